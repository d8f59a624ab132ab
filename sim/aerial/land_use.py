"""What lies between the roads: built-up blocks, parks, fields, woods, water; houses and trees on them."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import shapely
import shapely.affinity
import shapely.ops

from sim.aerial.materials import Material, Season, field_names, material
from sim.buildings_map import Footprint
from sim.roads import RoadNetwork

Array = np.ndarray
Style = Literal["country", "suburb", "inner_city"]
Block = Literal["fields", "suburb", "inner_city", "park", "commerce"]
_LARGEST_BUILT_M2 = 45000.0
_FIELD_M2 = 30000.0
WALK_M = 2.6
# Rows of bays stand so far apart that vans nose to nose do not touch.
_ROW_M = 5.5
Bay = tuple[float, float, float]
"""A parking bay: x, y of its middle [m] and the heading [rad] of who drives in."""


@dataclass
class Land:
    """What has been laid out so far: covers, footprints, and trees (x, y, radius, height) near and in woods,
    and where cars stand in drives and in marked bays."""

    season: Season
    covers: list[tuple[Any, Material]] = field(default_factory=list)
    footprints: list[Footprint] = field(default_factory=list)
    trees: list[tuple[float, float, float, float]] = field(default_factory=list)
    wood: list[tuple[float, float, float, float]] = field(default_factory=list)
    paint: list[Any] = field(default_factory=list)
    drives: list[Bay] = field(default_factory=list)
    bays: list[Bay] = field(default_factory=list)

    def cover(self, shape: Any, name: str, rng: np.random.Generator | None = None) -> None:
        if not shape.is_empty:
            self.covers.append((shape, material(name, self.season, rng)))


def blocks(network: RoadNetwork, bounds_m: tuple[float, float, float, float]) -> list[Any]:
    """Faces between the roads' middle lines and the bounds."""
    box = shapely.box(*bounds_m)
    lines = [shapely.LineString(r.line_m) for r in network.edges]
    whole = shapely.union_all([*lines, box.boundary])
    return [p for p in shapely.get_parts(shapely.polygonize([whole])) if box.contains(p.representative_point())]


def kinds(
    faces: list[Any], network: RoadNetwork, style: Style, bounds_m: tuple[float, float, float, float],
    rng: np.random.Generator,
) -> list[Block]:  # fmt: skip
    """What is built on every face: towns lie between small streets, and nothing is built along a motorway.

    What is too large for a block is a park where the town surrounds it, and land where it reaches the bounds.
    """
    rim = shapely.box(*bounds_m).boundary
    fast = [shapely.LineString(r.line_m) for r in network.edges if r.road_class <= 1]
    motorway = shapely.union_all(fast).buffer(30.0) if fast else shapely.Polygon()
    local = [shapely.LineString(r.line_m) for r in network.edges if r.road_class >= 2 and "exit" not in r.name]
    streets = shapely.union_all(local).buffer(5.0) if local else shapely.Polygon()
    out: list[Block] = []
    for face in faces:
        along = shapely.intersection(face.boundary, streets).length / face.boundary.length
        if style == "country" or rim.distance(face) < 1.0 or motorway.intersects(face):
            out.append("fields")
        elif face.area > _LARGEST_BUILT_M2 or along < 0.8 or rng.random() < 0.07:
            out.append("park")
        elif rng.random() < (0.10 if style == "suburb" else 0.05):
            out.append("commerce")
        else:
            out.append("suburb" if style == "suburb" else "inner_city")
    return out


def lay_out(land: Land, kind: Block, parcel: Any, rng: np.random.Generator) -> None:
    """Fills a parcel: what a block leaves beside pavement and walks."""
    for part in shapely.get_parts(parcel):
        if part.geom_type != "Polygon" or part.area < 80:
            continue
        if kind == "fields":
            _fields(land, part, rng)
        elif kind == "suburb":
            _suburb(land, part, rng)
        elif kind == "inner_city":
            _perimeter(land, part, rng)
        elif kind == "park":
            _park(land, part, rng)
        else:
            _commerce(land, part, rng)


def _pieces(shape: Any, largest: float, rng: np.random.Generator) -> list[Any]:
    """A shape cut across its longer side until no piece is larger."""
    if shape.area <= largest * rng.uniform(0.7, 1.4):
        return [shape]
    corners = shapely.get_coordinates(shapely.minimum_rotated_rectangle(shape))[:4]
    sides = np.roll(corners, -1, axis=0) - corners
    long = int(np.hypot(*sides[1]) > np.hypot(*sides[0]))
    cut = corners[long] + rng.uniform(0.35, 0.65) * sides[long]
    across = sides[1 - long] * 2
    line = shapely.LineString([cut - across, cut + across])
    halves = [p for p in shapely.get_parts(shapely.ops.split(shape, line)) if p.area > 1.0]
    if len(halves) < 2:
        return [shape]
    return [piece for half in halves for piece in _pieces(half, largest, rng)]


