"""Road markings as plain geometry: every painted stroke as a polyline with a width, after the German RMS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from sim.archive import freeze_fields
from sim.roads.lanes import lane_borders, offset_line, setbacks
from sim.roads.network import Road, RoadNetwork, along

Array = np.ndarray
Kind = Literal["edge", "lane", "centre", "stop"]

# (stroke, gap) [m] of broken lines: motorways, roads outside and inside towns (RMS, Leitlinien).
_DASHES = {0: (6.0, 12.0), 1: (6.0, 12.0), 2: (4.0, 8.0), 3: (4.0, 8.0), 4: (3.0, 6.0)}
# Narrow and wide lines [m] by class: motorways 0.15 and 0.30, others 0.12 and 0.25.
_NARROW_M, _WIDE_M = (0.15, 0.15, 0.12, 0.12, 0.12), (0.30, 0.30, 0.25, 0.12, 0.12)
_STOP_M = 0.50
# Local streets narrower than this have no line in the middle.
_NARROW_STREET_M = 5.5
_NO_EDGE_LINES = 4
# Into these classes traffic merges.
_MOTORWAYS = (0, 1)
# A stop line stands this far off the other road's pavement, and only where a street is long enough to stop on.
_STOP_GAP_M, _SHORTEST_STOP_ROAD_M = 1.0, 20.0


@dataclass(frozen=True, eq=False)
class Marking:
    """One painted stroke: a polyline (n, 2) in w and its width [m]; a broken line is many of them."""

    kind: Kind
    edge: int
    line_m: Float[Array, "n 2"]
    width_m: float

    def __post_init__(self) -> None:
        freeze_fields(self)


def markings(network: RoadNetwork) -> tuple[Marking, ...]:
    """All strokes of a network: solid lines at the edges of the roadway, broken ones between lanes, stop lines.

    Directions are parted by a broken line, from four lanes on by a solid one. Local streets (class 4) have no edge
    lines, and below 5.5 m none in the middle. Junctions (three roads or more) stay free. A road stops where it meets
    one of a higher class, but for ramps that merge into a motorway.
    """
    free = setbacks(network)
    out: list[Marking] = []
    for edge, road in enumerate(network.edges):
        begin, end = free[edge, 0], road.length_m - free[edge, 1]
        if end - begin > 1.0:
            out += _along(edge, road, begin, end)
    return (*out, *_stops(network, free))


def _along(edge: int, road: Road, begin: float, end: float) -> list[Marking]:
    free = road.piece(begin, end) if (begin, end) != (0.0, road.length_m) else road
    borders, narrow, wide = lane_borders(road), _NARROW_M[road.road_class], _WIDE_M[road.road_class]
    out: list[Marking] = []
    if road.road_class != _NO_EDGE_LINES:
        # The stroke lies outside of the lanes, on the strip, if there is one.
        for offset in (borders[0] + _outside(road, wide), borders[-1] - _outside(road, wide)):
            line = offset_line(free.line_m, float(offset))
            out += [Marking("edge", edge, line, wide)] if len(line) else []
    if road.road_class == _NO_EDGE_LINES and borders[0] - borders[-1] < _NARROW_STREET_M - 1e-9:
        return out
    middle = road.lanes - road.lanes_forward
    for k in range(1, road.lanes):
        line = offset_line(free.line_m, float(borders[k]))
        if not len(line):
            continue
        kind: Kind = "centre" if k == middle and not road.oneway else "lane"
        strokes = [line] if kind == "centre" and road.lanes >= 4 else dashes(line, *_DASHES[road.road_class])
        out += [Marking(kind, edge, stroke, narrow) for stroke in strokes]
    return out


def _outside(road: Road, wide: float) -> float:
    borders = lane_borders(road)
    room = road.width_m / 2 - borders[0]
    return wide / 2 if room >= wide else -wide / 2


def dashes(line: Float[Array, "n 2"], stroke_m: float, gap_m: float) -> list[Float[Array, "m 2"]]:
    """Strokes along a polyline, the pattern centred on it; none on a line shorter than a stroke."""
    stations = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    period = stroke_m + gap_m
    count = int((stations[-1] + gap_m) // period)
    first = (stations[-1] - count * period + gap_m) / 2
    out = []
    for k in range(count):
        a, b = first + k * period, first + k * period + stroke_m
        ends = along(line, np.array([a, b]))[0]
        inner = line[(stations > a + 1e-3) & (stations < b - 1e-3)]
        out.append(np.concatenate([ends[:1], inner, ends[1:]]))
    return out


def _stops(network: RoadNetwork, free: Float[Array, "k 2"]) -> list[Marking]:
    """Stop lines across the lanes that lead into a junction with a road of a higher class."""
    highest = np.full(len(network.nodes_m), _NO_EDGE_LINES)
    for road, pair in zip(network.edges, network.ends, strict=True):
        highest[pair] = np.minimum(highest[pair], road.road_class)
    out = []
    for edge, (road, pair) in enumerate(zip(network.edges, network.ends, strict=True)):
        borders = lane_borders(road)
        middle = road.lanes - road.lanes_forward
        for side, node in enumerate(pair):
            into = borders[middle:] if side == 1 else borders[: middle + 1]
            if (
                network.degree[node] < 3
                or highest[node] >= road.road_class
                or highest[node] in _MOTORWAYS
                or len(into) < 2
                or road.length_m < _SHORTEST_STOP_ROAD_M
            ):
                continue
            off = free[edge, side] + _STOP_GAP_M + _STOP_M / 2
            p, d = road.at(np.array(off if side == 0 else road.length_m - off))
            left = np.array([-d[1], d[0]])
            out.append(Marking("stop", edge, p + np.array([[into[0]], [into[-1]]]) * left, _STOP_M))
    return out
