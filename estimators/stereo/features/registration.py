"""Registration of image patches to sub-pixel accuracy, compiled: all patches of a frame in one call.

A patch T of (2 h + 1)² grey values is found again in an image I under an affine warp W(x) = t + A x of its own
coordinates x, its contrast and brightness free:

    sum_x w(x) (g I(W(x)) + o - T(x))²  ->  min

Gradients are the mean of the patch's and the warped image's (efficient second-order minimisation, Benhimane and Malis
2004): of second order without second derivatives, and symmetric in both, so that neither image's interpolation draws
the result to whole pixels. Interpolation is bicubic. Weights w leave out what does not belong to the object. What is
free of A is held near where it starts by a standard deviation, in units of the grey values' residual.
"""

from __future__ import annotations

from typing import Any, no_type_check

import numba
import numpy as np

Array = np.ndarray
compiled = numba.njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract", "reassoc", "nsz"})
# Which of (t_x, t_y, A_xx, A_xy, A_yx, A_yy) are free: all; the place, the disparity's gradient too; the place alone.
AFFINE = np.array([0, 1, 2, 3, 4, 5])
STEREO = np.array([0, 1, 2, 3])
TRANSLATION = np.array([0, 1])
OUTSIDE, SINGULAR, DIVERGED, GOOD = range(4)
_EPS_PX = 0.002
_LEAST_GREY = 1.0  # no residual of grey values is trusted to be smaller


@compiled
@no_type_check
def sample(image: Array, t: Array, A: Array, out: Array) -> bool:
    """Grey values at t + A x for x on the grid of out (s, s), bicubic; False where the grid leaves the image."""
    s = out.shape[0]
    r = (s - 1) // 2
    height, width = image.shape
    for sy in (-r, r):
        for sx in (-r, r):
            x = t[0] + A[0, 0] * sx + A[0, 1] * sy
            y = t[1] + A[1, 0] * sx + A[1, 1] * sy
            if not (x >= 1.0 and y >= 1.0 and x < width - 2.0 and y < height - 2.0):
                return False
    wx, wy = np.empty(4), np.empty(4)
    for i in range(s):
        for j in range(s):
            x = t[0] + A[0, 0] * (j - r) + A[0, 1] * (i - r)
            y = t[1] + A[1, 0] * (j - r) + A[1, 1] * (i - r)
            x0, y0 = int(x), int(y)
            _cubic(x - x0, wx)
            _cubic(y - y0, wy)
            total = 0.0
            for a in range(4):
                row = image[y0 - 1 + a]
                total += wy[a] * (wx[0] * row[x0 - 1] + wx[1] * row[x0] + wx[2] * row[x0 + 1] + wx[3] * row[x0 + 2])
            out[i, j] = total
    return True


@compiled
@no_type_check
def _cubic(f: float, w: Array) -> None:
    """Weights of four neighbours at a fraction f (Keys 1981, a = -1/2)."""
    w[0] = f * (f * (1.0 - 0.5 * f) - 0.5)
    w[1] = f * f * (1.5 * f - 2.5) + 1.0
    w[2] = f * (f * (2.0 - 1.5 * f) + 0.5)
    w[3] = f * f * (0.5 * f - 0.5)


@compiled
@no_type_check
def cut(image: Array, uv: Array, A: Array, mask: Array, patches: Array, weights: Array) -> Array:
    """Patches (n, s, s), one pixel wider on each side than they are used, at uv (n, 2) under A (n, 2, 2).

    weights (n, s - 2, s - 2): 1 where the mask holds (an empty mask: everywhere). Returns which lie in the image (n,).
    """
    n, s = patches.shape[0], patches.shape[1]
    r = (s - 3) // 2
    good = np.zeros(n, np.bool_)
    for k in range(n):
        good[k] = sample(image, uv[k], A[k], patches[k])
        for i in range(s - 2):
            for j in range(s - 2):
                weights[k, i, j] = 1.0
                if mask.size:
                    x = int(np.rint(uv[k, 0] + A[k, 0, 0] * (j - r) + A[k, 0, 1] * (i - r)))
                    y = int(np.rint(uv[k, 1] + A[k, 1, 0] * (j - r) + A[k, 1, 1] * (i - r)))
                    inside = 0 <= x < mask.shape[1] and 0 <= y < mask.shape[0]
                    weights[k, i, j] = 1.0 if inside and mask[y, x] else 0.0
    return good


