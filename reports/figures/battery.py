"""Errors of many cars by distance, occlusion or manoeuvre: medians with intervals, and what they rest on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from reports.figures.style import GREY, color, legend, marker, new_figure, styled
from reports.replay_battery import MEASURED, Group

_ASIDE = 0.13  # between estimators
_LABELS = {
    "distance": "distance",
    "occlusion": "occlusion of the label, median distance",
    "manoeuvre": "manoeuvre, median distance",
}


@styled
def battery_figure(groups: Sequence[Group], by: str) -> Figure:
    """Four panels of absolute errors over the values of the groups; below, frames with numbers of cars, and the shares
    of frames with an estimate and of outliers."""
    values = list(dict.fromkeys(g.value for g in groups))
    estimators = list(dict.fromkeys(g.estimator for g in groups))
    figure = new_figure(7.0)
    axes = figure.subplots(3, 2, sharex=True, height_ratios=[1, 1, 0.7])
    for i, estimator in enumerate(estimators):
        mine = [g for g in groups if g.estimator == estimator]
        x = np.array([values.index(g.value) for g in mine]) + _ASIDE * (i - (len(estimators) - 1) / 2)
        for ax, name in zip(axes[:2].flat, MEASURED, strict=True):
            _errors(ax, x, mine, name, i, estimator)
        axes[2, 1].plot(x, [100 * g.estimated for g in mine], marker(i), color=color(i), ms=4)
        axes[2, 1].plot(x, [100 * g.outliers for g in mine], marker(i), color=color(i), ms=4, mfc="none")
    for ax, measured in zip(axes[:2].flat, MEASURED.values(), strict=True):
        _logarithmic(ax)
        ax.set_title(measured.title)
        ax.set_ylabel(f"absolute error [{measured.unit}]")
    _counts(axes[2, 0], [next(g for g in groups if g.value == v) for v in values])
    axes[2, 1].set(title="Share", ylabel="[%]", ylim=(-4, 104))
    axes[2, 1].plot([], [], "o", color=GREY, ms=4, label="frames with an estimate")
    axes[2, 1].plot([], [], "o", color=GREY, ms=4, mfc="none", label="outliers among the tracks")
    for ax in axes[2]:
        ax.set_xticks(range(len(values)), [_name(groups, v, by) for v in values], rotation=30 if len(values) > 5 else 0)
        ax.set_xlabel(_LABELS[by])
        ax.set_xlim(-0.5, len(values) - 0.5)
    axes[0, 0].plot([], [], "_", color=GREY, ms=7, label="95 % of the errors below")
    legend(figure, list(axes.flat))
    return figure


def _name(groups: Sequence[Group], value: str, by: str) -> str:
    """A value with the median distance of its frames, where that is not what it says itself."""
    distance = next(g.distance_m for g in groups if g.value == value)
    return value if by == "distance" else f"{value}\n{distance:.0f} m"


def _errors(ax: Axes, x: np.ndarray, groups: Sequence[Group], name: str, i: int, label: str) -> None:
    """Medians with their intervals, and the 95 % quantile, of one estimator."""
    found = [g.errors[name] for g in groups]
    median, low, high, p95 = (np.array([getattr(s, k) for s in found]) for k in ("median", "low", "high", "p95"))
    ax.vlines(x, low, high, color=color(i), lw=1.4)
    ax.plot(x, median, marker(i), color=color(i), ms=4, label=label)
    ax.plot(x, p95, "_", color=color(i), ms=7)


def _logarithmic(ax: Axes) -> None:
    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())


def _counts(ax: Axes, groups: Sequence[Group]) -> None:
    """Frames of every group as bars, the number of cars above each."""
    frames = [g.frames for g in groups]
    ax.bar(range(len(groups)), frames, width=0.6, color="#bbbbbb")
    for x, g in enumerate(groups):
        ax.text(x, g.frames, f"{g.cars} {'car' if g.cars == 1 else 'cars'}", ha="center", va="bottom", fontsize=7.5)
    ax.set(title="What it rests on", ylabel="frames", ylim=(0, 1.2 * max(frames)))
