"""Errors, motion and consistency over time and distance, from tidy tables."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.consistency import DOF, band
from reports.errors import SMOOTHED
from reports.figures.style import GREY, TRUTH, color, legend, mark_clipped, marker, new_figure, robust_limits, styled
from reports.metrics import BIN_M

_PANELS = 3  # side by side at column width


def _online(comparison: pd.DataFrame) -> pd.DataFrame:
    """Rows of the newest frames of the windows, without failures."""
    return comparison[(comparison["entity"] != SMOOTHED) & (comparison["quantity"] != "failure")]


def _each(table: pd.DataFrame) -> Iterator[tuple[int, str, pd.DataFrame]]:
    """Rank, label and rows of every estimator, in order of appearance."""
    for i, (label, rows) in enumerate(table.groupby("estimator", sort=False)):
        yield i, str(label), rows


def _pick(table: pd.DataFrame, quantity: str, axis: str) -> pd.DataFrame:
    rows = table[(table["quantity"] == quantity) & (table["axis"] == axis)]
    return rows.sort_values("t_s")


def _segments(rows: pd.DataFrame) -> list[np.ndarray]:
    """Row numbers of stretches without gaps: a failed frame interrupts a line."""
    t = rows["t_s"].to_numpy(float)
    if len(t) < 2:
        return [np.arange(len(t))]
    step = np.diff(t)
    return np.split(np.arange(len(t)), np.flatnonzero(step > 1.5 * step.min()) + 1)


def _draw(ax: Axes, rows: pd.DataFrame, i: int, label: str, value: str, centre: str | float) -> None:
    """Values over time with the band of three stated sigmas around a column or a constant."""
    t, y = rows["t_s"].to_numpy(float), rows[value].to_numpy(float)
    middle = rows[centre].to_numpy(float) if isinstance(centre, str) else np.full(len(t), centre)
    sigma = rows["sigma"].to_numpy(float)
    for k, part in enumerate(_segments(rows)):
        lower, upper = middle[part] - 3 * sigma[part], middle[part] + 3 * sigma[part]
        if len(part) == 1:
            ax.vlines(t[part], lower, upper, color=color(i), alpha=0.3, lw=1.5)
        ax.fill_between(t[part], lower, upper, color=color(i), alpha=0.16, lw=0)
        for edge in (lower, upper):
            ax.plot(t[part], edge, "-", color=color(i), lw=0.5, alpha=0.5)
        ax.plot(t[part], y[part], "-", color=color(i), lw=0.9, alpha=0.7)
        ax.plot(t[part], y[part], marker(i), color=color(i), ms=2.6, mew=0, label=label if k == 0 else None)


def _limit(ax: Axes, table: pd.DataFrame, value: str, always: np.ndarray, band_around: str | float) -> None:
    """Limits for the bulk of the values and of the bands, and marks for what lies beyond."""
    middle = table[band_around] if isinstance(band_around, str) else band_around
    reach = np.concatenate([(middle + s * table["sigma"]).to_numpy(float) for s in (-3, 3)])
    reach = reach[np.isfinite(reach)]
    values = table[value].to_numpy(float)
    bulk = np.quantile(reach, [0.15, 0.85]) if len(reach) else np.zeros(0)
    ax.set_ylim(*robust_limits(values, np.concatenate([always, bulk])))
    for i, _, rows in _each(table):
        mark_clipped(ax, rows["t_s"].to_numpy(float), rows[value].to_numpy(float), color(i))


@styled
def trajectory(comparison: pd.DataFrame) -> Figure:
    """The path seen from above, and the position error of every frame with its ±3σ band.

    comparison: the table of `reports.errors.comparison_table`, of any number of estimators.
    """
    online = _online(comparison)
    figure = new_figure(6.4)
    axes = figure.subplots(4, 1, height_ratios=[1.35, 1, 1, 1])
    _path(axes[0], online)
    for ax, axis, name in zip(axes[1:], "xyz", ("x, right", "y, down", "z, forward"), strict=True):
        rows = _pick(online, "position", axis)
        ax.axhline(0, color=TRUTH, lw=0.9)
        for i, label, part in _each(rows):
            _draw(ax, part, i, label, "error", 0.0)
        _limit(ax, rows, "error", np.zeros(1), 0.0)
        ax.set_ylabel("error [m]")
        ax.set_title(f"Position error {name}")
        ax.sharex(axes[-1])
        ax.tick_params(labelbottom=axis == "z")
    axes[-1].set_xlabel("time [s]")
    legend(figure, list(axes))
    return figure


def _path(ax: Axes, online: pd.DataFrame) -> None:
    x_true, z_true = (_pick(online, "position", axis).drop_duplicates("t_s")["truth"].to_numpy(float) for axis in "xz")
    ax.plot(z_true, x_true, "-", color=TRUTH, lw=1.4, label="truth", zorder=2.5)
    for i, label, rows in _each(online):
        x, z = _pick(rows, "position", "x"), _pick(rows, "position", "z")
        ax.errorbar(
            z["estimate"],
            x["estimate"],
            xerr=3 * z["sigma"].to_numpy(float),
            yerr=3 * x["sigma"].to_numpy(float),
            fmt=marker(i),
            color=color(i),
            ms=2.8,
            mew=0,
            elinewidth=0.5,
            alpha=0.75,
            label=label,
        )
    x_all = _pick(online, "position", "x")["estimate"].to_numpy(float)
    low, high = robust_limits(x_all, x_true)
    middle, half = (low + high) / 2, max((high - low) / 2, 0.5)
    ax.set_ylim(middle - half, middle + half)
    ax.set_xlabel("z, forward [m]")
    ax.set_ylabel("x, right [m]")
    ax.set_title("Path of the tracked points' centroid from above, left camera frame")


@styled
def velocity(comparison: pd.DataFrame, reference: str) -> Figure:
    """Velocity of the reference point, speed and yaw rate with truth, estimate and ±3σ.

    reference: what speed and yaw rate refer to, "over ground" or "relative".
    """
    online = _online(comparison)
    figure = new_figure(4.8)
    axes = figure.subplots(2, 2, sharex=True)
    panels = (
        ("velocity", "x", "m/s", "Velocity x, right, relative"),
        ("velocity", "z", "m/s", "Velocity z, forward, relative"),
        ("speed", "all", "m/s", f"Speed, {reference}"),
        ("yaw_rate", "all", "deg/s", f"Yaw rate, {reference}"),
    )
    for ax, (quantity, axis, unit, title) in zip(axes.flat, panels, strict=True):
        rows = _pick(online, quantity, axis)
        if unit == "deg/s":
            rows = rows.assign(**{c: np.rad2deg(rows[c].astype(float)) for c in ("truth", "estimate", "sigma")})
        for i, label, part in _each(rows):
            _draw(ax, part, i, label, "estimate", "estimate")
        true = rows.drop_duplicates("t_s")
        ax.plot(true["t_s"], true["truth"], "-", color=TRUTH, lw=1.4, label="truth", zorder=2.5)
        _limit(ax, rows, "estimate", true["truth"].to_numpy(float), "estimate")
        ax.set_title(title)
        ax.set_ylabel(f"[{unit}]")
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    legend(figure, list(axes.flat))
    return figure


@styled
def depth_error(comparison: pd.DataFrame) -> Figure:
    """Depth error of every window over the true distance, with stated ±3σ, three bounds and the bias per 10 m bin."""
    rows = _pick(_online(comparison), "position", "z")
    labels = list(dict.fromkeys(rows["estimator"]))
    columns = min(_PANELS, max(1, len(labels)))
    lines = max(1, -(-len(labels) // columns))
    figure = new_figure(0.5 + 2.5 * lines)
    axes = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    reach = np.concatenate([3 * rows["bound"].to_numpy(float), -3 * rows["bound"].to_numpy(float)])
    limits = robust_limits(rows["error"].to_numpy(float), np.append(reach[np.isfinite(reach)], 0.0))
    for ax in axes.flat[len(labels) :]:
        ax.set_visible(False)
    for ax, (i, label, part) in zip(axes.flat, _each(rows), strict=False):
        _depth_panel(ax, part.sort_values("distance_m"), i, limits)
        ax.set_title(label)
    for ax in axes[-1]:
        ax.set_xlabel("true distance z [m]")
    for ax in axes[:, 0]:
        ax.set_ylabel("depth error [m]")
    legend(figure, list(axes.flat))
    return figure


def _depth_panel(ax: Axes, rows: pd.DataFrame, i: int, limits: tuple[float, float]) -> None:
    d, error = rows["distance_m"].to_numpy(float), rows["error"].to_numpy(float)
    sigma, bound = rows["sigma"].to_numpy(float), rows["bound"].to_numpy(float)
    ax.axhline(0, color=TRUTH, lw=0.9)
    ax.fill_between(d, -3 * sigma, 3 * sigma, color=color(i), alpha=0.16, lw=0, label="±3σ stated")
    for side, label in ((-3, None), (3, "±3 Cramér-Rao bounds")):
        ax.plot(d, side * bound, "--", color=GREY, lw=0.9, label=label)
    ax.plot(d, error, marker(i), color=color(i), ms=3, mew=0, alpha=0.8)
    lower = np.floor(d / BIN_M) * BIN_M
    for k, start in enumerate(np.unique(lower)):
        inside = lower == start
        ends = [max(start, d[inside].min()), min(start + BIN_M, d[inside].max())]
        label = f"mean per {BIN_M:.0f} m" if k == 0 else None
        ax.plot(ends, [error[inside].mean()] * 2, "-", color=TRUTH, lw=2.2, solid_capstyle="butt", label=label)
    ax.set_ylim(*limits)
    mark_clipped(ax, d, error, color(i))


@styled
def nees(table: pd.DataFrame) -> Figure:
    """NEES over its degrees of freedom for every window, with the 99 % chi-square band of a single window.

    table: `reports.consistency.nees_table`; disjoint windows, the independent ones, are drawn large.
    """
    figure = new_figure(3.9)
    axes = figure.subplots(2, 1, sharex=True)
    titles = {"pose": "Pose: centroid and rotation", "velocity": "Velocity of the reference point and angular rate"}
    low, high = band(DOF, 1)
    for ax, (quantity, title) in zip(axes, titles.items(), strict=True):
        ax.axhspan(low, high, color="#e4e4e4", lw=0, label="99 % chi-square band of one window")
        ax.axhline(1, color=TRUTH, lw=0.9)
        for i, label, part in _each(table):
            rows = part[part["quantity"] == quantity]
            t, y = rows["t_s"].to_numpy(float), rows["nees"].to_numpy(float) / DOF
            independent = rows["disjoint"].to_numpy(bool)
            ax.plot(t, y, marker(i), color=color(i), ms=2.4, mew=0, alpha=0.6)
            ax.plot(
                t[independent], y[independent], marker(i), color=color(i), ms=5.5, mec="white", mew=0.6, label=label
            )
        ax.set_yscale("log")
        ax.set_ylabel("NEES / 6")
        ax.set_title(title)
    axes[-1].set_xlabel("time [s]")
    legend(figure, list(axes))
    return figure
