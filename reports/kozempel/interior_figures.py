"""Figures of the calibration wall: errors over images and tilt, and over the image."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from estimators.aerial.image_error import image_rays
from reports.figures.style import GREY, color, legend, marker, new_figure, styled
from reports.kozempel.interior import (
    CORNERS_PX,
    ENOUGH_PX,
    chosen,
    iteration_errors,
    left_field,
    lens_field,
    over_points,
    own_corner_px,
    reduced_field,
    true_camera,
)
from reports.studies import StudyResult

Array = np.ndarray
_USUAL_TILT, _USUAL_IMAGES = 30, 12
_EVERY = 2  # arrows of a field


@styled
def design_figure(result: StudyResult) -> Figure:
    """Focal length and error over the image, true (marks) and formal (lines), over the images' number and tilt."""
    figure = new_figure(4.8)
    axes = figure.subplots(2, 2, sharex="col", sharey="row")
    rows = over_points(result).sort_values(["tilt_deg", "images"])
    series = (
        (axes[:, 0], "images", rows[rows["tilt_deg"] == _USUAL_TILT], f"images, tilted by {_USUAL_TILT}°"),
        (axes[:, 1], "tilt_deg", rows[rows["images"] == _USUAL_IMAGES], f"tilt of {_USUAL_IMAGES} images [°]"),
    )
    for column, key, part, label in series:
        for ax, quantity in zip(column, ("f", "image"), strict=True):
            _draw_series(ax, part, key, quantity)
            ax.set(xscale="log", yscale="log")
            ticks = sorted(set(part[key].astype(float)))
            ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
            ax.minorticks_off()
            ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            ax.yaxis.set_major_formatter("{x:g}")
        column[1].set_xlabel(label)
    axes[0, 0].set_ylabel("focal length [px]")
    axes[1, 0].set_ylabel("direction over the image [px]")
    legend(figure, list(axes.flat))
    return figure


def _draw_series(ax: Axes, part: pd.DataFrame, key: str, quantity: str) -> None:
    photographed = part["photographs"].astype(bool)
    for i, (wall, deep) in enumerate((("flat wall", False), ("deep wall", True))):
        mine = (part["depth_m"] > 0) == deep
        measured, pictures = part[mine & ~photographed], part[mine & photographed]
        ax.plot(measured[key], measured[f"{quantity}_sigma"], color=color(i), lw=1, label=f"{wall}, sigma")
        true = measured[f"{quantity}_error"]
        ax.plot(measured[key], true, marker(i), color=color(i), ms=4.5, label=f"{wall}, RMS")
        seen = pictures[f"{quantity}_error"]
        ax.plot(pictures[key], seen, "x", color=color(i), ms=7, mew=1.6, label=f"{wall}, photos")


@styled
def field_figure(result: StudyResult) -> Figure:
    """The lens over the image, what using K1 and K2 alone loses, and what a calibration leaves."""
    figure = new_figure(3.0)
    axes = figure.subplots(1, 3, sharey=True)
    camera = true_camera(result)
    rays = image_rays(camera)
    uv = camera.project(rays)
    side = round(np.sqrt(len(uv)))
    pick = np.arange(len(uv)).reshape(side, side)[::_EVERY, ::_EVERY].ravel()
    fields = (("Lens", lens_field(camera)), ("Lost with K₁, K₂ only", reduced_field(camera)))
    for ax, (title, d) in zip(axes, fields, strict=False):
        largest = float(np.linalg.norm(d, axis=1).max())
        ax.quiver(
            *uv[pick].T, *d[pick].T, angles="xy", scale_units="xy", scale=largest / 110, width=0.006, color=color(0)
        )
        ax.set_title(f"{title}:\nup to {largest:.2g} px")
    left = left_field(result, chosen(result)).reshape(side, side)
    steps = np.geomspace(left.min(), left.max(), 9)
    levels = axes[2].contourf(uv[:side, 0], uv[::side, 1], left, steps, norm="log", cmap="viridis")
    axes[2].set_title("Left by calibration:\nRMS")
    figure.colorbar(levels, ax=axes[2], label="px", shrink=0.8, ticks=steps[::2], format="%.3f")
    w, h = camera.size_px
    for ax in axes:
        ax.set(xlim=(-60, w + 60), ylim=(h + 60, -60), aspect="equal", xlabel="column [px]", xticks=[0, 512, 1023])
        ax.grid(False)
    axes[0].set(ylabel="row [px]", yticks=[0, 512, 1023])
    return figure


@styled
def iteration_figure(result: StudyResult) -> Figure:
    """Error of the distorted coordinates over the iterations of 3.2, for lenses of more and less distortion."""
    figure = new_figure(3.1)
    ax = figure.subplots()
    camera = true_camera(result)
    for i, corner in enumerate(sorted({*CORNERS_PX, round(own_corner_px(camera), 1)})):
        left = iteration_errors(camera, corner)
        ax.plot(
            np.arange(len(left)), left, color=color(i), marker=marker(i), ms=4, label=f"{corner:g} px in the corner"
        )
    ax.axhline(ENOUGH_PX, color=GREY, lw=0.9, ls="--", label=f"{ENOUGH_PX:g} px")
    ax.axvline(2, color=GREY, lw=0.9, ls=":", label="the source's two")
    ax.set(yscale="log", ylim=(1e-6, None), xlabel="iterations", ylabel="largest error over the image [px]")
    legend(figure, [ax])
    return figure
