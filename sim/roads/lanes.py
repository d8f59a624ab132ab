"""Lanes of roads: their centre lines in driving direction, and how far a road keeps off a junction's middle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Float

from sim.archive import freeze_fields
from sim.roads.cross_section import section
from sim.roads.network import Road, RoadNetwork, distinct

Array = np.ndarray

# Beyond this angle [rad] between two roads at a node one is the other's continuation and nothing is left out.
_STRAIGHT = np.deg2rad(150.0)
_ACUTE = np.deg2rad(30.0)
# Roads at an acute angle stay together for long; no road is left out farther than this, nor over this part of it.
_FARTHEST_M, _LARGEST_PART = 60.0, 0.45


@dataclass(frozen=True, eq=False)
class Lane:
    """One lane of an edge: its centre line in driving direction (traffic keeps to the right).

    ``number`` counts from the right in driving direction, 0 = rightmost; ``forward`` tells whether it runs along the
    edge's own line.
    """

    edge: int
    number: int
    forward: bool
    line_m: Float[Array, "n 2"]
    width_m: float

    def __post_init__(self) -> None:
        freeze_fields(self)


def offset_line(line: Float[Array, "n 2"], left_m: float) -> Float[Array, "m 2"]:
    """The parallel of a polyline, ``left_m`` to its left (to the right where negative), in the same direction.

    Bends tighter than the offset are cut off; where nothing is left of the line it is returned empty.
    """
    if left_m == 0:
        return np.array(line)
    curve = shapely.offset_curve(shapely.LineString(line), left_m, join_style="mitre", mitre_limit=2.0)
    parts = [p for p in shapely.get_parts(curve) if p.length > 0]
    if not parts:
        return np.zeros((0, 2))
    out = distinct(shapely.get_coordinates(max(parts, key=lambda p: p.length)))
    return out if len(out) > 1 else np.zeros((0, 2))


def roadway(road: Road) -> tuple[float, float]:
    """Left and right limit [m] of all lanes together, as offsets to the left of the road's line.

    Parking strips, edge strips and, at the right of a motorway's carriageway, the hard shoulder are left out as far as
    the pavement has room for them.
    """
    s = section(road.road_class)
    half = road.width_m / 2 - road.parking_m
    room = 2 * half - road.lanes * s.lane_m
    if room <= 0:
        return half, -half
    strip = min(s.strip_m, room / 2)
    shoulder = min(s.shoulder_m, room - 2 * strip) if road.oneway else 0.0
    # What is left beyond the standard parts widens the lanes.
    return half - strip, -half + strip + shoulder


def lane_borders(road: Road) -> Float[Array, "n"]:
    """Offsets [m] to the left of the road's line of the limits of all lanes, from left to right."""
    left, right = roadway(road)
    return np.linspace(left, right, road.lanes + 1)


def lanes(network: RoadNetwork) -> tuple[Lane, ...]:
    """All lanes of a network, whole from node to node; a lane that a tight bend swallows is left out."""
    found: list[Lane] = []
    for edge, road in enumerate(network.edges):
        borders = lane_borders(road)
        middles, width = (borders[:-1] + borders[1:]) / 2, float(borders[0] - borders[1])
        forward = np.arange(road.lanes) >= road.lanes - road.lanes_forward
        for k, (middle, ahead) in enumerate(zip(middles, forward, strict=True)):
            line = offset_line(road.line_m, float(middle))
            if len(line):
                number = road.lanes - 1 - k if ahead else k
                found.append(Lane(edge, number, bool(ahead), line if ahead else line[::-1], width))
    return tuple(found)


def setbacks(network: RoadNetwork) -> Float[Array, "k 2"]:
    """Length [m] at the start and end of every edge that lies within other roads' pavement at a junction.

    Two straight roads of half widths a, b at the angle θ overlap over (b + a cos θ) / sin θ of the first. A road that
    one of a lower class leaves or joins at an acute angle, as a ramp does, goes on undisturbed.
    """
    out = np.zeros((len(network.edges), 2))
    at_node: dict[int, list[tuple[int, int]]] = {}
    for edge, pair in enumerate(network.ends):
        for side, node in enumerate(pair):
            at_node.setdefault(int(node), []).append((edge, side))
    for arms in at_node.values():
        if len(arms) < 3:
            continue
        bearing = [_leaving(network.edges[e], side) for e, side in arms]
        for i, (edge, side) in enumerate(arms):
            a = network.edges[edge].width_m / 2
            for j, (other, _) in enumerate(arms):
                angle = abs((bearing[i] - bearing[j] + np.pi) % (2 * np.pi) - np.pi)
                ramp = angle < _ACUTE and network.edges[other].road_class > network.edges[edge].road_class
                if i != j and 1e-3 < angle < _STRAIGHT and not ramp:
                    b = network.edges[other].width_m / 2
                    out[edge, side] = max(out[edge, side], (b + a * np.cos(angle)) / np.sin(angle))
            out[edge, side] = min(out[edge, side], _FARTHEST_M, _LARGEST_PART * network.edges[edge].length_m)
    return out


def _leaving(road: Road, side: int) -> float:
    """Bearing [rad, from +x] in which a road leaves a node, taken over its first 5 m."""
    s = min(5.0, road.length_m)
    near, far = road.at(np.array([0.0, s] if side == 0 else [road.length_m, road.length_m - s]))[0]
    return float(np.arctan2(far[1] - near[1], far[0] - near[0]))
