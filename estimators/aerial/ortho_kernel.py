"""Compiled inner loops of orthorectification: maps from the ground to pixels.

A view is what `sim.camera_kernels` makes of a camera at a pose. Terrain is heights (rows, columns) from south to north
at x0, y0 with a spacing in metres.
"""

from __future__ import annotations

from typing import Any, no_type_check

import numba
import numpy as np

from sim.camera_kernels import compiled, pixel_of, threaded
from sim.terrain_kernels import height

Array = np.ndarray
STEP = 4
"""Ground pixels between the nodes of a coarse map."""
_OUTSIDE = -10.0


@threaded
@no_type_check
def exact_map(view: Array, H: Array, x0: float, y0: float, spacing: float, x: Array, y: Array) -> Any:
    """Pixels (rows, columns, 2) of the ground at x (columns,), y (rows,), each with its own height."""
    uv = np.empty((len(y), len(x), 2), np.float32)
    for i in numba.prange(len(y)):
        for j in range(len(x)):
            z = height(H, (x[j] - x0) / spacing, (y[i] - y0) / spacing)
            uv[i, j, 0], uv[i, j, 1], _ = pixel_of(view, x[j], y[i], z)
    return uv


@compiled
@no_type_check
def _nodes(view: Array, H: Array, x0: float, y0: float, spacing: float, x: float, y: float, step: float, n: int) -> Any:
    """Pixels (n, 2) of ground points from x at y, a step apart."""
    uv = np.empty((n, 2))
    for k in range(n):
        x_k = x + k * step
        uv[k, 0], uv[k, 1], _ = pixel_of(view, x_k, y, height(H, (x_k - x0) / spacing, (y - y0) / spacing))
    return uv


@compiled
@no_type_check
def _band(view: Array, H: Array, x0: float, y0: float, spacing: float, x: Array, y: Array, uv: Array) -> None:
    """Fills the map uv (up to STEP, columns, 2) of rows y between the nodes above and below."""
    gsd = x[1] - x[0]
    n = (len(x) + STEP - 1) // STEP + 1
    upper = _nodes(view, H, x0, y0, spacing, x[0], y[0], STEP * gsd, n)
    lower = _nodes(view, H, x0, y0, spacing, x[0], y[0] - STEP * gsd, STEP * gsd, n)
    for i in range(len(y)):
        t = i / STEP
        for k in range(n - 1):
            u_1, v_1 = (1 - t) * upper[k, 0] + t * lower[k, 0], (1 - t) * upper[k, 1] + t * lower[k, 1]
            u_2, v_2 = (1 - t) * upper[k + 1, 0] + t * lower[k + 1, 0], (1 - t) * upper[k + 1, 1] + t * lower[k + 1, 1]
            columns = range(k * STEP, min((k + 1) * STEP, len(x)))
            if np.isfinite(u_1 + u_2):
                du, dv = (u_2 - u_1) / STEP, (v_2 - v_1) / STEP
                for j in columns:
                    uv[i, j, 0], uv[i, j, 1] = u_1 + (j - k * STEP) * du, v_1 + (j - k * STEP) * dv
            else:
                for j in columns:
                    uv[i, j, 0], uv[i, j, 1], _ = pixel_of(
                        view, x[j], y[i], height(H, (x[j] - x0) / spacing, (y[i] - y0) / spacing)
                    )


@threaded
@no_type_check
def coarse_map(view: Array, H: Array, x0: float, y0: float, spacing: float, x: Array, y: Array) -> Any:
    """As `exact_map`, of every `STEP`th pixel in both directions and linear between; x has two columns or more."""
    uv = np.empty((len(y), len(x), 2), np.float32)
    for band in numba.prange((len(y) + STEP - 1) // STEP):
        rows = slice(band * STEP, min((band + 1) * STEP, len(y)))
        _band(view, H, x0, y0, spacing, x, y[rows], uv[rows])
    return uv


@threaded
@no_type_check
def seen(uv: Array, width: int, height_px: int) -> Any:
    """Alpha (rows, columns), 255 where a map points into the image; elsewhere the map is led far out of it."""
    alpha = np.empty(uv.shape[:2], np.uint8)
    for i in numba.prange(uv.shape[0]):
        for j in range(uv.shape[1]):
            u, v = uv[i, j, 0], uv[i, j, 1]
            if 0 <= u <= width - 1 and 0 <= v <= height_px - 1:
                alpha[i, j] = 255
            else:
                alpha[i, j] = 0
                uv[i, j, 0] = uv[i, j, 1] = _OUTSIDE
    return alpha
