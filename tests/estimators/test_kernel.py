"""The compiled loop against its definition: the same adjustment written with whole arrays, and finite differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators.gauss_markov import Spectrum, inverse_spd, normal_blocks, reduce_points, spectrum, sum_by
from estimators.stereo.depth_bias import Weights, observation_model
from estimators.stereo.initial_values import from_cloud, points_by_mean
from estimators.stereo.kernel import (
    FIT,
    LANES,
    Tiles,
    best_points,
    eliminated,
    fill_fixed,
    layout,
    mean_points,
    points_of,
    reduced_system,
    reweight,
    right_side,
    weights_of,
)
from estimators.stereo.object_motion import Problem, adjust, design, null_space
from estimators.stereo.triangulation import triangulate, undistorted
from sim.pose import exp_so3, hat

Array = np.ndarray
Maker = Callable[..., Any]


def make_problem(scene: Any, sigma_px: float, keep: Array | None = None, weights: Weights = "estimated") -> Problem:
    o = scene.observe(sigma_px, 1, keep)
    # Correlated, unequal coordinates: every element of the weights counts.
    mix = np.eye(4) + 0.3 * np.random.default_rng(5).normal(size=(4, 4))
    rig, uv, cov = undistorted(scene.rig, o.tracks.uv, mix @ o.tracks.cov @ mix.T)
    l, C = triangulate(rig, uv, cov)
    model = observation_model(rig, l, C, np.linalg.inv(cov), weights, sigma_px > 0)
    return Problem(o.tracks.frame, o.tracks.track, l, model, len(scene.t_s), len(scene.X))


def ragged(m: int, n: int) -> Array:
    """Tracks of different lives, some with gaps."""
    t, i = np.arange(m)[:, None], np.arange(n)[None, :]
    return (t >= i % (m - 3)) & ((t + i) % 5 != 4) | (t >= m - 2)


def lanes(tiles: Tiles, X: Array) -> Array:
    """Points (n, 3) in the order of the tiles."""
    flat = np.zeros((len(tiles.first), 3, LANES))
    flat[tiles.lane // LANES, :, tiles.lane % LANES] = X
    return flat.ravel()


def camera_points(problem: Problem, R: Array, T: Array, X: Array) -> Array:
    return np.asarray(np.einsum("kab,kb->ka", R[problem.frame], X[problem.point]) + T[problem.frame])


def solve_points(problem: Problem, R: Array, T: Array, observed: Array, W: Array) -> Array:
    """X_i = (sum R'WR)^-1 sum R'W (l - T)."""
    R_k = R[problem.frame]
    N_inv = inverse_spd(sum_by(problem.point, np.swapaxes(R_k, 1, 2) @ W @ R_k, problem.n), "a track")
    b = sum_by(problem.point, np.einsum("kba,kbc,kc->ka", R_k, W, observed - T[problem.frame]), problem.n)
    return np.asarray((N_inv @ b[:, :, None])[:, :, 0])


def cost_of(problem: Problem, R: Array, T: Array, observed: Array, W: Array) -> tuple[float, Array]:
    X = solve_points(problem, R, T, observed, W)
    v = camera_points(problem, R, T, X) - observed
    return float(np.einsum("ka,kab,kb->", v, W, v)), X


def system(problem: Problem, R: Array, T: Array, X: Array, observed: Array, W: Array, newton: bool) -> Any:
    """Reduced matrix, right side and scale; second derivatives g'(dr x (dr x a))/2 + g'(dr x R dX) with g = W v."""
    R_k, a = R[problem.frame], (R[problem.frame] @ X[problem.point][:, :, None])[:, :, 0]
    residual = observed - camera_points(problem, R, T, X)
    blocks = normal_blocks(design(R_k, X[problem.point]), R_k, W, residual)
    scale = np.sqrt(np.einsum("tpp->tp", sum_by(problem.frame, blocks.N_pp, problem.m))).ravel()
    if newton:
        g = -(W @ residual[:, :, None])[:, :, 0]
        ga = g[:, :, None] * a[:, None, :]
        N_pp, N_pX = blocks.N_pp.copy(), blocks.N_pX.copy()
        N_pp[:, :3, :3] += (ga + np.swapaxes(ga, 1, 2)) / 2 - np.sum(g * a, axis=1)[:, None, None] * np.eye(3)
        N_pX[:, :3] -= hat(g) @ R_k
        blocks = replace(blocks, N_pp=N_pp, N_pX=N_pX)
    reduced = reduce_points(problem.frame, problem.point, blocks, problem.m, problem.n)
    return reduced.S, reduced.rhs, scale


def reference(problem: Problem, R: Array, T: Array, tolerance: float) -> tuple[float, Array, Array, Array, int]:
    """`object_motion.adjust` with whole arrays; cost, R, T, X and iterations."""
    X, damping, decrement = points_by_mean(problem, R, T), 0.0, np.inf
    last = Spectrum(np.zeros(1), np.zeros((6 * problem.m, 1)), np.ones(6 * problem.m))
    for iteration in range(1, 51):
        if iteration <= 20:
            observed, W = problem.model(camera_points(problem, R, T, X))
        cost, X = cost_of(problem, R, T, observed, W)
        S, rhs, scale = system(problem, R, T, X, observed, W, decrement < 0.01 * cost)
        kept = damping == 0.0 and decrement < 1.0 and last.values[0] > 0.0 and rhs @ last.solve(rhs) < 0.1 * decrement
        s = last if kept else spectrum(S, scale, null_space(R))
        while True:
            dp = s.solve(rhs, damping).reshape(-1, 6)
            R_new, T_new = exp_so3(dp[:, :3]) @ R, T + dp[:, 3:]
            cost_new, X_new = cost_of(problem, R_new, T_new, observed, W)
            if cost_new <= cost * (1 + 1e-12) + 1e-12:
                break
            damping = max(10 * damping, 1e-6)
        damping = damping / 10 if damping > 1e-7 else 0.0
        R, T, X, last = R_new, T_new, X_new, s
        decrement = rhs @ (s.solve(rhs) if damping == 0.0 else dp.ravel())
        if damping == 0.0 and decrement < tolerance:
            return cost_new, R, T, X, iteration
    raise AssertionError("no convergence")


@pytest.fixture(scope="module", params=["normal", "general"])
def scene(request: pytest.FixtureRequest, make_scene: Maker) -> Any:
    return make_scene(points=37, frames=8, distance_m=15.0, rig=request.param)


@pytest.fixture(scope="module")
def problem(scene: Any) -> Problem:
    return make_problem(scene, 0.5, ragged(8, 37))


def filled(problem: Problem) -> Tiles:
    tiles: Tiles = layout(problem.frame, problem.point, problem.m, problem.n)
    problem.model.fill(tiles)
    return tiles


@pytest.mark.parametrize("n", [1, LANES - 1, LANES, LANES + 1, 100])
def test_every_observation_has_its_own_place_in_the_frame_and_lane_it_belongs_to(n: int) -> None:
    frame, point = np.nonzero(ragged(9, n))
    tiles = layout(frame, point, 9, n)
    assert len(set(tiles.slot.tolist())) == len(frame)
    assert len(set(tiles.lane.tolist())) == n
    cell, tile = tiles.slot // LANES, tiles.lane[point] // LANES
    np.testing.assert_array_equal(tiles.first[tile] + cell - tiles.start[tile], frame)
    assert ((tiles.start[tile] <= cell) & (cell < tiles.start[tile + 1])).all()
    np.testing.assert_array_equal(tiles.slot % LANES, tiles.lane[point] % LANES)
    assert tiles.unused.sum() == len(tiles.unused) - n
    assert (np.diff(tiles.first) >= 0).all()


@pytest.mark.parametrize("second_order", [True, False])
def test_weights_and_correction_follow_the_points_as_defined(scene: Any, problem: Problem, second_order: bool) -> None:
    problem = replace(problem, model=replace(problem.model, second_order=second_order))
    tiles, R, T = filled(problem), np.array(scene.T_co.R), np.array(scene.T_co.t)
    # Some points are lost: behind the cameras, beyond all accuracy, not finite.
    X = scene.X.copy()
    X[3], X[5], X[7] = [0, 0, -30], [0, 0, 3e5], np.nan
    T_rl = problem.model.rig.T_rl
    reweight(tiles, R, T, lanes(tiles, X), T_rl.R, T_rl.t, second_order)
    observed, W = problem.model(camera_points(problem, R, T, X))
    scale = np.sqrt(np.einsum("kaa->ka", W))
    unit = scale[:, :, None] * scale[:, None, :]
    np.testing.assert_allclose(weights_of(tiles) / unit, W / unit, atol=1e-12)
    fit = tiles.fit.reshape(-1, FIT, LANES)[tiles.slot // LANES, :3, tiles.slot % LANES]
    # Bias of centimetres from the inverse of W, whose condition is 1e5.
    np.testing.assert_allclose(fit, observed, atol=1e-10)


@pytest.mark.parametrize("newton", [True, False])
@pytest.mark.parametrize("weights", ["observed", "estimated"])
def test_one_pass_is_the_reduced_system(scene: Any, weights: Weights, newton: bool) -> None:
    problem = make_problem(scene, 0.5, ragged(8, 37), weights)
    rng = np.random.default_rng(3)
    R, T = exp_so3(rng.normal(0, 0.02, (8, 3))) @ scene.T_co.R, scene.T_co.t + rng.normal(0, 0.1, (8, 3))
    observed, W = problem.model(camera_points(problem, R, T, scene.X))
    tiles, T_rl = filled(problem), problem.model.rig.T_rl
    X, factor = lanes(tiles, scene.X), np.empty(len(tiles.unused) * 6)
    if weights == "estimated":
        reweight(tiles, R, T, X, T_rl.R, T_rl.t, True)
    cost = best_points(tiles, R, T, X, factor)
    expected_cost, expected = cost_of(problem, R, T, observed, W)
    assert cost == pytest.approx(expected_cost, rel=1e-11)
    np.testing.assert_allclose(points_of(tiles, X), expected, atol=1e-9)
    S, rhs, scale = reduced_system(tiles, R, T, X, factor, newton)
    S_ref, rhs_ref, scale_ref = system(problem, R, T, expected, observed, W, newton)
    np.testing.assert_allclose(scale, scale_ref, rtol=1e-12)
    np.testing.assert_allclose(S / np.outer(scale, scale), S_ref / np.outer(scale, scale), atol=1e-10)
    np.testing.assert_allclose(rhs, rhs_ref, atol=1e-8 * np.abs(rhs_ref).max())
    np.testing.assert_allclose(right_side(tiles, R, T, X), rhs, atol=1e-12 * np.abs(rhs_ref).max())


def test_functions_of_the_points_where_these_follow_the_poses(scene: Any, problem: Problem) -> None:
    R, X, at_rest = np.array(scene.T_co.R), scene.X, np.zeros((problem.m, 3))
    F = np.random.default_rng(4).normal(size=(len(X), 5, 3))
    Y = camera_points(problem, R, at_rest, X)
    W = problem.model(Y + np.array(scene.T_co.t)[problem.frame])[1]
    tiles = filled(problem)
    factor = np.empty(6 * len(tiles.unused))
    fill_fixed(tiles, Y, W)
    best_points(tiles, R, at_rest, lanes(tiles, X), factor)
    U, UZ = eliminated(tiles, problem.frame, problem.point, R, X, W, factor, F)
    R_k = R[problem.frame]
    blocks = normal_blocks(design(R_k, X[problem.point]), R_k, W, np.zeros_like(Y))
    reduced = reduce_points(problem.frame, problem.point, blocks, problem.m, problem.n)
    expected = np.einsum("nfa,nap->pf", F, reduced.h)
    np.testing.assert_allclose(UZ, expected, atol=1e-9 * np.abs(expected).max())
    variances = np.einsum("nfa,nab,ngb->fg", F, reduced.N_inv, F)
    np.testing.assert_allclose(np.einsum("naf,nag->fg", U, U), variances, atol=1e-9 * np.abs(variances).max())


def test_gradient_and_curvature_of_the_cost(make_scene: Maker) -> None:
    """The reduced system is half the gradient and half the Hessian of the cost over the poses, points re-solved."""
    scene = make_scene(points=9, frames=4, distance_m=12.0, yaw_rate=1.5)
    problem = make_problem(scene, 1.0, ragged(4, 9), "observed")
    tiles, R, T = filled(problem), np.array(scene.T_co.R), np.array(scene.T_co.t)
    X, factor = lanes(tiles, scene.X), np.empty(len(tiles.unused) * 6)

    def cost(dp: Array) -> float:
        d = dp.reshape(4, 6)
        return float(best_points(tiles, exp_so3(d[:, :3]) @ R, T + d[:, 3:], X, factor))

    h = np.tile([1e-4] * 3 + [1e-3] * 3, 4)
    E = np.diag(h)
    c = np.array([[[cost(a * p + b * q) for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))] for q in E] for p in E])
    hessian = (c[..., 0] - c[..., 1] - c[..., 2] + c[..., 3]) / (4 * np.outer(h, h))
    slope = np.array([cost(e) - cost(-e) for e in E]) / (2 * h)
    cost(np.zeros(24))
    S, rhs, _ = reduced_system(tiles, R, T, X, factor, True)
    # In units of the diagonal; truncation h² = 1e-6 relative to curvature, rounding 1e-12 of the cost / h².
    unit = np.sqrt(np.diag(S))
    np.testing.assert_allclose(rhs / unit, -slope / 2 / unit, atol=2e-3)
    np.testing.assert_allclose(S / np.outer(unit, unit), hessian / 2 / np.outer(unit, unit), atol=2e-4)


@pytest.mark.parametrize("weights", ["observed", "averaged", "estimated"])
@pytest.mark.parametrize("distance_m", [12.0, 80.0])
@pytest.mark.parametrize("rig", ["normal", "general"])
def test_the_loop_is_its_definition(make_scene: Maker, rig: str, distance_m: float, weights: Weights) -> None:
    scene = make_scene(points=40, frames=7, distance_m=distance_m, rig=rig)
    problem = make_problem(scene, 0.2, ragged(7, 40), weights)
    start = from_cloud(problem.frame, problem.l, problem.m)
    s = adjust(problem, *start, tolerance=1e-10)
    cost, R, T, X, iterations = reference(problem, *start, tolerance=1e-10)
    assert s.iterations == iterations
    assert s.cost == pytest.approx(cost, rel=1e-9)
    # A decrement of 1e-10 is 1e-5 standard deviations of 1 m at most.
    np.testing.assert_allclose(camera_points(problem, s.R, s.T, s.X), camera_points(problem, R, T, X), atol=1e-5)


def test_mean_points_are_those_of_the_definition(scene: Any, problem: Problem) -> None:
    R, T = np.array(scene.T_co.R), np.array(scene.T_co.t)
    tiles = filled(problem)
    X = points_of(tiles, mean_points(tiles, problem.frame, problem.point, problem.l, R, T))
    np.testing.assert_allclose(X, points_by_mean(problem, R, T), atol=1e-12)


def test_the_start_is_not_touched_and_the_result_is_the_same_again(problem: Problem) -> None:
    R, T = from_cloud(problem.frame, problem.l, problem.m)
    before = R.copy(), T.copy(), problem.l.copy()
    a, b = adjust(problem, R, T), adjust(problem, R, T)
    for now, then in zip((R, T, problem.l), before, strict=True):
        np.testing.assert_array_equal(now, then)
    np.testing.assert_array_equal(a.X, b.X)
    np.testing.assert_array_equal(a.W, b.W)
    assert a.cost == b.cost
