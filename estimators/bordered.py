"""Least squares with conditions as one sparse system of points and poses, the way Siegemund 2008 writes it (3.5).

    dl + v = A dp,  W = C_ll^-1,  H' dp = 0,      [ A'WA  H ] [dp]   [A'W dl]
                                                  [ H'    0 ] [mu] = [  0   ]                     (2.1.27)

The unknowns are ordered as in (3.5.8)-(3.5.9): n points of three, then m poses of six. Knows no camera. The compiled
loop of `estimators.stereo.kernel` is the fast way to the same solution; this is the one to look at and to compare with.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
import scipy.sparse
from jaxtyping import Float

from estimators.gauss_markov import SingularSystem, inverse_spd

Array = np.ndarray
Sparse = scipy.sparse.csr_array
_RCOND = 1e-14
_UNDETERMINED = "the motion is not determined by the tracks"


@dataclass(frozen=True, eq=False)
class BorderedSystem:
    """A (c, u), W (c, c), dl (c,), H (u, h) with u = 3n + 6m.

    rows and conditions name the parts of A's rows, "observations" first, and of H's columns; ``count`` of the rows are
    independent.
    """

    A: Sparse
    W: Sparse
    dl: Float[Array, "c"]
    H: Sparse
    n: int
    m: int
    rows: Mapping[str, slice]
    conditions: Mapping[str, slice]
    count: int

    @cached_property
    def N(self) -> Sparse:
        """Normal matrix A'WA (u, u), (2.1.16)."""
        return Sparse(self.A.T @ self.W @ self.A)

    @cached_property
    def b(self) -> Float[Array, "u"]:
        """Right side A'W dl."""
        return np.asarray(self.A.T @ (self.W @ self.dl))

    @property
    def C_ll(self) -> Sparse:
        """Covariance of the observations and pseudo-observations (c, c), block-diagonal.

        Raises
            SingularSystem: the weight of an observation is not positive definite.
        """
        k = self.rows["observations"].stop
        observations = block_diagonal(inverse_spd(_blocks(self.W[:k, :k]), "a weight is not positive definite"))
        known = np.linalg.inv(self.W[k:, k:].toarray())
        return clean(Sparse(scipy.sparse.block_diag([observations, known])))

    @property
    def kkt(self) -> Sparse:
        """The bordered matrix of (2.1.27), (u + h, u + h)."""
        upper = scipy.sparse.hstack([self.N, self.H])
        lower = scipy.sparse.hstack([self.H.T, Sparse((self.H.shape[1],) * 2)])
        return Sparse(scipy.sparse.vstack([upper, lower]))

    @property
    def redundancy(self) -> int:
        """n + k - u of (2.1.28): observations and conditions less unknowns."""
        return int(self.count + self.H.shape[1] - self.A.shape[1])

    def variance_factor(self, cost: float) -> float:
        """Estimated variance of unit weight v'Wv / r (2.1.22); it scales the covariance, (2.1.23).

        Raises
            SingularSystem: there is no redundancy.
        """
        if self.redundancy <= 0:
            raise SingularSystem("no observation is redundant")
        return cost / self.redundancy

    def eliminate(self, damping: float = 0.0) -> Elimination:
        """The points eliminated, (3.5.2)-(3.5.7), from N + damping I (2.2.6) bordered by the conditions.

        Raises
            SingularSystem: a point is not determined by its observations.
        """
        N_XX, border, corner = self._parts
        N_inv = inverse_spd(N_XX + damping * np.eye(3), "a point is not determined by its observations")
        Y = np.asarray((N_inv @ border.reshape(self.n, 3, -1)).reshape(border.shape))
        M = corner - border.T @ Y
        poses = np.arange(6 * self.m)
        M[poses, poses] += damping
        return Elimination(self.b, N_inv, Y, (M + M.T) / 2, len(poses))

    @cached_property
    def _parts(self) -> tuple[Float[Array, "n 3 3"], Float[Array, "x q"], Float[Array, "q q"]]:
        """The bordered matrix in blocks: of the points, beside them, and of poses and multipliers."""
        p, H = 3 * self.n, self.H.toarray()
        border = np.hstack([self.N[:p, p:].toarray(), H[:p]])
        corner = np.zeros((border.shape[1],) * 2)
        q = 6 * self.m
        corner[:q, :q], corner[:q, q:], corner[q:, :q] = self.N[p:, p:].toarray(), H[p:], H[p:].T
        return _blocks(self.N[:p, :p]), border, corner


