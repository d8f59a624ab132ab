"""What a window says of the vehicle: signs, frames and the motion of the camera itself."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.estimate import WindowEstimate
from estimators.stereo.vehicle import interpret
from sim.pose import R_WORLD_FROM_LEVEL_CAMERA, Pose, exp_so3, rot_z, vehicle_rotation

Array = np.ndarray


def window(T_wv: Pose, T_wc: Pose, frames: Array) -> WindowEstimate:
    """What a perfect adjustment gives: an object frame of any orientation on the vehicle."""
    T_vo = Pose(exp_so3(np.array([0.4, -1.0, 2.0])), np.array([1.0, 0.3, 0.5]))
    X_v = np.random.default_rng(0).uniform([0, -0.8, 0], [4, 0.8, 1.4], (10, 3))
    T_co = T_wc[frames].inv() @ T_wv[frames] @ T_vo
    return WindowEstimate(frames, T_co, np.arange(10), T_vo.inv().apply(X_v), np.eye(12), 1.0, 10, 3, 1.0)


T_S = np.array([0.0, 0.04, 0.08, 0.20, 0.24])
STANDING = Pose(np.broadcast_to(R_WORLD_FROM_LEVEL_CAMERA, (5, 3, 3)), np.tile([0.0, 0, 1.2], (5, 1)))


def straight(heading_deg: float, speed: float) -> Pose:
    heading = np.deg2rad(heading_deg)
    direction = np.array([np.sin(heading), np.cos(heading), 0])
    R = np.broadcast_to(vehicle_rotation(heading), (5, 3, 3))
    return Pose(R, np.array([2.0, 30, 0]) + speed * np.multiply.outer(T_S, direction))


@pytest.mark.parametrize("heading_deg", [0.0, 30.0, 90.0, 179.0, -135.0])
def test_driving_direction_and_speed(heading_deg: float) -> None:
    """Clockwise from the camera's forward axis; also over an uneven step."""
    T_wv = straight(heading_deg, 12.0)
    i = interpret([window(T_wv, STANDING, f) for f in (np.arange(3), np.arange(4), np.arange(2, 5))], T_S, None)
    np.testing.assert_array_equal(i.frame, [2, 3, 4])
    np.testing.assert_allclose(np.rad2deg(i.heading), heading_deg, atol=1e-9)
    np.testing.assert_allclose(i.speed, 12, atol=1e-9)
    np.testing.assert_allclose(i.yaw_rate, 0, atol=1e-9)
    assert not i.over_ground


@pytest.mark.parametrize("rate", [0.5, -0.5])
def test_yaw_rate_is_positive_to_the_left(rate: float) -> None:
    """A left turn lessens the heading (clockwise); counter-clockwise seen from above."""
    psi = np.deg2rad(160) - rate * T_S
    T_wv = Pose(vehicle_rotation(psi), np.tile([2.0, 30, 0], (5, 1)))
    i = interpret([window(T_wv, STANDING, np.arange(4))], T_S, None)
    assert i.yaw_rate[0] == pytest.approx(rate)


def test_over_ground_the_camera_s_own_motion_is_taken_off() -> None:
    """The camera drives and turns; the vehicle's speed is that over ground at the centroid of its points."""
    R = rot_z(0.6 * T_S) @ R_WORLD_FROM_LEVEL_CAMERA
    T_wc = Pose(R, np.array([0, 0, 1.2]) + np.multiply.outer(T_S, [1.0, 14.0, 0.0]))
    T_wv = straight(-10.0, 9.0)
    w = window(T_wv, T_wc, np.arange(1, 4))
    i = interpret([w], T_S, T_wc)
    assert i.over_ground
    assert i.speed[0] == pytest.approx(9)
    assert np.rad2deg(i.heading[0]) == pytest.approx(-10)
    assert i.yaw_rate[0] == pytest.approx(0, abs=1e-9)
    # Without its poses all is relative to the camera.
    relative = interpret([w], T_S, None)
    assert relative.yaw_rate[0] == pytest.approx(-0.6)
    assert relative.speed[0] != pytest.approx(9, abs=1)


def test_no_windows() -> None:
    i = interpret([], T_S, None)
    assert i.frame.shape == i.heading.shape == i.speed.shape == i.yaw_rate.shape == (0,)
