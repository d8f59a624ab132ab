"""Figures of a faulty road map: how far it is off, and what its mask holds over the margin."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.figures.style import GREY, color, legend, marker, new_figure, styled
from reports.kozempel.ortho import of
from reports.kozempel.road import (
    MARGIN_M,
    PUBLISHED_MAX_M,
    PUBLISHED_MEAN_M,
    networks,
    pooled,
    single,
    views,
)
from reports.studies import StudyResult
from sim.roads import SECTIONS


@styled
def displacement_figure(result: StudyResult) -> Figure:
    """Displacements of all nodes of the map, and mean and largest of ten of them, beside the source's ten."""
    figure = new_figure(3.2)
    left, right = figure.subplots(1, 2)
    beyond = of(single(result, "road_beyond"), displacement_m=PUBLISHED_MEAN_M).groupby("t_s")["value"].mean()
    lengths, share = beyond.index.to_numpy(float), beyond.to_numpy(float)
    left.stairs(-100 * np.diff(share), lengths, fill=True, color=color(0), alpha=0.6, label="nodes of our maps")
    left.axvline(PUBLISHED_MEAN_M, color="black", ls="--", lw=1, label="the source: mean of ten")
    left.axvline(PUBLISHED_MAX_M, color="black", ls=":", lw=1.2, label="the source: largest of ten")
    left.set(xlabel="displacement [m]", ylabel="nodes [%]", title="All nodes")
    mean = of(single(result, "road_displacement"), displacement_m=PUBLISHED_MEAN_M)
    largest = of(single(result, "road_displacement_max"), displacement_m=PUBLISHED_MEAN_M)
    for i, network in enumerate(networks(result)):
        x, y = (of(t, network=network).sort_values("run")["value"] for t in (mean, largest))
        right.plot(x, y, marker(i), color=color(i), ms=4, alpha=0.75, label=network)
    right.plot(PUBLISHED_MEAN_M, PUBLISHED_MAX_M, "k*", ms=13, label="the source")
    right.set(xlabel="mean of ten nodes [m]", ylabel="largest of ten nodes [m]", title="Ten nodes of every map")
    right.set(xlim=(0, None), ylim=(0, None))
    legend(figure, [left, right])
    return figure


# (map, how images are oriented: index into `views`, what it is called).
_LINES = (("exact", 0, "right map"), ("exact", 1, "right map"), ("all", 0, "faulty map"), ("all", 1, "faulty map"),
          ("all", 2, "faulty map"))  # fmt: skip


@styled
def margins_figure(result: StudyResult) -> Figure:
    """Above: vehicles that are inside the mask as a whole; below: mask where no road is; over the margin."""
    figure = new_figure(5.0)
    names, seen = networks(result), views(result)
    axes = figure.subplots(2, len(names), sharex=True, sharey="row", squeeze=False)
    rows = pooled(result)
    for column, network in zip(axes.T, names, strict=True):
        for i, (case, view, name) in enumerate(_LINES):
            mine = of(rows, network=network, estimator=case, view=seen[view])
            label = f"{name}, {seen[view].split()[0]}"
            for ax, quantity in zip(column, ("road_whole_vehicles", "road_excess"), strict=True):
                _draw(ax, of(mine, quantity=quantity), i, label)
        column[0].set_title(network)
    axes[0, 0].set_ylabel("whole vehicles inside [%]")
    axes[1, 0].set_ylabel("mask without a road [%]")
    figure.supxlabel("margin on both sides of the RAS-Q width [m]", fontsize=8.5)
    legend(figure, list(axes.flat))
    return figure


@styled
def classes_figure(result: StudyResult) -> Figure:
    """Pavement inside the mask of the faulty map by class of the road, over the margin, orientation of ANTAR."""
    figure = new_figure(3.2)
    names = networks(result)
    axes = figure.subplots(1, len(names), sharex=True, sharey=True, squeeze=False)[0]
    rows = of(pooled(result), estimator="all", view=views(result)[1])
    for ax, network in zip(axes, names, strict=True):
        for k, section in enumerate(SECTIONS):
            mine = of(rows, network=network, quantity=f"road_pavement_{k}")
            if len(mine):
                _draw(ax, mine, k, f"class {k}, {section.name}")
        ax.set_title(network)
    axes[0].set_ylabel("pavement inside [%]")
    figure.supxlabel("margin on both sides of the RAS-Q width [m]", fontsize=8.5)
    legend(figure, list(axes)[::-1])  # the mixed network has all classes
    return figure


def _draw(ax: Axes, rows: pd.DataFrame, i: int, label: str) -> None:
    rows = rows.sort_values("bin")
    ax.fill_between(rows["bin"], 100 * rows["ci_low"], 100 * rows["ci_high"], color=color(i), alpha=0.15, lw=0)
    ax.plot(rows["bin"], 100 * rows["value"], color=color(i), marker=marker(i), ms=4, label=label)
    ax.axvline(MARGIN_M, color=GREY, lw=0.8, ls=":")
