"""What a window says of the vehicle: signs, frames and the motion of the camera itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimators.estimate import TrajectoryEstimate, WindowEstimate
from estimators.stereo.vehicle import (
    ground_jacobian,
    interpret,
    levelled,
    pose_in_ego,
    shape,
    standard_deviations,
)
from sim.pose import R_WORLD_FROM_LEVEL_CAMERA, Pose, exp_so3, log_so3, rot_z, vehicle_rotation

Array = np.ndarray
T_VO = Pose(exp_so3(np.array([0.4, -1.0, 2.0])), np.array([1.0, 0.3, 0.5]))
X_V = np.random.default_rng(0).uniform([0, -0.8, 0], [4, 0.8, 1.4], (10, 3))


def window(T_wv: Pose, T_wc: Pose, frames: Array) -> WindowEstimate:
    """What a perfect adjustment gives: an object frame of any orientation on the vehicle."""
    T_co = T_wc[frames].inv() @ T_wv[frames] @ T_VO
    return WindowEstimate(frames, T_co, np.arange(10), T_VO.inv().apply(X_V), np.eye(12), 1.0, 10, 3, 1.0)


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
    np.testing.assert_allclose(np.rad2deg(i.within.heading), heading_deg, atol=1e-9)
    np.testing.assert_allclose(i.within.speed, 12, atol=1e-9)
    np.testing.assert_allclose(i.within.yaw_rate, 0, atol=1e-9)
    assert not i.over_ground


@pytest.mark.parametrize("rate", [0.5, -0.5])
def test_yaw_rate_is_positive_to_the_left(rate: float) -> None:
    """A left turn lessens the heading (clockwise); counter-clockwise seen from above."""
    psi = np.deg2rad(160) - rate * T_S
    T_wv = Pose(vehicle_rotation(psi), np.tile([2.0, 30, 0], (5, 1)))
    i = interpret([window(T_wv, STANDING, np.arange(4))], T_S, None)
    assert i.within.yaw_rate[0] == pytest.approx(rate)


def test_over_ground_the_camera_s_own_motion_is_taken_off() -> None:
    """The camera drives and turns; the vehicle's speed is that over ground at the centroid of its points."""
    R = rot_z(0.6 * T_S) @ R_WORLD_FROM_LEVEL_CAMERA
    T_wc = Pose(R, np.array([0, 0, 1.2]) + np.multiply.outer(T_S, [1.0, 14.0, 0.0]))
    T_wv = straight(-10.0, 9.0)
    w = window(T_wv, T_wc, np.arange(1, 4))
    i = interpret([w], T_S, T_wc)
    assert i.over_ground
    assert i.within.speed[0] == pytest.approx(9)
    assert np.rad2deg(i.within.heading[0]) == pytest.approx(-10)
    assert i.within.yaw_rate[0] == pytest.approx(0, abs=1e-9)
    # Without its poses all is relative to the camera.
    relative = interpret([w], T_S, None)
    assert relative.within.yaw_rate[0] == pytest.approx(-0.6)
    assert relative.within.speed[0] != pytest.approx(9, abs=1)


def test_no_windows() -> None:
    i = interpret([], T_S, None)
    assert i.frame.shape == i.within.heading.shape == i.across.speed.shape == i.within.yaw_rate.shape == (0,)
    assert i.R_of.shape == (0, 3, 3)


def circling(rate: float) -> Pose:
    """On a circle of 20 m; v's origin, the middle of the rear axle, along its axis x."""
    psi = 0.3 - rate * T_S
    side = np.stack([np.cos(psi), -np.sin(psi), 0 * psi], axis=1)  # to the right of the heading psi
    return Pose(vehicle_rotation(psi), np.array([5.0, 30, 0]) + 20 * np.sign(rate) * side)


WINDOWS = (np.arange(2), np.arange(3), np.arange(1, 4), np.arange(2, 5))


