"""Rows of metrics.csv of a recording: what its residuals say, and how it compares with measured ego poses."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from estimators.stereo.triangulation import triangulate
from reports.bootstrap import interval
from reports.metrics import as_table, metric_row
from reports.recordings.run import RecordingRun
from reports.statistics import Direction
from sim.observations import Tracks
from sim.streams import stream

Array = np.ndarray
_MAD = 1.4826
# Column of the motions, quantity, unit, direction: medians over the windows with their intervals.
_MEDIANS: tuple[tuple[str, str, str, Direction], ...] = (
    ("sigma_0", "sigma_0", "1", "one"),
    ("tracks", "track", "1", "higher"),
    ("rejected", "outlier", "1", "lower"),
    ("distance_sigma_m", "distance_sigma", "m", "lower"),
    ("rotation_sigma_deg", "rotation_sigma", "deg", "lower"),
    ("speed_sigma_mps", "speed_sigma", "m/s", "lower"),
    ("rotation_error_deg", "rotation_error", "deg", "lower"),
    ("translation_error_m", "translation_error", "m", "lower"),
    ("scale", "scale", "1", "one"),
    ("distance_ratio", "distance_ratio", "1", "one"),
    ("speed_difference_mps", "speed_difference", "m/s", "lower"),
)


def epipolar_errors(run: RecordingRun) -> pd.DataFrame:
    """u, v [px] of every left point and the distance [px] of the right one from its epipolar line, positive below."""
    tracks, rig = run.observations.tracks, run.observations.rig
    point, _ = triangulate(rig, tracks.uv, np.broadcast_to(np.eye(4), (len(tracks), 4, 4)))
    off = tracks.uv - rig.project(point)
    error = off[:, 3] - off[:, 1]
    return pd.DataFrame({"u": tracks.uv_left[:, 0], "v": tracks.uv_left[:, 1], "error_px": error}).dropna()


def recording_metrics(run: RecordingRun, motions: pd.DataFrame) -> pd.DataFrame:
    """All rows, in the columns of metrics.csv."""
    entity = run.observations.entity
    whose = {"scenario": run.name, "seed": 1, "runs": 1, "entity": entity, "estimator": ""}
    rows = [whose | row for row in _epipolar_rows(run)]
    rows += [whose | row for row in _track_rows(run.observations.tracks, len(run.observations.t_s))]
    for label, estimate in run.windows.items():
        part = with_differences(motions[motions["estimator"] == label])
        windows = len(estimate.windows) + len(estimate.failures)
        found = [metric_row("trajectory", "all", "failed", len(estimate.failures), "1", "lower", windows)]
        overlap = max(len(w.frames) for w in estimate.windows)
        found += list(_medians(part, overlap))
        rows += [whose | row | {"estimator": label} for row in found]
    return as_table(rows)


def with_differences(motions: pd.DataFrame) -> pd.DataFrame:
    """The motions with what block matching says beside them, where it does."""
    if "matched_distance_m" not in motions:
        return motions
    ratio = motions["distance_m"] / motions["matched_distance_m"]
    return motions.assign(
        distance_ratio=ratio, speed_difference_mps=(motions["speed_mps"] - motions["matched_speed_mps"]).abs()
    )


def _medians(part: pd.DataFrame, overlap: int) -> Iterator[dict[str, Any]]:
    for column, quantity, unit, direction in _MEDIANS:
        values = part[column].dropna().to_numpy(float) if column in part else np.empty(0)
        if not len(values):
            continue
        rng = stream(0, 0, f"bootstrap/recording/{column}")
        low, high = interval(lambda v: np.median(v[..., 0], axis=-1), values[:, None], overlap, rng)
        row = metric_row(quantity, "all", "median", float(np.median(values)), unit, direction, len(values))
        yield row | {"ci_low": low, "ci_high": high}


def _epipolar_rows(run: RecordingRun) -> Iterator[dict[str, Any]]:
    error = epipolar_errors(run)["error_px"].to_numpy(float)
    if len(error):
        middle = float(np.median(error))
        yield metric_row("epipolar", "all", "median", middle, "px", "zero", len(error))
        spread = _MAD * float(np.median(np.abs(error - middle)))
        yield metric_row("epipolar", "all", "mad", spread, "px", "lower", len(error))


def _track_rows(tracks: Tracks, frames: int) -> Iterator[dict[str, Any]]:
    per_frame = np.bincount(tracks.frame, minlength=frames)
    yield metric_row("track", "all", "per_frame", float(np.median(per_frame)), "1", "higher", frames)
    yield metric_row("track", "all", "fewest", float(per_frame.min()), "1", "higher", frames)
    if len(tracks):
        _, life = np.unique(tracks.track, return_counts=True)
        yield metric_row("track", "all", "life", float(life.mean()), "frame", "higher", len(life))
