"""Covariance of the residuals by blocks and the group tests of tracks and points, Siegemund 2008, (3.4.9)-(3.4.14).

    C_vv = C_ll - A C_pp A'                                                                      (3.4.11)

With the points eliminated (h_i = N_i^-1 N_Xp, Sigma the covariance of the poses) a track's block is
C_ll - (A - B h) Sigma (A - B h)' - B N_i^-1 B', B_t = R_t: no matrix over all observations is ever formed. A track
brings its own three unknowns, so its block of 3 |Theta| rows has rank 3 |Theta| - 3. The source inverts it all the same
and counts other degrees of freedom; the group test of Stefanovic and Baarda takes the pseudo-inverse and the true rank.
The null space is known, C_vv W B = 0, and v has no share in it, so

    v' C_vv^+ v = v' (C_vv + B N_i^-1 B')^-1 v.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float, Int

from estimators.gauss_markov import SingularSystem
from estimators.stereo.object_motion import Problem, Solution, null_space
from estimators.stereo.outliers import kernels

Array = np.ndarray
_NO_POINT = "a track is not determined by its observations"
_NO_MOTION = "the motion is not determined by the tracks"


@dataclass(frozen=True, eq=False)
class Fit:
    """A problem at given poses with the best points: one row per observation, sorted by (point, frame).

    order (k,) rows of the problem; first (n + 1,) begin of each track; frame (k,); R (m, 3, 3), T (m, 3); W (k, 3, 3)
    weights; X (n, 3); v (k, 3) residuals R X + T - l; cost (n,) v'Wv of every track.
    """

    order: Int[Array, "k"]
    first: Int[Array, "b"]
    frame: Int[Array, "k"]
    R: Float[Array, "m 3 3"]
    T: Float[Array, "m 3"]
    W: Float[Array, "k 3 3"]
    X: Float[Array, "n 3"]
    v: Float[Array, "k 3"]
    cost: Float[Array, "n"]

    @property
    def count(self) -> Int[Array, "n"]:
        """Observations |Theta_i| of each track."""
        return np.diff(self.first)

    @cached_property
    def point(self) -> Int[Array, "k"]:
        return np.repeat(np.arange(len(self.X)), self.count)

    @cached_property
    def arms(self) -> Float[Array, "k 3"]:
        """R_t X_i, the lever arms of the rotations."""
        return np.asarray((self.R[self.frame] @ self.X[self.point][:, :, None])[:, :, 0])

    @cached_property
    def C_ll(self) -> Float[Array, "k 3 3"]:
        return np.linalg.inv(self.W)


@dataclass(frozen=True, eq=False)
class Normals:
    """The poses' normal matrix S (6m, 6m), right side rhs (6m,), and N_inv (n, 3, 3), h (n, 3, 6m) of all tracks."""

    S: Float[Array, "p p"]
    rhs: Float[Array, "p"]
    N_inv: Float[Array, "n 3 3"]
    h: Float[Array, "n 3 p"]


def fit(
    problem: Problem, R: Float[Array, "m 3 3"], T: Float[Array, "m 3"], X: Float[Array, "n 3"] | None = None
) -> Fit:
    """Best points for given poses, weighted at the points X (by default at the observed places).

    Raises
        SingularSystem: a track is not determined.
    """
    order = np.lexsort((problem.frame, problem.point))
    first = np.searchsorted(problem.point[order], np.arange(problem.n + 1))
    place = problem.l
    if X is not None:
        place = (R[problem.frame] @ X[problem.point][:, :, None])[:, :, 0] + T[problem.frame]
    observed, W = problem.model(place)
    return _fit(order, first, problem.frame[order], R, T, observed[order], W[order])


def _fit(order: Array, first: Array, frame: Array, R: Array, T: Array, observed: Array, W: Array) -> Fit:
    X, v, cost = np.empty((len(first) - 1, 3)), np.empty_like(observed), np.empty(len(first) - 1)
    if not kernels.fit_points(first, frame, R, T, observed, W, X, v, cost):
        raise SingularSystem(_NO_POINT)
    return Fit(order, first, frame, R, T, W, X, v, cost)


def moved(f: Fit, R: Float[Array, "m 3 3"], T: Float[Array, "m 3"]) -> Fit:
    """The same observations and weights at other poses."""
    observed = f.arms + f.T[f.frame] - f.v
    return _fit(f.order, f.first, f.frame, R, T, observed, f.W)


def normals(f: Fit, w: Float[Array, "n"]) -> Normals:
    """Normal equations of the poses, track i weighted by w_i (0: it takes no part).

    Raises
        SingularSystem: a track is not determined.
    """
    n, p = len(f.X), 6 * len(f.R)
    N_inv, N_Xp, h = np.empty((n, 3, 3)), np.empty((n, 3, p)), np.empty((n, 3, p))
    S, rhs = np.empty((p, p)), np.empty(p)
    if not kernels.eliminate(f.first, f.frame, f.R, f.arms, f.W, f.v, w, N_inv, N_Xp, h, S, rhs):
        raise SingularSystem(_NO_POINT)
    S -= (w[:, None, None] * N_Xp).reshape(3 * n, p).T @ h.reshape(3 * n, p)
    return Normals(S, rhs, N_inv, h)


