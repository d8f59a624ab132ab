"""What a calibration flight needs: errors over images, control points, directions and heights; and what limits it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from reports.figures.style import GREY, color, legend, marker, new_figure, styled
from reports.kozempel.boresight import ADJUSTED, ANGLES, GOAL_DEG, LETTERS, NAVIGATION, nees_band, pooled
from reports.kozempel.log_axis import plain_log
from reports.studies import StudyResult

Array = np.ndarray
_DIRECTIONS = {1: "one direction", 2: "there and back", 4: "four directions"}  # by number of headings
_SIGMA = [f"boresight_sigma_{a}" for a in ANGLES]


def designs(result: StudyResult, column: str = "value") -> pd.DataFrame:
    """Measures of the adjustment with the settings as plain numbers: directions, and heights in words."""
    rows = pooled(result, ADJUSTED, column)
    rows["directions"] = rows["headings_deg"].map(lambda h: _DIRECTIONS.get(len(h), f"{len(h)} directions"))
    rows["heights"] = rows["heights_m"].map(lambda h: " and ".join(f"{v:g}" for v in h) + " m")
    return rows


def meets(rows: pd.DataFrame) -> pd.Series:
    """Whether the stated sigmas of all three angles are within the goal."""
    return pd.Series((rows[_SIGMA].to_numpy(float) <= list(GOAL_DEG.values())).all(axis=1), index=rows.index)


def smallest(result: StudyResult) -> pd.DataFrame:
    """For every navigation, heights and directions: fewest images, then fewest clicks, that meet the goal.

    sigma is the bound of the scene, RMS what the runs gave with its 95 % interval.
    """
    rows, low, high = (designs(result, c) for c in ("value", "ci_low", "ci_high"))
    table = []
    for (navigation, heights, directions), part in rows.groupby(["navigation", "heights", "directions"], sort=False):
        good = part[meets(part)].sort_values(["images", "gcps"])
        best = part.sort_values(_SIGMA[0]).index[0] if good.empty else good.index[0]
        row: dict[str, object] = {
            "navigation": NAVIGATION[str(navigation)],
            "heights": heights,
            "directions": directions,
            "meets the goal": "yes" if len(good) else "none does; the best:",
            "images": rows.loc[best, "images"],
            "control points per image": rows.loc[best, "gcps"],
        }
        for angle in ANGLES:
            q = f"boresight_{angle}"
            sigma, rms = (rows.loc[best, name] for name in (f"boresight_sigma_{angle}", q))
            interval = f"{low.loc[best, q]:.4f} … {high.loc[best, q]:.4f}"
            row[f"{LETTERS[angle]}: sigma; RMS (95 %) [°]"] = f"{sigma:.4f}; {rms:.4f} ({interval})"
        table.append(row)
    return pd.DataFrame(table)


def design_table(result: StudyResult) -> pd.DataFrame:
    """Every design: sigma and RMS of the angles, NEES."""
    rows = designs(result)
    low, high = nees_band(result)
    table = pd.DataFrame(
        {
            "navigation": rows["navigation"].map(NAVIGATION),
            "heights": rows["heights"],
            "directions": rows["directions"],
            "images": rows["images"],
            "control points per image": rows["gcps"],
        }
    )
    for angle in ANGLES:
        table[f"{LETTERS[angle]}, sigma [°]"] = rows[f"boresight_sigma_{angle}"]
        table[f"{LETTERS[angle]}, RMS [°]"] = rows[f"boresight_{angle}"]
    table["NEES"], table["NEES band"] = rows["boresight_nees"], f"{low:.2f} … {high:.2f}"
    table["failed [%]"] = 100 * rows["boresight_failed"]
    return table.reset_index(drop=True)


@styled
def images_figure(result: StudyResult, *, gcps: int = 8, heights: str = "500 m") -> Figure:
    """Sigma (lines) and RMS with interval (marks) over the number of images: columns angles, rows navigation.

    Raises
        ValueError: the study has no designs with so many control points or these heights.
    """
    value, low, high = (designs(result, c) for c in ("value", "ci_low", "ci_high"))
    used = (value["gcps"] == gcps) & (value["heights"] == heights)
    if not used.any():
        raise ValueError(f"gcps, heights: found {gcps} and {heights!r}, which no design of the study has")
    kinds = list(dict.fromkeys(value["navigation"]))
    figure = new_figure(5.6)
    axes = figure.subplots(len(kinds), len(ANGLES), sharex=True, sharey="col", squeeze=False)
    for row, kind in zip(axes, kinds, strict=True):
        for ax, angle in zip(row, ANGLES, strict=True):
            for i, (directions, own) in enumerate(
                value[used & (value["navigation"] == kind)].groupby("directions", sort=False)
            ):
                index = own.sort_values("images").index
                x = value.loc[index, "images"] * 1.07 ** (i - 1)
                ax.plot(x, value.loc[index, f"boresight_sigma_{angle}"], color=color(i), label=str(directions))
                q = f"boresight_{angle}"
                bars = np.abs(np.stack([low.loc[index, q], high.loc[index, q]]) - value.loc[index, q].to_numpy(float))
                ax.errorbar(x, value.loc[index, q], bars, fmt=marker(i), color=color(i), ms=3.5, lw=0.8, capsize=2)
            ax.axhline(GOAL_DEG[angle], color=GREY, lw=0.9, ls=":", label="goal")
            _log_axes(ax, sorted(set(value["images"])))
        row[1].set_title(f"navigation: {NAVIGATION[kind]}", loc="center", fontweight="normal")
        row[0].set_ylabel("error [°]")
    for ax, angle in zip(axes[-1], ANGLES, strict=True):
        ax.set_xlabel(f"{LETTERS[angle]}: images")
    legend(figure, list(axes.flat))
    return figure


def _log_axes(ax: Axes, ticks: Sequence[float]) -> None:
    ax.set(xscale="log", yscale="log", xticks=ticks, xticklabels=[f"{t:g}" for t in ticks])
    ax.xaxis.set_minor_locator(NullLocator())
    plain_log(ax.yaxis)


@styled
def maps_figure(result: StudyResult, *, directions: str = "four directions", navigation: str = "independent") -> Figure:
    """Sigmas over images and control points, a panel per angle and heights; what meets the goal in bold."""
    rows = designs(result)
    rows = rows[(rows["directions"] == directions) & (rows["navigation"] == navigation)]
    heights = list(dict.fromkeys(rows["heights"]))
    figure = new_figure(0.7 + 1.9 * len(heights))
    axes = figure.subplots(len(heights), len(ANGLES), sharex=True, sharey=True, squeeze=False)
    for row, height in zip(axes, heights, strict=True):
        for ax, angle in zip(row, ANGLES, strict=True):
            part = rows[rows["heights"] == height]
            grid = part.pivot_table(index="gcps", columns="images", values=f"boresight_sigma_{angle}")
            _map(ax, grid, GOAL_DEG[angle])
        row[1].set_title(height, loc="center", fontweight="normal")
        row[0].set_ylabel("control points\nper image")
    for ax, angle in zip(axes[-1], ANGLES, strict=True):
        ax.set_xlabel(f"{LETTERS[angle]} [°]: images")
    return figure


def _map(ax: Axes, grid: pd.DataFrame, goal: float) -> None:
    """Values over the goal: white is the goal, blue below, red above."""
    values = grid.to_numpy(float)
    ratio = np.log2(values / goal)
    ax.imshow(ratio, cmap="RdBu_r", vmin=-2, vmax=2, aspect="auto", origin="lower")
    for (i, j), value in np.ndenumerate(values):
        weight = "bold" if value <= goal else "normal"
        c = "white" if abs(ratio[i, j]) > 1.3 else "black"
        ax.text(j, i, f"{value:.4f}", ha="center", va="center", fontsize=6.5, fontweight=weight, color=c)
    ax.set_xticks(range(grid.shape[1]), [str(v) for v in grid.columns])
    ax.set_yticks(range(grid.shape[0]), [str(v) for v in grid.index])
    ax.grid(visible=False)


def noise_table(result: StudyResult) -> pd.DataFrame:
    """Nine images and eight points: sigma and RMS over vibration, clicks, GNSS and navigation."""
    rows = pooled(result, ADJUSTED)
    table = pd.DataFrame(
        {
            "vibration [°]": rows["vibration_deg"],
            "clicks [px]": rows["clicks_px"],
            "GNSS [m]": rows["position_m"],
            "navigation": rows["navigation"].map(NAVIGATION),
        }
    )
    for angle in ANGLES:
        table[f"{LETTERS[angle]}, sigma [°]"] = rows[f"boresight_sigma_{angle}"]
        table[f"{LETTERS[angle]}, RMS [°]"] = rows[f"boresight_{angle}"]
    low, high = nees_band(result)
    table["NEES"], table["NEES band"] = rows["boresight_nees"], f"{low:.2f} … {high:.2f}"
    table["residual [px]"] = rows["boresight_px"]
    return table.reset_index(drop=True)


@styled
def noise_figure(result: StudyResult) -> Figure:
    """Sigma (lines) and RMS with interval (marks) over GNSS: rows angles, columns vibration."""
    value, low, high = (pooled(result, ADJUSTED, c) for c in ("value", "ci_low", "ci_high"))
    shown = ("phi", "kappa")
    vibrations = sorted(set(value["vibration_deg"]))
    figure = new_figure(5.0)
    axes = figure.subplots(len(shown), len(vibrations), sharex=True, sharey="row", squeeze=False)
    for row, angle in zip(axes, shown, strict=True):
        q = f"boresight_{angle}"
        for ax, vibration in zip(row, vibrations, strict=True):
            part = value[value["vibration_deg"] == vibration]
            for i, (kind, clicks) in enumerate(itertools.product(NAVIGATION, sorted(set(value["clicks_px"])))):
                own = part[(part["navigation"] == kind) & (part["clicks_px"] == clicks)]
                index = own.sort_values("position_m").index
                x = value.loc[index, "position_m"] * 1.03 ** (i - 2.5)
                style = "-" if kind == "independent" else "--"
                c = color(sorted(set(value["clicks_px"])).index(clicks))
                label = f"{clicks:g} px, {'new' if kind == 'independent' else 'constant'}"
                ax.plot(x, value.loc[index, f"boresight_sigma_{angle}"], style, color=c, label=label)
                bars = np.abs(np.stack([low.loc[index, q], high.loc[index, q]]) - value.loc[index, q].to_numpy(float))
                ax.errorbar(x, value.loc[index, q], bars, fmt=marker(i), color=c, ms=3, lw=0.7)
            ax.axhline(GOAL_DEG[angle], color=GREY, lw=0.9, ls=":", label="goal")
            _log_axes(ax, sorted(set(value["position_m"])))
        row[0].set_ylabel(f"error of {LETTERS[angle]} [°]")
    for ax, vibration in zip(axes[0], vibrations, strict=True):
        ax.set_title(f"vibration {vibration:g}°", fontweight="normal")
    figure.supxlabel("GNSS, each axis [m]; lines: clicks, and navigation's errors", fontsize=8.5)
    legend(figure, list(axes.flat))
    return figure
