"""Table 3.4.1: how many good tracks a detector of outliers drops (fp), and how many wrong ones it keeps (fn)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.figures.style import color, marker, new_figure, styled
from reports.studies import StudyResult

SHARE, FRAMES = "outliers.0.tracks", "outliers.0.frames"
# Mean fp and fn by share of wrong tracks [%] and number of their wrong frames.
PUBLISHED: dict[str, dict[tuple[int, int], tuple[float, float]]] = {
    "points": {
        (10, 10): (15.3, 0),
        (30, 10): (12.72, 0),
        (50, 10): (0, 7),
        (10, 5): (15.83, 0),
        (30, 5): (13.15, 0),
        (50, 5): (0, 7),
        (10, 1): (15.47, 0),
        (30, 1): (13.09, 0),
        (50, 1): (0, 7),
    },
    "tracks": {
        (10, 10): (0.7, 0),
        (30, 10): (1.49, 0.01),
        (50, 10): (0.29, 7.29),
        (10, 5): (0.62, 0.04),
        (30, 5): (0.9, 0.01),
        (50, 5): (0.2, 7.2),
        (10, 1): (0.74, 0.01),
        (30, 1): (0.75, 0),
        (50, 1): (0.2, 7.2),
    },
    "prior knowledge": {
        (10, 10): (0, 1.74),
        (30, 10): (0, 3.94),
        (50, 10): (0, 6.94),
        (10, 5): (0, 2.83),
        (30, 5): (0, 8.37),
        (50, 5): (0, 15.56),
        (10, 1): (0, 3.25),
        (30, 1): (0, 9.35),
        (50, 1): (0, 15.56),
    },
}
_NORMAL_95 = 1.96
_SPREAD = 0.72  # of a row's height, over which its detectors are spread


def counts(result: StudyResult) -> pd.DataFrame:
    """Per row of the table and detector: theta [%], rho, estimator, mean fp and fn with half their 95 % intervals,
    number of runs, and the source's fp and fn, NaN where it has none.

    Raises
        KeyError: the study does not vary share and frames of its first kind of outliers.
    """
    levels = _levels(result)
    found = []
    for (point, estimator), rows in result.outliers.groupby(["point", "estimator"], observed=True):
        level = levels[str(point)]
        means, bars = rows[["fp", "fn"]].mean(), _NORMAL_95 * np.sqrt(rows[["fp", "fn"]].var() / len(rows))
        source = PUBLISHED.get(str(estimator), {}).get(level, (np.nan, np.nan))
        found.append((*level, str(estimator), *means, *bars, len(rows), *source))
    columns = ["theta", "rho", "estimator", "fp", "fn", "fp_bar", "fn_bar", "runs", "fp_source", "fn_source"]
    return pd.DataFrame(found, columns=columns)


def _levels(result: StudyResult) -> dict[str, tuple[int, int]]:
    """theta [%] and rho of every point."""
    p = result.points
    return {str(name): (round(100 * s), int(f)) for name, s, f in zip(p.index, p[SHARE], p[FRAMES], strict=True)}


def outlier_table(result: StudyResult) -> pd.DataFrame:
    """The published table: a row per share and number of frames, fp and fn of every detector beside the source's."""
    found = counts(result).set_index(["theta", "rho", "estimator"])[["fp", "fn", "fp_source", "fn_source"]].T.to_dict()
    rows = []
    for theta, rho in _levels(result).values():
        row: dict[str, float] = {"theta [%]": theta, "rho": rho}
        for estimator in result.estimators:
            names = ("fp", "fn", "fp_source", "fn_source") if estimator in PUBLISHED else ("fp", "fn")
            for name in names:
                head = f"{estimator} {name.replace('_source', ', source')}"
                row[head] = found.get((theta, rho, estimator), {}).get(name, np.nan)
        rows.append(row)
    return pd.DataFrame(rows)


@styled
def outlier_counts(result: StudyResult) -> Figure:
    """fp and fn of every detector, filled, with 95 % intervals, beside the source's, open."""
    table = counts(result)
    levels = list(dict.fromkeys(zip(table["theta"], table["rho"], strict=True)))
    figure = new_figure(0.9 + 0.52 * len(levels))
    axes = figure.subplots(1, 2, sharey=True)
    titles = {"fp": "Good tracks dropped (fp)", "fn": "Wrong tracks kept (fn)"}
    for ax, (kind, title) in zip(axes, titles.items(), strict=True):
        _rows(ax, table, kind, levels, result.estimators)
        ax.set_title(title)
        ax.set_xlabel("mean number of tracks in a run of 100")
    axes[0].set_yticks(range(len(levels)), [f"{theta} % of tracks\nin {_frames(rho)}" for theta, rho in levels])
    axes[0].set_ylim(len(levels) - 0.5, -0.5)
    for ax in axes:
        ax.tick_params(axis="y", length=0)
    drawn = {label: handle for handle, label in zip(*axes[0].get_legend_handles_labels(), strict=True)}
    order = [e + tail for e in result.estimators for tail in ("", ", source") if e + tail in drawn]
    handles = [drawn[label] for label in order]
    figure.legend(handles, order, loc="outside upper left", ncols=4, frameon=False, handletextpad=0.2)
    return figure


def _frames(rho: int) -> str:
    return f"{rho} frame" if rho == 1 else f"{rho} frames"


def _rows(ax: Axes, table: pd.DataFrame, kind: str, levels: list[tuple[int, int]], estimators: tuple[str, ...]) -> None:
    """One detector above the other within every row of the table."""
    at = {level: k for k, level in enumerate(levels)}
    step = _SPREAD / max(len(estimators), 1)
    for i, estimator in enumerate(estimators):
        part = table[table["estimator"] == estimator]
        y = np.array([at[level] for level in zip(part["theta"], part["rho"], strict=True)], float)
        y += step * (i - (len(estimators) - 1) / 2)
        style: dict[str, Any] = {"color": color(i), "marker": marker(i), "ls": "", "clip_on": False, "zorder": 3}
        ax.errorbar(part[kind], y, xerr=part[f"{kind}_bar"], ms=4, mew=0, elinewidth=1, label=estimator, **style)
        if part[f"{kind}_source"].notna().any():
            ax.plot(part[f"{kind}_source"], y, ms=5.5, mfc="none", mew=0.9, label=f"{estimator}, source", **style)
    for k in range(1, len(levels)):
        ax.axhline(k - 0.5, color="#bbbbbb", lw=0.6)
    ax.set_xscale("symlog", linthresh=1, linscale=0.6)
    ticks = [0, 1, 2, 5, 10, 20, 50]
    ax.set_xticks(ticks, [str(t) for t in ticks])
    ax.set_xticks([], minor=True)
    ax.set_xlim(0, 60)
    ax.grid(visible=False, axis="y")
