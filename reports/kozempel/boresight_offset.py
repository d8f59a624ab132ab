"""Residuals over an assumed time offset, beside Fig. 3.8, and what an adjustment finds of the offset."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from reports.figures.style import GREY, TRUTH, color, legend, new_figure, styled
from reports.kozempel.boresight import pooled
from reports.studies import StudyResult

HELD, REFITTED, ADJUSTED = "boresight held", "boresight fitted anew", "offset adjusted"
SOURCE_MINIMUM_MS = -1.0
SOURCE_GOOD_PX, SOURCE_BAD_PX = (0.5, 1.5), (4.0, 7.0)
_COLUMNS = 3


def conditions(result: StudyResult) -> pd.Series:
    """What every point was flown with, in words, in two lines."""
    return result.points.apply(_condition, axis=1)


def _condition(p: pd.Series) -> str:
    heights = " and ".join(f"{h:g}" for h in p["heights_m"])
    flown = f"{heights} m, {len(p['headings_deg'])} directions, " + ("calm air" if p["gusts"] < 0.5 else "gusts")
    wrong = [
        f"offset {1e3 * p['time_offset_s']:g} ms" if p["time_offset_s"] else "",
        f"vibration {p['vibration_deg']:g}°" if p["vibration_deg"] else "",
        f"jitter {1e3 * p['jitter_s']:g} ms" if p["jitter_s"] else "",
        f"GNSS {p['position_m']:g} m",
    ]
    return f"{flown}\n{', '.join(w for w in wrong if w)}"


def offset_table(result: StudyResult) -> pd.DataFrame:
    """Every flight: where the curves are lowest, and the offset as an unknown of the adjustment."""
    held, anew, adjusted = (pooled(result, case) for case in (HELD, REFITTED, ADJUSTED))
    scatter = minima(result, REFITTED).groupby("point", observed=False).std()
    return pd.DataFrame(
        {
            "flight": conditions(result).str.replace("\n", ", "),
            "injected [ms]": 1e3 * result.points["time_offset_s"],
            "lowest, held [ms]": held["offset_minimum"],
            "gain, held [%]": 100 * held["offset_gain"],
            "lowest, fitted anew [ms]": anew["offset_minimum"],
            "its scatter [ms]": scatter.reindex(result.points.index),
            "gain, fitted anew [%]": 100 * anew["offset_gain"],
            "adjusted: RMS error [ms]": adjusted["offset_error"],
            "adjusted: sigma [ms]": adjusted["offset_sigma"],
            "called inseparable from pitch [%]": 100 * adjusted["offset_inseparable"],
            "boresight ω, RMS [°]": adjusted["boresight_omega"],
        }
    ).reset_index(drop=True)


def minima(result: StudyResult, case: str) -> pd.Series:
    """Where the curve of every run is lowest [ms], by point; without those that fall to their end."""
    m = result.measures
    rows = m[(m["estimator"] == case) & (m["quantity"] == "offset_minimum")]
    return rows.set_index("point")["value"]


@styled
def curves_figure(result: StudyResult) -> Figure:
    """RMS over the assumed offset, over all runs, with the middle 95 % of single runs; lowest points marked."""
    names, true = conditions(result), 1e3 * result.points["time_offset_s"]
    rows = -(-len(names) // _COLUMNS)
    figure = new_figure(0.6 + 2.5 * rows)
    axes = figure.subplots(rows, _COLUMNS, sharex=True, sharey=True, squeeze=False).ravel()
    for ax, (point, name) in zip(axes, names.items(), strict=False):
        for i, case in enumerate((HELD, REFITTED)):
            curve = _curves(result, str(point), case)
            rms = np.sqrt((curve**2).mean(axis=0))
            low, high = curve.quantile(0.025), curve.quantile(0.975)
            ax.fill_between(curve.columns, low, high, color=color(i), alpha=0.15, lw=0)
            ax.plot(rms.index, rms, color=color(i), label=case)
            ax.plot(rms.idxmin(), rms.min(), "o", color=color(i), ms=4)
        ax.axvline(true[str(point)], color=TRUTH, lw=0.8, label="true offset")
        ax.set_title(name, fontsize=7, fontweight="normal")
    for ax in axes[len(names) :]:
        ax.set_axis_off()
    axes[0].set_ylim(0, None)
    figure.supxlabel("assumed time offset [ms]", fontsize=8.5)
    figure.supylabel("RMS of the control points [px]", fontsize=8.5)
    legend(figure, list(axes[: len(names)]))
    return figure


def _curves(result: StudyResult, point: str, case: str) -> pd.DataFrame:
    """Runs x assumed offsets."""
    m = result.measures
    rows = m[(m["point"] == point) & (m["estimator"] == case) & (m["quantity"] == "offset_px")]
    return rows.pivot_table(index="run", columns="t_s", values="value")


def of_images(result: StudyResult, point: str, quantity: str) -> pd.Series:
    """RMS of single images of all runs [px]."""
    m = result.measures
    return m[(m["point"] == point) & (m["quantity"] == quantity)]["value"]


def unsteady(result: StudyResult) -> dict[str, str]:
    """The points that might explain the source's residuals: vibration, and jitter of the synchronisation."""
    p = result.points
    return {"vibration": str(p["vibration_deg"].idxmax()), "jitter": str(p["jitter_s"].idxmax())}


@styled
def images_figure(result: StudyResult) -> Figure:
    """Residuals of single images without an offset and with the best one of each image's own."""
    figure = new_figure(3.0)
    axes = figure.subplots(1, 2, sharey=True, sharex=True)
    bins = np.arange(0.0, 14.5, 0.5)
    for ax, (cause, point) in zip(axes, unsteady(result).items(), strict=True):
        for i, (quantity, label) in enumerate(
            (("offset_image_zero_px", "no offset"), ("offset_image_px", "each image's own best"))
        ):
            values = of_images(result, point, quantity)
            share = np.full(len(values), 100 / len(values))
            ax.hist(values, bins, weights=share, color=color(i), alpha=0.55, label=label)
        for j, (limits, said) in enumerate(((SOURCE_GOOD_PX, "some images"), (SOURCE_BAD_PX, "3 of 9 images"))):
            y = 33 + 3 * j
            ax.plot(limits, [y, y], color=GREY, lw=4, solid_capstyle="butt", label="the source, own best")
            ax.text(limits[1], y, f"  {said}", va="center", fontsize=7.5)
        ax.set(title=cause, xlabel="RMS of an image [px]")
    axes[0].set_ylabel("images [%]")
    legend(figure, list(axes))
    return figure
