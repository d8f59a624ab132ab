"""The bundle adjustment in image space: derivatives by differences, SciPy's optimum, and the Cramer-Rao bound."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from estimators.estimate import TrajectoryEstimate, WindowEstimate
from estimators.gauss_markov import SingularSystem
from estimators.stereo.image_space import ImageProblem, adjust_images
from estimators.stereo.object_motion import Solution, Stop, motion_covariance
from estimators.stereo.sliding_window import SlidingWindowAdjustment
from estimators.stereo.triangulation import information, undistorted
from sim.pose import exp_so3, log_so3

Array = np.ndarray
Maker = Callable[..., Any]


def make_problem(scene: Any, sigma_px: float = 0.0, keep: Array | None = None) -> ImageProblem:
    tracks = scene.observe(sigma_px, 1, keep).tracks
    mix = np.eye(4) + 0.3 * np.random.default_rng(5).normal(size=(4, 4))
    W_uv = np.linalg.inv(mix @ tracks.cov @ mix.T)
    return ImageProblem(scene.rig, tracks.frame, tracks.track, tracks.uv, W_uv, len(scene.t_s), len(scene.X))


def near(scene: Any, seed: int = 0) -> Solution:
    """Start values off by a degree, 5 cm and 2 cm."""
    rng = np.random.default_rng(seed)
    m, n = len(scene.t_s), len(scene.X)
    R = exp_so3(rng.normal(0, 0.0175, (m, 3))) @ scene.T_co.R
    T, X = scene.T_co.t + rng.normal(0, 0.05, (m, 3)), scene.X + rng.normal(0, 0.02, (n, 3))
    return Solution(R, T, X, np.empty((0, 3, 3)), np.nan, 0)


def some_missing(m: int, n: int) -> Array:
    return np.add.outer(np.arange(m), 3 * np.arange(n)) % 4 != 0


@pytest.mark.parametrize("rig", ["normal", "general"])
def test_gradient_and_curvature_of_the_cost(make_scene: Maker, rig: str) -> None:
    """Normal equations in one matrix against differences of the cost; distortion's own curvature is left out."""
    scene = make_scene(points=4, frames=2, distance_m=12.0, rig=rig)
    problem = make_problem(scene, 1.0)
    if rig == "general":
        tracks = scene.observe(1.0, 1).tracks
        ideal, uv, cov = undistorted(scene.rig, tracks.uv, tracks.cov)
        problem = replace(problem, rig=ideal, uv=uv, W_uv=np.linalg.inv(cov))
    R, T, X = scene.T_co.R, scene.T_co.t, scene.X
    blocks = problem.blocks(R, T, X)
    N, b = np.zeros((24, 24)), np.zeros(24)
    for k, (t, i) in enumerate(zip(problem.frame, problem.point, strict=True)):
        p, x = slice(6 * t, 6 * t + 6), slice(12 + 3 * i, 15 + 3 * i)
        N[p, p] += blocks.N_pp[k]
        N[p, x] += blocks.N_pX[k]
        N[x, p] += blocks.N_pX[k].T
        N[x, x] += blocks.N_XX[k]
        b[p] += blocks.b_p[k]
        b[x] += blocks.b_X[k]

    def cost(d: Array) -> float:
        q = d[:12].reshape(2, 6)
        return problem.cost(exp_so3(q[:, :3]) @ R, T + q[:, 3:], X + d[12:].reshape(4, 3))

    unit = np.sqrt(np.diag(N))
    E = np.diag(0.1 / unit)  # a tenth of a standard deviation
    c = np.array([[[cost(u * p + v * q) for u, v in ((1, 1), (1, -1), (-1, 1), (-1, -1))] for q in E] for p in E])
    slope = np.array([cost(e) - cost(-e) for e in E]) / 0.2
    # Third and fourth derivatives over a tenth of a standard deviation.
    np.testing.assert_allclose(b / unit, -slope / 2, atol=1e-4 * np.abs(slope).max())
    hessian = (c[..., 0] - c[..., 1] - c[..., 2] + c[..., 3]) / 0.04
    np.testing.assert_allclose(N / np.outer(unit, unit), hessian / 2, atol=1e-4)