@dataclass(frozen=True, eq=False)
class Elimination:
    """N_inv (n, 3, 3) = N_11^-1, Y (3n, q) = N_11^-1 N_12 and the reduced matrix M (q, q) of poses and multipliers."""

    b: Float[Array, "u"]
    N_inv: Float[Array, "n 3 3"]
    Y: Float[Array, "x q"]
    M: Float[Array, "q q"]
    poses: int

    def solve(self) -> Float[Array, "u"]:
        """The step dp, (3.5.6)-(3.5.7).

        Raises
            SingularSystem: the poses are not determined.
        """
        b_1 = self.b[: len(self.Y)]
        b_2 = np.zeros(len(self.M))
        b_2[: self.poses] = self.b[len(self.Y) :]
        x = self._solve((b_2 - self.Y.T @ b_1)[:, None])[:, 0]
        points = (self.N_inv @ b_1.reshape(-1, 3, 1)).ravel() - self.Y @ x
        return np.concatenate([points, x[: self.poses]])

    def covariance(self) -> Float[Array, "u u"]:
        """Covariance (2.1.21) of all unknowns in the datum of the conditions: the upper left block of the inverse.

        Raises
            SingularSystem: the poses are not determined.
        """
        M_inv = self._solve(np.eye(len(self.M)))
        YM = self.Y @ M_inv
        C_XX = scipy.linalg.block_diag(*self.N_inv) + YM @ self.Y.T
        C_Xp, C_pp = -YM[:, : self.poses], M_inv[: self.poses, : self.poses]
        C = np.block([[C_XX, C_Xp], [C_Xp.T, C_pp]])
        return np.asarray((C + C.T) / 2)

    def variances(self) -> Float[Array, "u"]:
        """Diagonal of the covariance; about zero where a condition holds an unknown.

        Raises
            SingularSystem: the poses are not determined.
        """
        M_inv = self._solve(np.eye(len(self.M)))
        points = np.einsum("naa->na", self.N_inv).ravel() + np.sum((self.Y @ M_inv) * self.Y, axis=1)
        return np.asarray(np.concatenate([points, np.diag(M_inv)[: self.poses]]).clip(0))

    def _solve(self, right: Array) -> Array:
        """M^-1 times the columns of ``right``, M in units that make its rows alike."""
        size = np.sqrt(np.abs(self.M).max(axis=1))
        if not (np.isfinite(size).all() and size.all()):
            raise SingularSystem(_UNDETERMINED)
        scaled = self.M / np.outer(size, size)
        *_, x, rcond, _, _, failed = scipy.linalg.lapack.dsysvx(scaled, right / size[:, None])
        if rcond < _RCOND or 0 < failed <= len(self.M):
            raise SingularSystem(_UNDETERMINED)
        result: Array = x / size[:, None]
        return result


def block_diagonal(blocks: Float[Array, "k a a"]) -> Sparse:
    """Sparse matrix (ka, ka) with these blocks."""
    k, a, _ = blocks.shape
    return Sparse(scipy.sparse.bsr_array((blocks, np.arange(k), np.arange(k + 1)), shape=(a * k, a * k)))


def clean(M: Sparse) -> Sparse:
    """The matrix without stored zeros."""
    result = M.copy()
    result.eliminate_zeros()
    return result


def _blocks(M: Sparse) -> Float[Array, "k 3 3"]:
    """The 3x3 blocks on the diagonal of a matrix that has no others; zero where there are none."""
    k = M.shape[0] // 3
    bsr = M.tobsr((3, 3))
    blocks = np.zeros((k, 3, 3))
    blocks[bsr.indices] = bsr.data
    return blocks
