"""Pseudo-observations and fixed conditions: derivatives, optima, what they do to motion and covariance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators.stereo.conditions import Conditions, RotationAxis, Smoothing, of_window
from estimators.stereo.depth_bias import observation_model
from estimators.stereo.initial_values import from_cloud
from estimators.stereo.object_motion import Problem, Solution, adjust, motion_covariance, redundancy
from estimators.stereo.triangulation import triangulate
from sim.pose import Pose, exp_so3

Array = np.ndarray
Maker = Callable[..., Any]
UNEVEN_S = np.array([0.0, 0.04, 0.08, 0.16, 0.2, 0.28, 0.32])
FREE, ANY_AXIS = Smoothing(), RotationAxis()
SMOOTHINGS = {
    "velocity": Smoothing("velocity"),
    "velocity and rate": Smoothing("velocity", True),
    "turn": Smoothing("turn", True, "fixed"),
    "rate": Smoothing(rotation=True, weights="fixed"),
}
AXES = {mode: RotationAxis(mode) for mode in ("fixed", "pseudo_observation", "adaptive")}


def random_poses(m: int, seed: int = 0) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    return exp_so3(0.3 * rng.normal(size=(m, 3))), np.array([1.0, 0.5, 20]) + rng.normal(size=(m, 3))


def make_conditions(smoothing: Smoothing, axis: RotationAxis, poses: tuple[Array, Array], ego: bool) -> Conditions:
    rng = np.random.default_rng(3)
    m = len(poses[0])
    T_wc = Pose(exp_so3(0.2 * rng.normal(size=(m, 3))), rng.normal(size=(m, 3))) if ego else None
    conditions = of_window(smoothing, axis, UNEVEN_S[:m], T_wc, poses)[1]
    assert conditions is not None
    return conditions


def moved(R: Array, T: Array, dp: Array) -> tuple[Array, Array]:
    d = dp.reshape(-1, 6)
    return exp_so3(d[:, :3]) @ R, T + d[:, 3:]


def to_problem(scene: Any, sigma_px: float, seed: int = 1) -> Problem:
    o = scene.observe(sigma_px, seed)
    l, C = triangulate(scene.rig, np.concatenate([o.tracks.uv_left, o.tracks.uv_right], axis=1), o.tracks.cov)
    uv_weights = np.linalg.inv(o.tracks.cov)
    model = observation_model(scene.rig, l, C, uv_weights, "estimated", sigma_px > 0)
    return Problem(o.tracks.frame, o.tracks.track, l, model, len(scene.t_s), len(scene.X))


def solved(
    problem: Problem, t_s: Array, smoothing: Smoothing = FREE, axis: RotationAxis = ANY_AXIS
) -> tuple[Solution, Conditions | None]:
    start = from_cloud(problem.frame, problem.l, problem.m, "unrotated")
    start, conditions = of_window(smoothing, axis, t_s, None, start)
    return adjust(problem, *start, tolerance=1e-12, conditions=conditions), conditions


@pytest.mark.parametrize("ego", [False, True])
@pytest.mark.parametrize("smoothing", SMOOTHINGS.values(), ids=SMOOTHINGS)
@pytest.mark.parametrize("axis", ["free", "pseudo_observation"])
def test_derivatives_are_those_of_finite_differences(smoothing: Smoothing, axis: Any, ego: bool) -> None:
    R, T = random_poses(7)
    conditions = make_conditions(smoothing, RotationAxis(axis), (R, T), ego)
    known, h = conditions.pseudo_observations(R, T), 1e-6
    for i in range(42):
        d = np.zeros(42)
        d[i] = h
        e = [conditions.pseudo_observations(*moved(R, T, sign * d)).e for sign in (1, -1)]
        np.testing.assert_allclose((e[0] - e[1]) / (2 * h), known.J[:, i], atol=1e-6 * np.abs(known.J).max())


def screw(t: Array, omega: Array, at: Array) -> tuple[Array, Array]:
    """A constant turn about an axis and a steady rise along it."""
    turn = np.multiply.outer(t, omega)
    R = exp_so3(turn) @ exp_so3(np.array([0.3, -0.2, 0.1]))
    return R, np.einsum("tab,b->ta", exp_so3(turn), at) + turn


@pytest.mark.parametrize("shift", [[0.0, 0, 0], [0.7, -2.0, 1.5]])
def test_a_constant_turn_is_smooth_for_any_object_frame(shift: list[float]) -> None:
    even = np.arange(7) * 0.04
    for t, tolerance in ((even, 1e-9), (UNEVEN_S, 0.8 * 10 * (0.8 * 0.08) ** 2 / 24)):
        R, T = screw(t, np.array([0.1, 0.8, -0.2]), np.array([3.0, 1.0, 9.0]))
        T = T + R @ np.array(shift)
        turn, velocity = (of_window(SMOOTHINGS[s], ANY_AXIS, t, None, (R, T))[1] for s in ("turn", "velocity"))
        assert turn is not None
        assert velocity is not None
        np.testing.assert_allclose(turn.pseudo_observations(R, T).e, 0, atol=tolerance)
        assert np.abs(velocity.pseudo_observations(R, T).e).max() > 0.05


def test_adaptive_weights_are_inverse_second_moments() -> None:
    R, T = random_poses(7)
    smoothing = Smoothing("velocity", gamma=2.5)
    known = make_conditions(smoothing, RotationAxis(), (R, T), False).pseudo_observations(R, T)
    a = (np.diff(T[1:], axis=0) / np.diff(UNEVEN_S)[1:, None]) - (
        np.diff(T[:-1], axis=0) / np.diff(UNEVEN_S)[:-1, None]
    )
    C = a.T @ a / len(a)
    np.testing.assert_allclose(known.e.reshape(-1, 6)[:, :3], a, atol=1e-12)
    np.testing.assert_allclose(np.linalg.inv(known.P[:3, :3]) * 2.5, C + 1e-6 * np.eye(3), rtol=1e-9)
    assert known.count == 3 * len(a)


@pytest.mark.parametrize(
    ("smoothing", "axis"),
    [
        *((s, RotationAxis()) for s in SMOOTHINGS.values()),
        *((Smoothing(), a) for a in AXES.values()),
        (SMOOTHINGS["turn"], AXES["fixed"]),
        (SMOOTHINGS["velocity"], AXES["pseudo_observation"]),
    ],
)
def test_the_optimum_is_stationary(make_scene: Maker, smoothing: Smoothing, axis: RotationAxis) -> None:
    scene = make_scene(points=30, frames=7)
    problem = to_problem(scene, 0.2)
    s, conditions = solved(problem, scene.t_s, smoothing, axis)
    assert conditions is not None

    def cost(dp: Array) -> float:
        R, T = moved(s.R, s.T, dp)
        known = conditions.pseudo_observations(R, T)
        observed, _ = problem.model((s.R[problem.frame] @ s.X[problem.point][:, :, None])[:, :, 0] + s.T[problem.frame])
        v = (R[problem.frame] @ s.X[problem.point][:, :, None])[:, :, 0] + T[problem.frame] - observed
        return float(np.einsum("ka,kab,kb->", v, s.W, v) + known.e @ P @ known.e)

    P = conditions.pseudo_observations(s.R, s.T).P
    free = np.eye(6 * problem.m) if conditions.free is None else conditions.free
    G = conditions.null_space(s.R)
    rng = np.random.default_rng(7)
    for _ in range(5):
        d = free @ rng.normal(size=free.shape[1])
        d -= G @ np.linalg.lstsq(G, d, rcond=None)[0]
        d *= 1e-4 / np.linalg.norm(d)
        slope, bend = (cost(d) - cost(-d)) / 2, (cost(d) + cost(-d)) / 2 - cost(0 * d)
        assert bend > 0
        assert abs(slope) < 1e-3 * bend


def test_fixed_axis_keeps_the_axis_exactly(make_scene: Maker) -> None:
    scene = make_scene(points=30, frames=7)
    s, _ = solved(to_problem(scene, 0.2), scene.t_s, axis=AXES["fixed"])
    up = np.einsum("tba,b->ta", s.R, [0.0, 1, 0])
    np.testing.assert_allclose(up, np.tile(up[0], (7, 1)), atol=1e-12)


def test_tied_frames_keep_their_translations(make_scene: Maker) -> None:
    scene = make_scene(points=30, frames=7)
    problem = to_problem(scene, 0.2)
    start = adjust(problem, *from_cloud(problem.frame, problem.l, problem.m, "unrotated"))
    T = start.T + np.random.default_rng(2).normal(size=(7, 3)) * 0.01
    (R0, T0), conditions = of_window(Smoothing(), RotationAxis(), scene.t_s, None, (start.R, T), tied=3)
    s = adjust(problem, R0, T0, conditions=conditions)
    np.testing.assert_array_equal(s.T[:3], T[:3])
    assert s.cost > start.cost
    assert np.abs(s.T[3:] - T[3:]).min() > 0
    assert redundancy(problem, conditions, (s.R, s.T)) == redundancy(problem) + 9 - 3


@pytest.mark.parametrize("axis", AXES.values(), ids=AXES)
def test_noise_free_motion_is_found_under_conditions_that_hold(make_scene: Maker, axis: RotationAxis) -> None:
    scene = make_scene(points=20, frames=7)
    T_co = Pose(*screw(scene.t_s, np.array([0.0, 0.4, 0.0]), np.array([3.0, 1.0, 15.0])))
    scene = replace(scene, T_co=T_co)
    s, _ = solved(to_problem(scene, 0.0), scene.t_s, SMOOTHINGS["turn"], axis)
    y = np.einsum("tab,nb->tna", s.R, s.X) + s.T[:, None]
    np.testing.assert_allclose(y, scene.points_c(), atol=1e-6)


@pytest.mark.parametrize("axis", AXES.values(), ids=AXES)
def test_covariance_shrinks_with_what_is_known(make_scene: Maker, axis: RotationAxis) -> None:
    scene = make_scene(points=30, frames=7, distance_m=40.0)
    problem = to_problem(scene, 0.2)
    plain, _ = solved(problem, scene.t_s)
    s, conditions = solved(problem, scene.t_s, SMOOTHINGS["turn"], axis)
    arguments = (problem.frame, problem.point, s.R, s.X, s.W, 0.04)
    C, known = motion_covariance(*arguments), motion_covariance(*arguments, s.T, conditions)
    assert np.linalg.eigvalsh(C - known)[0] > -1e-9 * np.linalg.eigvalsh(C)[-1]
    assert np.sqrt(known[8, 8]) < 0.5 * np.sqrt(C[8, 8])
    assert redundancy(problem, conditions, (s.R, s.T)) > redundancy(problem)
    assert s.cost > plain.cost


@pytest.mark.parametrize(
    "arguments", [{"gamma": 0.0}, {"gamma": np.nan}, {"acceleration_mps2": -1.0}, {"tied": -1}], ids=str
)
def test_bad_smoothing_is_refused(arguments: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"smoothing.{next(iter(arguments))}"):
        Smoothing(**arguments)


def test_an_axis_without_direction_is_refused() -> None:
    with pytest.raises(ValueError, match="no direction"):
        RotationAxis("fixed", axis_c=(0.0, 0.0, 0.0))
