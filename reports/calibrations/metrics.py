"""Rows of metrics.csv of a calibration."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import chi2

from estimators.aerial.boresight_result import BoresightResult
from reports.calibrations.run import CalibrationRun
from reports.calibrations.tables import ANGLES, errors_deg, in_shown_units
from reports.metrics import as_table, metric_row

Array = np.ndarray
_BAND = (0.005, 0.995)
# Beginnings of the reasons for which clicks and images are left out.
_REASONS = ("not among the images", "outside its image", "no clicks in it")


def calibration_metrics(run: CalibrationRun) -> pd.DataFrame:
    """All rows, in the columns of metrics.csv."""
    whose = {"scenario": run.name, "seed": 1, "runs": 1, "estimator": ""}
    rows = [whose | row for row in _excluded_rows(run)]
    for label, r in run.results.items():
        found = [*_unknown_rows(r), *_error_rows(run, r), *_fit_rows(run, r), *_image_rows(run, r)]
        rows += [whose | row | {"estimator": label} for row in found]
    return as_table(rows)


def _excluded_rows(run: CalibrationRun) -> Iterator[dict[str, Any]]:
    clicks = len(run.observations.points) + len(run.observations.excluded)
    for reason, count in Counter(_kind(line) for line in run.observations.excluded).items():
        yield metric_row("excluded", "all", "sum", count, "1", "lower", clicks) | {"entity": reason}


def _kind(line: str) -> str:
    return next((reason for reason in _REASONS if reason in line), "outside its image")


def _unknown_rows(r: BoresightResult) -> Iterator[dict[str, Any]]:
    """What was found, which has no direction, and its standard deviation."""
    n = int(np.count_nonzero(r.used))
    for name, x, sigma in zip(r.names, r.x, r.sigma, strict=True):
        factor, unit = in_shown_units(name)
        quantity, axis = ("boresight", name) if name in ANGLES else _named(name)
        yield metric_row(quantity, axis, "estimate", x * factor, unit, "zero", n) | {"direction": ""}
        yield metric_row(quantity, axis, "sigma", sigma * factor, unit, "lower", n)


def _named(name: str) -> tuple[str, str]:
    if name == "time_offset":
        return name, "all"
    quantity, _, axis = name.partition("_")
    return f"{quantity}_arm" if quantity == "lever" else f"{quantity}_offset", axis


def _error_rows(run: CalibrationRun, r: BoresightResult) -> Iterator[dict[str, Any]]:
    """Differences from the reference, and their square by the inverse covariance with its 99 % band."""
    if run.reference_deg is None:
        return
    error = errors_deg(np.rad2deg(r.x[:3]), run.reference_deg)
    for axis, value, reference in zip(ANGLES, error.tolist(), run.reference_deg.tolist(), strict=True):
        known = {"reference": f"{reference:g}", "source": run.reference_source}
        yield metric_row("boresight", axis, "bias", value, "deg", "zero", 1) | known
    e = np.deg2rad(error)
    low, high = (float(chi2.ppf(q, 3)) / 3 for q in _BAND)
    band = {"reference": f"{low:.3f}..{high:.3f}", "source": "99 % chi-square band"}
    yield metric_row("boresight", "all", "nees", e @ np.linalg.pinv(r.cov[:3, :3]) @ e / 3, "1", "one", 1) | band


def _fit_rows(run: CalibrationRun, r: BoresightResult) -> Iterator[dict[str, Any]]:
    used = r.used
    n, clicks = int(np.count_nonzero(used)), len(used)
    images = len(np.unique(run.observations.points.image[used]))
    adjusted = float(np.sqrt(np.mean(np.sum(r.adjusted[used] ** 2, axis=1))))
    yield metric_row("residual", "all", "rms", r.rms_px, "px", "lower", n)
    yield metric_row("residual_adjusted", "all", "rms", adjusted, "px", "lower", n)
    if np.isfinite(r.sigma_0):
        yield metric_row("sigma_0", "all", "median", r.sigma_0, "1", "one", r.redundancy)
    yield metric_row("image", "all", "sum", images, "1", "higher", len(run.observations.images))
    yield metric_row("click", "all", "sum", n, "1", "higher", clicks)
    yield metric_row("outlier", "all", "rejected", int(np.count_nonzero(r.rejected)), "1", "lower", clicks)
    for group in r.inseparable:
        row = metric_row("inseparable", "all", "correlation", group.correlation, "1", "zero", n)
        yield row | {"entity": " and ".join(group.names)}
    yield metric_row("runtime", "all", "median", r.runtime_s, "s", "lower", 1)


def _image_rows(run: CalibrationRun, r: BoresightResult) -> Iterator[dict[str, Any]]:
    """Scatter of the angles over the images, and the residual of each."""
    angles = r.by_image[np.isfinite(r.by_image).all(axis=1)]
    if len(angles) > 1:
        off = errors_deg(np.rad2deg(angles), np.rad2deg(r.x[:3]))
        for i, axis in enumerate(ANGLES):
            scatter = float(np.sqrt(np.sum(off[:, i] ** 2) / (len(off) - 1)))
            yield metric_row("boresight", axis, "std", scatter, "deg", "lower", len(off))
    for i, name in enumerate(run.observations.images):
        own = r.used & (run.observations.points.image == i)
        if own.any():
            rms = float(np.sqrt(np.mean(np.sum(r.predicted[own] ** 2, axis=1))))
            yield metric_row("residual", "all", "rms", rms, "px", "lower", int(own.sum())) | {"entity": name}
