"""The reduced normal equations against one small dense system, and the generalised inverse by its properties."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.gauss_markov import (
    Reduced,
    SingularSystem,
    inverse_spd,
    normal_blocks,
    reduce_points,
    spectrum,
    sum_by,
)

Array = np.ndarray
M, N = 3, 8


class Dense:
    """One linear model l + v = A dp + B dX of three poses and eight points, as blocks and as one matrix."""

    def __init__(self) -> None:
        rng = np.random.default_rng(0)
        self.frame, self.point = np.nonzero(np.arange(M * N).reshape(M, N) % 7 != 3)  # 63 equations, 42 unknowns
        k = len(self.frame)
        self.A, self.B, self.dl = rng.normal(size=(k, 3, 6)), rng.normal(size=(k, 3, 3)), rng.normal(size=(k, 3))
        half = rng.normal(size=(k, 3, 3))
        self.W = half @ np.swapaxes(half, 1, 2) + np.eye(3)
        J = np.zeros((3 * k, 6 * M + 3 * N))
        W = np.zeros((3 * k, 3 * k))
        for i in range(k):
            rows = slice(3 * i, 3 * i + 3)
            J[rows, 6 * self.frame[i] : 6 * self.frame[i] + 6] = self.A[i]
            J[rows, 6 * M + 3 * self.point[i] : 6 * M + 3 * self.point[i] + 3] = self.B[i]
            W[rows, rows] = self.W[i]
        self.normal, self.right = J.T @ W @ J, J.T @ W @ self.dl.ravel()

    def reduced(self) -> Reduced:
        return reduce_points(self.frame, self.point, normal_blocks(self.A, self.B, self.W, self.dl), M, N)


@pytest.fixture(scope="module")
def dense() -> Dense:
    return Dense()


def test_reduced_system_is_the_schur_complement(dense: Dense) -> None:
    r, p = dense.reduced(), 6 * M
    N_XX_inv = np.linalg.inv(dense.normal[p:, p:])
    S = dense.normal[:p, :p] - dense.normal[:p, p:] @ N_XX_inv @ dense.normal[p:, :p]
    np.testing.assert_allclose(r.S, S, atol=1e-10)  # entries of about 100
    np.testing.assert_allclose(r.rhs, dense.right[:p] - dense.normal[:p, p:] @ N_XX_inv @ dense.right[p:], atol=1e-10)
    np.testing.assert_allclose(r.h.reshape(3 * N, p), N_XX_inv @ dense.normal[p:, :p], atol=1e-10)
    for i in range(N):
        block = slice(3 * i, 3 * i + 3)
        np.testing.assert_allclose(r.N_inv[i], N_XX_inv[block, block], atol=1e-10)


def test_solution_is_the_dense_one(dense: Dense) -> None:
    r, p = dense.reduced(), 6 * M
    expected = np.linalg.solve(dense.normal, dense.right)
    dp = np.linalg.solve(r.S, r.rhs)
    np.testing.assert_allclose(dp, expected[:p], atol=1e-9)
    b_X = dense.right[p:].reshape(N, 3)
    dX = np.einsum("nab,nb->na", r.N_inv, b_X) - r.h @ dp
    np.testing.assert_allclose(dX.ravel(), expected[p:], atol=1e-9)


def test_a_point_without_observations_is_not_determined(dense: Dense) -> None:
    blocks = normal_blocks(dense.A, dense.B, dense.W, dense.dl)
    with pytest.raises(SingularSystem, match="point is not determined"):
        reduce_points(dense.frame, dense.point, blocks, M, N + 1)


def test_sums_by_index() -> None:
    values = np.arange(24.0).reshape(4, 2, 3)
    sums = sum_by(np.array([2, 0, 2, 2]), values, 4)
    np.testing.assert_array_equal(
        sums, [values[1], np.zeros((2, 3)), values[0] + values[2] + values[3], np.zeros((2, 3))]
    )


def test_inverse_of_blocks_of_any_scale() -> None:
    rng = np.random.default_rng(1)
    half = rng.normal(size=(50, 3, 3))
    D = 10.0 ** rng.integers(-8, 8, (50, 3))
    N = (half @ np.swapaxes(half, 1, 2) + 0.1 * np.eye(3)) * D[:, :, None] * D[:, None, :]
    inverse = inverse_spd(N, "block")
    np.testing.assert_array_equal(inverse, np.swapaxes(inverse, 1, 2))
    unit = (N @ inverse) / D[:, :, None] * D[:, None, :]
    np.testing.assert_allclose(unit, np.broadcast_to(np.eye(3), N.shape), atol=1e-10)  # condition up to 1e3


@pytest.mark.parametrize("broken", [np.zeros((3, 3)), np.diag([1.0, 1, -1]), np.ones((3, 3)) - 2 * np.eye(3)])
def test_blocks_that_are_not_positive_are_named(broken: Array) -> None:
    with pytest.raises(SingularSystem, match="the third wheel"):
        inverse_spd(np.stack([np.eye(3), broken]), "the third wheel")


def singular(seed: int, p: int = 12, g: int = 3) -> tuple[Array, Array]:
    """A positive semidefinite matrix of widely different units and its null space."""
    rng = np.random.default_rng(seed)
    D = 10.0 ** rng.integers(-2, 3, p)
    G = rng.normal(size=(p, g)) / D[:, None]
    Q, _ = np.linalg.qr(G * D[:, None], mode="complete")
    half = Q[:, g:] @ rng.normal(size=(p - g, p - g))
    return (half @ half.T) * np.outer(D, D), G


@pytest.mark.parametrize("seed", range(5))
def test_generalised_inverse(seed: int) -> None:
    """Reflexive, symmetric, and pinv of the scaled matrix: unique by its null space."""
    S, G = singular(seed)
    scale = np.sqrt(np.diag(S))
    inverse = spectrum(S, scale, G).inverse()
    unit, inner = S / np.outer(scale, scale), inverse * np.outer(scale, scale)
    np.testing.assert_allclose(inner, np.linalg.pinv(unit, rcond=1e-9), rtol=1e-6, atol=1e-8 * np.abs(inner).max())
    np.testing.assert_allclose(unit @ inner @ unit, unit, atol=1e-9)
    np.testing.assert_allclose(inner, inner.T, atol=1e-12 * np.abs(inner).max())
    # The datum: no share of the null space.
    np.testing.assert_allclose(
        inner @ (G * scale[:, None]), 0, atol=1e-8 * np.abs(inner).max() * np.abs(G * scale[:, None]).max()
    )


def test_solving_is_multiplying_with_the_inverse() -> None:
    S, G = singular(7)
    s = spectrum(S, np.sqrt(np.diag(S)), G)
    rhs = S @ np.linspace(-1, 1, 12)
    step = s.solve(rhs)
    np.testing.assert_allclose(step, s.inverse() @ rhs, rtol=1e-8)
    np.testing.assert_allclose(S @ step, rhs, rtol=1e-7, atol=1e-9 * np.abs(rhs).max())
    # Damping shortens the step in the scaled units and keeps it downhill.
    damped = s.solve(rhs, 10.0)
    assert np.linalg.norm(damped * s.scale) < np.linalg.norm(step * s.scale)
    assert rhs @ damped > 0


def test_negative_curvature_is_taken_by_magnitude() -> None:
    S = np.diag([4.0, -1.0, 2.0, 1.0])
    s = spectrum(S, np.ones(4), np.eye(4)[:, 3:])
    np.testing.assert_allclose(s.solve(np.array([4.0, 1.0, 2.0, 0.0])), [1, 1, 1, 0], atol=1e-14)
    with pytest.raises(SingularSystem, match="motion is not determined"):
        s.inverse()


def test_a_further_null_direction_is_refused() -> None:
    S, G = singular(3)
    with pytest.raises(SingularSystem, match="motion is not determined"):
        spectrum(S, np.sqrt(np.diag(S)), G[:, :2]).inverse()
    with pytest.raises(SingularSystem, match="pose is not observed"):
        spectrum(np.diag([1.0, 0, 1]), np.array([1.0, 0, 1]), np.eye(3)[:, :1])
