"""Figures of a recording: images with tracks, motion over time, epipolar errors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from jaxtyping import UInt8
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimators.estimate import TrajectoryEstimate
from reports.figures.style import GREY, INLIER, OUTLIERS, TRUTH, color, legend, marker, new_figure, styled
from reports.recordings.run import Followed
from sim.observations import Tracks

Array = np.ndarray
_MARGIN = 0.6  # of the box, around it
# Column, its sigma, a reference, label.
_CAMERA = (
    ("distance_m", "distance_sigma_m", "true_distance_m", "way per frame [m]"),
    ("rotation_deg", "rotation_sigma_deg", "true_rotation_deg", "rotation per frame [deg]"),
    ("sigma_0", None, None, "sigma_0"),
)
_VEHICLE = (
    ("distance_m", "distance_sigma_m", "matched_distance_m", "distance [m]"),
    ("speed_mps", "speed_sigma_mps", "matched_speed_mps", "speed [m/s]"),
    ("sigma_0", None, None, "sigma_0"),
)
_BINS = (12, 5)  # of the image, across and down
_FEWEST = 5


@styled
def motion(motions: pd.DataFrame, of_vehicle: bool, reference: str) -> Figure:
    """Motion over time with three standard deviations, beside what it is held against."""
    rows = _VEHICLE if of_vehicle else _CAMERA
    figure = new_figure(0.5 + 1.9 * len(rows))
    axes = figure.subplots(len(rows), 1, sharex=True)
    labels = list(dict.fromkeys(motions["estimator"]))
    for ax, (column, sigma, held, title) in zip(axes, rows, strict=True):
        if held in motions:
            first = motions[motions["estimator"] == labels[0]]
            ax.plot(first["t_s"], first[held], color=TRUTH, lw=1.4, label=reference)
        for i, label in enumerate(labels):
            part = motions[motions["estimator"] == label]
            spread = None if sigma is None else 3 * part[sigma]
            ax.errorbar(
                part["t_s"],
                part[column],
                spread,
                fmt=marker(i),
                ms=3,
                mew=0,
                elinewidth=0.8,
                color=color(i),
                label=label,
            )
        ax.set_ylabel(title)
    axes[-1].axhline(1, color=GREY, lw=0.8)
    axes[-1].set_xlabel("time [s]")
    legend(figure, list(axes))
    return figure


@styled
def strip(
    images: Mapping[int, UInt8[Array, "h w 3"]], tracks: Tracks, estimate: TrajectoryEstimate | None, followed: Followed
) -> Figure:
    """Left images with tracks that took part, tracks left out as outliers, and the followed box; around it, if any."""
    n = max(len(images), 1)
    columns = 2
    figure = new_figure(0.5 + 1.55 * -(-n // columns))
    axes = figure.subplots(-(-n // columns), columns, squeeze=False).ravel()
    newest = {} if estimate is None else {int(w.frames[-1]): w for w in estimate.windows}
    for ax, (frame, image) in zip(axes, images.items(), strict=False):
        ax.imshow(image, interpolation="antialiased")
        here = tracks.frame == frame
        window = newest.get(frame)
        out = np.isin(tracks.track[here], window.rejected) if window is not None else np.zeros(here.sum(), bool)
        uv = tracks.uv_left[here]
        ax.plot(*uv[~out].T, ".", color=INLIER, ms=2.5, mew=0, label="tracks")
        ax.plot(*uv[out].T, "x", color=OUTLIERS[0], ms=3, mew=0.7, label="taken for outliers")
        ax.set_title(f"frame {frame}")
        _frame_box(ax, followed, frame, image.shape)
    for ax in axes:
        ax.set_axis_off()
    legend(figure, list(axes))
    return figure


def _frame_box(ax: Axes, followed: Followed, frame: int, shape: tuple[int, ...]) -> None:
    ax.set_xlim(0, shape[1])
    ax.set_ylim(shape[0], 0)
    if frame >= len(followed.box) or not np.isfinite(followed.box[frame]).all():
        return
    x0, y0, x1, y1 = followed.box[frame]
    ax.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], "-", color=color(4), lw=1, label="box, followed")
    grown = _MARGIN * max(x1 - x0, y1 - y0)
    ax.set_xlim(max(x0 - grown, 0), min(x1 + grown, shape[1]))
    ax.set_ylim(min(y1 + grown / 2, shape[0]), max(y0 - grown / 2, 0))


@styled
def epipolar(errors: pd.DataFrame, size_px: tuple[int, int]) -> Figure:
    """Distances from the epipolar lines: their distribution, and their median by place in the image."""
    figure = new_figure(2.6)
    left, right = figure.subplots(1, 2, width_ratios=[1, 1.7])
    values = errors["error_px"].to_numpy(float)
    reach = float(np.quantile(np.abs(values), 0.98)) if len(values) else 1.0
    left.hist(np.clip(values, -reach, reach), bins=60, color=color(0))
    left.axvline(float(np.median(values)) if len(values) else 0, color=TRUTH, lw=1)
    left.set_xlabel("distance from the epipolar line [px]")
    left.set_ylabel("observations")
    grid = _by_place(errors, size_px)
    limit = float(np.nanmax(np.abs(grid))) if np.isfinite(grid).any() else 1.0
    image = right.imshow(
        grid, cmap="RdBu_r", vmin=-limit, vmax=limit, extent=(0, size_px[0], size_px[1], 0), aspect="equal"
    )
    right.grid(visible=False)
    right.set_xlabel("u [px]")
    right.set_ylabel("v [px]")
    figure.colorbar(image, ax=right, label="median [px]", shrink=0.8)
    return figure


def _by_place(errors: pd.DataFrame, size_px: tuple[int, int]) -> Array:
    column = (errors["u"].to_numpy(float) / size_px[0] * _BINS[0]).astype(int).clip(0, _BINS[0] - 1)
    row = (errors["v"].to_numpy(float) / size_px[1] * _BINS[1]).astype(int).clip(0, _BINS[1] - 1)
    grid = np.full(_BINS[::-1], np.nan)
    values = errors["error_px"].to_numpy(float)
    for i in range(_BINS[1]):
        for j in range(_BINS[0]):
            here = values[(row == i) & (column == j)]
            if len(here) >= _FEWEST:
                grid[i, j] = np.median(here)
    return grid
