"""What a detector is given and what it says, and the part of a problem that some of its tracks make."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float

from estimators.gauss_markov import SingularSystem
from estimators.stereo.object_motion import Problem, Solution
from estimators.stereo.windows import MIN_POINTS

Array = np.ndarray
Poses = tuple[Float[Array, "m 3 3"], Float[Array, "m 3"]]
Solve = Callable[[Problem, Poses], Solution]


@dataclass(frozen=True, eq=False)
class Verdict:
    """Which tracks of a problem are good.

    inlier (n,); solution of the problem `select_points(problem, inlier)`; outer_iterations adjustments made;
    second_group (n,) outliers that move as another rigid body, None where there are none or nobody looked for them.
    """

    inlier: Bool[Array, "n"]
    solution: Solution
    outer_iterations: int
    second_group: Bool[Array, "n"] | None = None


class Detector(Protocol):
    """Finds the outliers among the tracks of a problem; ``solve(problem, start)`` adjusts from start poses.

    Raises
        SingularSystem: too few good tracks are left.
    """

    def __call__(self, problem: Problem, start: Poses, solve: Solve) -> Verdict: ...


def select_points(problem: Problem, keep: Bool[Array, "n"]) -> Problem:
    """The problem of the tracks ``keep`` alone, in the same frames, tracks numbered anew in their order.

    Raises
        SingularSystem: a frame is left with fewer than three tracks.
    """
    if keep.all():
        return problem
    rows = keep[problem.point]
    frame = problem.frame[rows]
    if np.bincount(frame, minlength=problem.m).min() < MIN_POINTS:
        raise SingularSystem(f"outlier detection leaves a frame with fewer than {MIN_POINTS} tracks")
    number = np.cumsum(keep) - 1
    return replace(
        problem,
        frame=frame,
        point=number[problem.point[rows]],
        l=problem.l[rows],
        model=problem.model.select(rows),
        n=int(np.count_nonzero(keep)),
    )
