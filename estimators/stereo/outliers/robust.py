"""Robust detection over whole tracks by graduated non-convexity, for windows where wrong tracks may be the majority.

The truncated cost sum_i min(T_i, c_i), c_i the quantile of chi-square with 3 |Theta_i| - 3 degrees of freedom, knows
no worse than an outlier. It is minimised by weights that follow a convex cost first and the truncated one in the end
(Yang, Antonante, Tzoumas, Carlone 2020, "Graduated non-convexity for robust spatial perception"), from the group of
tracks that keep their distances, and, where that is no majority, from the next such group and from all tracks.
Siegemund 2008 has no such detector; the test that decides in the end is that of (3.4.13) with the true rank.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float
from scipy.stats import chi2

from estimators.gauss_markov import SingularSystem
from estimators.stereo.initial_values import from_alignment, from_cloud
from estimators.stereo.object_motion import Problem, Solution
from estimators.stereo.outliers.residuals import Fit, fit, moved, normals, regular, track_statistics
from estimators.stereo.outliers.rigidity import consistency, largest_group
from estimators.stereo.outliers.verdict import Poses, Solve, Verdict, select_points
from sim.pose import exp_so3

Array = np.ndarray
Graph = tuple[Bool[Array, "n n"], Bool[Array, "n n"]]
_NONE = "no group of tracks moves as one rigid body"
# Three tracks can contradict each other, but not tell which of them is wrong.
_FEWEST = 4
_TRIES = 8
# From one weight function to the next; beyond the last one the weights are 0 or 1.
_GRADUATION, _LAST = 1.6, 1e3
# Where the convex cost begins: residuals so many times the quantile weigh nothing from the start.
_WORST = 1e4
# From a group's own motion on, the others come in at once: the convex cost would let them pull it away.
_FROM_GROUP = 0.5
# A track that fits two motions belongs to the second only if it fits it better by so much (two standard deviations).
_DOUBT = 4.0
_STEPS, _REVISIONS = 12, 6


@dataclass(frozen=True)
class Robust:
    """Graduated non-convexity over whole tracks, then adjustment and group test of all tracks at ``level`` in turn.

    sigma_0: standard deviation of unit weight, where the stated accuracies are known to be off; min_share: a smaller
    share of the tracks is no object but chance or error; second_share: among the outliers, a rigid group of at least
    this share of all tracks (and five tracks) is reported as a second group.
    """

    level: float = 0.01
    sigma_0: float = 1.0
    min_share: float = 0.2
    second_share: float = 0.1

    def __call__(self, problem: Problem, start: Poses, solve: Solve) -> Verdict:
        """``start`` serves the search among all tracks.

        Raises
            SingularSystem: fewer than four tracks, or no rigid group that is large enough.
        """
        limit = self._limit(problem)
        C = np.linalg.inv(problem.model(problem.l)[1]) * self.sigma_0**2
        graph = consistency(problem, C)
        inlier, solution, revisions = self._revise(problem, limit, _search(problem, limit, start, graph), None, solve)
        rival = self._rival(problem, limit, inlier, graph)
        if rival is None:
            return Verdict(inlier, solution, revisions)
        first, rival = _separate(problem, limit, fit(problem, solution.R, solution.T), rival)
        inlier, solution, more = self._revise(problem, limit, first, rival, solve)
        second = ~inlier & _inside(rival, limit)
        return Verdict(inlier, solution, revisions + more, second if self._matters(second) else None)

    def _limit(self, problem: Problem) -> Float[Array, "n"]:
        count = np.bincount(problem.point, minlength=problem.n)
        return np.asarray(chi2.isf(self.level, np.maximum(3 * count - 3, 1)) * self.sigma_0**2)

    def _matters(self, group: Bool[Array, "n"]) -> bool:
        return int(np.count_nonzero(group)) >= max(_FEWEST + 1, self.second_share * len(group))

    def _checked(self, inlier: Bool[Array, "n"]) -> Bool[Array, "n"]:
        if np.count_nonzero(inlier) < max(_FEWEST, self.min_share * len(inlier)):
            raise SingularSystem(_NONE)
        return inlier

    def _revise(
        self, problem: Problem, limit: Array, found: Fit, rival: Fit | None, solve: Solve
    ) -> tuple[Array, Solution, int]:
        """Adjustment of the good tracks and test of all in turn, until they stay the same; tracks nearer to a rival
        motion are none of them."""
        own = np.ones(problem.n, bool) if rival is None else found.cost <= rival.cost + _DOUBT
        inlier = self._checked(own & _inside(found, limit))
        poses = found.R, found.T
        for revision in range(1, _REVISIONS + 1):
            solution = solve(select_points(problem, inlier), poses)
            poses = solution.R, solution.T
            f = fit(problem, *poses, fit(problem, *poses).X)
            tested = self._checked(own & (track_statistics(f, inlier) < limit))
            if np.array_equal(tested, inlier):
                break
            if revision < _REVISIONS:
                inlier = tested
        return inlier, solution, revision

    def _rival(self, problem: Problem, limit: Array, inlier: Array, graph: Graph) -> Fit | None:
        """Another motion that a group of the outliers shares, None where the group is too small to matter."""
        group = largest_group(*graph, ~inlier)
        if not self._matters(group):
            return None
        try:
            found = _consensus(select_points(problem, ~inlier), limit[~inlier], group[~inlier])
        except SingularSystem:
            return None
        if found is None:
            return None
        rival = fit(problem, found.R, found.T)
        return rival if self._matters(~inlier & _inside(rival, limit)) else None


def _search(problem: Problem, limit: Array, start: Poses, graph: Graph) -> Fit:
    """The lowest truncated cost found: from the largest rigid group if it proves a majority, else also from its part
    in which all agree with all, from the group beside it and from all tracks."""
    everyone = np.ones(problem.n, bool)
    group = largest_group(*graph, everyone)
    found = _consensus(problem, limit, group)
    if found is not None and 2 * np.count_nonzero(_inside(found, limit)) > problem.n:
        return found
    more = (largest_group(*graph, everyone, agreement=1.0), largest_group(*graph, ~group))
    candidates = [found, *(_consensus(problem, limit, g) for g in more), _from_all(problem, limit, start)]
    return min((f for f in candidates if f is not None), key=lambda f: _truncated(f, limit))


def _inside(f: Fit, limit: Array) -> Bool[Array, "n"]:
    return np.asarray(f.cost < limit)


def _truncated(f: Fit, limit: Array) -> float:
    return float(np.minimum(f.cost, limit).sum())


def _consensus(problem: Problem, limit: Array, group: Bool[Array, "n"]) -> Fit | None:
    """Local minimum of the truncated cost from the motion of a group; None where it does not reach into all frames.

    The motion of a far group has several minima (its cloud laid over in depth): the best from three starts counts.
    """
    try:
        part = select_points(problem, group)
        fits = [_from_all(part, limit[group], poses) for poses in _starts(part)]
        best = min(fits, key=lambda f: _truncated(f, limit[group]))
        return _graduate(problem, limit, fit(problem, best.R, best.T), _FROM_GROUP)
    except SingularSystem:
        return None


def _starts(problem: Problem) -> list[Poses]:
    frame, l, m = problem.frame, problem.l, problem.m
    clouds = [from_cloud(frame, l, m, axes) for axes in ("unrotated", "principal_axes_xz")]
    return [*clouds, from_alignment(frame, problem.point, l, m)]


def _graduate(problem: Problem, limit: Array, f: Fit, mu: float) -> Fit:
    """Graduated non-convexity from the graduation mu on."""
    damping = 0.0
    while mu < _LAST:
        f, damping = _step(f, _weights(f.cost / limit, mu), damping)
        mu *= _GRADUATION
    return fit(problem, f.R, f.T, f.X)


def _from_all(problem: Problem, limit: Array, start: Poses) -> Fit:
    """Graduated non-convexity from least squares over all tracks, where the truncated cost is convex."""
    f = _settle(problem, fit(problem, *start), np.ones(problem.n))
    return _graduate(problem, limit, f, _convex(f.cost / limit))


def _convex(tau: Float[Array, "n"]) -> float:
    """Graduation at which the truncated cost is convex for all these values."""
    return 1 / max(2 * min(float(tau.max()), _WORST) - 1, 1.0)


def _settle(problem: Problem, f: Fit, w: Float[Array, "n"]) -> Fit:
    """Least squares with weighted tracks, roughly; then the observations' weights at the new points."""
    damping = 0.0
    for _ in range(_STEPS):
        before = float(w @ f.cost)
        f, damping = _step(f, w, damping)
        if before - float(w @ f.cost) < 1e-3 * before:
            break
    return fit(problem, f.R, f.T, f.X)