@pytest.mark.parametrize("turned", [False, True], ids=["one datum", "new datum"])
def test_across_windows_by_their_newest_frames(turned: bool) -> None:
    """On exact motion both ways agree, over uneven steps and whatever frame each window has chosen for the object."""
    T_wv = circling(0.6)
    windows = [window(T_wv, STANDING, f) for f in WINDOWS]
    if turned:
        windows[2] = in_frame(windows[2], Pose(exp_so3(np.array([0.5, 1, -2])), np.array([3.0, -1, 4])))
    i = interpret(windows, T_S, None)
    assert np.isnan(i.across.velocity[0]).all()
    np.testing.assert_allclose(i.across.velocity[1:], i.within.velocity[1:], atol=1e-9)
    np.testing.assert_allclose(i.across.omega[1:], i.within.omega[1:], atol=1e-9)
    np.testing.assert_allclose(i.across.heading[1:], i.within.heading[1:], atol=1e-9)


def in_frame(w: WindowEstimate, T_no: Pose) -> WindowEstimate:
    return replace(w, T_co=w.T_co @ T_no.inv(), X_o=T_no.apply(w.X_o))


def test_another_shape_is_no_turn() -> None:
    """A window that sees the points elsewhere, in the same poses: laid on one another, the clouds would turn."""
    windows = [window(circling(0.6), STANDING, f) for f in WINDOWS]
    noise = np.random.default_rng(1).normal(0, 1.0, X_V.shape)
    changed = replace(windows[2], X_o=windows[2].X_o + noise - noise.mean(axis=0))
    before, after = (interpret([*windows[:2], w, windows[3]], T_S, None) for w in (windows[2], changed))
    np.testing.assert_allclose(after.across.omega, before.across.omega, atol=1e-9)
    np.testing.assert_allclose(after.across.velocity, before.across.velocity, atol=1e-9)
    np.testing.assert_allclose(after.R_of, before.R_of, atol=1e-9)


def test_a_missing_window_makes_the_step_across_longer() -> None:
    T_wv = circling(0.6)
    i = interpret([window(T_wv, STANDING, np.arange(3)), window(T_wv, STANDING, np.arange(5))], T_S, None)
    assert i.across.yaw_rate[1] == pytest.approx(0.6)
    centre = T_wv[np.array([2, 4])].apply(X_V.mean(axis=0))
    np.testing.assert_allclose(i.across.velocity[1], (centre[1] - centre[0]) / (T_S[4] - T_S[2]), atol=1e-9)


def test_the_ways_differ_where_windows_correct_each_other() -> None:
    """A window that sees all nearer by 0.1 m moves across by that, within not at all."""
    T_wv = straight(90.0, 10.0)
    windows = [window(T_wv, STANDING, f) for f in WINDOWS]
    nearer = Pose(np.eye(3), np.array([0, 0, -0.1]))
    windows[3] = replace(windows[3], T_co=nearer @ windows[3].T_co)
    i = interpret(windows, T_S, None)
    np.testing.assert_allclose(i.within.velocity, [[10, 0, 0]] * 4, atol=1e-9)
    np.testing.assert_allclose(i.across.velocity[1:3], [[10, 0, 0]] * 2, atol=1e-9)
    np.testing.assert_allclose(i.across.velocity[3], [10, -0.1 / 0.04, 0], atol=1e-9)


def test_windows_without_common_tracks_say_nothing_across() -> None:
    T_wv = straight(90.0, 10.0)
    windows = [window(T_wv, STANDING, f) for f in WINDOWS]
    windows[2] = replace(windows[2], track=windows[2].track + 100)
    i = interpret(windows, T_S, None)
    np.testing.assert_array_equal(np.isnan(i.across.speed), [True, False, True, True])


@pytest.mark.parametrize("rate", [0.6, -0.6])
def test_speed_and_course_are_those_of_the_points(rate: float) -> None:
    """On a circle of 20 m the centroid, some 2 m ahead of the rear axle, drives on its own, its course 0.1 rad off."""
    i = interpret([window(circling(rate), STANDING, f) for f in WINDOWS], T_S, None)
    ahead, inwards = X_V.mean(axis=0)[:2] * [1, np.sign(rate)]
    dt = np.diff(T_S)
    chord = 2 * np.hypot(ahead, 20 - inwards) * np.sin(abs(rate) * dt / 2) / dt
    np.testing.assert_allclose(i.within.speed, chord, atol=1e-9)
    psi = 0.3 - rate * (T_S[1:] + T_S[:-1]) / 2  # of the vehicle, half a step before
    slip = np.arctan2(ahead, 20 - inwards)
    assert slip > 0.08
    np.testing.assert_allclose(i.within.heading, psi - np.sign(rate) * slip, atol=1e-9)


