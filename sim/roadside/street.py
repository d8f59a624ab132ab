"""Puts the static street together: what stands where."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sim.meshes.solid import Part, merged, surface
from sim.model import Model, Surface
from sim.pose import Pose, rot_z
from sim.roadside.buildings import facade_atlas, house
from sim.roadside.furniture import bin_, delineator, guard_rail, lamp_post, sign, sign_atlas
from sim.roadside.ground import KERB_M, PAVEMENT_M, VERGE_M, Layout, ground_surfaces
from sim.roadside.trees import bush, conifer, tree, wood_edge, wooded_hills
from sim.textures import leaves

Array = np.ndarray
_PATH_Z = KERB_M + 0.02


def build_roadside(
    rng: np.random.Generator,
    length_m: float = 160.0,
    lanes: int = 2,
    lane_m: float = 3.5,
    crossing_y: float | None = None,
    behind_m: float = 40.0,
    houses: bool = True,
) -> list[tuple[str, Model, Pose]]:
    """The static world from ``y = -behind_m`` to ``length_m`` as (name, model, pose), deterministic in ``rng``.

    ``lanes`` are counted from the ego lane to the left. ``crossing_y`` adds a crossing road of two lanes there.
    ``houses=False`` puts woods in their place.

    Raises
        ValueError: a length or width that is not positive, or no lane.
    """
    if not (length_m > 0 and lane_m > 0 and behind_m >= 0):
        raise ValueError(f"length_m, lane_m, behind_m: expected > 0, got {length_m}, {lane_m}, {behind_m}")
    if lanes < 1:
        raise ValueError(f"lanes: expected at least 1, got {lanes}")
    layout = Layout(lanes, lane_m, -behind_m, length_m + 60.0, crossing_y)
    streams = dict(zip(("ground", "houses", "trees", "furniture", "hills"), rng.spawn(5), strict=True))
    out = [("ground", _model("ground", ground_surfaces(layout, streams["ground"]).values()))]
    plots = _plots(layout, length_m, streams["houses"]) if houses else []
    if plots:
        out.append(("houses", _model("houses", [_houses(plots, streams["houses"])])))
    foliage = leaves(streams["hills"])
    out.append(("trees", _model("trees", [_trees(layout, length_m, plots, foliage, streams["trees"])])))
    out.append(("furniture", _model("furniture", [_furniture(layout, length_m, plots, streams["furniture"])])))
    out.append(("hills", _model("hills", [_hills(layout, foliage, streams["hills"])])))
    return [(name, model, Pose.identity()) for name, model in out]


def _model(name: str, surfaces: Iterable[Surface]) -> Model:
    surfaces = tuple(surfaces)
    shift = np.cumsum([0] + [len(s.vertices) for s in surfaces[:-1]])
    vertices = np.concatenate([s.vertices for s in surfaces])
    faces = np.concatenate([s.faces + k for s, k in zip(surfaces, shift, strict=True)])
    size = vertices.max(axis=0) - vertices.min(axis=0)
    return Model(name, (surfaces,), (), vertices, faces, (float(size[0]), float(size[1]), float(size[2])))


class _Plot:
    """A house to build: which facade, which side (+1 right, -1 left), y range, x of its front and depth."""

    def __init__(self, facade: int, side: int, y: tuple[float, float], front: float, bays_deep: int) -> None:
        self.facade, self.side, self.y, self.front, self.bays_deep = facade, side, y, front, bays_deep


def _plots(layout: Layout, length_m: float, rng: np.random.Generator) -> list[_Plot]:
    """Rows of houses on both sides, with gaps and clear of the crossing; widths are bounded, not yet known."""
    plots = []
    for side, edge in ((1, layout.right_m), (-1, layout.left_m)):
        y = layout.begin_m + rng.uniform(2, 10)
        while y < length_m - 5:
            width = 18.5
            if layout.near_crossing(y + width / 2, width / 2 + PAVEMENT_M + 2.0):
                y += 3.0
                continue
            front = edge + side * (PAVEMENT_M + rng.uniform(1.5, 6.5))
            plots.append(_Plot(int(rng.integers(6)), side, (y, y + width), front, int(rng.integers(3, 5))))
            y += width + (rng.uniform(0.5, 3) if rng.random() < 0.55 else rng.uniform(8, 16))
    return plots


def _houses(plots: list[_Plot], rng: np.random.Generator) -> Surface:
    texture, facades = facade_atlas(rng)
    parts = []
    for plot in plots:
        part = house(facades[plot.facade], int(rng.integers(2)), plot.bays_deep, rng)
        R = rot_z(-np.pi / 2 if plot.side > 0 else np.pi / 2)
        y = plot.y[1] if plot.side > 0 else plot.y[0]
        parts.append(part.placed(R, np.array([plot.front, y, KERB_M - 0.02])))
    return surface(merged(parts), texture, crease_rad=np.deg2rad(20), repeat=False)


def _free(plots: list[_Plot], x: float, y: float, margin: float) -> bool:
    """Whether (x, y) is clear of every house."""
    for p in plots:
        deep = p.front + p.side * 14.0
        if p.y[0] - margin < y < p.y[1] + margin and min(p.front, deep) - margin < x < max(p.front, deep) + margin:
            return False
    return True


def _trees(layout: Layout, length_m: float, plots: list[_Plot], foliage: Array, rng: np.random.Generator) -> Surface:
    parts: list[Part] = []
    clear = PAVEMENT_M + 2.0
    for side, edge in ((1, layout.right_m), (-1, layout.left_m)):
        for y in np.arange(4.0, length_m, 17.0):
            at = y + rng.uniform(-3, 3)
            x = edge + side * (0.55 * VERGE_M + rng.uniform(-0.2, 0.2))
            if rng.random() < 0.75 and not layout.near_crossing(at, 9.0):
                parts.append(tree((x, at, KERB_M), rng.uniform(8.5, 10), 1.0 if at < 50 else 0.45, rng, stem=0.5))
        for _ in range(30 if plots else 12):
            x, at = edge + side * rng.uniform(clear + 1, 75 if plots else clear + 3), rng.uniform(-5, length_m + 50)
            if layout.near_crossing(at, clear) or not _free(plots, x, at, 3.0):
                continue
            near = abs(x) < 22 and at < 60
            kind = conifer if rng.random() < 0.3 else tree
            z = KERB_M + max((abs(x - edge) - PAVEMENT_M - 40) / 100, 0) ** 2 * 1.5
            parts.append(kind((x, at, z), rng.uniform(8, 16), 0.7 if near else 0.3, rng))
        for _ in range(26):
            x, at = edge + side * (PAVEMENT_M + rng.uniform(0.6, 1.3)), rng.uniform(0, length_m)
            if _free(plots, x, at, 0.7) and not layout.near_crossing(at, 8.0):
                parts.append(bush((x, at, KERB_M), rng.uniform(0.8, 1.6), 1.0 if at < 60 else 0.4, rng))
    parts += _end_of_street(layout, length_m, rng)
    if not plots:
        parts += _woods(layout, rng)
    return surface(merged(parts), foliage, crease_rad=np.deg2rad(60))


def _woods(layout: Layout, rng: np.random.Generator) -> list[Part]:
    """The edges of the woods along the street and the crossing road."""
    back = PAVEMENT_M + 4.5
    parts = []
    for x, sx in ((layout.right_m + back, 1.0), (layout.left_m - back, -1.0)):
        if layout.crossing_m is None:
            spans = [(np.array([x, layout.begin_m]), np.array([x, layout.end_m]))]
            corners = []
        else:
            reach = layout.crossing_half_m + back
            corners = [np.array([x, layout.crossing_m - reach]), np.array([x, layout.crossing_m + reach])]
            spans = [(np.array([x, layout.begin_m]), corners[0]), (corners[1], np.array([x, layout.end_m]))]
        parts += [_wood(a, b, np.array([-sx, 0.0]), rng) for a, b in spans]
        for corner, sy in zip(corners, (1.0, -1.0), strict=False):
            parts.append(_wood(corner, corner + np.array([sx * 120.0, 0.0]), np.array([0.0, sy]), rng))
    return parts


def _wood(a: Array, b: Array, toward: Array, rng: np.random.Generator) -> Part:
    steps = max(round(float(np.hypot(*(b - a))) / 2.5), 2)
    line = np.linspace(a, b, steps)
    return wood_edge(line, np.broadcast_to(toward, line.shape), KERB_M, rng)


def _end_of_street(layout: Layout, length_m: float, rng: np.random.Generator) -> list[Part]:
    """The wood in which the street and the crossing road disappear."""
    parts = []
    middle = (layout.right_m + layout.left_m) / 2
    for x in np.arange(-70.0, 75.0, 7.0):
        for row in range(2):
            at = (middle + x + rng.uniform(-2, 2), length_m + 68 + 9 * row + rng.uniform(-3, 3), KERB_M)
            parts.append((conifer if rng.random() < 0.35 else tree)(at, rng.uniform(9, 17), 0.18, rng))
    return parts


def _furniture(layout: Layout, length_m: float, plots: list[_Plot], rng: np.random.Generator) -> Surface:
    parts: list[Part] = []
    right, left = layout.right_m, layout.left_m
    kinds = ["limit", "priority", "town", "warning", "arrow", "limit"]
    for k, y in enumerate(np.arange(16.0, length_m, 24.0)):
        if not layout.near_crossing(y, 16.0):
            parts.append(sign(kinds[k % len(kinds)], (right + 1.5 + 0.3 * rng.random(), y, KERB_M)))
        back = sign("limit" if k % 2 else "warning", (0.0, 0.0, KERB_M))
        if k % 2 and not layout.near_crossing(y + 6, 7.0):
            parts.append(back.placed(rot_z(np.pi), np.array([left - 1.5, y + 6, 0.0])))
    if layout.crossing_m is not None:
        c, reach = layout.crossing_m, layout.crossing_half_m + 7.5
        parts.append(sign("priority", (right + 1.2, c - reach, KERB_M)))
        parts.append(
            sign("yield", (0.0, 0.0, KERB_M)).placed(rot_z(np.pi / 2), np.array([right + 8.0, c + reach - 5, 0]))
        )
        parts.append(
            sign("yield", (0.0, 0.0, KERB_M)).placed(rot_z(-np.pi / 2), np.array([left - 8.0, c - reach + 5, 0]))
        )
    for k, y in enumerate(np.arange(10.0, length_m, 28.0)):
        if not layout.near_crossing(y, 6.0):
            side = 1 if k % 2 else -1
            x = right + 0.5 if side > 0 else left - 0.5
            parts.append(lamp_post((x, y, KERB_M), -side))
    for y in np.arange(3.0, length_m + 40, 25.0):
        for x in (right + 0.45, left - 0.45):
            if not layout.near_crossing(y, 7.0):
                parts.append(delineator((x, y, KERB_M)))
    parts.append(guard_rail(left - 0.75, max(length_m - 60, 60.0), length_m + 40, KERB_M, 1.0))
    for p in plots:
        if rng.random() < 0.6:
            color = [(0.06, 0.06, 0.07), (0.05, 0.12, 0.30), (0.25, 0.17, 0.08)][int(rng.integers(3))]
            parts.append(bin_((p.front - p.side * 0.6, p.y[0] + rng.uniform(1, 8), KERB_M), color))
    return surface(merged(parts), sign_atlas(rng), repeat=False)


def _hills(layout: Layout, foliage: Array, rng: np.random.Generator) -> Surface:
    part = wooded_hills((0.0, layout.end_m / 2), 240.0, rng)
    return surface(part, foliage, crease_rad=np.deg2rad(70))
