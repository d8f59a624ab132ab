"""The calibration wall: photographs are exact to the camera model, boards hide each other, cameras look at it."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.aerial.interior_orientation import detect_board
from sim.calibration_wall import LENS, Wall, photograph, viewpoints
from sim.camera import Camera
from sim.pose import Pose
from sim.sensor import Sensor

Array = np.ndarray
# Affinity, shear and 7 px of distortion in the corners.
CAMERA = Camera(
    np.array([[1254.0, 0.8, 258.0], [0, 1250, 253], [0, 0, 1]]), (512, 512), np.array([-0.3, 0.4, 1e-3, -8e-4, 0.5])
)
PERFECT = Sensor(blur_px=0.7, vignetting=0.0, read_noise=0.0, shot_noise=0.0, grey=True)


def errors(wall: Wall, camera: Camera, T_wc: Pose, image: Array) -> list[Array]:
    """Deviations of every board's corners from where the camera projects them."""
    out = []
    for board in wall.boards:
        points, X = detect_board([image], board.pattern, 0.05)
        np.testing.assert_allclose(X + board.at_m, board.corners_m)
        out.append(points.uv - camera.project(T_wc.inv().apply(board.corners_m[points.point])))
    return out


@pytest.mark.parametrize("depth_m", [0.0, 0.5])
def test_corners_appear_where_the_camera_projects_them(depth_m: float) -> None:
    rng = np.random.default_rng(1)
    wall = Wall(depth_m)
    T_wc = viewpoints(3, 0.4, (4.0, 5.0), rng)
    found = [errors(wall, CAMERA, T_wc[k], photograph(wall, CAMERA, T_wc[k], rng, PERFECT, 3)) for k in range(3)]
    e = np.concatenate([e for image in found for e in image])
    assert len(e) > 200
    # What refining leaves without noise; in the mean it goes away.
    assert np.sqrt(np.mean(e**2)) < 0.03
    assert np.abs(e.mean(axis=0)).max() < 0.005


def test_a_board_in_front_hides_what_is_behind() -> None:
    """Seen from the right, the upper right board stands before the last column of corners of the upper left one."""
    centre, aim = np.array([2.2, -0.6, -3.5]), np.array([-0.3, -0.6, -0.2])
    z = (aim - centre) / np.linalg.norm(aim - centre)
    x = np.cross([0.0, 1.0, 0.0], z)
    T_wc = Pose(np.stack([x, np.cross(z, x), z], axis=1), centre)
    found = []
    for wall in (Wall(0.0), Wall(0.5)):
        image = photograph(wall, CAMERA, T_wc, np.random.default_rng(0), PERFECT, 3)
        points, _ = detect_board([image], wall.boards[0].pattern, 0.05)
        found.append(set(points.point.tolist()))
    last = set(range(5, 36, 6))
    assert last <= found[0]
    assert not last & found[1]
    # The column beside it has lost half of its markers.
    assert {k for k in range(36) if k % 6 < 4} <= found[1]


def test_cameras_look_at_the_wall_with_the_tilt_asked_for() -> None:
    T_wc = viewpoints(8, 0.35, (4.0, 6.0), np.random.default_rng(2), aside_m=0.2)
    axis = T_wc.R[..., 2]
    np.testing.assert_allclose(np.arccos(axis[:, 2]), 0.35)
    hit = T_wc.t - axis * (T_wc.t[:, 2] / axis[:, 2])[:, None]
    assert np.abs(hit[:, :2]).max() <= 0.2
    distance = np.linalg.norm(T_wc.t - hit, axis=1)
    assert ((distance >= 4.0) & (distance <= 6.0)).all()
    # Tilted to all sides, turned by all quarters.
    assert np.linalg.norm(axis[:, :2].mean(axis=0)) < 1e-9
    turn = np.round(np.arctan2(T_wc.R[:, 1, 0], T_wc.R[:, 0, 0]) / (np.pi / 2)).astype(int) % 4
    assert set(turn) == {0, 1, 2, 3}


def test_noise_is_the_sensor_s_and_follows_the_generator() -> None:
    T_wc = viewpoints(1, 0.2, (4.0, 5.0), np.random.default_rng(3))[0]
    one, again, other = (photograph(Wall(), CAMERA, T_wc, np.random.default_rng(s)) for s in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert 1.5 < np.std(one.astype(float) - other) / np.sqrt(2) < 3.0


def test_wrong_calls_are_refused() -> None:
    with pytest.raises(ValueError, match=r"Wall\.depth_m"):
        Wall(-0.1)
    T_wc = viewpoints(1, 0.2, (4.0, 5.0), np.random.default_rng(3))[0]
    with pytest.raises(ValueError, match="samples"):
        photograph(Wall(), CAMERA, T_wc, np.random.default_rng(1), LENS, 0)
    with pytest.raises(ValueError, match="grey"):
        photograph(Wall(), CAMERA, T_wc, np.random.default_rng(1), Sensor())
