"""Road masks cover roads with their RAS-Q width, in maps and in images, and nothing far from them."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.aerial.orthorectify import MapGrid, OrthoError, ground_points, orthorectify
from estimators.aerial.road_mask import mask_of_image, mask_of_ortho, roads_near
from sim.camera import Camera
from sim.pose import Pose, exp_so3
from sim.roads import Road, RoadNetwork
from sim.terrain import plane

Array = np.ndarray
CAMERA = Camera(np.array([[700.0, 0, 320], [0, 700, 240], [0, 0, 1]]), (640, 480), np.array([-0.08, 0.03, 0, 0, 0]))
T_WC = Pose(np.diag([1.0, -1, -1]) @ exp_so3(np.array([0.05, -0.03, 0.3])), np.array([10.0, 5, 520]))
GROUND = plane((-2000, -2000, 2000, 2000), 20.0, (0.04, 0.02))
GRID = MapGrid(-100.0, 100.0, 0.5, 401, 401)
LOCAL = Road.standard(np.array([[-90.0, -80], [0, 0], [95, 40]]), 4, 2, False, "local")
MAIN = Road.standard(np.array([[-95.0, 30], [95, -30]]), 2, 4, False, "main")


def distance(xy: Array, road: Road) -> Array:
    """From points (..., 2) to the line of a road [m]."""
    best = np.full(xy.shape[:-1], np.inf)
    for a, b in zip(road.line_m, road.line_m[1:], strict=False):
        s = np.clip(((xy - a) @ (b - a)) / np.sum((b - a) ** 2), 0, 1)
        best = np.minimum(best, np.linalg.norm(xy - a - s[..., None] * (b - a), axis=-1))
    return best


def test_the_mask_of_a_map_is_as_wide_as_the_road() -> None:
    found = mask_of_ortho(RoadNetwork.of([LOCAL]), GRID)
    xy = np.stack(np.meshgrid(GRID.x, GRID.y), axis=-1)
    off = distance(xy, LOCAL) - (7.5 + 3.0) / 2
    assert (found.mask[off < -0.5] == 255).all()
    assert (found.mask[off > 0.5] == 0).all()
    wider = mask_of_ortho(RoadNetwork.of([LOCAL]), GRID, widening_m=4.0)
    assert (wider.mask[off < 1.5] == 255).all()
    assert (wider.mask[off > 2.5] == 0).all()


def test_the_mask_of_an_image_is_that_of_its_ortho() -> None:
    network = RoadNetwork.of([LOCAL, MAIN])
    seen = mask_of_image(network, CAMERA, T_WC, GROUND)
    as_map = orthorectify(seen.mask, CAMERA, T_WC, GROUND, grid=GRID, method="exact")
    drawn = mask_of_ortho(network, GRID)
    inside = as_map.alpha > 0
    assert inside.mean() > 0.99
    differing = (as_map.image[..., 0] > 127) != (drawn.mask > 0)
    assert differing[inside].mean() < 0.01


def test_the_more_important_road_is_meant_where_two_meet() -> None:
    found = mask_of_ortho(RoadNetwork.of([MAIN, LOCAL]), GRID)
    column, row = np.rint(GRID.pixels(np.zeros(2))).astype(int)
    assert found.roads[found.edge[row, column]].name == "main"
    assert {found.roads[k].name for k in np.unique(found.edge) if k >= 0} == {"main", "local"}
    np.testing.assert_array_equal(found.mask > 0, found.edge >= 0)


def test_a_ring_road_leaves_its_middle_free() -> None:
    angle = np.linspace(0, 2 * np.pi, 41)
    ring = Road.standard(60 * np.stack([np.cos(angle), np.sin(angle)], axis=1), 4, 2, False)
    found = mask_of_ortho(RoadNetwork.of([ring]), GRID)
    radius = np.hypot(*np.meshgrid(GRID.x, GRID.y))
    assert (found.mask[np.abs(radius - 60) < 4] == 255).all()
    assert (found.mask[np.abs(radius - 60) > 7] == 0).all()


def test_edges_are_cut_and_chosen_by_their_middle() -> None:
    long = Road.standard(np.array([[0.0, 0], [2000, 0]]), 0, 3, True)
    corners = np.array([[-50.0, -50], [50, -50], [50, 50], [-50, 50]])
    near = roads_near(RoadNetwork.of([long]), corners)
    assert len(near) == 1
    assert near[0].length_m == pytest.approx(400)
    assert roads_near(RoadNetwork.of([]), corners) == ()


def test_no_ground_is_said() -> None:
    level = Pose(T_WC.R @ exp_so3(np.array([1.4, 0, 0])), T_WC.t)
    with pytest.raises(OrthoError, match="horizon"):
        mask_of_image(RoadNetwork.of([LOCAL]), CAMERA, level, GROUND)


def test_the_edge_of_a_pixel_is_the_road_below_it() -> None:
    network = RoadNetwork.of([LOCAL, MAIN])
    seen = mask_of_image(network, CAMERA, T_WC, GROUND)
    rows, columns = np.nonzero(seen.edge >= 0)
    chosen = np.random.default_rng(1).choice(len(rows), 300, replace=False)
    uv = np.stack([columns[chosen], rows[chosen]], axis=1).astype(float)
    ground = ground_points(CAMERA, T_WC, GROUND, uv)[:, :2]
    for xy, k in zip(ground, seen.edge[rows[chosen], columns[chosen]], strict=True):
        assert distance(xy, seen.roads[k]) < seen.roads[k].map_width_m / 2 + 1
