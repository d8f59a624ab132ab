"""The structure of the matrices of an adjustment: where they are not zero, Siegemund 2008, Appendix C."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from estimators.bordered import BorderedSystem, Sparse
from reports.figures.style import COLORS, GREY, WIDTH_IN, styled

Array = np.ndarray
Name = Literal["C_ll", "A", "H", "N"]
MATRICES: tuple[Name, ...] = ("C_ll", "A", "H", "N")
_TITLES = {
    "C_ll": "Covariance matrix $C_{ll}$",
    "A": "Design matrix $A$",
    "H": "Condition matrix $H$",
    "N": "Normal matrix $N$",
}
_COLORS = {"base": COLORS[0], "smoothing": COLORS[1], "axis": COLORS[2], "tied": COLORS[3]}
_MEANING = {
    "base": "observations and datum",
    "smoothing": "smooth motion",
    "axis": "known axis of rotation",
    "tied": "frames tied to the last window",
}
_PANEL_IN = (2.75, 1.6)
_GRID = 900  # cells per axis that can be told apart; dots of a larger matrix fall together
_VECTOR_DOTS = 3000
_LEAST_DOT_PT = 0.55
_LEAST_SINGLE_PT = 1.2  # where the dots are few
_NARROW = 0.15  # share of an axis that leaves a name no room in its middle


@dataclass(frozen=True, eq=False)
class _Matrix:
    """Entries (rows and columns) by what they come from, and the names of groups of rows and columns."""

    shape: tuple[int, int]
    entries: dict[str, tuple[Int[Array, "e"], Int[Array, "e"]]]
    rows: list[tuple[str, slice]]
    columns: list[tuple[str, slice]]


@styled
def structure(small: BorderedSystem, large: BorderedSystem, names: Sequence[Name] = MATRICES) -> Figure:
    """Two examples side by side, a matrix in every row: dots where an entry is not zero, their number nz beneath.

    What smoothing and known rotation axes add has a colour of its own; groups of rows and columns are named.
    """
    width, height = _PANEL_IN
    figure = Figure(figsize=(WIDTH_IN, 0.4 + len(names) * (height + 0.75)), layout="constrained")
    axes = figure.subplots(len(names), 2, squeeze=False)
    used: set[str] = set()
    for name, row in zip(names, axes, strict=True):
        for ax, system in zip(row, (small, large), strict=True):
            matrix = _matrix(system, name)
            used |= {part for part, (i, _) in matrix.entries.items() if len(i)}
            _panel(ax, matrix, (width * 72, height * 72))
            ax.set_title(_size(system), pad=15, loc="right", fontweight="normal")
        row[0].set_title(_TITLES[name], pad=15)
    handles = [
        Line2D([], [], ls="", marker="s", ms=4, mew=0, color=_COLORS[part], label=_MEANING[part])
        for part in _COLORS
        if part in used
    ]
    figure.legend(handles=handles, loc="outside upper left", ncols=4, frameon=False, handlelength=1, columnspacing=1)
    return figure


def _size(system: BorderedSystem) -> str:
    observations = system.rows["observations"].stop // 3
    about = "" if observations == system.n * system.m else "about "
    return f"{about}{observations / system.m:.0f} points, {system.m} frames"


def _matrix(system: BorderedSystem, name: Name) -> _Matrix:
    p = 3 * system.n
    unknowns = [("points", slice(0, p)), ("poses", slice(p, p + 6 * system.m))]
    rows, columns = list(system.rows.items()), list(system.conditions.items())
    if name == "C_ll":
        return _Matrix(system.C_ll.shape, _by_row(system.C_ll, rows), rows, rows)
    if name == "A":
        return _Matrix(system.A.shape, _by_row(system.A, rows), rows, unknowns)
    if name == "H":
        by_column = _by_row(Sparse(system.H.T), columns)
        return _Matrix(system.H.shape, {part: (i, j) for part, (j, i) in by_column.items()}, unknowns, columns)
    return _Matrix(system.N.shape, _added(system), unknowns, unknowns)


def _by_row(M: Sparse, parts: list[tuple[str, slice]]) -> dict[str, tuple[Array, Array]]:
    i, j = M.nonzero()
    return {
        part if part in _COLORS else "base": (i[inside], j[inside])
        for part, where in parts
        for inside in [(i >= where.start) & (i < where.stop)]
    }


def _added(system: BorderedSystem) -> dict[str, tuple[Array, Array]]:
    """Entries of N by the first part of the rows of A that makes them."""
    size = system.N.shape[0]
    result, before = {}, np.zeros(0, np.int64)
    for part, where in system.rows.items():
        A, W = system.A[where], system.W[where, where]
        i, j = Sparse(A.T @ W @ A).nonzero()
        cells = np.setdiff1d(i.astype(np.int64) * size + j, before)
        result[part if part in _COLORS else "base"] = (cells // size, cells % size)
        before = np.union1d(before, cells)
    return result


def _panel(ax: Axes, matrix: _Matrix, size_pt: tuple[float, float]) -> None:
    rows, columns = matrix.shape
    total = sum(len(i) for i, _ in matrix.entries.values())
    least = _LEAST_DOT_PT if total > _VECTOR_DOTS else _LEAST_SINGLE_PT
    dot = max(least, 0.8 * min(size_pt[0] / columns, size_pt[1] / rows))
    for part, (i, j) in matrix.entries.items():
        x, y = _apart(j, i, (columns, rows))
        ax.plot(x, y, "s", color=_COLORS[part], ms=dot, mew=0, rasterized=total > _VECTOR_DOTS)
    ax.set_xlim(0.5, columns + 0.5)
    ax.set_ylim(rows + 0.5, 0.5)
    ax.set_xlabel(f"nz = {total}")
    ax.grid(visible=False)
    for side in ax.spines.values():
        side.set_visible(True)
    for name, where in matrix.columns:
        _brace(ax, name, where, columns, upright=False)
    for name, where in matrix.rows:
        _brace(ax, name, where, rows, upright=True)


def _brace(ax: Axes, name: str, where: slice, size: int, upright: bool) -> None:
    """A line along a group of columns (above) or rows (right) with its name, where narrow groups leave room for it."""
    length = where.stop - where.start
    if length == 0:
        return
    color, gap = _COLORS.get(name, GREY), min(0.01 * size, 0.2)
    ends, beside = [where.start + 0.5 + gap, where.stop + 0.5 - gap], [1.025, 1.025]
    at, align = (where.start + 0.5, "left") if upright else ((where.start + where.stop + 1) / 2, "center")
    if length < _NARROW * size:
        if where.start == 0:
            at, align = 0.5, "left"
        elif where.stop == size:
            at, align = size + 0.5, "right"
        else:
            name = ""
    if upright:
        transform = ax.get_yaxis_transform()
        ax.plot(beside, ends, color=color, lw=2, transform=transform, clip_on=False, solid_capstyle="butt")
        vertical = "top" if align == "left" else "bottom"
        ax.text(1.045, at, name, color=color, transform=transform, rotation=-90, va=vertical)
    else:
        transform = ax.get_xaxis_transform()
        ax.plot(ends, beside, color=color, lw=2, transform=transform, clip_on=False, solid_capstyle="butt")
        ax.text(at, 1.05, name, color=color, transform=transform, ha=align)


def _apart(j: Array, i: Array, size: tuple[int, int]) -> tuple[Array, Array]:
    """Places counted from one; those that fall into one cell of the drawing only once."""
    step = [max(1.0, n / _GRID) for n in size]
    cells = np.unique(np.stack([j / step[0], i / step[1]], axis=1).astype(np.int64), axis=0)
    return 1 + cells[:, 0] * step[0], 1 + cells[:, 1] * step[1]
