"""Start values: axes of the cloud, their continuity, and extrapolation over uneven steps."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.stereo.initial_values import (
    Average,
    Axes,
    extrapolate,
    from_alignment,
    from_cloud,
    from_shared_tracks,
    from_turn,
    has_drifted,
    points_from_cloud,
    propagated_points,
)
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


def test_axes_in_space_keep_the_signs_of_the_frame_before() -> None:
    """(3.7.3)-(3.7.5): a box rolling about a slant axis, more than a turn; the first axes are the nearest to ours."""
    rng = np.random.default_rng(2)
    X = rng.uniform(-1, 1, (100, 3)) * [2.0, 1.0, 0.4]
    X -= X.mean(axis=0)
    R_true = exp_so3(np.multiply.outer(0.3 * np.arange(FRAMES), np.array([1.0, 2, 2]) / 3))
    l = np.einsum("mab,nb->mna", R_true, X).reshape(-1, 3)
    R, _ = from_cloud(np.repeat(np.arange(FRAMES), 100), l, FRAMES, "principal_axes")
    np.testing.assert_allclose(R @ R[0].T, R_true @ R_true[0].T, atol=1e-9)
    np.testing.assert_array_less(0, np.diag(R[0])[:2])
    values = np.linalg.eigvalsh(X.T @ X)[::-1]
    np.testing.assert_allclose(np.diag(R[0].T @ (X.T @ X) @ R[0]), values, rtol=1e-9)


@pytest.mark.parametrize("rate", [0.5, -0.5])
def test_a_turn_is_met_whatever_the_times(rate: float) -> None:
    t_s = np.array([0.0, 0.04, 0.08, 0.2])
    X = np.random.default_rng(1).uniform(-1, 1, (30, 3))
    X -= X.mean(axis=0)
    R_true = exp_so3(np.multiply.outer(-rate * t_s, [0.0, 1.0, 0.0]))
    T_true = np.array([1.0, 0, 20]) + np.multiply.outer(t_s, [3.0, 0, -9])
    l = np.einsum("mab,nb->mna", R_true, X) + T_true[:, None]
    R, T = from_turn(np.repeat(np.arange(4), 30), l.reshape(-1, 3), t_s, rate)
    np.testing.assert_allclose(T, T_true, atol=1e-12)
    np.testing.assert_allclose(R @ R[0].T, R_true @ R_true[0].T, atol=1e-12)


def test_the_centroid_carried_by_shared_tracks_does_not_jump() -> None:
    """Exact for a motion without turning, whatever part of the cloud a frame shows, also over frames between."""
    frame, l, _, T_true = turning_cloud((0.8, 0.5, 2.0), 0.0)
    point = np.tile(np.arange(200), FRAMES)
    seen = (np.abs(point - 8 * frame) < 20) & ~((frame == 12) & (point < 100))
    R, T = from_shared_tracks(frame[seen], point[seen], l[seen], FRAMES)
    np.testing.assert_allclose(np.diff(T, axis=0), np.diff(T_true, axis=0), atol=1e-10)
    np.testing.assert_array_equal(R, np.broadcast_to(np.eye(3), R.shape))
    X = points_from_cloud(frame[seen], point[seen], l[seen], R, T, 200, "mean")
    np.testing.assert_allclose(X.mean(axis=0), 0, atol=1e-10)
    assert np.abs(np.diff(from_cloud(frame[seen], l[seen], FRAMES)[1] - T_true, axis=0)).max() > 0.05


def test_the_centroid_carried_is_least_squares() -> None:
    frame, l, _, _ = turning_cloud((0.8, 0.5, 2.0), 0.02, 0.3)
    point = np.tile(np.arange(200), FRAMES)
    seen = (point * 7 + frame * 11) % 13 < 5
    frame, point, l = frame[seen], point[seen], l[seen]
    R, T = from_shared_tracks(frame, point, l, FRAMES)
    v = l - T[frame] - points_from_cloud(frame, point, l, R, T, 200, "mean")[point]
    for of, count in ((frame, FRAMES), (point, 200)):
        sums = np.stack([np.bincount(of, v[:, a], minlength=count) for a in range(3)])
        np.testing.assert_allclose(sums, 0, atol=1e-9)


def test_frames_without_any_common_track_are_no_failure() -> None:
    frame, l, _, _ = turning_cloud((0.8, 0.5, 2.0), 0.0)
    point = np.tile(np.arange(200), FRAMES)
    apart = np.where(frame < 12, point < 100, point >= 100)
    _, T = from_shared_tracks(frame[apart], point[apart], l[apart], FRAMES)
    assert np.isfinite(T).all()


@pytest.mark.parametrize("average", ["mean", "median"])
def test_points_from_cloud(average: Average) -> None:
    """Against NumPy, point by point, over even and odd numbers of frames."""
    frame, l, R, T = turning_cloud((0.8, 0.5, 2.0), 0.1, 0.2)
    point = np.tile(np.arange(200), FRAMES)
    seen = (point * 7 + frame * 11) % 13 < 5
    frame, point, l = frame[seen], point[seen], l[seen]
    X = points_from_cloud(frame, point, l, R, T, 200, average)
    Y = np.einsum("kba,kb->ka", R[frame], l - T[frame])
    expected = [getattr(np, average)(Y[point == i], axis=0) for i in range(200)]
    assert {np.count_nonzero(point == i) % 2 for i in range(200)} == {0, 1}
    np.testing.assert_allclose(X, expected, atol=1e-12)


def test_the_median_survives_outliers() -> None:
    frame, l, R, T = turning_cloud((0.8, 0.5, 2.0), 0.1)
    point = np.tile(np.arange(200), FRAMES)
    X = points_from_cloud(frame, point, l, R, T, 200, "mean")
    wrong = l + np.where((frame % 3 == 0)[:, None], 50.0, 0.0)
    np.testing.assert_allclose(points_from_cloud(frame, point, wrong, R, T, 200, "median"), X, atol=1e-10)
    assert np.abs(points_from_cloud(frame, point, wrong, R, T, 200, "mean") - X).max() > 10


def test_propagated_points_are_the_last_window_s_where_it_knew_them() -> None:
    X, known = np.zeros((4, 3)), np.arange(9.0).reshape(3, 3)
    found = propagated_points(np.array([2, 5, 7, 9]), X, np.array([1, 5, 9]), known)
    np.testing.assert_array_equal(found, [[0, 0, 0], known[1], [0, 0, 0], known[2]])
    np.testing.assert_array_equal(X, 0)


def test_drift_is_an_origin_off_the_object() -> None:
    X = np.random.default_rng(0).uniform([-0.9, -0.7, -2.2], [0.9, 0.7, 2.2], (50, 3))
    diagonal = 5.0
    assert not has_drifted(X - X[0], diagonal)  # on the object's surface
    assert has_drifted(X + np.array([0, 0, 8.0]), diagonal)
    X[:5] += 100  # outliers do not count
    assert not has_drifted(X, diagonal)


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
