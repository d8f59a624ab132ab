"""Linearised least squares with two groups of unknowns: many small blocks (points) and few large ones (poses).

Knows no camera. The normal equations (2.1.16) of Siegemund 2008 are never built as one matrix: the points are
eliminated block by block (Schur complement, (3.5.5)-(3.5.7)), and a rank defect with a known null space (the datum,
3.1.7) is closed by weights on that null space alone, which changes no estimable quantity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int


class SingularSystem(ValueError):
    """The normal equations do not determine the unknowns."""


@dataclass(frozen=True, eq=False)
class Reduced:
    """Normal equations after elimination of the points, for m poses of 6 and n points of 3 unknowns.

    S (6m, 6m) reduced normal matrix; rhs (6m,) reduced right side; N_inv (n, 3, 3) inverse point blocks;
    h (n, 3, 6m) = N_inv N_Xp, so that the points follow the poses by dX = N_inv b_X - h dp.
    """

    S: Float[np.ndarray, "p p"]
    rhs: Float[np.ndarray, "p"]
    N_inv: Float[np.ndarray, "n 3 3"]
    h: Float[np.ndarray, "n 3 p"]


def sum_by(index: Int[np.ndarray, "k"], values: Float[np.ndarray, "k ..."], size: int) -> Float[np.ndarray, "s ..."]:
    """Sums of the rows with the same index, (size, ...)."""
    flat = values.reshape(len(values), -1)
    out = np.stack([np.bincount(index, column, size) for column in flat.T], axis=-1)
    return out.reshape(size, *values.shape[1:])


def inverse_spd(N: Float[np.ndarray, "n 3 3"], what: str) -> Float[np.ndarray, "n 3 3"]:
    """Inverse of symmetric positive definite blocks, in unit-free scaling.

    Raises
        SingularSystem: a block is not positive definite; ``what`` names it.
    """
    d = np.sqrt(np.einsum("nii->ni", N))
    if not np.all(d > 0):
        raise SingularSystem(what)
    scaled = N / (d[:, :, None] * d[:, None, :])
    try:
        np.linalg.cholesky(scaled)
    except np.linalg.LinAlgError as error:
        raise SingularSystem(what) from error
    inverse = np.linalg.inv(scaled) / (d[:, :, None] * d[:, None, :])
    return np.asarray((inverse + np.swapaxes(inverse, 1, 2)) / 2)


def reduce_points(
    frame: Int[np.ndarray, "k"],
    point: Int[np.ndarray, "k"],
    A: Float[np.ndarray, "k 3 6"],
    B: Float[np.ndarray, "k 3 3"],
    W: Float[np.ndarray, "k 3 3"],
    dl: Float[np.ndarray, "k 3"],
    m: int,
    n: int,
) -> Reduced:
    """Eliminates the points from ``dl + v = A dp[frame] + B dX[point]`` with weights W; Siegemund 2008, (3.5.6).

    Raises
        SingularSystem: a point is not determined by its observations.
    """
    WA, WB = W @ A, W @ B
    N_inv = inverse_spd(sum_by(point, np.swapaxes(B, 1, 2) @ WB, n), "a point is not determined by its observations")
    b_X = sum_by(point, np.einsum("kab,ka->kb", WB, dl), n)
    b_p = sum_by(frame, np.einsum("kab,ka->kb", WA, dl), m).ravel()
    blocks = np.zeros((n, m, 3, 6))
    np.add.at(blocks, (point, frame), np.swapaxes(B, 1, 2) @ WA)
    N_Xp = blocks.transpose(0, 2, 1, 3).reshape(n, 3, 6 * m)
    h = N_inv @ N_Xp
    S = scipy.linalg.block_diag(*sum_by(frame, np.swapaxes(A, 1, 2) @ WA, m))
    S = S - np.tensordot(N_Xp, h, axes=((0, 1), (0, 1)))
    rhs = b_p - np.tensordot(h, b_X, axes=((0, 1), (0, 1)))
    return Reduced((S + S.T) / 2, rhs, N_inv, h)


def invert_with_null_space(S: Float[np.ndarray, "p p"], G: Float[np.ndarray, "p g"]) -> Float[np.ndarray, "p p"]:
    """Symmetric reflexive generalised inverse of S whose null space is spanned by G: the datum ``G' D dp = 0``.

    S is scaled to unit diagonal (D) first, so that radians and metres weigh alike.

    Raises
        SingularSystem: S has further null directions: the motion is not determined.
    """
    d = np.sqrt(np.clip(np.diag(S), 0, None))
    if not np.all(d > 0):
        raise SingularSystem("a pose is not observed")
    Q, _ = np.linalg.qr(G * d[:, None])
    scaled = S / np.outer(d, d)
    values, vectors = scipy.linalg.eigh(scaled + Q @ Q.T)
    if values[0] < 1e-11 * values[-1]:
        raise SingularSystem("the motion is not determined by the tracks")
    inverse = (vectors / values) @ vectors.T - Q @ Q.T
    return np.asarray(inverse / np.outer(d, d))
