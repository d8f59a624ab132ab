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


@pytest.fixture(scope="module", params=["normal", "general"])
def runs(request: pytest.FixtureRequest, make_scene: Callable[..., Any]) -> tuple[Array, Array]:
    """Errors (runs, 12) and covariances (runs, 12, 12) of a 10-frame window at 20 m: the linear covariance holds."""
    runs = RUNS if request.param == "normal" else RUNS // 3
    scene = make_scene(points=120, frames=10, distance_m=20.0, rig=request.param)
    estimator = SlidingWindowAdjustment(window=10, start_window=10, initial="principal_axes_xz")
    results = []
    for seed in range(runs):
        estimate = estimator(scene.observe(0.2, 1000 + seed))
        assert isinstance(estimate, TrajectoryEstimate)
        (w,) = estimate.windows
        results.append((errors(w, scene), w.cov))
    return np.array([r[0] for r in results]), np.array([r[1] for r in results])


@pytest.mark.parametrize("part", [slice(0, 6), slice(6, 12), slice(0, 12)], ids=["pose", "velocity and rate", "all"])
def test_nees_is_inside_its_band(runs: tuple[Array, Array], part: slice) -> None:
    e, C = runs[0][:, part], runs[1][:, part, part]
    nees = np.einsum("ra,rab,rb->r", e, np.linalg.inv(C), e)
    dof = e.shape[1]
    # 99 % of the mean of as many chi-square variables.
    low, high = chi2.ppf([0.005, 0.995], dof * len(e)) / len(e)
    assert low < nees.mean() < high
    # Each run, too: the largest of all at 1e-4 a run.
    assert nees.max() < chi2.ppf(1 - 1e-4, dof)


def test_errors_have_no_bias(runs: tuple[Array, Array]) -> None:
    """The mean of every functional over the runs is zero within 4 standard errors (24 tests: 0.2 % by chance)."""
    e, C = runs
    standard = e.mean(axis=0) / np.sqrt(np.einsum("raa->ra", C).mean(axis=0) / len(e))
    assert np.abs(standard).max() < 4


def test_every_functional_scatters_as_stated(runs: tuple[Array, Array]) -> None:
    e, C = runs
    ratio = (e**2).mean(axis=0) / np.einsum("raa->ra", C).mean(axis=0)
    # Variance of a variance estimate 2/n, 4 standard deviations.
    assert np.abs(ratio - 1).max() < 4 * np.sqrt(2 / len(e))
