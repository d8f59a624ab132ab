"""Boresight angles of single images about the true ones, and true errors beside stated ones."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.figures.style import GREY, TRUTH, color, legend, marker, new_figure, styled
from reports.kozempel.boresight import (
    ADJUSTED,
    ANGLES,
    GOAL_DEG,
    LETTERS,
    PER_IMAGE,
    SOURCE_SCATTER_DEG,
    as_source,
    conditions,
    nees_band,
    pooled,
)
from reports.kozempel.log_axis import plain_log
from reports.studies import StudyResult


@styled
def scatter_figure(result: StudyResult, *, run: int = 0) -> Figure:
    """One run: the angles of every image minus the true ones, by approach, and what was made of them.

    Above in the best conditions, below in the source's; behind, the images of all other runs.
    """
    points = [str(result.points.index[0]), as_source(result)]
    names = conditions(result)
    figure = new_figure(5.2)
    axes = figure.subplots(len(points), len(ANGLES), sharex=True, sharey="row", squeeze=False)
    for row, point in zip(axes, points, strict=True):
        m = result.measures
        rows = m[(m["point"] == point) & (m["estimator"].isin([PER_IMAGE, ADJUSTED]))]
        for ax, angle in zip(row, ANGLES, strict=True):
            _draw(ax, rows, angle, run)
        row[1].set_title(names[point], loc="center", fontweight="normal")
        row[0].set_ylabel("found minus true [°]")
    for ax, angle in zip(axes[-1], ANGLES, strict=True):
        ax.set_xlabel(f"{LETTERS[angle]}: image, mean, adjusted")
    legend(figure, list(axes.flat))
    return figure


def _draw(ax: Axes, rows: pd.DataFrame, angle: str, run: int) -> None:
    images = _column(rows, f"boresight_image_{angle}")
    n = int(images["t_s"].max())
    ax.plot(images["t_s"], images["value"], ".", color="#dddddd", ms=2.5, zorder=0, label="images of all runs")
    own = images[images["run"] == run].set_index("t_s")["value"]
    heading = _column(rows, "boresight_heading")
    heading_of = heading[heading["run"] == run].set_index("t_s")["value"].round().astype(int) % 360
    for i, h in enumerate(sorted(set(heading_of))):
        at = own.index[heading_of.loc[own.index] == h]
        ax.plot(at, own[at], marker(i), color=color(i), ms=5, label=f"flown at {h}°")
    single = rows[rows["run"] == run].set_index(["estimator", "quantity", "t_s"])["value"]
    for x, case, c in ((n + 1.2, PER_IMAGE, GREY), (n + 2.4, ADJUSTED, "#882255")):
        value, sigma = (single[case, f"boresight_{part}{angle}", 0.0] for part in ("", "sigma_"))
        label = "their mean, scatter / √n" if case == PER_IMAGE else "one adjustment, sigma"
        ax.errorbar([x], [value], [[sigma], [sigma]], fmt="D", color=c, ms=4, capsize=3, label=label)
    ax.axhline(0, color=TRUTH, lw=0.8, label="true")
    for s in (-SOURCE_SCATTER_DEG[1], SOURCE_SCATTER_DEG[1]):
        ax.axhline(s, color=GREY, lw=0.9, ls=":", label="source's scatter, 0.12°")
    ax.set(xticks=range(1, n + 1, 2))


def _column(rows: pd.DataFrame, quantity: str) -> pd.DataFrame:
    return rows[rows["quantity"] == quantity]


@styled
def honesty_figure(result: StudyResult) -> Figure:
    """True errors (filled, with interval) and stated ones (hollow) of every way, and its NEES, by conditions."""
    figure = new_figure(4.6)
    axes = figure.subplots(1, len(ANGLES) + 1, sharey=True)
    names = [name.replace(", GNSS", ",\nGNSS") for name in conditions(result)]
    y = np.arange(len(names))[::-1].astype(float)
    for i, case in enumerate(result.estimators):
        value, low, high = (pooled(result, case, c) for c in ("value", "ci_low", "ci_high"))
        at = y + 0.22 * (1 - i)
        for ax, angle in zip(axes, ANGLES, strict=False):
            q = f"boresight_{angle}"
            bars = np.abs(np.stack([low[q], high[q]]) - value[q].to_numpy())
            ax.errorbar(value[q], at, xerr=bars, fmt=marker(i), color=color(i), ms=4, capsize=2, label=case)
            ax.plot(value[f"boresight_sigma_{angle}"], at, marker(i), mfc="none", color=color(i), ms=7)
        axes[-1].plot(value["boresight_nees"], at, marker(i), color=color(i), ms=4)
    axes[0].plot([], [], "o", mfc="none", color=GREY, ms=7, label="stated")
    for ax, angle in zip(axes, ANGLES, strict=False):
        ax.axvline(GOAL_DEG[angle], color=GREY, lw=0.9, ls=":", label="goal, clean")
        ax.set(xscale="log", title=LETTERS[angle], xlabel="error [°]")
        plain_log(ax.xaxis)
    axes[-1].axvspan(*nees_band(result), color="#cccccc", zorder=0)
    axes[-1].set(xscale="log", title="NEES", xlabel="mean per angle")
    plain_log(axes[-1].xaxis)
    axes[0].set_yticks(y, names, fontsize=7)
    legend(figure, list(axes))
    return figure
