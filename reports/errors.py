"""Truth and estimate side by side: the tidy error table, one row per scalar error."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from estimators.estimate import EstimationFailed, TrajectoryEstimate
from estimators.stereo import vehicle
from reports.consistency import cramer_rao
from reports.windows import AT_REST, WindowComparison, compare_window, inlier_tracks, standard_deviations
from sim.observations import Tracks
from sim.pose import R_WORLD_FROM_LEVEL_CAMERA
from sim.truth import Truth

Array = np.ndarray

ERROR_COLUMNS = ["scenario", "seed", "run", "estimator", "quantity", "unit", "t_s", "entity", "axis", "error", "sigma"]
COMPARISON_COLUMNS = [*ERROR_COLUMNS, "truth", "estimate", "bound", "distance_m"]
UNITS = {
    "position": "m",
    "orientation": "rad",
    "reference_point": "m",
    "velocity": "m/s",
    "angular_rate": "rad/s",
    "speed": "m/s",
    "yaw_rate": "rad/s",
    "centroid_speed": "m/s",
    "driving_direction": "rad",
    "centroid_speed_across": "m/s",
    "driving_direction_across": "rad",
    "yaw_rate_across": "rad/s",
    "shape": "m",
    "failure": "1",
}
SMOOTHED = "smoothed"
_AXES = {3: ("x", "y", "z"), 1: ("all",)}
Row = tuple[str, float, str, str, float, float, float, float, float]


def compare_windows(truth: Truth, tracks: Tracks, estimate: TrajectoryEstimate) -> list[WindowComparison]:
    """Every window that can be compared, in order of its newest frame."""
    found = (compare_window(truth, tracks, w, estimate.T_wc) for w in estimate.windows)
    return [c for c in found if c is not None]


def comparison_table(
    truth: Truth,
    tracks: Tracks,
    estimate: TrajectoryEstimate | EstimationFailed,
    *,
    scenario: str,
    seed: int,
    run: int,
    estimator: str,
    comparisons: list[WindowComparison] | None = None,
) -> pd.DataFrame:
    """The error table with truth, estimate, Cramer-Rao bound (a standard deviation) and true distance of every row.

    Quantities of `UNITS` in axes of the left camera at t. Entity: the target's name for the newest frame of each
    window, "smoothed" for each frame in the window that has it nearest to its middle (position only, without sigma);
    for failures the reason. Velocity, speed and rates are differences of two frames against the truth at the instant t.
    comparisons: those of `compare_windows`, where they have been made already.
    """
    if isinstance(estimate, EstimationFailed):
        rows: list[Row] = [_failure(np.nan, estimate.reason)]
    else:
        name = truth.bodies[truth.target].name
        if comparisons is None:
            comparisons = compare_windows(truth, tracks, estimate)
        compared = {c.frame for c in comparisons}
        rows = [row for c in comparisons for row in _window_rows(truth, tracks, c, name)]
        rows += _interpretation_rows(truth, estimate, comparisons, name)
        rows += _smoothed_rows(truth, tracks, estimate)
        rows += [_failure(float(truth.t_s[f.frame]), f.reason) for f in estimate.failures]
        rows += [
            _failure(float(truth.t_s[w.frames[-1]]), "too few true tracks or frames to compare")
            for w in estimate.windows
            if int(w.frames[-1]) not in compared
        ]
    names = ("quantity", "t_s", "entity", "axis", "sigma", "truth", "estimate", "bound", "distance_m")
    columns: dict[str, Any] = dict(zip(names, zip(*rows, strict=True) if rows else [()] * len(names), strict=True))
    columns |= {"scenario": scenario, "seed": seed, "run": run, "estimator": estimator}
    columns["unit"] = [UNITS[q] for q in columns["quantity"]]
    columns["error"] = np.subtract(columns["estimate"], columns["truth"])
    return pd.DataFrame({c: columns[c] for c in COMPARISON_COLUMNS}, index=range(len(rows)))


def _failure(t_s: float, reason: str) -> Row:
    return ("failure", t_s, reason, "all", np.nan, 0.0, 1.0, np.nan, np.nan)


def _window_rows(truth: Truth, tracks: Tracks, c: WindowComparison, name: str) -> Iterator[Row]:
    e, t = c.estimate, c.truth
    pairs = {
        "position": (e.position, t.position),
        "orientation": (c.orientation, np.zeros(3)),
        "reference_point": (e.reference, t.reference),
        "velocity": (e.velocity, t.velocity),
        "angular_rate": (e.omega, t.omega),
        "speed": (np.array([e.speed]), np.array([t.speed])),
        "yaw_rate": (np.array([e.yaw_rate]), np.array([t.yaw_rate])),
        "shape": (np.array([c.shape_m]), np.zeros(1)),
    }
    sigma = standard_deviations(c.window.cov, e)
    bound = standard_deviations(cramer_rao(truth, tracks, c), t)
    t_s, distance = float(truth.t_s[c.frame]), float(t.position[2])
    for quantity, (estimated, true) in pairs.items():
        unknown = np.full(len(true), np.nan)
        s, b = sigma.get(quantity, unknown), bound.get(quantity, unknown)
        for i, axis in enumerate(_AXES[len(true)]):
            yield (quantity, t_s, name, axis, s[i], true[i], estimated[i], b[i], distance)


def _interpretation_rows(
    truth: Truth, estimate: TrajectoryEstimate, comparisons: list[WindowComparison], name: str
) -> Iterator[Row]:
    """What the estimator itself says of the vehicle, against the true motion of the same points' centroid.

    From the last two frames of a window, and, with the suffix "_across" and without a sigma, from the newest frames of
    consecutive windows; the yaw rate of the first way is that of `_window_rows`. No rows where the estimator gives
    nothing: no direction for what may stand, no motion across for a first window. Speed and course differ from those of
    the reference point where the vehicle turns: the jumps of Siegemund 2008, Fig. 4.1.10, come from that choice alone.
    """
    said = estimate.interpretation
    row_of = {int(frame): k for k, frame in enumerate(said.frame)}
    unknown = np.full(len(said.frame), np.nan)
    ways = (("", said.within, vehicle.standard_deviations(said)), ("_across", said.across, (unknown,) * 3))
    for c, (suffix, motion, sigma) in itertools.product(comparisons, ways):
        k, course = row_of[c.frame], _true_course(truth, c, said.over_ground)
        speed, heading = float(np.linalg.norm(course)), float(np.arctan2(course[0], course[1]))
        turned = float(np.remainder(motion.heading[k] - heading + np.pi, 2 * np.pi) - np.pi)
        pairs = {"centroid_speed": (speed, motion.speed[k], sigma[0][k])}
        if speed > AT_REST:
            pairs["driving_direction"] = (heading, heading + turned, sigma[1][k])
        if suffix:
            pairs["yaw_rate"] = (c.truth.yaw_rate, motion.yaw_rate[k], sigma[2][k])
        t_s, distance = float(truth.t_s[c.frame]), float(c.truth.position[2])
        for quantity, (true, estimated, s) in pairs.items():
            if np.isfinite(estimated):
                yield (quantity + suffix, t_s, name, "all", s, true, float(estimated), np.nan, distance)


def _true_course(truth: Truth, c: WindowComparison, over_ground: bool) -> Array:
    """Velocity of the compared points' centroid in world axes, or relative in those of a level camera."""
    if not over_ground:
        lever = c.truth.position - c.truth.reference
        return np.asarray(R_WORLD_FROM_LEVEL_CAMERA @ (c.truth.velocity + np.cross(c.truth.omega, lever)))
    T_wc = truth.T_wc[c.frame]
    lever = T_wc.R @ (c.truth.position - c.truth.reference)
    return np.asarray(truth.velocity_w[c.frame] + np.cross(truth.omega_w[c.frame], lever))


def _smoothed_rows(truth: Truth, tracks: Tracks, estimate: TrajectoryEstimate) -> Iterator[Row]:
    """Position of every frame in the window that supports it best: the one with the frame nearest to its middle."""
    best: dict[int, tuple[float, int, int]] = {}
    for w, window in enumerate(estimate.windows):
        for k, frame in enumerate(window.frames.tolist()):
            best[frame] = min(best.get(frame, (np.inf, 0, 0)), (abs(k - (len(window.frames) - 1) / 2), w, k))
    good = [inlier_tracks(truth, tracks, w) for w in estimate.windows]
    for frame, (_, w, k) in sorted(best.items()):
        if not good[w].any():
            continue
        window = estimate.windows[w]
        y = window.T_co[k].apply(window.X_o[good[w]]).mean(axis=0)
        p = truth.points_c(np.array([frame]), window.track[good[w]])[0].mean(axis=0)
        for i, axis in enumerate(_AXES[3]):
            yield ("position", float(truth.t_s[frame]), SMOOTHED, axis, np.nan, p[i], y[i], np.nan, p[2])
