"""Whether errors agree with the stated covariance (NEES), and with the best any estimator could do (Cramer-Rao)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.stats import chi2

from estimators.estimate import TrajectoryEstimate
from estimators.gauss_markov import SingularSystem
from estimators.stereo.conditions import Conditions
from estimators.stereo.object_motion import motion_covariance
from reports.windows import WindowComparison, at_reference
from sim.observations import Tracks
from sim.pose import Pose
from sim.truth import INLIER, Truth

Array = np.ndarray
Known = Callable[[Array, Pose | None, tuple[Array, Array]], tuple[tuple[Array, Array], Conditions | None]]
DOF = 6
_SINGULAR = 1e12  # condition number; in metres and radians, windows of any use stay below 1e6
NO_BOUND = np.full((12, 12), np.nan)
NEES_COLUMNS = ["scenario", "seed", "run", "estimator", "quantity", "t_s", "nees", "disjoint"]


def nees(error: Float[Array, "*b k"], cov: Float[Array, "*b k k"]) -> Float[Array, "*b"]:
    """Normalised estimation error squared, ``e' C^-1 e``: chi-square with k degrees of freedom if C is honest."""
    return np.asarray(np.sum(error * np.linalg.solve(cov, error[..., None])[..., 0], axis=-1))


def band(dof: int, n: int, level: float = 0.99) -> tuple[float, float]:
    """Band of the mean of n independent NEES values over its degrees of freedom; expectation 1."""
    tail = (1 - level) / 2
    return float(chi2.ppf(tail, dof * n)) / (dof * n), float(chi2.ppf(1 - tail, dof * n)) / (dof * n)


def pooled_nees(values: Float[Array, "n"], dof: int = DOF) -> tuple[float, float, float]:
    """Mean of n independent NEES values over its degrees of freedom, and the 99 % band it lies in if C is honest.

    Independent are the runs of one fixed window, or windows of one run that share no frame; never overlapping ones.
    """
    return (float(np.mean(values)) / dof, *band(dof, len(values)))


def window_nees(c: WindowComparison) -> dict[str, float]:
    """NEES of a window's pose (centroid, rotation) and motion (velocity of the reference point, angular rate).

    Errors are estimate minus truth in left camera axes, the covariance is the one of the stated sigmas. The true motion
    is the difference of the same two frames, as the covariance is: the lag of a difference behind the instant is in the
    errors, not in the NEES. None where a condition fixes a direction (rotation about a known axis): its error has no
    variance to be divided by.
    """
    pose = np.concatenate([c.estimate.position - c.truth.position, c.orientation])
    motion = np.concatenate([c.estimate.velocity - c.true_velocity, c.estimate.omega - c.true_omega])
    moved = at_reference(c.window.cov, c.estimate)[6:, 6:]
    pairs = {"pose": (pose, c.window.cov[:6, :6]), "velocity": (motion, moved)}
    return {name: float(nees(e, cov)) for name, (e, cov) in pairs.items() if np.linalg.cond(cov) < _SINGULAR}


def disjoint_windows(estimate: TrajectoryEstimate) -> frozenset[int]:
    """Newest frames of windows that share no observation with one another, chosen greedily from the first.

    Overlapping windows use the same observations, those of a filter all of them; only disjoint ones are independent.
    """
    chosen: list[int] = []
    for w in estimate.windows:
        if not chosen or w.oldest > chosen[-1]:
            chosen.append(int(w.frames[-1]))
    return frozenset(chosen)


def nees_table(
    truth: Truth,
    estimate: TrajectoryEstimate,
    comparisons: list[WindowComparison],
    *,
    scenario: str,
    seed: int,
    run: int,
    estimator: str,
) -> pd.DataFrame:
    """NEES of every window, quantity "pose" and "velocity" (with rate), six degrees of freedom each.

    ``disjoint`` marks the windows that may be pooled within one run. Over independent runs, pool one fixed window.
    """
    independent = disjoint_windows(estimate)
    rows = [
        (scenario, seed, run, estimator, quantity, float(truth.t_s[c.frame]), value, c.frame in independent)
        for c in comparisons
        for quantity, value in window_nees(c).items()
    ]
    return pd.DataFrame(rows, columns=NEES_COLUMNS)


def cramer_rao(truth: Truth, tracks: Tracks, c: WindowComparison, known: Known | None = None) -> Float[Array, "12 12"]:
    """Cramer-Rao bound of the functionals of `WindowEstimate.cov` over a window's inlier tracks.

    Fisher information of the image coordinates at the true geometry with the injected noise: ``W = J' J / sigma²`` with
    J the Jacobian of the projection. NaN where the rows do not determine it or the noise is zero. ``known`` makes of
    the times, the ego poses and the true poses the conditions that an estimator takes for granted. NaN for recursive
    estimates: observations before the window entered, and what a filter believes of the motion between them.
    """
    if c.window.since >= 0:
        return NO_BOUND
    frames = c.window.frames
    rows = np.isin(tracks.frame, frames) & np.isin(tracks.track, c.track) & (truth.labels.kind == INLIER)
    seen, frame = np.unique(tracks.frame[rows], return_inverse=True)
    present, point = np.unique(tracks.track[rows], return_inverse=True)
    sigma = truth.labels.sigma_px[rows]
    if len(present) < len(c.track) or not np.isin(frames[-2:], seen).all() or not np.all(sigma > 0):
        return NO_BOUND
    X_v = truth.point_v[np.searchsorted(truth.track, present)]
    T_cv = truth.T_cv[seen]
    J = truth.rig.project_jacobian(T_cv[frame].apply(X_v[point]))
    W = np.swapaxes(J, 1, 2) @ J / sigma[:, None, None] ** 2
    try:
        conditions = known and known(truth.t_s[seen], None, (T_cv.R, T_cv.t))[1]
        return motion_covariance(frame, point, T_cv.R, X_v, W, c.truth.dt_s, T_cv.t, conditions)
    except SingularSystem:
        return NO_BOUND
