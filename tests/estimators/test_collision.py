"""When and how near a moving outline comes, on motions known exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.estimate import WindowEstimate
from estimators.stereo.collision import EgoVehicle, closest_approach, outline
from estimators.stereo.vehicle import level_camera, levelled
from sim.pose import Pose, exp_so3, rot_z

Array = np.ndarray
T_S = np.array([0.0, 0.04, 0.1])
T_EC = levelled(level_camera(3))
EGO = EgoVehicle(length_m=4.0, width_m=2.0, ahead_m=-1.0)  # front 3 m before the camera, rear 1 m behind it
BOX = np.array([[x, y, z] for x in (-1.0, 1) for y in (-1.5, 0) for z in (-2.0, 2)])


def window(R_c: Array, T_c: Array, X: Array = BOX) -> WindowEstimate:
    """Poses in camera axes at T_S, in an object frame of its own."""
    T_vo = Pose(exp_so3(np.array([0.4, -1.0, 2.0])), np.array([1.0, 0.3, 0.5]))
    T_co = Pose(np.broadcast_to(R_c, (3, 3, 3)), T_c) @ T_vo
    n = len(X)
    return WindowEstimate(np.arange(3), T_co, np.arange(n), T_vo.inv().apply(X), 1e-6 * np.eye(12), 1.0, 1, 1, 1.0)


def driving(place: tuple[float, float], velocity: tuple[float, float], turned: float = 0.0) -> WindowEstimate:
    """A box 2 m wide and 4 m long, (x right, z forward) of the camera at the newest frame."""
    path = np.multiply.outer(T_S - T_S[-1], [velocity[0], 0, velocity[1]])
    path += np.array([place[0], 1.0, place[1]])
    return window(exp_so3(np.array([0, turned, 0])), path)


def test_head_on() -> None:
    """Faces 30 - 2 - 3 m apart at 10 m/s."""
    found = closest_approach(driving((0.5, 30), (0, -10)), T_S, T_EC, EGO)
    assert found.collision_s == pytest.approx(2.5)
    assert (found.distance_m, found.time_s) == (0, found.collision_s)


def test_beyond_the_horizon_there_is_no_collision() -> None:
    found = closest_approach(driving((0.5, 30), (0, -10)), T_S, T_EC, EGO, horizon_s=2.0)
    assert found.collision_s == np.inf
    assert found.distance_m == pytest.approx(5.0)
    assert found.time_s == pytest.approx(2.0, abs=1e-6)


@pytest.mark.parametrize("side", [-3.5, 3.5])
def test_passing_by(side: float) -> None:
    """Two half widths of 1 m leave 1.5 m."""
    found = closest_approach(driving((side, 30), (0, -10)), T_S, T_EC, EGO)
    assert found.collision_s == np.inf
    assert found.distance_m == pytest.approx(1.5)
    assert 2.5 <= found.time_s <= 3.3


def test_already_touching() -> None:
    found = closest_approach(driving((0, 4), (0, -10)), T_S, T_EC, EGO)
    assert (found.distance_m, found.time_s, found.collision_s) == (0, 0, 0)


def test_the_camera_s_place_matters() -> None:
    """With the camera at its right side the vehicle reaches 2 m to the left and not at all to the right."""
    ego = EgoVehicle(length_m=4.0, width_m=2.0, left_m=-1.0, ahead_m=-1.0)
    assert closest_approach(driving((2.5, 30), (0, -10)), T_S, T_EC, ego).distance_m == pytest.approx(1.5)
    assert np.isfinite(closest_approach(driving((-2.5, 30), (0, -10)), T_S, T_EC, ego).collision_s)


def test_a_side_meets_our_corner() -> None:
    """Turned by 45 degrees, the corners left and right of the side that hits our corner pass by.

    They are at (2, 30) + (-1, -3) / sqrt(2) and (2, 30) + (-3, -1) / sqrt(2): at x = 1 the side is at 31 - 4 / sqrt(2).
    """
    found = closest_approach(driving((2.0, 30), (0, -10), np.pi / 4), T_S, T_EC, EGO)
    assert found.collision_s == pytest.approx((28 - 4 / np.sqrt(2)) / 10)


POLE, START = np.array([4.0, 0, 25.0]), np.array([9.0, 0.5, 28.0])


def circling(rate: float) -> WindowEstimate:
    """The box on a circle around the pole, about the camera's vertical."""
    turns = exp_so3(np.multiply.outer(rate * (T_S - T_S[-1]), [0.0, 1, 0]))
    return window(turns, turns @ (START - POLE) + POLE)


@pytest.mark.parametrize("rate", [0.5, -0.7])
def test_velocities_on_a_circle(rate: float) -> None:
    """Those of every corner, at right angles to its own radius."""
    shape = outline(circling(rate), T_S, T_EC)
    assert len(shape.corner) == 4
    lever = shape.corner * [-1, 1] - POLE[[0, 2]]  # x to the right
    expected = rate * np.stack([lever[:, 1], -lever[:, 0]], axis=1) * [-1, 1]
    np.testing.assert_allclose(shape.velocity, expected, atol=1e-9)


