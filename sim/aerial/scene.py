"""The aerial world: a small spec, and everything that is built from it: ground, buildings, trees, vehicles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float, Int

from sim.aerial import buildings, trees, vehicles
from sim.aerial.ground import GroundPlan, PaintedGround
from sim.aerial.land_use import WALK_M, Bay, Land, Style, blocks, kinds, lay_out
from sim.aerial.library import Instances, Library, places
from sim.aerial.materials import Season, material
from sim.aerial.road_paint import bay_lines, road_paint
from sim.aerial.road_surface import RoadSurface, road_surface
from sim.aerial.sunlight import Sunlight
from sim.aerial.traffic_state import VehicleStates
from sim.aerial_traffic import Traffic
from sim.buildings_map import Footprint
from sim.meshes import VEHICLE_KINDS
from sim.meshes.shapes import SHAPES
from sim.overlap import overlapping
from sim.pose import rot_z
from sim.roads import RoadNetwork
from sim.streams import stream
from sim.terrain import Bounds, ElevationGrid

Array = np.ndarray
_SNOW = 0.75
SIGNAL_M = 0.9
"""Diameter of the signal of a control point."""
# Grass beside the pavement of a motorway.
_EMBANKMENT_M = 7.0
_OCCUPIED, _APART_M = 0.55, 0.1
_CARS = ("sedan", "hatchback", "estate", "van")


@dataclass(frozen=True, eq=False)
class AerialWorld:
    """What an aerial world is made from; the same spec gives the same world.

    ``bounds_m`` is what is furnished, and lies on the terrain. ``style`` says what stands on blocks between small
    streets; with ``footprints`` (of a map) these stand there instead. ``traffic`` drives
    on the roads; more cars stand in bays between them. ``signals`` (n, 2) [m] are white discs of `SIGNAL_M` on the
    ground.
    """

    terrain: ElevationGrid
    roads: RoadNetwork
    bounds_m: Bounds
    style: Style = "suburb"
    season: Season = "summer"
    sunlight: Sunlight = field(default_factory=Sunlight)
    footprints: tuple[Footprint, ...] | None = None
    traffic: Traffic | None = None
    signals: Float[Array, "n 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    seed: int = 0

    def __post_init__(self) -> None:
        x0, y0, x1, y1 = self.bounds_m
        if not (x1 > x0 and y1 > y0):
            raise ValueError(f"AerialWorld.bounds_m: expected x0 < x1 and y0 < y1, got {self.bounds_m}")
        if not self.terrain.contains(np.array([[x0, y0], [x1, y1]])).all():
            raise ValueError(
                f"AerialWorld.bounds_m: expected to lie on the terrain {self.terrain.bounds_m}, got {self.bounds_m}"
            )


@dataclass(frozen=True, eq=False)
class AerialScene:
    """A built world: painted ground, the library of models, what stands and what moves."""

    world: AerialWorld
    ground: PaintedGround
    library: Library
    standing: Instances
    footprints: tuple[Footprint, ...]
    parked: VehicleStates
    paint: Float[Array, "n 3"]

    def vehicles(self, t_s: float) -> VehicleStates:
        """Vehicles at a time: those of the traffic that are there, by their numbers, then those in bays."""
        traffic = self.world.traffic
        if traffic is None:
            return self.parked
        now = traffic.at(t_s)
        there = np.flatnonzero(now.present)
        return VehicleStates(
            there,
            kind_numbers(traffic.kind)[there],
            now.centre_m[there],
            np.arctan2(now.direction[there, 0], now.direction[there, 1]),
            now.speed_mps[there],
            traffic.size_m[there],
            self.paint[there],
        ).joined(self.parked)

    def placed(self, states: VehicleStates) -> Instances:
        """Vehicles on the ground, leaning with it; the kind's mesh scaled to the vehicle's size."""
        kind = states.kind
        typical = np.array([SHAPES[k].size_m for k in VEHICLE_KINDS])[kind]
        scale = states.size_m / typical
        up = self.world.terrain.normal(states.xy_m)
        ahead = np.stack([np.sin(states.heading), np.cos(states.heading), np.zeros(len(kind))], axis=-1)
        left = np.cross(up, ahead)
        left /= np.linalg.norm(left, axis=-1, keepdims=True)
        R = np.stack([np.cross(left, up), left, up], axis=-1)
        # The mesh begins behind its rear axle; the state is the vehicle's middle.
        overhang = np.array([SHAPES[k].rear_overhang_m for k in VEHICLE_KINDS])[kind]
        back = (overhang - typical[:, 0] / 2) * scale[:, 0]
        t = self.world.terrain.on_ground(states.xy_m) + back[:, None] * R[..., 0]
        return Instances(kind, places(R * scale[:, None, :], t), states.paint)


def kind_numbers(kinds: Sequence[str]) -> Int[Array, "n"]:
    """Indices into `sim.meshes.VEHICLE_KINDS`."""
    return np.array([VEHICLE_KINDS.index(k) for k in kinds], int)


def build(world: AerialWorld) -> AerialScene:
    """Everything of a world; pictures of the ground are painted when they are first seen."""
    rng = stream(world.seed, 0, "aerial/land use")
    land = Land(world.season)
    surface = _lay_out(world, land, rng)
    footprints = tuple(land.footprints if world.footprints is None else world.footprints)
    houses = shapely.STRtree([f.polygon for f in footprints])
    bays = _clear(land.bays, houses)
    signals = shapely.buffer(shapely.points(world.signals), SIGNAL_M / 2)
    plan = GroundPlan(
        base=material("grass", world.season),
        covers=tuple(land.covers),
        strips=surface.strips,
        wear=surface.wear,
        paint=(*surface.paint, *land.paint, *bay_lines(bays), *signals),
        snow=_SNOW if world.season == "winter" else 0.0,
    )
    ground = PaintedGround(plan, world.terrain.bounds_m, stream(world.seed, 0, "aerial/ground"))
    library, standing = _models(world, footprints, land)
    driving = () if world.traffic is None else world.traffic.kind
    paint = vehicles.draw_paints(driving, stream(world.seed, 0, "aerial/paint"))
    return AerialScene(
        world,
        ground,
        library,
        standing,
        footprints,
        _parked(world, np.concatenate([bays, _clear(land.drives, houses)]), len(driving)),
        paint,
    )


def _clear(bays: Sequence[Bay], houses: Any) -> Float[Array, "n 3"]:
    """Bays that no house touches."""
    rows = np.array(bays, float).reshape(-1, 3)
    hit = houses.query(shapely.points(rows[:, :2]), predicate="dwithin", distance=3.0)[0] if len(rows) else []
    return np.delete(rows, np.unique(np.asarray(hit, int)), axis=0)


def _parked(world: AerialWorld, bays: Float[Array, "n 3"], first: int) -> VehicleStates:
    """Cars in bays, some of them backed in, with numbers from ``first`` on."""
    rng = stream(world.seed, 0, "aerial/parked")
    bays = bays[(rng.random(len(bays)) < _OCCUPIED) & world.terrain.contains(bays[:, :2])]
    n = len(bays)
    kinds = [_CARS[k] for k in rng.integers(len(_CARS), size=n)]
    cars = VehicleStates(
        first + np.arange(n),
        kind_numbers(kinds),
        bays[:, :2] + rng.normal(0, 0.08, (n, 2)),
        bays[:, 2] + rng.normal(0, 0.02, n) + np.pi * (rng.random(n) < 0.4),
        np.zeros(n),
        np.array([SHAPES[k].size_m for k in kinds], float).reshape(-1, 3),
        vehicles.draw_paints(kinds, rng),
    )
    direction = np.stack([np.sin(cars.heading), np.cos(cars.heading)], axis=-1)
    touching = overlapping(cars.xy_m, direction, cars.size_m[:, :2] + _APART_M)[:, 1]
    return cars.of(np.setdiff1d(np.arange(n), touching))


def _lay_out(world: AerialWorld, land: Land, rng: np.random.Generator) -> RoadSurface:
    """Covers, houses and trees of all blocks; walks and kerbs along streets in the built-up area."""
    faces = blocks(world.roads, world.bounds_m)
    kind = kinds(faces, world.roads, world.style, world.bounds_m, rng)
    built = shapely.union_all([f for f, k in zip(faces, kind, strict=True) if k != "fields"]).buffer(12.0)
    surface = road_surface(world.roads, built, rng)
    land.paint += road_paint(world.roads, built, rng)
    fast = [
        shapely.LineString(r.line_m).buffer(r.width_m / 2 + _EMBANKMENT_M)
        for r in world.roads.edges
        if r.road_class <= 1
    ]
    embankment = shapely.union_all(fast)
    for face, k in zip(faces, kind, strict=True):
        near = shapely.intersection(surface.pavement, face.buffer(20.0))
        lay_out(land, k, face - near.buffer(WALK_M if k != "fields" else 1.5) - embankment, rng)
    walks = shapely.intersection(surface.pavement.buffer(WALK_M, quad_segs=4), built)
    for part in shapely.get_parts(walks - surface.pavement):
        land.cover(part, "paving")
    _street_trees(world, land, built, surface.pavement, rng)
    return surface


def _street_trees(world: AerialWorld, land: Land, built: Any, pavement: Any, rng: np.random.Generator) -> None:
    """Trees on the walks of wider streets."""
    share = {"inner_city": 0.55, "suburb": 0.25, "country": 0.0}[world.style]
    for road in world.roads.edges:
        if road.road_class < 2 or rng.random() > share:
            continue
        stations = np.arange(14.0, road.length_m - 14.0, rng.uniform(9.0, 15.0))
        p, d = road.at(stations)
        n = np.stack([-d[:, 1], d[:, 0]], axis=-1)
        for side in (1, -1):
            for x, y in p + side * (road.width_m / 2 + 1.3) * n + rng.normal(0, 0.4, p.shape):
                point = shapely.Point(x, y)
                if built.contains(point) and pavement.distance(point) > 0.5 and rng.random() < 0.8:
                    r = float(rng.uniform(1.8, 4.2))
                    land.trees.append((float(x), float(y), r, float(2.6 * r + 2)))


def _models(world: AerialWorld, footprints: tuple[Footprint, ...], land: Land) -> tuple[Library, Instances]:
    """Vehicles' meshes first, then crowns, then every building; and where trees and buildings stand."""
    rng = stream(world.seed, 0, "aerial/models")
    fleet, textures = vehicles.fleet()
    leaves, roofs = len(textures), len(textures) + 1
    crowns = trees.crowns(rng, leaves)
    houses = [
        buildings.build(f, world.terrain.height(f.outline_m), roofs, rng, world.season)
        for f in footprints
        if world.terrain.contains(f.outline_m).all()
    ]
    library = Library.of(
        [*fleet, *crowns, *(h.mesh for h in houses)],
        [*textures, trees.foliage(rng), *buildings.textures(rng, world.season)],
    )
    first = len(fleet) + len(crowns)
    n = len(houses)
    built = Instances(
        first + np.arange(n),
        places(np.broadcast_to(np.eye(3), (n, 3, 3)), np.array([h.at_m for h in houses]).reshape(-1, 3)),
        np.array([h.paint for h in houses], np.float32).reshape(-1, 3),
    )
    shapes = shapely.STRtree([f.polygon for f in footprints])
    wood = [_trees(world, w, len(fleet), coarse, shapes, rng) for w, coarse in ((land.trees, 0), (land.wood, 1))]
    return library, Instances.joined([built, *wood])


