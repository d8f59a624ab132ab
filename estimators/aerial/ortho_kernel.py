"""Compiled inner loops of orthorectification: ground to pixel, maps of it, and their inverse.

A view is a vector of 23 numbers, as `view_of` makes it: rotation world to camera (9, by rows), projection centre (3),
K (fx, skew, cx, fy, cy), distortion (k1, k2, p1, p2, k3), largest squared radius of a ray that is followed. Terrain is
heights (rows, columns) from south to north at x0, y0 with a spacing in metres.
"""

from __future__ import annotations

from typing import Any, no_type_check

import numba
import numpy as np

from sim.camera import Camera
from sim.pose import Pose
from sim.terrain_kernels import height

Array = np.ndarray
STEP = 4
"""Ground pixels between the nodes of a coarse map."""
_BORDER = 65  # rays along each side of the image that bound the radius
_MARGIN = 1.1
_OUTSIDE = -10.0
compiled = numba.njit(cache=True, error_model="numpy")
threaded = numba.njit(cache=True, error_model="numpy", parallel=True)


def view_of(camera: Camera, T_wc: Pose) -> Array:
    """The numbers of a camera at a pose, for the loops below."""
    w, h = camera.size_px
    u, v = np.linspace(-0.5, w - 0.5, _BORDER), np.linspace(-0.5, h - 0.5, _BORDER)
    edges = [np.stack([u, np.full_like(u, y)], -1) for y in (v[0], v[-1])]
    edges += [np.stack([np.full_like(v, x), v], -1) for x in (u[0], u[-1])]
    largest = np.nanmax(np.sum(camera.normalise(np.concatenate(edges)) ** 2, axis=-1))
    K = camera.K
    intrinsic = [K[0, 0], K[0, 1], K[0, 2], K[1, 1], K[1, 2], *camera.distortion, _MARGIN * largest]
    return np.concatenate([T_wc.R.T.ravel(), T_wc.t, intrinsic])


@compiled
@no_type_check
def pixel_of(view: Array, x: float, y: float, z: float) -> Any:
    """(u, v) of a ground point; NaN behind the camera, below no ground, or far outside the image."""
    dx, dy, dz = x - view[9], y - view[10], z - view[11]
    depth = view[6] * dx + view[7] * dy + view[8] * dz
    if not depth > 0:
        return np.nan, np.nan
    a = (view[0] * dx + view[1] * dy + view[2] * dz) / depth
    b = (view[3] * dx + view[4] * dy + view[5] * dz) / depth
    r2 = a * a + b * b
    if r2 > view[22]:
        return np.nan, np.nan
    k1, k2, p1, p2, k3 = view[17], view[18], view[19], view[20], view[21]
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    ad = a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)
    bd = b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b
    return view[12] * ad + view[13] * bd + view[14], view[15] * bd + view[16]


@threaded
@no_type_check
def exact_map(view: Array, H: Array, x0: float, y0: float, spacing: float, x: Array, y: Array) -> Any:
    """Pixels (rows, columns, 2) of the ground at x (columns,), y (rows,), each with its own height."""
    uv = np.empty((len(y), len(x), 2), np.float32)
    for i in numba.prange(len(y)):
        for j in range(len(x)):
            z = height(H, (x[j] - x0) / spacing, (y[i] - y0) / spacing)
            uv[i, j, 0], uv[i, j, 1] = pixel_of(view, x[j], y[i], z)
    return uv


@compiled
@no_type_check
def _nodes(view: Array, H: Array, x0: float, y0: float, spacing: float, x: float, y: float, step: float, n: int) -> Any:
    """Pixels (n, 2) of ground points from x at y, a step apart."""
    uv = np.empty((n, 2))
    for k in range(n):
        x_k = x + k * step
        uv[k, 0], uv[k, 1] = pixel_of(view, x_k, y, height(H, (x_k - x0) / spacing, (y - y0) / spacing))
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
                    uv[i, j, 0], uv[i, j, 1] = pixel_of(
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


@compiled
@no_type_check
def ray_of(view: Array, u: float, v: float) -> Any:
    """Ideal normalised coordinates of a pixel, by Newton's method on the Brown model."""
    bd = (v - view[16]) / view[15]
    ad = (u - view[14] - view[13] * bd) / view[12]
    k1, k2, p1, p2, k3 = view[17], view[18], view[19], view[20], view[21]
    a, b = ad, bd
    for _ in range(20):
        r2 = a * a + b * b
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
        ea = a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a) - ad
        eb = b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b - bd
        j00 = radial + a * a * slope + 2 * p1 * b + 6 * p2 * a
        j01 = a * b * slope + 2 * p1 * a + 2 * p2 * b
        j11 = radial + b * b * slope + 6 * p1 * b + 2 * p2 * a
        det = j00 * j11 - j01 * j01
        da, db = (j11 * ea - j01 * eb) / det, (j00 * eb - j01 * ea) / det
        a -= da
        b -= db
        if abs(da) + abs(db) < 1e-12:
            break
    return a, b


@threaded
@no_type_check
def rays_of(view: Array, u: Array, v: Array) -> Any:
    """Directions in the world (rows, columns, 3), of no certain length, of the pixels in rows v and columns u."""
    d = np.empty((len(v), len(u), 3))
    for i in numba.prange(len(v)):
        for j in range(len(u)):
            a, b = ray_of(view, u[j], v[i])
            d[i, j, 0] = view[0] * a + view[3] * b + view[6]
            d[i, j, 1] = view[1] * a + view[4] * b + view[7]
            d[i, j, 2] = view[2] * a + view[5] * b + view[8]
    return d
