"""The road map that estimators get: the true network displaced, with missing, outdated and too narrow roads.

Kozempel 2012, 4.2.2, found ten map points 1.7 m off on average and one of them 6.1 m, and roads newer than the map: the
Ernst-Ruska-Ufer with four lanes and 16.5 m in the world is class 4 (RQ 7.5) in the map.

A point x is displaced by s(x) g(x): g is a Gaussian vector field of unit variance per axis and ln s a Gaussian field of
standard deviation TAIL, all with the correlation exp(-r²/2L²). The length of a displacement then has the mean that is
asked for; with 1.7 m its median is 1.3 m, its 95 % quantile 4.6 m, and 2.2 % of the points are off by more than 6 m.
Roads that meet are displaced together and still meet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from sim.archive import freeze_fields
from sim.roads.cross_section import map_width_m, section
from sim.roads.network import Road, RoadNetwork

Array = np.ndarray

# Standard deviation of ln s: how much heavier the tail is than a Rayleigh distribution's.
TAIL = 0.6
# Waves that make up a Gaussian field: its values are Gaussian to 1 / _WAVES.
_WAVES = 256
# Lines bend with the field between vertices this far apart.
_VERTEX_M = 20.0
# The class a rebuilt road still has in the map; roads are narrowed where that leaves pavement outside the mask.
_NARROW_CLASS = 4
# Outdated roads: length, and the part of it that may lie this near to a true road's middle line.
_OUTDATED_M, _NEAR_M, _NEAR_PART, _TRIES = (60.0, 200.0), 12.0, 0.35, 100


@dataclass(frozen=True)
class MapFaults:
    """How wrong the map is: mean displacement, its correlation length L [m], and parts of the edges (0..1).

    ``narrowed`` is a part of the edges whose pavement is wider than a mask of class 4; ``outdated`` roads are as many
    as that part of all edges.

    Raises
        ValueError: a negative displacement, a length that is not positive, a part outside 0..1.
    """

    displacement_m: float = 1.7
    correlation_m: float = 150.0
    missing: float = 0.04
    outdated: float = 0.04
    narrowed: float = 0.15

    def __post_init__(self) -> None:
        if not (self.displacement_m >= 0 and self.correlation_m > 0):
            raise ValueError(
                f"MapFaults: expected displacement_m >= 0 and correlation_m > 0, got {self.displacement_m} and "
                f"{self.correlation_m}"
            )
        for name in ("missing", "outdated", "narrowed"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"MapFaults.{name}: expected a part in 0..1, got {getattr(self, name)}")


@dataclass(frozen=True, eq=False)
class MapErrors:
    """What was done to every edge of the map; for the truth only.

    source           (k,) edge of the true network, -1 for an outdated road that the world does not have.
    narrowed         (k,) whether class, lanes and width are those of a road that has been rebuilt since.
    displacement_m   (k, 2) mean displacement of the edge's vertices (map minus world).
    missing          edges of the true network that the map does not have.
    """

    source: Int[Array, "k"]
    narrowed: Bool[Array, "k"]
    displacement_m: Float[Array, "k 2"]
    missing: Int[Array, "m"]

    def __post_init__(self) -> None:
        freeze_fields(self)


class DisplacementField:
    """One realisation of the smooth displacement of the module's docstring, at any point."""

    def __init__(self, rng: np.random.Generator, faults: MapFaults) -> None:
        # Components: g_x, g_y, ln s / TAIL; random Fourier features of a Gaussian correlation.
        self._waves = rng.normal(0, 1 / faults.correlation_m, (2, 3 * _WAVES))
        self._phases = rng.uniform(0, 2 * np.pi, 3 * _WAVES)
        # E |s g| = exp(mu + TAIL² / 2) sqrt(pi / 2).
        self._scale = faults.displacement_m / (math.sqrt(math.pi / 2) * math.exp(TAIL**2 / 2))

    def __call__(self, xy: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
        cosines = np.cos(xy @ self._waves + self._phases).reshape(len(xy), 3, _WAVES)
        fields = math.sqrt(2 / _WAVES) * cosines.sum(axis=-1)
        return np.asarray(self._scale * np.exp(TAIL * fields[:, 2:]) * fields[:, :2])


def faulty_map(
    network: RoadNetwork, rng: np.random.Generator, faults: MapFaults | None = None
) -> tuple[RoadNetwork, MapErrors]:
    """(the map for estimators, what is wrong with it for the truth)."""
    faults = faults or MapFaults()
    n = len(network.edges)
    missing = np.sort(rng.permutation(n)[: round(faults.missing * n)])
    wide = np.flatnonzero([e.width_m > map_width_m(_NARROW_CLASS) for e in network.edges])
    narrowed = rng.permutation(wide)[: round(faults.narrowed * len(wide))]
    field = DisplacementField(rng, faults)
    source = np.setdiff1d(np.arange(n), missing)
    roads = [_narrow(network.edges[k]) if k in narrowed else network.edges[k] for k in source]
    ends = [tuple(network.ends[k]) for k in source]
    nodes = list(network.nodes_m)
    for start, road in _outdated(network, rng, round(faults.outdated * n)):
        roads.append(road)
        ends.append((start, len(nodes)))
        nodes.append(road.line_m[-1])
    added = np.full(len(roads) - len(source), -1)
    moved = [_move(road, field) for road in roads]
    errors = MapErrors(
        np.concatenate([source, added]),
        np.concatenate([np.isin(source, narrowed), np.zeros(len(added), bool)]),
        np.reshape([shift for _, shift in moved], (-1, 2)),
        missing,
    )
    return _network([road for road, _ in moved], np.reshape(ends, (-1, 2)).astype(int)), errors


def _network(roads: list[Road], ends: Int[Array, "k 2"]) -> RoadNetwork:
    """The network of roads that keep their order, with the nodes that are left."""
    kept, ends_kept = np.unique(ends, return_inverse=True)
    nodes = np.zeros((len(kept), 2))
    for road, (start, end) in zip(roads, ends_kept.reshape(-1, 2), strict=True):
        nodes[start], nodes[end] = road.line_m[0], road.line_m[-1]
    return RoadNetwork(tuple(roads), nodes, ends_kept.reshape(-1, 2))


def _narrow(road: Road) -> Road:
    """The road as it was: local, one lane a direction."""
    lanes = 1 if road.oneway else 2
    width = section(_NARROW_CLASS).paved_m(lanes)
    return replace(road, road_class=_NARROW_CLASS, lanes=lanes, width_m=width, parking_m=0.0)


def _move(road: Road, field: DisplacementField) -> tuple[Road, Float[Array, "2"]]:
    line = shapely.get_coordinates(shapely.segmentize(shapely.LineString(road.line_m), _VERTEX_M))
    shift = field(line)
    return replace(road, line_m=line + shift), shift.mean(axis=0)


def _outdated(network: RoadNetwork, rng: np.random.Generator, count: int) -> list[tuple[int, Road]]:
    """Local roads that leave nodes into the open, each with its node; fewer where there is no room left."""
    out: list[tuple[int, Road]] = []
    taken = shapely.union_all([shapely.LineString(e.line_m).buffer(_NEAR_M) for e in network.edges])
    for _ in range(_TRIES * count):
        if len(out) == count:
            break
        node = int(rng.integers(len(network.nodes_m)))
        bearing, bend = rng.uniform(0, 2 * np.pi), rng.uniform(-0.5, 0.5)
        s = np.linspace(0, rng.uniform(*_OUTDATED_M), 9)
        angle = bearing + bend * s / s[-1]
        line = network.nodes_m[node] + s[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        shape = shapely.LineString(line)
        if shape.intersection(taken).length < _NEAR_PART * shape.length:
            out.append((node, Road.standard(line, _NARROW_CLASS, 2, False)))
            taken = taken.union(shape.buffer(_NEAR_M))
    return out
