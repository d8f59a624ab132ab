"""Accuracy of rigs: what a designer reads off, and how far the formulas behind it can be trusted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from reports.figures.style import COLORS, GREY, TRUTH, color, legend, marker, new_figure, styled
from reports.rig_design import Fit, Rig

_TRUSTED = 0.15
_LEVELS = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)


@styled
def accuracy_over_distance(fits: Mapping[str, Fit], rig: Rig, pairs: Sequence[tuple[float, float]]) -> Figure:
    """Standard deviation to be expected over the distance, a colour per baseline [m] and focal length [px].

    Solid: achieved, dashed: Cramér-Rao bound. rig: its distances are the horizontal axis; noise, tracks and window
    those of all lines.
    """
    figure = new_figure(3.3)
    axes = figure.subplots(1, len(fits), squeeze=False)[0]
    for ax, (name, fit) in zip(axes, fits.items(), strict=True):
        for i, (b, f) in enumerate(pairs):
            one = replace(rig, baseline_m=b, focal_px=f)
            label = f"b = {b:g} m, f = {f:g} px"
            ax.plot(rig.distance_m, fit.quantity.factor * fit.achieved(one), color=color(i), label=label)
            ax.plot(rig.distance_m, fit.quantity.factor * fit.bound(one), "--", color=color(i), lw=0.9)
        _logarithmic(ax, rig.distance_m)
        ax.set_title(name)
        ax.set_ylabel(f"standard deviation [{fit.quantity.unit}]")
        ax.set_xlabel("distance [m]")
    axes[0].plot([], [], "-", color=GREY, label="achieved")
    axes[0].plot([], [], "--", color=GREY, lw=0.9, label="Cramér-Rao bound")
    legend(figure, list(axes))
    return figure


def _logarithmic(ax: Axes, distance: np.ndarray) -> None:
    ax.set_xscale("log")
    ax.set_yscale("log")
    ticks = [z for z in (5, 10, 20, 30, 50, 80, 120) if distance.min() <= z <= distance.max()]
    ax.set_xticks(ticks, [str(z) for z in ticks])
    ax.set_xticks([], minor=True)
    ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())


@styled
def depth_chart(fit: Fit, rig: Rig, baselines_m: np.ndarray) -> Figure:
    """Lines of equal accuracy in depth over distance and baseline, for the focal length, noise, tracks and window of
    the rig: the baseline a distance and an accuracy ask for."""
    figure = new_figure(3.6)
    ax = figure.add_subplot()
    z, b = np.meshgrid(rig.distance_m, baselines_m)
    values = fit.achieved(replace(rig, distance_m=z, baseline_m=b))
    lines = ax.contour(z, b, values, levels=_LEVELS, colors=COLORS[0], linewidths=1.1)
    ax.clabel(lines, fmt=lambda v: f"{v:g} m", fontsize=8, inline_spacing=2)
    ax.set_xscale("log")
    ax.set_yscale("log")
    for axis, ticks in (("x", (5, 10, 20, 30, 50, 80, 120)), ("y", (0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 0.9))):
        low, high = ax.get_xlim() if axis == "x" else ax.get_ylim()
        shown = [t for t in ticks if low <= t <= high]
        getattr(ax, f"set_{axis}ticks")(shown, [f"{t:g}" for t in shown])
        getattr(ax, f"set_{axis}ticks")([], minor=True)
    ax.set_xlabel("distance [m]")
    ax.set_ylabel("baseline [m]")
    ax.set_title(
        f"Standard deviation in depth: f = {rig.focal_px:g} px, sigma = {rig.sigma_px:g} px, "
        f"{rig.tracks:g} tracks, {rig.window:g} frames"
    )
    return figure


@styled
def fit_quality(fits: Mapping[str, Fit]) -> Figure:
    """Bound and achieved RMS error of every point of the study over what the formulas say, with a band of 15 %."""
    figure = new_figure(3.0)
    axes = figure.subplots(1, len(fits), squeeze=False)[0]
    for ax, (name, fit) in zip(axes, fits.items(), strict=True):
        t, factor = fit.table, fit.quantity.factor
        x = factor * t["formula"].to_numpy(float)
        near = t["near"].to_numpy(bool)
        ends = np.array([x.min() / 1.3, x.max() * 1.3])
        ax.fill_between(ends, ends / (1 + _TRUSTED), ends * (1 + _TRUSTED), color="#dddddd", lw=0, label="±15 %")
        ax.plot(ends, ends, color=TRUTH, lw=0.9)
        ax.plot(x[near], factor * t["rms"][near], marker(0), color=COLORS[0], ms=3, mew=0, label="achieved")
        if not near.all():
            ax.plot(x[~near], factor * t["rms"][~near], marker(6), color=GREY, ms=3, mew=0, label="shape not known")
        ax.plot(x, factor * t["bound"], marker(1), color=COLORS[1], ms=3, mfc="none", mew=0.7, label="Cramér-Rao bound")
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_title(name)
        ax.set_xlabel(f"formula of the bound [{fit.quantity.unit}]")
    axes[0].set_ylabel("study, in the same unit")
    legend(figure, list(axes))
    return figure
