"""The source's own solvers, points and poses in one step: Gauss-Newton (2.1.5), line search (2.2.1), damping (2.2.2).

`object_motion.adjust` solves the points anew for the poses of every iteration and needs fewer of them; these follow the
text, to be compared with.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from estimators.bordered import BorderedSystem, Elimination
from estimators.gauss_markov import SingularSystem
from estimators.stereo.conditions import Conditions
from estimators.stereo.datum import choose_three
from estimators.stereo.full_system import Weighted, about_camera, linearise, weighted
from estimators.stereo.initial_values import points_by_mean
from estimators.stereo.object_motion import Problem, Solution, Stop
from sim.pose import exp_so3

Array = np.ndarray
Method = Literal["gauss_newton", "line_search", "levenberg_marquardt"]
Datum = Literal["inner", "three_points"]
Pivot = Literal["object", "camera"]
State = tuple[Array, Array, Array]
_HALVINGS = 10
_NU = 10.0
_REPEATS = 30
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class _Place:
    """Where an iteration starts: R, T, X, the weights that hold for it, the system and what its steps turn about."""

    state: State
    w: Weighted
    system: BorderedSystem
    pivot: Pivot

    def moved(self, dp: Array) -> State:
        """The state after a step: (3.1.32)-(3.1.34), or with T <- T + dT where steps turn about the object."""
        R, T, X = self.state
        d = dp[-6 * len(R) :].reshape(-1, 6)
        turn = exp_so3(d[:, :3])
        pivot = T if self.pivot == "object" else (turn @ T[:, :, None])[:, :, 0]
        return turn @ R, pivot + d[:, 3:], X + dp[: X.size].reshape(-1, 3)

    def cost(self, dp: Array) -> float:
        """The system error after a step; infinite where it is not a number."""
        cost = self.w.cost(*self.moved(dp))
        return cost if np.isfinite(cost) else np.inf


Step = Callable[[_Place, Array, float], tuple[Array, float]]


def _gauss_newton(_: _Place, full: Array, damping: float) -> tuple[Array, float]:
    return full, damping


def _line_search(place: _Place, full: Array, damping: float) -> tuple[Array, float]:
    """gamma <- gamma +- 2^-mu from gamma = 1, mu = 0, whichever side costs less, (2.2.5)."""
    gamma = 1.0
    for mu in range(_HALVINGS + 1):
        more, less = gamma + 0.5**mu, gamma - 0.5**mu
        gamma = more if place.cost(more * full) < place.cost(less * full) else less
    return gamma * full, damping


def _levenberg_marquardt(place: _Place, _: Array, damping: float) -> tuple[Array, float]:
    """The better of the steps with lambda and lambda / nu, lambda raised until one lowers the cost, 2.2.2."""
    if damping == 0:
        damping = float(place.system.N.trace()) / (1e3 * place.system.A.shape[1])
    before = place.cost(np.zeros(place.system.A.shape[1])) * (1 + _ROUNDING) + _ROUNDING
    for _repeat in range(_REPEATS):
        first, second = (place.system.eliminate(value).solve() for value in (damping, damping / _NU))
        cost_1, cost_2 = place.cost(first), place.cost(second)
        if cost_1 > before and cost_2 > before:
            damping *= _NU
        elif cost_1 < cost_2:
            return first, damping
        else:
            return second, damping / _NU
    raise SingularSystem("no step decreases the cost")


_STEPS: dict[Method, Step] = {
    "gauss_newton": _gauss_newton,
    "line_search": _line_search,
    "levenberg_marquardt": _levenberg_marquardt,
}


def adjust_full(
    problem: Problem,
    R: Float[Array, "m 3 3"],
    T: Float[Array, "m 3"],
    method: Method = "gauss_newton",
    datum: Datum = "inner",
    conditions: Conditions | None = None,
    stop: Stop = "decrement",
    tolerance: float = 1e-6,
    max_iterations: int = 50,
    pivot: Pivot = "object",
) -> Solution:
    """Poses and points together by the bordered normal equations (2.1.27), weights before every iteration (4.1.3.3).

    method: "gauss_newton" the full step (2.1.18); "line_search" (2.2.1)-(2.2.5); "levenberg_marquardt" (2.2.6)-(2.2.8)
    with lambda_0 = tr(A'WA) / (10^3 u), nu = 10. datum: which conditions keep the object's frame where R, T and the
    mean of the points put it; the result is in that frame, `datum.in_frame` leads into others. pivot: what steps turn
    about, the source's being the camera (3.1.33). conditions as in `object_motion.adjust`, met by R, T.

    stop: "decrement" squared Newton decrement below the tolerance; "update" largest change of an unknown (2.1.19);
    "relative_update" largest change in standard deviations (2.1.20). Each looks at the full step, even where a part of
    it is taken: a damped step is small far from the optimum, too.

    Raises
        SingularSystem: the tracks do not determine the motion, or the iterations diverge or do not end.
    """
    state: State = (np.array(R, float), np.array(T, float), points_by_mean(problem, R, T))
    three = choose_three(problem.point, state[2]) if datum == "three_points" else None
    damping = 0.0
    for iteration in range(1, max_iterations + 1):
        try:
            w = weighted(problem, *state, conditions)
        except np.linalg.LinAlgError as error:  # a step has led points to where no image tells their distance
            raise SingularSystem("the iterations diverge") from error
        system = linearise(w, *state, three)
        place = _Place(state, w, about_camera(system, state[1]) if pivot == "camera" else system, pivot)
        elimination = place.system.eliminate()
        full = elimination.solve()
        step, damping = _STEPS[method](place, full, damping)
        state = place.moved(step)
        cost = w.cost(*state)
        if not np.isfinite(cost):
            raise SingularSystem("the iterations diverge")
        if _change(elimination, full, stop) < tolerance:
            return Solution(*state, w.W, cost, iteration)
    raise SingularSystem(f"no convergence within {max_iterations} iterations")


def _change(elimination: Elimination, full: Array, stop: Stop) -> float:
    if stop == "decrement":
        return float(elimination.b @ full)
    if stop == "update":
        return float(np.abs(full).max())
    sigma = np.sqrt(elimination.variances())
    known = sigma > 1e-9 * sigma.max()  # the others are held by the datum or a condition
    return float(np.max(np.abs(full[known]) / sigma[known]))
