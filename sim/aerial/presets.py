"""Ready-made aerial worlds: the source's five data sets, a town beside a motorway, and any place of a map."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from sim.aerial.land_use import Style
from sim.aerial.materials import Season
from sim.aerial.scene import AerialWorld
from sim.aerial.sunlight import Sunlight
from sim.aerial_placement import TrafficSpec, place_traffic
from sim.buildings_map import DEFAULT_HEIGHT_M, read_buildings
from sim.geodesy import Georeference
from sim.roads import RoadNetwork
from sim.roads.files import read_roads
from sim.roads.motorway import mixed, motorway
from sim.roads.town import town
from sim.streams import stream
from sim.terrain import Bounds, ElevationGrid, plane, relief

Array = np.ndarray
# Land around the roads, and terrain around the land: oblique views see far.
_LAND_M, _TERRAIN_M = 500.0, 1500.0
_NODE_M = 30.0


def motorway_world(
    seed: int, *, jam: bool = False, season: Season = "summer", duration_s: float = 60.0, length_m: float = 3000.0
) -> AerialWorld:
    """A motorway of three lanes through fields; in a jam one carriageway is full (data sets 1 to 3 of chapter 5)."""
    roads = motorway(stream(seed, 0, "aerial/roads"), length_m=length_m)
    jammed = _one_carriageway(roads) if jam else frozenset()
    sun = Sunlight(azimuth_deg=165.0, elevation_deg=26.0, sky=0.42) if season == "winter" else Sunlight()
    spec = TrafficSpec(duration_s=duration_s, lorries=0.18, jammed=jammed)
    return _world(roads, seed, spec, style="country", season=season, sunlight=sun)


def inner_city_world(
    seed: int, *, low_sun: bool = False, duration_s: float = 60.0, size_m: tuple[float, float] = (900.0, 700.0)
) -> AerialWorld:
    """Closed blocks, street trees, parked cars and queues; high hazy or low clear sun (data sets 4 and 5)."""
    roads = town(stream(seed, 0, "aerial/roads"), size_m=size_m)
    sun = (
        Sunlight(azimuth_deg=245.0, elevation_deg=34.0, sky=0.20)
        if low_sun
        else Sunlight(azimuth_deg=170.0, elevation_deg=56.0, sky=0.32, visibility_m=25000.0)
    )
    spec = TrafficSpec(duration_s=duration_s, density=1.3, lorries=0.06, queues=0.35, parked=0.8)
    return _world(roads, seed, spec, style="inner_city", sunlight=sun, relief_m=1.5)


def town_world(
    seed: int,
    *,
    duration_s: float = 60.0,
    length_m: float = 3000.0,
    size_m: tuple[float, float] = (900.0, 700.0),
) -> AerialWorld:
    """A town of houses with gardens beside a motorway, hills of some metres."""
    roads = mixed(stream(seed, 0, "aerial/roads"), size_m=size_m, length_m=length_m)
    return _world(roads, seed, TrafficSpec(duration_s=duration_s), style="suburb")


PRESETS: Mapping[str, Callable[..., AerialWorld]] = {
    "motorway": motorway_world,
    "motorway-jam": partial(motorway_world, jam=True),
    "motorway-snow": partial(motorway_world, season="winter"),
    "inner-city-1": inner_city_world,
    "inner-city-2": partial(inner_city_world, low_sun=True),
    "flight-town": town_world,
}
"""Worlds by name; each is called with a seed, and takes ``duration_s``: so long vehicles keep apart and enter."""


def map_world(
    roads: Path,
    buildings: Path | None,
    seed: int,
    *,
    terrain: ElevationGrid | None = None,
    georeference: Georeference | None = None,
    duration_s: float = 60.0,
    default_height_m: float = DEFAULT_HEIGHT_M,
) -> tuple[AerialWorld, Georeference]:
    """The world of map files, in the UTM zone chosen from the roads unless ``georeference`` says another.

    Buildings without a height get ``default_height_m``; without ``terrain`` the land is level at z = 0.

    Raises
        MapError: a file that cannot be read.
    """
    reading = read_roads(roads, georeference)
    footprints = (
        None
        if buildings is None
        else read_buildings(buildings, reading.georeference, default_height_m=default_height_m).footprints
    )
    bounds = _wider(reading.network.bounds_m, 60.0)
    spec = TrafficSpec(duration_s=duration_s, lorries=0.06, queues=0.3, parked=0.7)
    world = AerialWorld(
        plane(_wider(bounds, _TERRAIN_M)) if terrain is None else terrain,
        reading.network,
        bounds,
        style="inner_city",
        footprints=footprints,
        traffic=place_traffic(reading.network, stream(seed, 0, "aerial/traffic"), spec),
        seed=seed,
    )
    return world, reading.georeference


def _world(
    roads: RoadNetwork,
    seed: int,
    spec: TrafficSpec,
    *,
    style: Style,
    season: Season = "summer",
    sunlight: Sunlight | None = None,
    relief_m: float = 5.0,
) -> AerialWorld:
    bounds = _wider(roads.bounds_m, _LAND_M)
    around = _wider(bounds, _TERRAIN_M)
    terrain = relief(around, _NODE_M, stream(seed, 0, "aerial/terrain"), rms_m=relief_m, wavelengths_m=(400.0, 2500.0))
    return AerialWorld(
        terrain,
        roads,
        bounds,
        style=style,
        season=season,
        sunlight=sunlight or Sunlight(),
        traffic=place_traffic(roads, stream(seed, 0, "aerial/traffic"), spec),
        seed=seed,
    )


def _wider(bounds: Bounds, margin_m: float) -> Bounds:
    x0, y0, x1, y1 = bounds
    return x0 - margin_m, y0 - margin_m, x1 + margin_m, y1 + margin_m


def _one_carriageway(roads: RoadNetwork) -> frozenset[int]:
    """Edges of the motorway that lead east."""
    return frozenset(k for k, r in enumerate(roads.edges) if r.road_class <= 1 and r.line_m[-1, 0] > r.line_m[0, 0])
