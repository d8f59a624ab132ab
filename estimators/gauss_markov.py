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
    h (n, 3, 6m) = N_inv N_Xp; b_X (n, 3) right side of the points.
    """

    S: Float[np.ndarray, "p p"]
    rhs: Float[np.ndarray, "p"]
    N_inv: Float[np.ndarray, "n 3 3"]
    h: Float[np.ndarray, "n 3 p"]
    b_X: Float[np.ndarray, "n 3"]

    def points(self, dp: Float[np.ndarray, "p"]) -> Float[np.ndarray, "n 3"]:
        """What the points follow the poses by: dX = N_inv b_X - h dp."""
        return np.asarray((self.N_inv @ self.b_X[:, :, None])[:, :, 0] - self.h @ dp)


def sum_by(index: Int[np.ndarray, "k"], values: Float[np.ndarray, "k ..."], size: int) -> Float[np.ndarray, "s ..."]:
    """Sums of the rows with the same index, (size, ...)."""
    width = int(np.prod(values.shape[1:]))
    cell = (index[:, None] * width + np.arange(width)).ravel()
    return np.bincount(cell, values.ravel(), size * width).reshape(size, *values.shape[1:])


def inverse_spd(N: Float[np.ndarray, "n 3 3"], what: str) -> Float[np.ndarray, "n 3 3"]:
    """Inverse of symmetric positive definite blocks, in unit-free scaling.

    Raises
        SingularSystem: a block is not positive definite; ``what`` names it.
    """
    diagonal = np.einsum("nii->ni", N)
    if not np.all(diagonal > 0):
        raise SingularSystem(what)
    d = np.sqrt(diagonal)
    scaled = N / (d[:, :, None] * d[:, None, :])
    try:
        np.linalg.cholesky(scaled)
    except np.linalg.LinAlgError as error:
        raise SingularSystem(what) from error
    inverse = np.linalg.inv(scaled) / (d[:, :, None] * d[:, None, :])
    return np.asarray((inverse + np.swapaxes(inverse, 1, 2)) / 2)


@dataclass(frozen=True, eq=False)
class Blocks:
    """What every observation adds to the normal equations: N_pp (k, 6, 6), N_pX (k, 6, 3), N_XX (k, 3, 3) and the right
    sides b_p (k, 6), b_X (k, 3)."""

    N_pp: Float[np.ndarray, "k 6 6"]
    N_pX: Float[np.ndarray, "k 6 3"]
    N_XX: Float[np.ndarray, "k 3 3"]
    b_p: Float[np.ndarray, "k 6"]
    b_X: Float[np.ndarray, "k 3"]


def normal_blocks(
    A: Float[np.ndarray, "k e 6"],
    B: Float[np.ndarray, "k e 3"],
    W: Float[np.ndarray, "k e e"],
    dl: Float[np.ndarray, "k e"],
) -> Blocks:
    """Blocks of ``dl + v = A dp + B dX`` with weights W: N = A'WA, b = A'W dl (2.1.16)."""
    AW, BW = np.swapaxes(A, 1, 2) @ W, np.swapaxes(B, 1, 2) @ W
    l = dl[:, :, None]
    return Blocks(AW @ A, AW @ B, BW @ B, (AW @ l)[:, :, 0], (BW @ l)[:, :, 0])


def reduce_points(frame: Int[np.ndarray, "k"], point: Int[np.ndarray, "k"], blocks: Blocks, m: int, n: int) -> Reduced:
    """Eliminates the points from the normal equations; Siegemund 2008, (3.5.6).

    Raises
        SingularSystem: a point is not determined by its observations.
    """
    N_inv = inverse_spd(sum_by(point, blocks.N_XX, n), "a point is not determined by its observations")
    b_X = sum_by(point, blocks.b_X, n)
    by_frame = np.zeros((n, m, 3, 6))
    by_frame[point, frame] = np.swapaxes(blocks.N_pX, 1, 2)  # a point is observed once in a frame
    N_Xp = by_frame.transpose(0, 2, 1, 3).reshape(n * 3, 6 * m)
    h = (N_inv @ N_Xp.reshape(n, 3, 6 * m)).reshape(n * 3, 6 * m)
    S = scipy.linalg.block_diag(*sum_by(frame, blocks.N_pp, m)) - N_Xp.T @ h
    rhs = sum_by(frame, blocks.b_p, m).ravel() - h.T @ b_X.ravel()
    return Reduced((S + S.T) / 2, rhs, N_inv, h.reshape(n, 3, 6 * m), b_X)


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Eigenvalues and -vectors of D^-1 S D^-1 with unit diagonal (D), without its null space; scale (p,) = diag(D)."""

    values: Float[np.ndarray, "q"]
    vectors: Float[np.ndarray, "p q"]
    scale: Float[np.ndarray, "p"]

    def solve(self, rhs: Float[np.ndarray, "p"], damping: float = 0.0) -> Float[np.ndarray, "p"]:
        """Step for the right side with the eigenvalues |lambda| + damping: downhill whatever their sign."""
        weights = np.abs(self.values) + damping
        return np.asarray(self.vectors @ ((self.vectors.T @ (rhs / self.scale)) / weights) / self.scale)

    def inverse(self) -> Float[np.ndarray, "p p"]:
        """Symmetric reflexive generalised inverse: the datum in which the null space has no share.

        Raises
            SingularSystem: S has further null directions, or is not positive: the motion is not determined.
        """
        if self.values[0] < 1e-11 * self.values[-1]:
            raise SingularSystem("the motion is not determined by the tracks")
        return np.asarray((self.vectors / self.values) @ self.vectors.T / np.outer(self.scale, self.scale))


def spectrum(S: Float[np.ndarray, "p p"], scale: Float[np.ndarray, "p"], G: Float[np.ndarray, "p g"]) -> Spectrum:
    """Spectrum of S in units of ``scale`` (radians and metres weigh alike), orthogonal to the null space G."""
    if not np.all(scale > 0):
        raise SingularSystem("a pose is not observed")
    Q, _ = np.linalg.qr(G * scale[:, None], mode="complete")
    Q = Q[:, G.shape[1] :]
    values, vectors = scipy.linalg.eigh(Q.T @ (S / np.outer(scale, scale)) @ Q)
    return Spectrum(values, Q @ vectors, scale)
