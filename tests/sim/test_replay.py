"""Replay: a car of known motion, written as a label, comes back from a standing and from a moving camera."""

from __future__ import annotations

import numpy as np
import pytest

from sim.kitti import LabelTrack
from sim.pose import R_WORLD_FROM_LEVEL_CAMERA, Pose, heading_of, rot_z
from sim.replay import Replay, Visit, plan, visit

Array = np.ndarray

REAR_AXLE_M = 1.2
RATE_HZ = 10.0
FIRST = 4
START, VELOCITY, HEADING = np.array([3.0, 12.0]), np.array([4.0, 8.0]), np.arctan2(4.0, 8.0)


def middle(t: Array) -> Array:
    """Middle of the car in the world of the camera's first frame: constant velocity."""
    return START + np.multiply.outer(t, VELOCITY)


def camera_motion(t: Array, speed: float, yaw_rate: float) -> tuple[Array, Array]:
    """Position (x, y) and heading (clockwise) of a camera on a circle, from the origin."""
    psi = -yaw_rate * t
    if yaw_rate == 0:
        return np.stack([np.zeros_like(t), speed * t], axis=-1), psi
    radius = speed / yaw_rate
    return radius * np.stack([np.cos(psi) - 1, -np.sin(psi)], axis=-1), psi


def labelled(frames: Array, speed: float = 0.0, yaw_rate: float = 0.0) -> LabelTrack:
    """The label of the car as a camera would see it: location in camera axes, ry = 0 along the camera's x."""
    t = (frames - frames[0]) / RATE_HZ
    xy, psi = camera_motion(t, speed, yaw_rate)
    d = middle(t) - xy
    c, s = np.cos(psi), np.sin(psi)
    location = np.stack([c * d[:, 0] - s * d[:, 1], np.full(len(t), 1.65), s * d[:, 0] + c * d[:, 1]], axis=-1)
    ry = np.mod(HEADING - psi - np.pi / 2 + np.pi, 2 * np.pi) - np.pi
    return LabelTrack("Car", frames, (4.2, 1.6, 1.5), location, ry, np.zeros(len(t), int))


def camera_poses(count: int, speed: float, yaw_rate: float) -> Pose:
    """KITTI poses of frames 0..count-1 in the camera frame at frame 0; t = 0 of the car is at frame FIRST."""
    t = (np.arange(count) - FIRST) / RATE_HZ
    xy, psi = camera_motion(t, speed, yaw_rate)
    T_wc = Pose(rot_z(-psi) @ R_WORLD_FROM_LEVEL_CAMERA, np.column_stack([xy, np.zeros(count)]))
    return Pose(T_wc.R[0], T_wc.t[0]).inv() @ T_wc


def planned(label: LabelTrack, camera: Pose | None = None) -> Replay:
    return plan(label, camera, REAR_AXLE_M, RATE_HZ, 0.1, np.deg2rad(3.0))


FRAMES = np.arange(FIRST, FIRST + 31)
MOTIONS = {"standing": (0.0, 0.0), "straight": (9.0, 0.0), "turning left": (9.0, 0.3), "turning right": (6.0, -0.4)}


@pytest.mark.parametrize(("speed", "yaw_rate"), MOTIONS.values(), ids=MOTIONS.keys())
def test_constant_velocity_is_recovered(speed: float, yaw_rate: float) -> None:
    camera = None if speed == 0 else camera_poses(40, speed, yaw_rate)
    replay = planned(labelled(FRAMES, speed, yaw_rate), camera)
    t = np.linspace(0, replay.end_s, 61)
    assert replay.end_s == pytest.approx(3.0)
    axle = middle(t) - REAR_AXLE_M * np.array([np.sin(HEADING), np.cos(HEADING)])
    # A smoothing spline leaves a straight line as it is; the label's position is exact: rounding only.
    np.testing.assert_allclose(replay.target.pose(t).t[:, :2], axle, atol=1e-6)
    np.testing.assert_allclose(replay.target.velocity(t), [[4, 8, 0]] * 61, atol=1e-5)
    np.testing.assert_allclose(heading_of(replay.target.pose(t).R), HEADING, atol=1e-7)
    np.testing.assert_allclose(replay.target.angular_rate(t), 0, atol=1e-5)


@pytest.mark.parametrize(("speed", "yaw_rate"), list(MOTIONS.values())[1:], ids=list(MOTIONS.keys())[1:])
def test_the_ego_car_follows_the_camera_poses(speed: float, yaw_rate: float) -> None:
    replay = planned(labelled(FRAMES, speed, yaw_rate), camera_poses(40, speed, yaw_rate))
    t = np.linspace(0.5, replay.end_s - 0.5, 41)
    xy, psi = camera_motion(t, speed, yaw_rate)
    # The ego path is smoothed with lambda = sigma² / q = 1e-4 s³: on a circle of 20 m at 9 m/s the ends, where the
    # spline has no curvature, differ by lambda^(1/2) * a = 3 cm, less inside.
    np.testing.assert_allclose(replay.ego.pose(t).t[:, :2], xy, atol=2e-3)
    np.testing.assert_allclose(heading_of(replay.ego.pose(t).R), psi, atol=1e-4)
    np.testing.assert_allclose(replay.ego.angular_rate(t)[:, 2], yaw_rate, atol=5e-3)


