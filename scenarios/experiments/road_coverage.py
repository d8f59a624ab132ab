"""How far points lie from roads: what a mask of the roads holds at any margin, without drawing it.

A point is in the mask of a road if it is no farther from its line than half its width and the margin
(`estimators.aerial.road_mask`); the least distance over all roads, less half the width, is its clearance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Float, Int

from sim.aerial_traffic import Traffic
from sim.roads import Road, RoadNetwork, map_width_m

Array = np.ndarray
REACH_M = 6.0
"""Clearances beyond it are not looked for."""
# Area of pavement that one point stands for.
_AREA_M2 = 8.0


class Strips:
    """Roads as strips along their lines."""

    def __init__(self, roads: Sequence[Road], width_m: Sequence[float]) -> None:
        self.half = np.asarray(width_m, float) / 2
        self.lines = np.array([shapely.LineString(road.line_m) for road in roads])
        self._tree = shapely.STRtree(self.lines)

    @staticmethod
    def mask(network: RoadNetwork) -> Strips:
        """Roads of a map by their RAS-Q widths, without a margin."""
        widths = [map_width_m(r.road_class, r.oneway, 0.0) for r in network.edges]
        return Strips(network.edges, widths)

    @staticmethod
    def pavement(network: RoadNetwork) -> Strips:
        """Roads of the world from kerb to kerb."""
        return Strips(network.edges, [r.width_m for r in network.edges])

    def clearance(self, points: Array) -> tuple[Float[Array, "n"], Int[Array, "n"]]:
        """Distance [m] of shapely's points (n,) from the nearest strip, negative inside, and which strip it is.

        Infinite and -1 beyond `REACH_M`.
        """
        out, road = np.full(len(points), np.inf), np.full(len(points), -1)
        reach = REACH_M + float(self.half.max(initial=0.0))
        point, line = self._tree.query(points, predicate="dwithin", distance=reach)
        distance = shapely.distance(points[point], self.lines[line]) - self.half[line]
        order = np.argsort(-distance)  # the least is written last
        out[point[order]], road[point[order]] = distance[order], line[order]
        far = out > REACH_M
        out[far], road[far] = np.inf, -1
        return out, road


@dataclass(frozen=True, eq=False)
class PavementSamples:
    """Points spread evenly over pavement: place, the edge it belongs to, and the edge's direction there."""

    xy: Float[Array, "n 2"]
    edge: Int[Array, "n"]
    direction: Float[Array, "n 2"]

    def of(self, chosen: Array) -> PavementSamples:
        return PavementSamples(self.xy[chosen], self.edge[chosen], self.direction[chosen])


def pavement_samples(network: RoadNetwork, rng: np.random.Generator) -> PavementSamples:
    """One random point to every 8 m² of every road."""
    xy, direction = [], []
    counts = [max(round(r.length_m * r.width_m / _AREA_M2), 1) for r in network.edges]
    for road, n in zip(network.edges, counts, strict=True):
        at, ahead = road.at(rng.uniform(0, road.length_m, n))
        left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
        xy.append(at + rng.uniform(-0.5, 0.5, (n, 1)) * road.width_m * left)
        direction.append(ahead)
    edge = np.repeat(np.arange(len(counts)), counts)
    return PavementSamples(np.concatenate(xy), edge, np.concatenate(direction))


def vehicle_points(traffic: Traffic) -> Float[Array, "m 5 2"]:
    """Middle and the four corners of every vehicle that is there at t = 0."""
    state = traffic.at(0.0)
    there = np.flatnonzero(state.present)
    ahead = state.direction[there]
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
    length, width = traffic.size_m[there, :2].T[..., None] / 2
    corners = [a * length * ahead + b * width * left for a in (-1, 1) for b in (-1, 1)]
    return np.asarray(state.centre_m[there][:, None] + np.stack([np.zeros_like(ahead), *corners], axis=1))
