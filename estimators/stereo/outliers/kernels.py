"""Loops over tracks in compiled code: points, normal equations without the points, covariance of the residuals.

All arrays hold one row per observation, sorted by (point, frame); ``first`` (n + 1,) marks where each track begins.
"""

from __future__ import annotations

from typing import no_type_check

import numba
import numpy as np

Array = np.ndarray


@numba.njit(cache=True)
@no_type_check
def invert(N: Array, out: Array) -> bool:
    """Inverse of a symmetric positive definite 3x3 matrix by cofactors in unit-free scaling; False where it is none."""
    if not (N[0, 0] > 0 and N[1, 1] > 0 and N[2, 2] > 0):
        return False
    d0, d1, d2 = np.sqrt(N[0, 0]), np.sqrt(N[1, 1]), np.sqrt(N[2, 2])
    a, b, c = N[0, 1] / (d0 * d1), N[0, 2] / (d0 * d2), N[1, 2] / (d1 * d2)
    det = 1 - a * a - b * b - c * c + 2 * a * b * c
    if not det > 1e-13:
        return False
    out[0, 0] = (1 - c * c) / (det * d0 * d0)
    out[1, 1] = (1 - b * b) / (det * d1 * d1)
    out[2, 2] = (1 - a * a) / (det * d2 * d2)
    out[0, 1] = out[1, 0] = (b * c - a) / (det * d0 * d1)
    out[0, 2] = out[2, 0] = (a * c - b) / (det * d0 * d2)
    out[1, 2] = out[2, 1] = (a * b - c) / (det * d1 * d2)
    return True


@numba.njit(cache=True)
@no_type_check
def fit_points(
    first: Array, frame: Array, R: Array, T: Array, l: Array, W: Array, X: Array, v: Array, cost: Array
) -> bool:
    """Best points X (n, 3) for given poses, residuals v (k, 3) = R X + T - l and v'Wv of every track (n,)."""
    N, inverse, b = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for i in range(len(first) - 1):
        N[:], b[:] = 0.0, 0.0
        for k in range(first[i], first[i + 1]):
            R_t = R[frame[k]]
            for p in range(3):
                for q in range(3):
                    WR = W[k, q, 0] * R_t[0, p] + W[k, q, 1] * R_t[1, p] + W[k, q, 2] * R_t[2, p]
                    b[p] += WR * (l[k, q] - T[frame[k], q])
                    for r in range(3):
                        N[p, r] += WR * R_t[q, r]
        if not invert(N, inverse):
            return False
        for p in range(3):
            X[i, p] = inverse[p, 0] * b[0] + inverse[p, 1] * b[1] + inverse[p, 2] * b[2]
        cost[i] = 0.0
        for k in range(first[i], first[i + 1]):
            R_t = R[frame[k]]
            for p in range(3):
                v[k, p] = R_t[p, 0] * X[i, 0] + R_t[p, 1] * X[i, 1] + R_t[p, 2] * X[i, 2] + T[frame[k], p] - l[k, p]
            for p in range(3):
                for q in range(3):
                    cost[i] += v[k, p] * W[k, p, q] * v[k, q]
    return True


