"""Road networks from GeoJSON, GeoPackage and OpenStreetMap extracts, and to GeoJSON."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from sim.archive import write_text
from sim.geodesy import Georeference
from sim.map_files import MapError, number, read_features
from sim.roads.cross_section import section
from sim.roads.network import NARROWEST_LANE_M, Road, RoadNetwork, distinct

Array = np.ndarray

# OpenStreetMap's highway classes: class of the road map, lanes by default (two-way, oneway).
OSM_CLASSES: Mapping[str, tuple[int, int, int]] = {
    "motorway": (1, 4, 2),
    "trunk": (1, 4, 2),
    "primary": (2, 2, 1),
    "secondary": (3, 2, 1),
    "tertiary": (3, 2, 1),
    "unclassified": (4, 2, 1),
    "residential": (4, 2, 1),
    "living_street": (4, 1, 1),
    "service": (4, 1, 1),
    "road": (4, 2, 1),
    "motorway_link": (3, 2, 1),
    "trunk_link": (3, 2, 1),
    "primary_link": (3, 2, 1),
    "secondary_link": (3, 2, 1),
    "tertiary_link": (4, 2, 1),
}
# A motorway of three lanes or more a direction is an RQ 35.5.
_WIDE_MOTORWAY_LANES = 3
# Streets of these classes have parking strips at both kerbs unless a width is stated.
_WITH_PARKING, PARKING_M = ("residential", "unclassified", "living_street"), 2.0
_ONEWAY_BY_NATURE = ("motorway", "motorway_link")
# Underground: seen neither from above nor by the road mask. A passage through a building only hides below its roof.
_TUNNELS = ("yes", "culvert")


@dataclass(frozen=True, eq=False)
class RoadReading:
    """Roads of a file in the world frame; what was left out and what was assumed, counted in the file's features."""

    network: RoadNetwork
    georeference: Georeference
    left_out: Mapping[str, int]
    assumed: Mapping[str, int]


def read_roads(
    path: Path, georeference: Georeference | None = None, *, layer: str | None = None, height_m: float = 0.0
) -> RoadReading:
    """The road network of a map file (GeoJSON, GeoPackage, OpenStreetMap PBF or XML) of any coordinate system.

    Without ``georeference`` the UTM zone and the origin are chosen from the data, the origin at the ellipsoidal height
    ``height_m``. Features have OpenStreetMap's tags (highway, lanes, oneway, width, tunnel, junction, name) or those of
    `write_roads`. Missing or senseless lanes and widths become those of OSM_CLASSES and of the cross section, streets
    get parking strips of PARKING_M; each is counted. Pieces of one road are joined. Left out are ways without motor
    traffic and tunnels. Bridges lie on the ground, without a junction below them.

    Raises
        MapError: a file that cannot be read (see `read_features`), without road tags, or without any road.
    """
    features = read_features(path, "lines", layer)
    if not any("highway" in t or "road_class" in t for t in features.tags):
        found = sorted({k for t in features.tags for k in t})
        raise MapError(
            f'{path}: no feature has "highway" or "road_class"; their fields are {", ".join(found) or "none"}'
        )
    world = features.georeference(georeference, height_m)
    left_out: Counter[str] = Counter()
    assumed: Counter[str] = Counter()
    roads: list[Road] = []
    for geometry, tags in zip(features.in_world(world), features.tags, strict=True):
        reason = _unusable(tags)
        if reason:
            left_out[reason] += 1
            continue
        lines = [distinct(shapely.get_coordinates(part)) for part in shapely.get_parts(geometry)]
        usable = [line for line in lines if len(line) > 1]
        left_out["without length"] += not usable
        try:
            roads += [_road(line, tags, assumed if k == 0 else Counter()) for k, line in enumerate(usable)]
        except ValueError as e:
            raise MapError(f"{path}: {e}") from None
    if not roads:
        why = ", ".join(f"{n} {reason}" for reason, n in left_out.items() if n)
        raise MapError(f"{path}: no road for motor traffic among {len(features.tags)} lines ({why})")
    return RoadReading(RoadNetwork.of(roads).joined(), world, dict(+left_out), dict(+assumed))


def _unusable(tags: dict[str, Any]) -> str:
    if "road_class" in tags:
        return ""
    if tags.get("highway") not in OSM_CLASSES:
        return "without motor traffic"
    return "tunnel" if tags.get("tunnel") in _TUNNELS else ""


def _road(line: Array, tags: dict[str, Any], assumed: Counter[str]) -> Road:
    name = str(tags.get("name", ""))
    if "road_class" in tags:
        cls, count = number(tags["road_class"]), number(tags.get("lanes"))
        if cls is None or count is None or not cls.is_integer() or not count.is_integer():
            raise ValueError(f"road {name!r}: expected whole numbers road_class and lanes, got {tags}")
        parking = number(tags.get("parking_m")) or 0.0
        oneway = bool(tags.get("oneway", False))
        width = number(tags.get("width_m")) or section(int(cls)).paved_m(int(count)) + 2 * parking
        return Road(line, int(cls), int(count), oneway, width, name, parking)
    kind = str(tags["highway"])
    way = str(tags.get("oneway", "yes" if _implied_oneway(kind, tags) else "no")).lower()
    oneway = way in ("yes", "true", "1", "-1", "reverse")
    cls, *defaults = OSM_CLASSES[kind]
    lanes = _lanes(tags, assumed, defaults[oneway])
    if kind == "motorway" and lanes >= _WIDE_MOTORWAY_LANES * (1 if oneway else 2):
        cls = 0
    lanes, width, parking = _width(tags, assumed, cls, lanes, PARKING_M if kind in _WITH_PARKING else 0.0)
    return Road(line[::-1] if way in ("-1", "reverse") else line, cls, lanes, oneway, width, name, parking)


def _implied_oneway(kind: str, tags: dict[str, Any]) -> bool:
    return kind in _ONEWAY_BY_NATURE or tags.get("junction") in ("roundabout", "circular")


def _lanes(tags: dict[str, Any], assumed: Counter[str], default: int) -> int:
    lanes = number(tags.get("lanes"))
    if lanes is None or not lanes.is_integer() or not 1 <= lanes <= 12:
        assumed["lanes"] += 1
        return default
    return int(lanes)


def _width(
    tags: dict[str, Any], assumed: Counter[str], cls: int, lanes: int, parking: float
) -> tuple[int, float, float]:
    """(lanes, width, parking strips) [m]: a stated width holds as many of the lanes as fit, and no parking strips."""
    width = number(tags.get("width"))
    if width is None or not NARROWEST_LANE_M <= width <= 60:
        assumed["width"] += 1
        return lanes, section(cls).paved_m(lanes) + 2 * parking, parking
    fitting = min(lanes, int(width / NARROWEST_LANE_M + 1e-9))
    assumed["lanes"] += fitting < lanes
    return fitting, width, 0.0


def write_roads(network: RoadNetwork, georeference: Georeference, path: Path) -> None:
    """Edges as GeoJSON (RFC 7946: WGS 84, longitude first), coordinates to 1e-9 degrees (0.1 mm)."""
    features = [
        {
            "type": "Feature",
            "properties": {
                "road_class": e.road_class,
                "lanes": e.lanes,
                "oneway": e.oneway,
                "width_m": e.width_m,
                "parking_m": e.parking_m,
                "name": e.name,
            },
            "geometry": {
                "type": "LineString",
                "coordinates": np.round(georeference.to_crs(e.line_m), 9).tolist(),
            },
        }
        for e in network.edges
    ]
    write_text(Path(path), json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False))
