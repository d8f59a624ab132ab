"""Statistics over the parameters of a study: lines with interval bars, and maps over two parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.colors import LogNorm, Normalize, SymLogNorm
from matplotlib.figure import Figure

from reports.figures.style import GREY, color, legend, marker, new_figure, styled

_PANEL_IN = 2.6
_DASHES = ("--", ":", "-.")


@styled
def sweep_lines(
    table: pd.DataFrame,
    x: str,
    labels: tuple[str, str],
    *,
    bound: pd.DataFrame | None = None,
    log_x: bool = False,
    log_y: bool = False,
) -> Figure:
    """One line per ``line`` of a table (line, x, value, ci_low, ci_high) with interval bars.

    bound (line, x, value) is drawn dashed; x is the column of the parameter; labels are those of the axes.
    """
    figure = new_figure(3.2)
    ax = figure.add_subplot()
    for i, (line, part) in enumerate(table.groupby("line", sort=False)):
        rows = part.sort_values(x)
        known = rows["ci_low"].notna()
        bars = np.abs(rows[["ci_low", "ci_high"]].to_numpy(float).T - rows["value"].to_numpy(float))
        ax.plot(rows[x], rows["value"], color=color(i), marker=marker(i), ms=4, label=str(line))
        ax.errorbar(
            rows[x][known], rows["value"][known], bars[:, known], fmt="none", ecolor=color(i), capsize=2, lw=0.9
        )
    if bound is not None:
        for i, (line, part) in enumerate(bound.groupby("line", sort=False)):
            rows = part.sort_values(x)
            label = ", ".join(filter(None, ["Cramér-Rao bound", str(line)]))
            ax.plot(rows[x], rows["value"], color=GREY, ls=_DASHES[i % len(_DASHES)], label=label)
    if log_x:
        ax.set_xscale("log")
    if log_y:
        ax.set_yscale("log")
    elif (table["value"] < 0).any() and (table["value"] > 0).any():
        ax.axhline(0, color="black", lw=0.7)
    ax.set(xlabel=labels[0], ylabel=labels[1])
    legend(figure, [ax])
    return figure


@styled
def sweep_map(
    table: pd.DataFrame, x: str, y: str, labels: tuple[str, str, str], panels: Sequence[str], log: bool = False
) -> Figure:
    """A statistic over two parameters, one panel per estimator, every cell with its number; one scale for all.

    Columns estimator, x, y and value; labels are those of both axes and of the scale, which is blue below and red above
    zero where the statistic has a sign.
    """
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    xs, ys = np.unique(table[x]), np.unique(table[y])
    figure = new_figure(0.5 + rows * min(_PANEL_IN, 0.9 + 0.3 * len(ys)))
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    norm, cmap = _scale(table["value"].to_numpy(float), log)
    largest = float(table["value"].abs().max())
    digits = max(0, 2 - int(np.floor(np.log10(largest)))) if largest > 0 else 0
    image = None
    for ax, panel in zip(axes.flat, panels, strict=False):
        part = table[table["estimator"] == panel]
        grid = part.pivot_table(index=y, columns=x, values="value").reindex(index=ys, columns=xs).to_numpy()
        image = ax.imshow(grid, origin="lower", aspect="auto", norm=norm, cmap=cmap)
        for i, j in np.argwhere(np.isfinite(grid)):
            r, g, b, _ = image.cmap(norm(grid[i, j]))
            dark = 0.3 * r + 0.6 * g + 0.1 * b < 0.5
            text = f"{grid[i, j]:.{digits}f}".replace("-", "−")
            ax.text(j, i, text, ha="center", va="center", fontsize=6.5, color="white" if dark else "black")
        ax.set_title(panel)
        ax.set_xticks(range(len(xs)), [f"{v:g}" for v in xs])
        ax.set_yticks(range(len(ys)), [f"{v:g}" for v in ys])
        ax.grid(False)
    for ax in axes.flat[len(panels) :]:
        ax.set_axis_off()
    figure.supxlabel(labels[0], fontsize=8.5)
    figure.supylabel(labels[1], fontsize=8.5)
    if image is not None:
        figure.colorbar(image, ax=axes, label=labels[2], shrink=0.9)
    return figure


def _scale(values: np.ndarray, log: bool) -> tuple[Normalize, str]:
    values = values[np.isfinite(values)]
    if log and len(values) and values.min() > 0:
        return LogNorm(values.min(), values.max()), "viridis"
    if len(values) and values.min() < 0:
        reach = float(np.abs(values).max())
        return SymLogNorm(reach / 20, vmin=-reach, vmax=reach), "RdBu_r"
    return Normalize(0, float(values.max()) if len(values) else 1), "viridis"
