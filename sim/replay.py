"""Replay of real traffic: a KITTI label track, seen from a standing or a moving camera, as motions in a flat world.

Labels are noisy and come at 10 Hz; positions and headings are smoothed over time before they are sampled at the frame
rate. The world is flat: of the labels and of the camera poses x, z and the heading are kept, height and tilt are those
of the rig.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike
from scipy.interpolate import make_smoothing_spline

from sim.archive import freeze_fields
from sim.kitti import LabelTrack
from sim.pose import Pose, vehicle_rotation
from sim.traffic import MARGIN_S, SAMPLE_HZ
from sim.trajectory import Trajectory

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Replay:
    """A label track in the world: the target's and the ego car's motion over [0, end_s], and what the label saw.

    label_t_s (k,) times of the label's rows, occluded (k,) their occlusion 0..3; between rows further apart than
    1.5 label periods the vehicle was not seen.
    """

    target: Trajectory
    ego: Trajectory
    label_t_s: Float[Array, "k"]
    occluded: Int[Array, "k"]
    period_s: float
    end_s: float

    def __post_init__(self) -> None:
        freeze_fields(self)

    def occlusion(self, t_s: Float[Array, "m"]) -> Int[Array, "m"]:
        """Occlusion 0..3 of the nearest label row, or -1 in a gap."""
        nearest = np.argmin(np.abs(np.asarray(t_s)[:, None] - self.label_t_s), axis=1)
        gap = np.abs(self.label_t_s[nearest] - t_s) > 0.75 * self.period_s
        return np.where(gap, -1, self.occluded[nearest])


# Spectral densities of the white second derivatives the smoothing assumes: cars at 1 g at most, gentle ego motion.
_Q_POSITION = 4.0  # m²/s³
_Q_HEADING = 0.1  # rad²/s³
_AWAY_M = 1000.0
_EGO_SIGMA_M, _EGO_SIGMA_RAD = 0.02, np.deg2rad(0.05)


def _smooth(t: Array, values: Array, sigma: float, q: float, at: Array) -> Array:
    """Cubic smoothing spline: the best estimate where the second derivative is white noise of density q."""
    return np.asarray(make_smoothing_spline(t, values, lam=sigma**2 / q)(at))


def _planar(t: Array, xy: Array, heading: Array, sigmas: tuple[float, float], at: Array) -> Trajectory:
    """Smoothed motion in the plane; held beyond its ends by linear extrapolation of the spline."""
    inside = np.clip(at, t[0], t[-1])
    step = 1e-3
    columns = [(xy[:, 0], sigmas[0], _Q_POSITION), (xy[:, 1], sigmas[0], _Q_POSITION), (heading, sigmas[1], _Q_HEADING)]
    smoothed = []
    for values, sigma, q in columns:
        f = _smooth(t, values, sigma, q, inside)
        ends = _smooth(t, values, sigma, q, np.array([t[0], t[0] + step, t[-1] - step, t[-1]]))
        slope = np.where(at < t[0], (ends[1] - ends[0]) / step, (ends[3] - ends[2]) / step)
        smoothed.append(f + slope * (at - inside))
    x, y, psi = smoothed
    return Trajectory(at, Pose(vehicle_rotation(psi), np.stack([x, y, np.zeros_like(x)], axis=1)))


def plan(
    label: LabelTrack,
    camera: Pose | None,
    rear_axle_m: float,
    rate_hz: float,
    sigma_m: float,
    sigma_rad: float,
) -> Replay:
    """Motions of target and ego car from a label track and the camera poses of the whole label file.

    rear_axle_m: distance of the rear axle behind the middle of the vehicle (KITTI locates the middle of the bottom
    face). The world's origin lies below the camera at the track's first frame.

    Raises
        ValueError: there are fewer camera poses than the label's frames.
    """
    first = int(label.frame[0])
    span = np.arange(first, label.frame[-1] + 1)
    t_span, t = (span - first) / rate_hz, (label.frame - first) / rate_hz
    at = _samples(0.0, float(t[-1]))
    ego = _planar(t_span, *_camera_path(camera, span, first), (_EGO_SIGMA_M, _EGO_SIGMA_RAD), at)
    target = _planar(t, *_vehicle_path(label, camera, first, rear_axle_m), (sigma_m, sigma_rad), at)
    return Replay(target, ego, t, label.occluded, 1 / rate_hz, float(t[-1]))


@dataclass(frozen=True, eq=False)
class Visit(Trajectory):
    """A motion that is known, and seen, from ``from_s`` to ``to_s`` only: before and after it the body is out of the
    world, far below the ground."""

    from_s: float
    to_s: float

    def pose(self, t: ArrayLike) -> Pose:
        there = (np.asarray(t) >= self.from_s) & (np.asarray(t) <= self.to_s)
        T = super().pose(np.clip(t, self.from_s, self.to_s))
        return Pose(T.R, T.t - np.where(there, 0.0, _AWAY_M)[..., None] * np.array([0.0, 0.0, 1.0]))


def visit(
    other: LabelTrack,
    label: LabelTrack,
    camera: Pose | None,
    rear_axle_m: float,
    rate_hz: float,
    sigma_m: float,
    sigma_rad: float,
) -> Visit | None:
    """Motion of another track of the same label file in the world that `plan` makes of ``label``; None where it is
    not labelled at any time of that. Its parameters are those of `plan`.

    It is there from half a label period before its first row to half a period after its last one.
    """
    first = int(label.frame[0])
    t = (other.frame - first) / rate_hz
    from_s, to_s = float(t[0] - 0.5 / rate_hz), float(t[-1] + 0.5 / rate_hz)
    if to_s < 0 or from_s > (label.frame[-1] - first) / rate_hz:
        return None
    path = _vehicle_path(other, camera, first, rear_axle_m)
    motion = _planar(t, *path, (sigma_m, sigma_rad), _samples(from_s, to_s))
    return Visit(motion.t_s, motion.T_wb, from_s, to_s)


def _samples(from_s: float, to_s: float) -> Array:
    """Times of a motion's samples over a span and the margin on both sides."""
    h = 1 / SAMPLE_HZ
    return from_s + np.arange(-round(MARGIN_S / h), round((to_s - from_s + MARGIN_S) / h) + 2) * h


