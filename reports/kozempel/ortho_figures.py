"""Figures of the accuracy of ortho images: passes and methods, the budget, errors over the image."""

from __future__ import annotations

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from reports.figures.style import GREY, color, legend, marker, new_figure, styled
from reports.kozempel.ortho import (
    BEST,
    PUBLISHED_IMAGES_PX,
    PUBLISHED_PX,
    budget,
    of,
    pooled,
    settings,
    single,
    systems,
)
from reports.studies import StudyResult

Array = np.ndarray
_LIMITS_PX, _TICKS_PX = (0.02, 90.0), (0.3, 0.5, 1, 2, 5, 10, 20)
_TITLES = {"antar": "ANTAR at {:.0f} m", "argos": "ARGOS at {:.0f} m"}
# (errors, heights, method, what it is called) of the zones and of the vectors.
_LINES = (
    ("all", "srtm", BEST, "all errors"),
    ("vibration", "exact", BEST, "vibration"),
    ("none", "flat", BEST, "flat heights"),
    ("none", "srtm", BEST, "SRTM heights"),
    ("none", "exact", "anchor", "anchor points"),
    ("none", "exact", "forward", "forward projection"),
)
_VECTORS = (
    ("all", "srtm", BEST, "all errors, pixel by pixel"),
    ("none", "flat", BEST, "one height, else known"),
    ("none", "exact", "anchor", "anchor points, all known"),
)


def _title(result: StudyResult, system: str) -> str:
    return _TITLES[system].format(float(of(settings(result), system=system)["height_m"].iloc[0]))


@styled
def passes_figure(result: StudyResult, *, dem: str = "srtm") -> Figure:
    """RMS of single passes by method: mean square and 90 % of the runs; grey: of single images."""
    figure = new_figure(3.4)
    names = systems(result)
    axes = figure.subplots(1, len(names), squeeze=False)[0]
    passes = of(single(result, "ortho_pass"), errors="all", dem=dem)
    images = of(single(result, "ortho_image"), errors="all", dem=dem)
    for ax, system in zip(axes, names, strict=True):
        mine, shown = of(passes, system=system), of(images, system=system)
        for i, method in enumerate(result.estimators):
            _draw_passes(ax, of(mine, estimator=method), i, method)
            low, high = np.quantile(of(shown, estimator=method)["px"], [0.05, 0.95])
            ax.fill_between([i - 0.38, i + 0.38], low, high, color=GREY, alpha=0.15, lw=0, label="90 % of the images")
        if system == "antar":
            ax.axhline(PUBLISHED_PX, color="black", lw=0.9, ls="--", label="the source, all images")
            ax.plot([-0.55] * 2, PUBLISHED_IMAGES_PX, "k_", ms=9, mew=1.3, label="the source, two images")
        ax.set_xticks(range(len(result.estimators)), result.estimators)
        ax.set(title=_title(result, system), ylim=(0, None))
        ax.grid(axis="x", visible=False)
    axes[0].set_ylabel("RMS of check points [px]")
    legend(figure, list(axes))
    return figure


def _draw_passes(ax: Axes, rows: pd.DataFrame, i: int, method: str) -> None:
    """One method's passes side by side."""
    numbers = sorted(set(rows["t_s"]))
    x = i + 0.22 * (np.arange(len(numbers)) - (len(numbers) - 1) / 2)
    found = [of(rows, t_s=k)["px"].to_numpy(float) for k in numbers]
    rms = np.array([np.sqrt(np.mean(v**2)) for v in found])
    bars = np.abs(np.array([np.quantile(v, [0.05, 0.95]) for v in found]).T - rms)
    ax.errorbar(x, rms, bars, color=color(i), fmt=marker(i), ms=4, capsize=2, lw=0.9, label=method)


