"""Road, markings, kerbs, verges, pavements and the land around, with or without a crossing road."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sim.model import Surface
from sim.textures import asphalt_texture, grass, paint_texture, slabs

Array = np.ndarray

KERB_M = 0.11
VERGE_M = 2.2
PAVEMENT_M = 4.2
_CORNER_M = 6.0
_SHOULDER_M = 0.45
_LINE_M = 0.14
_DASH_M, _CYCLE_M = 4.0, 12.0
_FAR_M = 260.0


@dataclass(frozen=True)
class Layout:
    """The street in the world frame: lanes [m], where it begins and ends along y, and where a road crosses it."""

    lanes: int
    lane_m: float
    begin_m: float
    end_m: float
    crossing_m: float | None

    @property
    def right_m(self) -> float:
        """x of the asphalt's right edge; the ego lane's centre is x = 0."""
        return self.lane_m / 2 + _SHOULDER_M

    @property
    def left_m(self) -> float:
        return self.lane_m / 2 - self.lanes * self.lane_m - _SHOULDER_M

    @property
    def crossing_half_m(self) -> float:
        return self.lane_m + _SHOULDER_M

    def near_crossing(self, y: float, margin_m: float) -> bool:
        """Whether y lies within the crossing road and a margin on both sides."""
        return self.crossing_m is not None and bool(abs(y - self.crossing_m) < self.crossing_half_m + margin_m)


def ground_surfaces(layout: Layout, rng: np.random.Generator) -> dict[str, Surface]:
    """Surfaces by name: road, markings, grass, pavement."""
    asphalt_cells, paint_cells = _road_cells(layout)
    blocks = _blocks(layout)
    kerbs = [_strip(b, [(0, -0.02), (0, KERB_M - 0.01), (0.02, KERB_M), (0.15, KERB_M)]) for b in blocks]
    verges = [_strip(b, [(0.15, KERB_M - 0.015), (VERGE_M, KERB_M)]) for b in blocks]
    paths = [_strip(b, [(VERGE_M, KERB_M), (VERGE_M, KERB_M + 0.02), (PAVEMENT_M, KERB_M + 0.02)]) for b in blocks]
    land = [_land(b) for b in blocks]
    return {
        "road": _textured(asphalt_cells, 12.0, asphalt_texture(rng), rng, 0.16, wheel_paths=layout),
        "markings": _textured(paint_cells, 4.0, paint_texture(rng), rng, 0.04),
        "grass": _textured(_joined(verges + land), 8.0, grass(rng), rng, 0.25),
        "pavement": _textured(_joined(kerbs + paths), 2.4, slabs(rng), rng, 0.12),
    }


_Mesh = tuple[Array, Array]


def _joined(meshes: list[_Mesh]) -> _Mesh:
    shift = np.cumsum([0] + [len(v) for v, _ in meshes[:-1]])
    return np.concatenate([v for v, _ in meshes]), np.concatenate(
        [f + s for (_, f), s in zip(meshes, shift, strict=True)]
    )


def _grid_faces(rows: int, columns: int) -> Array:
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
    a = i * columns + j
    b, c, d = a + 1, a + columns, a + columns + 1
    return np.stack([a, b, d, a, d, c], axis=-1).reshape(-1, 3)


def _cells(xs: Array, ys: Array, along_x: bool) -> tuple[Array, Array, Array]:
    """Grid in the road's own axes (across, along): vertices, faces (two per cell, row-major), cell centres."""
    s, t = np.meshgrid(xs, ys)
    flat = np.stack([s.ravel(), t.ravel(), np.zeros(s.size)], axis=-1)
    if along_x:
        flat = flat[:, [1, 0, 2]] * [1, -1, 1]
    centers = np.stack(np.meshgrid((xs[1:] + xs[:-1]) / 2, (ys[1:] + ys[:-1]) / 2), axis=-1).reshape(-1, 2)
    return flat, _grid_faces(len(ys), len(xs)), centers


def _painted(layout: Layout, s: Array, t: Array, right: float, left: float, stop: Array) -> Array:
    """Which cells at (across s, along t) carry white paint: edge lines, dashed lane lines, stop lines."""
    edge = (np.abs(s - right + _SHOULDER_M - 0.05) < _LINE_M / 2) | (
        np.abs(s - left - _SHOULDER_M + 0.05) < _LINE_M / 2
    )
    dash = np.mod(t + 2.0, _CYCLE_M) < _DASH_M
    lanes = round((right - left - 2 * _SHOULDER_M) / layout.lane_m)
    dividers = right - _SHOULDER_M - layout.lane_m * np.arange(1, lanes)
    divider = np.any(np.abs(s[:, None] - dividers) < _LINE_M / 2, axis=1) & dash
    stops = np.zeros(len(s), bool)
    for begin, end, low, high in stop:
        stops |= (t > begin) & (t < end) & (s > low) & (s < high)
    return np.asarray(edge | divider | stops)


