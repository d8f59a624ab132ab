"""The adjustment of motion and shape: derivatives by differences, the optimum and its covariance by other means."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from estimators.gauss_markov import SingularSystem, normal_blocks, reduce_points
from estimators.stereo.depth_bias import Weights, observation_model
from estimators.stereo.initial_values import from_cloud, points_by_mean
from estimators.stereo.object_motion import (
    Problem,
    Stop,
    adjust,
    align,
    design,
    motion_covariance,
    null_space,
    redundancy,
)
from estimators.stereo.triangulation import triangulate, undistorted
from sim.pose import exp_so3, log_so3

Array = np.ndarray
Maker = Callable[..., Any]


def make_problem(
    scene: Any, sigma_px: float = 0.0, keep: Array | None = None, weights: Weights = "estimated"
) -> Problem:
    o = scene.observe(sigma_px, 1, keep)
    rig, uv, cov = undistorted(scene.rig, o.tracks.uv, o.tracks.cov)
    l, C = triangulate(rig, uv, cov)
    model = observation_model(rig, l, C, np.linalg.inv(cov), weights, sigma_px > 0)
    return Problem(o.tracks.frame, o.tracks.track, l, model, len(scene.t_s), len(scene.X))


def some_missing(m: int, n: int) -> Array:
    """Every point misses some frames, none all but one."""
    return np.add.outer(np.arange(m), 3 * np.arange(n)) % 4 != 0


@pytest.fixture(scope="module")
def small(make_scene: Maker) -> Any:
    return make_scene(points=9, frames=4, distance_m=12.0, yaw_rate=1.5)


def camera_points(R: Array, T: Array, X: Array) -> Array:
    return np.asarray(np.einsum("mab,nb->mna", R, X) + T[:, None])


def test_design_by_finite_differences(small: Any) -> None:
    R, X, T, h = small.T_co.R, small.X[:4], small.T_co.t, 1e-6
    A = design(R, X)
    for j, step in enumerate(h * np.eye(6)):
        f = [np.einsum("kab,kb->ka", exp_so3(s * step[:3]) @ R, X) + T + s * step[3:] for s in (1, -1)]
        # Rounding of 12 m: 1e-15 / 1e-6; truncation 1e-12.
        np.testing.assert_allclose(A[:, :, j], (f[0] - f[1]) / (2 * h), atol=1e-8)


def test_moving_the_object_frame_alone_costs_nothing(small: Any) -> None:
    problem = make_problem(small)
    _, W = problem.model(problem.l)
    R_k, X_k = small.T_co.R[problem.frame], small.X[problem.point]
    blocks = normal_blocks(design(R_k, X_k), R_k, W, np.zeros((len(R_k), 3)))
    S = reduce_points(problem.frame, problem.point, blocks, 4, 9).S
    unit = np.sqrt(np.diag(S))
    G = null_space(small.T_co.R) * unit[:, None]
    assert np.linalg.matrix_rank(G) == 6
    np.testing.assert_allclose(S / np.outer(unit, unit) @ G, 0, atol=1e-11 * np.abs(G).max())
    # The null space has no further direction.
    assert np.sum(np.linalg.eigvalsh(S / np.outer(unit, unit)) > 1e-9) == 24 - 6


def test_mean_points_of_given_poses(small: Any) -> None:
    X = points_by_mean(make_problem(small, keep=some_missing(4, 9)), small.T_co.R, small.T_co.t)
    np.testing.assert_allclose(X, small.X, atol=1e-9)


def test_align_finds_the_rigid_motion_and_never_mirrors() -> None:
    rng = np.random.default_rng(2)
    X, Q, s = rng.normal(size=(20, 3)), exp_so3(np.array([1.0, -2, 0.5])), np.array([3.0, 4, 5])
    found = align(X, X @ Q.T + s)
    np.testing.assert_allclose(found[0], Q, atol=1e-13)
    np.testing.assert_allclose(found[1], s, atol=1e-13)
    mirrored, _ = align(X, X * [1, 1, -1])
    assert np.linalg.det(mirrored) == pytest.approx(1)
    # Inner constraints (3.1.35)-(3.1.36) at the optimum.
    Y = X + 0.1 * rng.normal(size=X.shape)
    Q, s = align(X, Y)
    Z = X @ Q.T + s
    np.testing.assert_allclose((Y - Z).sum(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(np.cross(Z, Y - Z).sum(axis=0), 0, atol=1e-11)


@pytest.mark.parametrize("rig", ["normal", "general"])
@pytest.mark.parametrize("weights", ["observed", "averaged", "estimated"])
@pytest.mark.parametrize("distance_m", [12.0, 80.0])
def test_noise_free_motion_is_recovered(make_scene: Maker, rig: str, weights: Weights, distance_m: float) -> None:
    scene = make_scene(points=40, frames=8, distance_m=distance_m, rig=rig)
    problem = make_problem(scene, keep=some_missing(8, 40), weights=weights)
    rng = np.random.default_rng(3)
    # Rough start values: 1 degree (of the 5 the object turns) and 20 cm, a hundred times the accuracy.
    R, T = exp_so3(rng.normal(0, 0.0175, (8, 3))) @ scene.T_co.R, scene.T_co.t + rng.normal(0, 0.2, (8, 3))
    s = adjust(problem, R, T, tolerance=1e-10)
    # The bounds; the Newton decrement of 1e-10 alone means 1e-5 standard deviations.
    np.testing.assert_allclose(camera_points(s.R, s.T, s.X), scene.points_c(), atol=1e-6)
    relative, true = s.R @ s.R[0].T, scene.T_co.R @ scene.T_co.R[0].T
    np.testing.assert_allclose(log_so3(relative @ np.swapaxes(true, 1, 2)), 0, atol=1e-8)
    assert s.cost < 1e-6


@pytest.mark.parametrize(("stop", "tolerance"), [("decrement", 1e-12), ("update", 1e-7), ("relative_update", 1e-5)])
def test_every_stop_criterion_ends_at_the_same_optimum(scene: Any, stop: Stop, tolerance: float) -> None:
    problem = make_problem(scene, 0.2)
    start = from_cloud(problem.frame, problem.l, problem.m)
    s = adjust(problem, *start, stop, tolerance)
    best = adjust(problem, *start, "decrement", 1e-14)
    # Below 1e-3 standard deviations of 1 cm and more.
    np.testing.assert_allclose(camera_points(s.R, s.T, s.X), camera_points(best.R, best.T, best.X), atol=1e-5)
    assert s.cost == pytest.approx(best.cost, rel=1e-6)
    # Newton: from centroid and axes a few steps; a loose tolerance ends earlier.
    assert 3 <= s.iterations <= 15
    assert adjust(problem, *start, stop, 100 * tolerance ** (1 / 3)).iterations < s.iterations


def test_a_cloud_laid_over_in_depth_is_another_minimum(scene: Any) -> None:
    """Why several start values are tried: without axes a turning object may end in its reversal, seen by the cost."""
    problem = make_problem(scene, 0.2)
    good = adjust(problem, *from_cloud(problem.frame, problem.l, problem.m))
    reversal = adjust(problem, *from_cloud(problem.frame, problem.l, problem.m, "unrotated"))
    assert good.cost == pytest.approx(redundancy(problem), rel=0.1)  # 4 sigma: 4 sqrt(2 / 3186) = 0.1
    assert reversal.cost > 5 * good.cost


def test_optimum_is_scipy_s(make_scene: Maker) -> None:
    scene = make_scene(points=8, frames=4, distance_m=15.0)
    problem = make_problem(scene, 0.3, some_missing(4, 8), "observed")
    s = adjust(problem, *from_cloud(problem.frame, problem.l, 4, "unrotated"), tolerance=1e-16)
    observed, W = problem.model(problem.l)
    root = np.swapaxes(np.linalg.cholesky(W), 1, 2)

    def residuals(x: Array) -> Array:
        """Frame 0 is the datum: the object frame is the camera frame there."""
        d = np.concatenate([np.zeros((1, 6)), x[:18].reshape(3, 6)])
        Y = np.einsum("kab,kb->ka", exp_so3(d[:, :3])[problem.frame], x[18:].reshape(8, 3)[problem.point])
        return np.asarray(root @ (Y + d[problem.frame, 3:] - observed)[:, :, None]).ravel()

    start = np.zeros(18 + 24)
    start[18:] = (problem.l[[np.flatnonzero(problem.point == i)[0] for i in range(8)]]).ravel()
    result = least_squares(residuals, start, x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=500)
    assert s.cost == pytest.approx(2 * result.cost, rel=1e-9)
    d = result.x[:18].reshape(3, 6)
    # The cost is flat at the optimum: 1e-9 of it means 3e-5 standard deviations, of 1e-3 rad and 0.1 m.
    np.testing.assert_allclose(log_so3(s.R[1:] @ s.R[0].T), d[:, :3], atol=1e-6)
    np.testing.assert_allclose(s.T[1:] - (s.R[1:] @ s.R[0].T @ s.T[0]), d[:, 3:], atol=2e-5)


def test_redundancy_counts_the_datum(make_scene: Maker) -> None:
    """Three frames and four points, all seen: 36 coordinates, 18 + 12 unknowns, 6 of them datum."""
    assert redundancy(make_problem(make_scene(points=4, frames=3))) == 36 - 30 + 6


def functionals(R: Array, T: Array, X: Array, X_0: Array) -> tuple[Array, Array]:
    """Centroid and orientation of the last two frames by definition: the cloud aligned with a fixed one."""
    Q, _ = align(X_0, X)
    return (X.mean(axis=0) @ np.swapaxes(R[-2:], 1, 2) + T[-2:]), R[-2:] @ Q


@pytest.mark.parametrize("missing", [False, True], ids=["all seen", "some missing"])
def test_motion_covariance_is_the_dense_one(small: Any, missing: bool) -> None:
    """Functionals differentiated numerically, one dense pseudo-inverse of all normal equations."""
    m, n, dt, h = 4, 9, 0.04, 1e-6
    problem = make_problem(small, keep=some_missing(m, n) if missing else None)
    _, W = problem.model(problem.l)
    R, T, X = small.T_co.R, small.T_co.t, small.X
    cov = motion_covariance(problem.frame, problem.point, R, X, W, dt)

    def change(x: Array) -> Array:
        d, X_d = x[: 6 * m].reshape(m, 6), X + x[6 * m :].reshape(n, 3)
        c, O = functionals(exp_so3(d[:, :3]) @ R, T + d[:, 3:], X_d, X)
        c_0, O_0 = functionals(R, T, X, X)
        turn = log_so3(O @ np.swapaxes(O_0, 1, 2))
        rate = (log_so3(O[1] @ O[0].T) - log_so3(O_0[1] @ O_0[0].T)) / dt
        return np.concatenate([(c - c_0)[1], turn[1], ((c[1] - c[0]) - (c_0[1] - c_0[0])) / dt, rate])

    size = 6 * m + 3 * n
    F = np.stack([(change(h * e) - change(-h * e)) / (2 * h) for e in np.eye(size)], axis=1)
    J = np.zeros((len(problem.frame), 3, size))
    for k, (t, i) in enumerate(zip(problem.frame, problem.point, strict=True)):
        J[k, :, 6 * t : 6 * t + 6] = design(R[[t]], X[[i]])[0]
        J[k, :, 6 * m + 3 * i : 6 * m + 3 * i + 3] = R[t]
    N = np.einsum("kai,kab,kbj->ij", J, W, J)
    unit = np.sqrt(np.diag(N))
    inverse = np.linalg.pinv(N / np.outer(unit, unit), rcond=1e-10, hermitian=True) / np.outer(unit, unit)
    expected = F @ inverse @ F.T
    sigma = np.sqrt(np.diag(expected))
    # In units of the standard deviations; differences of F to 1e-9 of 1/dt.
    np.testing.assert_allclose(cov / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=1e-6)
    np.testing.assert_array_equal(cov, cov.T)
    assert np.linalg.eigvalsh(cov)[0] > 0


def test_motion_covariance_does_not_depend_on_the_object_frame(small: Any) -> None:
    problem = make_problem(small, keep=some_missing(4, 9))
    _, W = problem.model(problem.l)
    R, X = small.T_co.R, small.X
    cov = motion_covariance(problem.frame, problem.point, R, X, W, 0.04)
    Q = exp_so3(np.array([0.5, -1.2, 2.0]))
    sigma = np.sqrt(np.diag(cov))
    for shift in ([0.0, 0, 0], [10.0, -20, 30]):
        other = motion_covariance(problem.frame, problem.point, R @ Q.T, X @ Q.T + shift, W, 0.04)
        np.testing.assert_allclose(other / np.outer(sigma, sigma), cov / np.outer(sigma, sigma), atol=1e-7)


def test_covariance_shrinks_with_more_frames(make_scene: Maker) -> None:
    def sigmas(frames: int) -> Array:
        scene = make_scene(points=20, frames=10, distance_m=15.0)
        scene = type(scene)(scene.rig, scene.t_s[-frames:], scene.T_co[10 - frames :], scene.X)
        problem = make_problem(scene)
        _, W = problem.model(problem.l)
        cov = motion_covariance(problem.frame, problem.point, scene.T_co.R, scene.X, W, 0.04)
        return np.asarray(np.sqrt(np.diag(cov)))

    three, ten = sigmas(3), sigmas(10)
    # Information only adds; more than tenfold it does not.
    assert (ten <= three * (1 + 1e-9)).all()
    assert (ten > three / 10).all()


@pytest.mark.parametrize("case", ["two points", "collinear", "no overlap"])
def test_what_does_not_determine_the_motion_is_singular(make_scene: Maker, case: str) -> None:
    scene = make_scene(points=2 if case == "two points" else 6, frames=3, distance_m=12.0)
    if case == "collinear":
        line = np.multiply.outer(np.linspace(-1, 1, 6), [0.4, 0.1, 2.0])
        scene = type(scene)(scene.rig, scene.t_s, scene.T_co, line)
    keep = None
    if case == "no overlap":
        keep = np.zeros((3, 6), bool)
        keep[:2, :3], keep[2, 3:] = True, True
    problem = make_problem(scene, keep=keep)

    def estimate() -> None:
        s = adjust(problem, scene.T_co.R, scene.T_co.t)
        motion_covariance(problem.frame, problem.point, s.R, s.X, s.W, 0.04)

    with pytest.raises(SingularSystem):
        estimate()


def test_too_few_iterations_are_no_result(scene: Any) -> None:
    problem = make_problem(scene, 0.2)
    start = from_cloud(problem.frame, problem.l, problem.m, "unrotated")
    with pytest.raises(SingularSystem, match="no convergence within 1 iteration"):
        adjust(problem, *start, max_iterations=1)
