"""Road networks: junctions and the edges between them in the world frame; cutting, clipping and sampling them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import shapely
from jaxtyping import Float, Int

from sim.archive import freeze, freeze_fields
from sim.roads.cross_section import map_width_m, section

Array = np.ndarray
Bounds = tuple[float, float, float, float]

# Longer edges are cut (Kozempel 2012, 4.2): the distance of a middle then tells whether an edge can be in an image.
LONGEST_EDGE_M = 400.0
# Vertices nearer than this are one: the resolution of map files (1e-7 degrees).
SNAP_M = 0.01
# A lane narrower than this holds no car.
NARROWEST_LANE_M = 2.3


@dataclass(frozen=True, eq=False)
class Road:
    """One road or carriageway: its middle line and what runs on it.

    line_m      (n, 2) polyline in w along the middle of the pavement; a oneway road is driven from first to last.
    road_class  0 (motorway) to 4 (local), see `sim.roads.cross_section`.
    lanes       in both directions together; the right half, rounded up, is driven along the line.
    width_m     pavement from kerb to kerb, parking strips included.
    parking_m   width of a parking strip at each kerb, 0 = none.

    Raises
        ValueError: a line of fewer than two different points or not finite, no lane, a width that the lanes do not fit.
    """

    line_m: Float[Array, "n 2"]
    road_class: int
    lanes: int
    oneway: bool
    width_m: float
    name: str = ""
    parking_m: float = 0.0

    def __post_init__(self) -> None:
        line = np.asarray(self.line_m, float)
        if line.ndim != 2 or line.shape[1] != 2 or not np.isfinite(line).all():
            raise ValueError(f"road {self.name!r}: expected a finite line (n, 2), got shape {line.shape}")
        if len(line) < 2 or np.any(np.hypot(*np.diff(line, axis=0).T) == 0):
            raise ValueError(f"road {self.name!r}: expected at least two points, no two in a row the same")
        section(self.road_class)
        if self.lanes < 1:
            raise ValueError(f"road {self.name!r}: expected at least 1 lane, got {self.lanes}")
        if not self.width_m - 2 * self.parking_m >= self.lanes * NARROWEST_LANE_M:
            raise ValueError(
                f"road {self.name!r}: {self.width_m} m with parking strips of {self.parking_m} m are too narrow for "
                f"{self.lanes} lanes of at least {NARROWEST_LANE_M} m"
            )
        object.__setattr__(self, "line_m", freeze(line))

    @staticmethod
    def standard(
        line_m: Float[Array, "n 2"], road_class: int, lanes: int, oneway: bool, name: str = "", parking_m: float = 0.0
    ) -> Road:
        """A road as wide as its class and lanes ask for."""
        width = section(road_class).paved_m(lanes) + 2 * parking_m
        return Road(line_m, road_class, lanes, oneway, width, name, parking_m)

    @cached_property
    def stations_m(self) -> Float[Array, "n"]:
        """Length along the line up to every vertex."""
        return freeze(np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.line_m, axis=0).T))]))

    @property
    def length_m(self) -> float:
        return float(self.stations_m[-1])

    @property
    def lanes_forward(self) -> int:
        return self.lanes if self.oneway else (self.lanes + 1) // 2

    @property
    def map_width_m(self) -> float:
        """Width in a mask: RAS-Q and 1.5 m on both sides; a oneway road of a divided class is one carriageway."""
        return map_width_m(self.road_class, self.oneway)

    def at(self, station_m: Float[Array, "*b"]) -> tuple[Float[Array, "*b 2"], Float[Array, "*b 2"]]:
        """Points and unit directions at stations along the line (beyond the ends: along the end pieces)."""
        return along(self.line_m, station_m)

    def piece(self, begin_m: float, end_m: float) -> Road:
        """The part between two stations."""
        s = self.stations_m
        inner = self.line_m[(s > begin_m + SNAP_M / 2) & (s < end_m - SNAP_M / 2)]
        ends = self.at(np.array([begin_m, end_m]))[0]
        return replace(self, line_m=np.concatenate([ends[:1], inner, ends[1:]]))


def along(
    line: Float[Array, "n 2"], station_m: Float[Array, "*b"]
) -> tuple[Float[Array, "*b 2"], Float[Array, "*b 2"]]:
    """Points and unit directions at stations of a polyline."""
    steps = np.diff(line, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    stations = np.concatenate([[0.0], np.cumsum(lengths)])
    k = np.clip(np.searchsorted(stations, station_m, side="right") - 1, 0, len(steps) - 1)
    direction = steps[k] / lengths[k][..., None]
    return line[k] + (np.asarray(station_m) - stations[k])[..., None] * direction, direction


@dataclass(frozen=True, eq=False)
class RoadSamples:
    """Points along the edges of a network: position, unit direction of the line, edge and station [m]."""

    xy_m: Float[Array, "n 2"]
    direction: Float[Array, "n 2"]
    edge: Int[Array, "n"]
    station_m: Float[Array, "n"]

    def __post_init__(self) -> None:
        freeze_fields(self)


@dataclass(frozen=True, eq=False)
class RoadNetwork:
    """Roads that meet at their ends only: ``ends[k]`` are the nodes of edge k's first and last vertex.

    Made by `RoadNetwork.of`, which cuts roads where they share a vertex. Roads that cross without a common vertex
    (bridges, tunnels) do not meet.
    """

    edges: tuple[Road, ...]
    nodes_m: Float[Array, "m 2"]
    ends: Int[Array, "k 2"]

    def __post_init__(self) -> None:
        freeze_fields(self)
        for road, (start, end) in zip(self.edges, self.ends, strict=True):
            gaps = road.line_m[[0, -1]] - self.nodes_m[[start, end]]
            if np.abs(gaps).max() > SNAP_M:
                raise ValueError(f"RoadNetwork: road {road.name!r} does not end at its nodes")

    @staticmethod
    def of(roads: Iterable[Road]) -> RoadNetwork:
        """The network of roads, cut at every vertex that two of them share (or one passes twice)."""
        roads = list(roads)
        keys = [_keys(r.line_m) for r in roads]
        uses: dict[tuple[int, int], int] = {}
        for ks in keys:
            for position, key in enumerate(ks):
                # An end counts twice: where another road passes or ends, that one is cut or meets.
                uses[key] = uses.get(key, 0) + (2 if position in (0, len(ks) - 1) else 1)
        edges: list[Road] = []
        ends: list[tuple[int, int]] = []
        number: dict[tuple[int, int], int] = {}
        nodes: list[Array] = []
        for road, ks in zip(roads, keys, strict=True):
            cuts = [i for i, key in enumerate(ks) if i in (0, len(ks) - 1) or uses[key] > 1]
            for i, j in pairwise(cuts):
                for index in (i, j):
                    if ks[index] not in number:
                        number[ks[index]] = len(nodes)
                        nodes.append(road.line_m[index])
                start, end = number[ks[i]], number[ks[j]]
                line = np.concatenate([[nodes[start]], road.line_m[i + 1 : j], [nodes[end]]])
                if len(line) > 2 or start != end:
                    edges.append(replace(road, line_m=line))
                    ends.append((start, end))
        return RoadNetwork(tuple(edges), np.reshape(nodes, (-1, 2)), np.reshape(ends, (-1, 2)).astype(int))

    def joined(self) -> RoadNetwork:
        """Edges that go on as the same road (all but the line equal) made one, where nothing else meets them."""
        groups: dict[tuple[object, ...], list[Road]] = {}
        for e in self.edges:
            key = (e.road_class, e.lanes, e.oneway, e.width_m, e.name, e.parking_m)
            groups.setdefault(key, []).append(e)
        roads: list[Road] = []
        for same in groups.values():
            # The direction counts where traffic or the lanes of both directions differ.
            directed = same[0].oneway or same[0].lanes % 2 == 1
            merged = shapely.line_merge(shapely.MultiLineString([e.line_m for e in same]), directed=directed)
            roads += [replace(same[0], line_m=shapely.get_coordinates(g)) for g in shapely.get_parts(merged)]
        return RoadNetwork.of(roads)

    @property
    def length_m(self) -> float:
        return math.fsum(e.length_m for e in self.edges)

    @property
    def bounds_m(self) -> Bounds:
        """(least x, least y, greatest x, greatest y) of the lines.

        Raises
            ValueError: a network without roads.
        """
        if not self.edges:
            raise ValueError("RoadNetwork.bounds_m: the network has no roads")
        points = np.concatenate([e.line_m for e in self.edges])
        (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
        return float(x0), float(y0), float(x1), float(y1)

    @cached_property
    def degree(self) -> Int[Array, "m"]:
        """How many edge ends meet at every node: 1 a dead end, 2 a road that goes on, 3 or more a junction."""
        return freeze(np.bincount(self.ends.ravel(), minlength=len(self.nodes_m)))

    def cut(self, longest_m: float = LONGEST_EDGE_M) -> RoadNetwork:
        """Every longer edge in equal parts of at most ``longest_m`` (Kozempel 2012, 4.2)."""
        if not longest_m > 0:
            raise ValueError(f"longest_m: expected > 0, got {longest_m}")
        pieces: list[Road] = []
        for road in self.edges:
            stations = np.linspace(0, road.length_m, math.ceil(road.length_m / longest_m - 1e-9) + 1)
            pieces += [road] if len(stations) < 3 else [road.piece(a, b) for a, b in pairwise(stations)]
        return RoadNetwork.of(pieces)

    def clip(self, bounds_m: Bounds) -> RoadNetwork:
        """What lies inside a rectangle; roads end where they leave it."""
        pieces: list[Road] = []
        for road in self.edges:
            inside = shapely.clip_by_rect(shapely.LineString(road.line_m), *bounds_m)
            for part in shapely.get_parts(shapely.line_merge(inside) if inside.geom_type != "LineString" else inside):
                line = distinct(shapely.get_coordinates(part))
                if part.geom_type == "LineString" and len(line) > 1:
                    pieces.append(replace(road, line_m=line))
        return RoadNetwork.of(pieces)

    def sample(self, step_m: float) -> RoadSamples:
        """Points in the middle of equal steps of at most ``step_m`` along every edge, and directions of its line."""
        if not step_m > 0:
            raise ValueError(f"step_m: expected > 0, got {step_m}")
        counts = [max(math.ceil(e.length_m / step_m - 1e-9), 1) for e in self.edges]
        stations = [(np.arange(n) + 0.5) * e.length_m / n for e, n in zip(self.edges, counts, strict=True)]
        found = [e.at(s) for e, s in zip(self.edges, stations, strict=True)]
        edge = np.repeat(np.arange(len(counts)), counts)
        if not found:
            return RoadSamples(np.zeros((0, 2)), np.zeros((0, 2)), edge, np.zeros(0))
        xy, direction = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return RoadSamples(xy, direction, edge, np.concatenate(stations))


def distinct(line: Float[Array, "n 2"]) -> Float[Array, "m 2"]:
    """A polyline without points that repeat the one before."""
    line = np.asarray(line, float)
    keep = np.concatenate([[True], np.hypot(*np.diff(line, axis=0).T) > SNAP_M / 10])[: len(line)]
    return np.asarray(line[keep])


def _keys(line: Array) -> list[tuple[int, int]]:
    return [(int(x), int(y)) for x, y in np.round(line / SNAP_M)]
