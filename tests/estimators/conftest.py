"""A rigid cloud of points moving before a stereo rig: known truth, observed with any noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from sim.camera import Camera, StereoRig
from sim.observations import Observations, Tracks
from sim.pose import Pose, exp_so3

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Scene:
    """True poses T_co (m,) of the object, its points X (n, 3) and the rig that sees them at t_s (m,)."""

    rig: StereoRig
    t_s: Array
    T_co: Pose
    X: Array

    def points_c(self) -> Array:
        """True camera coordinates (m, n, 3)."""
        return np.einsum("mab,nb->mna", self.T_co.R, self.X) + self.T_co.t[:, None]

    def observe(
        self,
        sigma_px: float = 0.0,
        seed: int = 0,
        keep: Array | None = None,
        stated_px: float = 0.2,
        T_wc: Pose | None = None,
    ) -> Observations:
        """All points in all frames with Gaussian noise; ``keep`` (m, n) takes some away."""
        m, n = len(self.t_s), len(self.X)
        uv = self.rig.project(self.points_c())
        uv = uv + sigma_px * np.random.default_rng(seed).standard_normal(uv.shape)
        frame, track = np.nonzero(np.ones((m, n), bool) if keep is None else keep)
        cov = np.broadcast_to(np.eye(4) * stated_px**2, (len(frame), 4, 4))
        rows = uv[frame, track]
        return Observations(self.t_s, self.rig, Tracks(frame, track, rows[:, :2], rows[:, 2:], cov), "target", T_wc)


CAMERA = Camera.simple((1024, 768), 1000.0)
RIGS = {
    "normal": StereoRig.normal_case(CAMERA, 0.3),
    "general": StereoRig(
        Camera(
            np.array([[1010.0, 1.5, 500], [0, 990, 390], [0, 0, 1]]), (1024, 768), np.array([-0.1, 0.02, 1e-3, 0, 0])
        ),
        CAMERA,
        Pose(exp_so3(np.array([0.01, -0.04, 0.02])), exp_so3(np.array([0.01, -0.04, 0.02])) @ [-0.3, 0.02, -0.01]),
    ),
}


@pytest.fixture(scope="session")
def rigs() -> dict[str, StereoRig]:
    return RIGS


@pytest.fixture(scope="session")
def make_scene() -> Callable[..., Any]:
    """A car-sized cloud at a distance; by default it comes closer at 10 m/s, turning with 0.3 rad/s to the left."""

    def make(
        points: int = 120,
        frames: int = 10,
        distance_m: float = 20.0,
        speed_mps: float = 10.0,
        yaw_rate: float = 0.3,
        rate_hz: float = 25.0,
        rig: str = "normal",
    ) -> Scene:
        rng = np.random.default_rng(11)
        # On the rear and the left side of a box of 4.4 x 1.7 x 1.4 m, as a camera sees a car; y down.
        X = rng.uniform([-0.85, -0.7, -2.2], [0.85, 0.7, 2.2], (points, 3))
        rear = rng.random(points) < 0.5
        X[rear, 2], X[~rear, 0] = -2.2, -0.85
        t = np.arange(frames) / rate_hz
        # Driving towards the camera; a left turn seen from above is clockwise about the camera's y (down).
        turn = exp_so3(np.multiply.outer(-yaw_rate * t, [0.0, 1.0, 0.0]))
        R = turn @ exp_so3(np.array([0.02, 0.3, -0.01]))
        T = np.array([1.0, 0.5, distance_m]) - np.multiply.outer(speed_mps * t, [0.1, 0.0, 1.0])
        return Scene(RIGS[rig], t, Pose(R, T), X)

    return make


@pytest.fixture(scope="session")
def scene(make_scene: Callable[..., Any]) -> Any:
    return make_scene()
