"""Rows of errors.parquet and metrics.csv of a flight."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from estimators.aerial.orthorectification import OrthoImages
from reports.bootstrap import interval
from reports.errors import ERROR_COLUMNS
from reports.flights.boresight import boresight_rows
from reports.flights.errors import CHECK_POINTS, MEASURED, TRUE
from reports.flights.masks import mask_rows
from reports.flights.run import FlightRun
from reports.metrics import as_table, metric_row
from reports.statistics import STATISTICS
from sim.streams import stream

Array = np.ndarray
_ANGLES = ("roll", "pitch", "heading", "omega", "phi", "kappa")
_SHOWN = ("bias", "std", "rms", "p95", "max")


def flight_metrics(
    run: FlightRun,
    poses: pd.DataFrame,
    orthos: Mapping[str, pd.DataFrame],
    matched: Mapping[str, pd.DataFrame],
    covered: Mapping[str, pd.DataFrame],
) -> pd.DataFrame:
    """All rows, in the columns of metrics.csv; orthos, matched, covered by the estimator's label."""
    whose = {"scenario": run.name, "seed": run.seed, "runs": 1, "estimator": ""}
    rows = [*_pose_rows(run, poses), *_vehicle_rows(run), *_map_rows(run)]
    found = [whose | row for row in (*rows, *boresight_rows(run), *mask_rows(run))]
    for label, estimate in run.orthos.items():
        own = [*_ortho_rows(orthos[label], run), *_matched_rows(matched[label]), *_covered_rows(covered[label])]
        own += _made_rows(estimate, len(run.observations))
        found += [whose | {"estimator": label} | row for row in own]
    return as_table(found)


