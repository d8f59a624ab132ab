"""Random sample consensus over three tracks before the adjustment, Siegemund 2008, 3.4.2.2."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import chi2

from estimators.gauss_markov import SingularSystem
from estimators.stereo.object_motion import Problem
from estimators.stereo.outliers.verdict import Poses, Solve, Verdict, select_points
from sim.pose import hat

Array = np.ndarray
# Sine of the angle below which three points are a line to the computer's precision; noise spreads them wider.
_FLAT = 1e-6


def triple_poses(x: Float[Array, "m 3 3"]) -> tuple[Float[Array, "m 3 3"], Float[Array, "m 3"]]:
    """Object frames from three points x[:, 0..2] per frame: origin in the first, e_x along b, e_y along b x c.

    (3.4.4)-(3.4.5); the third column is the unit vector of b x (b x c). Collinear points give NaN.
    """
    b, c = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
    n = np.cross(b, c)
    columns = [b, n, np.cross(b, n)]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.stack([e / np.linalg.norm(e, axis=1)[:, None] for e in columns], axis=2), x[:, 0]


def triple_jacobian(x: Float[Array, "m 3 3"]) -> Float[Array, "m 6 9"]:
    """Derivative of [dr; dT] (R <- exp(dr) R) of `triple_poses` by the three points."""
    R, _ = triple_poses(x)
    e = np.swapaxes(R, 1, 2)
    b, c = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
    length, area = np.linalg.norm(b, axis=1), np.linalg.norm(np.cross(b, c), axis=1)
    turn_b = (
        e[:, 0, :, None] * (np.cross(c, e[:, 2]) / area[:, None])[:, None, :]
        - (e[:, 1, :, None] * e[:, 2, None, :] - e[:, 2, :, None] * e[:, 1, None, :]) / length[:, None, None]
    )
    turn_c = e[:, 0, :, None] * (np.cross(e[:, 2], b) / area[:, None])[:, None, :]
    J = np.zeros((len(x), 6, 9))
    J[:, :3, :3], J[:, :3, 3:6], J[:, :3, 6:] = -turn_b - turn_c, turn_b, turn_c
    J[:, 3:, :3] = np.eye(3)
    return J


@dataclass(frozen=True)
class Ransac:
    """The three tracks that most others confirm, (3.4.4)-(3.4.8); the tracks that do not are outliers.

    A track is carried from its first frame into all others by the poses of the triple (3.4.6) and confirms them if its
    Mahalanobis distances (3.4.7) stay below the quantile. The source compares this square of three coordinates with
    the quantile of the normal distribution, and each frame by itself; we take the chi-square of three degrees of
    freedom at a level shared among the frames. outlier_share: epsilon, and confidence: P_min, of (3.4.8), whose
    exponent u is the size of the sample, three, not the number of unknowns as the text says.
    """

    level: float = 0.01
    outlier_share: float = 0.5
    confidence: float = 0.9999
    seed: int = 0

    @property
    def iterations(self) -> int:
        """Triples to draw, (3.4.8)."""
        return int(np.ceil(np.log(1 - self.confidence) / np.log(1 - (1 - self.outlier_share) ** 3)))

    def __call__(self, problem: Problem, start: Poses, solve: Solve) -> Verdict:
        inlier = self.consensus(problem)
        return Verdict(inlier, solve(select_points(problem, inlier), start), 1)

    def consensus(self, problem: Problem) -> Bool[Array, "n"]:
        """The largest set of tracks that confirm a triple.

        Raises
            SingularSystem: fewer than three tracks span the window, or no triple is confirmed.
        """
        seen = np.zeros((problem.n, problem.m), bool)
        x, C = np.zeros((problem.n, problem.m, 3)), np.tile(np.eye(3), (problem.n, problem.m, 1, 1))
        at = (problem.point, problem.frame)
        seen[at], x[at], C[at] = True, problem.l, np.linalg.inv(problem.model(problem.l)[1])
        whole = np.flatnonzero(seen.all(axis=1))
        if len(whole) < 3:
            raise SingularSystem("fewer than three tracks span the window, as RANSAC needs")
        rng = np.random.default_rng(self.seed)
        best = np.zeros(problem.n, bool)
        for _ in range(self.iterations):
            triple = rng.choice(whole, 3, replace=False)
            confirmed = self._confirmed(triple, seen, x, C)
            if np.count_nonzero(confirmed) > np.count_nonzero(best):
                best = confirmed
        if np.count_nonzero(best) <= 3:
            raise SingularSystem("no three tracks are confirmed by another")
        return best

    def _confirmed(self, triple: Array, seen: Array, x: Array, C: Array) -> Array:
        x_3 = x[triple].transpose(1, 0, 2)
        b, c = x_3[:, 1] - x_3[:, 0], x_3[:, 2] - x_3[:, 0]
        area = np.linalg.norm(np.cross(b, c), axis=1)
        if np.any(area <= _FLAT * np.linalg.norm(b, axis=1) * np.linalg.norm(c, axis=1)):
            return np.zeros(len(seen), bool)
        R, T = triple_poses(x_3)
        J = triple_jacobian(x_3)
        C_OO = sum(J[:, :, 3 * j : 3 * j + 3] @ C[i] @ np.swapaxes(J[:, :, 3 * j : 3 * j + 3], 1, 2)
                   for j, i in enumerate(triple))  # fmt: skip
        D = _distances(R, T, np.asarray(C_OO), seen, x, C)
        limit = chi2.isf(1 - (1 - self.level) ** (1 / np.maximum(seen.sum(axis=1) - 1, 1)), 3)
        confirmed = np.all(~seen | (limit[:, None] > D), axis=1)
        # Its own points define the poses; what the triple itself can be asked is whether it is rigid.
        confirmed[triple] = _is_rigid(x_3, C[triple], self.level)
        return np.asarray(confirmed)


def _distances(R: Array, T: Array, C_OO: Array, seen: Array, x: Array, C: Array) -> Array:
    """Mahalanobis distances (n, m) of (3.4.7) between every point and its track's first one carried along."""
    rows = np.arange(len(x))
    first = np.argmax(seen, axis=1)
    R_1 = R[first]
    arm = x[rows, first] - T[first]
    J_1 = np.concatenate([hat(arm), np.broadcast_to(-np.eye(3), (len(x), 3, 3))], axis=2)
    C_1 = C[rows, first] + J_1 @ C_OO[first] @ np.swapaxes(J_1, 1, 2)
    y = np.einsum("nba,nb->na", R_1, arm)
    C_y = np.swapaxes(R_1, 1, 2) @ C_1 @ R_1
    Ry = np.einsum("mab,nb->nma", R, y)
    J = np.concatenate([-hat(Ry), np.broadcast_to(np.eye(3), (*Ry.shape, 3))], axis=3)
    C_bar = J @ C_OO @ np.swapaxes(J, 2, 3) + R @ C_y[:, None] @ np.swapaxes(R, 1, 2)
    d = x - (Ry + T)
    D = np.einsum("nma,nma->nm", d, np.linalg.solve(C + C_bar, d[..., None])[..., 0])
    D[rows, first] = 0.0
    return np.asarray(D)


def _is_rigid(x: Float[Array, "m 3 3"], C: Float[Array, "3 m 3 3"], level: float) -> bool:
    """Whether the three distances of a triple stay the same over the frames."""
    for i, j in ((0, 1), (0, 2), (1, 2)):
        d = x[:, i] - x[:, j]
        length = np.linalg.norm(d, axis=1)
        weight = length**2 / np.einsum("ma,mab,mb->m", d, C[i] + C[j], d)
        mean = np.sum(weight * length) / np.sum(weight)
        if np.sum(weight * (length - mean) ** 2) > chi2.isf(level / 3, len(x) - 1):
            return False
    return True