@numba.njit(cache=True)
@no_type_check
def eliminate(
    first: Array, frame: Array, R: Array, a: Array, W: Array, v: Array, w: Array,
    N_inv: Array, N_Xp: Array, h: Array, S: Array, rhs: Array,
) -> bool:  # fmt: skip
    """Normal equations of the poses before the points' share is taken off, (3.5.5)-(3.5.7), track i weighted by w_i.

    a (k, 3) = R_t X_i. Fills N_inv (n, 3, 3), N_Xp and h = N_inv N_Xp (n, 3, 6m), the block diagonal S (6m, 6m) and
    rhs (6m,) = -A'Wv; the points are at their best, so that their own right side is zero.
    """
    N, WR, A = np.empty((3, 3)), np.empty((3, 3)), np.zeros((3, 6))
    A[0, 3] = A[1, 4] = A[2, 5] = 1.0
    WA = np.empty((3, 6))
    N_Xp[:], S[:], rhs[:], h[:] = 0.0, 0.0, 0.0, 0.0
    for i in range(len(first) - 1):
        N[:] = 0.0
        for k in range(first[i], first[i + 1]):
            t = frame[k]
            A[0, 1], A[0, 2], A[1, 2] = a[k, 2], -a[k, 1], a[k, 0]
            A[1, 0], A[2, 0], A[2, 1] = -a[k, 2], a[k, 1], -a[k, 0]
            for p in range(3):
                for q in range(6):
                    WA[p, q] = W[k, p, 0] * A[0, q] + W[k, p, 1] * A[1, q] + W[k, p, 2] * A[2, q]
                for q in range(3):
                    WR[p, q] = W[k, p, 0] * R[t, 0, q] + W[k, p, 1] * R[t, 1, q] + W[k, p, 2] * R[t, 2, q]
            for p in range(3):
                for q in range(3):
                    N[p, q] += R[t, 0, p] * WR[0, q] + R[t, 1, p] * WR[1, q] + R[t, 2, p] * WR[2, q]
                for q in range(6):
                    N_Xp[i, p, 6 * t + q] = R[t, 0, p] * WA[0, q] + R[t, 1, p] * WA[1, q] + R[t, 2, p] * WA[2, q]
            if w[i] > 0:
                for p in range(6):
                    rhs[6 * t + p] -= w[i] * (WA[0, p] * v[k, 0] + WA[1, p] * v[k, 1] + WA[2, p] * v[k, 2])
                    for q in range(6):
                        S[6 * t + p, 6 * t + q] += w[i] * (A[0, p] * WA[0, q] + A[1, p] * WA[1, q] + A[2, p] * WA[2, q])
        if not invert(N, N_inv[i]):
            return False
        for p in range(3):
            for r in range(3):
                for k in range(first[i], first[i + 1]):
                    for q in range(6 * frame[k], 6 * frame[k] + 6):
                        h[i, p, q] += N_inv[i, p, r] * N_Xp[i, r, q]
    return True


