"""The systematic error in depth and its cures, 4.1.2 and 4.1.3: Figures 4.1.4, 4.1.6 and 4.1.7."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimators.estimate import TrajectoryEstimate
from reports.errors import compare_windows
from reports.figures.style import GREY, TRUTH, color, legend, new_figure, styled
from reports.siegemund.over_time import distance_axis, draw_mean, draw_runs, each, over_time
from reports.studies import StudyResult
from reports.windows import WindowComparison

# What 4.1.3 says of the estimated position along the camera's axis.
PUBLISHED = {
    "observed": "too near (4.1.4)",
    "averaged": "cured (4.1.6)",
    "estimated": "too far (4.1.7, left)",
    "estimated second order": "cured (4.1.7, right)",
}


def depth_table(result: StudyResult) -> pd.DataFrame:
    """Mean depth error of all windows with its 95 % interval, RMS, bound, efficiency, and what the source says."""
    rows = {label: {"estimator": label} for label in result.estimators}
    for statistic in ("bias", "rms", "crb", "efficiency"):
        for r in result.select("position", "z", statistic).to_dict("records"):
            cells = rows[str(r["estimator"])]
            name = statistic if statistic == "efficiency" else f"{statistic} [m]"
            cells[name] = r["value"]
            if statistic == "bias":
                cells |= {"from": r["ci_low"], "to": r["ci_high"]}
    return pd.DataFrame([row | {"source": PUBLISHED.get(label, "")} for label, row in rows.items()])


@styled
def depth_error(result: StudyResult, *, zoom_m: float = 0.0) -> Figure:
    """Mean depth error of the newest frame over time, a line per estimator, with 95 % bands over the runs.

    zoom_m: half the height of a second panel that shows the small errors; none where it is zero. One estimator alone
    is drawn with the band of its single runs.
    """
    table = over_time(result, "position", "z")
    figure = new_figure(3.4)
    axes = figure.subplots(1, 2 if zoom_m else 1, squeeze=False)[0]
    for ax in axes:
        _errors(ax, table, result.estimators)
    axes[0].set_ylabel("depth error [m], negative: too near")
    if zoom_m:
        axes[1].set_ylim(-zoom_m, zoom_m)
        axes[1].set_ylabel("the grey part enlarged [m]")
        axes[0].axhspan(-zoom_m, zoom_m, color="#eeeeee", lw=0, zorder=0)
    legend(figure, list(axes))
    return figure


def _errors(ax: Axes, table: pd.DataFrame, estimators: tuple[str, ...]) -> None:
    lines = list(each(table, estimators))
    ax.axhline(0, color=TRUTH, lw=0.9)
    for i, label, rows in lines:
        if len(lines) == 1:
            draw_runs(ax, rows, i, "95 % of the runs")
        draw_mean(ax, rows, i, label)
    if lines:
        rows = lines[0][2]
        ax.set_xlim(rows["t_s"].min(), rows["t_s"].max())
        distance_axis(ax, rows)
    ax.set_xlabel("time [s]")


@styled
def depth_and_cloud(result: StudyResult) -> Figure:
    """Figure 4.1.4: the depth error over time, and the estimated points of one run's last window beside the true ones.

    Raises
        FileNotFoundError: the study keeps no examples.
    """
    figure = new_figure(3.4)
    left, right = figure.subplots(1, 2, width_ratios=[1.1, 1])
    _errors(left, over_time(result, "position", "z"), result.estimators)
    left.set_ylabel("depth error [m], negative: too near")
    run = result.example()
    for i, label in enumerate(result.estimators):
        estimate = run.estimates[label]
        windows: list[WindowComparison] = []
        if isinstance(estimate, TrajectoryEstimate):
            windows = compare_windows(run.truth, run.observations.tracks, estimate)
        if windows:
            _cloud(right, windows[-1], i)
            right.set_title(f"Points in the camera frame, t = {run.truth.t_s[windows[-1].frame]:.2f} s")
    legend(figure, [left, right])
    return figure


def _cloud(ax: Axes, window: WindowComparison, i: int) -> None:
    """True and estimated points from above, a line from each to the other."""
    for p, y in zip(window.p_c, window.y_c, strict=True):
        ax.plot([p[2], y[2]], [p[0], y[0]], color=GREY, lw=0.4, alpha=0.6)
    ax.plot(window.p_c[:, 2], window.p_c[:, 0], "*", color=TRUTH, ms=4, mew=0, label="true points")
    ax.plot(
        window.y_c[:, 2], window.y_c[:, 0], "o", color=color(i), ms=3, mfc="none", mew=0.8, label="estimated points"
    )
    for cloud, c in ((window.p_c, TRUTH), (window.y_c, color(i))):
        ax.axvline(float(np.mean(cloud[:, 2])), color=c, lw=0.9, ls="--")
    ax.set_xlabel("z, forward [m]; dashed: mean")
    ax.set_ylabel("x, right [m]")
