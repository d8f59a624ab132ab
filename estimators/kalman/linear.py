"""What all forms share: the correction they return, what they refuse, and the way to independent measurements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Correction:
    """State x (..., n) and covariance F (..., n, n), in the form's way, after the measurements of one time.

    used (..., m): False where a measurement was gated or not finite. nis (...): normalised innovation squared of those
    used, chi-square with as many degrees of freedom.
    """

    x: Float[Array, "... n"]
    F: Float[Array, "... n n"]
    used: Bool[Array, "... m"]
    nis: Float[Array, "..."]


def positive_definite(P: Float[Array, "... n n"], name: str = "P") -> Float[Array, "... n n"]:
    """The lower Cholesky factor of a covariance.

    Raises
        ValueError: it is not finite, symmetric and positive definite.
    """
    P = np.asarray(P)
    if P.ndim < 2 or P.shape[-1] != P.shape[-2]:
        raise ValueError(f"{name}: expected (..., n, n), got {P.shape}")
    transposed = np.swapaxes(P, -1, -2)
    slack = 100 * np.finfo(P.dtype).eps * np.abs(P).max(initial=0)
    if not (np.isfinite(P).all() and np.abs(P - transposed).max(initial=0) <= slack):
        raise ValueError(f"{name}: expected a finite symmetric matrix")
    try:
        return np.asarray(np.linalg.cholesky(P))
    except np.linalg.LinAlgError as error:
        raise ValueError(
            f"{name}: not positive definite, least eigenvalue {np.linalg.eigvalsh(P).min():.3g}"
        ) from error


def variances(R: Float[Array, "... m"]) -> Float[Array, "... m 1 1"]:
    """Variances of independent measurements as blocks of one."""
    return R[..., None, None]


def check_blocks(m: int, R: Float[Array, "... k b b"]) -> None:
    """Raises ValueError where blocks of covariances are not those of m measurements."""
    if R.shape[-3] * R.shape[-2] != m:
        raise ValueError(f"R: expected blocks (..., k, b, b) with k b = {m}, got {R.shape}")


def not_positive(block: int) -> ValueError:
    """A measurement without a positive variance has no gain."""
    return ValueError(f"R: block {block} is not positive definite")


def decorrelated(
    H: Float[Array, "... m n"], dz: Float[Array, "... m"], R: Float[Array, "... k b b"]
) -> tuple[Float[Array, "... m n"], Float[Array, "... m"]]:
    """Correlated measurements as independent ones of unit variance (6.4.5.1): L^-1 H, L^-1 dz with R = L L'.

    A block with what is not finite is not finite in dz either. Raises ValueError where a block of R is not positive
    definite.
    """
    check_blocks(dz.shape[-1], R)
    k, b = R.shape[-3:-1]
    try:
        L = np.linalg.cholesky(R)
    except np.linalg.LinAlgError:
        wrong = ~(np.linalg.eigvalsh(R) > 0).all(axis=-1)
        raise not_positive(int(np.argwhere(wrong)[0, -1])) from None
    split = (*dz.shape[:-1], k, b)
    rows = np.linalg.solve(L, H.reshape(*H.shape[:-2], k, b, H.shape[-1]))
    innovation = np.linalg.solve(L, dz.reshape(split)[..., None])[..., 0]
    lead = np.broadcast_shapes(H.shape[:-2], L.shape[:-3])
    return rows.reshape(*lead, *H.shape[-2:]), innovation.reshape(*innovation.shape[:-2], -1)
