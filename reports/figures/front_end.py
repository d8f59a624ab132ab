"""What an image front end's tracked points are like: errors, their correlation, drift, and tracks over time."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

from reports.figures.style import INLIER, OUTLIERS, TRUTH, color, legend, marker, new_figure, styled
from reports.front_end import INLIER_NAME, LAGS

Array = np.ndarray
_SHOWN = {"u_left": "left u", "v_left": "left v", "disparity": "disparity"}
_BINS = 61


@styled
def front_end(errors: pd.DataFrame, metrics: pd.DataFrame, t_s: np.ndarray, kinds: tuple[str, ...]) -> Figure:
    """Distribution of the inliers' errors, correlation over time, drift since birth, tracks per frame by label.

    errors: `reports.front_end.pixel_errors`; metrics: rows of metrics.csv of `reports.front_end.front_end_rows`.
    """
    figure = new_figure(5.2)
    axes = figure.subplots(2, 2)
    good = errors[errors["kind"] == INLIER_NAME]
    _distribution(axes[0, 0], good)
    _correlation(axes[0, 1], metrics)
    _drift(axes[1, 0], metrics)
    _counts(axes[1, 1], errors, t_s, kinds)
    legend(figure, list(axes.flat))
    return figure


def _distribution(ax: Axes, good: pd.DataFrame) -> None:
    reach = 4 * max((good[axis].std() for axis in _SHOWN), default=0.0) if len(good) > 1 else 1.0
    edges = np.linspace(-reach, reach, _BINS)
    middle = (edges[1:] + edges[:-1]) / 2
    for i, (axis, name) in enumerate(_SHOWN.items()):
        e = good[axis].to_numpy(float)
        if len(e) < 2:
            continue
        density, _ = np.histogram(np.clip(e, -reach, reach), edges, density=True)
        ax.step(middle, density, where="mid", color=color(i), lw=1.0, label=name)
        ax.plot(middle, norm.pdf(middle, e.mean(), e.std()), "--", color=color(i), lw=0.7)
    ax.set_title("Errors of the inliers")
    ax.set_xlabel("error [px]")
    ax.set_ylabel("density [1/px]")


def _binned(metrics: pd.DataFrame, axis: str, statistic: str) -> tuple[Array, Array, Array]:
    """Number in the bin's name, value and its interval as distances from it, (n,), (n,) and (2, n)."""
    rows = metrics[(metrics["quantity"] == "pixel") & (metrics["axis"] == axis) & (metrics["statistic"] == statistic)]
    value = rows["value"].to_numpy(float)
    ends = np.stack([value - rows["ci_low"].to_numpy(float), rows["ci_high"].to_numpy(float) - value])
    return rows["bin"].str.split(" ").str[-1].to_numpy(float), value, np.maximum(np.nan_to_num(ends), 0.0)


def _correlation(ax: Axes, metrics: pd.DataFrame) -> None:
    ax.axhline(0, color=TRUTH, lw=0.9)
    for i, (axis, name) in ((0, ("left", "left u, v")), (2, ("disparity", "disparity"))):
        lag, value, ends = _binned(metrics, axis, "correlation")
        ax.errorbar(lag, value, ends, fmt=f"{marker(i)}-", color=color(i), ms=4, lw=0.9, label=name)
    ax.set_xticks(list(LAGS))
    ax.set_title("Correlation of a track's errors")
    ax.set_xlabel("frames apart")
    ax.set_ylabel("correlation")


def _drift(ax: Axes, metrics: pd.DataFrame) -> None:
    age, value, ends = _binned(metrics, "left", "drift")
    ax.errorbar(age, value, ends, fmt="o-", color=color(0), ms=4, lw=0.9, label="left u, v")
    sigma = metrics[metrics["axis"].isin(["u_left", "v_left"]) & (metrics["statistic"] == "std")]["value"]
    if len(sigma):
        white = float(np.sqrt(2 * np.mean(sigma.to_numpy(float) ** 2)))
        ax.axhline(white, color=TRUTH, ls="--", lw=0.9, label="white noise of the same sigma")
    ax.set_ylim(bottom=0)
    ax.set_title("Change since a track's first frame")
    ax.set_xlabel("age of the track [frames]")
    ax.set_ylabel("RMS per coordinate [px]")


def _counts(ax: Axes, errors: pd.DataFrame, t_s: np.ndarray, kinds: tuple[str, ...]) -> None:
    names = [INLIER_NAME, *kinds]
    counts = [np.bincount(errors.loc[errors["kind"] == name, "frame"], minlength=len(t_s)) for name in names]
    shown = [i for i, c in enumerate(counts) if i == 0 or c.any()]
    ax.stackplot(
        t_s,
        [counts[i] for i in shown],
        colors=[INLIER if i == 0 else OUTLIERS[(i - 1) % len(OUTLIERS)] for i in shown],
        labels=["inliers" if i == 0 else f"outlier: {names[i]}" for i in shown],
        lw=0,
    )
    ax.set_ylim(bottom=0)
    ax.margins(x=0)
    ax.set_title("Tracks by label")
    ax.set_xlabel("time [s]")
    ax.set_ylabel("tracks in a frame")
