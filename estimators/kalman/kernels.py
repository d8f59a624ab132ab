"""Compiled loops over runs, blocks of correlated measurements, and scalar measurements.

Each block is decorrelated first (Dickmanns 2007, 6.4.5.1), so that every scalar measurement has variance 1; each is
used in turn, and the innovations of the following ones are corrected for what it changed, (6.35).

One scalar measurement: row c (n,) of the Jacobian, innovation e already corrected. A function returns the innovation
covariance q of (6.57) and whether the measurement was used, e² <= gate² q; if so F (n, n) and dx (n,) are corrected.
"""

from __future__ import annotations

from typing import Any, no_type_check

import numba
import numpy as np

Array = np.ndarray
SEQUENTIAL, POTTER, CARLSON, UDU = range(4)
compiled = numba.njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc"})


@compiled
@no_type_check
def _sequential(P: Array, c: Array, e: Any, gate: Any, dx: Array, f: Array, k: Array) -> Any:
    """Covariance P itself, (6.37)."""
    n = len(c)
    f[:] = 0
    for a in range(n):
        if c[a] != 0:
            for b in range(n):
                f[b] += c[a] * P[a, b]
    q = c.dtype.type(1)
    for a in range(n):
        q += c[a] * f[a]
    if not e * e <= gate * gate * q:
        return q, False
    for a in range(n):
        k[a] = f[a] / q
        dx[a] += k[a] * e
    for a in range(n):
        for b in range(n):
            P[a, b] -= k[a] * f[b]
    return q, True


@compiled
@no_type_check
def _potter(S: Array, c: Array, e: Any, gate: Any, dx: Array, f: Array, k: Array) -> Any:
    """Root S, P = S S' (Potter 1964): S - k f' / (1 + sqrt(1/q)) with f = S' c, k = S f / q."""
    n = len(c)
    f[:] = 0
    for a in range(n):
        if c[a] != 0:
            for b in range(n):
                f[b] += S[a, b] * c[a]
    one = c.dtype.type(1)
    q = one
    for a in range(n):
        q += f[a] * f[a]
    if not e * e <= gate * gate * q:
        return q, False
    share = q / (q + np.sqrt(q))
    for a in range(n):
        total = S[a, 0] * f[0]
        for b in range(1, n):
            total += S[a, b] * f[b]
        k[a] = total / q
        dx[a] += k[a] * e
        total = share * k[a]
        for b in range(n):
            S[a, b] -= total * f[b]
    return q, True


@compiled
@no_type_check
def _carlson(S: Array, c: Array, e: Any, gate: Any, dx: Array, f: Array, k: Array) -> Any:
    """Upper triangular root, given as its transpose S, P = S' S, which stays triangular (Carlson 1973)."""
    n = len(c)
    one = c.dtype.type(1)
    q = one
    for b in range(n):
        total = S[b, 0] * c[0]
        for a in range(1, b + 1):
            total += S[b, a] * c[a]
        f[b] = total
        q += total * total
    if not e * e <= gate * gate * q:
        return q, False
    k[:] = 0
    before = one
    for b in range(n):
        after = before + f[b] * f[b]
        keep, mix = np.sqrt(before / after), f[b] / np.sqrt(before * after)
        for a in range(b + 1):
            old = S[b, a]
            S[b, a] = old * keep - k[a] * mix
            k[a] += old * f[b]
        before = after
    for a in range(n):
        dx[a] += k[a] / q * e
    return q, True


@compiled
@no_type_check
def _udu(F: Array, c: Array, e: Any, gate: Any, dx: Array, f: Array, k: Array) -> Any:
    """Factors of P = U D U', given as U' in F with D on its diagonal, (6.43)-(6.48).

    The factorisation of D - e e'/q is Bierman's recursion, column by column of U, without a subtraction of variances.
    """
    n = len(c)
    one = c.dtype.type(1)
    q = one
    for b in range(n):
        total = c[b]
        for a in range(b):
            total += F[b, a] * c[a]
        f[b] = total
        q += total * total * F[b, b]
    if not e * e <= gate * gate * q:
        return q, False
    before = one
    for b in range(n):
        g = F[b, b] * f[b]
        after = before + f[b] * g
        mix = -f[b] / before
        F[b, b] *= before / after
        for a in range(b):
            old = F[b, a]
            F[b, a] = old + k[a] * mix
            k[a] += old * g
        k[b] = g
        before = after
    for a in range(n):
        dx[a] += k[a] / q * e
    return q, True


