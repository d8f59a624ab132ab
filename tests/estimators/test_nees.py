"""Is the stated covariance honest? Normalised errors of independent runs of one fixed window against chi-square."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from estimators.estimate import TrajectoryEstimate, WindowEstimate
from estimators.stereo.object_motion import align
from estimators.stereo.sliding_window import SlidingWindowAdjustment
from sim.pose import log_so3

Array = np.ndarray

RUNS = 200


def errors(w: WindowEstimate, scene: Any) -> Array:
    """The twelve gauge-free functionals of `WindowEstimate.cov`, estimated minus true, from their definitions."""
    dt = scene.t_s[-1] - scene.t_s[-2]
    R, R_true = w.T_co.R[-2:], scene.T_co.R[-2:]
    Q, _ = align(scene.X, w.X_o)  # the estimated object frame from the true one
    centre = R @ w.X_o.mean(axis=0) + w.T_co.t[-2:] - scene.points_c()[-2:].mean(axis=1)
    rate = (log_so3(R[1] @ R[0].T) - log_so3(R_true[1] @ R_true[0].T)) / dt
    return np.concatenate([centre[1], log_so3(R[1] @ Q @ R_true[1].T), (centre[1] - centre[0]) / dt, rate])


def simulated(scene: Any, count: int) -> tuple[Array, Array]:
    """Errors (count, 12) and covariances (count, 12, 12) of one 10-frame window under independent noise."""
    estimator = SlidingWindowAdjustment(window=10, start_window=10, initial="principal_axes_xz")
    results = []
    for seed in range(count):
        estimate = estimator(scene.observe(0.2, 1000 + seed))
        assert isinstance(estimate, TrajectoryEstimate)
        (w,) = estimate.windows
        results.append((errors(w, scene), w.cov))
    return np.array([r[0] for r in results]), np.array([r[1] for r in results])


@pytest.mark.parametrize(("rig", "count"), [("normal", RUNS), ("general", RUNS // 3)])
def test_the_stated_covariance_is_honest(make_scene: Callable[..., Any], rig: str, count: int) -> None:
    """An object at 20 m, where the linear covariance holds: one test, for the runs are dear."""
    e, C = simulated(make_scene(points=120, frames=10, distance_m=20.0, rig=rig), count)
    for part in (slice(0, 6), slice(6, 12), slice(0, 12)):  # pose; velocity and rate; all
        nees = np.einsum("ra,rab,rb->r", e[:, part], np.linalg.inv(C[:, part, part]), e[:, part])
        dof = e[:, part].shape[1]
        # 99 % of the mean of as many chi-square variables.
        low, high = chi2.ppf([0.005, 0.995], dof * count) / count
        assert low < nees.mean() < high
        # Each run, too: the largest of all at 1e-4 a run.
        assert nees.max() < chi2.ppf(1 - 1e-4, dof)
    variance = np.einsum("raa->ra", C).mean(axis=0)
    # No bias: every mean is zero within 4 standard errors (24 values: 0.2 % by chance).
    assert np.abs(e.mean(axis=0) / np.sqrt(variance / count)).max() < 4
    # Every functional scatters as stated: variance of a variance 2/n, 4 standard deviations.
    assert np.abs((e**2).mean(axis=0) / variance - 1).max() < 4 * np.sqrt(2 / count)
