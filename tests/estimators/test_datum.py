"""The two datums: printed coefficients, finite frames, and covariances carried from one to the other."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from estimators.bordered import BorderedSystem
from estimators.gauss_markov import SingularSystem
from estimators.stereo.conditions import RotationAxis, Smoothing, of_window
from estimators.stereo.datum import (
    choose_three,
    full_null_space,
    in_frame,
    inner_conditions,
    s_transformation,
    three_point_conditions,
    three_point_frame,
)
from estimators.stereo.depth_bias import observation_model
from estimators.stereo.full_system import linearise, weighted
from estimators.stereo.object_motion import Problem, align, motion_covariance
from estimators.stereo.triangulation import triangulate
from sim.pose import log_so3

Array = np.ndarray
Maker = Callable[..., Any]
THREE = np.array([4, 0, 6])


@pytest.fixture(scope="module")
def scene(make_scene: Maker) -> Any:
    return make_scene(points=9, frames=4, distance_m=12.0, yaw_rate=1.5)


@pytest.fixture(scope="module")
def problem(scene: Any) -> Problem:
    o = scene.observe(0.0, 1, np.add.outer(np.arange(4), 3 * np.arange(9)) % 4 != 0)
    l, C = triangulate(scene.rig, o.tracks.uv, o.tracks.cov)
    model = observation_model(scene.rig, l, C, np.linalg.inv(o.tracks.cov), "estimated", False)
    return Problem(o.tracks.frame, o.tracks.track, l, model, 4, 9)


def system(problem: Problem, scene: Any, three: Array | None) -> BorderedSystem:
    state = scene.T_co.R, scene.T_co.t, scene.X
    return linearise(weighted(problem, *state), *state, three)


def padded(H: Array, m: int = 4) -> Array:
    """Conditions on the points as conditions on all unknowns."""
    return np.concatenate([H, np.zeros((6 * m, 6))])


def test_inner_conditions_are_the_printed_ones() -> None:
    (X, Y, Z), other = (2.0, 3.0, 5.0), (-1.0, 0.5, 4.0)
    H = inner_conditions(np.array([other, (X, Y, Z)]))
    printed = [[1, 0, 0, 0, -Z, Y], [0, 1, 0, Z, 0, -X], [0, 0, 1, -Y, X, 0]]
    np.testing.assert_array_equal(H[3:], printed)


def test_three_point_conditions_in_their_own_frame_are_the_printed_ones(scene: Any) -> None:
    X = in_frame(scene.T_co.R, scene.T_co.t, scene.X, *three_point_frame(scene.X, THREE))[2]
    H = three_point_conditions(X, THREE)
    expected = np.zeros((9, 3, 6))
    expected[4, [0, 1, 2], [0, 1, 2]] = expected[0, [1, 2], [3, 4]] = expected[6, 2, 5] = 1
    np.testing.assert_allclose(H, expected.reshape(-1, 6), atol=1e-12)


def test_frame_of_three_points(scene: Any) -> None:
    R, T, X = in_frame(scene.T_co.R, scene.T_co.t, scene.X, *three_point_frame(scene.X, THREE))
    first, second, third = X[THREE]
    np.testing.assert_allclose(first, 0, atol=1e-12)
    np.testing.assert_allclose(second[1:], 0, atol=1e-12)
    assert second[0] > 0
    assert third[2] == pytest.approx(0, abs=1e-12)
    assert third[1] > 0
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-12)
    seen = np.einsum("mab,nb->mna", R, X) + T[:, None]
    np.testing.assert_allclose(seen, scene.points_c(), atol=1e-12)


def within(H: Array, X: Array, seed: int) -> Array:
    """A change of the points that meets conditions, about 1 m."""
    dX = np.random.default_rng(seed).normal(size=X.size)
    return np.asarray((dX - H @ np.linalg.lstsq(H, dX)[0]).reshape(X.shape))


@pytest.mark.parametrize("seed", range(3))
def test_conditions_are_the_derivatives_of_their_frames(scene: Any, seed: int) -> None:
    """A change that meets them leaves the frame to the first order, any other does not."""
    h = 1e-5
    R, T, X = in_frame(scene.T_co.R, scene.T_co.t, scene.X, *three_point_frame(scene.X, THREE))
    frames = {
        "inner": (inner_conditions(X), lambda dX: align(X + h * dX, X)),
        "three": (three_point_conditions(X, THREE), lambda dX: three_point_frame(X + h * dX, THREE)),
    }
    any_change = np.random.default_rng(seed).normal(size=X.shape)
    for H, frame in frames.values():
        for dX, kept in ((within(H, X, seed), True), (any_change, False)):
            Q, s = frame(dX)
            moved = np.concatenate([log_so3(Q), s]) / h
            # Second order: h times changes of 1 over a size of 1 m and more.
            assert (np.abs(moved).max() < 100 * h) == kept
    np.testing.assert_allclose(R @ X[0] + T, scene.points_c()[:, 0], atol=1e-12)


def test_the_triangle_is_wide_and_of_the_points_seen_longest() -> None:
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (30, 3))
    X[::3] *= 10
    count = np.where(np.arange(30) % 3 == 0, 4, 7)  # the wide points are lost earlier
    three = choose_three(np.repeat(np.arange(30), count), X)
    assert (count[three] == 7).all()

    def area(i: Any) -> float:
        return float(np.linalg.norm(np.cross(X[i[1]] - X[i[0]], X[i[2]] - X[i[0]])))

    widest = max(area(c) for c in combinations(np.flatnonzero(count == 7), 3))
    assert area(three) > 0.7 * widest


def test_too_few_long_tracks_are_joined_by_shorter_ones() -> None:
    X = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [0, 0, 3]])
    point = np.repeat(np.arange(5), [6, 6, 6, 5, 4])  # the three longest lie on a line
    assert set(choose_three(point, X).tolist()) == {0, 2, 3}
    with pytest.raises(SingularSystem, match="collinear"):
        choose_three(point, X * [1, 0, 0])
    with pytest.raises(SingularSystem, match="collinear"):
        three_point_frame(X, np.array([0, 1, 2]))


@pytest.mark.parametrize("into", ["inner", "three points"])
def test_covariance_carried_over_is_that_of_the_other_datum(problem: Problem, scene: Any, into: str) -> None:
    inner, three = system(problem, scene, None), system(problem, scene, THREE)
    start, goal = (three, inner) if into == "inner" else (inner, three)
    S = s_transformation(full_null_space(scene.T_co.R, scene.X), goal.H.toarray())
    C, expected = start.eliminate().covariance(), goal.eliminate().covariance()
    scale = np.sqrt(np.diag(C).max())
    np.testing.assert_allclose(S @ C @ S.T / scale**2, expected / scale**2, atol=1e-8)
    # Going there and nowhere: S is a projection, and the datum's own coordinates are certain.
    np.testing.assert_allclose(S @ S, S, atol=1e-9)
    np.testing.assert_allclose(goal.H.T @ expected, 0, atol=1e-7 * scale**2)


def test_conditions_on_the_poses_leave_less_to_carry_over(problem: Problem, scene: Any) -> None:
    """A fixed axis holds two turns of the frame: four directions are left between the datums."""
    state = scene.T_co.R, scene.T_co.t, scene.X
    conditions = of_window(Smoothing(), RotationAxis("fixed"), scene.t_s, None, state[:2])[1]
    assert conditions is not None
    w = weighted(problem, *state, conditions)
    inner, three = linearise(w, *state), linearise(w, *state, THREE)
    G = full_null_space(scene.T_co.R, scene.X) @ conditions.terms.datum
    S = s_transformation(G, three.H[:, three.conditions["datum"]].toarray())
    C, expected = inner.eliminate().covariance(), three.eliminate().covariance()
    assert G.shape[1] == 4
    np.testing.assert_allclose(S @ C @ S.T, expected, atol=1e-8 * np.diag(C).max())


def test_functionals_free_of_the_frame_are_equal_in_both(problem: Problem, scene: Any) -> None:
    R, X, dt = scene.T_co.R, scene.X, 0.04
    inner, three = system(problem, scene, None), system(problem, scene, THREE)
    A = inner.A.toarray()
    first, second = (A @ s.eliminate().covariance() @ A.T for s in (inner, three))
    np.testing.assert_allclose(first, second, atol=1e-8 * np.diag(first).max())
    # The centroid of the last frame, by its own way through the reduced system.
    F = np.zeros((3, A.shape[1]))
    F[:, :27], F[:, 27 + 18 :] = np.tile(R[3] / 9, 9), np.hstack([-hat_of(R[3] @ X.mean(axis=0)), np.eye(3)])
    _, W = problem.model(problem.l)
    expected = motion_covariance(problem.frame, problem.point, R, X, W, dt)[:3, :3]
    for s in (inner, three):
        np.testing.assert_allclose(F @ s.eliminate().covariance() @ F.T, expected, rtol=1e-6)


def hat_of(x: Array) -> Array:
    return np.cross(np.eye(3), x).T @ -np.eye(3)


@pytest.mark.parametrize("seed", range(3))
def test_points_are_most_certain_in_the_inner_datum(problem: Problem, scene: Any, seed: int) -> None:
    """Its trace over the points is the least of all datums'."""
    C = system(problem, scene, None).eliminate().covariance()
    rng = np.random.default_rng(seed)
    near = inner_conditions(scene.X) + 0.05 * rng.normal(size=(27, 6))
    G = full_null_space(scene.T_co.R, scene.X)
    for H in (three_point_conditions(scene.X, THREE), rng.normal(size=(27, 6)), near):
        S = s_transformation(G, padded(H))
        assert np.trace((S @ C @ S.T)[:27, :27]) > np.trace(C[:27, :27])


def test_conditions_that_fix_nothing_are_refused(scene: Any) -> None:
    G = full_null_space(scene.T_co.R, scene.X)
    H = inner_conditions(scene.X)
    H[:, 5] = H[:, 0]
    with pytest.raises(SingularSystem, match="do not fix"):
        s_transformation(G, padded(H))