def _separate(problem: Problem, limit: Array, a: Fit, b: Fit) -> tuple[Fit, Fit]:
    """Two motions, each that of the tracks nearer to it than to the other; the one with more tracks first."""
    nearer = np.zeros(problem.n, bool)
    for _ in range(_STEPS):
        before, nearer = nearer, a.cost <= b.cost
        if np.array_equal(before, nearer):
            break
        try:
            a = _settle(problem, a, (nearer & _inside(a, limit)).astype(float))
            b = _settle(problem, b, (~nearer & _inside(b, limit)).astype(float))
        except SingularSystem:
            break
    more = np.count_nonzero(nearer & _inside(a, limit)) >= np.count_nonzero(~nearer & _inside(b, limit))
    return (a, b) if more else (b, a)


def _weights(tau: Float[Array, "n"], mu: float) -> Float[Array, "n"]:
    """Weights of the truncated least squares at graduation mu, Yang et al. 2020, (14), with threshold 1 for tau."""
    middle = np.sqrt(mu * (mu + 1) / np.maximum(tau, 1e-12)) - mu
    return np.asarray(np.where(tau <= mu / (mu + 1), 1.0, np.where(tau >= (mu + 1) / mu, 0.0, middle)))


def _step(f: Fit, w: Float[Array, "n"], damping: float) -> tuple[Fit, float]:
    """One damped Gauss-Newton step of the weighted cost, and the damping for the next."""
    N = normals(f, w)
    M, scale = regular(N, f.R)
    before = float(w @ f.cost)
    for _ in range(_TRIES):
        _, dp, failed = scipy.linalg.lapack.dposv(M + damping * np.eye(len(M)), N.rhs / scale)
        if not failed:
            step = (dp / scale).reshape(-1, 6)
            new = moved(f, exp_so3(step[:, :3]) @ f.R, f.T + step[:, 3:])
            if float(w @ new.cost) <= before * (1 + 1e-12) + 1e-12:
                return new, damping / 10 if damping > 1e-7 else 0.0
        damping = max(10 * damping, 1e-4)
    return f, damping
