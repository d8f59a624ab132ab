"""Attitudes and mountings against SciPy, the source's matrices written out, and signs checked by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod
from scipy.spatial.transform import Rotation

from sim import angles
from sim.angles import Mounting
from sim.geodesy import Georeference
from sim.pose import Pose, exp_so3

Array = np.ndarray
ROUNDING = 1e-14  # a product of a few matrices of unit size
FLIP = np.diag([1.0, -1.0, -1.0])
SWAP = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])  # (3.17)

full = st.floats(-3.1, 3.1)
# 1e-3 from the gimbal lock the outer angles still have 1e-3 of their digits.
half = st.floats(-np.pi / 2 + 1e-3, np.pi / 2 - 1e-3)
convergences = st.floats(-0.1, 0.1)
rotations = st.builds(lambda a, b, c: exp_so3(np.array([a, b, c])), full, full, full)


def deg(*values: float) -> Array:
    return np.deg2rad(np.array(values))


@given(full, half, full)
def test_roll_pitch_heading_against_scipy(roll: float, pitch: float, heading: float) -> None:
    rph = np.array([roll, pitch, heading])
    R = angles.rotation_from_roll_pitch_heading(rph)
    np.testing.assert_allclose(R, Rotation.from_euler("ZYX", rph[::-1]).as_matrix(), atol=ROUNDING)
    np.testing.assert_allclose(angles.roll_pitch_heading(R), rph, atol=1e-12)


@given(full, half, full)
def test_omega_phi_kappa_against_scipy(omega: float, phi: float, kappa: float) -> None:
    opk = np.array([omega, phi, kappa])
    R = angles.rotation_from_omega_phi_kappa(opk)
    np.testing.assert_allclose(R, Rotation.from_euler("XYZ", opk).as_matrix() @ FLIP, atol=ROUNDING)
    np.testing.assert_allclose(angles.omega_phi_kappa(R), opk, atol=1e-12)


@given(full, half, full)
def test_angles_are_the_sources_formulas(omega: float, phi: float, kappa: float) -> None:
    """(3.20)-(3.22) as printed, away from the lock."""
    M = Rotation.from_euler("XYZ", [omega, phi, kappa]).as_matrix()
    phi_ = np.arctan2(M[0, 2], np.sqrt(M[1, 2] ** 2 + M[2, 2] ** 2))
    printed = [
        np.arctan2(-M[1, 2] / np.cos(phi_), M[2, 2] / np.cos(phi_)),
        phi_,
        np.arctan2(-M[0, 1] / np.cos(phi_), M[0, 0] / np.cos(phi_)),
    ]
    np.testing.assert_allclose(angles.omega_phi_kappa(M @ FLIP), printed, atol=1e-12)


@given(full, st.sampled_from([-1.0, 1.0]), st.floats(0, 1e-7), full)
def test_angles_at_the_gimbal_lock_give_the_rotation_back(a: float, sign: float, off: float, b: float) -> None:
    middle = sign * (np.pi / 2 - off)
    R = angles.rotation_from_roll_pitch_heading(np.array([a, middle, b]))
    np.testing.assert_allclose(angles.rotation_from_roll_pitch_heading(angles.roll_pitch_heading(R)), R, atol=ROUNDING)
    R = angles.rotation_from_omega_phi_kappa(np.array([a, middle, b]))
    np.testing.assert_allclose(angles.rotation_from_omega_phi_kappa(angles.omega_phi_kappa(R)), R, atol=ROUNDING)


def test_what_roll_pitch_and_heading_mean() -> None:
    """Forward, right and down of the body in the map (east, north, up) where true is grid north."""

    def axes(roll: float, pitch: float, heading: float) -> Array:
        return angles.body_rotation(deg(roll, pitch, heading), 0.0).T

    np.testing.assert_allclose(axes(0, 0, 0), [[0, 1, 0], [1, 0, 0], [0, 0, -1]], atol=ROUNDING)
    np.testing.assert_allclose(axes(0, 0, 90), [[1, 0, 0], [0, -1, 0], [0, 0, -1]], atol=ROUNDING)
    assert axes(0, 10, 30)[0, 2] == pytest.approx(np.sin(np.deg2rad(10)))  # the nose rises
    assert axes(10, 0, 30)[1, 2] == pytest.approx(-np.sin(np.deg2rad(10)))  # the right side sinks


def test_what_omega_phi_and_kappa_mean() -> None:
    """Axes right, down, forward of the camera in the map."""

    def axes(omega: float, phi: float, kappa: float) -> Array:
        return angles.rotation_from_omega_phi_kappa(deg(omega, phi, kappa)).T

    np.testing.assert_allclose(axes(0, 0, 0), [[1, 0, 0], [0, -1, 0], [0, 0, -1]], atol=ROUNDING)
    np.testing.assert_allclose(axes(0, 0, 90)[0], [0, 1, 0], atol=ROUNDING)  # counter-clockwise seen from above
    assert axes(10, 0, 0)[2, 1] > 0.1  # omega > 0 looks to the north
    assert axes(0, 10, 0)[2, 0] < -0.1  # phi > 0 looks to the west


@pytest.mark.parametrize(
    ("heading", "kappa", "top"),
    [
        (0, 0, [0, 1, 0]),
        (90, 0, [1, 0, 0]),
        (180, 0, [0, -1, 0]),
        (90, -90, [0, 1, 0]),  # the top of the image points left of the flight
        (90, 90, [0, -1, 0]),
    ],
)
def test_top_of_the_image(heading: float, kappa: float, top: list[float]) -> None:
    """Level flight: the camera looks down, and the image's top points forward unless mounted at 90 degrees."""
    T_wc = angles.camera_pose(deg(0, 0, heading), np.zeros(3), 0.0, Mounting(deg(0, 0, kappa), np.zeros(3)))
    np.testing.assert_allclose(-T_wc.R[:, 1], top, atol=ROUNDING)
    np.testing.assert_allclose(T_wc.R[:, 2], [0, 0, -1], atol=ROUNDING)