@compiled
@no_type_check
def _whiten(R: Array, H: Array, dz: Array, h: Array, e: Array, L: Array) -> Any:
    """h = L^-1 H, e = L^-1 dz of one block, R = L L'; False where R is not positive definite."""
    b, n = H.shape
    for i in range(b):
        for j in range(i + 1):
            total = R[i, j]
            for s in range(j):
                total -= L[i, s] * L[j, s]
            if i == j:
                if not (0 < total < np.inf):
                    return False
                L[i, i] = np.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
        e[i] = dz[i]
        h[i] = H[i]
        for j in range(i):
            e[i] -= L[i, j] * e[j]
            for a in range(n):
                h[i, a] -= L[i, j] * h[j, a]
        e[i] /= L[i, i]
        for a in range(n):
            h[i, a] /= L[i, i]
    return True


@compiled
@no_type_check
def correct(form: int, F: Array, H: Array, dz: Array, R: Array, gate: Any) -> Any:
    """F (r, n, n) and dx (r, n) after the measurements H (r, m, n), dz (r, m) in blocks R (r, k, b, b).

    Also q and used (r, m), in units of the decorrelated measurements, nis (r,) the sum of e²/q of what was used, and
    the (run, block) whose R is not positive definite, or (-1, -1).
    """
    runs, m, n = H.shape
    blocks, b = R.shape[1], R.shape[2]
    F = F.copy()
    kind = F.dtype
    dx, q, nis = np.zeros((runs, n), kind), np.empty((runs, m), kind), np.zeros(runs, kind)
    used = np.zeros((runs, m), np.bool_)
    h, e, L = np.empty((b, n), kind), np.empty(b, kind), np.empty((b, b), kind)
    f, k = np.empty(n, kind), np.empty(n, kind)
    for r in range(runs):
        for block in range(blocks):
            i0 = block * b
            if not _whiten(R[r, block], H[r, i0 : i0 + b], dz[r, i0 : i0 + b], h, e, L):
                return F, dx, q, used, nis, (r, block)
            for j in range(b):
                rest = e[j]
                for a in range(n):
                    rest -= h[j, a] * dx[r, a]
                if form == SEQUENTIAL:
                    variance, taken = _sequential(F[r], h[j], rest, gate, dx[r], f, k)
                elif form == POTTER:
                    variance, taken = _potter(F[r], h[j], rest, gate, dx[r], f, k)
                elif form == CARLSON:
                    variance, taken = _carlson(F[r], h[j], rest, gate, dx[r], f, k)
                else:
                    variance, taken = _udu(F[r], h[j], rest, gate, dx[r], f, k)
                q[r, i0 + j], used[r, i0 + j] = variance, taken
                if taken:
                    nis[r] += rest * rest / variance
    return F, dx, q, used, nis, (-1, -1)


@compiled
@no_type_check
def thornton(W: Array, D: Array, F: Array) -> bool:
    """Factors F (r, n, n), as `_udu` has them, of W D W', (6.53)-(6.56); W (r, n, s) is used up.

    By weighted Gram-Schmidt in its modified order.
    False where a run's W D W' is not positive definite.
    """
    runs, n, s = W.shape
    for r in range(runs):
        for b in range(n - 1, -1, -1):
            length = W[r, b, 0] * W[r, b, 0] * D[r, 0]
            for j in range(1, s):
                length += W[r, b, j] * W[r, b, j] * D[r, j]
            if not length > 0:
                return False
            F[r, b, b] = length
            for a in range(b):
                total = W[r, a, 0] * D[r, 0] * W[r, b, 0]
                for j in range(1, s):
                    total += W[r, a, j] * D[r, j] * W[r, b, j]
                share = total / length
                F[r, b, a] = share
                F[r, a, b] = 0
                for j in range(s):
                    W[r, a, j] -= share * W[r, b, j]
    return True
