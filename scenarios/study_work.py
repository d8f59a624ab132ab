"""The runs of a study on the workers of a Dask cluster, stored as they come.

Few blocks of runs are in flight at a time, so that memory does not grow with their number; a block holds as many as
take about a second, so that sending it costs nothing beside it.
"""

from __future__ import annotations

import time
import traceback
from asyncio import CancelledError
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

from distributed import Client, Future, KilledWorker, as_completed

from scenarios.study_store import StudyStore, encode, trial_digest
from scenarios.study_subject import decoded, measured
from scenarios.trial import TrialResult, failed, joined

_BLOCK_S = 1.0
_MOST_RUNS = 100
_AHEAD = 2  # blocks per worker: one that runs, one that waits


class StudyStopped(RuntimeError):
    """The study cannot go on; what is done is stored."""


class Advance(Protocol):
    """Told of finished runs, and how many of them failed."""

    def __call__(self, runs: int, failed: int) -> None: ...


@dataclass(frozen=True)
class Block:
    """Consecutive runs of a point."""

    point: int
    runs: range


@dataclass(frozen=True)
class Done:
    """What a worker hands back: the rows as a Parquet file, failed runs, and the seconds it took."""

    part: bytes
    failed: int
    seconds: float


class OtherCode(RuntimeError):
    """A worker that would compute something else."""


def work(scenario: str, runs: range, keep: tuple[str, ...], code: str) -> Done:
    """Some runs of a resolved scenario or experiment (JSON); of one that ends with an exception, a row that says so.

    Raises
        OtherCode: this process has another version of the code.
    """
    if trial_digest() != code:
        raise OtherCode("a worker has another version of pruefstand's code")
    started = time.perf_counter()
    results = [_attempt(scenario, run, keep) for run in runs]
    count = sum((r.failures["kind"] == "exception").any() for r in results)
    return Done(encode(joined(results)), int(count), time.perf_counter() - started)


def _attempt(scenario: str, run: int, keep: tuple[str, ...]) -> TrialResult:
    try:
        return measured(_subject(scenario), run, keep)
    except Exception as error:  # a failed run is kept with its traceback and counted
        return failed(run, f"{type(error).__name__}: {error}", traceback.format_exc())


@lru_cache(maxsize=4)
def _subject(text: str) -> Any:
    return decoded(text)


class Blocks:
    """Cuts what is missing into blocks of about a second, by the time the last ones took."""

    def __init__(self, missing: Iterator[Block], workers: int) -> None:
        self._gaps = deque(missing)
        self._left = sum(len(b.runs) for b in self._gaps)
        self._again: deque[Block] = deque()
        self._workers = workers
        self._seconds: float | None = None

    def take(self) -> Block | None:
        """The next block; None where nothing is left to begin."""
        if self._again:
            return self._again.popleft()
        if not self._gaps:
            return None
        gap = self._gaps.popleft()
        runs = gap.runs[: self._size()]
        if len(runs) < len(gap.runs):
            self._gaps.appendleft(Block(gap.point, gap.runs[len(runs) :]))
        self._left -= len(runs)
        return Block(gap.point, runs)

    def _size(self) -> int:
        """One run to begin with; at the end so few that no worker waits long for another."""
        fair = -(-self._left // (_AHEAD * self._workers))
        return max(1, min(_MOST_RUNS, fair, 1 if self._seconds is None else int(_BLOCK_S / self._seconds)))

    def took(self, block: Block, seconds: float) -> None:
        """Learns from a block what a run takes."""
        each = seconds / len(block.runs)
        self._seconds = each if self._seconds is None else (self._seconds + each) / 2

    def split(self, block: Block) -> None:
        """Takes a block back, to try its runs one by one."""
        self._again.extend(Block(block.point, range(run, run + 1)) for run in block.runs)


def execute(client: Client, store: StudyStore, runs: int, keep: tuple[str, ...], advance: Advance) -> None:
    """Does what is missing of a study and stores it.

    Raises
        StudyStopped: the scheduler is gone, or a worker is not what it was.
    """
    texts = [p.scenario.model_dump_json(by_alias=True) for p in store.points]
    workers = sum(client.nthreads().values())
    missing = (Block(i, gap) for i in range(len(store.points)) for gap in store.missing(i, runs))
    blocks = Blocks(missing, workers)
    in_flight: dict[Future, Block] = {}
    finished = as_completed()

    def fill() -> None:
        while len(in_flight) < _AHEAD * workers and (block := blocks.take()) is not None:
            future = client.submit(work, texts[block.point], block.runs, keep, trial_digest(), pure=False)
            in_flight[future] = block
            finished.add(future)

    fill()
    while in_flight:
        future = next(finished)
        block = in_flight.pop(future)
        done = _outcome(future, block)
        if done is None:
            blocks.split(block)
        else:
            store.write(block.point, block.runs, done.part)
            blocks.took(block, done.seconds)
            advance(len(block.runs), done.failed)
        fill()


def _outcome(future: Future, block: Block) -> Done | None:
    """What a block came to; None where workers died over it, which only a single run is blamed for."""
    try:
        result: Done = future.result()
    except KilledWorker as error:
        if len(block.runs) > 1:
            return None
        reason = f"the process died, {error.allowed_failures + 1} times"
        return Done(encode(failed(block.runs[0], reason, "")), 1, 0.0)
    except CancelledError as error:
        raise StudyStopped("the scheduler is gone") from error
    except Exception as error:  # runs keep their own; this is the cluster's, and the study can go on later
        raise StudyStopped(str(error).splitlines()[0] if str(error) else type(error).__name__) from error
    return result
