"""One scalar measurement of variance 1, in the forms that use one after the other, compiled.

Row c (n,) of the Jacobian, innovation e already corrected for the measurements before, (6.35); f and k (n,) are work
space. A function returns the innovation covariance q of (6.57) and whether the measurement was used, e² <= gate² q; if
so the state x (n,) and F (n, n) are corrected.
"""

from __future__ import annotations

from typing import Any, no_type_check

import numba
import numpy as np

Array = np.ndarray
compiled = numba.njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc"})


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
    q = c.dtype.type(1)
    for a in range(n):
        q += c[a] * f[a]
    if not e * e <= gate * gate * q:
        return q, False
    for a in range(n):
        k[a] = f[a] / q
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
        x[a] += k[a] * e
        total = share * k[a]
        for b in range(n):
            S[a, b] -= total * f[b]
    return q, True


@compiled
@no_type_check
def carlson(S: Array, c: Array, e: Any, gate: Any, x: Array, f: Array, k: Array) -> Any:
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
        x[a] += k[a] / q * e
    return q, True


@compiled
@no_type_check
def udu(F: Array, c: Array, e: Any, gate: Any, x: Array, f: Array, k: Array) -> Any:
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
        x[a] += k[a] / q * e
    return q, True
