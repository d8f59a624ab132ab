"""Boresights estimated in a flight against the true one: rows, table and figure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from estimators.aerial.flight_boresight import FlightBoresight
from reports.figures.style import TRUTH, color, legend, marker, new_figure, styled
from reports.flights.run import FlightRun
from reports.metrics import metric_row

Array = np.ndarray
ANGLES = ("omega", "phi", "kappa")
_SYMBOLS = {"omega": "ω", "phi": "φ", "kappa": "κ"}


def boresight_table(run: FlightRun) -> pd.DataFrame:
    """One row per estimator and angle: columns estimator, camera, angle, estimate, truth, error, sigma [deg]."""
    rows = []
    for label, b in run.boresights.items():
        truth = _truth(run, b)
        sigma = np.sqrt(np.diag(b.cov))
        for k, angle in enumerate(ANGLES):
            error = _wrapped(b.x[k] - truth[k])
            values = np.rad2deg([b.x[k], truth[k], error, sigma[k]]).tolist()
            rows.append((label, b.camera, angle, *values))
    return pd.DataFrame(rows, columns=["estimator", "camera", "angle", "estimate", "truth", "error", "sigma"])


def boresight_rows(run: FlightRun) -> Iterator[dict[str, Any]]:
    """Rows of metrics.csv."""
    for label, b in run.boresights.items():
        for row in _rows(run, b):
            yield row | {"estimator": label}


def _rows(run: FlightRun, b: FlightBoresight) -> Iterator[dict[str, Any]]:
    error = _wrapped(b.x[:3] - _truth(run, b))
    sigma = np.sqrt(np.diag(b.cov))[:3]
    for k, angle in enumerate(ANGLES):
        yield metric_row("boresight", angle, "estimate", float(np.rad2deg(b.x[k])), "deg", "zero", 1)
        yield metric_row("boresight", angle, "bias", float(np.rad2deg(error[k])), "deg", "zero", 1)
        yield metric_row("boresight", angle, "sigma", float(np.rad2deg(sigma[k])), "deg", "lower", 1)
    nees = float(error @ np.linalg.solve(b.cov[:3, :3], error)) / 3
    yield metric_row("boresight", "all", "nees", nees, "1", "one", 1)
    yield metric_row("residual", "all", "rms", b.rms_px, "px", "lower", b.measured)
    yield metric_row("sigma_0", "all", "median", b.sigma_0, "1", "one", b.measured)
    yield metric_row("outlier", "all", "rejected", b.rejected, "1", "lower", b.measured)
    alone = b.per_image[np.isfinite(b.per_image).all(axis=1)]
    if len(alone) > 1:
        for k, angle in enumerate(ANGLES):
            scatter = float(np.rad2deg(np.std(_wrapped(alone[:, k] - b.x[k]), ddof=1)))
            yield metric_row("boresight", angle, "scatter", scatter, "deg", "lower", len(alone))


def _truth(run: FlightRun, b: FlightBoresight) -> Array:
    return next(c for c in run.truth.cameras if c.name == b.camera).mounting.boresight


def _wrapped(angle: Array) -> Array:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


@styled
def boresight_figure(run: FlightRun, boresights: Mapping[str, FlightBoresight]) -> Figure:
    """Errors of the boresight angles with three standard deviations, and those of every image alone (Fig. 3.7)."""
    figure = new_figure(2.9)
    axes = figure.subplots(1, 3)
    for k, (ax, angle) in enumerate(zip(axes, ANGLES, strict=True)):
        ax.axhline(0, color=TRUTH, lw=0.8)
        for i, (label, b) in enumerate(boresights.items()):
            truth = _truth(run, b)[k]
            sigma = np.rad2deg(np.sqrt(b.cov[k, k]))
            error = np.rad2deg(_wrapped(b.x[k] - truth))
            alone = np.rad2deg(_wrapped(b.per_image[:, k] - truth))
            place = i + np.linspace(-0.3, 0.1, max(len(alone), 2))[: len(alone)]
            if np.isfinite(alone).any():
                ax.plot(place, alone, ".", ms=3, color=color(i), alpha=0.6)
            ax.errorbar(i + 0.25, error, 3 * sigma, fmt=marker(i), ms=4, color=color(i), capsize=2, label=label)
        ax.set_title(f"{_SYMBOLS[angle]} [deg]")
        ax.set_xticks([])
    axes[0].set_ylabel("estimate minus truth")
    legend(figure, list(axes))
    return figure
