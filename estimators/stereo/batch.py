"""Adjustments of many windows at once, as a study of hundreds of runs asks for them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from estimators.gauss_markov import SingularSystem
from estimators.stereo.conditions import Conditions
from estimators.stereo.object_motion import Problem, Solution, Stop, adjust

# Of a window: R (m, 3, 3), T (m, 3).
Poses = tuple[np.ndarray, np.ndarray]


def adjust_batch(
    problems: Sequence[Problem],
    starts: Sequence[Poses],
    stop: Stop = "decrement",
    tolerance: float = 1e-6,
    max_iterations: int = 50,
    conditions: Sequence[Conditions | None] | None = None,
    threads: int | None = None,
) -> list[Solution | SingularSystem]:
    """`object_motion.adjust` of every problem from its start poses, on as many threads as there are processors.

    The compiled loop leaves the interpreter to the others while it runs. Every result is, bit for bit, that of a call
    of its own, whatever the number of threads; one that fails is the error as a value. The linear algebra library
    should keep to one thread (OPENBLAS_NUM_THREADS=1, as the command line sets it): from some fifty frames to a window
    on it would start its own.

    Raises
        ValueError: the sequences differ in length, or threads is less than one.
    """
    if conditions is None:
        conditions = [None] * len(problems)
    if not len(problems) == len(starts) == len(conditions):
        counts = f"{len(problems)} problems, {len(starts)} starts and {len(conditions)} conditions"
        raise ValueError(f"starts, conditions: expected one for each problem, found {counts}")
    threads = len(os.sched_getaffinity(0)) if threads is None else threads
    if threads < 1:
        raise ValueError(f"threads: {threads} is out of range, expected 1 or more")

    def one(i: int) -> Solution | SingularSystem:
        try:
            return adjust(problems[i], *starts[i], stop, tolerance, max_iterations, conditions[i])
        except SingularSystem as error:
            return error

    def share(first: int) -> list[Solution | SingularSystem]:
        return [one(i) for i in range(first, len(problems), threads)]

    results: list[Solution | SingularSystem] = [SingularSystem("not adjusted")] * len(problems)
    with ThreadPoolExecutor(threads) as pool:
        for first, part in enumerate(pool.map(share, range(threads))):
            results[first::threads] = part
    return results