def regular(N: Normals, R: Float[Array, "m 3 3"]) -> tuple[Float[Array, "p p"], Float[Array, "p"]]:
    """S in unit-free scaling with its null space (the datum) closed, and the scale (p,).

    The closed datum drops out of all that can be estimated, as (A - B h) vanishes on it.
    """
    diagonal = np.diag(N.S)
    if not np.all(diagonal > 0):
        raise SingularSystem(_NO_MOTION)
    scale = np.sqrt(diagonal)
    G, _ = np.linalg.qr(null_space(R) * scale[:, None])
    return N.S / np.outer(scale, scale) + G @ G.T, scale


def pose_cofactors(N: Normals, R: Float[Array, "m 3 3"]) -> Float[Array, "p p"]:
    """A covariance of the poses, good for all datum-free functions.

    Raises
        SingularSystem: the tracks do not determine the motion.
    """
    M, scale = regular(N, R)
    factor, failed = scipy.linalg.lapack.dpotrf(M)
    if failed or scipy.linalg.lapack.dpocon(factor, np.abs(M).sum(axis=0).max())[0] < 1e-13:
        raise SingularSystem(_NO_MOTION)
    inverse, _ = scipy.linalg.lapack.dpotri(factor)
    inverse = np.triu(inverse) + np.triu(inverse, 1).T
    return np.asarray(inverse / np.outer(scale, scale))


def _blocks(f: Fit, inside: Array, point_share: float) -> Array:
    N = normals(f, inside.astype(float))
    Sigma = pose_cofactors(N, f.R)
    hS = (N.h.reshape(-1, len(Sigma)) @ Sigma).reshape(N.h.shape)
    size = 3 * int(f.count.max())
    out = np.empty((len(f.X), size, size))
    sign = np.where(inside, 1.0, -1.0)
    kernels.residual_blocks(f.first, f.frame, f.R, f.arms, f.C_ll, Sigma, N.h, hS, N.N_inv, sign, point_share, out)
    return out


def residual_covariance(f: Fit) -> Float[Array, "n c c"]:
    """C_vv of every track, (3.4.11), c = 3 max |Theta_i|; shorter tracks are filled up with rows of the identity.

    Raises
        SingularSystem: the tracks do not determine the motion.
    """
    return _blocks(f, np.ones(len(f.X), bool), 1.0)


def track_statistics(f: Fit, inside: Bool[Array, "n"] | None = None) -> Float[Array, "n"]:
    """T_i = v_i' C_vv^+ v_i of (3.4.13), chi-square with 3 |Theta_i| - 3 degrees of freedom if nothing is wrong.

    The poses are those of the tracks ``inside`` (all by default); the others' residuals are predictions, in whose
    covariance that of the poses enters with the other sign. Where a track alone holds a pose, the rank is lower still
    and T_i counts what can be checked.

    Raises
        SingularSystem: the tracks inside do not determine the motion.
    """
    inside = np.ones(len(f.X), bool) if inside is None else inside
    M = _blocks(f, inside, 0.0)
    T = np.empty(len(f.X))
    kernels.quadratic_forms(f.first, M.copy(), f.v, T)
    for i in np.flatnonzero(np.isnan(T)):
        size = 3 * int(f.count[i])
        T[i] = _pseudo_form(M[i, :size, :size], f.v[f.first[i] : f.first[i + 1]].ravel())
    return T


def _pseudo_form(M: Float[Array, "c c"], v: Float[Array, "c"]) -> float:
    """v' M^+ v in the scaling of M's diagonal."""
    scale = np.sqrt(np.clip(np.diag(M), 1e-300, None))
    values, vectors = np.linalg.eigh(M / np.outer(scale, scale))
    share = vectors.T @ (v / scale)
    good = values > 1e-8 * values[-1]
    return float(np.sum(share[good] ** 2 / values[good]))


def point_statistics(f: Fit) -> Float[Array, "k"]:
    """T_it = v_it' C_vv[it, it]^-1 v_it of (3.4.10), sorted as ``f``, chi-square with 3 degrees of freedom.

    The text takes the block of the inverse of C_vv, which is singular; with the block's own inverse T_it follows the
    distribution the source states.

    Raises
        SingularSystem: the tracks do not determine the motion.
    """
    C_vv = residual_covariance(f)
    T = np.empty(len(f.frame))
    kernels.point_forms(f.first, C_vv, f.v, T)
    for k in np.flatnonzero(np.isnan(T)):
        i = f.point[k]
        rows = slice(3 * (k - f.first[i]), 3 * (k - f.first[i]) + 3)
        T[k] = _pseudo_form(C_vv[i, rows, rows], f.v[k])
    return T


def of_solution(problem: Problem, s: Solution) -> Fit:
    """The fit at a solution of the problem."""
    return fit(problem, s.R, s.T, s.X)
