"""The one rigid motion of many points from an earlier stereo frame to now, and how far each is from following it.

Image coordinates are normalised, (x_l, y_l, x_r, y_r) = (X/Z, Y/Z) in the left and in the right camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float

from estimators.stereo.features.registration import compiled
from sim.pose import Pose, exp_so3

Array = np.ndarray
_ITERATIONS, _ENOUGH = 8, 1e-5
_NEAREST_M = 0.3
_MEDIAN = 3.36  # of chi-square with the 4 degrees of freedom of a stereo point


@dataclass(frozen=True, eq=False)
class Motion:
    """x_now = R x_before + t [m], and the variance of an image coordinate (normalised) that its points show."""

    R: Float[Array, "3 3"]
    t: Float[Array, "3"]
    variance: float

    def apply(self, p: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        return np.asarray(p @ self.R.T + self.t)


def distance(
    T_rl: Pose, motion: Motion, p: Float[Array, "n 3"], xy: Float[Array, "n 4"], variance: Float[Array, "n"]
) -> Float[Array, "n"]:
    """Squared Mahalanobis distance, of 4 degrees of freedom, of what is seen at xy from where points p [m] move to.

    Points were triangulated from coordinates of the same variance; with M the Jacobian of the place now and N_0 the
    weight of the point before, r' (1 + M N_0⁻¹ M')⁻¹ r = r'r - r'M (M'M + N_0)⁻¹ M'r. Infinite behind a camera.
    """
    p = np.ascontiguousarray(p)
    return np.asarray(_equations(motion.R, motion.t, p, xy, variance, T_rl.R, T_rl.t, 0.0)[0])


def fit(
    T_rl: Pose,
    start: Motion,
    p: Float[Array, "n 3"],
    xy: Float[Array, "n 4"],
    relative: Float[Array, "n"],
    sigma: Float[Array, "6"],
) -> Motion:
    """The motion that points p [m], seen now at xy, follow, by Gauss-Newton reweighted after Geman and McClure.

    relative: variances of the points' coordinates in a common unit, in which the motion's variance is. sigma: how far
    the rotation [rad] and translation [m] may be from the start. The start's variance is the least that is believed;
    above, it is what the median point shows.
    """
    R, t, off = start.R, start.t, np.zeros(6)
    least, variance = start.variance, start.variance
    p = np.ascontiguousarray(p)
    d, _, _ = _equations(R, t, p, xy, relative, T_rl.R, T_rl.t, 0.0)
    for _ in range(_ITERATIONS):
        variance = max(float(np.median(d)) / _MEDIAN, least)
        if not np.isfinite(variance):
            return start
        d, N, b = _equations(R, t, p, xy, relative, T_rl.R, T_rl.t, variance)
        held = variance / sigma**2
        step = np.linalg.solve(N + np.diag(held), b - held * off)
        off += step
        R, t = exp_so3(step[:3]) @ R, t + step[3:]
        if np.abs(step).max() < _ENOUGH:
            break
    return Motion(R, t, variance)


@compiled
@no_type_check
def _equations(R: Array, t: Array, p: Array, xy: Array, own: Array, R_rl: Array, t_rl: Array, variance: float) -> tuple:
    """Squared distances (n,) for the points' own variances, and where a factor of these is given, the weighted normal
    equations of the step.

    The step turns q = R p + t about where the origin came to, and shifts it: q moves by w x R p + s.
    """
    d, N, b = np.empty(len(p)), np.zeros((6, 6)), np.zeros(6)
    J0, J, A, seen = np.empty((4, 3)), np.empty((4, 3)), np.empty((4, 6)), np.empty(4)
    turned, q, r = np.empty(3), np.empty(3), np.empty(4)
    for i in range(len(p)):
        for c in range(3):
            turned[c] = R[c, 0] * p[i, 0] + R[c, 1] * p[i, 1] + R[c, 2] * p[i, 2]
            q[c] = turned[c] + t[c]
        if not (_project(p[i], R_rl, t_rl, seen, J0) and _project(q, R_rl, t_rl, seen, J)):
            d[i] = np.inf
            continue
        for c in range(4):
            r[c] = xy[i, c] - seen[c]
        d[i] = max(_unexplained(R, J0, J, r), 0.0) / own[i]
        if variance > 0:
            w = 1 / (1 + d[i] / (4 * variance)) ** 2 / own[i]
            for c in range(4):
                A[c, 0] = J[c, 2] * turned[1] - J[c, 1] * turned[2]
                A[c, 1] = J[c, 0] * turned[2] - J[c, 2] * turned[0]
                A[c, 2] = J[c, 1] * turned[0] - J[c, 0] * turned[1]
                A[c, 3], A[c, 4], A[c, 5] = J[c, 0], J[c, 1], J[c, 2]
                for k in range(6):
                    b[k] += w * A[c, k] * r[c]
                    for m in range(k + 1):
                        N[k, m] += w * A[c, k] * A[c, m]
    for k in range(6):
        for m in range(k):
            N[m, k] = N[k, m]
    return d, N, b


@compiled
@no_type_check
def _project(p: Array, R_rl: Array, t_rl: Array, seen: Array, J: Array) -> bool:
    """Normalised coordinates in both cameras and their Jacobian; False where the point is not before both."""
    q = R_rl @ np.ascontiguousarray(p) + t_rl
    if not (p[2] > _NEAREST_M and q[2] > _NEAREST_M):
        return False
    seen[0], seen[1], seen[2], seen[3] = p[0] / p[2], p[1] / p[2], q[0] / q[2], q[1] / q[2]
    for c in range(3):
        J[0, c] = ((c == 0) - seen[0] * (c == 2)) / p[2]
        J[1, c] = ((c == 1) - seen[1] * (c == 2)) / p[2]
        J[2, c] = (R_rl[0, c] - seen[2] * R_rl[2, c]) / q[2]
        J[3, c] = (R_rl[1, c] - seen[3] * R_rl[2, c]) / q[2]
    return True


@compiled
@no_type_check
def _unexplained(R: Array, J0: Array, J: Array, r: Array) -> float:
    """r'r - r'M (M'M + J_0'J_0)⁻¹ M'r with M = J R, by Cholesky decomposition."""
    n00 = n10 = n11 = n20 = n21 = n22 = b0 = b1 = b2 = total = 0.0
    for c in range(4):
        x = J[c, 0] * R[0, 0] + J[c, 1] * R[1, 0] + J[c, 2] * R[2, 0]
        y = J[c, 0] * R[0, 1] + J[c, 1] * R[1, 1] + J[c, 2] * R[2, 1]
        z = J[c, 0] * R[0, 2] + J[c, 1] * R[1, 2] + J[c, 2] * R[2, 2]
        u, v, w = J0[c, 0], J0[c, 1], J0[c, 2]
        n00, n11, n22 = n00 + x * x + u * u, n11 + y * y + v * v, n22 + z * z + w * w
        n10, n20, n21 = n10 + x * y + u * v, n20 + x * z + u * w, n21 + y * z + v * w
        b0, b1, b2 = b0 + x * r[c], b1 + y * r[c], b2 + z * r[c]
        total += r[c] * r[c]
    l00 = np.sqrt(n00)
    l10, l20 = n10 / l00, n20 / l00
    l11 = np.sqrt(n11 - l10 * l10)
    l21 = (n21 - l20 * l10) / l11
    l22 = np.sqrt(n22 - l20 * l20 - l21 * l21)
    y0 = b0 / l00
    y1 = (b1 - l10 * y0) / l11
    y2 = (b2 - l20 * y0 - l21 * y1) / l22
    return total - y0 * y0 - y1 * y1 - y2 * y2
