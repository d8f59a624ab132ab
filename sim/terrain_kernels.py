"""The hot loops of the elevation grid, compiled: heights and slopes between nodes, and where rays meet the ground.

Between four nodes the ground is the bilinear patch
h = h00 + a (h01 - h00) + b (h10 - h00) + a b (h00 - h01 - h10 + h11), a and b in 0..1 from the south-western node.
Along a ray it is a quadratic, so that the marching from cell to cell below finds the first meeting exactly: no step can
jump over a crest.

All is in one module because the compiler's cache looks at the source file of a function alone.
"""

from __future__ import annotations

from typing import no_type_check

import numba
import numpy as np

Array = np.ndarray

compiled = numba.njit(cache=True, error_model="numpy", nogil=True)

# The vertical iteration shrinks its error by slope times tan(off-nadir angle) a step; beyond, marching is faster.
_RATE = 0.5
_ITERATIONS = 60
# Horizontal step [m] that ends the iteration: the error left is at most as large (rate 0.5), far below any use.
_STEP_M = 1e-7


@no_type_check
@compiled
def _cell(g: float, n: int) -> int:
    """Index of the cell that holds the grid coordinate g of n nodes; the last node belongs to the last cell."""
    return min(max(int(np.floor(g)), 0), n - 2)


@no_type_check
@compiled
def height(h: Array, gx: float, gy: float) -> float:
    """Height at grid coordinates (column gx, row gy); NaN outside the nodes."""
    rows, columns = h.shape
    if not (0.0 <= gx <= columns - 1 and 0.0 <= gy <= rows - 1):
        return np.nan
    i, j = _cell(gy, rows), _cell(gx, columns)
    a, b = gx - j, gy - i
    south = h[i, j] + a * (h[i, j + 1] - h[i, j])
    north = h[i + 1, j] + a * (h[i + 1, j + 1] - h[i + 1, j])
    return south + b * (north - south)


@no_type_check
@compiled
def heights(h: Array, x0: float, y0: float, spacing: float, xy: Array, out: Array) -> None:
    """Heights of points (n, 2) in metres."""
    for k in range(len(xy)):
        out[k] = height(h, (xy[k, 0] - x0) / spacing, (xy[k, 1] - y0) / spacing)


@no_type_check
@compiled
def slopes(h: Array, x0: float, y0: float, spacing: float, xy: Array, out: Array) -> None:
    """(dh/dx, dh/dy) of the bilinear patch at points (n, 2) in metres; NaN outside."""
    rows, columns = h.shape
    for k in range(len(xy)):
        gx, gy = (xy[k, 0] - x0) / spacing, (xy[k, 1] - y0) / spacing
        if not (0.0 <= gx <= columns - 1 and 0.0 <= gy <= rows - 1):
            out[k] = np.nan
            continue
        i, j = _cell(gy, rows), _cell(gx, columns)
        a, b = gx - j, gy - i
        twist = h[i, j] - h[i, j + 1] - h[i + 1, j] + h[i + 1, j + 1]
        out[k, 0] = (h[i, j + 1] - h[i, j] + b * twist) / spacing
        out[k, 1] = (h[i + 1, j] - h[i, j] + a * twist) / spacing


@no_type_check
@compiled
def _first_root(q0: float, q1: float, q2: float, end: float) -> float:
    """Smallest root in [0, end] of q0 + q1 t + q2 t², q0 >= 0; NaN where there is none."""
    if q0 <= 0.0:
        return 0.0
    discriminant = q1 * q1 - 4 * q2 * q0
    if discriminant < 0.0:
        return np.nan
    q = -0.5 * (q1 + np.copysign(np.sqrt(discriminant), q1))
    root = np.nan
    for t in (q0 / q, q / q2):
        if 0.0 <= t <= end and not t > root:
            root = t
    # A change of sign that rounding hides from the roots lies at the cell's far side.
    if np.isnan(root) and q0 + end * (q1 + end * q2) <= 0.0:
        return end
    return root


