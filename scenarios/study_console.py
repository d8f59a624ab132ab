"""How far a study is: a bar on a terminal, now and then a plain line elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
from rich.progress import Progress as Bar

from scenarios.study_work import Advance

_LINE_S = 10.0


class Silent:
    """An engine's progress that nobody needs to see."""

    @contextmanager
    def stage(self, _name: str, _total: int) -> Iterator[Callable[[], None]]:
        yield lambda: None

    def say(self, _line: str) -> None:
        pass


class Counter:
    """Runs done, and at what rate since the first of this session came back."""

    def __init__(self, total: int, done: int) -> None:
        self.total, self.done, self.failed = total, done, 0
        self._started = time.perf_counter()
        self._first: tuple[float, int] | None = None

    def add(self, runs: int, failed: int) -> None:
        self.done += runs
        self.failed += failed
        if self._first is None:
            self._first = (time.perf_counter(), self.done)

    @property
    def rate(self) -> float:
        """Runs a second; starting the workers and building the first worlds does not count."""
        if self._first is None or self.done == self._first[1]:
            return 0.0
        return (self.done - self._first[1]) / (time.perf_counter() - self._first[0])

    @property
    def text(self) -> str:
        left = f"{_duration((self.total - self.done) / self.rate)} left" if self.rate else "starting"
        failed = f", {self.failed} failed" if self.failed else ""
        return f"{self.rate:.3g} runs/s, {left}{failed}"

    @property
    def summary(self) -> str:
        seconds = time.perf_counter() - self._started
        return f"study  {self.done}/{self.total} runs  {_duration(seconds)}  {self.rate:.3g} runs/s"


@dataclass(frozen=True)
class Progress:
    """Progress of a study on a rich console."""

    console: Console

    @contextmanager
    def of(self, total: int, done: int) -> Iterator[Advance]:
        """Announces so many runs, some of which are done already."""
        counter = Counter(total, done)
        if done:
            self.say(f"going on: {done} of {total} runs are there already")
        if self.console.is_terminal:
            columns = (BarColumn(bar_width=28), MofNCompleteColumn(), TextColumn("{task.description}"))
            with Bar(*columns, console=self.console, transient=True) as bar:
                task = bar.add_task("starting", total=total, completed=done)

                def advance(runs: int, failed: int) -> None:
                    counter.add(runs, failed)
                    bar.update(task, completed=counter.done, description=counter.text)

                yield advance
        else:
            yield self._lines(counter)
        self.say(counter.summary)

    def _lines(self, counter: Counter) -> Advance:
        said = time.perf_counter()

        def advance(runs: int, failed: int) -> None:
            nonlocal said
            counter.add(runs, failed)
            if time.perf_counter() - said >= _LINE_S:
                said = time.perf_counter()
                self.say(f"study  {counter.done}/{counter.total} runs  {counter.text}")

        return advance

    def say(self, line: str) -> None:
        self.console.print(line, markup=False, highlight=False, soft_wrap=True)


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"