def _fields(land: Land, shape: Any, rng: np.random.Generator) -> None:
    """Fields with headlands and paths between them, woods, and now and then a pond."""
    land.cover(shape, "verge")
    names = field_names(land.season)
    for piece in _pieces(shape, _FIELD_M2, rng):
        plot = piece.buffer(-rng.uniform(0.4, 2.5), join_style="mitre")
        if plot.is_empty or plot.area < 300:
            continue
        draw = rng.random()
        if draw < 0.10 and plot.area > 2500:
            wood = plot.buffer(-8).buffer(6)
            land.cover(wood, "forest", rng)
            _scatter(land.wood, wood, 17.0, (2.2, 4.4), (9.0, 17.0), rng)
        elif draw < 0.13 and plot.area > 6000:
            middle = plot.representative_point()
            pond = shapely.affinity.scale(middle.buffer(rng.uniform(15, 32)), 1.0, rng.uniform(0.5, 1.0))
            land.cover(plot, "grass", rng)
            land.cover(shapely.intersection(pond, plot.buffer(-6)), "water")
            _scatter(land.trees, shapely.intersection(pond.buffer(9), plot) - pond, 120.0, (2.0, 4.0), (5.0, 12.0), rng)
        else:
            land.cover(plot, str(rng.choice(names)), rng)
        if rng.random() < 0.30:
            edge = piece.boundary.buffer(1.2)
            _scatter(land.trees, shapely.intersection(edge, piece), 60.0, (1.4, 3.4), (4.0, 11.0), rng)


def _scatter(
    trees: list[tuple[float, float, float, float]],
    shape: Any,
    area_m2: float,
    radius: tuple[float, float],
    height: tuple[float, float],
    rng: np.random.Generator,
) -> None:
    """Trees at random in a shape, one per ``area_m2``."""
    if shape.is_empty:
        return
    x0, y0, x1, y1 = shape.bounds
    count = int((x1 - x0) * (y1 - y0) / area_m2)
    points = rng.uniform((x0, y0), (x1, y1), (count, 2))
    for x, y in points[shapely.contains_xy(shape, points)]:
        r = float(rng.uniform(*radius))
        share = (r - radius[0]) / (radius[1] - radius[0])
        h = height[0] + share * (height[1] - height[0]) * rng.uniform(0.8, 1.1)
        trees.append((float(x), float(y), r, float(h)))


def _park(land: Land, shape: Any, rng: np.random.Generator) -> None:
    land.cover(shape, "lawn", rng)
    corners = shapely.get_coordinates(shape.exterior)
    for _ in range(3):
        a, b = corners[rng.choice(len(corners), 2, replace=False)]
        middle = (a + b) / 2 + rng.normal(0, 6.0, 2)
        path = shapely.LineString([a, middle, b]).segmentize(5.0).buffer(1.4)
        land.cover(shapely.intersection(path, shape), "gravel")
    _scatter(land.trees, shape.buffer(-3), 140.0, (2.5, 6.0), (7.0, 18.0), rng)


def _along_edges(shape: Any, step: tuple[float, float], rng: np.random.Generator) -> list[tuple[Array, Array, float]]:
    """Frontages: begin, unit direction and length of pieces of a parcel's sides, the parcel to their left."""
    ring = shapely.get_coordinates(shapely.orient_polygons(shape.simplify(1.5)).exterior)
    out = []
    for p, q in pairwise(ring):
        length = float(np.hypot(*(q - p)))
        if length < step[0]:
            continue
        count = max(round(length / rng.uniform(*step)), 1)
        cuts = np.linspace(0, length, count + 1)
        d = (q - p) / length
        out += [(p + a * d, d, float(b - a)) for a, b in pairwise(cuts)]
    return out


def _house(p: Array, d: Array, at: tuple[float, float], size: tuple[float, float]) -> Any:
    """A rectangle at (along, into the parcel) of a frontage."""
    n = np.array([-d[1], d[0]])
    a, b = p + at[0] * d + at[1] * n, size[0] * d
    return shapely.Polygon([a, a + b, a + b + size[1] * n, a + size[1] * n])


def _footprint(shape: Any, height: float) -> Footprint:
    part = shapely.orient_polygons(shape)
    rings = [shapely.get_coordinates(r)[:-1] for r in (part.exterior, *part.interiors)]
    return Footprint(rings[0], tuple(rings[1:]), height, True)