def test_without_poses_the_ego_car_stands() -> None:
    replay = planned(labelled(FRAMES))
    np.testing.assert_allclose(replay.ego.pose(np.array([0.0, 1.5])).t, 0, atol=1e-12)
    np.testing.assert_allclose(replay.ego.velocity(1.0), 0, atol=1e-12)


def test_noise_of_the_labels_is_smoothed() -> None:
    """10 cm of label noise: the spline's band of sqrt(lambda)^(1/2) = 0.22 s averages about eight labels."""
    rng = np.random.default_rng(4)
    label = labelled(np.arange(100))
    noisy = LabelTrack(
        label.kind, label.frame, label.size_m, label.location_c + rng.normal(0, 0.1, (100, 3)), label.ry, label.occluded
    )
    t = label.frame / RATE_HZ
    axle = middle(t) - REAR_AXLE_M * np.array([np.sin(HEADING), np.cos(HEADING)])
    rms = np.sqrt(np.mean((planned(noisy).target.pose(t).t[:, :2] - axle) ** 2))
    assert 0.02 < rms < 0.06  # smoothed, but not frozen
    assert np.abs(planned(noisy).target.acceleration(t)).max() < 15  # second differences of the label: 25 m/s² sigma


def test_gaps_are_known_and_bridged() -> None:
    frames = np.concatenate([np.arange(4, 12), np.arange(17, 25)])
    label = labelled(frames)
    occluded = np.where(frames < 12, 0, 2)
    replay = planned(LabelTrack("Car", frames, label.size_m, label.location_c, label.ry, occluded))
    t = np.arange(21) / RATE_HZ
    # Frames 12..16 (t = 0.8..1.2 s) have no label.
    expected = np.where(t < 0.75, 0, np.where(t < 1.25, -1, 2))
    np.testing.assert_array_equal(replay.occlusion(t), expected)
    axle = middle(t) - REAR_AXLE_M * np.array([np.sin(HEADING), np.cos(HEADING)])
    np.testing.assert_allclose(replay.target.pose(t).t[:, :2], axle, atol=1e-6)


def test_between_labels_there_is_no_gap() -> None:
    """Frames at 25 Hz between labels at 10 Hz take the nearer label's level."""
    label = labelled(FRAMES)
    occluded = np.arange(31) % 4
    replay = planned(LabelTrack("Car", FRAMES, label.size_m, label.location_c, label.ry, occluded))
    t = np.arange(76) / 25
    np.testing.assert_array_equal(replay.occlusion(t[t <= 3.0]), occluded[np.rint(t[t <= 3.0] * 10 - 1e-9).astype(int)])


def test_too_few_camera_poses_are_refused() -> None:
    with pytest.raises(ValueError, match="34 camera poses, but the label goes to frame 34"):
        planned(labelled(FRAMES, 9.0), camera_poses(34, 9.0, 0.0))
    planned(labelled(FRAMES, 9.0), camera_poses(35, 9.0, 0.0))


def visiting(other: LabelTrack, label: LabelTrack, camera: Pose | None = None) -> Visit | None:
    return visit(other, label, camera, REAR_AXLE_M, RATE_HZ, 0.1, np.deg2rad(3.0))


def test_another_track_drives_in_the_same_world() -> None:
    """The very same car, labelled two frames later and for a shorter time, is where it was; and only then."""
    camera = camera_poses(40, 9.0, 0.3)
    xy, psi = camera_motion(np.array([0.2]), 9.0, 0.3)
    late = labelled(FRAMES[2:20], 9.0, 0.3)  # as seen from its own first frame: brought back into the target's world
    back = visiting(late, labelled(FRAMES, 9.0, 0.3), camera)
    assert back is not None
    there = np.linspace(0.2, 1.9, 18)
    c, s = np.cos(psi[0]), np.sin(psi[0])
    path = middle(there - 0.2) @ np.array([[c, s], [-s, c]]).T + xy[0]
    heading = HEADING + psi[0]
    axle = path - REAR_AXLE_M * np.array([np.sin(heading), np.cos(heading)])
    np.testing.assert_allclose(back.pose(there).t[:, :2], axle, atol=1e-6)
    np.testing.assert_allclose(heading_of(back.pose(there).R), heading, atol=1e-7)
    np.testing.assert_array_equal(back.pose(there).t[:, 2], 0)


def test_a_visitor_is_there_for_as_long_as_it_is_labelled() -> None:
    there = visiting(labelled(FRAMES[5:11]), labelled(FRAMES))
    assert there is not None
    t = np.arange(31) / RATE_HZ
    np.testing.assert_array_equal(there.pose(t).t[:, 2] > -1, (t > 0.45) & (t < 1.05))
    assert there.pose(0.0).t[2] < -100
    assert visiting(labelled(FRAMES[-1] + 1 + np.arange(6)), labelled(FRAMES)) is None
    with pytest.raises(ValueError, match="20 camera poses, but the label goes to frame 34"):
        visiting(labelled(FRAMES), labelled(FRAMES[:10]), camera_poses(20, 9.0, 0.0))
