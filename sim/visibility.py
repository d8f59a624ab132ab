"""Which surface points a camera sees: our own ray test, so that measurements never depend on a GL driver."""

from __future__ import annotations

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float

Array = np.ndarray

# A ray ends this far before its point, so that the point's own triangle does not hide it.
_GAP_M = 0.004
_CELLS = 48


@numba.njit(cache=True)
@no_type_check
def _hits(p: Array, reach: float, a: Array, e1: Array, e2: Array) -> bool:
    """Moeller-Trumbore for the segment from the origin to reach * p."""
    px, py, pz = p[1] * e2[2] - p[2] * e2[1], p[2] * e2[0] - p[0] * e2[2], p[0] * e2[1] - p[1] * e2[0]
    det = e1[0] * px + e1[1] * py + e1[2] * pz
    if abs(det) < 1e-18:
        return False
    u = -(a[0] * px + a[1] * py + a[2] * pz) / det
    if u < 0.0 or u > 1.0:
        return False
    qx, qy, qz = -(a[1] * e1[2] - a[2] * e1[1]), -(a[2] * e1[0] - a[0] * e1[2]), -(a[0] * e1[1] - a[1] * e1[0])
    v = (p[0] * qx + p[1] * qy + p[2] * qz) / det
    if v < 0.0 or u + v > 1.0:
        return False
    s = (e2[0] * qx + e2[1] * qy + e2[2] * qz) / det
    return bool(0.0 < s < reach)


@numba.njit(cache=True)
@no_type_check
def _mark_hidden(
    points: Array, order: Array, start: Array, low: Array, cell: Array, triangles: Array, hidden: Array
) -> None:
    """Tests every triangle against the points in the cells of the image plane its projection covers."""
    lo, hi = np.zeros(2), np.zeros(2)
    for f in range(triangles.shape[0]):
        a = triangles[f, 0]
        e1, e2 = triangles[f, 1] - a, triangles[f, 2] - a
        if min(triangles[f, 0, 2], triangles[f, 1, 2], triangles[f, 2, 2]) > 1e-3:
            for k in range(2):
                x0, x1, x2 = (
                    a[k] / a[2],
                    triangles[f, 1, k] / triangles[f, 1, 2],
                    triangles[f, 2, k] / triangles[f, 2, 2],
                )
                lo[k] = max(np.floor((min(x0, x1, x2) - low[k]) / cell[k]), 0)
                hi[k] = min(np.floor((max(x0, x1, x2) - low[k]) / cell[k]), _CELLS - 1)
        elif max(triangles[f, 0, 2], triangles[f, 1, 2], triangles[f, 2, 2]) > 1e-3:
            lo[:], hi[:] = 0, _CELLS - 1
        else:
            continue
        for i in range(int(lo[0]), int(hi[0]) + 1):
            for j in range(int(lo[1]), int(hi[1]) + 1):
                for k in range(start[i * _CELLS + j], start[i * _CELLS + j + 1]):
                    p = order[k]
                    if not hidden[p] and _hits(points[p], 1.0 - _GAP_M / np.sqrt(np.sum(points[p] ** 2)), a, e1, e2):
                        hidden[p] = True


def hidden(points_c: Float[Array, "p 3"], triangles_c: Float[Array, "f 3 3"]) -> Bool[Array, "p"]:
    """Whether something stands between the camera's centre and each point; both in the camera frame [m].

    Points behind the camera count as hidden.
    """
    result = points_c[:, 2] <= 1e-3
    rows = np.flatnonzero(~result)
    if not len(rows) or not len(triangles_c):
        return result
    p = np.ascontiguousarray(points_c[rows])
    xy = p[:, :2] / p[:, 2:]
    low = xy.min(axis=0)
    cell = np.maximum((xy.max(axis=0) - low) / _CELLS * (1 + 1e-9), 1e-12)
    ij = np.minimum(((xy - low) / cell).astype(int), _CELLS - 1)
    key = ij[:, 0] * _CELLS + ij[:, 1]
    order = np.argsort(key, kind="stable")
    start = np.searchsorted(key[order], np.arange(_CELLS * _CELLS + 1))
    mark = np.zeros(len(p), np.bool_)
    _mark_hidden(p, order, start, low, cell, np.ascontiguousarray(triangles_c), mark)
    result[rows] = mark
    return result


def facing(points_c: Float[Array, "p 3"], normals_c: Float[Array, "p 3"], least_cos: float = 0.08) -> Bool[Array, "p"]:
    """Whether the surface at each point turns towards the camera, at least by the given cosine."""
    towards = -np.sum(points_c * normals_c, axis=1) / np.linalg.norm(points_c, axis=1)
    return np.asarray(towards > least_cos)