@numba.njit(cache=True)
@no_type_check
def residual_blocks(
    first: Array, frame: Array, R: Array, a: Array, C: Array, Sigma: Array, h: Array, hS: Array,
    N_inv: Array, sign: Array, point_share: float, out: Array,
) -> None:  # fmt: skip
    """delta_st C_ll - sign_i P_st - point_share R_s N_inv R_t' of every track, out (n, 3c, 3c).

    P = (A - R h) Sigma (A - R h)' is what the poses contribute to the covariance of the fitted coordinates, hS = h
    Sigma. With sign = point_share = 1 it is C_vv of (3.4.11). Rows beyond a track's length are those of the identity.
    """
    p_size = Sigma.shape[0]
    Q, Z, V, RN = np.empty((3, p_size)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for i in range(len(first) - 1):
        count = first[i + 1] - first[i]
        out[i] = 0.0
        for p in range(3 * count, out.shape[1]):
            out[i, p, p] = 1.0
        V[:] = 0.0
        for p in range(3):
            for q in range(3):
                for k in range(first[i], first[i + 1]):
                    for c in range(6 * frame[k], 6 * frame[k] + 6):
                        V[p, q] += hS[i, p, c] * h[i, q, c]
        for s in range(count):
            k = first[i] + s
            u, f = frame[k], 6 * frame[k]
            a0, a1, a2 = a[k, 0], a[k, 1], a[k, 2]
            for c in range(p_size):
                r0, r1, r2 = Sigma[f, c], Sigma[f + 1, c], Sigma[f + 2, c]
                g0, g1, g2 = hS[i, 0, c], hS[i, 1, c], hS[i, 2, c]
                Q[0, c] = Sigma[f + 3, c] + a2 * r1 - a1 * r2 - R[u, 0, 0] * g0 - R[u, 0, 1] * g1 - R[u, 0, 2] * g2
                Q[1, c] = Sigma[f + 4, c] + a0 * r2 - a2 * r0 - R[u, 1, 0] * g0 - R[u, 1, 1] * g1 - R[u, 1, 2] * g2
                Q[2, c] = Sigma[f + 5, c] + a1 * r0 - a0 * r1 - R[u, 2, 0] * g0 - R[u, 2, 1] * g1 - R[u, 2, 2] * g2
            for q in range(3):  # Z_s = -Cov(fitted coordinates, points' dependence on the poses) = R_s V - A_s U_s
                t0, t1, t2 = hS[i, q, f], hS[i, q, f + 1], hS[i, q, f + 2]
                Z[0, q] = -(hS[i, q, f + 3] + a2 * t1 - a1 * t2)
                Z[1, q] = -(hS[i, q, f + 4] + a0 * t2 - a2 * t0)
                Z[2, q] = -(hS[i, q, f + 5] + a1 * t0 - a0 * t1)
            for p in range(3):
                for q in range(3):
                    Z[p, q] += R[u, p, 0] * V[0, q] + R[u, p, 1] * V[1, q] + R[u, p, 2] * V[2, q]
                    RN[p, q] = point_share * (
                        R[u, p, 0] * N_inv[i, 0, q] + R[u, p, 1] * N_inv[i, 1, q] + R[u, p, 2] * N_inv[i, 2, q]
                    )
                    Z[p, q] = sign[i] * Z[p, q] + RN[p, q]
            for t in range(s + 1):
                j = first[i] + t
                b0, b1, b2 = a[j, 0], a[j, 1], a[j, 2]
                R_t, g = R[frame[j]], 6 * frame[j]
                for p in range(3):
                    q0, q1, q2 = sign[i] * Q[p, g], sign[i] * Q[p, g + 1], sign[i] * Q[p, g + 2]
                    z0, z1, z2 = Z[p, 0], Z[p, 1], Z[p, 2]
                    y0 = sign[i] * Q[p, g + 3] + b2 * q1 - b1 * q2 + z0 * R_t[0, 0] + z1 * R_t[0, 1] + z2 * R_t[0, 2]
                    y1 = sign[i] * Q[p, g + 4] + b0 * q2 - b2 * q0 + z0 * R_t[1, 0] + z1 * R_t[1, 1] + z2 * R_t[1, 2]
                    y2 = sign[i] * Q[p, g + 5] + b1 * q0 - b0 * q1 + z0 * R_t[2, 0] + z1 * R_t[2, 1] + z2 * R_t[2, 2]
                    out[i, 3 * s + p, 3 * t], out[i, 3 * s + p, 3 * t + 1], out[i, 3 * s + p, 3 * t + 2] = -y0, -y1, -y2
                    if t == s:
                        for q in range(3):
                            out[i, 3 * s + p, 3 * s + q] += C[k, p, q]
        for p in range(3 * count):
            for q in range(p):
                out[i, q, p] = out[i, p, q]


@numba.njit(cache=True)
@no_type_check
def quadratic_forms(first: Array, M: Array, v: Array, T: Array) -> None:
    """T_i = v_i' M_i^-1 v_i by Cholesky, M (n, 3c, 3c) is overwritten; NaN where M_i is not positive definite."""
    for i in range(len(first) - 1):
        size = 3 * (first[i + 1] - first[i])
        T[i] = 0.0
        for p in range(size):
            diagonal = M[i, p, p]
            y = v[first[i] + p // 3, p % 3]
            for q in range(p):
                x = M[i, p, q]
                for r in range(q):
                    x -= M[i, p, r] * M[i, q, r]
                x *= M[i, q, q]
                M[i, p, q] = x
                y -= x * M[i, q, p]
            pivot = diagonal
            for q in range(p):
                pivot -= M[i, p, q] ** 2
            if not pivot > 1e-9 * diagonal:
                T[i] = np.nan
                break
            M[i, p, p] = 1 / np.sqrt(pivot)  # the inverse of the factor's diagonal
            y *= M[i, p, p]
            for q in range(p + 1, size):  # the solved right side is kept above the diagonal
                M[i, p, q] = y
            T[i] += y * y


@numba.njit(cache=True)
@no_type_check
def point_forms(first: Array, M: Array, v: Array, T: Array) -> None:
    """T_k = v_k' M_kk^-1 v_k with the 3x3 block of each observation on M_i's diagonal; NaN where it is singular."""
    inverse = np.empty((3, 3))
    for i in range(len(first) - 1):
        for k in range(first[i], first[i + 1]):
            s = 3 * (k - first[i])
            T[k] = 0.0 if invert(M[i, s : s + 3, s : s + 3], inverse) else np.nan
            for p in range(3):
                for q in range(3):
                    T[k] += v[k, p] * inverse[p, q] * v[k, q]
