"""Compiled loops over runs, blocks of correlated measurements, and scalar measurements.

Each block is decorrelated first (Dickmanns 2007, 6.4.5.1), so that every scalar measurement has variance 1; each is
used in turn, and the innovations of the following ones are corrected for what it changed, (6.35). Many measurements
without a gate are first compressed to as many as there are states, by an orthogonal transformation.

Work space: W (n + 1, b, k'), the blocks along its last axis, filled up with zeros to a multiple of eight; W[a] is what
the measurements say of a state, the last their innovations. L (b, b, k') the Cholesky factors, their diagonal inverted.
"""

from __future__ import annotations

from typing import Any, no_type_check

import numpy as np

from estimators.kalman import scalars
from estimators.kalman.scalars import Array, compiled, dot, leading_zeros

SEQUENTIAL, POTTER, CARLSON, UDU = range(4)


@compiled
@no_type_check
def _factored(R: Array, L: Array) -> int:
    """L of all blocks R (k, b, b) = L L'; the first block that is not positive definite, or -1."""
    k, b = R.shape[:2]
    for j in range(b):
        for l in range(j + 1):
            L[j, l] = j == l
            for i in range(k):
                L[j, l, i] = R[i, j, l]
    for j in range(b):
        for l in range(j + 1):
            entry = L[j, l]
            for s in range(l):
                left, right = L[j, s], L[l, s]
                for i in range(len(entry)):
                    entry[i] -= left[i] * right[i]
            if l < j:
                inverse = L[l, l]
                for i in range(len(entry)):
                    entry[i] *= inverse[i]
            else:
                for i in range(k):
                    if not (0 < entry[i] < np.inf):
                        return i
                for i in range(len(entry)):
                    entry[i] = 1 / np.sqrt(entry[i])
    return -1


@compiled
@no_type_check
def _whitened(H: Array, dz: Array, L: Array, W: Array, states: Array, used: Array) -> int:
    """W and used (m,) of the measurements H (m, n), dz (m,); zeros, and not used, where a block is not finite.

    How many states are measured, with their indices at the start of ``states``; W has no others.
    """
    m, n = H.shape
    b, k, width = len(L), m // len(L), W.shape[2]
    W[:, :, k:] = 0
    count = 0
    for a in range(n):
        if leading_zeros(H[:, a]) < m:
            column = W[count]
            for j in range(b):
                for i in range(k):
                    column[j, i] = H[i * b + j, a]
            states[count] = a
            count += 1
    for i in range(k):
        seen = True
        for j in range(b):
            W[count, j, i] = dz[i * b + j]
            seen &= np.isfinite(dz[i * b + j])
        used[i * b : i * b + b] = seen
        if not seen:
            W[:, :, i] = 0
    for a in range(count + 1):
        for j in range(b):
            for l in range(j):
                for i in range(width):
                    W[a, j, i] -= L[j, l, i] * W[a, l, i]
            for i in range(width):
                W[a, j, i] *= L[j, j, i]
    return count


@compiled
@no_type_check
def _alike(W: Array, n: int) -> bool:
    """Whether no measurement would drown in the rounding of another: lengths of rows within eps^-1/4."""
    square = np.zeros(W.shape[1], W.dtype)
    for a in range(n):
        for i in range(len(square)):
            square[i] += W[a, i] * W[a, i]
    most, least = square[0], square.dtype.type(np.inf)
    for i in range(len(square)):
        most = max(most, square[i])
        least = min(least, square[i] if square[i] > 0 else least)
    return most * np.sqrt(np.finfo(W.dtype).eps) <= least


@compiled
@no_type_check
def _compressed(W: Array, n: int, C: Array) -> Any:
    """Rows C (n, n + 1) that say the same as the measurements W (n + 1, m), and the sum of squares they leave.

    Gram-Schmidt in its modified order, as stable as Householder's transformation; nothing is squared.
    """
    m = W.shape[1]
    C[:] = 0
    for a in range(n):
        unit = W[a]
        C[a, a] = np.sqrt(dot(unit, unit, m))
        if C[a, a] > 0:
            inverse = 1 / C[a, a]
            for i in range(m):
                unit[i] *= inverse
            for b in range(a + 1, n + 1):
                column = W[b]
                share = dot(unit, column, m)
                C[a, b] = share
                for i in range(m):
                    column[i] -= share * unit[i]
    return dot(W[n], W[n], m)