def test_a_turn_about_another_point_is_a_jump_in_speed() -> None:
    """Fig. 4.1.10: the model turns about its middle, what is seen lies behind it and swings aside."""
    rate, middle = 1.5, np.array([2.0, 0, 0])
    psi = -rate * np.clip(T_S - T_S[2], 0, None)
    R = vehicle_rotation(psi)
    T_wv = Pose(R, np.array([0, 30.0, 0]) + np.multiply.outer(T_S, [0, 5.0, 0]) - R @ middle)
    rear = np.array([[-1.0, y, z] for y in (-0.8, 0.8) for z in (0.3, 1.2)])
    windows = [replace(window(T_wv, STANDING, f), track=np.arange(4), X_o=T_VO.inv().apply(rear)) for f in WINDOWS]
    i = interpret(windows, T_S, None)
    np.testing.assert_allclose(i.within.speed[:2], 5, atol=1e-9)
    np.testing.assert_allclose(i.within.heading[:2], 0, atol=1e-9)
    # 3 m behind the middle: 4.5 m/s to the right, along a chord.
    aside = 3 * np.sin(rate * 0.12) / 0.12
    assert i.within.velocity[2, 0] == pytest.approx(aside)
    assert i.within.speed[2] > 6.5


def test_no_direction_without_motion() -> None:
    """Below what the stated covariance can tell from rest: NaN, not the direction of the noise."""
    slow = [window(straight(90.0, speed), STANDING, f) for speed, f in zip((0.0, 3.0, 3.1), WINDOWS, strict=False)]
    i = interpret(slow, T_S, None)  # 1 m/s in each axis: 99 % of the lengths are below 3.03 m/s
    np.testing.assert_array_equal(np.isnan(i.within.heading), [True, True, False])
    np.testing.assert_array_equal(np.isnan(i.R_of_now).all(axis=(1, 2)), [True, True, False])
    np.testing.assert_array_equal(np.isnan(i.R_of).all(axis=(1, 2)), [True, True, False])


def test_vehicle_axes() -> None:
    """x left, y up, z forward, also after the first window's orientation is carried on by the windows' poses."""
    T_wv = circling(0.6)
    windows = [window(T_wv, STANDING, f) for f in WINDOWS]
    windows[2] = in_frame(windows[2], Pose(exp_so3(np.array([0.5, 1, -2])), np.array([3.0, -1, 4])))
    i = interpret(windows, T_S, None)
    for k, w in enumerate(windows):
        R_wo = STANDING.R[0] @ w.T_co.R[-1]
        now = R_wo @ i.R_of_now[k]
        s, c = np.sin(i.within.heading[k]), np.cos(i.within.heading[k])
        np.testing.assert_allclose(now, [[-c, 0, s], [s, 0, c], [0, 1, 0]], atol=1e-12)
        turned = 0.6 * (T_S[k + 1] - T_S[1])
        carried = R_wo @ i.R_of[k]
        np.testing.assert_allclose(
            carried, rot_z(turned) @ STANDING.R[0] @ windows[0].T_co.R[-1] @ i.R_of[0], atol=1e-9
        )
        np.testing.assert_allclose(
            now, carried, atol=0.05
        )  # the step of 0.12 s lags 0.6 * 0.04 rad more than the first


def test_the_orientation_waits_for_motion() -> None:
    """Fixed at the first window that moves; what came before has none."""
    windows = [
        window(straight(90.0, speed), STANDING, f) for speed, f in zip((1.0, 1.0, 8.0, 1.0), WINDOWS, strict=True)
    ]
    i = interpret(windows, T_S, None)
    np.testing.assert_array_equal(np.isnan(i.R_of).all(axis=(1, 2)), [True, True, False, False])
    np.testing.assert_array_equal(np.isnan(i.R_of_now).all(axis=(1, 2)), [True, True, False, True])


