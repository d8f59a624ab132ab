"""Roads as they are painted on the ground: asphalt with its age, wheel tracks, patches, joints, kerbs and markings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from sim.aerial.ground import DRAWN_WIDER_M, Strip
from sim.roads import Road, RoadNetwork, markings, offset_line
from sim.roads.lanes import lane_borders

Array = np.ndarray
_CORNER_M = 6.0
# sRGB code values of asphalt: old and light, new and dark.
_TONES = (102, 130)
_KERB_TONE, _KERB_M = 152, 0.18
_TRACK_OFF_M, _TRACK_M = 0.85, 0.6
_TRACK, _OIL = 22, -20


@dataclass(frozen=True, eq=False)
class RoadSurface:
    """What `GroundPlan` wants of the roads, and all pavement as one shape."""

    strips: tuple[Strip, ...]
    wear: tuple[tuple[Float[Array, "n 2"], float, int], ...]
    paint: tuple[Any, ...]
    pavement: Any


def road_surface(network: RoadNetwork, built_up: Any, rng: np.random.Generator) -> RoadSurface:
    """The surface of a network; kerbs lie where it runs through the built-up area (a shape)."""
    shapes = [shapely.LineString(r.line_m).buffer(r.width_m / 2, quad_segs=6) for r in network.edges]
    tones = rng.integers(*_TONES, len(shapes))
    strips = [Strip(s, int(t), _strokes(r)) for s, t, r in zip(shapes, tones, network.edges, strict=True)]
    corners = [Strip(c, int(rng.integers(*_TONES))) for c in _corners(network, shapes)]
    pavement = shapely.union_all([s.shape for s in (*corners, *strips)])
    wear = [w for road in network.edges for w in _wear(road, rng)]
    for part in shapely.get_parts(shapely.intersection(pavement.boundary, built_up)):
        if part.geom_type == "LineString":
            wear.append((shapely.get_coordinates(part), _KERB_M, _KERB_TONE))
    paint = [
        shapely.LineString(m.line_m).buffer(m.width_m / 2 - DRAWN_WIDER_M, cap_style="flat") for m in markings(network)
    ]
    return RoadSurface((*corners, *strips), tuple(wear), tuple(paint), pavement)


def _corners(network: RoadNetwork, shapes: list[Any]) -> list[Any]:
    """Pavement that rounds the corners of junctions."""
    tree = shapely.STRtree(shapes)
    out = []
    for node in np.flatnonzero(network.degree >= 3):
        at = shapely.Point(network.nodes_m[node]).buffer(45.0)
        meeting = [e for e in np.flatnonzero((network.ends == node).any(axis=1)) if network.edges[e].road_class >= 2]
        near = [shapes[k] for k in tree.query(at) if k in meeting]
        if len(near) < 2:
            continue
        arms = shapely.intersection(shapely.union_all(near), at)
        closed = arms.buffer(_CORNER_M, quad_segs=6).buffer(-_CORNER_M, quad_segs=6)
        out.append(shapely.intersection(closed, shapely.Point(network.nodes_m[node]).buffer(38.0)))
    return out


def _strokes(road: Road) -> tuple[tuple[Float[Array, "n 2"], float, int], ...]:
    """Wheel tracks, lighter than the rest, and the oil between them."""
    borders = lane_borders(road)
    out = []
    for middle in (borders[:-1] + borders[1:]) / 2:
        for off, width, change in (
            (0.0, 0.8, _OIL),
            (_TRACK_OFF_M, _TRACK_M, _TRACK),
            (-_TRACK_OFF_M, _TRACK_M, _TRACK),
        ):
            line = offset_line(road.line_m, float(middle + off))
            if len(line):
                out.append((line, width, change))
    return tuple(out)


def _wear(road: Road, rng: np.random.Generator) -> list[tuple[Float[Array, "n 2"], float, int]]:
    """Patches, sealed joints across and along, and manholes."""
    out: list[tuple[Array, float, int]] = []
    half = road.width_m / 2
    for _ in range(rng.poisson(road.length_m / 55)):
        s, length = rng.uniform(0, road.length_m), rng.uniform(1.5, 14.0)
        left, width = rng.uniform(-half + 0.3, half - 1.3), rng.uniform(0.8, 3.2)
        tone = int(rng.integers(84, 142))
        p, d = road.at(np.array([s, s + length]))
        n = np.stack([-d[:, 1], d[:, 0]], axis=-1)
        right = min(left + width, half - 0.1)
        ring = np.array([p[0] + left * n[0], p[1] + left * n[1], p[1] + right * n[1], p[0] + right * n[0]])
        if shapely.Polygon(ring).is_valid:
            out += [(ring, 0.0, tone), (np.concatenate([ring, ring[:1]]), 0.1, 78)]
    for _ in range(rng.poisson(road.length_m / 30)):
        p, d = road.at(np.array(rng.uniform(0, road.length_m)))
        n = np.array([-d[1], d[0]]) + 0.2 * rng.standard_normal() * d
        a, b = sorted(rng.uniform(-half, half, 2))
        mid = (a + b) / 2 * n + rng.normal(0, 0.3) * d
        out.append((np.array([p + a * n, p + mid, p + b * n]), 0.1, int(rng.integers(70, 96))))
    for border in lane_borders(road)[1:-1]:
        line = offset_line(road.line_m, float(border) + 0.12)
        if len(line):
            out.append((line, 0.1, 94))
    if road.road_class >= 2:
        for _ in range(rng.poisson(road.length_m / 45)):
            p = road.at(np.array(rng.uniform(0, road.length_m)))[0] + rng.uniform(-0.5, 0.5, 2)
            angle = np.linspace(0, 2 * np.pi, 9)[:-1]
            ring = p + 0.35 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
            out.append((ring, 0.0, int(rng.integers(66, 90))))
    return out
