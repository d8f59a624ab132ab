"""A small world whose estimate is known exactly: a box of points on a straight path towards the camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from estimators.estimate import Failure, TrajectoryEstimate, WindowEstimate
from estimators.stereo.object_motion import motion_covariance
from estimators.stereo.vehicle import interpret
from sim.camera import Camera, StereoRig
from sim.observations import Observations, Tracks
from sim.pose import R_WORLD_FROM_LEVEL_CAMERA, Pose, exp_so3, vehicle_rotation
from sim.truth import Body, Labels, Truth

RATE_HZ, SPEED, SIGMA_PX, WINDOW, FRAMES, POINTS = 25.0, 10.0, 0.2, 10, 40, 24
Q, S = exp_so3(np.array([0.4, -0.9, 1.3])), np.array([2.0, -1.0, 5.0])


@dataclass(frozen=True, eq=False)
class World:
    """Truth, its observations without noise, and an estimate that equals the truth."""

    truth: Truth
    observations: Observations
    estimate: TrajectoryEstimate

    @property
    def tracks(self) -> Tracks:
        return self.observations.tracks

    def moved(self, change_c: Pose) -> TrajectoryEstimate:
        """The estimate with every pose changed in the camera frame."""
        return self.with_windows(lambda w: replace(w, T_co=change_c @ w.T_co))

    def with_windows(self, change: Callable[[WindowEstimate], WindowEstimate]) -> TrajectoryEstimate:
        return replace(self.estimate, windows=tuple(change(w) for w in self.estimate.windows))


def _drive(t_s: np.ndarray, speed: float, yaw_rate: float, heading: float) -> tuple[np.ndarray, ...]:
    """Heading, path and velocity at constant speed and rate, from the origin."""
    h = heading - yaw_rate * t_s
    velocity = speed * np.stack([np.sin(h), np.cos(h), 0 * h], axis=1)
    path = velocity * t_s[:, None]
    if yaw_rate:
        path = speed / yaw_rate * np.stack([np.cos(h), -np.sin(h), 0 * h], axis=1)
    return h, path - path[0], velocity


def make_truth(yaw_rate: float, ego_speed: float, ego_yaw_rate: float) -> Truth:
    """A car of 4 x 1.7 x 1.4 m from 40 m, oncoming at 10 m/s."""
    t_s = np.arange(FRAMES) / RATE_HZ
    heading, path, velocity_w = _drive(t_s, SPEED, yaw_rate, np.pi)
    T_wv = Pose(vehicle_rotation(heading), path + np.array([-2.0, 40.0, 0]))
    ego_heading, ego_path, ego_velocity = _drive(t_s, ego_speed, ego_yaw_rate, 0.0)
    R_wc = vehicle_rotation(ego_heading) @ vehicle_rotation(0.0).T @ R_WORLD_FROM_LEVEL_CAMERA
    T_wc = Pose(R_wc, ego_path + np.array([0, 0, 1.0]))
    rng = np.random.default_rng(5)
    corners = np.array([[-0.9, -0.85, 0], [3.1, 0.85, 1.4]])
    point_v = rng.uniform(*corners, (POINTS, 3))
    rig = StereoRig.normal_case(Camera.simple((1024, 768), 1000.0), 0.3)
    up = np.array([0, 0, 1.0])
    uv = rig.project((T_wc.inv() @ T_wv)[np.repeat(np.arange(FRAMES), POINTS)].apply(np.tile(point_v, (FRAMES, 1))))
    labels = Labels(np.zeros(len(uv), int), uv, np.full(len(uv), SIGMA_PX), ("noise",))
    return Truth(
        t_s=t_s,
        rig=rig,
        T_wc=T_wc,
        ego_velocity_w=ego_velocity,
        ego_omega_w=np.tile(ego_yaw_rate * up, (FRAMES, 1)),
        bodies=(Body("target", T_wv, corners, _outline(corners)),),
        target=0,
        velocity_w=velocity_w,
        omega_w=np.tile(yaw_rate * up, (FRAMES, 1)),
        reference_v=np.zeros(3),
        track=np.arange(POINTS),
        point_v=point_v,
        labels=labels,
        visible_points=np.full(FRAMES, 40),
    )


def _outline(corners: np.ndarray) -> np.ndarray:
    grid = np.meshgrid(*np.linspace(corners[0], corners[1], 5).T, indexing="ij")
    return np.stack(grid, axis=-1).reshape(-1, 3)


def make_observations(truth: Truth, T_wc: Pose | None = None) -> Observations:
    frame, track = np.repeat(np.arange(FRAMES), POINTS), np.tile(np.arange(POINTS), FRAMES)
    cov = np.tile(SIGMA_PX**2 * np.eye(4), (len(frame), 1, 1))
    uv = truth.labels.uv_true
    return Observations(truth.t_s, truth.rig, Tracks(frame, track, uv[:, :2], uv[:, 2:], cov), "target", T_wc)


def true_window(truth: Truth, last: int, Q: np.ndarray = Q, s: np.ndarray = S) -> WindowEstimate:
    """The truth as a window, in an object frame of its own: X = Q p_v + s."""
    frames = np.arange(max(0, last - WINDOW + 1), last + 1)
    T_co = truth.T_cv[frames] @ Pose(Q, s).inv()
    m = len(frames)
    frame, point = np.repeat(np.arange(m), POINTS), np.tile(np.arange(POINTS), m)
    J = truth.rig.project_jacobian(truth.points_c(frames, truth.track).reshape(-1, 3))
    W = np.swapaxes(J, 1, 2) @ J / SIGMA_PX**2
    cov = motion_covariance(frame, point, truth.T_cv.R[frames], truth.point_v, W, 1 / RATE_HZ)
    return WindowEstimate(frames, T_co, truth.track, truth.point_v @ Q.T + s, cov, 1.0, 100, 3, 100.0)


def make_estimate(truth: Truth, T_wc: Pose | None = None, failures: tuple[Failure, ...] = ()) -> TrajectoryEstimate:
    failed = {f.frame for f in failures}
    windows = tuple(true_window(truth, t) for t in range(2, FRAMES) if t not in failed)
    return TrajectoryEstimate(truth.t_s, windows, failures, interpret(windows, truth.t_s, T_wc), T_wc, 0.5)


def make_world(
    yaw_rate: float = 0.0,
    ego_speed: float = 0.0,
    ego_yaw_rate: float = 0.0,
    ego_poses: bool = False,
    failures: tuple[Failure, ...] = (),
) -> World:
    truth = make_truth(yaw_rate, ego_speed, ego_yaw_rate)
    T_wc = truth.T_wc if ego_poses else None
    return World(truth, make_observations(truth, T_wc), make_estimate(truth, T_wc, failures))


@pytest.fixture(scope="session")
def world() -> World:
    return make_world()


@pytest.fixture(scope="session")
def build_world() -> Callable[..., World]:
    return make_world


@pytest.fixture
def keys() -> dict[str, Any]:
    return {"scenario": "box", "seed": 1, "run": 0, "estimator": "known"}