@styled
def budget_figure(result: StudyResult) -> Figure:
    """What every source costs alone: simulated (bars) and predicted (marks), and all together."""
    figure = new_figure(4.4)
    names = systems(result)
    axes = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for ax, system in zip(axes, names, strict=True):
        table = budget(result, system)
        y = np.arange(len(table))[::-1]
        whole = table["source"].str.startswith("all")
        ax.barh(y[~whole], table["simulated"][~whole], height=0.62, color=color(0), label="simulated, alone")
        ax.barh(y[whole], table["simulated"][whole], height=0.62, color=color(2), label="simulated, together")
        ax.plot(table["predicted"], y, "|", color=color(1), ms=11, mew=2, label="predicted")
        for height, value in zip(y, table["simulated"], strict=True):
            ax.text(
                _LIMITS_PX[1],
                height,
                f"{value:.2g}" if value > 0.01 else "< 0.01",
                ha="right",
                va="center",
                fontsize=7.5,
            )
        if system == "antar":
            ax.axvline(PUBLISHED_PX, color="black", lw=0.9, ls="--", label="the source")
        ax.set(xscale="log", xlim=_LIMITS_PX, xlabel="RMS [px]", title=_title(result, system))
        ax.set_xticks([0.1, 1, 10], ["0.1", "1", "10"])
        ax.set_yticks(y, table["source"])
        ax.grid(axis="y", visible=False)
    legend(figure, list(axes))
    return figure


@styled
def zones_figure(result: StudyResult) -> Figure:
    """RMS over the distance from the middle of the image."""
    figure = new_figure(3.4)
    names = systems(result)
    axes = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    rows = of(pooled(result), quantity="ortho_zone")
    for ax, system in zip(axes, names, strict=True):
        for i, (errors, dem, method, name) in enumerate(_LINES):
            part = of(rows, system=system, errors=errors, dem=dem, estimator=method).sort_values("bin")
            outer = part["bin"].to_numpy(float)
            middle = (outer + np.concatenate([[0.0], outer[:-1]])) / 2
            ax.fill_between(middle, part["px_low"], part["px_high"], color=color(i), alpha=0.2, lw=0)
            ax.plot(middle, part["px"], color=color(i), marker=marker(i), ms=4, label=name)
        ax.set(yscale="log", ylim=(0.3, 25), xlim=(0, 1), title=_title(result, system))
        ax.set_yticks(_TICKS_PX, [f"{v:g}" for v in _TICKS_PX])
        ax.yaxis.set_minor_locator(NullLocator())
        ax.set_xlabel("distance from the middle / half diagonal")
    axes[0].set_ylabel("RMS of check points [px]")
    legend(figure, list(axes))
    return figure


@styled
def vectors_figure(result: StudyResult) -> Figure:
    """Errors over one image (run 0): where the map has what lies at pixels of the image, beside where it is."""
    figure = new_figure(4.9)
    names = systems(result)
    axes = figure.subplots(len(names), len(_VECTORS), squeeze=False)
    for row, system in zip(axes, names, strict=True):
        for ax, (errors, dem, method, name) in zip(row, _VECTORS, strict=True):
            uv, error = _cells(result, system, errors, dem, method)
            longest = float(np.nanmax(np.linalg.norm(error, axis=-1)))
            _draw_vectors(ax, uv, error, longest)
            ax.set_title(f"{name}\nlongest arrow {longest:.1f} px", fontsize=8)
        row[0].set_ylabel(f"{_title(result, system)}\nrow [px]")
    for ax in axes[-1]:
        ax.set_xlabel("column [px]")
    return figure


def _cells(
    result: StudyResult, system: str, errors: str, dem: str, method: str
) -> tuple[Float[Array, "k 2"], Float[Array, "k 2"]]:
    """Pixels of the image and their errors [px of the map], east and north."""
    columns = []
    for axis in "uvxy":
        rows = of(single(result, f"ortho_cell_{axis}"), system=system, errors=errors, dem=dem, estimator=method)
        columns.append(rows.sort_values("t_s")["px" if axis in "xy" else "value"].to_numpy(float))
    return np.stack(columns[:2], axis=-1), np.stack(columns[2:], axis=-1)


def _draw_vectors(ax: Axes, uv: Array, error: Array, longest: float) -> None:
    """North up, as the first pass flies; the longest arrow is as long as columns are apart."""
    scale = longest / (float(np.ptp(uv[:, 0])) / 8)
    ax.quiver(*uv.T, *error.T, angles="uv", scale_units="x", scale=scale, color=color(0), width=0.007, headwidth=4)
    ax.plot(*uv.T, ".", color=GREY, ms=2)
    ax.set_aspect("equal")
    ax.invert_yaxis()
    ax.margins(0.2)
    ax.grid(visible=False)
