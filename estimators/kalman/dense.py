"""Forms that use all measurements of a time at once: plain (6.16), (6.17), stabilised (6.18), information."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from estimators.kalman.linear import Correction, decorrelated, positive_definite

Array = np.ndarray


def _transposed(M: Array) -> Array:
    return np.swapaxes(M, -1, -2)


def _times(M: Array, v: Array) -> Array:
    return np.asarray((M @ v[..., None])[..., 0])


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.sum(a * b, axis=-1))


def covariance(P: Float[Array, "... n n"]) -> Float[Array, "... n n"]:
    """The form is the covariance itself."""
    return P


def start(P: Float[Array, "... n n"]) -> Float[Array, "... n n"]:
    """P*(0). Raises ValueError where it is not positive definite."""
    positive_definite(P)
    return np.array(P)


def predict(
    P: Float[Array, "... n n"], A: Float[Array, "... n n"], G: Float[Array, "... n s"], q: Float[Array, "... s"]
) -> Float[Array, "... n n"]:
    """A P A' + G diag(q) G', 6.4.2.3, step 6."""
    return np.asarray(A @ P @ _transposed(A) + G * q[..., None, :] @ _transposed(G))


def predict_symmetric(
    P: Float[Array, "... n n"], A: Float[Array, "... n n"], G: Float[Array, "... n s"], q: Float[Array, "... s"]
) -> Float[Array, "... n n"]:
    """As `predict`, what rounding makes asymmetric averaged."""
    predicted = predict(P, A, G, q)
    return np.asarray((predicted + _transposed(predicted)) / 2)


def _selected(P: Array, H: Array, dz: Array, R: Array, gate: float) -> tuple[Array, Array, Array, Array]:
    """PH' (..., n, m), used (..., m), and decorrelated H, dz with zeros where a measurement is not used."""
    H, dz = decorrelated(H, dz, R)
    PH = P @ _transposed(H)
    q = np.sum(_transposed(PH) * H, axis=-1) + P.dtype.type(1)
    with np.errstate(invalid="ignore"):
        used = np.isfinite(dz) & (dz**2 <= np.asarray(gate, P.dtype) ** 2 * q)
    return np.where(used[..., None, :], PH, 0), used, np.where(used[..., None], H, 0), np.where(used, dz, 0)


def _gain(PH: Array, H: Array, dz: Array) -> tuple[Array, Array]:
    """K = P H' (H P H' + 1)^-1, (6.16), and the normalised innovation squared."""
    S = H @ PH + np.eye(H.shape[-2], dtype=PH.dtype)
    K = _transposed(np.linalg.solve(S, _transposed(PH)))
    return K, _dot(dz, np.linalg.solve(S, dz[..., None])[..., 0])


def plain(
    x: Float[Array, "... n"],
    P: Float[Array, "... n n"],
    H: Float[Array, "... m n"],
    dz: Float[Array, "... m"],
    R: Float[Array, "... k b b"],
    gate: float = np.inf,
) -> Correction:
    """K = P H' (H P H' + R)^-1, (6.16); P - K H P, (6.17), which rounding can make indefinite."""
    PH, used, H, dz = _selected(P, H, dz, R, gate)
    K, nis = _gain(PH, H, dz)
    return Correction(x + _times(K, dz), P - K @ H @ P, used, nis)


def joseph(
    x: Float[Array, "... n"],
    P: Float[Array, "... n n"],
    H: Float[Array, "... m n"],
    dz: Float[Array, "... m"],
    R: Float[Array, "... k b b"],
    gate: float = np.inf,
) -> Correction:
    """As `plain`, but (I - K H) P (I - K H)' + K R K', (6.18)."""
    PH, used, H, dz = _selected(P, H, dz, R, gate)
    K, nis = _gain(PH, H, dz)
    rest = np.eye(P.shape[-1], dtype=P.dtype) - K @ H
    P = rest @ P @ _transposed(rest) + K @ _transposed(K)
    return Correction(x + _times(K, dz), P, used, nis)


def information(
    x: Float[Array, "... n"],
    Y: Float[Array, "... n n"],
    H: Float[Array, "... m n"],
    dz: Float[Array, "... m"],
    R: Float[Array, "... k b b"],
    gate: float = np.inf,
) -> Correction:
    """Y + H' R^-1 H with Y the inverse of P: no matrix of the measurements' number is inverted."""
    _, used, H, dz = _selected(np.linalg.inv(Y), H, dz, R, gate)
    Y = Y + _transposed(H) @ H
    b = _times(_transposed(H), dz)
    dx = np.linalg.solve(Y, b[..., None])[..., 0]
    nis = np.asarray(_dot(dz, dz) - _dot(b, dx))
    return Correction(x + dx, Y, used, nis)


def start_information(P: Float[Array, "... n n"]) -> Float[Array, "... n n"]:
    """The inverse of P*(0). Raises ValueError where that is not positive definite."""
    positive_definite(P)
    return inverse(P)


def inverse(Y: Float[Array, "... n n"]) -> Float[Array, "... n n"]:
    """P of the information matrix, symmetric."""
    P = np.linalg.inv(Y)
    return np.asarray((P + _transposed(P)) / 2)


def predict_information(
    Y: Float[Array, "... n n"], A: Float[Array, "... n n"], G: Float[Array, "... n s"], q: Float[Array, "... s"]
) -> Float[Array, "... n n"]:
    """By way of the covariance."""
    return inverse(predict_symmetric(inverse(Y), A, G, q))
