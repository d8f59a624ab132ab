"""One look for all figures: sizes, colour-blind safe colours (Okabe and Ito), a legend beneath the title."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any, ParamSpec

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

Array = np.ndarray
P = ParamSpec("P")

WIDTH_IN = 7.2  # column width of a report; text of 8 pt stays legible in print and at 1280 px
TRUTH = "#000000"
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#882255", "#999933")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
OUTLIERS = ("#D55E00", "#CC79A7", "#E69F00", "#882255", "#56B4E9", "#999933")
INLIER = "#00C8A0"
GREY = "#666666"

STYLE: dict[str, Any] = {
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 8.5,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "lines.linewidth": 1.2,
    "svg.fonttype": "none",
    "svg.hashsalt": "pruefstand",
    "pdf.fonttype": 42,
}


def styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Draws in the style of the reports and leaves matplotlib's settings as they were."""

    @wraps(draw)
    def inner(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with mpl.rc_context(STYLE):
            return draw(*args, **kwargs)

    return inner


def new_figure(height_in: float) -> Figure:
    return Figure(figsize=(WIDTH_IN, height_in), layout="constrained")


def color(i: int) -> str:
    return COLORS[i % len(COLORS)]


def marker(i: int) -> str:
    return MARKERS[i % len(MARKERS)]


def legend(figure: Figure, axes: Sequence[Axes]) -> None:
    """One legend for all axes, above them, each label once, the truth first, then the boxes."""
    entries: dict[str, Any] = {}
    for ax in axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    labels = sorted(entries, key=lambda label: 0 if label.startswith("tru") else 1 if label.startswith("box") else 2)
    if labels:
        handles = [entries[label] for label in labels]
        figure.legend(handles, labels, loc="outside upper left", ncols=4, frameon=False, handlelength=1.6)


def robust_limits(spread: Float[Array, "n"], always: Float[Array, "k"]) -> tuple[float, float]:
    """Limits that hold ``always`` and the bulk of ``spread``, so that single blunders do not flatten the plot."""
    spread, always = spread[np.isfinite(spread)], always[np.isfinite(always)]
    inner = np.concatenate([always, np.quantile(spread, [0.04, 0.96])]) if len(spread) else always
    if not len(inner):
        return -1.0, 1.0
    low, high = float(inner.min()), float(inner.max())
    margin = 0.12 * (high - low) or 0.1 * max(abs(high), 1e-3)
    return low - margin, high + margin


def mark_clipped(ax: Axes, x: Float[Array, "n"], y: Float[Array, "n"], c: str) -> None:
    """Triangles at the edge for values beyond the limits: nothing vanishes."""
    low, high = ax.get_ylim()
    for beyond, edge, symbol in ((y > high, high, "^"), (y < low, low, "v")):
        if beyond.any():
            at = np.full(int(beyond.sum()), edge)
            ax.plot(x[beyond], at, symbol, color=c, ms=4, clip_on=False, zorder=5, markeredgewidth=0)