@pytest.mark.parametrize("ego_at", [(0.0, 0.0), (8.0, -24.0), (3.0, -31.0)])
@pytest.mark.parametrize("rate", [0.5, -0.7])
def test_approach_on_a_circle(rate: float, ego_at: tuple[float, float]) -> None:
    """Against points sampled on the sides of the turning box."""
    ego = EgoVehicle(0.6, 0.4, *ego_at)
    middle = np.array([ego_at[0], -ego_at[1]])  # x to the right
    found = closest_approach(circling(rate), T_S, T_EC, ego)
    corner = (START + np.array([[-1, 0, -2], [1, 0, -2], [1, 0, 2], [-1, 0, 2.0]]))[:, [0, 2]] - POLE[[0, 2]]
    share = np.linspace(0, 1, 401)[:, None, None]
    sides = ((1 - share) * corner + share * np.roll(corner, -1, axis=0)).reshape(-1, 2)
    time_s = np.linspace(0, 5, 1001)
    c, s = np.cos(rate * time_s)[:, None], np.sin(rate * time_s)[:, None]
    x, z = c * sides[:, 0] + s * sides[:, 1] + POLE[0], -s * sides[:, 0] + c * sides[:, 1] + POLE[2]
    beside = np.hypot(
        *(np.clip(np.abs(q - m) - h, 0, None) for q, m, h in zip((x, z), middle, (0.2, 0.3), strict=True))
    )
    distance = beside.min(axis=1)
    # Samples are 1 cm apart on a side and, at 12 m radius, up to 4 cm in time.
    if found.collision_s < np.inf:
        assert time_s[np.argmax(distance == 0)] == pytest.approx(found.collision_s, abs=0.01)
    else:
        assert distance.min() == pytest.approx(found.distance_m, abs=0.01)
        assert time_s[np.argmin(distance)] == pytest.approx(found.time_s, abs=0.05)


def test_a_doubtful_turn_is_none() -> None:
    """0.5 rad/s counts from a standard deviation of 0.5 / 2.575 on; else all corners move as the centroid does."""
    w = circling(0.5)
    for sigma, turns in ((0.193, True), (0.196, False)):
        velocity = outline(replace(w, cov=sigma**2 * np.eye(12)), T_S, T_EC).velocity
        assert (np.ptp(velocity, axis=0).max() > 1) == turns
    centre = w.T_co[-2:].apply(w.X_o.mean(axis=0)[None])
    np.testing.assert_allclose(velocity, [(centre[1] - centre[0])[[0, 2]] / 0.06 * [-1, 1]] * 4, atol=1e-9)


def test_relative_to_a_camera_that_drives_and_turns() -> None:
    """Two vehicles at rest to each other, whatever the motion over ground, stay at their distance."""
    T_wc = Pose(rot_z(0.4 * T_S), np.multiply.outer(T_S, [1.0, 14, 0])) @ level_camera(3)
    found = closest_approach(driving((0, 12), (0, 0)), T_S, levelled(T_wc), EGO)
    assert found.collision_s == np.inf
    assert found.distance_m == pytest.approx(7.0)


def test_outline_of_a_flat_cloud() -> None:
    """Only the rear is seen, all of it in one plane."""
    rear = BOX[BOX[:, 2] < 0]
    path = np.multiply.outer(T_S - T_S[-1], [0, 0, -5.0]) + np.array([0, 1.0, 20])
    shape = outline(window(np.eye(3), path, rear), T_S, T_EC)
    np.testing.assert_allclose(np.sort(shape.corner[:, 0]).round(9), [-1, 1])
    assert closest_approach(window(np.eye(3), path, rear), T_S, T_EC, EGO).collision_s == pytest.approx(3.0)


def test_outline_is_the_hull_in_the_plane() -> None:
    rng = np.random.default_rng(0)
    X = rng.normal(size=(200, 3))
    w = window(exp_so3(np.array([0, 0.3, 0])), np.broadcast_to([0, 0, 20.0], (3, 3)), X)
    shape = outline(w, T_S, T_EC)
    points = T_EC[-1].apply(w.T_co[-1].apply(w.X_o))[:, [0, 2]]
    side = np.roll(shape.corner, -1, axis=0) - shape.corner
    lever = points[:, None] - shape.corner
    inside = side[:, 0] * lever[..., 1] - side[:, 1] * lever[..., 0]
    assert inside.min() > -1e-9  # every point on the same side of every side
    assert np.isclose(inside, 0).sum(axis=0).min() >= 2  # and two corners on each
    np.testing.assert_allclose(shape.velocity, 0, atol=1e-12)