def test_many_frames_held_together_by_short_tracks(make_scene: Maker) -> None:
    """Where Gauss-Newton creeps."""
    scene = make_scene(points=150, frames=30, distance_m=45.0, speed_mps=20.0)
    begin, t = np.arange(150) * 25 // 150, np.arange(30)[:, None]
    o = scene.observe(0.2, keep=(t >= begin) & (t < begin + 6))
    w = window(SlidingWindowAdjustment(window=30, start_window=30, space="image")(o))
    assert w.sigma_0 == pytest.approx(1, abs=4 / np.sqrt(2 * w.redundancy))
    assert w.iterations < 40


@pytest.mark.parametrize("rig", ["normal", "general"])
def test_noise_free_motion_is_recovered(make_scene: Maker, rig: str) -> None:
    scene = make_scene(points=20, frames=6, distance_m=20.0, rig=rig)
    problem = make_problem(scene, keep=some_missing(6, 20))
    s = adjust_images(problem, near(scene), tolerance=1e-10)
    points = np.einsum("mab,nb->mna", s.R, s.X) + s.T[:, None]
    np.testing.assert_allclose(points, scene.points_c(), atol=1e-6)
    relative, true = s.R @ s.R[0].T, scene.T_co.R @ scene.T_co.R[0].T
    np.testing.assert_allclose(log_so3(relative @ np.swapaxes(true, 1, 2)), 0, atol=1e-8)
    assert s.cost < 1e-8


def test_points_improve_to_the_best_for_fixed_poses(make_scene: Maker) -> None:
    scene = make_scene(points=20, frames=6, distance_m=60.0)
    problem = make_problem(scene, 0.5, some_missing(6, 20))
    R, T, X = scene.T_co.R, scene.T_co.t, scene.X
    steps = [X]
    for _ in range(6):
        steps.append(problem.improved_points(R, T, steps[-1]))
    costs = [problem.cost(R, T, x) for x in steps]
    # One step does nearly all of it.
    assert costs[0] - costs[1] > 0.99 * (costs[0] - costs[-1]) > 1
    b_X = np.zeros((20, 3))
    np.add.at(b_X, problem.point, problem.blocks(R, T, steps[-1]).b_X)
    unit = np.sqrt(np.einsum("kaa->ka", problem.blocks(R, T, X).N_XX).max(axis=0))
    assert np.abs(b_X / unit).max() < 1e-6


def test_optimum_is_scipy_s(make_scene: Maker) -> None:
    scene = make_scene(points=8, frames=4, distance_m=15.0)
    problem = make_problem(scene, 0.5, some_missing(4, 8))
    start = near(scene)
    s = adjust_images(problem, start, tolerance=1e-16)
    root = np.swapaxes(np.linalg.cholesky(problem.W_uv), 1, 2)

    def residuals(x: Array) -> Array:
        """The first frame's pose is the datum."""
        d = np.concatenate([np.zeros((1, 6)), x[:18].reshape(3, 6)])
        v = problem.residuals(exp_so3(d[:, :3]) @ start.R, start.T + d[:, 3:], start.X + x[18:].reshape(8, 3))
        return np.asarray(root @ v[:, :, None]).ravel()

    best = least_squares(residuals, np.zeros(18 + 24), x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=500)
    assert s.cost == pytest.approx(2 * best.cost, rel=1e-10)
    assert s.cost == pytest.approx(problem.cost(s.R, s.T, s.X), rel=1e-12)
    d = best.x[:18].reshape(3, 6)
    R = exp_so3(d[:, :3]) @ start.R[1:]
    # The cost is flat at the optimum: 1e-10 of it means 1e-5 standard deviations, of 1e-3 rad.
    np.testing.assert_allclose(log_so3(s.R[1:] @ s.R[0].T @ np.swapaxes(R @ start.R[0].T, 1, 2)), 0, atol=1e-6)


@pytest.mark.parametrize(("stop", "tolerance"), [("decrement", 1e-12), ("update", 1e-8), ("relative_update", 1e-5)])
def test_every_stop_criterion_ends_at_the_same_optimum(make_scene: Maker, stop: Stop, tolerance: float) -> None:
    scene = make_scene(points=20, frames=5)
    problem = make_problem(scene, 0.3)
    s = adjust_images(problem, near(scene), stop, tolerance)
    assert s.cost == pytest.approx(adjust_images(problem, near(scene, 1), "decrement", 1e-15).cost, rel=1e-9)
    assert adjust_images(problem, near(scene), stop, 100 * tolerance ** (1 / 3)).iterations < s.iterations


