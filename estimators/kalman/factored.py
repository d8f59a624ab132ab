"""Forms that use one scalar measurement after the other: sequential (Dickmanns 2007, 6.4.5), roots and UDU' (6.4.6).

Roots S with P = S S' need half the digits of P; with factors of P = U D U' nothing can become indefinite either.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from estimators.kalman import kernels
from estimators.kalman.linear import Correction, check_blocks, not_positive, positive_definite

Array = np.ndarray


def _runs(a: Array, lead: tuple[int, ...], axes: int) -> Array:
    """An array of leading axes that broadcast to ``lead``, as (r, ...) or, the same for all runs, (1, ...)."""
    shape = a.shape[a.ndim - axes :]
    if a.ndim > axes and a.shape[:-axes] != lead:
        a = np.broadcast_to(a, (*lead, *shape))
    return np.ascontiguousarray(a).reshape(-1, *shape)


def by_scalars(form: int) -> Callable[..., Correction]:
    """The correction of one of the forms of `estimators.kalman.kernels`."""

    def correct(
        x: Float[Array, "... n"],
        F: Float[Array, "... n n"],
        H: Float[Array, "... m n"],
        dz: Float[Array, "... m"],
        R: Float[Array, "... k b b"],
        gate: float = math.inf,
    ) -> Correction:
        check_blocks(dz.shape[-1], R)
        lead = x.shape[:-1]
        gate = F.dtype.type(gate)
        if not lead:
            corrected, F, used, nis, wrong = kernels.correct(form, x, F, H, dz, R, gate)
        else:
            runs = (_runs(a, lead, axes) for a, axes in ((x, 1), (F, 2), (H, 2), (dz, 1), (R, 3)))
            corrected, F, used, nis, wrong = kernels.correct_runs(form, *runs, gate)
            corrected, F, nis = corrected.reshape(x.shape), F.reshape(*lead, *F.shape[1:]), nis.reshape(lead)
            used = used.reshape(*lead, -1)
        if wrong >= 0:
            raise not_positive(wrong)
        return Correction(corrected, F, used, nis)

    return correct


sequential = by_scalars(kernels.SEQUENTIAL)
potter = by_scalars(kernels.POTTER)
carlson = by_scalars(kernels.CARLSON)
udu = by_scalars(kernels.UDU)


def square(S: Float[Array, "... n n"]) -> Float[Array, "... n n"]:
    """P = S S'."""
    return np.asarray(S @ np.swapaxes(S, -1, -2))


def transposed_square(S: Float[Array, "... n n"]) -> Float[Array, "... n n"]:
    """P = S' S."""
    return np.asarray(np.swapaxes(S, -1, -2) @ S)


def start_root(P: Float[Array, "... n n"]) -> Float[Array, "... n n"]:
    """Upper triangular S with P = S S'. Raises ValueError where P is not positive definite."""
    return np.ascontiguousarray(positive_definite(np.asarray(P)[..., ::-1, ::-1])[..., ::-1, ::-1])


def start_transposed_root(P: Float[Array, "... n n"]) -> Float[Array, "... n n"]:
    """As `start_root`, with P = S' S."""
    return np.ascontiguousarray(np.swapaxes(start_root(P), -1, -2))


def predict_root(
    S: Float[Array, "... n n"], A: Float[Array, "... n n"], G: Float[Array, "... n s"], q: Float[Array, "... s"]
) -> Float[Array, "... n n"]:
    """The root S of A P A' + G diag(q) G', P = S S', triangular by orthogonal transformation of [A S, G sqrt(q)]."""
    root = _side_by_side(A @ S, G * np.sqrt(q)[..., None, :])
    R = np.linalg.qr(np.swapaxes(root[..., ::-1, :], -1, -2), mode="r")
    return np.ascontiguousarray(np.swapaxes(R, -1, -2)[..., ::-1, ::-1])


def predict_transposed_root(
    S: Float[Array, "... n n"], A: Float[Array, "... n n"], G: Float[Array, "... n s"], q: Float[Array, "... s"]
) -> Float[Array, "... n n"]:
    """As `predict_root`, with P = S' S."""
    return np.ascontiguousarray(np.swapaxes(predict_root(np.swapaxes(S, -1, -2), A, G, q), -1, -2))


def _side_by_side(a: Array, b: Array) -> Array:
    lead = np.broadcast_shapes(a.shape[:-1], b.shape[:-1])
    return np.concatenate([np.broadcast_to(m, (*lead, m.shape[-1])) for m in (a, b)], axis=-1)


def start_udu(P: Float[Array, "... n n"]) -> Float[Array, "... n n"]:
    """U' and D of (6.38) in one matrix, D on the diagonal. Raises ValueError where P is not positive definite."""
    S = start_transposed_root(P)
    d = np.einsum("...ii->...i", S)
    F = np.asarray(S / d[..., None])
    np.einsum("...ii->...i", F)[...] = d**2
    return F


def _unit(F: Array) -> tuple[Array, Array]:
    """U (unit upper triangular) and D (a vector) of their compact form."""
    U, D = np.swapaxes(np.tril(F), -1, -2).copy(), np.einsum("...ii->...i", F).copy()
    np.einsum("...ii->...i", U)[...] = 1
    return U, D


def product(F: Float[Array, "... n n"]) -> Float[Array, "... n n"]:
    """P = U D U'."""
    U, D = _unit(F)
    return np.asarray(U * D[..., None, :] @ np.swapaxes(U, -1, -2))


def predict_udu(
    F: Float[Array, "... n n"], A: Float[Array, "... n n"], G: Float[Array, "... n s"], q: Float[Array, "... s"]
) -> Float[Array, "... n n"]:
    """Factors of A P A' + G diag(q) G' from W = [A U, G] and diag(D, q), (6.50)-(6.56).

    Raises
        ValueError: the prediction is not positive definite, as A is singular where no noise enters.
    """
    U, D = _unit(F)
    W = _side_by_side(A @ U, G)
    *lead, n, s = W.shape
    weights = np.concatenate([np.broadcast_to(D, (*lead, n)), np.broadcast_to(q, (*lead, s - n))], axis=-1)
    predicted = np.empty((math.prod(lead), n, n), W.dtype)
    if not kernels.thornton(W.reshape(-1, n, s), weights.reshape(-1, s), predicted):
        raise ValueError("A, G, q: the predicted covariance is not positive definite")
    return predicted.reshape(*lead, n, n)
