"""Buildings from map files: outlines, courtyards, heights and their default."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from sim.buildings_map import DEFAULT_HEIGHT_M, STOREY_M, BuildingReading, read_buildings
from sim.geodesy import Georeference
from sim.map_files import MapError

WORLD = Georeference(32632, (690000.0, 5335000.0, 0.0))
BLOCK = [[0, 0], [0, 40], [60, 40], [60, 0], [0, 0]]
YARD = [[20, 10], [40, 10], [40, 30], [20, 30], [20, 10]]


def read(
    path: Path, *buildings: tuple[dict[str, Any], list[Any]], world: Georeference | None = WORLD
) -> BuildingReading:
    features = [
        {
            "type": "Feature",
            "properties": {"building": "yes", **tags},
            "geometry": {
                "type": "Polygon",
                "coordinates": [WORLD.to_crs(np.array(r, float)).tolist() for r in rings],
            },
        }
        for tags, rings in buildings
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return read_buildings(path, world)


def test_outlines_and_courtyards_are_oriented_and_in_the_world(tmp_path: Path) -> None:
    (block,) = read(tmp_path / "a.geojson", ({}, [BLOCK, YARD])).footprints
    assert block.outline_m.shape == (4, 2)
    assert shapely.LinearRing(block.outline_m).is_ccw
    assert not shapely.LinearRing(block.holes_m[0]).is_ccw
    assert block.polygon.area == pytest.approx(60 * 40 - 20 * 20, abs=0.01)
    np.testing.assert_allclose(block.outline_m.min(axis=0), 0, atol=1e-3)


@pytest.mark.parametrize(
    ("tags", "height", "stated"),
    [
        ({"height": "17.5 m"}, 17.5, True),
        ({"height": 8, "building:levels": "9"}, 8.0, True),
        ({"building:levels": "3.5"}, 3.5 * STOREY_M, True),
        ({"building_levels": 2}, 2 * STOREY_M, True),
        ({"building:levels": "many"}, DEFAULT_HEIGHT_M, False),
        ({"height": "0"}, DEFAULT_HEIGHT_M, False),
        ({}, DEFAULT_HEIGHT_M, False),
    ],
)
def test_heights_are_stated_or_default(tmp_path: Path, tags: dict[str, Any], height: float, stated: bool) -> None:
    reading = read(tmp_path / "a.geojson", (tags, [BLOCK]))
    (building,) = reading.footprints
    assert (building.height_m, building.stated) == (height, stated)
    assert reading.without_height == (not stated)


def test_polygons_that_cross_themselves_are_mended_and_specks_left_out(tmp_path: Path) -> None:
    bow = [[0, 0], [20, 20], [20, 0], [0, 20], [0, 0]]
    speck = [[0, 0], [1, 0], [1, 1], [0, 0]]
    reading = read(tmp_path / "a.geojson", ({}, [bow]), ({}, [speck]), ({}, [BLOCK]), world=None)
    assert (len(reading.footprints), reading.mended, reading.left_out) == (3, 1, 1)
    assert all(f.polygon.is_valid for f in reading.footprints)
    assert reading.georeference.zone == 32


def test_a_map_of_roads_holds_no_buildings(tmp_path: Path) -> None:
    line = {"type": "Feature", "properties": {}, "geometry": {"type": "LineString", "coordinates": [[9, 48], [9, 49]]}}
    path = tmp_path / "roads.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [line]}))
    with pytest.raises(MapError, match=r"roads\.geojson: no layer with polygons among 'roads'"):
        read_buildings(path)


@pytest.mark.shared_data
def test_the_buildings_of_helsinki(shared_data: Path) -> None:
    reading = read_buildings(shared_data / "roads" / "helsinki-buildings.geojson")
    assert reading.georeference.zone == 35
    assert len(reading.footprints) > 480
    assert 300 < reading.without_height < 330  # 323 of 486 features have no levels
    assert {f.height_m for f in reading.footprints if not f.stated} == {DEFAULT_HEIGHT_M}
    assert all(f.polygon.is_valid and f.polygon.area >= 4 for f in reading.footprints)
