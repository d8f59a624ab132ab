"""Procedural towns: a bent, irregular grid of streets with main roads, a roundabout and a plaza."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from sim.roads.network import Road, RoadNetwork

Array = np.ndarray
Node = tuple[int, int]

# Irregularity as parts of a block: of the rows and columns, and of every crossing on top of it.
_ROW_JITTER, _NODE_JITTER = 0.12, 0.06
_TURN = np.deg2rad(20.0)
# Probabilities: a street left out between two crossings, a diagonal across a block, a street of one direction.
_GAP, _DIAGONAL, _ONEWAY = 0.10, 0.05, 0.25
# Largest bow [m] of a local street between two crossings.
_BOW_M = 3.0
_VERTEX_M = 8.0
_ROUNDABOUT_M = 20.0
_PARKING_M = 2.0
_FEWEST = 4


@dataclass(frozen=True)
class _Street:
    """What a whole row or column of the grid is."""

    road_class: int
    lanes: int
    oneway: bool
    name: str

    def along(self, line: Array) -> Road:
        parking = _PARKING_M if self.road_class == 4 else 0.0
        return Road.standard(line, self.road_class, self.lanes, self.oneway, self.name, parking)


def town(
    rng: np.random.Generator,
    *,
    size_m: tuple[float, float] = (900.0, 700.0),
    block_m: float = 110.0,
    centre_m: tuple[float, float] = (0.0, 0.0),
    roundabout: bool = True,
    plaza: bool = True,
) -> RoadNetwork:
    """A town of about ``size_m``, turned by up to 20 degrees; streets meet at junctions only.

    The middle row ("A ...") and column ("B ...") are main roads of four lanes (class 2), every third street collects
    (class 3), the others are local with parking strips at both kerbs (class 4), a quarter of them oneway. A
    ``roundabout`` lies where two collecting roads meet; a ``plaza`` is a local crossing left out with the streets
    around it.

    Raises
        ValueError: a size of fewer than four streets in a direction.
    """
    counts = tuple(round(s / block_m) + 1 for s in size_m)
    if min(counts) < _FEWEST:
        raise ValueError(
            f"town: size_m / block_m must give at least {_FEWEST} streets a direction, got {size_m} / {block_m} m"
        )
    points = _points(rng, counts, block_m) + centre_m
    # Streets along x are counted by rows, streets along y by columns.
    streets = [_streets(rng, n, letter) for n, letter in zip(counts[::-1], "AB", strict=True)]
    pieces = _pieces(rng, points, streets)
    kept = _thinned(rng, pieces, counts, _plaza(rng, streets) if plaza else None)
    roads = {key: pieces[key] for key in kept}
    ring: list[Road] = []
    if roundabout:
        ring = _roundabout(rng, roads, points, streets)
    return RoadNetwork.of([*roads.values(), *ring]).joined()


def _points(rng: np.random.Generator, counts: tuple[int, ...], block: float) -> Float[Array, "nx ny 2"]:
    """Crossings about the origin, in a turned, jittered grid."""
    x, y = (block * (np.arange(n) - (n - 1) / 2 + rng.uniform(-_ROW_JITTER, _ROW_JITTER, n)) for n in counts)
    p = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    p += block * rng.uniform(-_NODE_JITTER, _NODE_JITTER, p.shape)
    turn = rng.uniform(-_TURN, _TURN)
    c, s = np.cos(turn), np.sin(turn)
    return np.asarray(p @ np.array([[c, s], [-s, c]]))


def _streets(rng: np.random.Generator, n: int, letter: str) -> list[_Street]:
    middle = n // 2
    oneway = rng.random(n) < _ONEWAY
    out = []
    for k in range(n):
        name = f"{letter} {k + 1}"
        if k == middle:
            out.append(_Street(2, 4, False, name))
        elif abs(k - middle) % 3 == 2:
            out.append(_Street(3, 2, False, name))
        else:
            out.append(_Street(4, 1 if oneway[k] else 2, bool(oneway[k]), name))
    return out


def _pieces(
    rng: np.random.Generator, p: Float[Array, "nx ny 2"], streets: list[list[_Street]]
) -> dict[tuple[Node, Node], Road]:
    """Every street between two crossings that follow each other: smooth along the street, local ones bowed."""
    out: dict[tuple[Node, Node], Road] = {}
    for axis in (0, 1):
        # Tangents of a Catmull-Rom spline along the row or column.
        tangent = np.gradient(p, axis=axis)
        for i in range(p.shape[0] - (axis == 0)):
            for j in range(p.shape[1] - (axis == 1)):
                a, b = (i, j), (i + 1, j) if axis == 0 else (i, j + 1)
                street = streets[axis][j if axis == 0 else i]
                bow = rng.uniform(-_BOW_M, _BOW_M) if street.road_class == 4 else 0.0
                out[a, b] = street.along(_curve(p[a], p[b], tangent[a], tangent[b], bow))
    lane = _Street(4, 2, False, "diagonal")
    for i in range(p.shape[0] - 1):
        for j in range(p.shape[1] - 1):
            if rng.random() < _DIAGONAL:
                a, b = ((i, j), (i + 1, j + 1)) if rng.random() < 0.5 else ((i + 1, j), (i, j + 1))
                out[a, b] = lane.along(np.array([p[a], p[b]]))
    return out


def _curve(a: Array, b: Array, ta: Array, tb: Array, bow: float) -> Float[Array, "n 2"]:
    """Cubic Hermite from a to b, with a bow that leaves the ends' positions and directions alone."""
    span = np.hypot(*(b - a))
    u = np.linspace(0, 1, max(round(span / _VERTEX_M), 2) + 1)[:, None]
    line = (
        (1 + 2 * u) * (1 - u) ** 2 * a
        + u * (1 - u) ** 2 * ta
        + u**2 * (3 - 2 * u) * b
        + u**2 * (u - 1) * tb
        + bow * np.sin(np.pi * u) ** 2 * np.array([a[1] - b[1], b[0] - a[0]]) / span
    )
    line[0], line[-1] = a, b
    return np.asarray(line)