def test_too_few_iterations_are_no_result(make_scene: Maker) -> None:
    scene = make_scene(points=20, frames=5)
    with pytest.raises(SingularSystem, match="no convergence within 1 iteration"):
        adjust_images(make_problem(scene, 0.3), near(scene), max_iterations=1)


def window(estimate: Any) -> WindowEstimate:
    assert isinstance(estimate, TrajectoryEstimate)
    return estimate.windows[-1]


@pytest.mark.parametrize("rig", ["normal", "general"])
def test_as_a_configuration_of_the_sliding_window(make_scene: Maker, rig: str) -> None:
    scene = make_scene(points=60, frames=10, distance_m=20.0, rig=rig)
    o = scene.observe(0.2)
    config: dict[str, Any] = {"window": 10, "start_window": 10}
    w = window(SlidingWindowAdjustment(space="image", **config)(o))
    triangulated = window(SlidingWindowAdjustment(**config)(o))
    assert w.redundancy == 4 * 600 - 6 * 10 - 3 * 60 + 6
    # Stated and injected sigma agree: 1 within 4 / sqrt(2 * 2166).
    assert w.sigma_0 == pytest.approx(1, abs=4 / np.sqrt(2 * 2166))
    assert w.iterations > triangulated.iterations
    # Nearly the same estimate with nearly the same covariance.
    sigma = np.sqrt(np.diag(w.cov))
    np.testing.assert_allclose(np.sqrt(np.diag(triangulated.cov)), sigma, rtol=0.05)
    shift = (w.T_co[-1].apply(w.X_o) - triangulated.T_co[-1].apply(triangulated.X_o)).mean(axis=0)
    assert np.abs(shift / sigma[:3]).max() < 0.5


@pytest.mark.parametrize("distance_m", [22.0, 40.0])
def test_nothing_unbiased_is_better(make_scene: Maker, distance_m: float) -> None:
    """Errors of position and velocity against the Cramer-Rao bound of the true geometry, and no bias.

    100 pairs of runs with opposite noise: the variance comes from one of each pair, the bias from their means.
    """
    pairs = 100
    scene = make_scene(points=120, frames=10, distance_m=distance_m, speed_mps=20.0)
    estimator = SlidingWindowAdjustment(window=10, start_window=10, initial="principal_axes_xz", space="image")
    dt = scene.t_s[1]
    centre = scene.points_c().mean(axis=1)
    truth = np.concatenate([centre[-1], (centre[-1] - centre[-2]) / dt])

    def error(sigma_px: float, seed: int) -> Array:
        w = window(estimator(scene.observe(sigma_px, seed, stated_px=0.2)))
        p = w.T_co.apply(w.X_o.mean(axis=0))
        return np.concatenate([p[-1], (p[-1] - p[-2]) / dt]) - truth

    e = np.array([[error(0.2, 100 + i), error(-0.2, 100 + i)] for i in range(pairs)])
    frame, point = np.divmod(np.arange(1200), 120)
    J_W = information(scene.rig, scene.points_c().reshape(-1, 3), np.broadcast_to(np.eye(4) / 0.2**2, (1200, 4, 4)))
    bound = np.diag(motion_covariance(frame, point, scene.T_co.R, scene.X, J_W, dt))[[0, 1, 2, 6, 7, 8]]
    # Mean squared errors over position and over velocity; relative scatter sqrt(2 / 100) / 2 = 0.07 of the root.
    mse = (e[:, 0] ** 2).mean(axis=0)
    for part in (slice(0, 3), slice(3, 6)):
        efficiency = np.sqrt(bound[part].sum() / mse[part].sum())
        assert 0.95 - 3 * 0.07 < efficiency < 1 + 3 * 0.07
    mean = e.mean(axis=1)
    bias, scatter = mean.mean(axis=0), mean.std(axis=0) / np.sqrt(pairs)
    assert (np.abs(bias) < 4 * scatter + 0.02 * np.sqrt(bound)).all()
