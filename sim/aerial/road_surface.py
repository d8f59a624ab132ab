"""Roads as they are painted on the ground: asphalt with its age, wheel tracks, patches, joints, kerbs and markings."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float, Int

from sim.aerial.ground import DRAWN_WIDER_M, Strip
from sim.roads import Road, RoadNetwork, markings, offset_line
from sim.roads.lanes import lane_borders

Array = np.ndarray
_CORNER_M = 6.0
# sRGB code values of asphalt: old and light, new and dark.
_TONES = (114, 138)
_KERB_TONE, _KERB_M = 165, 0.18
_TRACK_OFF_M, _TRACK_M = 0.85, 0.6
_TRACK, _OIL = 22, -20


@dataclass(frozen=True, eq=False)
class RoadSurface:
    """What `GroundPlan` wants of the roads, and all pavement as one shape."""

    strips: tuple[Strip, ...]
    wear: tuple[tuple[Float[Array, "_ 2"], float, int], ...]
    paint: tuple[Any, ...]
    pavement: Any


def road_surface(network: RoadNetwork, built_up: Any, rng: np.random.Generator) -> RoadSurface:
    """The surface of a network; kerbs lie where it runs through the built-up area (a shape)."""
    shapes = [shapely.LineString(r.line_m).buffer(r.width_m / 2, cap_style="flat") for r in network.edges]
    tones = _tones(network, rng)
    strips = [Strip(s, int(t), _strokes(r)) for s, t, r in zip(shapes, tones, network.edges, strict=True)]
    below, above = _nodes(network, shapes, tones)
    strips = [*below, *strips, *above]
    pavement = shapely.union_all([s.shape for s in strips])
    wear = [w for road in network.edges for w in _wear(road, rng)]
    for part in shapely.get_parts(shapely.intersection(pavement.boundary, built_up)):
        if part.geom_type == "LineString":
            wear.append((shapely.get_coordinates(part), _KERB_M, _KERB_TONE))
    paint = [
        shapely.LineString(m.line_m).buffer(m.width_m / 2 - DRAWN_WIDER_M, cap_style="flat") for m in markings(network)
    ]
    return RoadSurface(tuple(strips), tuple(wear), tuple(paint), pavement)


def _tones(network: RoadNetwork, rng: np.random.Generator) -> Int[Array, "k"]:
    """One tone for all edges of a street of a name, a little different on every edge."""
    of_name = {name: int(rng.integers(*_TONES)) for name in sorted({r.name for r in network.edges})}
    return np.array([of_name[r.name] if r.name else rng.integers(*_TONES) for r in network.edges], int) + rng.integers(
        -4, 5, len(network.edges)
    )


def _nodes(network: RoadNetwork, shapes: list[Any], tones: Int[Array, "k"]) -> tuple[list[Strip], list[Strip]]:
    """Pavement below and above the edges at nodes: bends and corners made round; where arms overlap."""
    below, above = [], []
    for node in range(len(network.nodes_m)):
        arms = np.flatnonzero((network.ends == node).any(axis=1))
        if not len(arms):
            continue
        tone, at = int(tones[arms].mean()), shapely.Point(network.nodes_m[node])
        wide = max(network.edges[e].width_m for e in arms)
        if len(arms) == 2 or (len(arms) == 1 and network.edges[arms[0]].road_class == 4):
            below.append(Strip(at.buffer(min(network.edges[e].width_m for e in arms) / 2), tone))
        minor = [e for e in arms if network.edges[e].road_class >= 2]
        if len(arms) < 3 or len(minor) < 2:
            continue
        near = at.buffer(wide / 2 + 4 * _CORNER_M)
        cut = [shapely.intersection(shapes[e], near) for e in arms]
        whole = shapely.union_all(cut)
        closed = whole.buffer(_CORNER_M, quad_segs=6).buffer(-_CORNER_M, quad_segs=6)
        below.append(Strip(shapely.union(closed, whole), tone))
        overlaps = [shapely.intersection(a, b) for a, b in combinations(cut, 2)]
        core = shapely.intersection(shapely.union_all(overlaps).convex_hull, closed)
        if core.geom_type in ("Polygon", "MultiPolygon") and not core.is_empty:
            above.append(Strip(core, tone))
    return below, above


def _strokes(road: Road) -> tuple[tuple[Float[Array, "_ 2"], float, int], ...]:
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


def _wear(road: Road, rng: np.random.Generator) -> list[tuple[Float[Array, "_ 2"], float, int]]:
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
