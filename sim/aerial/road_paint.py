"""Paint on roads besides the lines of `sim.roads.markings`: crossings for pedestrians, arrows, parking bays."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from sim.roads import Road, RoadNetwork
from sim.roads.lanes import lane_borders, setbacks

Array = np.ndarray
# Shares of the arms of junctions in towns.
_FORD, _ZEBRA = 0.45, 0.12
_FORD_M, _ZEBRA_M = 3.4, 4.0
_SHORTEST_M = 40.0
# Outline of an arrow straight on, 5 m long, x ahead; and of its head turned to the left.
_STRAIGHT = ((0, -0.08), (3.4, -0.08), (3.4, -0.32), (5.0, 0.0), (3.4, 0.32), (3.4, 0.08), (0, 0.08))
_LEFT = (
    (0, -0.08), (3.3, -0.08), (3.9, 0.5), (4.15, 0.25), (4.3, 1.2), (3.3, 1.05), (3.6, 0.8), (3.15, 0.32), (3.0, 0.08),
    (0, 0.08),
)  # fmt: skip


def road_paint(network: RoadNetwork, built_up: Any, rng: np.random.Generator) -> list[Any]:
    """Crossings at junctions in the built-up area (a shape) and arrows on the lanes that lead to them, as polygons."""
    free = setbacks(network)
    out: list[Any] = []
    for edge, (road, pair) in enumerate(zip(network.edges, network.ends, strict=True)):
        if road.road_class < 2 or road.length_m < _SHORTEST_M:
            continue
        for side, node in enumerate(pair):
            if network.degree[node] < 3 or not shapely.contains_xy(built_up, *network.nodes_m[node]):
                continue
            draw = rng.random()
            if draw < _FORD:
                out += _ford(road, side, free[edge, side])
            elif draw < _FORD + _ZEBRA:
                out += _zebra(road, side, free[edge, side] + 7.0)
            out += _arrows(road, side, free[edge, side], rng)
    return out


def _frame(road: Road, side: int, off_m: float) -> tuple[Array, Array, Array]:
    """A point ``off_m`` before an end, the direction towards the end and to the left of it."""
    p, d = road.at(np.array(off_m if side == 0 else road.length_m - off_m))
    d = -d if side == 0 else d
    return p, d, np.array([-d[1], d[0]])


def _rectangle(p: Array, d: Array, n: Array, ahead: float, left: float, size: tuple[float, float]) -> Any:
    a = p + ahead * d + left * n
    return shapely.Polygon([a, a + size[0] * d, a + size[0] * d + size[1] * n, a + size[1] * n])


def _ford(road: Road, side: int, off_m: float) -> list[Any]:
    """Two broken lines across the road, before the stop line."""
    p, d, n = _frame(road, side, off_m + 0.4)
    steps = np.arange(-road.width_m / 2 + 0.3, road.width_m / 2 - 0.6, 1.0)
    return [_rectangle(p, d, n, x, float(y), (0.12, 0.5)) for x in (0.0, _FORD_M) for y in steps]


def _zebra(road: Road, side: int, off_m: float) -> list[Any]:
    p, d, n = _frame(road, side, off_m)
    steps = np.arange(-road.width_m / 2 + 0.4, road.width_m / 2 - 0.5, 1.0)
    return [_rectangle(p, d, n, 0.0, float(y), (_ZEBRA_M, 0.5)) for y in steps]


def _arrows(road: Road, side: int, off_m: float, rng: np.random.Generator) -> list[Any]:
    """Two arrows on every lane that leads to the end, where there is more than one; the left lane turns left."""
    borders = lane_borders(road)
    middle = road.lanes - road.lanes_forward
    into = borders[middle:] if side == 1 else -borders[: middle + 1][::-1]
    if len(into) < 3:
        return []
    out = []
    for k, left in enumerate((into[:-1] + into[1:]) / 2):
        shape = np.array(_LEFT if k == 0 and rng.random() < 0.7 else _STRAIGHT, float)
        for ahead in (7.0, 22.0):
            p, d, n = _frame(road, side, off_m + ahead + 5.0)
            out.append(shapely.Polygon(p + shape[:, :1] * d + (left + shape[:, 1:]) * n))
    return out


def bay_lines(bays: Float[Array, "n 3"]) -> list[Any]:
    """Lines at both sides of bays of 2.5 x 5 m; rows (x, y, heading)."""
    out = []
    for x, y, heading in bays:
        d = np.array([np.sin(heading), np.cos(heading)])
        n = np.array([-d[1], d[0]])
        out += [_rectangle(np.array([x, y]), d, n, -2.5, side - 0.06, (5.0, 0.12)) for side in (-1.25, 1.25)]
    return out
