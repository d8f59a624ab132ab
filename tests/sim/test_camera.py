"""Cameras against OpenCV, every Jacobian by finite differences, inverse functions and refusals."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from sim.camera import Camera, StereoRig
from sim.pose import Pose, exp_so3

Array = np.ndarray

PINHOLE = Camera.simple((640, 480), 500.0)
BROWN = Camera(
    np.array([[510.0, 0, 317.3], [0, 498.0, 243.8], [0, 0, 1]]), (640, 480), np.array([-0.28, 0.09, 1e-3, -6e-4, -0.01])
)
SKEWED = Camera(np.array([[510.0, 2.5, 317.3], [0, 498.0, 243.8], [0, 0, 1]]), (640, 480), BROWN.distortion)
CAMERAS = {"pinhole": PINHOLE, "brown": BROWN, "skewed": SKEWED}
every_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())

RIGS = {
    "normal": StereoRig.normal_case(PINHOLE, 0.3),
    "general": StereoRig(BROWN, SKEWED, Pose(exp_so3(np.array([0.02, -0.05, 0.01])), np.array([-0.3, 0.02, 0.05]))),
}
every_rig = pytest.mark.parametrize("rig", RIGS.values(), ids=RIGS.keys())


def points_in_view(camera: Camera, n: int = 200) -> Array:
    """Points whose pixels fill the image, 2 m to 60 m away."""
    rng = np.random.default_rng(3)
    uv = rng.uniform(0, np.array(camera.size_px) - 1, (n, 2))
    return camera.unproject(uv, rng.uniform(2, 60, n))


def derivative(f: object, p: Array, h: float = 1e-5) -> Array:
    """Central differences (n, outputs, 3) of a function of points (n, 3)."""
    assert callable(f)
    return np.stack([(f(p + h * e) - f(p - h * e)) / (2 * h) for e in np.eye(3)], axis=-1)


@pytest.mark.parametrize("camera", [PINHOLE, BROWN], ids=["pinhole", "brown"])
def test_projection_is_opencv_s(camera: Camera) -> None:
    p = points_in_view(camera)
    expected, _ = cv2.projectPoints(p, np.zeros(3), np.zeros(3), camera.K, camera.distortion)
    # Pixels to 640 in double precision.
    np.testing.assert_allclose(camera.project(p), expected[:, 0], atol=1e-10)


def test_right_camera_is_opencv_s_with_its_pose() -> None:
    rig = StereoRig(PINHOLE, BROWN, RIGS["general"].T_rl)
    p = points_in_view(PINHOLE)
    r, _ = cv2.Rodrigues(rig.T_rl.R)
    expected, _ = cv2.projectPoints(p, r, rig.T_rl.t, BROWN.K, BROWN.distortion)
    np.testing.assert_allclose(rig.project(p)[:, 2:], expected[:, 0], atol=1e-9)
    np.testing.assert_array_equal(rig.project(p)[:, :2], PINHOLE.project(p))


def test_skew_shifts_columns_with_rows() -> None:
    """u = f_x x + s y + c_x, v = f_y y + c_y."""
    camera = Camera(np.array([[500.0, 3, 320], [0, 400, 240], [0, 0, 1]]), (640, 480))
    np.testing.assert_allclose(camera.project(np.array([0.2, 0.1, 2.0])), [500 * 0.1 + 3 * 0.05 + 320, 260])


@every_camera
def test_projection_jacobian(camera: Camera) -> None:
    p = points_in_view(camera)
    # Largest entry f/z = 250 px/m; truncation h^2 f'''/6 with f''' ~ 500/z^4 * 6 at 2 m, rounding 1e-13/h.
    np.testing.assert_allclose(camera.project_jacobian(p), derivative(camera.project, p), rtol=1e-7, atol=2e-6)


@every_rig
def test_rig_jacobian(rig: StereoRig) -> None:
    p = points_in_view(rig.left)
    np.testing.assert_allclose(rig.project_jacobian(p), derivative(rig.project, p), rtol=1e-7, atol=2e-6)


@every_camera
def test_normalise_jacobian(camera: Camera) -> None:
    p = points_in_view(camera)
    uv, h = camera.project(p), 1e-3
    numeric = np.stack([(camera.normalise(uv + h * e) - camera.normalise(uv - h * e)) / (2 * h) for e in np.eye(2)], -1)
    # Truncation h^2/f^3, rounding 1e-16/h, relative to 1/f = 2e-3.
    np.testing.assert_allclose(camera.normalise_jacobian(camera.normalise(uv)), numeric, rtol=1e-6, atol=1e-11)


@every_camera
def test_pixels_return_from_rays(camera: Camera) -> None:
    u, v = np.meshgrid(np.linspace(0, 639, 30), np.linspace(0, 479, 20))
    uv = np.stack([u, v], axis=-1)
    # Newton ends at 1e-16 in normalised units, times the focal length.
    np.testing.assert_allclose(camera.to_pixels(camera.distort(camera.normalise(uv))), uv, atol=1e-10)
    depth = np.full(u.shape, 7.5)
    p = camera.unproject(uv, depth)
    assert p.shape == (20, 30, 3)
    np.testing.assert_array_equal(p[..., 2], depth)
    np.testing.assert_allclose(camera.project(p), uv, atol=1e-10)


def test_undistortion_is_opencv_s() -> None:
    uv = np.random.default_rng(1).uniform(100, 380, (50, 2))
    criteria = (cv2.TERM_CRITERIA_MAX_ITER + cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    expected = cv2.undistortPoints(uv[:, None], BROWN.K, BROWN.distortion, None, None, None, criteria)
    np.testing.assert_allclose(BROWN.normalise(uv), expected[:, 0], atol=1e-10)  # OpenCV iterates to about 1e-11


# With k1 = -0.28 alone the distorted radius r (1 - 0.28 r²) grows to 0.7274 at r = 1.0911, then falls.
FOLDING = Camera(PINHOLE.K, PINHOLE.size_px, np.array([-0.28, 0, 0, 0, 0]))


def ring(radius: float) -> Array:
    angle = np.linspace(0, 2 * np.pi, 50)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


@pytest.mark.parametrize("radius", [0.74, 0.8, 0.9, 1.0, 1.5, 2.2, 3.0])
def test_no_ray_belongs_to_a_pixel_beyond_the_lens_model(radius: float) -> None:
    """Newton finds roots on the far side of the fold, too; they are none."""
    assert np.isnan(FOLDING.undistort(ring(radius))).all()


def test_rays_are_found_up_to_the_fold() -> None:
    for radius in (0.3, 0.9, 1.09):
        np.testing.assert_allclose(FOLDING.undistort(FOLDING.distort(ring(radius))), ring(radius), atol=1e-9)


def test_points_beyond_the_lens_model_do_not_appear_in_the_image() -> None:
    """A ray of r = 1.9 would fold back to r = -0.02, the middle of the image."""
    beyond = np.concatenate([ring(1.9), np.ones((50, 1))], axis=1)
    assert np.isnan(FOLDING.project(beyond)).all()
    np.testing.assert_array_equal(PINHOLE.project(beyond), ring(1.9) * 500 + PINHOLE.K[:2, 2])


@every_camera
def test_nothing_behind_the_camera_is_seen(camera: Camera) -> None:
    p = np.array([[0.1, 0.2, -3.0], [0.1, 0.2, 0.0], [0.1, 0.2, 3.0]])
    uv = camera.project(p)
    assert np.isnan(uv[:2]).all()
    assert np.isfinite(uv[2]).all()
    assert not camera.contains(uv[:2]).any()
    assert camera.contains(uv[2])


def test_nothing_behind_the_right_camera_is_seen_by_it() -> None:
    rig = StereoRig(PINHOLE, PINHOLE, Pose(np.eye(3), np.array([-0.3, 0, -5.0])))
    uv = rig.project(np.array([0.0, 0.0, 4.0]))
    assert np.isfinite(uv[:2]).all()
    assert np.isnan(uv[2:]).all()


def test_the_image_ends_half_a_pixel_beyond_its_outer_centres() -> None:
    inside = np.array([[0.0, 0.0], [-0.49, 479.49], [639.49, -0.49], [320, 240]])
    outside = np.array([[-0.51, 100], [100, -0.51], [639.51, 100], [100, 479.51], [np.nan, 100], [100, np.nan]])
    assert PINHOLE.contains(inside).all()
    assert not PINHOLE.contains(outside).any()
    np.testing.assert_array_equal(PINHOLE.contains(inside, 1.0), [False, False, False, True])
    assert PINHOLE.contains(np.array([0.5, 478.5]), 1.0)


def test_principal_point_is_the_middle_of_the_image_by_default() -> None:
    np.testing.assert_array_equal(PINHOLE.K[:2, 2], [319.5, 239.5])
    np.testing.assert_array_equal(Camera.simple((640, 480), 500.0, (0.0, 10.0)).K[:2, 2], [0, 10])


@pytest.mark.parametrize("baseline", [0.0, -0.3, float("nan")])
def test_normal_case_refuses_a_base_that_is_none(baseline: float) -> None:
    with pytest.raises(ValueError, match="baseline_m"):
        StereoRig.normal_case(PINHOLE, baseline)


@pytest.mark.parametrize("focal", [0.0, -500.0, float("nan")])
def test_camera_refuses_a_focal_length_that_is_none(focal: float) -> None:
    with pytest.raises(ValueError, match="focal lengths"):
        Camera.simple((640, 480), focal)


def test_camera_refuses_what_is_not_finite() -> None:
    with pytest.raises(ValueError, match="finite"):
        Camera.simple((640, 480), 500.0, (float("nan"), 10.0))
    with pytest.raises(ValueError, match="finite"):
        Camera(PINHOLE.K, (640, 480), np.array([0, 0, np.inf, 0, 0]))


def test_camera_refuses_wrong_shapes() -> None:
    # Shape annotations refuse it in the tests, the constructor elsewhere.
    with pytest.raises((ValueError, TypeError)):
        Camera(np.eye(4), (640, 480))
    with pytest.raises((ValueError, TypeError)):
        Camera(np.eye(3), (640, 480), np.zeros(4))


def test_what_is_a_normal_case() -> None:
    assert RIGS["normal"].is_normal_case
    other_column = Camera.simple((640, 480), 500.0, (332.0, 239.5))
    assert StereoRig(PINHOLE, other_column, RIGS["normal"].T_rl).is_normal_case
    base = np.array([-0.3, 0, 0])
    not_normal = [
        RIGS["general"],
        StereoRig(BROWN, BROWN, Pose(np.eye(3), base)),
        StereoRig(PINHOLE, Camera.simple((640, 480), 501.0), Pose(np.eye(3), base)),
        StereoRig(PINHOLE, Camera.simple((640, 480), 500.0, (319.5, 240.5)), Pose(np.eye(3), base)),
        StereoRig(PINHOLE, PINHOLE, Pose(exp_so3(np.array([0, 1e-4, 0])), base)),
        StereoRig(PINHOLE, PINHOLE, Pose(np.eye(3), np.array([-0.3, 0.001, 0]))),
        StereoRig(PINHOLE, PINHOLE, Pose(np.eye(3), -base)),
    ]
    assert not any(rig.is_normal_case for rig in not_normal)


def test_batches_of_any_shape() -> None:
    p = points_in_view(PINHOLE, 24).reshape(2, 3, 4, 3)
    for rig in RIGS.values():
        assert rig.project(p).shape == (2, 3, 4, 4)
        assert rig.project_jacobian(p).shape == (2, 3, 4, 4, 3)
        np.testing.assert_allclose(rig.project(p)[1, 2, 3], rig.project(p[1, 2, 3]), atol=1e-12)
