"""Interior orientation: Jacobian by differences, exact recovery, honest covariance, walls and images that do not do."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from estimators.aerial.interior_orientation import (
    NAMES,
    InteriorOrientation,
    calibrate,
    camera_of,
    detect_board,
    interior_jacobian,
    parameters,
)
from estimators.aerial.resection import ImagePoints
from estimators.estimate import EstimationFailed
from sim.camera import Camera
from sim.pose import Pose, exp_so3

Array = np.ndarray
SIZE = (1024, 1024)
TRUE = Camera(
    np.array([[2502.0, 1.5, 515.0], [0, 2498, 508], [0, 0, 1]]), SIZE, np.array([-0.12, 0.08, 4e-4, -3e-4, 0.05])
)
NOMINAL = Camera.simple(SIZE, 2300.0)


def wall(flat: bool, rng: np.random.Generator) -> Array:
    east, north = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9)))
    return np.column_stack([east, north, np.zeros(81) if flat else rng.uniform(0, 0.5, 81)])


def look(tilt: float, rng: np.random.Generator, distance: tuple[float, float] = (4.0, 7.0), images: int = 12) -> Pose:
    """Cameras before the wall, turned about their axes, tilted into any direction."""
    T_cw = []
    for _ in range(images):
        a, turn = rng.uniform(-np.pi, np.pi, 2)
        R = exp_so3(np.array([0, 0, turn])) @ exp_so3(tilt * np.array([np.cos(a), np.sin(a), 0]))
        T_cw.append(Pose(R, np.array([*rng.uniform(-0.2, 0.2, 2), rng.uniform(*distance)])))
    return Pose.stack(T_cw).inv()


def measure(T_wc: Pose, X: Array, rng: np.random.Generator, sigma_px: float) -> ImagePoints:
    T_cw = T_wc.inv()
    uv = TRUE.project(np.einsum("mij,nj->mni", T_cw.R, X) + T_cw.t[:, None])
    image, point = np.nonzero(TRUE.contains(uv))
    noise = rng.normal(0, sigma_px, (len(image), 2))
    return ImagePoints(image, point, uv[image, point] + noise, max(sigma_px, 0.05))


def calibrated(tilt: float, flat: bool, seed: int, sigma_px: float = 0.1) -> InteriorOrientation:
    rng = np.random.default_rng(seed)
    X, T_wc = wall(flat, rng), look(tilt, rng)
    result = calibrate(measure(T_wc, X, rng, sigma_px), X, NOMINAL)
    assert isinstance(result, InteriorOrientation), result
    return result


def test_jacobian_by_differences() -> None:
    rng = np.random.default_rng(0)
    p_c = np.column_stack([rng.uniform(-0.8, 0.8, (20, 2)), rng.uniform(4, 6, 20)])
    x, J = parameters(TRUE), interior_jacobian(TRUE, p_c)
    for i, step in enumerate([1e-2] * 5 + [1e-4] * 5):
        d = np.zeros(10)
        d[i] = step
        numeric = (camera_of(x + d, SIZE).project(p_c) - camera_of(x - d, SIZE).project(p_c)) / (2 * step)
        np.testing.assert_allclose(numeric, J[:, :, i], rtol=1e-7, atol=1e-7)


def test_parameters_and_back() -> None:
    again = camera_of(parameters(TRUE), SIZE)
    np.testing.assert_array_equal(again.K, TRUE.K)
    np.testing.assert_array_equal(again.distortion, TRUE.distortion)


@pytest.mark.parametrize("flat", [True, False])
def test_exact_points_give_the_exact_camera(flat: bool) -> None:
    result = calibrated(0.5, flat, 1, 0.0)
    np.testing.assert_allclose(result.x, parameters(TRUE), rtol=1e-6, atol=1e-7)
    assert np.abs(result.residuals).max() < 1e-7
    assert result.undetermined == ()


@pytest.mark.parametrize("flat", [True, False])
def test_covariance_is_honest(flat: bool) -> None:
    runs = 20
    results = [calibrated(0.5, flat, 100 + seed) for seed in range(runs)]
    nees = [(r.x - parameters(TRUE)) @ np.linalg.solve(r.cov, r.x - parameters(TRUE)) / 10 for r in results]
    assert abs(np.mean(nees) - 1) < 2.6 * np.sqrt(2 / (10 * runs))  # 99 %
    assert np.sqrt(np.mean([r.sigma_0**2 for r in results])) == pytest.approx(1, abs=0.03)
    assert np.diag(results[0].correlation) == pytest.approx(1)
    k2, k3 = NAMES.index("k2"), NAMES.index("k3")
    assert results[0].correlation[k2, k3] < -0.9  # as every calibration of Brown's model shows


def test_frontal_images_of_a_flat_wall_are_said_not_to_give_the_focal_length() -> None:
    result = calibrated(0.02, True, 3)
    assert "f" in result.undetermined
    assert calibrated(0.02, False, 3).undetermined == ()  # depth in the wall does
    rng = np.random.default_rng(4)
    X, T_wc = wall(True, rng), look(0.0, rng, (5.0, 5.1))
    failed = calibrate(measure(T_wc, X, rng, 0.1), X, NOMINAL)
    assert isinstance(failed, EstimationFailed)
    assert "do not determine" in failed.reason
    assert "tilt the camera" in failed.hints[0]


def test_images_with_few_points_take_no_part() -> None:
    rng = np.random.default_rng(5)
    X, T_wc = wall(False, rng), look(0.5, rng)
    points = measure(T_wc, X, rng, 0.1)
    result = calibrate(points.select((points.image != 3) | (points.point < 2)), X, NOMINAL)
    assert isinstance(result, InteriorOrientation)
    assert result.images == tuple(i for i in range(12) if i != 3)
    none = calibrate(points.select(points.point < 3), X, NOMINAL)
    assert isinstance(none, EstimationFailed)
    assert "no image shows 6 points" in none.reason


def test_a_photographed_board_gives_the_camera() -> None:
    squares, pixels = (9, 9), 90
    board = cv2.aruco.CharucoBoard(squares, 0.2, 0.15, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100))
    drawn = cv2.GaussianBlur(board.generateImage((9 * pixels, 9 * pixels)), (0, 0), 1.0)
    camera = Camera.simple(SIZE, 1500.0)
    rng = np.random.default_rng(6)
    T_wc = look(0.45, rng, (2.8, 3.4), 8)
    T_wc = Pose(T_wc.R, T_wc.t + np.array([0.9, 0.9, 0]))
    pictures = []
    for T_cw in (T_wc[i].inv() for i in range(8)):
        H = camera.K @ np.column_stack([T_cw.R[:, 0] * 0.2 / pixels, T_cw.R[:, 1] * 0.2 / pixels, T_cw.t])
        H = H @ np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # pixel centres at integers, the board from its corner
        pictures.append(cv2.warpPerspective(drawn, H, SIZE, flags=cv2.INTER_AREA, borderValue=255))
    points, X = detect_board(pictures, board, 0.1)
    assert len(points) > 0.7 * 8 * 64
    result = calibrate(points, X, NOMINAL)
    assert isinstance(result, InteriorOrientation)
    assert result.x[0] == pytest.approx(1500, abs=5 * result.sigma[0])
    assert result.x[3:5] == pytest.approx(511.5, abs=5 * result.sigma[3:5].max())
    blank, _ = detect_board([np.zeros((100, 100), np.uint8)], board, 0.1)
    assert len(blank) == 0
    assert isinstance(calibrate(blank, X, NOMINAL), EstimationFailed)
