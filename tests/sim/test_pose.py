"""Rotations and poses: group axioms, series near the singularities, and every angle convention against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from sim import pose
from sim.pose import Pose, exp_so3, hat, interpolate, left_jacobian, log_so3

Array = np.ndarray
# A product of a few 3x3 matrices of unit size loses a few ulp (2e-16) an operation.
ROUNDING = 1e-14


def vectors(limit: float, size: int = 3) -> st.SearchStrategy[Array]:
    return hnp.arrays(float, size, elements=st.floats(-limit, limit))


def angles_below_pi() -> st.SearchStrategy[Array]:
    """Rotation vectors shorter than pi - 1e-3, where the logarithm is the inverse of the exponential."""
    return vectors(3.0).map(lambda r: r * min(1.0, (np.pi - 1e-3) / max(float(np.linalg.norm(r)), 1e-12)))


poses = st.builds(lambda r, t: Pose(exp_so3(r), t), vectors(3.0), vectors(100.0))


def assert_same(a: Pose, b: Pose, size: float = 1.0) -> None:
    np.testing.assert_allclose(a.R, b.R, atol=ROUNDING)
    np.testing.assert_allclose(a.t, b.t, atol=ROUNDING * max(size, 1.0))


@given(vectors(10), vectors(10))
def test_hat_is_the_cross_product(x: Array, y: Array) -> None:
    # A difference of products up to 100, rounded once each.
    np.testing.assert_allclose(hat(x) @ y, np.cross(x, y), atol=1e-13)


@given(vectors(4.0))
def test_exp_is_a_rotation_and_the_matrix_exponential(r: Array) -> None:
    R = exp_so3(r)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=ROUNDING)
    assert np.linalg.det(R) == pytest.approx(1, abs=ROUNDING)
    # expm scales and squares: a few times more rounding than a closed form.
    np.testing.assert_allclose(R, expm(hat(r)), atol=1e-13)


@given(angles_below_pi())
def test_log_is_the_inverse_of_exp(r: Array) -> None:
    # Near pi the logarithm divides rounding by sin: 1e-16 / 1e-3 at the edge of the strategy.
    np.testing.assert_allclose(log_so3(exp_so3(r)), r, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-12, 0.99e-4, 1.01e-4, 1e-3, np.pi - 1e-6, np.pi - 1e-10, np.pi])
@pytest.mark.parametrize("axis", [[1, 0, 0], [0, 0, 1], [0.6, 0, -0.8], [1, 2, 3]])
def test_exp_and_log_at_their_singularities(angle: float, axis: list[float]) -> None:
    r = angle * np.array(axis) / np.linalg.norm(axis)
    R = exp_so3(r)
    np.testing.assert_allclose(R, Rotation.from_rotvec(r).as_matrix(), atol=ROUNDING)
    back = log_so3(R)
    # At pi both directions of the axis are the same rotation, so the rotation is what must return.
    np.testing.assert_allclose(exp_so3(back), R, atol=ROUNDING)
    assert np.linalg.norm(back) == pytest.approx(angle, abs=ROUNDING)


def test_series_meets_closed_form() -> None:
    """Left and right of the switch the next term left out is below rounding: no step."""
    for a in (1e-4 * (1 - 1e-9), 1e-4 * (1 + 1e-9)):
        r = np.array([a, 0, 0])
        S = hat(r)
        # sin(a)/a needs a^4/120 = 1e-18; (a - sin a)/a^3 cancels to 1e-16/a^2 = 1e-8, times a^2 in the Jacobian.
        np.testing.assert_allclose(exp_so3(r), Rotation.from_rotvec(r).as_matrix(), rtol=0, atol=1e-16)
        expected = np.eye(3) + (0.5 - a * a / 24) * S + S @ S / 6
        np.testing.assert_allclose(left_jacobian(r), expected, rtol=0, atol=1e-15)


def test_log_of_no_rotations_is_empty() -> None:
    assert log_so3(np.empty((0, 3, 3))).shape == (0, 3)
    assert log_so3(np.broadcast_to(np.eye(3), (2, 4, 3, 3))).shape == (2, 4, 3)


@given(vectors(1.7))
def test_left_jacobian_by_finite_differences(r: Array) -> None:
    h = 1e-6
    steps = h * np.eye(3)
    numeric = (log_so3(exp_so3(r + steps) @ exp_so3(r).T) - log_so3(exp_so3(r - steps) @ exp_so3(r).T)).T / (2 * h)
    # Rounding 1e-16 / h and truncation h^2.
    np.testing.assert_allclose(left_jacobian(r), numeric, atol=1e-9)


@given(poses, poses, poses)
def test_poses_form_a_group(a: Pose, b: Pose, c: Pose) -> None:
    assert_same((a @ b) @ c, a @ (b @ c), 300)
    assert_same(a @ a.inv(), Pose.identity(), 300)
    assert_same(a.inv() @ a, Pose.identity(), 300)
    assert_same(a @ Pose.identity(), a)
    assert_same(Pose.identity() @ a, a)
    assert_same((a @ b).inv(), b.inv() @ a.inv(), 300)


@given(poses, poses, vectors(50))
def test_pose_acts_on_points_as_its_matrix(a: Pose, b: Pose, x: Array) -> None:
    np.testing.assert_allclose((a @ b).apply(x), a.apply(b.apply(x)), atol=1e-12)  # sizes to 300: 300 * ROUNDING
    np.testing.assert_allclose((a.matrix() @ np.append(x, 1))[:3], a.apply(x), atol=1e-12)
    np.testing.assert_allclose(a.inv().apply(a.apply(x)), x, atol=1e-12)


@given(angles_below_pi(), vectors(20))
def test_se3_exponential_is_that_of_the_matrix_and_log_its_inverse(r: Array, u: Array) -> None:
    xi = np.concatenate([r, u])
    M = np.zeros((4, 4))
    M[:3, :3], M[:3, 3] = hat(r), u
    # The Jacobian's (a - sin a)/a^3 just above its switch (a = 1e-4) is good to 1e-8, times a^2 |u|.
    np.testing.assert_allclose(Pose.exp(xi).matrix(), expm(M), atol=1e-11)
    # Its inverse is singular at 2 pi only; near pi log loses 1e-13, times |u|.
    np.testing.assert_allclose(Pose.exp(xi).log(), xi, atol=1e-10)


def test_batches_broadcast_and_index() -> None:
    rng = np.random.default_rng(1)
    T = Pose(exp_so3(rng.normal(size=(4, 3))), rng.normal(size=(4, 3)))
    x = rng.normal(size=(5, 1, 3))
    y = T.apply(x)
    assert y.shape == (5, 4, 3)
    for i in range(4):
        np.testing.assert_allclose(y[:, i], T[i].apply(x[:, 0]), atol=ROUNDING)
    assert len(T) == 4
    assert_same(Pose.stack([T[i] for i in range(4)]), T)
    assert_same(T[1:3], Pose.stack([T[1], T[2]]))
    assert T.inv().matrix().shape == (4, 4, 4)
    assert Pose.identity((2, 3)).t.shape == (2, 3, 3)
    with pytest.raises(IndexError, match="single Pose"):
        T[0][0]


def test_pose_refuses_wrong_shapes_and_is_read_only() -> None:
    # Shape annotations refuse it in the tests, the constructor elsewhere.
    with pytest.raises((ValueError, TypeError)):
        Pose(np.eye(4), np.zeros(3))
    R = np.eye(3)
    T = Pose(R, np.zeros(3))
    R[0, 0] = 7
    assert T.R[0, 0] == 1
    with pytest.raises(ValueError, match="read-only"):
        T.R[0, 0] = 2
    with pytest.raises(ValueError, match="read-only"):
        T.t[0] = 2


@given(poses, poses)
def test_interpolation_meets_its_ends_and_is_uniform(a: Pose, b: Pose) -> None:
    turn = log_so3(a.R.T @ b.R)
    if np.linalg.norm(turn) > np.pi - 1e-3:  # two shortest ways
        return
    ends = interpolate(a, b, np.array([0.0, 1.0]))
    assert_same(ends[0], a, 100)
    np.testing.assert_allclose(ends[1].R, b.R, atol=1e-12)  # log near pi, see above
    np.testing.assert_allclose(ends[1].t, b.t, atol=1e-12)
    third = interpolate(a, b, 1 / 3)
    np.testing.assert_allclose(log_so3(a.R.T @ third.R), turn / 3, atol=1e-11)
    np.testing.assert_allclose(third.t, a.t + (b.t - a.t) / 3, atol=1e-12)


@given(vectors(100))
def test_rodrigues_vector_round_trip_and_its_definition(m: Array) -> None:
    R = pose.rotation_from_rodrigues(m)
    S = hat(m / 2)
    # Cayley's form of the same rotation (McGlone 2004): (I - S)^-1 (I + S), conditioned by |m|.
    np.testing.assert_allclose(R, np.linalg.solve(np.eye(3) - S, np.eye(3) + S), atol=1e-12)
    # tan(angle/2) = 87 amplifies an error of the angle by 1 + 87^2.
    np.testing.assert_allclose(pose.rodrigues_from_rotation(R), m, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("a", [0.0, 1e-9, 0.99e-4, 1.01e-4, 1.99e-4, 2.01e-4])
def test_rodrigues_vector_near_zero(a: float) -> None:
    m = a * np.array([0.6, 0, 0.8])
    np.testing.assert_allclose(pose.rodrigues_from_rotation(pose.rotation_from_rodrigues(m)), m, rtol=0, atol=1e-16)


@given(vectors(4.0))
def test_quaternion_against_scipy(r: Array) -> None:
    R = exp_so3(r)
    q = pose.quaternion_from_rotation(R)
    assert q[0] >= 0
    assert np.linalg.norm(q) == pytest.approx(1, abs=ROUNDING)
    np.testing.assert_allclose(pose.rotation_from_quaternion(3 * q), R, atol=ROUNDING)
    np.testing.assert_allclose(pose.rotation_from_quaternion(-q), R, atol=ROUNDING)
    np.testing.assert_allclose(Rotation.from_quat(np.roll(q, -1)).as_matrix(), R, atol=ROUNDING)


@given(st.floats(-3.1, 3.1))
def test_heading_of_a_vehicle(heading: float) -> None:
    """Clockwise from +y: at zero the vehicle's axes forward, left, up are +y, -x, +z."""
    R = pose.vehicle_rotation(heading)
    np.testing.assert_allclose(R[:, 0], [np.sin(heading), np.cos(heading), 0], atol=ROUNDING)
    np.testing.assert_allclose(R[:, 1], [-np.cos(heading), np.sin(heading), 0], atol=ROUNDING)
    np.testing.assert_allclose(R[:, 2], [0, 0, 1], atol=ROUNDING)
    assert pose.heading_of(R) == pytest.approx(heading, abs=ROUNDING)


def test_conventions_are_batched() -> None:
    rng = np.random.default_rng(2)
    m = rng.uniform(-1, 1, (2, 5, 3))
    R = pose.rotation_from_rodrigues(m)
    assert R.shape == (2, 5, 3, 3)
    np.testing.assert_allclose(pose.rodrigues_from_rotation(R), m, atol=1e-12)
    assert pose.quaternion_from_rotation(R).shape == (2, 5, 4)
    assert pose.rotation_from_quaternion(pose.quaternion_from_rotation(R)).shape == (2, 5, 3, 3)


def test_level_camera_axes() -> None:
    """Camera right, down and forward are world right, -up and forward."""
    np.testing.assert_array_equal(pose.R_WORLD_FROM_LEVEL_CAMERA, np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]).T)