def _suburb(land: Land, shape: Any, rng: np.random.Generator) -> None:
    """Detached houses in gardens with paths, garages and hedges."""
    land.cover(shape, "garden", rng)
    used = shapely.Polygon()
    for p, d, length in _along_edges(shape, (17.0, 25.0), rng):
        plot = _house(p, d, (0.0, 0.0), (length, 32.0))
        garden = shapely.intersection(plot, shape).buffer(-0.3)
        if rng.random() < 0.8:
            land.cover(garden, str(rng.choice(["lawn", "garden", "grass"])), rng)
        size = (min(rng.uniform(9.0, 14.0), length - 5.0), rng.uniform(8.5, 11.5))
        front = rng.uniform(4.0, 7.5)
        house = _house(p, d, ((length - size[0]) * rng.uniform(0.3, 0.7), front), size)
        if size[0] < 7 or not shape.buffer(-1.0).contains(house) or house.intersects(used.buffer(3.0)):
            continue
        used = shapely.union(used, house)
        land.footprints.append(_footprint(house, float(rng.choice([3.4, 4.5, 6.2, 6.5]))))
        land.cover(shapely.intersection(_house(p, d, (0.6, -1.0), (3.0, front + 7.0)), shape), "yard")
        land.cover(shapely.intersection(house.buffer(1.0, join_style="mitre"), shape), "paving")
        if front > 6.2:
            land.drives.append(_bay(p, d, (0.85, 0.6)))
        n = np.array([-d[1], d[0]])
        if rng.random() < 0.6:
            for s in np.arange(front + 14, 30, 1.3):
                x, y = p + s * n
                if shape.contains(shapely.Point(x, y)):
                    land.trees.append((float(x), float(y), float(rng.uniform(0.7, 1.0)), float(rng.uniform(1.6, 2.4))))
    _scatter(land.trees, shape.buffer(-2) - used.buffer(2.5), 130.0, (1.2, 4.2), (3.0, 11.0), rng)


def _perimeter(land: Land, shape: Any, rng: np.random.Generator) -> None:
    """Closed rows of houses around a yard with trees, sheds and parked cars."""
    land.cover(shape, str(rng.choice(["yard", "yard", "garden"])), rng)
    inner = shape.buffer(-13.0, join_style="mitre")
    land.cover(inner.buffer(-3.0), str(rng.choice(["lawn", "yard", "garden", "gravel"])), rng)
    used = shapely.Polygon()
    height = rng.uniform(13.0, 20.0)
    for p, d, length in _along_edges(shape, (16.0, 30.0), rng):
        depth = rng.uniform(11.0, 13.5)
        house = shapely.intersection(_house(p, d, (0.0, 0.3), (length, depth)), shape) - used
        parts = [q for q in shapely.get_parts(house) if q.geom_type == "Polygon" and q.area > 70]
        used = shapely.union(used, house.buffer(0.01))
        if parts and rng.random() < 0.93:
            best = max(parts, key=lambda q: q.area).simplify(0.2)
            if best.geom_type == "Polygon" and best.is_valid:
                land.footprints.append(_footprint(best, float(height + rng.choice([-3.0, 0.0, 0.0, 0.0, 3.0]))))
    yard = shape.buffer(-17.0)
    _scatter(land.trees, yard, 110.0, (2.0, 4.5), (6.0, 14.0), rng)


def _commerce(land: Land, shape: Any, rng: np.random.Generator) -> None:
    """A flat hall and a car park."""
    land.cover(shape, "lot", rng)
    room = shape.buffer(-8.0, join_style="mitre")
    if room.is_empty:
        return
    halves = _pieces(max(shapely.get_parts(room), key=lambda q: q.area), shape.area * 0.35, rng)
    hall = max(halves, key=lambda q: q.area)
    box = shapely.minimum_rotated_rectangle(hall)
    hall = shapely.intersection(shapely.affinity.scale(box, 0.85, 0.85), hall)
    if hall.geom_type == "Polygon" and hall.area > 200:
        land.footprints.append(_footprint(hall.simplify(0.3), float(rng.uniform(6.0, 11.0))))
    free = [q for q in shapely.get_parts(room - hall.buffer(5.0)) if q.geom_type == "Polygon" and q.area > 400]
    for part in free:
        land.bays += _bays(part)
    _scatter(land.trees, shape - room, 90.0, (1.5, 3.0), (4.0, 8.0), rng)


def _bay(p: Array, d: Array, at: tuple[float, float]) -> Bay:
    """A bay of 2.5 x 5 m at (along, into the parcel) of a frontage, entered along it."""
    n = np.array([-d[1], d[0]])
    x, y = p + (at[0] + 1.25) * d + (at[1] + 2.5) * n
    return float(x), float(y), float(np.arctan2(n[0], n[1]))


def _bays(shape: Any) -> list[Bay]:
    """Bays in double rows along the shape's longer side, an aisle between them."""
    corners = shapely.get_coordinates(shapely.minimum_rotated_rectangle(shapely.orient_polygons(shape)))[:4]
    sides = np.roll(corners, -1, axis=0) - corners
    long = int(np.hypot(*sides[1]) > np.hypot(*sides[0]))
    d = sides[long] / np.hypot(*sides[long])
    n = np.array([-d[1], d[0]])
    p, width, length = corners[long], float(np.hypot(*sides[1 - long])), float(np.hypot(*sides[long]))
    if not shapely.minimum_rotated_rectangle(shape).buffer(0.1).contains(shapely.Point(p + d + n)):
        n, p = -n, p
    room = shape.buffer(-0.5)
    out = []
    for row, across in enumerate(np.arange(1.0, width - 5.0, _ROW_M)):
        if row % 3 == 2:
            continue
        for s in np.arange(1.0, length - 3.0, 2.5):
            centre = p + (s + 1.25) * d + (across + 2.5) * n
            if room.contains(shapely.Point(centre).buffer(2.8)):
                out.append((float(centre[0]), float(centre[1]), float(np.arctan2(n[0], n[1]))))
    return out
