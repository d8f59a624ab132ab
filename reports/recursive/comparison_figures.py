"""Filters and adjustments over time: after the start, through braking and turning, by the share of wrong tracks."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.consistency import DOF, band
from reports.figures.style import GREY, color, legend, marker, new_figure, styled
from reports.recursive.comparison import BRAKED, SETTLED, TURNED, lag_sums
from reports.recursive.situations import STEADY_S, Curves, curves, nees_of, situations, wrong_share
from reports.studies import StudyResult

_LEVEL = 0.95
_LABELS = {"position": "position, RMS [m]", "speed": "speed, RMS [m/s]"}


@styled
def start_figure(result: StudyResult) -> Figure:
    """RMS over the runs of position and speed, and NEES of the pose, over the time since the first frame."""
    point = situations(result)["constant velocity"]
    figure = new_figure(6.2)
    axes = figure.subplots(3, 1, sharex=True)
    for i, estimator in enumerate(result.estimators):
        for ax, quantity in zip(axes, _LABELS, strict=False):
            c = curves(result, point, estimator, quantity)
            ax.plot(c.t_s, _rms(c), color=color(i), label=estimator)
        nees = nees_of(result, point, estimator)
        axes[2].plot(nees.t_s, np.nanmean(nees.error[..., 0], axis=0), color=color(i), label=estimator)
    for ax, quantity in zip(axes, _LABELS, strict=False):
        ax.axhline(SETTLED[quantity], color=GREY, lw=0.8, ls=":")
        ax.set(yscale="log", ylabel=_LABELS[quantity])
    axes[2].axhspan(*band(DOF, result.runs, _LEVEL), color=GREY, alpha=0.3, lw=0, label="95 % band")
    axes[2].set(yscale="log", ylabel="NEES of the pose", xlabel="time [s]")
    legend(figure, list(axes))
    return figure


def _rms(c: Curves) -> np.ndarray:
    squares = np.sum(c.error**2, axis=-1)
    known = np.isfinite(squares)
    counts = known.sum(axis=0)
    return np.asarray(
        np.sqrt(
            np.divide(
                np.where(known, squares, 0).sum(axis=0), counts, out=np.full(len(counts), np.nan), where=counts > 0
            )
        )
    )


@styled
def manoeuvre_figure(result: StudyResult) -> Figure:
    """Speed through braking and yaw rate through turning: truth, means over the runs, and mean errors with the lag."""
    points = situations(result)
    figure = new_figure(4.8)
    axes = figure.subplots(2, 2, sharex="col")
    chosen = (("braking", "speed", BRAKED, 1.0, "m/s"), ("turning", "yaw_rate", TURNED, np.degrees(1), "°/s"))
    for (where, quantity, least, scale, unit), (upper, lower) in zip(chosen, axes.T, strict=True):
        for i, estimator in enumerate(result.estimators):
            if "poor" in estimator:
                continue
            c = curves(result, points[where], estimator, quantity)
            lag = lag_sums(c, least).sum(axis=0)
            _draw_mean(upper, lower, c, scale, i, estimator, 1000 * lag[0] / lag[1])
        upper.set(title=where, ylabel=f"{quantity.replace('_', ' ')} [{unit}]")
        lower.set(xlabel="time [s]", ylabel=f"mean error [{unit}]")
        lower.axhline(0, color="black", lw=0.6)
        lower.legend(frameon=False, fontsize=7, title="lag", title_fontsize=7, handlelength=1.2, labelspacing=0.2)
    legend(figure, list(axes[0]))
    return figure


def _draw_mean(upper: Axes, lower: Axes, c: Curves, scale: float, i: int, estimator: str, lag_ms: float) -> None:
    known = np.isfinite(c.error[..., 0]).all(axis=0)
    t_s, error, truth = (
        c.t_s[known],
        scale * c.error[:, known, 0].mean(axis=0),
        scale * c.truth[:, known, 0].mean(axis=0),
    )
    if i == 0:
        upper.plot(t_s, truth, color="black", lw=1.6, label="truth")
    upper.plot(t_s, truth + error, color=color(i), label=estimator)
    lower.plot(t_s, error, color=color(i), label=f"{lag_ms:.0f} ms".replace("-", "−"))


def wrong_tracks_table(result: StudyResult) -> pd.DataFrame:
    """RMS of position and speed by the share of wrong tracks, a row per estimator and share."""
    rows = []
    for point, scenario in result.scenarios.items():
        if scenario["vehicle"][0]["motion"]["kind"] != "straight":
            continue
        for estimator in result.estimators:
            row: dict[str, object] = {"wrong tracks [%]": 100 * wrong_share(scenario), "estimator": estimator}
            for quantity in _LABELS:
                late = curves(result, str(point), estimator, quantity).since(STEADY_S)
                row[_LABELS[quantity]] = float(np.sqrt(np.nanmean(np.sum(late.error**2, axis=-1))))
            rows.append(row)
    return pd.DataFrame(rows)


@styled
def wrong_tracks_figure(result: StudyResult) -> Figure:
    """RMS of position and speed over the share of wrong tracks."""
    table = wrong_tracks_table(result)
    figure = new_figure(2.8)
    axes = figure.subplots(1, 2)
    for ax, label in zip(axes, _LABELS.values(), strict=True):
        for i, estimator in enumerate(result.estimators):
            rows = table[table["estimator"] == estimator]
            ax.plot(rows["wrong tracks [%]"], rows[label], color=color(i), marker=marker(i), ms=4, label=estimator)
        ax.set(xlabel="wrong tracks [%]", ylabel=label, yscale="log")
    legend(figure, list(axes))
    return figure
