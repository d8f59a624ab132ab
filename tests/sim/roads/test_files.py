"""Road maps from files: every format gives the same network, tags and their defaults, and wrong files in one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pytest
import shapely
from pyproj import Transformer

from sim.geodesy import Georeference
from sim.map_files import MapError
from sim.roads import Road, RoadNetwork
from sim.roads.files import PARKING_M, read_roads, write_roads

from .osm_pbf import write_pbf

NODES = {1: (24.94, 60.17), 2: (24.943, 60.171), 3: (24.946, 60.172), 4: (24.943, 60.174), 5: (24.95, 60.173)}
WAYS: list[tuple[list[int], dict[str, str]]] = [
    ([1, 2, 3], {"highway": "primary", "lanes": "4", "name": 'Katu "1"'}),
    ([2, 4], {"highway": "residential"}),
    ([5, 3], {"highway": "tertiary", "oneway": "-1", "lanes": "2", "width": "6,5 m"}),
    ([1, 4], {"highway": "footway"}),
    ([4, 5], {"highway": "secondary", "tunnel": "yes"}),
]


def collection(crs: str | None = None, at: Any = lambda p: p) -> dict[str, Any]:
    features = [
        {
            "type": "Feature",
            "properties": tags,
            "geometry": {"type": "LineString", "coordinates": [list(at(NODES[n])) for n in refs]},
        }
        for refs, tags in WAYS
    ]
    head = {"crs": {"type": "name", "properties": {"name": crs}}} if crs else {}
    return {"type": "FeatureCollection", **head, "features": features}


def geojson(path: Path, crs: str | None = None, at: Any = lambda p: p) -> Path:
    path.write_text(json.dumps(collection(crs, at)))
    return path


def osm(path: Path) -> Path:
    nodes = "".join(f'<node id="{k}" lon="{p[0]}" lat="{p[1]}" version="1"/>' for k, p in NODES.items())
    ways = "".join(
        f'<way id="{k + 1}" version="1">'
        + "".join(f'<nd ref="{n}"/>' for n in refs)
        + "".join(f"<tag k={json.dumps(a)} v='{b}'/>" for a, b in tags.items())
        + "</way>"
        for k, (refs, tags) in enumerate(WAYS)
    )
    path.write_text(f'<?xml version="1.0"?><osm version="0.6">{nodes}{ways}</osm>')
    return path


def gpkg(path: Path, crs: str | None = "EPSG:4326", layer: str = "roads", **more: Any) -> Path:
    keys = sorted({k for _, tags in WAYS for k in tags})
    pyogrio.raw.write(
        path,
        shapely.to_wkb([shapely.LineString([NODES[n] for n in refs]) for refs, _ in WAYS]),
        [np.array([tags.get(k) for _, tags in WAYS], object) for k in keys],
        keys,
        geometry_type="LineString",
        crs=crs,
        driver="GPKG",
        layer=layer,
        **more,
    )
    return path


def pbf(path: Path) -> Path:
    write_pbf(path, NODES, WAYS)
    return path


def lines_of(network: RoadNetwork) -> dict[tuple[int, int, bool, str], Any]:
    return {(e.road_class, e.lanes, e.oneway, f"{e.name}{e.line_m[0, 0]:.0f}"): e.line_m for e in network.edges}


@pytest.mark.parametrize("source", ["a.geojson", "a.gpkg", "a.osm", "a.osm.pbf", "utm.geojson"])
def test_every_format_gives_the_same_network(tmp_path: Path, source: str) -> None:
    expected = read_roads(geojson(tmp_path / "reference.geojson"))
    to_utm34 = Transformer.from_crs(4326, 32634, always_xy=True)
    make = {
        "a.geojson": geojson,
        "a.gpkg": gpkg,
        "a.osm": osm,
        "a.osm.pbf": pbf,
        "utm.geojson": lambda p: geojson(p, "urn:ogc:def:crs:EPSG::32634", lambda q: to_utm34.transform(*q)),
    }[source]
    reading = read_roads(make(tmp_path / source))
    assert reading.georeference == expected.georeference
    assert reading.georeference.zone == 35
    found, wanted = lines_of(reading.network), lines_of(expected.network)
    assert found.keys() == wanted.keys()
    for key, line in wanted.items():
        np.testing.assert_allclose(found[key], line, atol=1e-3)
    left_out = {"without motor traffic": 1, "tunnel": 1}
    # GDAL's OpenStreetMap drivers, too, hand over every way with the key "highway".
    assert (reading.left_out, reading.assumed) == (left_out, {"lanes": 1, "width": 2})


def test_tags_become_roads(tmp_path: Path) -> None:
    reading = read_roads(geojson(tmp_path / "a.geojson"))
    net = reading.network
    assert len(net.edges) == 4
    assert sorted(net.degree) == [1, 1, 1, 2, 3]
    (one,) = [e for e in net.edges if e.oneway]
    start = reading.georeference.from_crs(np.array(NODES[3]))
    np.testing.assert_allclose(one.line_m[0], start, atol=1e-6)
    assert (one.road_class, one.lanes, one.width_m, one.parking_m) == (3, 2, 6.5, 0.0)
    (street,) = [e for e in net.edges if e.road_class == 4]
    assert (street.lanes, street.width_m, street.parking_m) == (2, 5.5 + 2 * PARKING_M, PARKING_M)
    main = [e for e in net.edges if e.road_class == 2]
    assert [(e.lanes, e.name, e.width_m) for e in main] == [(4, 'Katu "1"', 14.0)] * 2


@pytest.mark.parametrize(
    ("tags", "expected"),
    [
        ({"highway": "motorway", "lanes": "3"}, (0, 3, True, 14.5)),
        ({"highway": "motorway", "lanes": "two"}, (1, 2, True, 11.5)),
        ({"highway": "motorway_link"}, (3, 1, True, 4.0)),
        ({"highway": "tertiary", "junction": "roundabout"}, (3, 1, True, 4.0)),
        ({"highway": "tertiary", "junction": "roundabout", "oneway": "no", "lanes": "2;3"}, (3, 2, False, 7.5)),
        ({"highway": "service"}, (4, 1, False, 2.75)),
        ({"highway": "residential", "lanes": "2", "width": "3"}, (4, 1, False, 3.0)),
        ({"highway": "residential", "width": "wide"}, (4, 2, False, 9.5)),
        ({"highway": "residential", "width": "1.2"}, (4, 2, False, 9.5)),
    ],
)
def test_lanes_and_widths_have_defaults(tmp_path: Path, tags: dict[str, str], expected: tuple[Any, ...]) -> None:
    feature = {
        "type": "Feature",
        "properties": tags,
        "geometry": {"type": "LineString", "coordinates": [[9, 48], [9, 48.001]]},
    }
    path = tmp_path / "a.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    (e,) = read_roads(path).network.edges
    assert (e.road_class, e.lanes, e.oneway, e.width_m) == expected


def test_written_roads_read_the_same(tmp_path: Path) -> None:
    world = Georeference(32632, (690000.0, 5335000.0, 500.0))
    net = RoadNetwork.of(
        [
            Road.standard(np.array([[-100.0, 0], [0, 3], [120, 0]]), 2, 4, False, "Hauptstraße"),
            Road(np.array([[0.0, 3], [10, 90]]), 4, 1, True, 8.2, parking_m=2.1),
        ]
    )
    write_roads(net, world, tmp_path / "roads.geojson")
    again = read_roads(tmp_path / "roads.geojson", world)
    assert (again.left_out, again.assumed) == ({}, {})
    assert len(again.network.edges) == len(net.edges)
    for e in again.network.edges:
        (same,) = [f for f in net.edges if np.allclose(f.line_m[0], e.line_m[0], atol=1e-3) and f.name == e.name]
        np.testing.assert_allclose(e.line_m, same.line_m, atol=3e-4)
        for name in ("road_class", "lanes", "oneway", "width_m", "parking_m"):
            assert getattr(e, name) == getattr(same, name)


def test_files_that_cannot_be_used_are_named_in_one_line(tmp_path: Path) -> None:
    def fails(path: Path, match: str, **more: Any) -> None:
        with pytest.raises(MapError, match=match) as info:
            read_roads(path, **more)
        assert "\n" not in str(info.value)
        assert str(info.value).count(str(path)) == 1

    def text(name: str, content: str) -> Path:
        (tmp_path / name).write_text(content)
        return tmp_path / name

    empty = {"type": "FeatureCollection", "features": []}
    fails(tmp_path / "none.geojson", "no such file")
    for name in ("empty.geojson", "empty.gpkg", "empty.osm.pbf"):
        fails(text(name, ""), "not a readable map")
    fails(text("cut.geojson", json.dumps(collection())[:300]), "not a readable map")
    fails(text("nothing.geojson", json.dumps(empty)), "is empty: no lines among its 0 features")
    (tmp_path / "cut.osm.pbf").write_bytes(pbf(tmp_path / "good.osm.pbf").read_bytes()[:150])
    fails(tmp_path / "cut.osm.pbf", "not a readable map|is empty")
    with pytest.warns(UserWarning, match="'crs' was not provided"):
        nowhere = gpkg(tmp_path / "crs.gpkg", crs=None)
    fails(nowhere, "no coordinate system")
    two = gpkg(tmp_path / "two.gpkg")
    gpkg(two, layer="old roads", append=True)
    fails(two, "2 layers with lines among 'roads', 'old roads'")
    fails(two, "no layer 'x'; it has 'roads', 'old roads'", layer="x")
    assert len(read_roads(two, layer="old roads").network.edges) == 4
    metres = geojson(tmp_path / "metres.geojson", None, lambda p: (p[0] * 1e4, p[1] * 1e5))
    fails(metres, r"11 of 11 points, as \(249400, 6\.017e\+06\), do not exist in WGS 84")
    mixed = collection()
    mixed["features"][1]["geometry"]["coordinates"][0] = [386012.0, 6672117.0]
    fails(text("mixed.geojson", json.dumps(mixed)), "1 of 11 points.*must be stated and not be mixed")
    fails(geojson(tmp_path / "far.geojson"), "reach of UTM zone 32", georeference=Georeference(32632))
    plain = collection()
    for f in plain["features"]:
        f["properties"] = {"kind": 3}
    fails(text("tags.geojson", json.dumps(plain)), 'no feature has "highway" or "road_class"; their fields are kind')
    for f in plain["features"]:
        f["properties"] = {"highway": "path"}
    fails(
        text("paths.geojson", json.dumps(plain)), r"no road for motor traffic among 5 lines \(5 without motor traffic\)"
    )
    for f in plain["features"]:
        f["properties"] = {"road_class": 7, "lanes": 2}
    fails(text("class.geojson", json.dumps(plain)), r"expected 0 \(motorway\) to 4 \(local\), got 7")


@pytest.mark.shared_data
def test_the_roads_of_helsinki(shared_data: Path) -> None:
    reading = read_roads(shared_data / "roads" / "helsinki.geojson")
    assert (reading.georeference.zone, reading.georeference.is_north) == (35, True)
    assert reading.left_out == {"tunnel": 3}
    assert reading.assumed["width"] == 718  # 725 less 3 tunnels and 4 of stated width
    net = reading.network
    x0, y0, x1, y1 = net.bounds_m
    # 0.018 x 0.015 degrees at latitude 60.17.
    assert 1000 < x1 - x0 < 1100
    assert 1600 < y1 - y0 < 1700
    assert net.length_m == pytest.approx(21132, abs=1)
    assert {e.road_class for e in net.edges} == {2, 3, 4}
    assert len(net.cut(50.0).edges) > len(net.edges)