@compiled
@no_type_check
def _normalise(S: Array, T: Array, w: Array) -> Any:
    """Gain and offset that bring the inside of S to that of T, and their correlation."""
    s = w.shape[0]
    W = mS = mT = 0.0
    for i in range(s):
        for j in range(s):
            W += w[i, j]
            mS += w[i, j] * S[i + 1, j + 1]
            mT += w[i, j] * T[i + 1, j + 1]
    mS, mT = mS / W, mT / W
    vS = vT = c = 0.0
    for i in range(s):
        for j in range(s):
            a, b = S[i + 1, j + 1] - mS, T[i + 1, j + 1] - mT
            vS += w[i, j] * a * a
            vT += w[i, j] * b * b
            c += w[i, j] * a * b
    if not (vS > 0 and vT > 0):
        return 0.0, 0.0, 0.0
    gain = np.sqrt(vT / vS)
    return gain, mT - gain * mS, c / np.sqrt(vS * vT)


@compiled
@no_type_check
def register(
    image: Array,
    patches: Array,
    weights: Array,
    free: Array,
    spread: float,
    iterations: int,
    t: Array,
    A: Array,
    ncc: Array,
    sigma: Array,
    cov: Array,
    state: Array,
) -> None:
    """Finds patches (n, s, s) in an image, from and into t (n, 2), A (n, 2, 2).

    spread: standard deviation of A's free entries about their start, infinite where nothing is known of them. ncc (n,)
    correlation; sigma (n,) standard deviation of a grey value's residual; cov (n, 2, 2) [px²] of t, free parameters
    that are not t eliminated; state (n,): GOOD, or why not.
    """
    n, s = patches.shape[0], weights.shape[1]
    r, q = (s - 1) // 2, len(free)
    S, J = np.empty((s + 2, s + 2)), np.empty(6)
    N, b, D = np.empty((q, q)), np.empty(q), np.empty(6)
    A0 = np.empty((2, 2))
    for k in range(n):
        T, w = patches[k], weights[k]
        state[k], ncc[k] = DIVERGED, 0.0
        count = w.sum()
        if not count > 2 * q + 2:
            state[k] = SINGULAR
            continue
        A0[:] = A[k]
        for _ in range(iterations):
            if not sample(image, t[k], A[k], S):
                state[k] = OUTSIDE
                break
            gain, offset, ncc[k] = _normalise(S, T, w)
            if gain == 0.0:
                state[k] = SINGULAR
                break
            N[:] = 0.0
            b[:] = 0.0
            cost = 0.0
            for i in range(s):
                for j in range(s):
                    if w[i, j] == 0.0:
                        continue
                    gx = 0.25 * (gain * (S[i + 1, j + 2] - S[i + 1, j]) + T[i + 1, j + 2] - T[i + 1, j])
                    gy = 0.25 * (gain * (S[i + 2, j + 1] - S[i, j + 1]) + T[i + 2, j + 1] - T[i, j + 1])
                    J[0], J[1] = gx, gy
                    J[2], J[3] = gx * (j - r), gx * (i - r)
                    J[4], J[5] = gy * (j - r), gy * (i - r)
                    e = T[i + 1, j + 1] - gain * S[i + 1, j + 1] - offset
                    cost += w[i, j] * e * e
                    for a in range(q):
                        g = w[i, j] * J[free[a]]
                        b[a] += g * e
                        for c in range(a + 1):
                            N[a, c] += g * J[free[c]]
            sigma[k] = np.sqrt(cost / (count - q - 2))
            stiffness = max(sigma[k], _LEAST_GREY) ** 2 / spread**2
            _strain(A0, A[k], D)
            for a in range(q):
                if free[a] >= 2:
                    N[a, a] += stiffness
                    b[a] -= stiffness * D[free[a]]
            if not _inverse(N):
                state[k] = SINGULAR
                break
            moved = _compose(t[k], A[k], N, b, free)
            if moved < _EPS_PX:
                state[k] = GOOD
                break
            if not moved < r:
                break
        if state[k] == GOOD:
            for a in range(2):
                for c in range(2):
                    cov[k, a, c] = sigma[k] * sigma[k] * N[a, c]