def error_rows(run: FlightRun, poses: pd.DataFrame, orthos: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Every error, in the columns of errors.parquet; angles in degrees. Failed images have rows, too."""
    tables = []
    files = np.array([r.file for r in run.observations.records])
    sigma = _stated(run)
    for axis in (*_ANGLES, "east", "north", "up"):
        is_angle = axis in _ANGLES
        tables.append(
            pd.DataFrame(
                {
                    "quantity": "attitude" if is_angle else "position",
                    "unit": "deg" if is_angle else "m",
                    "t_s": poses["t_s"],
                    "entity": files[poses["image"]],
                    "axis": axis,
                    "error": np.rad2deg(poses[axis]) if is_angle else poses[axis],
                    "sigma": sigma.get(axis, np.nan),
                }
            ).assign(estimator="")
        )
    for label, errors in orthos.items():
        part = errors[errors["orientation"] == MEASURED]
        for axis in "xy":
            columns = {"t_s": part["t_s"], "entity": files[part["image"]], "error": part[f"d{axis}"]}
            fixed = {"quantity": "ortho", "unit": "m", "axis": axis, "sigma": np.nan, "estimator": label}
            tables.append(pd.DataFrame(columns | fixed))
        for failure in run.orthos[label].failures:
            entity = files[failure.frame] if failure.frame >= 0 else ""
            missing = {"quantity": "failure", "unit": "", "t_s": np.nan, "entity": entity, "axis": failure.reason}
            tables.append(pd.DataFrame([missing | {"error": np.nan, "sigma": np.nan, "estimator": label}]))
    return pd.concat(tables).assign(scenario=run.name, seed=run.seed, run=0)[ERROR_COLUMNS]


def _stated(run: FlightRun) -> dict[str, float]:
    """What navigation states of its own errors."""
    n = run.observations.navigation
    angles = dict(zip(("roll", "pitch", "heading"), np.rad2deg(n.sigma_rph).tolist(), strict=True))
    return angles | dict(zip(("east", "north", "up"), n.sigma_position.tolist(), strict=True))


def _pose_rows(run: FlightRun, poses: pd.DataFrame) -> Iterator[dict[str, Any]]:
    block = _largest_burst(run)
    for axis in (*_ANGLES, "east", "north", "up"):
        is_angle = axis in _ANGLES
        values = poses[axis].to_numpy(float)[:, None]
        values = np.rad2deg(values) if is_angle else values
        quantity, unit = ("attitude", "deg") if is_angle else ("position", "m")
        yield from _rows(quantity, axis, values, unit, block, ("bias", "std", "rms", "max"))


def _largest_burst(run: FlightRun) -> int:
    bursts = pd.Series([(r.head, r.line, r.burst) for r in run.observations.records])
    return int(bursts.value_counts().max())


def _rows(
    quantity: str, axis: str, values: Array, unit: str, block: int, statistics: tuple[str, ...] = _SHOWN
) -> Iterator[dict[str, Any]]:
    """Statistics of errors (n, k); neighbours within a block are no independent errors."""
    for name in statistics:
        statistic = STATISTICS[name]
        both = np.concatenate([values, np.zeros_like(values)], axis=1)
        row = metric_row(quantity, axis, name, float(statistic.pool(both)), unit, statistic.direction, len(values))
        if statistic.interval and len(values) >= 2 * block:
            rng = stream(0, 0, f"bootstrap/flight/{quantity}/{axis}/{name}")
            low, high = interval(statistic.pool, both, block, rng)
            row |= {"ci_low": low, "ci_high": high}
        yield row


def _ortho_rows(errors: pd.DataFrame, run: FlightRun) -> Iterator[dict[str, Any]]:
    block = CHECK_POINTS[0] * CHECK_POINTS[1] * _largest_burst(run)
    for orientation in (MEASURED, TRUE):
        part = errors[errors["orientation"] == orientation]
        d = part[["dx", "dy"]].to_numpy(float)
        if not len(d):
            continue
        for axis, columns in (("x", [0]), ("y", [1]), ("all", [0, 1])):
            for row in _rows("ortho", axis, d[:, columns], "m", block):
                yield row | {"entity": orientation}
        pixels = d / part["gsd_m"].to_numpy(float)[:, None]
        for row in _rows("ortho", "all", pixels, "px", block, ("rms", "max")):
            yield row | {"entity": orientation}


def _matched_rows(matched: pd.DataFrame) -> Iterator[dict[str, Any]]:
    if matched.empty:
        return
    off = matched[["dx", "dy"]].to_numpy(float) - matched[["foretold_x", "foretold_y"]].to_numpy(float)
    length = np.hypot(*off.T)
    yield metric_row("ortho_matched", "all", "rms", float(np.sqrt(np.mean(length**2))), "px", "lower", len(off))
    yield metric_row("ortho_matched", "all", "median", float(np.median(length)), "px", "lower", len(off))


def _covered_rows(covered: pd.DataFrame) -> Iterator[dict[str, Any]]:
    if covered.empty:
        return
    for column, entity in (("known", "road map as known"), ("true", "roads as they are")):
        share = covered[column].to_numpy(float)
        row = metric_row("road", "all", "completeness", float(share.mean()), "1", "higher", len(share))
        images = covered.groupby("image")[column].agg(["sum", "count"]).to_numpy(float)
        rng = stream(0, 0, f"bootstrap/flight/covered/{column}")
        low, high = interval(lambda v: v[..., 0].sum(axis=-1) / v[..., 1].sum(axis=-1), images, 1, rng)
        yield row | {"entity": entity, "ci_low": low, "ci_high": high}


def _made_rows(estimate: OrthoImages, images: int) -> Iterator[dict[str, Any]]:
    yield metric_row("ortho", "all", "made", len(estimate.image), "1", "higher", images)
    yield metric_row("ortho", "all", "failed", len(estimate.failures), "1", "lower", images)
    middle = float(np.median(estimate.seconds))
    yield metric_row("runtime", "all", "median", middle, "s", "lower", len(estimate.seconds)) | {"entity": "ortho"}
    written = float(np.median(estimate.written_s))
    yield metric_row("runtime", "all", "median", written, "s", "lower", len(estimate.seconds)) | {"entity": "writing"}


def _vehicle_rows(run: FlightRun) -> Iterator[dict[str, Any]]:
    images = len(run.observations)
    counts = run.vehicles.groupby("image").size().reindex(range(images), fill_value=0)
    yield metric_row("vehicle", "all", "per_image", float(counts.mean()), "1", "higher", images)
    if len(run.vehicles):
        hidden = float((run.vehicles["hidden"] > 0.5).mean())
        yield metric_row("vehicle", "all", "hidden", hidden, "1", "lower", len(run.vehicles))


def _map_rows(run: FlightRun) -> Iterator[dict[str, Any]]:
    errors = run.truth.map_errors
    known = errors.source >= 0
    length = np.hypot(*errors.displacement_m[known].T)
    if len(length):
        yield metric_row("road_map", "all", "mean", float(length.mean()), "m", "lower", len(length))
        yield metric_row("road_map", "all", "max", float(length.max()), "m", "lower", len(length))
    edges = len(run.roads.edges)
    for name, count in (
        ("missing", len(errors.missing)),
        ("outdated", int(np.count_nonzero(~known))),
        ("narrowed", int(np.count_nonzero(errors.narrowed))),
    ):
        yield metric_row("road_map", "all", name, count / edges, "1", "lower", edges)
