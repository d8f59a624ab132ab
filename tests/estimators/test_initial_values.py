"""Start values: axes of the cloud, their continuity, and extrapolation over uneven steps."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.stereo.initial_values import Axes, extrapolate, from_alignment, from_cloud
from sim.pose import exp_so3, log_so3

Array = np.ndarray
AXES: list[Axes] = ["principal_axes_xz", "principal_axes"]
FRAMES = 25


def turning_cloud(
    size: tuple[float, float, float], step: float, noise: float = 0.0
) -> tuple[Array, Array, Array, Array]:
    """A box of points turning about y by ``step`` a frame: frame, points, true rotations, true centroids."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (200, 3)) * size
    X -= X.mean(axis=0)
    angle = step * np.arange(FRAMES)
    R = exp_so3(np.multiply.outer(angle, [0.0, 1.0, 0.0]))
    T = np.array([1.0, 2, 20]) + np.multiply.outer(np.arange(FRAMES), [0.1, 0, -0.5])
    l = np.einsum("mab,nb->mna", R, X) + T[:, None] + noise * rng.standard_normal((FRAMES, 200, 3))
    return np.repeat(np.arange(FRAMES), 200), l.reshape(-1, 3), R, T


@pytest.mark.parametrize("axes", [*AXES, "unrotated"])
def test_centroids(axes: Axes) -> None:
    frame, l, _, T = turning_cloud((0.8, 0.6, 2.0), 0.1)
    R, T_found = from_cloud(frame, l, FRAMES, axes)
    np.testing.assert_allclose(T_found, T, atol=1e-12)
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-12)


@pytest.mark.parametrize("axes", AXES)
@pytest.mark.parametrize("step", [0.15, -0.15, 0.4])
@pytest.mark.parametrize("size", [(0.8, 0.5, 2.0), (2.0, 0.5, 0.8)], ids=["along", "across"])
def test_axes_turn_with_the_cloud_without_a_jump(axes: Axes, step: float, size: tuple[float, float, float]) -> None:
    """Through all quadrants: 25 steps of 0.15 rad are more than half a turn, of 0.4 more than one and a half."""
    frame, l, R_true, _ = turning_cloud(size, step)
    R, _ = from_cloud(frame, l, FRAMES, axes)
    relative = R[1:] @ np.swapaxes(R[:-1], 1, 2)
    np.testing.assert_allclose(log_so3(relative), [[0, step, 0]] * (FRAMES - 1), atol=1e-9)
    np.testing.assert_allclose(R @ R[0].T, R_true @ R_true[0].T, atol=1e-9)


def test_axes_in_the_plane_keep_the_vertical() -> None:
    frame, l, _, _ = turning_cloud((0.8, 2.0, 1.2), 0.1, 0.1)
    R, _ = from_cloud(frame, l, FRAMES, "principal_axes_xz")
    np.testing.assert_allclose(R[:, :, 1], [[0, 1, 0]] * FRAMES, atol=1e-12)


def test_first_axes_are_the_nearest_to_the_camera_s() -> None:
    frame, l, _, _ = turning_cloud((2.0, 0.5, 0.8), 0.1)
    R, _ = from_cloud(frame, l, FRAMES, "principal_axes_xz")
    assert np.linalg.norm(log_so3(R[0])) <= np.pi / 4 + 1e-9


def test_unrotated_is_unrotated() -> None:
    frame, l, _, _ = turning_cloud((2.0, 0.5, 0.8), 0.1)
    np.testing.assert_array_equal(
        from_cloud(frame, l, FRAMES, "unrotated")[0], np.broadcast_to(np.eye(3), (FRAMES, 3, 3))
    )


@pytest.mark.parametrize("axes", AXES)
def test_a_round_cloud_does_not_flicker(axes: Axes) -> None:
    """Its axes mean little, but they do not jump by a quarter turn from one frame to the next in the plane."""
    frame, l, _, _ = turning_cloud((1.0, 0.5, 1.0), 0.0, 0.05)
    R, _ = from_cloud(frame, l, FRAMES, axes)
    relative = log_so3(R[1:] @ np.swapaxes(R[:-1], 1, 2))
    assert np.linalg.norm(relative, axis=1).max() < (np.pi / 4 + 1e-9 if axes == "principal_axes_xz" else np.pi / 2)


def test_clouds_laid_on_one_another_give_the_motion() -> None:
    """Exact without noise, over points that come and go; where too few stay, the orientation is kept."""
    frame, l, R_true, T_true = turning_cloud((0.8, 0.5, 2.0), 0.4)
    point = np.tile(np.arange(200), FRAMES)
    seen = np.abs(point - 8 * frame) < 20
    R, T = from_alignment(frame[seen], point[seen], l[seen], FRAMES)
    np.testing.assert_allclose(R @ R[0].T, R_true @ R_true[0].T, atol=1e-10)
    X = np.einsum("mba,mnb->mna", R_true, l.reshape(FRAMES, 200, 3) - T_true[:, None])[0]
    relative = R[-1] @ R[0].T
    np.testing.assert_allclose(
        relative @ (R_true[0] @ X[0] + T_true[0] - T[0]) + T[-1], R_true[-1] @ X[0] + T_true[-1], atol=1e-9
    )
    apart = np.where(frame < 12, point < 100, point >= 100)
    R, T = from_alignment(frame[apart], point[apart], l[apart], FRAMES)
    np.testing.assert_array_equal(R[12], R[11])
    np.testing.assert_allclose(T[12], l[apart & (frame == 12)].mean(axis=0))


@pytest.mark.parametrize("t_s", [[0.0, 1.0, 2.0], [0.0, 0.04, 0.16], [0.0, 0.3, 0.32], [5.0, 5.1, 5.1]])
def test_extrapolation_over_uneven_steps(t_s: list[float]) -> None:
    """A motion of constant velocity and rate is met at any time."""
    omega, v = np.array([0.2, -0.8, 0.1]), np.array([3.0, -1.0, 8.0])
    R_0, T_0 = exp_so3(np.array([0.3, 0.2, -0.5])), np.array([1.0, 2, 30])
    R = exp_so3(np.multiply.outer(t_s, omega)) @ R_0
    T = T_0 + np.multiply.outer(t_s, v)
    R_new, T_new = extrapolate(R[:2], T[:2], np.array(t_s[:2]), t_s[2])
    np.testing.assert_allclose(R_new, R[2], atol=1e-12)
    np.testing.assert_allclose(T_new, T[2], atol=1e-11)
