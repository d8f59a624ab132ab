"""One scalar measurement of variance 1, in the forms that use one after the other, compiled.

Row c (n,) of the Jacobian, innovation e already corrected for the measurements before, (6.35); f and k (n,) are work
space. A function returns the innovation covariance q of (6.57) and whether the measurement was used, e² <= gate² q; if
so the state's correction x (n,) and F (n, n) are changed.
"""

from __future__ import annotations

from typing import Any, no_type_check

import numba
import numpy as np

Array = np.ndarray
compiled = numba.njit(cache=True, error_model="numpy", fastmath={"contract"})


@numba.njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc"})
@no_type_check
def dot(a: Array, b: Array, length: int) -> Any:
    """The sum of a b, in any order."""
    total = a.dtype.type(0)
    for i in range(length):
        total += a[i] * b[i]
    return total


@compiled
@no_type_check
def padded(b: int, n: int) -> int:
    """How much of row b of a triangle to go through, the zeros behind it filling up a processor's register."""
    return min(n, b // 4 * 4 + 4)


@compiled
@no_type_check
def leading_zeros(c: Array) -> int:
    """How many entries of a row are zero before the first that is not."""
    a = 0
    while a < len(c) and c[a] == 0:
        a += 1
    return a


@compiled
@no_type_check
def sequential(P: Array, c: Array, e: Any, gate: Any, x: Array, f: Array, k: Array) -> Any:
    """Covariance P itself, (6.37)."""
    n = len(c)
    f[:] = 0
    for a in range(n):
        if c[a] != 0:
            for b in range(n):
                f[b] += c[a] * P[a, b]
    q = dot(c, f, n) + c.dtype.type(1)
    if not e * e <= gate * gate * q:
        return q, False
    inverse = 1 / q
    for a in range(n):
        k[a] = f[a] * inverse
        x[a] += k[a] * e
    for a in range(n):
        for b in range(n):
            P[a, b] -= k[a] * f[b]
    return q, True


@compiled
@no_type_check
def potter(S: Array, c: Array, e: Any, gate: Any, x: Array, f: Array, k: Array) -> Any:
    """Root S, P = S S' (Potter 1964): S - k f' / (1 + sqrt(1/q)) with f = S' c, k = S f / q."""
    n = len(c)
    f[:] = 0
    for a in range(n):
        if c[a] != 0:
            for b in range(n):
                f[b] += S[a, b] * c[a]
    q = dot(f, f, n) + c.dtype.type(1)
    if not e * e <= gate * gate * q:
        return q, False
    share = 1 / (q + np.sqrt(q))
    step = e / q
    for a in range(n):
        k[a] = dot(f, S[a], n)
        x[a] += k[a] * step
        k[a] *= share
        for b in range(n):
            S[a, b] -= k[a] * f[b]
    return q, True


@compiled
@no_type_check
def carlson(S: Array, c: Array, e: Any, gate: Any, x: Array, f: Array, k: Array) -> Any:
    """Upper triangular root, given as its transpose S, P = S' S, which stays triangular (Carlson 1973)."""
    n = len(c)
    one = c.dtype.type(1)
    q = one
    first = leading_zeros(c)
    for b in range(first, n):
        f[b] = dot(S[b], c, padded(b, n))
        q += f[b] * f[b]
    if not e * e <= gate * gate * q:
        return q, False
    k[:] = 0
    before = one
    for b in range(first, n):
        after = before + f[b] * f[b]
        keep, mix = np.sqrt(before / after), f[b] / np.sqrt(before * after)
        for a in range(padded(b, n)):
            old = S[b, a]
            S[b, a] = old * keep - k[a] * mix
            k[a] += old * f[b]
        before = after
    step = e / q
    for a in range(n):
        x[a] += k[a] * step
    return q, True


@compiled
@no_type_check
def udu(U: Array, c: Array, e: Any, gate: Any, x: Array, f: Array, k: Array, d: Array) -> Any:
    """Factors of P = U D U', given as U' and d, (6.43)-(6.48).

    The factorisation of D - e e'/q is Bierman's recursion, column by column of U, without a subtraction of variances.
    """
    n = len(c)
    one = c.dtype.type(1)
    q = one
    first = leading_zeros(c)
    for b in range(first, n):
        f[b] = dot(U[b], c, padded(b, n))
        q += f[b] * f[b] * d[b]
    if not e * e <= gate * gate * q:
        return q, False
    k[:] = 0
    before = one
    for b in range(first, n):
        g = d[b] * f[b]
        after = before + f[b] * g
        mix = -f[b] / before
        d[b] *= before / after
        for a in range(padded(b, n)):
            old = U[b, a]
            U[b, a] = old + k[a] * mix
            k[a] += old * g
        before = after
    step = e / q
    for a in range(n):
        x[a] += k[a] * step
    return q, True
