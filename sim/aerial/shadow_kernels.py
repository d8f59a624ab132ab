"""Compiled loops of the sun's shadow map: heights seen along the sun's rays, and whether a point is lit.

Along a ray of light the point (x, y, z) has the sheared coordinates (x, y) - (z - z0) (Lx, Ly) / Lz, L the direction to
the sun: its shadow on the level z0. The map holds the greatest height of all casters there; what lies lower is dark.
"""

from __future__ import annotations

from typing import Any, no_type_check

import numba
import numpy as np

from sim.camera_kernels import compiled, threaded

Array = np.ndarray
_STRIPS = 32
NOTHING = -1e9


@threaded
@no_type_check
def cast(
    frame: Array,
    model: Array,
    place: Array,
    model_first: Array,
    face_first: Array,
    vertices: Array,
    faces: Array,
    rows: int,
    columns: int,
) -> Any:
    """Shadow map (rows, columns) of instances; frame: x0, y0, spacing, z0, Lx / Lz, Ly / Lz."""
    count = len(model)
    first = np.zeros(count + 1, np.int64)
    for k in range(count):
        first[k + 1] = first[k] + model_first[model[k] + 1] - model_first[model[k]]
    at = np.empty((first[count], 3), np.float32)
    span = np.empty((count, 2), np.float32)
    for k in numba.prange(count):
        P, m = place[k], model[k]
        o, low, high = first[k], np.inf, -np.inf
        for i in range(model_first[m], model_first[m + 1]):
            a, b, c = vertices[i, 0], vertices[i, 1], vertices[i, 2]
            z = P[6] * a + P[7] * b + P[8] * c + P[11]
            x = P[0] * a + P[1] * b + P[2] * c + P[9] - (z - frame[3]) * frame[4]
            y = P[3] * a + P[4] * b + P[5] * c + P[10] - (z - frame[3]) * frame[5]
            at[o, 0], at[o, 1], at[o, 2] = (x - frame[0]) / frame[2], (y - frame[1]) / frame[2], z
            low, high = min(low, at[o, 1]), max(high, at[o, 1])
            o += 1
        span[k, 0], span[k, 1] = low, high
    height = np.full((rows, columns), np.float32(NOTHING))
    for strip in numba.prange(_STRIPS):
        top, bottom = strip * rows // _STRIPS, (strip + 1) * rows // _STRIPS
        for k in range(count):
            if span[k, 1] < top or span[k, 0] > bottom:
                continue
            m = model[k]
            shift = first[k] - model_first[m]
            for f in range(face_first[m], face_first[m + 1]):
                _fill(at[faces[f, 0] + shift], at[faces[f, 1] + shift], at[faces[f, 2] + shift], height, top, bottom)
    return height


@compiled
@no_type_check
def _fill(a: Array, b: Array, c: Array, height: Array, top: int, bottom: int) -> None:
    ua, va, za, ub, vb, zb, uc, vc, zc = a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]
    area = (ub - ua) * (vc - va) - (uc - ua) * (vb - va)
    # Closed bodies: faces turned to the sun hide the others.
    if not area > 0:
        return
    columns = height.shape[1]
    i0, i1 = max(int(np.ceil(min(va, vb, vc))), top), min(int(np.floor(max(va, vb, vc))), bottom - 1)
    j0, j1 = max(int(np.ceil(min(ua, ub, uc))), 0), min(int(np.floor(max(ua, ub, uc))), columns - 1)
    bu, bv = (vc - va) / area, -(uc - ua) / area
    cu, cv = -(vb - va) / area, (ub - ua) / area
    for i in range(i0, i1 + 1):
        wb = bu * (j0 - ua) + bv * (i - va)
        wc = cu * (j0 - ua) + cv * (i - va)
        for j in range(j0, j1 + 1):
            if wb >= 0 and wc >= 0 and wb + wc <= 1:
                height[i, j] = max(height[i, j], za + wb * (zb - za) + wc * (zc - za))
            wb += bu
            wc += cu


@compiled
@no_type_check
def lit(frame: Array, height: Array, x: float, y: float, z: float) -> float:
    """Share of the sun that reaches a point of sheared coordinates (x, y) and height z: bilinear between texels."""
    rows, columns = height.shape
    u, v = (x - frame[0]) / frame[2], (y - frame[1]) / frame[2]
    if not (u >= 0 and v >= 0 and u < columns - 1 and v < rows - 1):
        return 1.0
    j, i = int(u), int(v)
    a, b = u - j, v - i
    upper = (1 - a) * (height[i, j] <= z) + a * (height[i, j + 1] <= z)
    lower = (1 - a) * (height[i + 1, j] <= z) + a * (height[i + 1, j + 1] <= z)
    return (1 - b) * upper + b * lower
