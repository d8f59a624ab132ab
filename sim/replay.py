"""Replay of real traffic: a KITTI label track, seen from a standing or a moving camera, as motions in a flat world.

Labels are noisy and come at 10 Hz; positions and headings are smoothed over time before they are sampled at the frame
rate. The world is flat: of the labels and of the camera poses x, z and the heading are kept, height and tilt are those
of the rig.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
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
    if camera is not None and len(camera) <= label.frame[-1]:
        raise ValueError(f"{len(camera)} camera poses, but the label goes to frame {label.frame[-1]}")
    span = np.arange(label.frame[0], label.frame[-1] + 1)
    t_span, t = (span - span[0]) / rate_hz, (label.frame - span[0]) / rate_hz
    h = 1 / SAMPLE_HZ
    at = np.arange(-round(MARGIN_S / h), round((t[-1] + MARGIN_S) / h) + 2) * h
    if camera is None:
        ego_xy, ego_heading = np.zeros((len(span), 2)), np.zeros(len(span))
    else:
        T = Pose(camera.R[span[0]], camera.t[span[0]]).inv() @ camera[span]
        ego_xy, ego_heading = T.t[:, [0, 2]], np.unwrap(np.arctan2(T.R[:, 0, 2], T.R[:, 2, 2]))
    ego = _planar(t_span, ego_xy, ego_heading, (_EGO_SIGMA_M, _EGO_SIGMA_RAD), at)
    # The label's position from the unsmoothed camera pose it was made with; ry = 0 faces the camera's x.
    i = label.frame - span[0]
    c, s = np.cos(ego_heading[i]), np.sin(ego_heading[i])
    x, z = label.location_c[:, 0], label.location_c[:, 2]
    middle = ego_xy[i] + np.stack([c * x + s * z, -s * x + c * z], axis=1)
    heading = np.unwrap(ego_heading[i] + label.ry + np.pi / 2)
    axle = middle - rear_axle_m * np.stack([np.sin(heading), np.cos(heading)], axis=1)
    target = _planar(t, axle, heading, (sigma_m, sigma_rad), at)
    return Replay(target, ego, t, label.occluded, 1 / rate_hz, float(t[-1]))