def test_boresight_signs_and_lever_arm() -> None:
    """omega < 0 looks forward, phi < 0 to the left; a lever arm forward lies ahead, one down below the body."""
    east = deg(0, 0, 90)
    view = angles.camera_pose(east, np.zeros(3), 0.0, Mounting(deg(-5, 0, 0), np.zeros(3))).R[:, 2]
    assert view[0] == pytest.approx(np.sin(np.deg2rad(5)))
    view = angles.camera_pose(east, np.zeros(3), 0.0, Mounting(deg(0, -5, 0), np.zeros(3))).R[:, 2]
    assert view[1] == pytest.approx(np.sin(np.deg2rad(5)))
    T_wc = angles.camera_pose(east, np.array([10.0, 20, 30]), 0.0, Mounting(np.zeros(3), np.array([2.0, 1, 0.5])))
    np.testing.assert_allclose(T_wc.t, [12, 19, 29.5], atol=ROUNDING * 30)


@given(rotations, full, half, full)
def test_boresight_is_the_sources_chain(R_wc: Array, roll: float, pitch: float, heading: float) -> None:
    """(3.17)-(3.19) written out: M_b̄^m = S M_b^n S, M_b̄^c = (M_c^m)^-1 M_b̄^m."""
    rph = np.array([roll, pitch, heading])
    M_nb = Rotation.from_euler("ZYX", rph[::-1]).as_matrix()
    M = (R_wc @ FLIP).T @ (SWAP @ M_nb @ SWAP)
    R_bc = angles.body_rotation(rph, 0.0).T @ R_wc
    boresight = angles.boresight_angles(R_bc)
    np.testing.assert_allclose(Rotation.from_euler("XYZ", boresight).as_matrix(), M, atol=ROUNDING)
    np.testing.assert_allclose(angles.boresight_rotation(boresight), R_bc, atol=ROUNDING)


@given(rotations, st.tuples(full, half, full), convergences)
def test_camera_pose_and_back(R: Array, boresight: tuple[float, float, float], gamma: float) -> None:
    mounting = Mounting(np.array(boresight), np.array([0.3, -0.1, 0.2]))
    T_wc = Pose(R, np.array([100.0, -200, 500]))
    rph, p_wb = angles.imu_from_camera_pose(T_wc, gamma, mounting)
    again = angles.camera_pose(rph, p_wb, gamma, mounting)
    np.testing.assert_allclose(again.R, T_wc.R, atol=ROUNDING)
    np.testing.assert_allclose(again.t, T_wc.t, atol=ROUNDING * 500)


@given(st.floats(-2.9, 2.9), st.floats(-70, 70), full)
def test_heading_is_true_in_a_grid_that_is_not(dlon: float, lat: float, heading: float) -> None:
    """Flying a true heading moves along the geodesic of that azimuth, computed on the ellipsoid."""
    reference = Georeference(32632 if lat >= 0 else 32732)
    p_w = reference.from_crs(np.array([9 + dlon, lat]))
    forward = angles.body_rotation(np.array([0, 0, heading]), reference.convergence(p_w))[:, 0]
    lon, lat_end, _ = Geod(ellps="WGS84").fwd(9 + dlon, lat, np.rad2deg(heading), 10.0)
    step = reference.from_crs(np.array([lon, lat_end])) - p_w
    # 10 m: coordinates to 1e-8 m, and half the arc's change of direction, tan(70°) 5 m / 6.4e6 m.
    np.testing.assert_allclose(step / np.linalg.norm(step), forward[:2], atol=5e-6)


def test_batches_broadcast() -> None:
    rng = np.random.default_rng(5)
    rph, p_wb, gamma = rng.uniform(-1, 1, (4, 6, 3)), rng.normal(size=(4, 6, 3)), rng.uniform(-0.1, 0.1, 6)
    mounting = Mounting(deg(0.1, -0.2, -90), np.array([0.1, 0.2, 0.3]))
    T_wc = angles.camera_pose(rph, p_wb, gamma, mounting)
    assert T_wc.R.shape == (4, 6, 3, 3)
    one = angles.camera_pose(rph[2, 3], p_wb[2, 3], gamma[3], mounting)
    np.testing.assert_allclose(T_wc.t[2, 3], one.t, atol=ROUNDING)
    np.testing.assert_allclose(T_wc.R[2, 3], one.R, atol=ROUNDING)
    back, p = angles.imu_from_camera_pose(T_wc, gamma, mounting)
    np.testing.assert_allclose(back, rph, atol=1e-13)
    np.testing.assert_allclose(p, p_wb, atol=1e-13)
    assert angles.omega_phi_kappa(T_wc.R).shape == (4, 6, 3)


@pytest.mark.parametrize("convergence", [None, np.nan, 1.86, np.array([0.01, -0.5])])
def test_a_heading_without_its_convergence_is_refused(convergence: object) -> None:
    """None, unknown, and degrees taken for radians."""
    with pytest.raises(ValueError, match="convergence"):
        angles.body_rotation(np.zeros(3), convergence)  # type: ignore[arg-type]  # the refusal is the test


def test_mounting_refuses_what_is_no_vector() -> None:
    with pytest.raises(ValueError, match="boresight"):
        Mounting(np.array([0, np.nan, 0]), np.zeros(3))
