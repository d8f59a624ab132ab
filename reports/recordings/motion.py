"""Motions of a recording window by window: of the camera against the scene, or of a vehicle."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from jaxtyping import Float

from estimators.estimate import TrajectoryEstimate, WindowEstimate
from estimators.stereo import vehicle
from reports.recordings.run import RecordingRun
from sim.camera import StereoRig
from sim.pose import Pose, hat, log_so3

Array = np.ndarray
_SLOPE_FRAMES = 2  # before and after, for the slope of a distance measured otherwise
COMMON = ["estimator", "frame", "t_s", "tracks", "rejected", "sigma_0"]


def motions(run: RecordingRun) -> pd.DataFrame:
    """One row per window: `COMMON`, then those of the camera or of the vehicle."""
    rows = []
    for label, estimate in run.windows.items():
        parts = _vehicle(run, estimate) if run.of_vehicle else _camera(run, estimate)
        for window, part in zip(estimate.windows, parts, strict=True):
            k = int(window.frames[-1])
            seen = (label, k, float(run.observations.t_s[k]), len(window.track), len(window.rejected), window.sigma_0)
            rows.append(dict(zip(COMMON, seen, strict=True)) | part)
    return pd.DataFrame(rows)


def _camera(run: RecordingRun, estimate: TrajectoryEstimate) -> Iterator[dict[str, float]]:
    """From the frame before to the newest one, in the camera's axes before: forward, right, down [m], distance [m] and
    rotation [deg] with standard deviations; against measured poses the rotation between them [deg], the length of the
    difference of translations [m], and the factor by which the distance is longer."""
    truth = run.reference.T_wc
    for w in estimate.windows:
        before, now = int(w.frames[-2]), int(w.frames[-1])
        E = w.T_co[-2] @ w.T_co[-1].inv()
        C = camera_covariance(w, float(run.observations.t_s[now] - run.observations.t_s[before]))
        along = E.t / max(float(np.linalg.norm(E.t)), 1e-12)
        row = {
            "forward_m": E.t[2],
            "right_m": E.t[0],
            "down_m": E.t[1],
            "distance_m": float(np.linalg.norm(E.t)),
            "distance_sigma_m": float(np.sqrt(along @ C[:3, :3] @ along)),
            "rotation_deg": float(np.rad2deg(np.linalg.norm(log_so3(E.R)))),
            "rotation_sigma_deg": float(np.rad2deg(np.sqrt(np.trace(C[3:, 3:]) / 3))),
        }
        if truth is not None:
            T = truth[before].inv() @ truth[now]
            row |= {
                "true_distance_m": float(np.linalg.norm(T.t)),
                "true_rotation_deg": float(np.rad2deg(np.linalg.norm(log_so3(T.R)))),
                "rotation_error_deg": float(np.rad2deg(np.linalg.norm(log_so3(E.R @ T.R.T)))),
                "translation_error_m": float(np.linalg.norm(E.t - T.t)),
                "scale": float(np.linalg.norm(E.t) / max(float(np.linalg.norm(T.t)), 1e-12)),
            }
        yield {k: float(v) for k, v in row.items()}


def camera_covariance(w: WindowEstimate, dt_s: float) -> Float[Array, "6 6"]:
    """Covariance of the camera's displacement [m] and rotation [rad] between the last two frames of a window.

    The scene moves against the camera; of its velocity at the centroid c the window states the covariance, and at the
    camera itself it is v - omega x c.
    """
    c = w.T_co[-1].apply(w.X_o).mean(axis=0)
    J = np.block([[np.eye(3), hat(c)], [np.zeros((3, 3)), np.eye(3)]])
    return np.asarray(dt_s**2 * J @ w.cov[6:, 6:] @ J.T)


def _vehicle(run: RecordingRun, estimate: TrajectoryEstimate) -> Iterator[dict[str, float]]:
    """Distance [m] of the points' centroid, its speed over ground or relative [m/s], with standard deviations; beside
    them the distance by block matching in the box, and the speed that its changes and the ego poses give."""
    said = estimate.interpretation
    sigma = vehicle.standard_deviations(said)[0]
    distance, speed = block_matching(run)
    for i, w in enumerate(estimate.windows):
        k = int(w.frames[-1])
        yield {
            "distance_m": float(w.T_co[-1].apply(w.X_o)[:, 2].mean()),
            "distance_sigma_m": float(np.sqrt(w.cov[2, 2])),
            "speed_mps": float(said.within.speed[i]),
            "speed_sigma_mps": float(sigma[i]),
            "matched_distance_m": float(distance[k]),
            "matched_speed_mps": float(speed[k]),
        }


def block_matching(run: RecordingRun) -> tuple[Float[Array, "m"], Float[Array, "m"]]:
    """Distance [m] by the median disparity in the box, and the speed [m/s] of the place this gives the box's middle:
    over ground with ego poses, the slope of a straight line over five frames; NaN where there are too few."""
    rig, t = run.observations.rig, run.observations.t_s
    m = len(t)
    box = run.followed.box if len(run.followed.box) == m else np.full((m, 4), np.nan)
    disparity = run.followed.disparity if len(run.followed.disparity) == m else np.full(m, np.nan)
    distance = _base(rig) / disparity
    place = rig.left.unproject((box[:, :2] + box[:, 2:]) / 2, distance)
    T = run.observations.T_wc or Pose(np.tile(np.eye(3), (m, 1, 1)), np.zeros((m, 3)))
    place = np.einsum("mij,mj->mi", T.R, place) + T.t
    speed = np.full(m, np.nan)
    for k in range(m):
        near = np.arange(max(k - _SLOPE_FRAMES, 0), min(k + _SLOPE_FRAMES + 1, m))
        near = near[np.isfinite(place[near]).all(axis=1)]
        if len(near) > _SLOPE_FRAMES and np.isfinite(place[k]).all():
            speed[k] = float(np.linalg.norm(np.polyfit(t[near] - t[k], place[near], 1)[0]))
    return distance, speed


def _base(rig: StereoRig) -> float:
    """Focal length times base, what a disparity is divided into for a distance [px m]."""
    return float(-rig.left.K[0, 0] * rig.T_rl.t[0])
