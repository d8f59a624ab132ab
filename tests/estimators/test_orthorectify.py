"""Orthorectification: what was painted on the ground comes back at its place, whatever lies between."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from estimators.aerial.orthorectify import (
    METHODS,
    MapGrid,
    Method,
    Ortho,
    OrthoError,
    footprint,
    ground_points,
    ground_sampling,
    image_map,
    orthorectify,
    placed,
)
from sim.camera import Camera
from sim.pose import Pose, exp_so3
from sim.terrain import ElevationGrid, plane

Array = np.ndarray
CAMERA = Camera(
    np.array([[700.0, 0.4, 322], [0, 698, 236], [0, 0, 1]]), (640, 480), np.array([-0.08, 0.03, 4e-4, -3e-4, 0.0])
)
DOWN = np.diag([1.0, -1, -1])
T_WC = Pose(DOWN @ exp_so3(np.array([0.06, -0.04, 0.4])), np.array([12.0, -7, 540]))
MARKS = np.array([[-60.0, 30], [45, -70], [100, 60], [-20, -110], [10, 20]])
SIGMA_M, GSD_M = 2.0, 0.5


@pytest.fixture(scope="module")
def hills() -> ElevationGrid:
    rng = np.random.default_rng(3)
    relief = cv2.GaussianBlur(rng.standard_normal((41, 41)), (0, 0), 2)
    return ElevationGrid(30 + 8 * relief / relief.std(), (-600.0, -600.0), 30.0)


def painted(ground: Array) -> Array:
    """Grey value of the ground: a slow wave with bright round marks."""
    x, y = ground[..., 0], ground[..., 1]
    value = 100 + 40 * np.sin(x / 25) * np.cos(y / 30)
    for mark in MARKS:
        value = value + 100 * np.exp(-0.5 * ((x - mark[0]) ** 2 + (y - mark[1]) ** 2) / SIGMA_M**2)
    return np.asarray(value)


def taken(camera: Camera, terrain: ElevationGrid, T_wc: Pose = T_WC) -> Array:
    u, v = np.meshgrid(np.arange(camera.size_px[0], dtype=float), np.arange(camera.size_px[1], dtype=float))
    ground = ground_points(camera, T_wc, terrain, np.stack([u, v], axis=-1))
    return np.asarray(np.rint(painted(ground)), np.uint8)


def centroid(value: Array, at: Array) -> Array:
    """Of a mark over its surroundings within three sigma of a pixel [px]."""
    column, row = np.rint(at).astype(int)
    reach = int(3 * SIGMA_M / GSD_M)
    patch = value[row - reach : row + reach + 1, column - reach : column + reach + 1].astype(float)
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    w = np.clip(patch - np.percentile(patch, 60), 0, None)
    return np.array([column + np.sum(w * columns) / w.sum(), row + np.sum(w * rows) / w.sum()])


def misplaced(ortho: Ortho) -> Array:
    """Distances of the marks from where they are in a map painted directly [px]."""
    ideal = painted(ground_of(ortho.grid))
    marks = ortho.grid.pixels(MARKS)
    return np.array([np.linalg.norm(centroid(ortho.image[..., 0], m) - centroid(ideal, m)) for m in marks])


def ground_of(grid: MapGrid) -> Array:
    x, y = np.meshgrid(grid.x, grid.y)
    return np.stack([x, y], axis=-1)


@pytest.mark.parametrize("method", METHODS)
def test_check_points_lie_where_they_are(method: Method) -> None:
    """Over a plane, where all four are exact, without a lens; the forward one by whole pixels."""
    camera, ground = Camera(CAMERA.K, CAMERA.size_px), plane((-900, -900, 900, 900), 25.0, (0.03, -0.02))
    ortho = orthorectify(taken(camera, ground), camera, T_WC, ground, GSD_M, method)
    assert misplaced(ortho).max() < (0.25 if method == "forward" else 0.1)


@pytest.mark.parametrize("method", ["map", "exact"])
def test_hills_and_lens_are_taken_away(method: Method, hills: ElevationGrid) -> None:
    ortho = orthorectify(taken(CAMERA, hills), CAMERA, T_WC, hills, GSD_M, method)
    assert misplaced(ortho).max() < 0.1
    off = np.abs(ortho.image[..., 0] - painted(ground_of(ortho.grid)))[ortho.alpha > 0]
    assert np.percentile(off, 99) < 1.5


def test_anchor_points_miss_the_hills_and_the_lens(hills: ElevationGrid) -> None:
    ortho = orthorectify(taken(CAMERA, hills), CAMERA, T_WC, hills, GSD_M, "anchor")
    assert misplaced(ortho).max() > 1


def test_the_coarse_map_is_the_exact_one(hills: ElevationGrid) -> None:
    grid = MapGrid.around(footprint(CAMERA, T_WC, hills)[:, :2], GSD_M)
    fast, exact = (image_map(CAMERA, T_WC, hills, grid, m) for m in ("map", "exact"))
    np.testing.assert_array_equal(np.isnan(fast), np.isnan(exact))
    error = np.linalg.norm(fast - exact, axis=-1)[CAMERA.contains(exact)]
    assert np.percentile(error, 99) < 0.01
    assert error.max() < 0.06


def test_the_map_is_that_of_the_camera(hills: ElevationGrid) -> None:
    grid = MapGrid.around(footprint(CAMERA, T_WC, hills)[:, :2], 5.0)
    uv = CAMERA.project(T_WC.inv().apply(hills.on_ground(ground_of(grid))))
    inside = CAMERA.contains(uv)
    found = image_map(CAMERA, T_WC, hills, grid, "exact")
    assert inside.sum() > 1000
    np.testing.assert_allclose(found[inside], uv[inside], atol=1e-3)


def test_forward_projection_leaves_no_gaps(hills: ElevationGrid) -> None:
    forward, exact = (orthorectify(taken(CAMERA, hills), CAMERA, T_WC, hills, 0.8, m) for m in ("forward", "exact"))
    inner = cv2.erode(exact.alpha, np.ones((5, 5), np.uint8)) > 0
    assert (forward.alpha[inner] > 0).all()
    off = np.abs(forward.image[inner].astype(float) - exact.image[inner])
    assert np.percentile(off, 95) < 5


def test_alpha_is_where_the_image_is(hills: ElevationGrid) -> None:
    ortho = orthorectify(np.full((480, 640, 3), 200, np.uint8), CAMERA, T_WC, hills, GSD_M)
    uv = CAMERA.project(T_WC.inv().apply(hills.on_ground(ground_of(ortho.grid))))
    inside = CAMERA.contains(uv, 0.5)
    assert np.mean((ortho.alpha > 0) != inside) < 1e-3
    assert (ortho.image[ortho.alpha == 0] == 0).all()
    assert (ortho.image[inside & (ortho.alpha > 0)] == 200).all()


def test_grids_of_several_images_fit() -> None:
    a = MapGrid.around(np.array([[0.31, 0.7], [10.2, 5.5]]), 0.2)
    b = MapGrid.around(np.array([[3.33, 1.21], [14.0, 9.9]]), 0.2)
    shift = a.pixels(np.array([b.x_m, b.y_m]))
    np.testing.assert_allclose(shift, np.rint(shift), atol=1e-6)
    for grid, points in ((a, [[0.31, 0.7], [10.2, 5.5]]), (b, [[3.33, 1.21], [14.0, 9.9]])):
        at = grid.pixels(np.array(points))
        assert (at >= 0).all()
        assert (at <= [grid.columns - 1, grid.rows - 1]).all()


def test_ground_sampling_of_argos() -> None:
    assert ground_sampling(1400, Camera.simple((4992, 3328), 6933)) == pytest.approx(0.2019, abs=1e-4)


def test_the_horizon_and_the_end_of_the_terrain_are_refused(hills: ElevationGrid) -> None:
    image = np.zeros((480, 640), np.uint8)
    level = Pose(DOWN @ exp_so3(np.array([1.5, 0, 0])), T_WC.t)
    with pytest.raises(OrthoError, match="horizon"):
        orthorectify(image, CAMERA, level, hills)
    far = Pose(T_WC.R, T_WC.t + np.array([500.0, 0, 0]))
    with pytest.raises(OrthoError, match="no ground under"):
        orthorectify(image, CAMERA, far, hills)
    with pytest.raises(OrthoError, match=r"expected \(640, 480\)"):
        orthorectify(image[:-1], CAMERA, T_WC, hills)


DOTS = np.array([[60.0, 70], [320, 240], [585.4, 60.7], [100.3, 430.2], [570, 420]])


@pytest.mark.parametrize("method", METHODS)
def test_a_mark_in_the_image_lands_where_the_method_puts_its_pixel(method: Method, hills: ElevationGrid) -> None:
    u, v = np.meshgrid(np.arange(640), np.arange(480))
    image = np.full((480, 640), 20, np.uint8)
    for dot in DOTS:
        image += np.rint(200 * np.exp(-((u - dot[0]) ** 2 + (v - dot[1]) ** 2) / (2 * 1.5**2))).astype(np.uint8)
    ortho = orthorectify(image, CAMERA, T_WC, hills, GSD_M, method)
    at = ortho.grid.pixels(placed(CAMERA, T_WC, hills, DOTS, method, ortho.grid))
    found = []
    for column, row in np.rint(at).astype(int):
        patch = ortho.image[row - 10 : row + 11, column - 10 : column + 11, 0].astype(float)
        w = np.clip(patch - 25, 0, None)
        rows, columns = np.mgrid[-10:11, -10:11]
        found.append([column + np.sum(w * columns) / w.sum(), row + np.sum(w * rows) / w.sum()])
    # A whole pixel may be moved by half of one; the middle of a mark of many pixels is not.
    np.testing.assert_allclose(found, at, atol=0.5 if method == "forward" else 0.1)


def test_methods_put_pixels_at_true_places_or_not(hills: ElevationGrid) -> None:
    grid = MapGrid.around(footprint(CAMERA, T_WC, hills)[:, :2], GSD_M)
    uv = np.random.default_rng(2).uniform([5, 5], [634, 474], (500, 2))
    true = ground_points(CAMERA, T_WC, hills, uv)[:, :2]
    off = {m: np.linalg.norm(placed(CAMERA, T_WC, hills, uv, m, grid) - true, axis=1) / GSD_M for m in METHODS}
    assert off["exact"].max() == 0
    assert 1e-4 < off["map"].max() < 0.06
    # Uniform within half a pixel of both axes: RMS sqrt(1/6); 500 draws give it to 3 %.
    assert np.sqrt(np.mean(off["forward"] ** 2)) == pytest.approx(np.sqrt(1 / 6), rel=0.08)
    assert off["anchor"].max() > 3


def test_nothing_is_placed_outside_the_map(hills: ElevationGrid) -> None:
    whole = MapGrid.around(footprint(CAMERA, T_WC, hills)[:, :2], GSD_M)
    west = MapGrid(whole.x_m, whole.y_m, GSD_M, whole.columns // 2, whole.rows)
    uv = np.array([[320.0, 20], [320, 460], [30, 240], [610, 240]])
    at = {m: np.isfinite(placed(CAMERA, T_WC, hills, uv, m, whole)).all() for m in METHODS}
    assert all(at.values())
    true = ground_points(CAMERA, T_WC, hills, uv)[:, 0]
    for method in ("exact", "map", "forward"):
        found = placed(CAMERA, T_WC, hills, uv, method, west)
        np.testing.assert_array_equal(np.isfinite(found[:, 0]), true < west.x[-1] + GSD_M / 2)
