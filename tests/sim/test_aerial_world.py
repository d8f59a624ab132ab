"""Worlds from specs: the same twice, nothing inside anything else, paint where the roads' markings are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from sim.aerial import AerialScene, AerialWorld, Sunlight, build, measure, render
from sim.aerial.ground import PIXEL_M, TILE_PX
from sim.aerial.presets import PRESETS, map_world, motorway_world, town_world
from sim.aerial.traffic_state import VehicleStates
from sim.camera import Camera
from sim.meshes import VEHICLE_KINDS
from sim.overlap import overlapping
from sim.pose import Pose, exp_so3
from sim.roads import RoadNetwork, markings
from sim.terrain import plane

Array = np.ndarray
CAMERA = Camera.simple((320, 240), 2000.0)


@pytest.fixture(scope="module")
def town() -> AerialScene:
    return build(town_world(3, length_m=1400.0, size_m=(450.0, 450.0), duration_s=4.0))


def above(scene: AerialScene, xy: Array, height_m: float = 300.0) -> Pose:
    ground = scene.world.terrain.on_ground(xy)
    return Pose(np.diag([1.0, -1, -1]), ground + np.array([0, 0, height_m]))


def junction(scene: AerialScene) -> Array:
    roads = scene.world.roads
    return np.asarray(roads.nodes_m[np.argmax(roads.degree)])


def test_the_same_spec_gives_the_same_picture_and_another_seed_another(town: AerialScene) -> None:
    T_wc = above(town, junction(town))
    image = render(town, CAMERA, T_wc, 1.0)
    again = build(town_world(3, length_m=1400.0, size_m=(450.0, 450.0), duration_s=4.0))
    np.testing.assert_array_equal(image, render(again, CAMERA, T_wc, 1.0))
    other = build(replace(town.world, seed=4))
    assert np.mean(render(other, CAMERA, T_wc, 1.0) != image) > 0.5


def boxes(v: VehicleStates) -> tuple[Array, Array, Array]:
    return v.xy_m, np.stack([np.sin(v.heading), np.cos(v.heading)], axis=-1), v.size_m[:, :2]


@pytest.mark.parametrize("t_s", [0.0, 2.0, 4.0])
def test_no_vehicles_intersect(town: AerialScene, t_s: float) -> None:
    states = town.vehicles(t_s)
    assert len(states) > 100
    assert len(np.unique(states.number)) == len(states)
    assert not len(overlapping(*boxes(states)))


def test_vehicles_have_their_size_and_stand_on_the_ground(town: AerialScene) -> None:
    states = town.vehicles(0.0).of(np.arange(30))
    placed, library = town.placed(states), town.library
    up = town.world.terrain.normal(states.xy_m)
    for k in range(30):
        m = placed.mesh[k]
        R, t = placed.place[k, :9].reshape(3, 3), placed.place[k, 9:]
        p = library.vertices[library.vertex_first[m] : library.vertex_first[m + 1]] @ R.T + t
        ahead = R[:, 0] / np.linalg.norm(R[:, 0])
        ground = town.world.terrain.on_ground(states.xy_m[k])
        along, over = (p - ground) @ ahead, (p - ground) @ up[k]
        # The coarse mesh's rounded ends: 1 % of the length; wheels with eight corners end above the ground.
        np.testing.assert_allclose([-along.min(), along.max()], states.size_m[k, 0] / 2, rtol=0.02)
        assert over.max() == pytest.approx(states.size_m[k, 2], rel=0.03)
        assert -0.01 < over.min() < 0.08
        assert np.arctan2(ahead[0], ahead[1]) == pytest.approx(states.heading[k] % (2 * np.pi), abs=0.02) or (
            np.arctan2(ahead[0], ahead[1]) % (2 * np.pi) == pytest.approx(states.heading[k] % (2 * np.pi), abs=0.02)
        )


def test_houses_and_trees_keep_off_the_roads_and_each_other(town: AerialScene) -> None:
    houses = shapely.STRtree([f.polygon for f in town.footprints])
    assert len(town.footprints) > 40
    pavement = shapely.union_all([shapely.LineString(r.line_m).buffer(r.width_m / 2) for r in town.world.roads.edges])
    assert not any(f.polygon.intersects(pavement) for f in town.footprints)
    i, j = houses.query([f.polygon.buffer(-0.02) for f in town.footprints], predicate="intersects")
    assert (i == j).all()
    trunks = town.standing.place[len(town.footprints) :, 9:11]
    assert len(trunks) > 500
    assert not len(houses.query(shapely.points(trunks), predicate="within")[0])
    cars = town.parked
    assert not len(houses.query(shapely.points(cars.xy_m), predicate="dwithin", distance=1.5)[0])


def test_neighbouring_tiles_agree_where_they_overlap(town: AerialScene) -> None:
    row, column = town.ground.rows // 2, town.ground.columns // 2
    middle, east, north = (town.ground.paint(row + a, column + b) for a, b in ((0, 0), (0, 1), (1, 0)))
    border = len(middle) - TILE_PX
    # Blurred tracks and fixed-point corners differ by a few values within pixels of the border.
    assert np.abs(middle[:, -border:].astype(int) - east[:, :border]).mean() < 2.0
    assert np.abs(middle[-border:].astype(int) - north[:border]).mean() < 2.0


def test_a_coarser_level_shows_the_same_ground(town: AerialScene) -> None:
    grid = town.ground.grid(0)
    column, row = (int(v) for v in (junction(town) - grid[:2]) // (PIXEL_M * TILE_PX))
    fine = town.ground.paint(row, column).astype(float)
    for level in (1, 2):
        coarse = town.ground.paint(row, column, level).astype(float)
        n = len(fine) >> level
        averaged = fine.reshape(n, 2**level, n, 2**level, 3).mean(axis=(1, 3))
        assert coarse.shape == averaged.shape
        # Edges of covers and joints of the asphalt are one coarse pixel, grain is averaged.
        assert np.median(np.abs(coarse - averaged)) < 2.5
        assert abs(np.mean(coarse - averaged)) < 1.0


def test_the_horizon_may_be_in_the_image(town: AerialScene) -> None:
    level = above(town, junction(town), 200.0)
    T_wc = Pose(level.R @ exp_so3(np.array([np.deg2rad(83.0), 0.0, 0.0])), level.t)
    truth = measure(town, CAMERA, T_wc)
    nothing = truth.instance == -2
    assert 0.2 < nothing.mean() < 0.8
    np.testing.assert_array_equal(nothing, np.isnan(truth.depth))
    image = render(town, CAMERA, T_wc)
    assert np.ptp(image[nothing].astype(int), axis=0).max() <= 1


def test_markings_are_painted_where_they_are(town: AerialScene) -> None:
    """White strokes are lighter than the asphalt half a metre beside them."""
    long = [m for m in markings(town.world.roads) if m.kind in ("lane", "centre")]
    grid, found = town.ground.grid(0), []
    tiles: dict[tuple[int, int], Array] = {}
    for m in long[:: max(len(long) // 40, 1)]:
        p, q = m.line_m[:2]
        middle, n = (p + q) / 2, np.array([p[1] - q[1], q[0] - p[0]]) / np.hypot(*(q - p))
        values = []
        for at in (middle, middle + 0.5 * n, middle - 0.5 * n):
            pixel = (at - grid[:2]) / PIXEL_M
            column, row = (int(v) for v in pixel // TILE_PX)
            if (row, column) not in tiles:
                tiles[row, column] = town.ground.paint(row, column)
            tile = tiles[row, column]
            j, i = (int(v % TILE_PX) + (len(tile) - TILE_PX) // 2 for v in pixel)
            values.append(float(tile[i, j].mean()))
        found.append(values[0] - max(values[1:]))
    assert np.mean(np.array(found) > 20) > 0.85


def test_snow_is_light_and_a_jam_is_full() -> None:
    free, jam = (motorway_world(1, jam=jam, duration_s=1.0, length_m=1500.0) for jam in (False, True))
    summer, winter = (build(replace(free, season=s)) for s in ("summer", "winter"))
    centre = free.roads.edges[0].at(np.array(300.0))[0]
    T_wc = above(summer, centre)
    assert render(winter, CAMERA, T_wc).mean() > 1.4 * render(summer, CAMERA, T_wc).mean()
    assert len(build(jam).vehicles(0.0)) > 4 * len(summer.vehicles(0.0))


def test_every_preset_makes_a_world_with_roads_and_traffic() -> None:
    assert set(PRESETS) >= {"motorway", "motorway-jam", "motorway-snow", "inner-city-1", "inner-city-2", "flight-town"}
    world = PRESETS["inner-city-2"](2)
    assert world.roads.edges
    assert world.traffic is not None
    assert len(world.traffic) > 200


@pytest.mark.shared_data
def test_a_map_becomes_a_world(shared_data: Path) -> None:
    folder = shared_data / "roads"
    world, georeference = map_world(
        folder / "helsinki.geojson", folder / "helsinki-buildings.geojson", 1, duration_s=1.0
    )
    scene = build(world)
    assert georeference.epsg == 32635
    assert len(scene.footprints) > 300
    xy = np.mean([f.outline_m.mean(axis=0) for f in scene.footprints], axis=0)
    truth = measure(scene, CAMERA, above(scene, xy, 900.0))
    assert np.mean(truth.instance == -3) > 0.2
    assert set(VEHICLE_KINDS) >= {VEHICLE_KINDS[k] for k in truth.vehicles.states.kind}


def test_wrong_worlds_are_refused() -> None:
    terrain, roads = plane((-10.0, -10.0, 10.0, 10.0)), RoadNetwork.of([])
    with pytest.raises(ValueError, match="on the terrain"):
        AerialWorld(terrain, roads, (-20.0, -5.0, 5.0, 5.0))
    with pytest.raises(ValueError, match="x0 < x1"):
        AerialWorld(terrain, roads, (5.0, -5.0, -5.0, 5.0))
    with pytest.raises(ValueError, match="elevation_deg"):
        Sunlight(elevation_deg=2.0)
    with pytest.raises(ValueError, match="sky"):
        Sunlight(sky=0.0)