def _plaza(rng: np.random.Generator, streets: list[list[_Street]]) -> Node | None:
    """An inner crossing of two local streets."""
    local = [[k for k in range(1, len(s) - 1) if s[k].road_class == 4] for s in streets]
    found = [(i, j) for i in local[1] for j in local[0]]
    return found[rng.integers(len(found))] if found else None


def _thinned(
    rng: np.random.Generator, pieces: dict[tuple[Node, Node], Road], counts: tuple[int, ...], plaza: Node | None
) -> list[tuple[Node, Node]]:
    """The pieces without those at the plaza and some local ones, where no crossing becomes a dead end or is cut off."""
    kept = [key for key in pieces if plaza not in key]
    for key in [k for k in kept if pieces[k].road_class == 4 and rng.random() < _GAP]:
        rest = [k for k in kept if k != key]
        left = {node: sum(node in k for k in rest) for node in key}
        if min(left.values()) >= 3 and _connected(rest, counts):
            kept = rest
    return kept


def _connected(keys: list[tuple[Node, Node]], counts: tuple[int, ...]) -> bool:
    a, b = (np.array([k[side] for k in keys]) @ [counts[1], 1] for side in (0, 1))
    _, labels = connected_components(coo_array((np.ones(len(a)), (a, b)), shape=(counts[0] * counts[1],) * 2))
    return len(np.unique(labels[np.concatenate([a, b])])) == 1


def _roundabout(
    rng: np.random.Generator,
    roads: dict[tuple[Node, Node], Road],
    points: Float[Array, "nx ny 2"],
    streets: list[list[_Street]],
) -> list[Road]:
    """Shortens the arms at a crossing of collecting roads, in place, and returns the ring: oneway, to the left."""
    major = [[k for k in range(1, len(s) - 1) if s[k].road_class == 3] for s in streets]
    found = [(i, j) for i in major[1] for j in major[0]]
    if not found:
        return []
    node = found[rng.integers(len(found))]
    middle = points[node]
    arms = []
    for key in [k for k in roads if node in k]:
        line = np.array(roads[key].line_m if key[0] == node else roads[key].line_m[::-1])
        outside = int(np.argmax(np.hypot(*(line - middle).T) > _ROUNDABOUT_M))
        toward = (line[outside] - middle) / np.hypot(*(line[outside] - middle))
        line = np.concatenate([[middle + _ROUNDABOUT_M * toward], line[outside:]])
        roads[key] = replace(roads[key], line_m=line if key[0] == node else line[::-1])
        arms.append((np.arctan2(toward[1], toward[0]), line[0]))
    arms.sort(key=lambda arm: arm[0])
    ring = []
    for (a, begin), (b, end) in zip(arms, arms[1:] + arms[:1], strict=True):
        sweep = (b - a) % (2 * np.pi)
        angles = a + np.linspace(0, sweep, max(int(np.ceil(sweep * _ROUNDABOUT_M / 2.0)), 2) + 1)
        line = middle + _ROUNDABOUT_M * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        line[0], line[-1] = begin, end
        ring.append(Road(line, 3, 1, True, 6.0, "roundabout"))
    return ring
