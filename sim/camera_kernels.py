"""A camera at a pose for compiled loops: points to pixels, and pixels to rays.

A view is 23 numbers, as `view_of` makes it: rotation world to camera (9, by rows), projection centre (3), K (fx, skew,
cx, fy, cy), distortion (k1, k2, p1, p2, k3), largest squared radius at which the distortion is Brown's.
"""

from __future__ import annotations

from typing import Any, no_type_check

import numba
import numpy as np

from sim.camera import Camera
from sim.pose import Pose

Array = np.ndarray
_BORDER = 65  # rays along each side of the image that bound the radius
_MARGIN = 1.15
compiled = numba.njit(cache=True, error_model="numpy", fastmath={"contract", "arcp", "nsz"})
threaded = numba.njit(cache=True, error_model="numpy", parallel=True, fastmath={"contract", "arcp", "nsz"})


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
    """(u, v, 1/depth) of a point; NaN behind the camera.

    Far outside the image, where Brown's polynomial folds back, what it does at the bound goes on in proportion: what
    reaches into the image from there keeps its corners.
    """
    dx, dy, dz = x - view[9], y - view[10], z - view[11]
    depth = view[6] * dx + view[7] * dy + view[8] * dz
    if not depth > 0:
        return np.nan, np.nan, np.nan
    a = (view[0] * dx + view[1] * dy + view[2] * dz) / depth
    b = (view[3] * dx + view[4] * dy + view[5] * dz) / depth
    r2 = a * a + b * b
    beyond = 1.0
    if r2 > view[22]:
        beyond = np.sqrt(r2 / view[22])
        a, b, r2 = a / beyond, b / beyond, view[22]
    k1, k2, p1, p2, k3 = view[17], view[18], view[19], view[20], view[21]
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    ad = beyond * (a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a))
    bd = beyond * (b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b)
    return view[12] * ad + view[13] * bd + view[14], view[15] * bd + view[16], 1 / depth


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
    """World directions (rows, columns, 3) of depth 1 of the pixels in rows v and columns u."""
    d = np.empty((len(v), len(u), 3))
    for i in numba.prange(len(v)):
        for j in range(len(u)):
            a, b = ray_of(view, u[j], v[i])
            for k in range(3):
                d[i, j, k] = view[k] * a + view[3 + k] * b + view[6 + k]
    return d
