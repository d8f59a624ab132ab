"""Photogrammetric interior orientation against the source's formulas written out, and against `Camera`."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sim.camera import Camera
from sim.interior import InteriorOrientation

# 50 mm on 36 x 24 mm with the distortion of a common lens, 47 px at the corners, in mm as calibrations print it.
LENS = InteriorOrientation(
    principal_distance=50.123,
    pitch=(36 / 4992, 24 / 3328),
    size_px=(4992, 3328),
    principal_point=(0.112, -0.087),
    radial=(4.5e-5, -3.0e-8, 1.0e-11),
    decentring=(4.0e-6, -3.0e-6),
    affinity=(2.0e-4, -1.0e-4),
)


def rng_points(n: int) -> np.ndarray:
    return np.random.default_rng(1).uniform([-18, -12], [18, 12], (n, 2))


def test_correction_is_the_sources_formula() -> None:
    """(3.4)-(3.10) one point at a time."""
    (K1, K2, K3), (P1, P2), (B1, B2) = LENS.radial, LENS.decentring, LENS.affinity
    points = rng_points(20)
    for (x, y), (dx, dy) in zip(points, LENS.correction(points), strict=True):
        r = math.hypot(x, y)
        xr = x * (r**2 * K1 + r**4 * K2 + r**6 * K3)
        yr = y * (r**2 * K1 + r**4 * K2 + r**6 * K3)
        xd = (r**2 + 2 * x**2) * P1 + 2 * x * y * P2
        yd = 2 * x * y * P1 + (r**2 + 2 * y**2) * P2
        assert (dx, dy) == pytest.approx((xr + xd + x * B1 + y * B2, yr + yd), rel=1e-12)


def test_pixels_are_the_sources_with_rows_downward() -> None:
    """(3.11)-(3.12) count from 1 and give x; the row of an upward y is mirrored."""
    x, y = 3.0, 2.0
    u, v = LENS.to_pixels(np.array([x, y]))
    assert u + 1 == pytest.approx(4992 / 2 + 0.5 + (x + 0.112) / LENS.pitch[0], abs=1e-9)
    assert v + 1 == pytest.approx(3328 / 2 + 0.5 - (y - 0.087) / LENS.pitch[1], abs=1e-9)
    np.testing.assert_allclose(LENS.from_pixels(np.array([u, v])), [x, y], atol=1e-12)


def test_distortion_is_iterated_and_two_steps_serve_a_weak_lens() -> None:
    """ "Nur zwei Iterationen notwendig" for the source's lens: K1 and K2 only, a fifth of ours."""
    points = rng_points(200)
    np.testing.assert_allclose(LENS.ideal(LENS.measured(points)), points, atol=1e-12)
    weak = InteriorOrientation(50.0, LENS.pitch, LENS.size_px, radial=(9e-6, -6e-9, 0.0))
    error = weak.measured(points, iterations=2) - weak.measured(points)
    assert 1e-5 < np.abs(error).max() / LENS.pitch[0] < 0.05  # pixels: not exact, and of no account


def test_affinity_and_shear_are_the_camera_matrix() -> None:
    """Without a polynomial both models are linear and agree to rounding."""
    plain = InteriorOrientation(50.0, (0.0072, 0.0072), (4992, 3328), (0.1, 0.2), affinity=(3e-4, -2e-4))
    camera = plain.camera()
    assert plain.misfit_px(camera) < 1e-9  # 5000 px of double precision
    assert camera.K[0, 0] == pytest.approx(camera.K[1, 1] / 1.0003, rel=1e-12)
    assert camera.K[0, 1] == pytest.approx(-2e-4 * camera.K[0, 0], rel=1e-12)
    back = InteriorOrientation.of_camera(camera, plain.pitch)
    assert back.principal_distance == pytest.approx(50.0, rel=1e-12)
    assert back.affinity == pytest.approx(plain.affinity, rel=1e-9)
    assert back.principal_point == pytest.approx(plain.principal_point, abs=1e-9)
    np.testing.assert_allclose([*back.radial, *back.decentring], 0, atol=1e-15)


def test_camera_of_a_calibrated_lens() -> None:
    """The inverse of a polynomial is none; over the image the fitted one is good to a thousandth of the distortion."""
    weak = replace(LENS, radial=(9e-6, -6e-9, 0.0))
    assert weak.misfit_px(weak.camera()) < 0.01  # 10 px
    camera = LENS.camera()
    assert LENS.misfit_px(camera) < 0.05  # 47 px
    shift = np.linalg.norm(
        camera.project(np.array([0.36, 0.24, 1.0]))
        - Camera(camera.K, camera.size_px).project(np.array([0.36, 0.24, 1.0]))
    )
    assert shift > 30  # there is a distortion to describe
    uv = np.random.default_rng(2).uniform([0, 0], [4991, 3327], (500, 2))
    np.testing.assert_allclose(camera.normalise(uv), LENS.normalise(uv), atol=0.05 / 6900)


@pytest.mark.parametrize("pitch", [(1.0, 1.0), (0.0072, 0.0072)])
def test_there_and_back_in_pixels_and_in_millimetres(pitch: tuple[float, float]) -> None:
    K = np.array([[6930.0, 1.2, 2510.0], [0, 6933.0, 1650.0], [0, 0, 1.0]])
    camera = Camera(K, (4992, 3328), np.array([-0.09, 0.07, 3e-4, -2e-4, -0.01]))
    model = InteriorOrientation.of_camera(camera, pitch)
    assert model.misfit_px(camera) < 0.06  # 60 px of distortion, and the same share of it as above
    again = model.camera()
    np.testing.assert_allclose(again.K, camera.K, rtol=1e-12, atol=1e-9)
    uv = np.random.default_rng(2).uniform([0, 0], [4991, 3327], (500, 2))
    np.testing.assert_allclose(again.normalise(uv), camera.normalise(uv), atol=0.06 / 6933)


def test_signs_of_radial_and_decentring_terms() -> None:
    """K1 > 0 corrects outward, so the image is compressed: k1 < 0. P1 belongs to x, OpenCV's p2; P2 to y up, -p1."""
    camera = InteriorOrientation(1000.0, (1.0, 1.0), (801, 601), radial=(1e-8, 0, 0), decentring=(1e-7, 2e-7)).camera()
    k1, _, p1, p2, _ = camera.distortion
    # First order of the inverse: the fit of five terms to a sixth-order remainder moves the first by a few percent.
    assert k1 == pytest.approx(-1e-8 * 1000**2, rel=0.05)
    assert p2 == pytest.approx(-1e-7 * 1000, rel=0.05)
    assert p1 == pytest.approx(2e-7 * 1000, rel=0.05)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"principal_distance": 0.0}, "principal distance"),
        ({"pitch": (0.0072, -0.0072)}, "pitch"),
        ({"radial": (math.nan, 0.0, 0.0)}, "radial"),
        ({"affinity": (-1.0, 0.0)}, "B1"),
    ],
)
def test_refusals(change: dict[str, object], message: str) -> None:
    fields: dict[str, object] = {"principal_distance": 50.0, "pitch": (0.0072, 0.0072), "size_px": (4992, 3328)}
    with pytest.raises(ValueError, match=message):
        InteriorOrientation(**(fields | change))  # type: ignore[arg-type]  # each is wrong in one field


def test_a_lens_that_folds_has_no_photogrammetric_model() -> None:
    camera = Camera(np.array([[500.0, 0, 400], [0, 500, 300], [0, 0, 1]]), (801, 601), np.array([-1.5, 0, 0, 0, 0]))
    with pytest.raises(ValueError, match="folds"):
        InteriorOrientation.of_camera(camera)