def _camera_path(camera: Pose | None, frames: Int[Array, "k"], first: int) -> tuple[Array, Array]:
    """Position (k, 2) and heading (k,) of the camera at frames, in the world of its pose at frame ``first``.

    Raises
        ValueError: there are fewer poses than frames.
    """
    if camera is None:
        return np.zeros((len(frames), 2)), np.zeros(len(frames))
    if len(camera) <= frames[-1]:
        raise ValueError(f"{len(camera)} camera poses, but the label goes to frame {frames[-1]}")
    T = Pose(camera.R[first], camera.t[first]).inv() @ camera[frames]
    return T.t[:, [0, 2]], np.unwrap(np.arctan2(T.R[:, 0, 2], T.R[:, 2, 2]))


def _vehicle_path(label: LabelTrack, camera: Pose | None, first: int, rear_axle_m: float) -> tuple[Array, Array]:
    """Rear axle (k, 2) and heading (k,) of a label, from the unsmoothed camera poses it was made with."""
    ego_xy, ego_heading = _camera_path(camera, label.frame, first)
    c, s = np.cos(ego_heading), np.sin(ego_heading)
    x, z = label.location_c[:, 0], label.location_c[:, 2]
    middle = ego_xy + np.stack([c * x + s * z, -s * x + c * z], axis=1)
    heading = np.unwrap(ego_heading + label.ry + np.pi / 2)  # ry = 0 faces the camera's x
    return middle - rear_axle_m * np.stack([np.sin(heading), np.cos(heading)], axis=1), heading
