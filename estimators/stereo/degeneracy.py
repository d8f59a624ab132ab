"""Shapes that determine no motion: points on a line, as far as their accuracy can tell."""

from __future__ import annotations

import functools

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import chi2

from estimators.gauss_markov import SingularSystem, sum_by

Array = np.ndarray
# Share of lines that are not taken for lines.
_LEVEL = 1e-4


def require_shape(
    frame: Int[Array, "k"], point: Int[Array, "k"], R: Float[Array, "m 3 3"], X: Float[Array, "n 3"], W: Array
) -> None:
    """Refuses adjusted points X that do not determine the rotation; weights W (k, 3, 3) in the camera frame.

    Raises
        SingularSystem: the points are collinear.
    """
    R_k = R[frame]
    if is_collinear(X, sum_by(point, np.swapaxes(R_k, 1, 2) @ W @ R_k, len(X)), len(R)):
        raise SingularSystem("the points are collinear")


def is_collinear(X: Float[Array, "n 3"], N: Float[Array, "n 3 3"], frames: int) -> bool:
    """Whether adjusted points X leave a line no farther than their noise explains: the rotation about it is free.

    N: weight matrix of every point [1/m²], its block sum R'WR of the normal equations; frames: number m of the window.

    The points' weighted squared distances from a line they lie on are chi-square with 2n - 4 degrees of freedom. But
    there the adjustment turns every frame freely about the line, to where its noise fits best: of n x m random numbers
    such a fit gathers up to (1 + sqrt(m / n))² times what their mean over the frames does (the largest singular value),
    and so far the limit is raised. Ours; the source takes the rank for granted.
    """
    n = len(X)
    if n < 3:
        return True
    x, L = X - X.mean(axis=0), np.linalg.cholesky(N.mean(axis=0))
    direction = np.linalg.solve(L.T, np.linalg.svd(x @ L, full_matrices=False)[2][0])
    weighted = N @ direction
    along = np.einsum("na,na->n", weighted, x) / (weighted @ direction)
    off = x - along[:, None] * direction
    return bool(np.einsum("na,nab,nb->", off, N, off) <= _quantile(2 * n - 4) * (1 + np.sqrt(frames / n)) ** 2)


@functools.cache
def _quantile(dof: int) -> float:
    return float(chi2.isf(_LEVEL, dof))
