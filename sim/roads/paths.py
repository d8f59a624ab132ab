"""Ways through a network: each lane with the lanes that follow it, joined smoothly across the junctions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from sim.archive import freeze_fields
from sim.roads.lanes import Lane, setbacks
from sim.roads.network import RoadNetwork, along, distinct

Array = np.ndarray

# A lane goes on into one that turns by less than this.
_SHARPEST = np.deg2rad(115.0)
# A lane of another number or class costs as much as this much turning [rad].
_OTHER_NUMBER, _OTHER_CLASS = 0.2, 0.3
# At a node that is no junction the corner is rounded from this far off; spacing of the vertices across a junction.
_ROUNDING_M, _VERTEX_M = 3.0, 1.0


@dataclass(frozen=True, eq=False)
class Paths:
    """Polylines one behind the other: path k has the vertices ``first[k]`` to ``first[k + 1]`` and begins on lane k.

    ``stations_m`` begin with 0 at every path's first vertex; ``lane_m`` is the length that lies on the path's own lane;
    ``after`` the lane that follows it, -1 where none does.
    """

    vertices_m: Float[Array, "v 2"]
    stations_m: Float[Array, "v"]
    first: Int[Array, "_"]
    lane_m: Float[Array, "p"]
    after: Int[Array, "p"]

    def __post_init__(self) -> None:
        freeze_fields(self)

    @cached_property
    def length_m(self) -> Float[Array, "p"]:
        return np.asarray(self.stations_m[self.first[1:] - 1])

    @cached_property
    def _begin(self) -> Float[Array, "p"]:
        """Where every path begins on one common axis, all a metre apart: one interpolation serves all."""
        return np.concatenate([[0.0], np.cumsum(self.length_m + 1.0)[:-1]])

    @cached_property
    def _axis(self) -> Float[Array, "v"]:
        return np.asarray(self.stations_m + np.repeat(self._begin, np.diff(self.first)))

    def at(self, path: Int[Array, "n"], station_m: Float[Array, "n"]) -> Float[Array, "n 2"]:
        """Points at stations of paths; before the beginning and after the end, the end points."""
        s = self._begin[path] + np.clip(station_m, 0.0, self.length_m[path])
        return np.stack([np.interp(s, self._axis, self.vertices_m[:, k]) for k in (0, 1)], axis=-1)


def paths(network: RoadNetwork, lanes: Sequence[Lane], longest_m: float) -> Paths:
    """From every lane on the way through its successors, until ``longest_m`` lie behind the lane or no lane follows.

    The successor of a lane leaves the node where it ends, turning least; other lane numbers and classes count as a
    turn. Across a junction, from pavement to pavement, a way is a cubic that keeps both directions.
    """
    cores = [_core(lane, free) for lane, free in zip(lanes, _free(network, lanes), strict=True)]
    after = _successors(network, lanes, cores)
    joints = {k: _joint(cores[k], cores[n]) for k, n in enumerate(after) if n >= 0}
    lines, own = [], []
    for k, core in enumerate(cores):
        parts, lane, behind = [core], k, 0.0
        while after[lane] >= 0 and behind < longest_m:
            following = cores[after[lane]]
            parts += [joints[lane], following]
            behind += _length(joints[lane]) + _length(following)
            lane = after[lane]
        lines.append(distinct(np.concatenate(parts)))
        own.append(_length(core))
    stations = [np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))]) for line in lines]
    first = np.concatenate([[0], np.cumsum([len(line) for line in lines], dtype=int)])
    vertices = np.concatenate([np.zeros((0, 2)), *lines])
    return Paths(vertices, np.concatenate([np.zeros(0), *stations]), first, np.array(own), np.array(after, int))


def _free(network: RoadNetwork, lanes: Sequence[Lane]) -> list[tuple[float, float]]:
    """Length at the beginning and end of every lane that belongs to the joints."""
    back = np.where(network.degree[network.ends] > 1, np.maximum(setbacks(network), _ROUNDING_M), 0.0)
    out = []
    for lane in lanes:
        a, b = back[lane.edge] if lane.forward else back[lane.edge][::-1]
        # Something is left of every lane.
        shrink = min(1.0, 0.9 * _length(lane.line_m) / max(a + b, 1e-9))
        out.append((float(a * shrink), float(b * shrink)))
    return out


def _core(lane: Lane, free: tuple[float, float]) -> Float[Array, "n 2"]:
    stations = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(lane.line_m, axis=0).T))])
    begin, end = free[0], stations[-1] - free[1]
    ends = along(lane.line_m, np.array([begin, end]))[0]
    inner = lane.line_m[(stations > begin + 0.01) & (stations < end - 0.01)]
    return np.concatenate([ends[:1], inner, ends[1:]])


def _successors(network: RoadNetwork, lanes: Sequence[Lane], cores: list[Array]) -> list[int]:
    leaving: dict[int, list[int]] = {}
    for k, lane in enumerate(lanes):
        leaving.setdefault(int(network.ends[lane.edge][0 if lane.forward else 1]), []).append(k)
    out = []
    for k, lane in enumerate(lanes):
        node = int(network.ends[lane.edge][1 if lane.forward else 0])
        arriving, cls = _direction(cores[k], -1), network.edges[lane.edge].road_class
        best, found = _SHARPEST, -1
        for n in leaving.get(node, []):
            other = lanes[n]
            turn = abs((_direction(cores[n], 0) - arriving + np.pi) % (2 * np.pi) - np.pi)
            cost = turn + _OTHER_NUMBER * abs(other.number - lane.number)
            cost += _OTHER_CLASS * abs(network.edges[other.edge].road_class - cls)
            if turn < _SHARPEST and (found < 0 or cost < best) and other.edge != lane.edge:
                best, found = cost, n
        out.append(found)
    return out


def _direction(line: Array, at: int) -> float:
    d = line[-1] - line[-2] if at == -1 else line[1] - line[0]
    return float(np.arctan2(d[1], d[0]))


def _joint(line: Array, following: Array) -> Float[Array, "n 2"]:
    """Inner vertices and ends of a cubic from the end of one line to the beginning of the other."""
    a, b = line[-1], following[0]
    span = float(np.hypot(*(b - a)))
    directions = [(line[-1] - line[-2]), (following[1] - following[0])]
    ta, tb = (span * d / np.hypot(*d) for d in directions)
    u = np.linspace(0, 1, max(round(span / _VERTEX_M), 1) + 1)[:, None]
    curve = (1 + 2 * u) * (1 - u) ** 2 * a + u * (1 - u) ** 2 * ta + u**2 * (3 - 2 * u) * b + u**2 * (u - 1) * tb
    return np.asarray(curve)


def _length(line: Array) -> float:
    return float(np.hypot(*np.diff(line, axis=0).T).sum())