def _trees(
    world: AerialWorld, rows: list[tuple[float, float, float, float]], first: int, coarse: int, houses: Any,
    rng: np.random.Generator,
) -> Instances:  # fmt: skip
    """Trees as rows (x, y, radius, height), without those in houses."""
    t = np.array(rows, float).reshape(-1, 4)
    hit = houses.query(shapely.points(t[:, :2]), predicate="within")[0] if len(t) else np.zeros(0, int)
    t = np.delete(t, np.unique(hit), axis=0)
    t = t[world.terrain.contains(t[:, :2])]
    n = len(t)
    R = rot_z(rng.uniform(0, 2 * np.pi, n)) * np.stack([t[:, 2], t[:, 2], t[:, 3] / 2.2], axis=-1)[:, :, None]
    mesh = first + coarse * trees.SHAPES + rng.integers(trees.SHAPES, size=n)
    return Instances(mesh, places(R, world.terrain.on_ground(t[:, :2])), trees.paints(n, rng, world.season))


def footprint_bounds(points: Float[Array, "n d"], margin_m: float = 0.0) -> Bounds:
    """Bounds of points, as `AerialWorld` wants them."""
    (x0, y0), (x1, y1) = points[:, :2].min(axis=0) - margin_m, points[:, :2].max(axis=0) + margin_m
    return float(x0), float(y0), float(x1), float(y1)