def _road_axis(
    layout: Layout, right: float, left: float, begin: float, end: float, stop: Array, along_x: bool
) -> tuple[_Mesh, _Mesh]:
    """Asphalt and painted cells of one straight piece of road."""
    lanes = round((right - left - 2 * _SHOULDER_M) / layout.lane_m)
    centers = right - _SHOULDER_M - layout.lane_m * (np.arange(lanes) + 0.5)
    lines = [right - _SHOULDER_M + 0.05, left + _SHOULDER_M - 0.05]
    lines += list(right - _SHOULDER_M - layout.lane_m * np.arange(1, lanes))
    xs = np.unique(np.round(np.concatenate([[left, right], *[[x - _LINE_M / 2, x + _LINE_M / 2] for x in lines],
                                            centers - 0.8, centers, centers + 0.8]), 4))  # fmt: skip
    dashes = np.arange(np.floor(begin / _CYCLE_M) * _CYCLE_M, end + _CYCLE_M, _CYCLE_M) - 2.0
    ys = np.concatenate([dashes, dashes + _DASH_M, dashes + 8.0, stop[:, :2].ravel(), [begin, end]])
    ys = np.unique(np.round(ys[(ys >= begin) & (ys <= end)], 4))
    vertices, faces, at = _cells(xs, ys, along_x)
    paint = np.repeat(_painted(layout, at[:, 0], at[:, 1], right, left, stop), 2)
    return (vertices, faces[~paint]), (vertices, faces[paint])


def _road_cells(layout: Layout) -> tuple[_Mesh, _Mesh]:
    """Asphalt and paint of the street and, where there is one, of the crossing road and its rounded corners."""
    right, left = layout.right_m, layout.left_m
    none = np.zeros((0, 4))
    if layout.crossing_m is None:
        return _road_axis(layout, right, left, layout.begin_m, layout.end_m, none, False)
    half, c = layout.crossing_half_m, layout.crossing_m
    low, high = c - half - _CORNER_M, c + half + _CORNER_M
    middle = right - _SHOULDER_M - (layout.lanes + 1) // 2 * layout.lane_m
    before = np.array([[low - 0.5, low, middle, right - _SHOULDER_M]])
    after = np.array([[high, high + 0.5, left + _SHOULDER_M, middle]])
    pieces = [
        _road_axis(layout, right, left, layout.begin_m, low, before, False),
        _road_axis(layout, right, left, high, layout.end_m, after, False),
        _road_axis(layout, half - c, -half - c, -_FAR_M / 2, left - _CORNER_M, none, True),
        _road_axis(layout, half - c, -half - c, right + _CORNER_M, _FAR_M / 2, none, True),
    ]
    xs, ys = np.array([left - _CORNER_M, left, right, right + _CORNER_M]), np.array([low, c - half, c + half, high])
    vertices, faces, at = _cells(xs, ys, False)
    cross = ((at[:, 0] > left) & (at[:, 0] < right)) | (np.abs(at[:, 1] - c) < half)
    asphalt = [p[0] for p in pieces] + [(vertices, faces[np.repeat(cross, 2)])]
    asphalt += [
        _corner(x, y, sx, sy) for x, sx in ((left, -1), (right, 1)) for y, sy in ((c - half, -1), (c + half, 1))
    ]
    return _joined(asphalt), _joined([p[1] for p in pieces])


def _corner(x: float, y: float, sx: int, sy: int) -> _Mesh:
    """Asphalt between a square corner at (x, y) and the rounded kerb."""
    a = np.linspace(0, np.pi / 2, 9)
    arc = np.stack([x + sx * _CORNER_M * (1 - np.sin(a)), y + sy * _CORNER_M * (1 - np.cos(a)), 0 * a], axis=-1)
    vertices = np.concatenate([[[x, y, 0.0]], arc])
    j = np.arange(1, 9)
    faces = np.stack([np.zeros(8, int), j, j + 1], axis=-1)
    return vertices, faces if sx * sy > 0 else faces[:, ::-1]


@dataclass(frozen=True, eq=False)
class _Block:
    """A piece of land beside the street: kerb line (n, 2) with the land's inward normals, and its far corner."""

    line: Float[Array, "n 2"]
    inward: Float[Array, "n 2"]
    far: tuple[float, float]


