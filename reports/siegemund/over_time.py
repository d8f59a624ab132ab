"""Errors of many runs over time: what Figures 4.1.4 to 4.1.10 are drawn from."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from reports.errors import SMOOTHED
from reports.figures.style import color
from reports.studies import StudyResult

_NORMAL_95 = 1.96


def over_time(result: StudyResult, quantity: str, axis: str) -> pd.DataFrame:
    """Error of the newest frames by estimator and time, all points and runs together.

    Columns estimator, t_s; mean error with its 95 % interval low, high (normal, over the runs); q_low, q_high that hold
    95 % of the single runs; truth, bound and distance_m, means over the runs.
    """
    c = result.comparison
    rows = c[(c["quantity"] == quantity) & (c["axis"] == axis) & (c["entity"] != SMOOTHED)]
    by = rows.groupby(["estimator", "t_s"], observed=True)
    error = by["error"]
    half: pd.Series = _NORMAL_95 * error.std().fillna(0) / np.sqrt(error.count())
    table = pd.DataFrame(
        {
            "mean": error.mean(),
            "low": error.mean() - half,
            "high": error.mean() + half,
            "q_low": error.quantile(0.025),
            "q_high": error.quantile(0.975),
        }
    ).join(by[["truth", "bound", "distance_m"]].mean())
    return table.reset_index()


def each(table: pd.DataFrame, estimators: tuple[str, ...]) -> Iterator[tuple[int, str, pd.DataFrame]]:
    """Rank, label and rows in order of time of the estimators a table has, in the study's order."""
    for i, label in enumerate(estimators):
        rows = table[table["estimator"] == label]
        if len(rows):
            yield i, label, rows.sort_values("t_s")


def draw_mean(ax: Axes, rows: pd.DataFrame, i: int, label: str | None) -> None:
    """Mean error over time with the band of its 95 % interval."""
    ax.fill_between(rows["t_s"], rows["low"], rows["high"], color=color(i), alpha=0.25, lw=0)
    ax.plot(rows["t_s"], rows["mean"], color=color(i), label=label)


def draw_runs(ax: Axes, rows: pd.DataFrame, i: int, label: str | None) -> None:
    """The band that holds 95 % of the single runs."""
    ax.fill_between(rows["t_s"], rows["q_low"], rows["q_high"], color=color(i), alpha=0.13, lw=0, label=label)


def distance_axis(ax: Axes, rows: pd.DataFrame) -> None:
    """True distance above the time, for an object that comes or goes evenly."""
    slope, start = np.polyfit(rows["t_s"], rows["distance_m"], 1)
    upper = ax.secondary_xaxis("top", functions=(lambda t: start + slope * t, lambda z: (z - start) / slope))
    upper.set_xlabel("true distance [m]")
    upper.tick_params(labelsize=8)
    ax.grid(visible=False, axis="x")