def test_place_and_shape_from_our_own_vehicle() -> None:
    """The camera looks 20 degrees to the right and 5 down, rolled by 2; e is level and looks along."""
    R = (
        rot_z(np.deg2rad(-20))
        @ R_WORLD_FROM_LEVEL_CAMERA
        @ exp_so3(np.deg2rad([-5.0, 0, 0]))
        @ exp_so3(np.deg2rad([0, 0, 2.0]))
    )
    T_wc = Pose(np.broadcast_to(R, (5, 3, 3)), np.tile([1.0, -2, 1.3], (5, 1)))
    T_wv = straight(20.0, 12.0)
    w = window(T_wv, T_wc, np.arange(3))
    i = interpret([w], T_S, T_wc)
    T_ec = levelled(T_wc)
    T_ef = pose_in_ego(w, i.R_of[0], T_ec[2])
    np.testing.assert_allclose(T_ef.R, np.eye(3), atol=1e-9)  # both look the same way
    # The vehicle's axes are x forward, y left, z up; f's x left, y up, z forward, its origin that of the object.
    X_f = shape(w, i.R_of[0])
    np.testing.assert_allclose(X_f, (X_V - T_VO.t)[:, [1, 2, 0]], atol=1e-9)
    p_w = T_wv[2].apply(X_V) - T_wc.t[2]
    s, c = np.sin(np.deg2rad(20)), np.cos(np.deg2rad(20))  # heading 20 degrees to the right of +y
    expected = np.stack([-c * p_w[:, 0] + s * p_w[:, 1], p_w[:, 2], s * p_w[:, 0] + c * p_w[:, 1]], axis=1)
    np.testing.assert_allclose(T_ef.apply(X_f), expected, atol=1e-9)


@pytest.mark.parametrize("moving", [False, True])
def test_ground_jacobian_by_finite_differences(moving: bool) -> None:
    R_wc = exp_so3(np.array([[0.1, 0.5, -0.3], [0.15, 0.3, -0.2]])) if moving else STANDING.R[:2]
    t_wc = np.array([[1.0, 2, 3], [1.4, 2.5, 3]]) if moving else np.zeros((2, 3))
    dt, x0 = 0.04, np.concatenate([[2.0, 1, 30], np.zeros(3), [3.0, 0.2, -9], [0.4, -2.0, 0.7]])

    def motion(x: Array) -> Array:
        old, new = R_wc @ np.stack([x[:3] - x[6:9] * dt, x[:3]])[..., None]
        velocity = (new[:, 0] + t_wc[1] - old[:, 0] - t_wc[0]) / dt
        return np.concatenate([velocity, log_so3(R_wc[1] @ exp_so3(x[9:] * dt) @ R_wc[0].T) / dt])

    steps = 1e-6 * np.eye(12)
    numeric = np.stack([(motion(x0 + s) - motion(x0 - s)) / 2e-6 for s in steps], axis=1)
    J = ground_jacobian(R_wc[None], x0[None, 9:] * dt, np.array([dt]))[0]
    np.testing.assert_allclose(J, numeric, atol=1e-6)  # 1e-16 * 30 m / 0.04 s / 1e-6 s of rounding, some times


def test_standard_deviations_by_finite_differences() -> None:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(12, 12))
    w = replace(window(straight(120.0, 12.0), STANDING, np.arange(3)), cov=1e-3 * A @ A.T)
    i = interpret([w], T_S, None)
    v, steps = i.within.velocity[0], 1e-6 * np.eye(3)
    functions: list[Callable[[Array], Any]] = [np.linalg.norm, lambda u: np.arctan2(u[0], u[1])]
    for function, found in zip(functions, standard_deviations(i)[:2], strict=True):
        gradient = np.array([(function(v + s) - function(v - s)) / 2e-6 for s in steps])
        assert found[0] == pytest.approx(np.sqrt(gradient @ i.cov[0, :3, :3] @ gradient), rel=1e-6)
    assert standard_deviations(i)[2][0] == pytest.approx(np.sqrt(i.cov[0, 5, 5]))


def test_archived_and_read_back(tmp_path: Path) -> None:
    windows = tuple(window(circling(0.6), STANDING, f) for f in WINDOWS)
    said = interpret(windows, T_S, STANDING)
    TrajectoryEstimate(T_S, windows, (), said, STANDING, 0.1).save(tmp_path)
    read = TrajectoryEstimate.load(tmp_path).interpretation
    np.testing.assert_array_equal(read.across.velocity, said.across.velocity)
    np.testing.assert_array_equal(read.within.heading, said.within.heading)
    np.testing.assert_array_equal(read.R_of, said.R_of)
    assert read.over_ground is True