def _blocks(layout: Layout) -> list[_Block]:
    blocks = []
    for x, sx in ((layout.right_m, 1.0), (layout.left_m, -1.0)):
        if layout.crossing_m is None:
            y = np.arange(layout.begin_m, layout.end_m + 4.0, 4.0)
            line = np.stack([np.full_like(y, x), y], axis=-1)
            inward = np.broadcast_to([sx, 0.0], line.shape)
            blocks.append(_Block(line, inward, (x + sx * _FAR_M, layout.end_m)))
            continue
        for sy, y_far in ((-1.0, layout.begin_m), (1.0, layout.end_m)):
            y_edge = layout.crossing_m + sy * layout.crossing_half_m
            ys = np.linspace(y_far, y_edge + sy * _CORNER_M, 24)[:-1]
            xs = np.linspace(x + sx * _CORNER_M, x + sx * _FAR_M / 2, 20)[1:]
            a = np.linspace(0, np.pi / 2, 9)
            arc = np.stack([x + sx * _CORNER_M * (1 - np.cos(a)), y_edge + sy * _CORNER_M * (1 - np.sin(a))], axis=-1)
            line = np.concatenate([np.stack([np.full_like(ys, x), ys], -1), arc, np.stack([xs, 0 * xs + y_edge], -1)])
            inward = np.concatenate([np.broadcast_to([sx, 0.0], (len(ys), 2)),
                                     np.stack([sx * np.cos(a), sy * np.sin(a)], -1),
                                     np.broadcast_to([0.0, sy], (len(xs), 2))])  # fmt: skip
            blocks.append(_Block(line, inward, (x + sx * _FAR_M, y_far)))
    return blocks


def _strip(block: _Block, profile: list[tuple[float, float]]) -> _Mesh:
    """A ribbon along the kerb line; profile (distance into the land, height)."""
    n, k = len(block.line), len(profile)
    p = np.asarray(profile)
    xy = block.line[:, None] + block.inward[:, None] * p[None, :, :1]
    vertices = np.concatenate([xy, np.broadcast_to(p[None, :, 1:], (n, k, 1))], axis=-1).reshape(-1, 3)
    faces = _grid_faces(n, k)
    a, b, c = vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]
    facing = np.cross(b - a, c - a)
    inward = np.repeat(block.inward, k, axis=0)[faces[:, 0]]
    outward = facing[:, 2] - np.sum(facing[:, :2] * inward, axis=1)
    return vertices, faces if outward.sum() > 0 else faces[:, ::-1]


def _land(block: _Block) -> _Mesh:
    """The ground from the pavement to the far corner, gently rolling far away."""
    x0 = block.line[0, 0] + block.inward[0, 0] * (PAVEMENT_M - 0.05)
    y0 = block.line[-1, 1] + block.inward[-1, 1] * (PAVEMENT_M - 0.05)
    out = block.inward[0, 0]
    steps = np.array([0, 1, 3, 6, 10, 15, 22, 30, 40, 55, 75, 100, 140, 200, _FAR_M - PAVEMENT_M])
    xs = np.sort(x0 + out * steps)
    span = block.far[1] - y0
    if abs(block.inward[-1, 1]) < 0.5:
        y0, span = block.line[0, 1], block.line[-1, 1] - block.line[0, 1]
    ys = np.sort(y0 + np.linspace(0, 1, max(int(abs(span) / 8), 2)) * span)
    vertices, faces, _ = _cells(xs, ys, False)
    vertices[:, 2] = KERB_M + np.clip((np.abs(vertices[:, 0] - x0) - 40) / 100, 0, 2) ** 2 * 1.5
    return vertices, faces


def _textured(
    mesh: _Mesh,
    tile_m: float,
    texture: Array,
    rng: np.random.Generator,
    variation: float,
    wheel_paths: Layout | None = None,
) -> Surface:
    """A surface textured from above (steep faces from the side), its brightness varied over tens of metres."""
    vertices, faces = mesh
    used, faces = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], faces.reshape(-1, 3)
    c = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, faces[:, k], c)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    uv = np.stack([vertices[:, 0] + vertices[:, 2], vertices[:, 1]], axis=-1) / tile_m
    tone = np.ones(len(vertices))
    for wavelength in (60.0, 23.0, 9.0):
        wave = rng.normal(0, 2 * np.pi / wavelength, 2)
        tone += variation / 3 * np.sin(vertices[:, :2] @ wave + rng.uniform(0, 6.3))
    if wheel_paths is not None:
        lane = np.mod(vertices[:, 0] + wheel_paths.lane_m / 2, wheel_paths.lane_m) - wheel_paths.lane_m / 2
        tone *= np.where(np.abs(np.abs(lane) - 0.8) < 0.05, 0.90, 1.0)
    color = np.clip(tone * 0.85, 0, 1)[:, None] * np.ones(3)
    return Surface(vertices, faces, normals, color, np.zeros(len(vertices)), uv, texture, cast_shadow=False)