@compiled
@no_type_check
def _scalar(form: int, dx: Array, F: Array, c: Array, e: Any, gate: Any, f: Array, k: Array, d: Array) -> Any:
    """One measurement: whether it was used, and its e²/q if so."""
    if form == SEQUENTIAL:
        q, used = scalars.sequential(F, c, e, gate, dx, f, k)
    elif form == POTTER:
        q, used = scalars.potter(F, c, e, gate, dx, f, k)
    elif form == CARLSON:
        q, used = scalars.carlson(F, c, e, gate, dx, f, k)
    else:
        q, used = scalars.udu(F, c, e, gate, dx, f, k, d)
    return used, e * e / q if used else 0 * q


@compiled
@no_type_check
def _corrected(
    form: int, dx: Array, F: Array, H: Array, dz: Array, L: Array, gate: Any, W: Array, C: Array, used: Array
) -> Any:
    """Corrects dx (n,), all zero, and F (n, n) of one run, and tells used (m,); the NIS of what was used."""
    n, m, b = len(dx), len(dz), len(L)
    f, k, d = np.empty(n, F.dtype), np.empty(n, F.dtype), np.empty(n, F.dtype)
    if form == UDU:
        for a in range(n):
            d[a], F[a, a] = F[a, a], 1
    states = np.empty(n, np.int64)
    count = _whitened(H, dz, L, W, states, used)
    flat, nis = W.reshape(n + 1, -1), F.dtype.type(0)
    compressed = gate == np.inf and m > 2 * count and _alike(flat, count)
    if compressed:
        nis = _compressed(flat, count, C)
    c = np.zeros(n, F.dtype)
    for i in range(count if compressed else m):
        if compressed or used[i]:
            for a in range(count):
                c[states[a]] = C[i, a] if compressed else W[a, i % b, i // b]
            e = (C[i, count] if compressed else W[count, i % b, i // b]) - dot(dx, c, n)
            taken, share = _scalar(form, dx, F, c, e, gate, f, k, d)
            nis += share
            if not compressed:
                used[i] = taken
    if form == UDU:
        for a in range(n):
            F[a, a] = d[a]
    return nis


@compiled
@no_type_check
def _space(F: Array, R: Array) -> Any:
    """L, W and C of the docstrings above."""
    k, b = R.shape[-3:-1]
    n, wide, kind = F.shape[-1], (k + 7) // 8 * 8, F.dtype
    return np.empty((b, b, wide), kind), np.empty((n + 1, b, wide), kind), np.empty((n, n + 1), kind)


@compiled
@no_type_check
def correct(form: int, x: Array, F: Array, H: Array, dz: Array, R: Array, gate: Any) -> Any:
    """x (n,) and F (n, n) corrected by measurements H (m, n), dz (m,) in blocks R (k, b, b); used (m,), NIS ().

    Last, the block whose R is not positive definite, or -1.
    """
    L, W, C = _space(F, R)
    dx, F = np.zeros_like(x), F.copy()
    used, nis = np.zeros(len(dz), np.bool_), np.zeros((), F.dtype)
    wrong = _factored(R, L)
    if wrong < 0:
        nis[()] = _corrected(form, dx, F, H, dz, L, gate, W, C, used)
    return x + dx, F, used, nis, wrong


@compiled
@no_type_check
def correct_runs(form: int, x: Array, F: Array, H: Array, dz: Array, R: Array, gate: Any) -> Any:
    """As `correct` for r runs along a first axis, which is of length 1 where all of them have the same."""
    L, W, C = _space(F, R)
    runs, m = len(x), dz.shape[1]
    dx, out = np.zeros_like(x), np.empty((runs, *F.shape[1:]), F.dtype)
    used, nis = np.zeros((runs, m), np.bool_), np.zeros(runs, F.dtype)
    for r in range(runs):
        if r < len(R):
            wrong = _factored(R[r], L)
            if wrong >= 0:
                return x, out, used, nis, wrong
        out[r] = F[r % len(F)]
        nis[r] = _corrected(form, dx[r], out[r], H[r % len(H)], dz[r], L, gate, W, C, used[r])
    return x + dx, out, used, nis, -1


@compiled
@no_type_check
def thornton(W: Array, D: Array, F: Array) -> bool:
    """Factors F (r, n, n), as `_udu` has them, of W D W', (6.53)-(6.56); W (r, n, s) is used up.

    By weighted Gram-Schmidt in its modified order.
    False where a run's W D W' is not positive definite.
    """
    runs, n, s = W.shape
    weighted = np.empty(s, W.dtype)
    for r in range(runs):
        for b in range(n - 1, -1, -1):
            row = W[r, b]
            for j in range(s):
                weighted[j] = row[j] * D[r, j]
            length = dot(row, weighted, s)
            if not length > 0:
                return False
            F[r, b, b] = length
            for a in range(b):
                other = W[r, a]
                share = dot(other, weighted, s) / length
                F[r, b, a] = share
                F[r, a, b] = 0
                for j in range(s):
                    other[j] -= share * row[j]
    return True