@compiled
@no_type_check
def _strain(A0: Array, A: Array, D: Array) -> None:
    """Entries of A0^-1 A - 1, into D (6,) as in `AFFINE`."""
    det = A0[0, 0] * A0[1, 1] - A0[0, 1] * A0[1, 0]
    D[2] = (A0[1, 1] * A[0, 0] - A0[0, 1] * A[1, 0]) / det - 1.0
    D[3] = (A0[1, 1] * A[0, 1] - A0[0, 1] * A[1, 1]) / det
    D[4] = (A0[0, 0] * A[1, 0] - A0[1, 0] * A[0, 0]) / det
    D[5] = (A0[0, 0] * A[1, 1] - A0[1, 0] * A[0, 1]) / det - 1.0


@compiled
@no_type_check
def _compose(t: Array, A: Array, N: Array, b: Array, free: Array) -> float:
    """W <- W o dW with the step dp = N b of a patch's own coordinates; how far t moves [px]."""
    d = np.zeros(6)
    for a in range(len(free)):
        for c in range(len(free)):
            d[free[a]] += N[a, c] * b[c]
    dx = A[0, 0] * d[0] + A[0, 1] * d[1]
    dy = A[1, 0] * d[0] + A[1, 1] * d[1]
    t[0] += dx
    t[1] += dy
    a00, a01, a10, a11 = A[0, 0], A[0, 1], A[1, 0], A[1, 1]
    A[0, 0] = a00 * (1.0 + d[2]) + a01 * d[4]
    A[0, 1] = a00 * d[3] + a01 * (1.0 + d[5])
    A[1, 0] = a10 * (1.0 + d[2]) + a11 * d[4]
    A[1, 1] = a10 * d[3] + a11 * (1.0 + d[5])
    return np.sqrt(dx * dx + dy * dy)


@compiled
@no_type_check
def _inverse(N: Array) -> bool:
    """Inverse of a symmetric positive definite matrix given by its lower half, in place; False where it is singular."""
    n = N.shape[0]
    L = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = N[i, j]
            for c in range(j):
                total -= L[i, c] * L[j, c]
            if i == j:
                if not total > 1e-6 * N[i, i]:
                    return False
                L[i, i] = np.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    for c in range(n):
        for i in range(n):
            total = 1.0 if i == c else 0.0
            for j in range(i):
                total -= L[i, j] * N[j, c]
            N[i, c] = total / L[i, i]
        for i in range(n - 1, -1, -1):
            total = N[i, c]
            for j in range(i + 1, n):
                total -= L[j, i] * N[j, c]
            N[i, c] = total / L[i, i]
    return True


@compiled
@no_type_check
def best_match(image: Array, patches: Array, weights: Array, places: Array, t: Array, ncc: Array) -> None:
    """Of the places (n, c, 2) in the image the one that correlates best with each patch (n, s, s), into t (n, 2).

    ncc (n, 2): the best correlation, and the best one farther than two pixels from it. Whole pixels are compared.
    """
    n, s = patches.shape[0], weights.shape[1]
    r = (s - 1) // 2
    height, width = image.shape
    for k in range(n):
        T, w = patches[k], weights[k]
        found = np.full(places.shape[1], -1.0)
        W = mT = 0.0
        for i in range(s):
            for j in range(s):
                W += w[i, j]
                mT += w[i, j] * T[i + 1, j + 1]
        mT /= max(W, 1.0)
        vT = 0.0
        for i in range(s):
            for j in range(s):
                vT += w[i, j] * (T[i + 1, j + 1] - mT) ** 2
        best = -1
        for c in range(places.shape[1]):
            x, y = places[k, c, 0], places[k, c, 1]
            if not (x >= r and y >= r and x < width - r - 1 and y < height - r - 1) or not vT > 0:
                continue
            x0, y0 = int(np.rint(x)) - r, int(np.rint(y)) - r
            m = v = cross = 0.0
            for i in range(s):
                for j in range(s):
                    value = w[i, j] * image[y0 + i, x0 + j]
                    m += value
                    v += value * image[y0 + i, x0 + j]
                    cross += value * (T[i + 1, j + 1] - mT)
            v -= m * m / W
            if v > 0:
                found[c] = cross / np.sqrt(v * vT)
                if best < 0 or found[c] > found[best]:
                    best = c
        ncc[k] = -1.0
        if best >= 0:
            t[k] = places[k, best]
            ncc[k, 0] = found[best]
            for c in range(places.shape[1]):
                far = abs(places[k, c, 0] - t[k, 0]) + abs(places[k, c, 1] - t[k, 1]) > 2.0
                if far and found[c] > ncc[k, 1]:
                    ncc[k, 1] = found[c]
