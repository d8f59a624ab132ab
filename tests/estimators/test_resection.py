"""Resection: exact recovery, Jacobians by differences, honest covariance, outliers, and what cannot be solved."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.aerial.resection import ImagePoints, Resection, initial_pose, linearise, moved, resect
from estimators.estimate import EstimationFailed
from sim.angles import rotation_from_omega_phi_kappa
from sim.camera import Camera
from sim.pose import Pose, exp_so3, log_so3

Array = np.ndarray
K = np.array([[2500.0, 0.8, 515.0], [0, 2498.0, 508.0], [0, 0, 1]])
CAMERA = Camera(K, (1024, 1024), np.array([0.05, -0.1, 1e-4, -2e-4, 0.0]))
M, N = 40, 9


def flight(m: int = M) -> tuple[Pose, Array]:
    """Cameras 500 m over nine points of some relief."""
    rng = np.random.default_rng(1)
    opk = np.column_stack([rng.normal(0, 0.05, (m, 2)), rng.uniform(-np.pi, np.pi, m)])
    t = np.array([0, 0, 500.0]) + rng.normal(0, 8, (m, 3))
    east, north = np.meshgrid([-55.0, 0, 55], [-55.0, 0, 55])
    X = np.column_stack([east.ravel(), north.ravel(), rng.uniform(0, 25, N)])
    return Pose(rotation_from_omega_phi_kappa(opk), t), X


def clicks(T_wc: Pose, X: Array, sigma_px: float = 0.0, stated_px: float = 0.5, seed: int = 0) -> ImagePoints:
    image, point = (a.ravel() for a in np.indices((len(T_wc), len(X))))
    uv = CAMERA.project(T_wc[image].inv().apply(X[point]))
    assert np.isfinite(uv).all()
    return ImagePoints(image, point, uv + np.random.default_rng(seed).normal(0, sigma_px, uv.shape), stated_px)


def disturbed(T_wc: Pose, seed: int = 5) -> Pose:
    """A start 2 degrees and 5 m away."""
    rng = np.random.default_rng(seed)
    return moved(T_wc, np.column_stack([rng.normal(0, 0.035, (len(T_wc), 3)), rng.normal(0, 5, (len(T_wc), 3))]))


def good(results: tuple[Resection | EstimationFailed, ...]) -> list[Resection]:
    assert all(isinstance(r, Resection) for r in results), results
    return [r for r in results if isinstance(r, Resection)]


def errors(results: list[Resection], T_wc: Pose) -> Array:
    """Rotation in camera axes and translation, (m, 6)."""
    T = Pose.stack([r.T_wc for r in results])
    rotation = log_so3(np.swapaxes(T_wc.R, 1, 2) @ T.R)
    return np.concatenate([rotation, T.t - T_wc.t], axis=1)


def test_jacobians_by_differences() -> None:
    T_wc, X = flight(9)
    p = linearise(CAMERA, T_wc, X)
    h = 1e-6
    for i in range(6):
        d = np.zeros((9, 6))
        d[:, i] = h * (1 if i < 3 else 1e3)
        ahead, back = linearise(CAMERA, moved(T_wc, d), X).uv, linearise(CAMERA, moved(T_wc, -d), X).uv
        # central differences of values of 1e3 px: 1e-6 of the derivative
        np.testing.assert_allclose((ahead - back) / (2 * d[0, i]), p.A[:, :, i], rtol=1e-5, atol=1e-4)
    for i in range(3):
        dX = np.zeros(3)
        dX[i] = 1e-3
        ahead, back = linearise(CAMERA, T_wc, X + dX).uv, linearise(CAMERA, T_wc, X - dX).uv
        np.testing.assert_allclose((ahead - back) / 2e-3, p.B[:, :, i], rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("fixed", [False, True])
def test_exact_points_give_the_exact_pose(fixed: bool) -> None:
    T_wc, X = flight()
    start = disturbed(T_wc)
    start = Pose(start.R, T_wc.t) if fixed else start
    e = errors(good(resect(CAMERA, clicks(T_wc, X), X, start, fixed)), T_wc)
    assert np.abs(e[:, :3]).max() < 1e-9
    assert np.abs(e[:, 3:]).max() < (1e-12 if fixed else 1e-6)


def test_a_start_from_the_points_alone() -> None:
    T_wc, X = flight(1)
    points = clicks(T_wc, X)
    start = initial_pose(CAMERA, X, points.uv)
    assert isinstance(start, Pose)
    np.testing.assert_allclose(start.R, T_wc.R[0], atol=1e-6)
    np.testing.assert_allclose(start.t, T_wc.t[0], atol=1e-3)
    assert isinstance(initial_pose(CAMERA, X[:3], points.uv[:3]), EstimationFailed)


@pytest.mark.parametrize("fixed", [False, True])
def test_covariance_is_honest(fixed: bool) -> None:
    T_wc, X = flight()
    runs = []
    for seed in range(10):
        start = Pose(disturbed(T_wc).R, T_wc.t)
        results = good(resect(CAMERA, clicks(T_wc, X, 0.5, 0.5, seed), X, start, fixed))
        c = 3 if fixed else 6
        e = errors(results, T_wc)[:, :c]
        C = np.stack([r.cov[:c, :c] for r in results])
        runs.append(np.einsum("ni,nij,nj->n", e, np.linalg.inv(C), e) / c)
        sigma_0 = np.sqrt(np.mean([r.sigma_0**2 for r in results]))
        assert 0.85 < sigma_0 < 1.15  # 40 images of redundancy >= 12: 4 sigma are 0.13
    dof = 400 * c
    assert abs(np.mean(runs) - 1) < 4 * np.sqrt(2 / dof)


def test_wrong_clicks_are_found_and_left_out() -> None:
    T_wc, X = flight()
    points = clicks(T_wc, X, 0.5)
    uv = points.uv.copy()
    for i in range(M):
        uv[i * N + i % N] += [8.0, -6.0]
        uv[i * N + (i + 4) % N] += [0.0, 60.0]
    results = good(resect(CAMERA, ImagePoints(points.image, points.point, uv, 0.5), X, disturbed(T_wc)))
    found = [{i % N, (i + 4) % N} <= set(r.rejected.tolist()) for i, r in enumerate(results)]
    assert np.mean(found) > 0.9
    clean = [len(r.rejected) for r in good(resect(CAMERA, points, X, disturbed(T_wc)))]
    assert sum(clean) <= 4  # 360 tests at 0.1 %


def test_what_cannot_be_solved_is_said_per_image() -> None:
    T_wc, X = flight(4)
    points = clicks(T_wc, X, 0.5)
    row = X[:, 1] == 0
    keep = (points.image == 0) | ((points.image == 1) & (points.point < 2)) | ((points.image == 2) & row[points.point])
    level = np.where(row[:, None] & (np.arange(3) == 2), 0.0, X)
    points = clicks(T_wc, level, 0.5).select(keep)
    results = resect(CAMERA, points, level, T_wc)
    assert isinstance(results[0], Resection)
    reasons = [r.reason for r in results if isinstance(r, EstimationFailed)]
    assert reasons == ["2 points: a resection needs 3", "the points lie on a line", "0 points: a resection needs 3"]


def test_a_start_that_looks_away_is_a_failure() -> None:
    T_wc, X = flight(2)
    start = Pose(np.stack([T_wc.R[0], T_wc.R[1] @ exp_so3(np.array([np.pi, 0, 0]))]), T_wc.t)
    first, second = resect(CAMERA, clicks(T_wc, X), X, start)
    assert isinstance(first, Resection)
    assert isinstance(second, EstimationFailed)
    assert "behind" in second.reason


def test_wrong_points_are_refused() -> None:
    uv = np.zeros((2, 2))
    two = np.array([0, 1])
    with pytest.raises(ValueError, match="point 3 is measured twice in image 0"):
        ImagePoints(np.zeros(2, int), np.array([3, 3]), uv, 0.5)
    with pytest.raises(ValueError, match="1 are not finite"):
        ImagePoints(np.zeros(2, int), two, np.array([[np.nan, 0], [0, 0]]), 0.5)
    with pytest.raises(ValueError, match="sigma_px: expected > 0"):
        ImagePoints(np.zeros(2, int), two, uv, 0.0)
