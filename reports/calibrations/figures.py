"""Figures of a calibration: angles of every image, residuals in the image, residuals over time offset."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.calibrations.tables import ANGLES
from reports.calibrations.time_offset import ALL, REFIT
from reports.figures.style import GREY, TRUTH, color, legend, marker, new_figure, styled

Array = np.ndarray
_SYMBOLS = dict(zip(ANGLES, "ωφκ", strict=True))
# Images whose names fit below an axis; of more, every second, third ... is named.
_NAMED = 24
# Share of the image's width that the arrow of a typical residual takes, less where there are more of them than this.
_ARROW, _CROWDED = 0.06, 100
# Headings are told apart to this.
_APPROACH_DEG = 45.0


@styled
def angles(table: pd.DataFrame, images: tuple[str, ...], headings_deg: Float[Array, "m"], reference: str) -> Figure:
    """Boresight angles of every image with their standard deviation, and of all with theirs (Fig. 3.7)."""
    figure = new_figure(6.4)
    axes = figure.subplots(3, 1, sharex=True)
    labels = list(dict.fromkeys(table["estimator"]))
    for ax, name in zip(axes, ANGLES, strict=True):
        part = table[table["name"] == name]
        for i, label in enumerate(labels):
            own = part[part["estimator"] == label]
            _images(ax, own[own["image"] != ""], images, i, label)
            whole = own[own["image"] == ""].iloc[0]
            ax.axhspan(whole["value"] - whole["sigma"], whole["value"] + whole["sigma"], color=color(i), alpha=0.15)
            ax.axhline(whole["value"], color=color(i), lw=1.1, ls=("-", "--", "-.", ":")[i % 4], label=label)
        if reference:
            ax.axhline(part["reference"].iloc[0], color=TRUTH, lw=1, ls=":", label=reference)
        ax.set_ylabel(f"{_SYMBOLS[name]} [deg]")
        ax.margins(x=0.03)
    step = -(-len(images) // _NAMED)
    ticks = np.arange(0, len(images), step)
    names = [f"{PurePosixPath(images[k]).stem}, {round(headings_deg[k]) % 360}°" for k in ticks]
    axes[-1].set_xticks(ticks, names, rotation=40, ha="right", rotation_mode="anchor")
    axes[-1].set_xlabel("image, heading")
    legend(figure, list(axes))
    return figure


def _images(ax: Axes, rows: pd.DataFrame, images: tuple[str, ...], i: int, label: str) -> None:
    if rows.empty:
        return
    at = [images.index(image) for image in rows["image"]]
    style: dict[str, Any] = {"ms": 4, "mew": 0, "elinewidth": 0.9, "color": color(i)}
    ax.errorbar(at, rows["value"], rows["sigma"], fmt=marker(i), label=f"{label}, each", **style)


@styled
def residuals(table: pd.DataFrame, headings_deg: Mapping[str, float], size_px: tuple[int, int]) -> Figure:
    """Residual vectors of all images in one image plane: by navigation, and by the pose adjusted to each image."""
    width, height = size_px
    figure = new_figure(1.3 + 3.1 * height / width)
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    bearing = table["image"].map(headings_deg).to_numpy(float)
    approach = (np.round(bearing / _APPROACH_DEG) * _APPROACH_DEG % 360).astype(int)
    panels = ((("du_px", "dv_px"), "by navigation"), (("du_adjusted_px", "dv_adjusted_px"), "by the adjusted pose"))
    for ax, (columns, title) in zip(axes, panels, strict=True):
        _vectors(ax, table, columns, approach, width)
        ax.set_title(title)
        ax.set_xlim(-0.5, width - 0.5)
        ax.set_ylim(height - 0.5, -0.5)
        ax.set_aspect("equal")
        ax.set_xlabel("u [px]")
    axes[0].set_ylabel("v [px]")
    legend(figure, list(axes))
    return figure


def _vectors(ax: Axes, table: pd.DataFrame, columns: tuple[str, str], approach: Int[Array, "k"], width: int) -> None:
    wrong = table["rejected"].to_numpy(bool)
    uv, d = table[["u_px", "v_px"]].to_numpy(float), table[list(columns)].to_numpy(float)
    good = ~wrong & np.isfinite(d).all(axis=1)
    shown = _round(float(np.sqrt(np.mean(np.sum(d[good] ** 2, axis=1)))))
    scale = shown / (_ARROW * width * min(1.0, (_CROWDED / np.count_nonzero(good)) ** 0.25))
    style: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": scale, "width": 0.004}
    for i, heading in enumerate(np.unique(approach).tolist()):
        own = good & (approach == heading)
        if own.any():
            arrows = ax.quiver(*uv[own].T, *d[own].T, color=color(i), label=f"flown at {heading}°", **style)
    ax.quiverkey(arrows, 0.84, 1.04, shown, f"{shown:g} px", labelpos="E", coordinates="axes", color=TRUTH)
    if wrong.any():
        ax.plot(*uv[wrong].T, "x", color=TRUTH, ms=5, mew=1.0, label="taken for wrong clicks")


def _round(value: float) -> float:
    """The next smaller of 1, 2, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(max(value, 1e-6)))
    return float(max(step * power for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)))


@styled
def time_offset(table: pd.DataFrame, label: str) -> Figure:
    """Residuals over an assumed time offset: of every image, of all, and of all with the boresight adjusted anew."""
    figure = new_figure(3.4)
    ax = figure.subplots()
    for image, part in table.groupby("image", sort=False):
        if image not in (ALL, REFIT):
            ax.plot(part["offset_ms"], part["rms_px"], color=GREY, lw=0.7, alpha=0.7, label="one image")
    for i, image in enumerate((ALL, REFIT)):
        part = table[table["image"] == image]
        style: dict[str, Any] = {"color": color(i), "lw": 2.0, "ls": ("-", "--")[i]}
        name = f"{image}, boresight of {label!r}" if image == ALL else image
        ax.plot(part["offset_ms"], part["rms_px"], label=name, **style)
    ax.axvline(0, color=GREY, lw=0.8)
    ax.set_ylim(bottom=0)
    ax.set_xlabel("exposure after its time tag by [ms]")
    ax.set_ylabel("RMS residual [px]")
    legend(figure, [ax])
    return figure
