"""The hot loop of the adjustment, compiled: observations in tiles, passes over them, steps down to the optimum.

It does what `object_motion` describes; the formulas are written out so that sixteen tracks go through them at once.
All is in one module because the compiler's cache looks at the source file of a function alone: split, a change in one
file would leave the others' old machine code in use.

A tile holds ``LANES`` tracks of about the same life, a cell one frame of a tile. Every number of a cell is a row of
``LANES`` values, so that the loops over lanes become vector instructions; a track that is not seen in a cell has the
weight zero there. Rows are addressed in flat arrays, (cell * columns + column) * LANES + lane, with constants only:
then the compiler knows that they do not overlap.

Per point: N_XX = sum R'WR = L L'. Per frame: sums of N_pp, b_p; the reduced matrix is S = N_pp - Z'Z with
Z = L^-1 N_Xp, (3.5.6). With the points best for the poses b_X is zero and the right side is b_p.
"""

from __future__ import annotations

from typing import NamedTuple, no_type_check

import numba
import numpy as np

Array = np.ndarray

# Beyond, the rays are parallel to any camera's accuracy and the normal equations singular to double precision.
FAR_M = 1e5
# Nearer, a point of an adjustment is lost.
NEAR_M = 0.1

# Fewer iterations the compiler does not turn into vector instructions.
LANES = 16
# Columns of a cell: the point l, the weights of its four ideal image coordinates (upper triangle, by rows);
SEEN = 13
# the corrected observation and its weights (upper triangle, by rows).
FIT = 9

# Columns of a tile's points: X; the Cholesky factor of N_XX as 1/L00, L10, L20, 1/L11, L21, 1/L22.
_POINT, _FACTOR = 3, 6
# Sums of a frame: N_pp by blocks (rotation 6, mixed 9, translation 6), b_p 6, and the diagonal of the rotation's block
# without the curvature.
_SUMS = 30
# Tiles whose points leave the normal equations together, and how far the rows of their Z lie apart: no power of two, or
# all would compete for the same lines of the cache.
_BATCH = 8
_WIDTH = 3 * LANES * _BATCH + 8

CONVERGED, UNDETERMINED_TRACK, UNOBSERVED_POSE, STUCK, EXHAUSTED = range(5)
DECREMENT, UPDATE, RELATIVE_UPDATE = range(3)

_TRIES = 14
# Weights that follow the points need not lead to a fixed point where outliers rule; after so many iterations they stay.
_REWEIGHTED = 20
# At rough start values Newton's curvature belongs to residuals that one linear step takes away: it misleads where the
# last step's decrement was a larger part of the cost.
_NEWTON = 0.01
# A matrix serves further steps where the decrement of the last one was below, one standard deviation in all, and as
# long as each makes the decrement this part of the last.
_NEAR, _WORTH = 1.0, 0.1
# Below, a pivot of a matrix with unit diagonal may be rounding.
_PIVOT = 1e-13

# Contraction alone gives fused multiply-adds and leaves NaN and the order of sums as they are.
compiled = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
# Sums of products over the lanes may be taken in any order: only then they become vector instructions.
summed = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})


class Tiles(NamedTuple):
    """Layout and observations of one window; m frames, q tiles, c cells, k observations, n points.

    start (q + 1,) first cell of each tile; first (q,) its first frame; seen (c * SEEN * LANES,) and fit
    (c * FIT * LANES,) numbers of the cells; unused (q * LANES,) one for lanes without a track; slot (k,) cell * LANES +
    lane of each observation; lane (n,) tile * LANES + lane of each point.
    """

    start: Array
    first: Array
    seen: Array
    fit: Array
    unused: Array
    slot: Array
    lane: Array


class Terms(NamedTuple):
    """What is known of the poses beyond the observations; `conditions.Conditions` says what the numbers mean.

    With m frames: dt_s (m - 1,); R_wc (m, 3, 3) and t_wc (m, 3) ego poses; translation one of NO_SMOOTHING, WORLD_AXES,
    BODY_AXES, rotation whether rates are smoothed; P (m - 2, 6, 6) weights of their changes, or scaled by gamma > 0
    from the changes themselves; axis (m, 3) of the rotations in the camera, up (3,) in the object, with a weight
    that is fixed or, where negative, adaptive; free (6m, f) allowed pose changes, empty where all are; datum (6, g)
    allowed changes of the object frame.
    """

    dt_s: Array
    R_wc: Array
    t_wc: Array
    translation: int
    rotation: bool
    P: Array
    gamma: float
    axis: Array
    up: Array
    axis_weight: float
    free: Array
    datum: Array


NO_SMOOTHING, WORLD_AXES, BODY_AXES = range(3)
# Standard deviations that adaptive weights do not fall below: m/s, rad/s and rad.
_CALM_MPS, _CALM_RADPS, _CALM_RAD = 1e-3, 1e-3, 1e-4


@compiled
@no_type_check
def rows(values: Array, columns: int, i: int) -> Array:
    """The rows of cell, tile or frame i."""
    return values[i * columns * LANES : (i + 1) * columns * LANES]