@no_type_check
@compiled
def _iterate(h: Array, g: Array, d: Array, start: float, spacing: float) -> float:
    """Vertical iteration: the ray meets the horizontal plane at the height found at the last meeting.

    g is the ray's origin and d its direction, horizontally in nodes and vertically in metres. NaN where it leaves the
    grid or does not settle.
    """
    per_t = spacing * np.hypot(d[0], d[1])
    t = (start - g[2]) / d[2]
    for _ in range(_ITERATIONS):
        new = (height(h, g[0] + t * d[0], g[1] + t * d[1]) - g[2]) / d[2]
        if np.isnan(new):
            return np.nan
        step = abs(new - t) * per_t
        t = new
        if step <= _STEP_M:
            return t
    return np.nan


@no_type_check
@compiled
def _clip(g: float, d: float, low: float, high: float, begin: float, end: float) -> tuple[float, float]:
    """The part of [begin, end] in which g + t d stays in [low, high]; empty (begin > end) where it never does."""
    if d == 0.0:
        return (begin, end) if low <= g <= high else (1.0, 0.0)
    t0, t1 = (low - g) / d, (high - g) / d
    return max(begin, min(t0, t1)), min(end, max(t0, t1))


@no_type_check
@compiled
def _march(h: Array, g: Array, d: Array, low: float, high: float) -> float:
    """Ray parameter of the first meeting, from cell to cell; NaN where there is none or the ray comes from below."""
    rows, columns = h.shape
    t, end = _clip(g[0], d[0], 0.0, columns - 1.0, 0.0, np.inf)
    t, end = _clip(g[1], d[1], 0.0, rows - 1.0, t, end)
    # A hair wider than the heights, so that a ray that only touches the highest or lowest node is not lost to rounding.
    hair = 1e-9 * (1.0 + abs(low) + abs(high))
    t, end = _clip(g[2], d[2], low - hair, high + hair, t, end)
    if not t <= end:
        return np.nan
    j, i = _cell(g[0] + t * d[0], columns), _cell(g[1] + t * d[1], rows)
    first = True
    while 0 <= i < rows - 1 and 0 <= j < columns - 1:
        tx = ((j + 1 if d[0] > 0.0 else j) - g[0]) / d[0] if d[0] != 0.0 else np.inf
        ty = ((i + 1 if d[1] > 0.0 else i) - g[1]) / d[1] if d[1] != 0.0 else np.inf
        leave = min(max(min(tx, ty), t), end)
        a, b = g[0] + t * d[0] - j, g[1] + t * d[1] - i
        east, north = h[i, j + 1] - h[i, j], h[i + 1, j] - h[i, j]
        twist = h[i + 1, j + 1] - h[i, j + 1] - north
        above = g[2] + t * d[2] - (h[i, j] + a * east + b * north + a * b * twist)
        if first and above < -hair:
            return np.nan
        first = False
        rate = d[2] - (d[0] * (east + b * twist) + d[1] * (north + a * twist))
        root = _first_root(above, rate, -twist * d[0] * d[1], leave - t)
        if not np.isnan(root):
            return t + root
        if leave >= end:
            return np.nan
        t = leave
        if tx <= ty:
            j += 1 if d[0] > 0.0 else -1
        else:
            i += 1 if d[1] > 0.0 else -1
    return np.nan


@no_type_check
@compiled
def rays(
    h: Array,
    x0: float,
    y0: float,
    spacing: float,
    low: float,
    high: float,
    steepest: float,
    origins: Array,
    directions: Array,
    out: Array,
) -> None:
    """First meetings (n, 3) of rays with the ground; ``origins`` is (n, 3), or (1, 3) for a bundle."""
    g, d = np.empty(3), np.empty(3)
    for k in range(len(directions)):
        o = origins[k if len(origins) > 1 else 0]
        v = directions[k]
        g[0], g[1], g[2] = (o[0] - x0) / spacing, (o[1] - y0) / spacing, o[2]
        d[0], d[1], d[2] = v[0] / spacing, v[1] / spacing, v[2]
        t = np.nan
        # Below this rate the height above ground falls strictly along the ray: what the iteration finds is the first.
        if v[2] < 0.0 and steepest * np.hypot(v[0], v[1]) < -_RATE * v[2]:
            t = _iterate(h, g, d, 0.5 * (low + high), spacing)
        if np.isnan(t):
            t = _march(h, g, d, low, high)
        if t >= 0.0:
            for axis in range(3):
                out[k, axis] = o[axis] + t * v[axis]
        else:
            out[k] = np.nan
