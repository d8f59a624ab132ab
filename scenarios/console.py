"""What a user sees while a command works: a progress bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


@dataclass(frozen=True)
class Reporter:
    """Progress of stages on a rich console; ``unit``: what their steps are."""

    console: Console
    unit: str = "frames"

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[Callable[[], None]]:
        """Announces a stage; the value it yields is called once per finished step."""
        started = time.perf_counter()
        if self.console.is_terminal and total > 1:
            columns = (
                TextColumn("{task.description:<10}"),
                BarColumn(bar_width=28),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
                TimeRemainingColumn(),
            )
            with Progress(*columns, console=self.console, transient=True) as progress:
                task = progress.add_task(name, total=total)
                yield lambda: progress.advance(task)
        else:
            yield lambda: None
        self.say(f"{name}  {time.perf_counter() - started:.1f} s" + (f"  {total} {self.unit}" if total > 1 else ""))

    def say(self, line: str) -> None:
        self.console.print(line, markup=False, highlight=False, soft_wrap=True)