@compiled
@no_type_check
def layout(frame: Array, point: Array, m: int, n: int) -> Tiles:
    """Tracks sorted by their life, sixteen to a tile; no observations yet."""
    first, last = np.full(n, m), np.full(n, -1)
    for k in range(len(frame)):
        first[point[k]] = min(first[point[k]], frame[k])
        last[point[k]] = max(last[point[k]], frame[k])
    count = np.zeros((m + 1) * (m + 1) + 1, np.int64)
    for i in range(n):
        count[first[i] * (m + 1) + last[i] + 2] += 1
    count = np.cumsum(count)
    order = np.empty(n, np.int64)
    for i in range(n):
        key = first[i] * (m + 1) + last[i] + 1
        order[count[key]] = i
        count[key] += 1
    q = (n + LANES - 1) // LANES
    start, tile_first = np.zeros(q + 1, np.int64), np.zeros(q, np.int64)
    unused, lane = np.ones(q * LANES), np.empty(n, np.int64)
    for i in range(q):
        a, b = m, 0
        for j in range(i * LANES, min(n, (i + 1) * LANES)):
            p = order[j]
            lane[p], unused[j] = j, 0.0
            a, b = min(a, first[p]), max(b, last[p])
        tile_first[i], start[i + 1] = a, start[i] + max(0, b - a + 1)
    slot = np.empty(len(frame), np.int64)
    for k in range(len(frame)):
        j = lane[point[k]]
        slot[k] = (start[j // LANES] + frame[k] - tile_first[j // LANES]) * LANES + j % LANES
    cells = start[q]
    return Tiles(start, tile_first, np.zeros(cells * SEEN * LANES), np.zeros(cells * FIT * LANES), unused, slot, lane)


@compiled
@no_type_check
def fill_fixed(tiles: Tiles, observed: Array, W: Array) -> None:
    """Corrected observations (k, 3) with weights W (k, 3, 3) that stay."""
    for k in range(len(observed)):
        o = tiles.slot[k] // LANES * FIT * LANES + tiles.slot[k] % LANES
        c = 3
        for a in range(3):
            tiles.fit[o + a * LANES] = observed[k, a]
            for b in range(a, 3):
                tiles.fit[o + c * LANES] = W[k, a, b]
                c += 1


@compiled
@no_type_check
def fill_seen(tiles: Tiles, l: Array, W_uv: Array, K: Array) -> None:
    """Points l (k, 3) and the weights of their image coordinates W_uv (k, 4, 4) [1/px²], brought to the ideal camera
    by the calibration matrices K (2, 2, 2)."""
    for i in range(2, len(tiles.seen) // LANES, SEEN):
        tiles.seen[i * LANES : (i + 1) * LANES] = 1.0  # unseen points must not divide by zero
    a0, a1, a2 = K[0, 0, 0], K[0, 0, 1], K[0, 1, 1]
    b0, b1, b2 = K[1, 0, 0], K[1, 0, 1], K[1, 1, 1]
    for k in range(len(l)):
        W, s = W_uv[k], tiles.seen[tiles.slot[k] // LANES * SEEN * LANES + tiles.slot[k] % LANES :]
        s[0], s[LANES], s[2 * LANES] = l[k, 0], l[k, 1], l[k, 2]
        # Second column of the left half, both of the right half, turned by K of the right camera.
        u11, u01 = a1 * W[0, 1] + a2 * W[1, 1], a1 * W[0, 0] + a2 * W[0, 1]
        u02, u03 = b0 * W[0, 2], b1 * W[0, 2] + b2 * W[0, 3]
        u12, u13 = b0 * W[1, 2], b1 * W[1, 2] + b2 * W[1, 3]
        u22, u23 = b0 * W[2, 2], b1 * W[2, 2] + b2 * W[2, 3]
        u33 = b1 * W[2, 3] + b2 * W[3, 3]
        s[3 * LANES], s[4 * LANES] = a0 * a0 * W[0, 0], a0 * u01
        s[5 * LANES], s[6 * LANES] = a0 * u02, a0 * u03
        s[7 * LANES] = a1 * u01 + a2 * u11
        s[8 * LANES], s[9 * LANES] = a1 * u02 + a2 * u12, a1 * u03 + a2 * u13
        s[10 * LANES], s[11 * LANES], s[12 * LANES] = b0 * u22, b0 * u23, b1 * u23 + b2 * u33


@compiled
@no_type_check
def weights_of(tiles: Tiles) -> Array:
    """Weights (k, 3, 3) of the observations in their own order."""
    W = np.empty((len(tiles.slot), 3, 3))
    for k in range(len(W)):
        o = tiles.slot[k] // LANES * FIT * LANES + tiles.slot[k] % LANES
        c = 3
        for a in range(3):
            for b in range(a, 3):
                W[k, a, b] = W[k, b, a] = tiles.fit[o + c * LANES]
                c += 1
    return W


@compiled
@no_type_check
def mean_points(tiles: Tiles, frame: Array, point: Array, l: Array, R: Array, T: Array) -> Array:
    """Start values of the points in lanes: mean over the frames of R'(l - T), (3.7.13)."""
    X, count = np.zeros(3 * len(tiles.unused)), np.zeros(len(tiles.unused))
    for k in range(len(l)):
        lane, t = tiles.lane[point[k]], frame[k]
        count[lane] += 1.0
        d0, d1, d2 = l[k, 0] - T[t, 0], l[k, 1] - T[t, 1], l[k, 2] - T[t, 2]
        for a in range(3):
            X[(lane // LANES * 3 + a) * LANES + lane % LANES] += R[t, 0, a] * d0 + R[t, 1, a] * d1 + R[t, 2, a] * d2
    for i in range(len(count)):
        for a in range(3):
            X[(i // LANES * 3 + a) * LANES + i % LANES] /= max(count[i], 1.0)
    return X


@compiled
@no_type_check
def in_lanes(tiles: Tiles, points: Array) -> Array:
    """Points (n, 3) in the lanes of their tiles."""
    X = np.zeros(3 * len(tiles.unused))
    for i in range(len(points)):
        for a in range(3):
            X[(tiles.lane[i] // LANES * 3 + a) * LANES + tiles.lane[i] % LANES] = points[i, a]
    return X


@compiled
@no_type_check
def points_of(tiles: Tiles, X: Array) -> Array:
    """Points (n, 3) in their own order from those in lanes."""
    points = np.empty((len(tiles.lane), 3))
    for i in range(len(points)):
        for a in range(3):
            points[i, a] = X[(tiles.lane[i] // LANES * 3 + a) * LANES + tiles.lane[i] % LANES]
    return points


@compiled
@no_type_check
def reweight(tiles: Tiles, R: Array, T: Array, X: Array, R_rl: Array, t_rl: Array, second_order: bool) -> None:
    """Weights J'WJ and second-order correction of the observations at the current points; see `depth_bias`."""
    a00, a01, a02, a10, a11, a12, a20, a21, a22 = R_rl.flat
    tx, ty, tz = t_rl
    correction = 1.0 if second_order else 0.0
    for q in range(len(tiles.first)):
        for cell in range(tiles.start[q], tiles.start[q + 1]):
            t = tiles.first[q] + cell - tiles.start[q]
            r00, r01, r02, r10, r11, r12, r20, r21, r22 = R[t].flat
            T0, T1, T2 = T[t]
            x, s = rows(X, _POINT, q), rows(tiles.seen, SEEN, cell)
            f = rows(tiles.fit, FIT, cell)
            for j in range(LANES):
                X0, X1, X2 = x[j], x[LANES + j], x[2 * LANES + j]
                l0, l1, l2 = s[j], s[LANES + j], s[2 * LANES + j]
                p0 = r00 * X0 + r01 * X1 + r02 * X2 + T0
                p1 = r10 * X0 + r11 * X1 + r12 * X2 + T1
                p2 = r20 * X0 + r21 * X1 + r22 * X2 + T2
                # False for NaN, too: then the observed place serves.
                depth_r = a20 * p0 + a21 * p1 + a22 * p2 + tz
                good = (p2 > NEAR_M) & (p2 < FAR_M) & (depth_r > NEAR_M) & (abs(p0) + abs(p1) < np.inf)
                p0 = p0 if good else l0
                p1 = p1 if good else l1
                p2 = p2 if good else l2
                # Left and right ideal coordinates and their derivatives: rows [g, 0, -g u], [0, g, -g v] and
                # h (A0 - A2 u'), h (A1 - A2 v').
                g = 1.0 / p2
                u, v = p0 * g, p1 * g
                h = 1.0 / (a20 * p0 + a21 * p1 + a22 * p2 + tz)
                ur = (a00 * p0 + a01 * p1 + a02 * p2 + tx) * h
                vr = (a10 * p0 + a11 * p1 + a12 * p2 + ty) * h
                c0, c1, c2 = h * (a00 - a20 * ur), h * (a01 - a21 * ur), h * (a02 - a22 * ur)
                d0, d1, d2 = h * (a10 - a20 * vr), h * (a11 - a21 * vr), h * (a12 - a22 * vr)
                w00, w01, w02, w03 = s[3 * LANES + j], s[4 * LANES + j], s[5 * LANES + j], s[6 * LANES + j]
                w11, w12, w13 = s[7 * LANES + j], s[8 * LANES + j], s[9 * LANES + j]
                w22, w23, w33 = s[10 * LANES + j], s[11 * LANES + j], s[12 * LANES + j]
                gu, gv = g * u, g * v
                # Rows of J'W, (3, 4).
                k00, k01 = g * w00 + c0 * w02 + d0 * w03, g * w01 + c0 * w12 + d0 * w13
                k02, k03 = g * w02 + c0 * w22 + d0 * w23, g * w03 + c0 * w23 + d0 * w33
                k10, k11 = g * w01 + c1 * w02 + d1 * w03, g * w11 + c1 * w12 + d1 * w13
                k12, k13 = g * w12 + c1 * w22 + d1 * w23, g * w13 + c1 * w23 + d1 * w33
                k20 = c2 * w02 + d2 * w03 - gu * w00 - gv * w01
                k21 = c2 * w12 + d2 * w13 - gu * w01 - gv * w11
                k22 = c2 * w22 + d2 * w23 - gu * w02 - gv * w12
                k23 = c2 * w23 + d2 * w33 - gu * w03 - gv * w13
                W00, W01 = k00 * g + k02 * c0 + k03 * d0, k01 * g + k02 * c1 + k03 * d1
                W02 = k02 * c2 + k03 * d2 - k00 * gu - k01 * gv
                W11 = k11 * g + k12 * c1 + k13 * d1
                W12 = k12 * c2 + k13 * d2 - k10 * gu - k11 * gv
                W22 = k22 * c2 + k23 * d2 - k20 * gu - k21 * gv
                # C = W^-1 and tr(H C) of the four coordinates.
                e00, e01, e02 = W11 * W22 - W12 * W12, W02 * W12 - W01 * W22, W01 * W12 - W02 * W11
                det = W00 * e00 + W01 * e01 + W02 * e02
                i = 1.0 / (det if det > 0.0 else 1.0)
                C00, C01, C02 = e00 * i, e01 * i, e02 * i
                C11, C12 = (W00 * W22 - W02 * W02) * i, (W01 * W02 - W00 * W12) * i
                C22 = (W00 * W11 - W01 * W01) * i
                n0, n1 = C00 * a20 + C01 * a21 + C02 * a22, C01 * a20 + C11 * a21 + C12 * a22
                n2 = C02 * a20 + C12 * a21 + C22 * a22
                zz = a20 * n0 + a21 * n1 + a22 * n2
                left, right = 2.0 * g * g, 2.0 * h * h
                h0, h1 = left * (u * C22 - C02), left * (v * C22 - C12)
                h2 = right * (ur * zz - (a00 * n0 + a01 * n1 + a02 * n2))
                h3 = right * (vr * zz - (a10 * n0 + a11 * n1 + a12 * n2))
                b0 = k00 * h0 + k01 * h1 + k02 * h2 + k03 * h3
                b1 = k10 * h0 + k11 * h1 + k12 * h2 + k13 * h3
                b2 = k20 * h0 + k21 * h1 + k22 * h2 + k23 * h3
                half = 0.5 * correction
                f[j] = l0 + half * (C00 * b0 + C01 * b1 + C02 * b2)
                f[LANES + j] = l1 + half * (C01 * b0 + C11 * b1 + C12 * b2)
                f[2 * LANES + j] = l2 + half * (C02 * b0 + C12 * b1 + C22 * b2)
                f[3 * LANES + j], f[4 * LANES + j], f[5 * LANES + j] = W00, W01, W02
                f[6 * LANES + j], f[7 * LANES + j], f[8 * LANES + j] = W11, W12, W22


@compiled
@no_type_check
def best_points(tiles: Tiles, R: Array, T: Array, X: Array, factor: Array) -> float:
    """Writes the best points for given poses, X_i = (sum R'WR)^-1 sum R'W (l - T), and the factors of their matrices.

    Returns the cost v'Wv; NaN where a track is not determined.
    """
    N = np.empty(9 * LANES)
    costs = np.zeros(LANES)
    for q in range(len(tiles.first)):
        for j in range(LANES):
            for c in range(9):
                N[c * LANES + j] = 0.0
            N[j] = N[3 * LANES + j] = N[5 * LANES + j] = tiles.unused[q * LANES + j]
        for cell in range(tiles.start[q], tiles.start[q + 1]):
            t = tiles.first[q] + cell - tiles.start[q]
            r00, r01, r02, r10, r11, r12, r20, r21, r22 = R[t].flat
            T0, T1, T2 = T[t]
            f = rows(tiles.fit, FIT, cell)
            for j in range(LANES):
                d0, d1, d2 = f[j] - T0, f[LANES + j] - T1, f[2 * LANES + j] - T2
                W00, W01, W02 = f[3 * LANES + j], f[4 * LANES + j], f[5 * LANES + j]
                W11, W12, W22 = f[6 * LANES + j], f[7 * LANES + j], f[8 * LANES + j]
                u00, u10 = W00 * r00 + W01 * r10 + W02 * r20, W01 * r00 + W11 * r10 + W12 * r20
                u20 = W02 * r00 + W12 * r10 + W22 * r20
                u01, u11 = W00 * r01 + W01 * r11 + W02 * r21, W01 * r01 + W11 * r11 + W12 * r21
                u21 = W02 * r01 + W12 * r11 + W22 * r21
                u02, u12 = W00 * r02 + W01 * r12 + W02 * r22, W01 * r02 + W11 * r12 + W12 * r22
                u22 = W02 * r02 + W12 * r12 + W22 * r22
                N[j] += r00 * u00 + r10 * u10 + r20 * u20
                N[LANES + j] += r00 * u01 + r10 * u11 + r20 * u21
                N[2 * LANES + j] += r00 * u02 + r10 * u12 + r20 * u22
                N[3 * LANES + j] += r01 * u01 + r11 * u11 + r21 * u21
                N[4 * LANES + j] += r01 * u02 + r11 * u12 + r21 * u22
                N[5 * LANES + j] += r02 * u02 + r12 * u12 + r22 * u22
                N[6 * LANES + j] += u00 * d0 + u10 * d1 + u20 * d2
                N[7 * LANES + j] += u01 * d0 + u11 * d1 + u21 * d2
                N[8 * LANES + j] += u02 * d0 + u12 * d1 + u22 * d2
        _solve(N, q, X, factor)
        for cell in range(tiles.start[q], tiles.start[q + 1]):
            t = tiles.first[q] + cell - tiles.start[q]
            r00, r01, r02, r10, r11, r12, r20, r21, r22 = R[t].flat
            T0, T1, T2 = T[t]
            x, f = rows(X, _POINT, q), rows(tiles.fit, FIT, cell)
            for j in range(LANES):
                X0, X1, X2 = x[j], x[LANES + j], x[2 * LANES + j]
                v0 = r00 * X0 + r01 * X1 + r02 * X2 + T0 - f[j]
                v1 = r10 * X0 + r11 * X1 + r12 * X2 + T1 - f[LANES + j]
                v2 = r20 * X0 + r21 * X1 + r22 * X2 + T2 - f[2 * LANES + j]
                costs[j] += (
                    v0 * (f[3 * LANES + j] * v0 + 2.0 * (f[4 * LANES + j] * v1 + f[5 * LANES + j] * v2))
                    + v1 * (f[6 * LANES + j] * v1 + 2.0 * f[7 * LANES + j] * v2)
                    + v2 * f[8 * LANES + j] * v2
                )
    return costs.sum()


@compiled
@no_type_check
def _solve(N: Array, q: int, X: Array, factor: Array) -> None:
    """Cholesky factor and solution of a tile's points; NaN where the matrix is not positive definite."""
    x, f = rows(X, _POINT, q), rows(factor, _FACTOR, q)
    for j in range(LANES):
        i0 = 1.0 / np.sqrt(N[j])
        l1, l2 = N[LANES + j] * i0, N[2 * LANES + j] * i0
        i1 = 1.0 / np.sqrt(N[3 * LANES + j] - l1 * l1)
        l3 = (N[4 * LANES + j] - l2 * l1) * i1
        i2 = 1.0 / np.sqrt(N[5 * LANES + j] - l2 * l2 - l3 * l3)
        y0 = N[6 * LANES + j] * i0
        y1 = (N[7 * LANES + j] - l1 * y0) * i1
        x2 = (N[8 * LANES + j] - l2 * y0 - l3 * y1) * i2 * i2
        x1 = (y1 - l3 * x2) * i1
        x[j], x[LANES + j], x[2 * LANES + j] = (y0 - l1 * x1 - l2 * x2) * i0, x1, x2
        f[j], f[LANES + j], f[2 * LANES + j] = i0, l1, l2
        f[3 * LANES + j], f[4 * LANES + j], f[5 * LANES + j] = i1, l3, i2


@compiled
@no_type_check
def _end(tiles: Tiles, q: int) -> int:
    """The frame after the last of tile q."""
    return tiles.first[q] + tiles.start[q + 1] - tiles.start[q]


@compiled
@no_type_check
def _share(
    tiles: Tiles, a: int, b: int, low: int, high: int,
    R: Array, T: Array, X: Array, factor: Array, bend: float, sums: Array, Z: Array,
) -> None:  # fmt: skip
    """Adds what tiles a to b have in N_pp and b_p to the sums of the frames, writes their Z for frames low to high.

    bend: 1 with Newton's curvature, else 0. A row of Z belongs to an unknown of the poses and holds the tiles' lanes
    for each of the three coordinates; it is zero where a tile does not reach.
    """
    for q in range(a, b):
        for t in range(low, high):
            if t < tiles.first[q] or t >= _end(tiles, q):
                for row in range(6 * (t - low), 6 * (t - low) + 6):
                    Z[row * _WIDTH + 3 * (q - a) * LANES : row * _WIDTH + 3 * (q - a + 1) * LANES] = 0.0
        for cell in range(tiles.start[q], tiles.start[q + 1]):
            t = tiles.first[q] + cell - tiles.start[q]
            r00, r01, r02, r10, r11, r12, r20, r21, r22 = R[t].flat
            T0, T1, T2 = T[t]
            x, L = rows(X, _POINT, q), rows(factor, _FACTOR, q)
            f, total = rows(tiles.fit, FIT, cell), rows(sums, _SUMS, t)
            z = Z[6 * (t - low) * _WIDTH + 3 * (q - a) * LANES :]
            for j in range(LANES):
                X0, X1, X2 = x[j], x[LANES + j], x[2 * LANES + j]
                W00, W01, W02 = f[3 * LANES + j], f[4 * LANES + j], f[5 * LANES + j]
                W11, W12, W22 = f[6 * LANES + j], f[7 * LANES + j], f[8 * LANES + j]
                a0 = r00 * X0 + r01 * X1 + r02 * X2
                a1 = r10 * X0 + r11 * X1 + r12 * X2
                a2 = r20 * X0 + r21 * X1 + r22 * X2
                v0, v1, v2 = a0 + T0 - f[j], a1 + T1 - f[LANES + j], a2 + T2 - f[2 * LANES + j]
                g0, g1 = W00 * v0 + W01 * v1 + W02 * v2, W01 * v0 + W11 * v1 + W12 * v2
                g2 = W02 * v0 + W12 * v1 + W22 * v2
                # M = S(a) W: a x columns of W; rotation block: a x rows of M.
                m00, m10, m20 = a1 * W02 - a2 * W01, a2 * W00 - a0 * W02, a0 * W01 - a1 * W00
                m01, m11, m21 = a1 * W12 - a2 * W11, a2 * W01 - a0 * W12, a0 * W11 - a1 * W01
                m02, m12, m22 = a1 * W22 - a2 * W12, a2 * W02 - a0 * W22, a0 * W12 - a1 * W02
                n00, n01, n02 = a1 * m02 - a2 * m01, a2 * m00 - a0 * m02, a0 * m01 - a1 * m00
                n11, n12, n22 = a2 * m10 - a0 * m12, a0 * m11 - a1 * m10, a0 * m21 - a1 * m20
                ga = bend * (g0 * a0 + g1 * a1 + g2 * a2)
                total[j] += n00 + bend * g0 * a0 - ga
                total[LANES + j] += n01 + 0.5 * bend * (g0 * a1 + g1 * a0)
                total[2 * LANES + j] += n02 + 0.5 * bend * (g0 * a2 + g2 * a0)
                total[3 * LANES + j] += n11 + bend * g1 * a1 - ga
                total[4 * LANES + j] += n12 + 0.5 * bend * (g1 * a2 + g2 * a1)
                total[5 * LANES + j] += n22 + bend * g2 * a2 - ga
                total[6 * LANES + j] += m00
                total[7 * LANES + j] += m01
                total[8 * LANES + j] += m02
                total[9 * LANES + j] += m10
                total[10 * LANES + j] += m11
                total[11 * LANES + j] += m12
                total[12 * LANES + j] += m20
                total[13 * LANES + j] += m21
                total[14 * LANES + j] += m22
                total[15 * LANES + j] += W00
                total[16 * LANES + j] += W01
                total[17 * LANES + j] += W02
                total[18 * LANES + j] += W11
                total[19 * LANES + j] += W12
                total[20 * LANES + j] += W22
                total[21 * LANES + j] += a2 * g1 - a1 * g2
                total[22 * LANES + j] += a0 * g2 - a2 * g0
                total[23 * LANES + j] += a1 * g0 - a0 * g1
                total[24 * LANES + j] -= g0
                total[25 * LANES + j] -= g1
                total[26 * LANES + j] -= g2
                total[27 * LANES + j] += n00
                total[28 * LANES + j] += n11
                total[29 * LANES + j] += n22
                # N_pX: below U = W R, above a x U - g x R by columns.
                u00, u10 = W00 * r00 + W01 * r10 + W02 * r20, W01 * r00 + W11 * r10 + W12 * r20
                u20 = W02 * r00 + W12 * r10 + W22 * r20
                u01, u11 = W00 * r01 + W01 * r11 + W02 * r21, W01 * r01 + W11 * r11 + W12 * r21
                u21 = W02 * r01 + W12 * r11 + W22 * r21
                u02, u12 = W00 * r02 + W01 * r12 + W02 * r22, W01 * r02 + W11 * r12 + W12 * r22
                u22 = W02 * r02 + W12 * r12 + W22 * r22
                s0, s1, s2 = bend * g0, bend * g1, bend * g2
                i0, l1, l2 = L[j], L[LANES + j], L[2 * LANES + j]
                i1, l3, i2 = L[3 * LANES + j], L[4 * LANES + j], L[5 * LANES + j]
                z0 = (a1 * u20 - a2 * u10 - s1 * r20 + s2 * r10) * i0
                z1 = (a1 * u21 - a2 * u11 - s1 * r21 + s2 * r11 - l1 * z0) * i1
                z[j], z[LANES + j] = z0, z1
                z[2 * LANES + j] = (a1 * u22 - a2 * u12 - s1 * r22 + s2 * r12 - l2 * z0 - l3 * z1) * i2
                z0 = (a2 * u00 - a0 * u20 - s2 * r00 + s0 * r20) * i0
                z1 = (a2 * u01 - a0 * u21 - s2 * r01 + s0 * r21 - l1 * z0) * i1
                z[_WIDTH + j], z[_WIDTH + LANES + j] = z0, z1
                z[_WIDTH + 2 * LANES + j] = (a2 * u02 - a0 * u22 - s2 * r02 + s0 * r22 - l2 * z0 - l3 * z1) * i2
                z0 = (a0 * u10 - a1 * u00 - s0 * r10 + s1 * r00) * i0
                z1 = (a0 * u11 - a1 * u01 - s0 * r11 + s1 * r01 - l1 * z0) * i1
                z[2 * _WIDTH + j], z[2 * _WIDTH + LANES + j] = z0, z1
                z[2 * _WIDTH + 2 * LANES + j] = (a0 * u12 - a1 * u02 - s0 * r12 + s1 * r02 - l2 * z0 - l3 * z1) * i2
                z0 = u00 * i0
                z1 = (u01 - l1 * z0) * i1
                z[3 * _WIDTH + j], z[3 * _WIDTH + LANES + j], z[3 * _WIDTH + 2 * LANES + j] = (
                    z0,
                    z1,
                    (u02 - l2 * z0 - l3 * z1) * i2,
                )
                z0 = u10 * i0
                z1 = (u11 - l1 * z0) * i1
                z[4 * _WIDTH + j], z[4 * _WIDTH + LANES + j], z[4 * _WIDTH + 2 * LANES + j] = (
                    z0,
                    z1,
                    (u12 - l2 * z0 - l3 * z1) * i2,
                )
                z0 = u20 * i0
                z1 = (u21 - l1 * z0) * i1
                z[5 * _WIDTH + j], z[5 * _WIDTH + LANES + j], z[5 * _WIDTH + 2 * LANES + j] = (
                    z0,
                    z1,
                    (u22 - l2 * z0 - l3 * z1) * i2,
                )


@summed
@no_type_check
def _subtract(tiles: Tiles, a: int, b: int, low: int, high: int, Z: Array, S: Array) -> None:
    """Takes Z'Z of tiles a to b off the upper triangle of S, three rows by six columns at a time: as many sums as there
    are vector registers for."""
    for row in range(0, 6 * (high - low), 3):
        s = low + row // 6
        for t in range(s, high):
            of, to = a, b
            while of < to and _end(tiles, of) <= t:
                of += 1
            while to > of and (tiles.first[to - 1] > s or _end(tiles, to - 1) <= t):
                to -= 1
            if of == to:
                continue
            x, y = Z[row * _WIDTH + 3 * LANES * (of - a) :], Z[6 * (t - low) * _WIDTH + 3 * LANES * (of - a) :]
            c = S[6 * low + row :, 6 * t :]
            s00 = s01 = s02 = s03 = s04 = s05 = 0.0
            s10 = s11 = s12 = s13 = s14 = s15 = 0.0
            s20 = s21 = s22 = s23 = s24 = s25 = 0.0
            for i in range(3 * LANES * (to - of)):
                x0, x1, x2 = x[i], x[_WIDTH + i], x[2 * _WIDTH + i]
                y0, y1, y2 = y[i], y[_WIDTH + i], y[2 * _WIDTH + i]
                y3, y4, y5 = y[3 * _WIDTH + i], y[4 * _WIDTH + i], y[5 * _WIDTH + i]
                s00, s01, s02 = s00 + x0 * y0, s01 + x0 * y1, s02 + x0 * y2
                s03, s04, s05 = s03 + x0 * y3, s04 + x0 * y4, s05 + x0 * y5
                s10, s11, s12 = s10 + x1 * y0, s11 + x1 * y1, s12 + x1 * y2
                s13, s14, s15 = s13 + x1 * y3, s14 + x1 * y4, s15 + x1 * y5
                s20, s21, s22 = s20 + x2 * y0, s21 + x2 * y1, s22 + x2 * y2
                s23, s24, s25 = s23 + x2 * y3, s24 + x2 * y4, s25 + x2 * y5
            c[0, 0], c[0, 1], c[0, 2] = c[0, 0] - s00, c[0, 1] - s01, c[0, 2] - s02
            c[0, 3], c[0, 4], c[0, 5] = c[0, 3] - s03, c[0, 4] - s04, c[0, 5] - s05
            c[1, 0], c[1, 1], c[1, 2] = c[1, 0] - s10, c[1, 1] - s11, c[1, 2] - s12
            c[1, 3], c[1, 4], c[1, 5] = c[1, 3] - s13, c[1, 4] - s14, c[1, 5] - s15
            c[2, 0], c[2, 1], c[2, 2] = c[2, 0] - s20, c[2, 1] - s21, c[2, 2] - s22
            c[2, 3], c[2, 4], c[2, 5] = c[2, 3] - s23, c[2, 4] - s24, c[2, 5] - s25


@compiled
@no_type_check
def reduced_system(
    tiles: Tiles, R: Array, T: Array, X: Array, factor: Array, newton: bool
) -> tuple[Array, Array, Array]:
    """S (6m, 6m), Newton's or Gauss-Newton's, rhs (6m,) and the scale (6m,) at poses and their best points."""
    m = len(R)
    S = np.zeros((6 * m, 6 * m))
    sums = np.zeros(m * _SUMS * LANES)
    Z = np.empty(6 * m * _WIDTH)
    bend = 1.0 if newton else 0.0
    for a in range(0, len(tiles.first), _BATCH):
        b = min(a + _BATCH, len(tiles.first))
        low = tiles.first[a]  # the tiles are sorted by it
        high = low
        for q in range(a, b):
            high = max(high, _end(tiles, q))
        _share(tiles, a, b, low, high, R, T, X, factor, bend, sums, Z)
        _subtract(tiles, a, b, low, high, Z, S)
    rhs, scale, s = np.empty(6 * m), np.empty(6 * m), np.empty(_SUMS)
    for t in range(m):
        for c in range(_SUMS):
            s[c] = 0.0
            for j in range(LANES):
                s[c] += sums[(t * _SUMS + c) * LANES + j]
        o, c = 6 * t, 0
        for a in range(3):
            for b in range(3):
                S[o + a, o + 3 + b] += s[6 + 3 * a + b]
                if b >= a:
                    S[o + a, o + b] += s[c]
                    S[o + 3 + a, o + 3 + b] += s[15 + c]
                    c += 1
        rhs[o : o + 6] = s[21:27]
        scale[o : o + 3] = np.sqrt(s[27:30])
        scale[o + 3], scale[o + 4], scale[o + 5] = np.sqrt(s[15]), np.sqrt(s[18]), np.sqrt(s[20])
    for a in range(6 * m):
        for b in range(a):
            S[a, b] = S[b, a]
    return S, rhs, scale


@compiled
@no_type_check
def eliminated(
    tiles: Tiles, frame: Array, point: Array, R: Array, X: Array, W: Array, factor: Array, F: Array
) -> tuple[Array, Array]:
    """What functions of the points become when these follow the poses: U = L^-1 F' (n, 3, f) and sum U'Z (6m, f).

    X (n, 3) and the derivatives F (n, f, 3) of the functions belong to the points in their own order. The functions'
    covariance is U'U for given poses; -(U'Z)' is their derivative by the poses.
    """
    n, f = F.shape[0], F.shape[1]
    U, L = np.empty((n, 3, f)), np.empty((n, 6))
    for i in range(n):
        for c in range(6):
            L[i, c] = factor[(tiles.lane[i] // LANES * _FACTOR + c) * LANES + tiles.lane[i] % LANES]
        for c in range(f):
            U[i, 0, c] = F[i, c, 0] * L[i, 0]
            U[i, 1, c] = (F[i, c, 1] - L[i, 1] * U[i, 0, c]) * L[i, 3]
            U[i, 2, c] = (F[i, c, 2] - L[i, 2] * U[i, 0, c] - L[i, 4] * U[i, 1, c]) * L[i, 5]
    UZ, N = np.zeros((6 * len(R), f)), np.empty((6, 3))
    for k in range(len(frame)):
        t, i = frame[k], point[k]
        a0 = R[t, 0, 0] * X[i, 0] + R[t, 0, 1] * X[i, 1] + R[t, 0, 2] * X[i, 2]
        a1 = R[t, 1, 0] * X[i, 0] + R[t, 1, 1] * X[i, 1] + R[t, 1, 2] * X[i, 2]
        a2 = R[t, 2, 0] * X[i, 0] + R[t, 2, 1] * X[i, 1] + R[t, 2, 2] * X[i, 2]
        for c in range(3):
            for b in range(3):
                N[3 + b, c] = W[k, b, 0] * R[t, 0, c] + W[k, b, 1] * R[t, 1, c] + W[k, b, 2] * R[t, 2, c]
            N[0, c], N[1, c] = a1 * N[5, c] - a2 * N[4, c], a2 * N[3, c] - a0 * N[5, c]
            N[2, c] = a0 * N[4, c] - a1 * N[3, c]
        for b in range(6):
            z0 = N[b, 0] * L[i, 0]
            z1 = (N[b, 1] - L[i, 1] * z0) * L[i, 3]
            z2 = (N[b, 2] - L[i, 2] * z0 - L[i, 4] * z1) * L[i, 5]
            row, u = UZ[6 * t + b], U[i]
            for c in range(f):
                row[c] += z0 * u[0, c] + z1 * u[1, c] + z2 * u[2, c]
    return U, UZ


@compiled
@no_type_check
def right_side(tiles: Tiles, R: Array, T: Array, X: Array) -> Array:
    """The right side (6m,) of `reduced_system` alone."""
    sums = np.zeros(6 * len(R) * LANES)
    for q in range(len(tiles.first)):
        for cell in range(tiles.start[q], tiles.start[q + 1]):
            t = tiles.first[q] + cell - tiles.start[q]
            r00, r01, r02, r10, r11, r12, r20, r21, r22 = R[t].flat
            T0, T1, T2 = T[t]
            x, f, total = rows(X, _POINT, q), rows(tiles.fit, FIT, cell), rows(sums, 6, t)
            for j in range(LANES):
                X0, X1, X2 = x[j], x[LANES + j], x[2 * LANES + j]
                W01, W02, W12 = f[4 * LANES + j], f[5 * LANES + j], f[7 * LANES + j]
                a0 = r00 * X0 + r01 * X1 + r02 * X2
                a1 = r10 * X0 + r11 * X1 + r12 * X2
                a2 = r20 * X0 + r21 * X1 + r22 * X2
                v0, v1, v2 = a0 + T0 - f[j], a1 + T1 - f[LANES + j], a2 + T2 - f[2 * LANES + j]
                g0 = f[3 * LANES + j] * v0 + W01 * v1 + W02 * v2
                g1 = W01 * v0 + f[6 * LANES + j] * v1 + W12 * v2
                g2 = W02 * v0 + W12 * v1 + f[8 * LANES + j] * v2
                total[j] += a2 * g1 - a1 * g2
                total[LANES + j] += a0 * g2 - a2 * g0
                total[2 * LANES + j] += a1 * g0 - a0 * g1
                total[3 * LANES + j] -= g0
                total[4 * LANES + j] -= g1
                total[5 * LANES + j] -= g2
    return sums.reshape(6 * len(R), LANES).sum(axis=1)


@compiled
@no_type_check
def _turn(a2: float) -> tuple[float, float]:
    """sin(a) / a and (1 - cos(a)) / a² from a², by series near zero."""
    if a2 < 1e-8:
        return 1.0 - a2 / 6.0, 0.5 - a2 / 24.0
    a = np.sqrt(a2)
    return np.sin(a) / a, 2.0 * np.sin(a / 2.0) ** 2 / a2


@compiled
@no_type_check
def _rotation(r: Array) -> Array:
    """exp of a rotation vector (3,)."""
    s, c = _turn(r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
    S = _hat(r)
    return np.eye(3) + s * S + c * (S @ S)


@compiled
@no_type_check
def _hat(x: Array) -> Array:
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


@compiled
@no_type_check
def _rotation_vector(R: Array) -> Array:
    """log of a rotation by less than half a turn, (3,)."""
    s = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2.0
    sine = np.sqrt(np.dot(s, s))
    if sine < 1e-6:
        return s
    return s * (np.arctan2(sine, (R[0, 0] + R[1, 1] + R[2, 2] - 1.0) / 2.0) / sine)


@compiled
@no_type_check
def extrapolated(R: Array, T: Array, ratio: float) -> tuple[Array, Array]:
    """Pose after the two of R (2, 3, 3) and T (2, 3), by a multiple of their motion, (3.7.10)-(3.7.12)."""
    turn = _rotation(ratio * _rotation_vector(R[1] @ R[0].T))
    return turn @ R[1], T[1] + ratio * (T[1] - T[0])


@compiled
@no_type_check
def _left_jacobian(r: Array) -> Array:
    """exp(r + dr) = exp(J dr) exp(r)."""
    a2 = np.dot(r, r)
    if a2 < 1e-6:
        s, c = 0.5 - a2 / 24.0, 1.0 / 6.0 - a2 / 120.0
    else:
        a = np.sqrt(a2)
        s, c = (1.0 - np.cos(a)) / a2, (a - np.sin(a)) / (a * a2)
    S = _hat(r)
    return np.eye(3) + s * S + c * (S @ S)


@compiled
@no_type_check
def _step_motion(terms: Terms, R: Array, T: Array, t: int, v: Array, V: Array) -> None:
    """Writes velocity and rate (6,) from frame t to the next and their derivatives (6, 12) by both poses."""
    R_0, R_1 = terms.R_wc[t], terms.R_wc[t + 1]
    A, B = R_0 @ R[t], R_1 @ R[t + 1]
    d = np.dot(R_1, T[t + 1]) + terms.t_wc[t + 1] - np.dot(R_0, T[t]) - terms.t_wc[t]
    E = B @ A.T
    turn = _rotation_vector(E)
    J_inv = np.linalg.inv(_left_jacobian(turn))
    H = np.eye(3)
    if terms.translation == BODY_AXES:
        # In axes halfway between both frames: a constant turn has a constant velocity there, whatever the time steps.
        half = _rotation(0.5 * turn)
        H = np.ascontiguousarray((half @ A).T)
        second = 0.5 * (_left_jacobian(0.5 * turn) @ J_inv)
        HS = H @ _hat(d)
        V[:3, :3] = HS @ ((half - second @ E) @ R_0)
        V[:3, 6:9] = HS @ (second @ R_1)
    v[:3], v[3:] = np.dot(H, d), turn
    V[:3, 3:6], V[:3, 9:] = -(H @ R_0), H @ R_1
    V[3:, :3], V[3:, 6:9] = -(J_inv @ (E @ R_0)), J_inv @ R_1
    v /= terms.dt_s[t]
    V /= terms.dt_s[t]


@compiled
@no_type_check
def smoothness(terms: Terms, R: Array, T: Array) -> tuple[Array, Array]:
    """Changes (m - 2, 6) of velocity and rate at the inner frames and their derivatives (m - 2, 6, 18) by the poses of
    the frames before, at and after."""
    m = len(terms.P) + 2
    e, J = np.zeros((m - 2, 6)), np.zeros((m - 2, 6, 18))
    v, V = np.zeros(6), np.zeros((6, 12))
    for t in range(m - 1):
        _step_motion(terms, R, T, t, v, V)
        if t > 0:
            e[t - 1] += v
            J[t - 1, :, 6:] += V
        if t < m - 2:
            e[t] -= v
            J[t, :, :12] -= V
    return e, J


@compiled
@no_type_check
def smoothness_weights(terms: Terms, e: Array) -> Array:
    """Weights (m - 2, 6, 6) of the changes e: those given, or gamma over their second moments about zero (4.2.12).

    Fewer than four changes do not fill a matrix of moments; then all directions weigh alike.
    """
    if terms.gamma <= 0.0 or len(e) == 0:
        return terms.P
    P = np.zeros_like(terms.P)
    for part in range(2):
        if (part == 0 and terms.translation == NO_SMOOTHING) or (part == 1 and not terms.rotation):
            continue
        x = np.ascontiguousarray(e[:, 3 * part : 3 * part + 3])
        C = x.T @ x / len(e)
        if len(e) < 4:
            C = np.eye(3) * (np.trace(C) / 3.0)
        calm = _CALM_MPS if part == 0 else _CALM_RADPS
        P[:, 3 * part : 3 * part + 3, 3 * part : 3 * part + 3] = terms.gamma * np.linalg.inv(C + np.eye(3) * calm**2)
    return P


@compiled
@no_type_check
def tilt(terms: Terms, R: Array) -> tuple[Array, Array]:
    """By how much the axis (m, 3) has left its place in the object, and the derivatives (m, 3, 3) by the rotations."""
    m = len(R)
    e, J = np.empty((m, 3)), np.empty((m, 3, 3))
    for t in range(m):
        R_t = np.ascontiguousarray(R[t].T)
        e[t] = np.dot(R_t, terms.axis[t]) - terms.up
        J[t] = R_t @ _hat(terms.axis[t])
    return e, J


@compiled
@no_type_check
def tilt_weight(terms: Terms, e: Array) -> float:
    """Weight [1/rad²] of a tilt e (m, 3): the one given, or that of its mean square about both other axes."""
    if terms.axis_weight >= 0.0:
        return terms.axis_weight
    return 1.0 / (np.sum(e * e) / (2.0 * len(e)) + _CALM_RAD**2)


@compiled
@no_type_check
def _known_cost(terms: Terms, P: Array, weight: float, R: Array, T: Array) -> float:
    """Share of the pseudo-observations in the cost."""
    cost = 0.0
    if len(P) > 0:
        e, _ = smoothness(terms, R, T)
        for t in range(len(P)):
            cost += np.dot(e[t], np.dot(P[t], e[t]))
    if weight > 0.0:
        e, _ = tilt(terms, R)
        cost += weight * np.sum(e * e)
    return cost


@compiled
@no_type_check
def _add_known(terms: Terms, P: Array, weight: float, R: Array, T: Array, S: Array, rhs: Array, scale: Array) -> None:
    """Adds the pseudo-observations to the normal equations."""
    if len(P) > 0:
        e, J = smoothness(terms, R, T)
        for t in range(len(P)):
            i, JP = 6 * t, J[t].T @ P[t]
            N = JP @ J[t]
            S[i : i + 18, i : i + 18] += N
            rhs[i : i + 18] -= np.dot(JP, e[t])
            scale[i : i + 18] = np.sqrt(scale[i : i + 18] ** 2 + np.diag(N))
    if weight > 0.0:
        e, J = tilt(terms, R)
        for t in range(len(R)):
            i, N = 6 * t, weight * (J[t].T @ J[t])
            S[i : i + 3, i : i + 3] += N
            rhs[i : i + 3] -= weight * np.dot(J[t].T, e[t])
            scale[i : i + 3] = np.sqrt(scale[i : i + 3] ** 2 + np.diag(N))


@compiled
@no_type_check
def _move(R: Array, T: Array, dp: Array, R_new: Array, T_new: Array) -> None:
    """Writes the poses moved by dp (6m,): exp(dr) R, column by column, and T + dT."""
    for t in range(len(R)):
        r0, r1, r2, T0, T1, T2 = dp[6 * t : 6 * t + 6]
        a2 = r0 * r0 + r1 * r1 + r2 * r2
        s, c = _turn(a2)
        for k in range(3):
            x0, x1, x2 = R[t, 0, k], R[t, 1, k], R[t, 2, k]
            y0, y1, y2 = r1 * x2 - r2 * x1, r2 * x0 - r0 * x2, r0 * x1 - r1 * x0
            R_new[t, 0, k] = x0 + s * y0 + c * (r1 * y2 - r2 * y1)
            R_new[t, 1, k] = x1 + s * y1 + c * (r2 * y0 - r0 * y2)
            R_new[t, 2, k] = x2 + s * y2 + c * (r0 * y1 - r1 * y0)
        T_new[t, 0], T_new[t, 1], T_new[t, 2] = T[t, 0] + T0, T[t, 1] + T1, T[t, 2] + T2


@compiled
@no_type_check
def _datum(terms: Terms, R: Array) -> Array:
    """Allowed pose changes that only move the object frame, (6m, g)."""
    G = np.empty((6 * len(R), terms.datum.shape[1]))
    for row in range(len(G)):
        t, half, a = row // 6, row % 6 // 3 * 3, row % 3
        for k in range(G.shape[1]):
            G[row, k] = 0.0
            for b in range(3):
                G[row, k] += R[t, a, b] * terms.datum[half + b, k]
    return G


@compiled
@no_type_check
def _orthonormal(G: Array) -> None:
    """Makes the columns orthonormal: Gram-Schmidt, twice."""
    for _ in range(2):
        for k in range(G.shape[1]):
            for i in range(k + 1):
                product = 0.0
                for row in range(len(G)):
                    product += G[row, i] * G[row, k]
                for row in range(len(G)):
                    G[row, k] = G[row, k] - product * G[row, i] if i < k else G[row, k] / np.sqrt(product)


@compiled
@no_type_check
def without_datum(S: Array, scale: Array, G: Array) -> Array:
    """P S P + G G' in units of ``scale``; P projects onto the complement of the null space G (p, g), orthonormal there.

    The changes that only move the object frame get eigenvalues of one: no estimable quantity depends on them.
    """
    M, inverse = np.empty_like(S), 1.0 / scale
    for a in range(len(S)):
        for b in range(len(S)):
            M[a, b] = S[a, b] * inverse[a] * inverse[b]
    SG = np.dot(M, G)
    B = SG - np.dot(G, 0.5 * (np.dot(G.T, SG) + np.eye(G.shape[1])))
    # No product of the library's: from this size on it might start threads.
    G_rows, B_rows = np.ascontiguousarray(G.T), np.ascontiguousarray(B.T)
    for a in range(len(M)):
        row = M[a]
        for k in range(G.shape[1]):
            g, b, G_k, B_k = G[a, k], B[a, k], G_rows[k], B_rows[k]
            for c in range(len(M)):
                row[c] -= g * B_k[c] + b * G_k[c]
    return M


@compiled
@no_type_check
def _system(
    tiles: Tiles, terms: Terms, P: Array, weight: float, R: Array, T: Array, X: Array, factor: Array, newton: bool
) -> tuple[Array, Array, Array, Array]:
    """Matrix and right side for the allowed changes in units of the scale, the null space and the scale."""
    S, rhs, scale = reduced_system(tiles, R, T, X, factor, newton)
    _add_known(terms, P, weight, R, T, S, rhs, scale)
    G = _datum(terms, R)
    if terms.free.size > 0:
        F = np.ascontiguousarray(terms.free.T)
        S, rhs, G = np.dot(F, np.dot(S, terms.free)), np.dot(F, rhs), np.dot(F, G)
        scale = np.sqrt(np.dot(F * F, scale * scale))
    if not scale.min() > 0.0:
        return S, rhs, G, scale
    G = G * scale.reshape(-1, 1)
    _orthonormal(G)
    M, b = without_datum(S, scale, G), rhs / scale
    # What is known may hold the object frame itself; its place is the start's all the same.
    return M, b - np.dot(G, np.dot(G.T, b)), G, scale


@compiled
@no_type_check
def _right_side(
    tiles: Tiles, terms: Terms, P: Array, weight: float, R: Array, T: Array, X: Array, G: Array, scale: Array
) -> Array:
    """The right side of `_system` alone, with the null space and the scale of an earlier one."""
    rhs = right_side(tiles, R, T, X)
    if len(P) > 0 or weight > 0.0:
        _add_known(terms, P, weight, R, T, np.zeros((len(rhs), len(rhs))), rhs, np.zeros(len(rhs)))
    if terms.free.size > 0:
        rhs = np.dot(np.ascontiguousarray(terms.free.T), rhs)
    b = rhs / scale
    return b - np.dot(G, np.dot(G.T, b))


@compiled
@no_type_check
def _cholesky(M: Array) -> Array:
    """Lower factor of M; empty where M is not positive definite beyond rounding."""
    try:
        L = np.linalg.cholesky(M)
    except Exception:  # numba knows no other
        return np.empty((0, 0))
    for i in range(len(L)):
        if not L[i, i] ** 2 > _PIVOT:
            return np.empty((0, 0))
    return L


@compiled
@no_type_check
def _substitute(L: Array, b: Array) -> Array:
    """Solution of L L'x = b."""
    x = b.copy()
    for i in range(len(x)):
        x[i] = (x[i] - np.dot(L[i, :i], x[:i])) / L[i, i]
    for i in range(len(x) - 1, -1, -1):
        x[i] /= L[i, i]
        for k in range(i):
            x[k] -= x[i] * L[i, k]
    return x


@compiled
@no_type_check
def _step(M: Array, L: Array, b: Array, damping: float) -> Array:
    """Solution with the eigenvalues |lambda| + damping of M: downhill whatever their sign. L is M's factor or empty."""
    if len(L) > 0 and damping > 0.0:
        L = _cholesky(M + damping * np.eye(len(M)))
    if len(L) > 0:
        return _substitute(L, b)
    values, V = np.linalg.eigh(M)
    return np.dot(V, np.dot(V.T, b) / (np.abs(values) + damping))


@compiled
@no_type_check
def descend(
    tiles: Tiles,
    terms: Terms,
    follows: bool,
    second_order: bool,
    R_rl: Array,
    t_rl: Array,
    R: Array,
    T: Array,
    X: Array,
    stop: int,
    tolerance: float,
    max_iterations: int,
) -> tuple[int, int, float]:
    """Moves R (m, 3, 3), T (m, 3) and X to the optimum; returns status, iterations, cost. See `object_motion.adjust`.

    follows: the weights are evaluated at the current points, X in lanes: (tile * 3 + axis) * LANES + lane.
    """
    factor = np.empty(2 * len(X))
    damping, cost, decrement = 0.0, 0.0, np.inf
    P, weight = terms.P, max(terms.axis_weight, 0.0)
    R_new, T_new = np.empty_like(R), np.empty_like(T)
    M = L = G = np.empty((0, 0))
    b = x = scale = np.empty(0)
    for iteration in range(1, max_iterations + 1):
        if iteration <= _REWEIGHTED:
            if follows:
                reweight(tiles, R, T, X, R_rl, t_rl, second_order)
            if terms.gamma > 0.0:
                P = smoothness_weights(terms, smoothness(terms, R, T)[0])
            if terms.axis_weight < 0.0:
                weight = tilt_weight(terms, tilt(terms, R)[0])
        cost = best_points(tiles, R, T, X, factor)
        if np.isnan(cost):
            return UNDETERMINED_TRACK, iteration, cost
        cost += _known_cost(terms, P, weight, R, T)
        kept = len(L) > 0 and damping == 0.0 and decrement < _NEAR
        if kept:
            b = _right_side(tiles, terms, P, weight, R, T, X, G, scale)
            x = _substitute(L, b)
            kept = np.dot(b, x) < _WORTH * decrement
        if not kept:
            M, b, G, scale = _system(tiles, terms, P, weight, R, T, X, factor, decrement < _NEWTON * cost)
            if not scale.min() > 0.0:
                return UNOBSERVED_POSE, iteration, cost
            L = _cholesky(M)
            x = _step(M, L, b, damping)
        for _ in range(_TRIES):
            dp = x / scale
            if terms.free.size > 0:
                dp = np.dot(terms.free, dp)
            _move(R, T, dp, R_new, T_new)
            cost_new = best_points(tiles, R_new, T_new, X, factor) + _known_cost(terms, P, weight, R_new, T_new)
            if cost_new <= cost * (1.0 + 1e-12) + 1e-12:
                break
            damping = max(10.0 * damping, 1e-6)
            x = _step(M, L, b, damping)
        else:
            return STUCK, iteration, cost
        R[:], T[:], cost = R_new, T_new, cost_new
        decrement = np.dot(b, x)
        if damping > 1e-7:
            damping /= 10.0
            continue
        if damping > 0.0:
            damping, x = 0.0, _step(M, L, b, 0.0)
            decrement = np.dot(b, x)
        change = decrement
        if stop == UPDATE:
            change = np.abs(dp).max()
        elif stop == RELATIVE_UPDATE:
            N, _, H, _ = _system(tiles, terms, P, weight, R, T, X, factor, False)
            change = np.max(np.abs(x) / np.sqrt(np.diag(np.linalg.inv(N)) - np.sum(H * H, axis=1)))
        if change < tolerance:
            return CONVERGED, iteration, cost
    return EXHAUSTED, max_iterations, cost
