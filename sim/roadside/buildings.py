"""Houses with painted facades: windows, doors, several storeys, tiled roofs; one texture for all of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from sim.meshes.solid import Part, box, merged, plain
from sim.textures import Board, Color, noise, to_texture

Array = np.ndarray

_SIZE = 2048
_FACADE_ROWS, _FACADE_PX = 3, 540
_ROOF_PX = _SIZE - _FACADE_ROWS * _FACADE_PX
_ROOF_M = (14.0, 5.8)


@dataclass(frozen=True)
class Facade:
    """A painted house front: bays and storeys [count, m], and its place on the texture (column, row)."""

    bays: int
    bay_m: float
    storeys: int
    storey_m: float
    place: tuple[int, int]

    @property
    def size_m(self) -> tuple[float, float]:
        return self.bays * self.bay_m, self.storeys * self.storey_m + 0.6

    def uv(self, a: Array, b: Array) -> Array:
        """Texture coordinates of (a along the front, b up) [m]."""
        w, h = self.size_m
        x0, y0 = self.place[0] * _SIZE / 2, self.place[1] * _FACADE_PX
        u = (x0 + 2 + np.clip(a / w, 0, 1) * (_SIZE / 2 - 4)) / _SIZE
        v = 1 - (y0 + 2 + np.clip(1 - b / h, 0, 1) * (_FACADE_PX - 4)) / _SIZE
        return np.stack([u, v], axis=-1)


_WALLS: tuple[Color, ...] = (
    (0.80, 0.76, 0.66), (0.62, 0.36, 0.27), (0.84, 0.83, 0.80), (0.72, 0.60, 0.42), (0.55, 0.57, 0.58),
    (0.78, 0.68, 0.60),
)  # fmt: skip


def facade_atlas(rng: np.random.Generator) -> tuple[UInt8[Array, "h w 3"], tuple[Facade, ...]]:
    """The texture of all houses and what is where on it; the lowest stripe holds two roofs."""
    image = np.full((_SIZE, _SIZE, 3), 0.5, np.float32)
    facades = []
    for k, wall in enumerate(_WALLS):
        place = (k % 2, k // 2)
        f = Facade(
            int(rng.integers(4, 7)), rng.uniform(2.3, 3.0), int(rng.integers(2, 4)), rng.uniform(2.7, 3.2), place
        )
        x0, y0 = place[0] * _SIZE // 2, place[1] * _FACADE_PX
        part = image[y0 : y0 + _FACADE_PX, x0 : x0 + _SIZE // 2]
        w, h = f.size_m
        scale = (part.shape[1] - 4) / w, (part.shape[0] - 4) / h
        _paint_facade(Board(part, (2, part.shape[0] - 2), (scale[0], -scale[1])), f, wall, brick=k == 1, rng=rng)
        facades.append(f)
    for k, color in enumerate(((0.45, 0.20, 0.14), (0.26, 0.26, 0.28))):
        part = image[-_ROOF_PX:, k * _SIZE // 2 : (k + 1) * _SIZE // 2]
        _paint_roof(part, color, rng)
    grain = np.tile(0.022 * noise((1024, 1024), 0.7, rng) + 0.020 * noise((1024, 1024), 2.2, rng), (2, 2))
    return to_texture(image * (1 + grain)[..., None]), tuple(facades)


def _paint_facade(b: Board, f: Facade, wall: Color, brick: bool, rng: np.random.Generator) -> None:
    w, h = f.size_m
    b.image[:] = wall
    if brick:
        for z in np.arange(0, h, 0.16):
            b.rect(0, z, w, 0.03, (0.58, 0.47, 0.40), 0.6)
    dark = (0.55 * wall[0], 0.55 * wall[1], 0.55 * wall[2])
    b.rect(0, 0, w, 0.5, dark)
    b.rect(0, h - 0.25, w, 0.25, (0.45, 0.40, 0.36))
    frame: Color = (0.86, 0.86, 0.84) if rng.random() < 0.7 else (0.30, 0.20, 0.13)
    shutters = rng.random() < 0.4
    door = int(rng.integers(0, f.bays))
    window_w, window_h = 0.44 * f.bay_m, 0.50 * f.storey_m
    for storey in range(f.storeys):
        if storey:
            b.rect(0, storey * f.storey_m + 0.22, w, 0.09, dark, 0.5)
        for bay in range(f.bays):
            x = (bay + 0.5) * f.bay_m
            if storey == 0 and bay == door:
                _paint_door(b, x, rng)
                continue
            _paint_window(b, x - window_w / 2, storey * f.storey_m + 0.95, window_w, window_h, frame, shutters, rng)
    b.rect(0.04, 0, 0.09, h, (0.40, 0.40, 0.40))
    for _ in range(14):
        x, z = rng.uniform(0, w), rng.uniform(0, h)
        b.rect(x, z - rng.uniform(0.3, 1.2), rng.uniform(0.03, 0.12), rng.uniform(0.3, 1.2), dark, 0.10)


def _paint_window(
    b: Board, x: float, z: float, w: float, h: float, frame: Color, shutters: bool, rng: np.random.Generator
) -> None:
    b.rect(x - 0.10, z - 0.12, w + 0.20, 0.10, (0.70, 0.68, 0.64))
    b.rect(x - 0.07, z - 0.03, w + 0.14, h + 0.12, (0.22, 0.20, 0.18))
    b.rect(x - 0.05, z, w + 0.10, h + 0.05, frame)
    glass: Color = (0.12, 0.15, 0.18)
    pane = (w - 0.15) / 2
    for k in range(2):
        x0 = x + 0.05 + k * (pane + 0.05)
        b.rect(x0, z + 0.05, pane, h - 0.08, glass)
        shine = rng.uniform(0.1, 0.5)
        b.poly([(x0, z + 0.05 + shine * h), (x0 + pane, z + 0.05 + (shine - 0.2) * h), (x0 + pane, z + h - 0.03),
                (x0, z + h - 0.03)], (0.34, 0.42, 0.50), 0.7)  # fmt: skip
        if rng.random() < 0.5:
            b.rect(x0, z + 0.05, pane * rng.uniform(0.2, 0.45), h - 0.08, (0.72, 0.70, 0.66), 0.6)
    if rng.random() < 0.25:
        drop = float(h * rng.uniform(0.2, 0.7))
        b.rect(x + 0.02, z + h - drop, w - 0.04, drop, (0.68, 0.67, 0.62))
        for slat in np.arange(0, drop, 0.07):
            b.rect(x + 0.02, z + h - drop + slat, w - 0.04, 0.015, (0.45, 0.44, 0.42))
    if shutters:
        for side in (x - 0.46, x + w + 0.08):
            b.rect(side, z - 0.02, 0.38, h + 0.06, (0.20, 0.30, 0.24))
            for slat in np.arange(0.05, h, 0.09):
                b.rect(side + 0.04, z + slat, 0.30, 0.03, (0.13, 0.20, 0.16))


def _paint_door(b: Board, x: float, rng: np.random.Generator) -> None:
    color: Color = tuple(np.asarray(_DOORS)[rng.integers(len(_DOORS))])
    b.rect(x - 0.65, 0, 1.3, 2.35, (0.74, 0.72, 0.68))
    b.rect(x - 0.52, 0.12, 1.04, 2.1, color)
    b.rect(x - 0.32, 1.3, 0.64, 0.7, (0.14, 0.17, 0.19))
    b.rect(x - 0.38, 0.3, 0.76, 0.8, (0.7 * color[0], 0.7 * color[1], 0.7 * color[2]))
    b.disc((x + 0.42, 1.1), 0.04, (0.8, 0.75, 0.5))
    b.rect(x - 0.8, 0, 1.6, 0.13, (0.62, 0.61, 0.59))


_DOORS = ((0.30, 0.16, 0.10), (0.12, 0.22, 0.30), (0.16, 0.26, 0.18), (0.45, 0.44, 0.42))


def _paint_roof(part: Array, color: Color, rng: np.random.Generator) -> None:
    """Rows of overlapping tiles, each of its own shade."""
    h, w, _ = part.shape
    course, tile = round(0.34 / _ROOF_M[1] * h), round(0.24 / _ROOF_M[0] * w)
    shade = rng.normal(1, 0.09, (h // course + 1, w // tile + 2))
    rows, columns = np.arange(h)[:, None], np.arange(w)[None, :]
    row = rows // course
    column = (columns + (row % 2) * (tile // 2)) // tile
    groove = (columns + (row % 2) * (tile // 2)) % tile < 2
    light = shade[row, column] * (1 - 0.45 * (rows % course > course - 4)) * (1 - 0.18 * groove)
    part[:] = light[..., None] * np.asarray(color, np.float32)


def house(facade: Facade, roof: int, depth_bays: int, rng: np.random.Generator) -> Part:
    """A house whose front stands on the x axis from 0 to its width and looks toward -y; the ridge runs along x."""
    w, h = facade.size_m
    d = depth_bays * facade.bay_m
    rise = rng.uniform(0.32, 0.48) * d
    walls = [
        _wall(facade, (0, 0), (w, 0), h), _wall(facade, (w, 0), (w, d), h),
        _wall(facade, (w, d), (0, d), h), _wall(facade, (0, d), (0, 0), h),
    ]  # fmt: skip
    gables = []
    for x, order in ((0.0, [0, 2, 1]), (w, [0, 1, 2])):
        vertices = np.array([[x, 0, h], [x, d, h], [x, d / 2, h + rise]])
        gables.append(
            plain(vertices, np.array([order]), uv=facade.uv(np.array(0.5 * facade.bay_m - 0.9), np.array(h - 0.45)))
        )
    parts = [*walls, *gables, _roof(w, d, h, rise, roof)]
    chimney = plain(*box((0.3 * w, 0.55 * d, h + 0.5 * rise), (0.3 * w + 0.7, 0.55 * d + 0.6, h + rise + 0.8)),
                    color=(0.55, 0.45, 0.4), uv=facade.uv(np.array(0.3), np.array(0.8)))  # fmt: skip
    boxes = [box((-0.2, y, h - 0.06), (w + 0.2, y + 0.14, h + 0.05)) for y in (-0.40, d + 0.26)]
    gutter = [plain(*b, color=(0.4, 0.4, 0.42), uv=_roof_uv(1, 0.5, 0.5)) for b in boxes]
    return merged([*parts, chimney, *gutter])


def _wall(facade: Facade, a: tuple[float, float], b: tuple[float, float], h: float) -> Part:
    length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
    vertices = np.array([[*a, 0], [*b, 0], [*b, h], [*a, h]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    at = np.array([[0, 0], [length, 0], [length, h], [0, h]])
    part = plain(vertices, faces)
    return Part(part.vertices, part.faces, facade.uv(at[:, 0], at[:, 1])[faces], part.color, part.gloss)


def _roof_uv(roof: int, a: float, b: float) -> tuple[float, float]:
    u = (roof * _SIZE / 2 + 3 + min(a, 1) * (_SIZE / 2 - 6)) / _SIZE
    return u, (3 + min(b, 1) * (_ROOF_PX - 6)) / _SIZE


def _roof(w: float, d: float, h: float, rise: float, roof: int) -> Part:
    """Two slabs with overhang, closed."""
    over, thick = 0.35, 0.16
    drop = rise / (d / 2) * over
    section = np.array([[-over, h - drop], [d / 2, h + rise], [d + over, h - drop], [d + over, h - drop + thick],
                        [d / 2, h + rise + thick], [-over, h - drop + thick]])  # fmt: skip
    left, right = np.insert(section, 0, -0.25, axis=1), np.insert(section, 0, w + 0.25, axis=1)
    vertices = np.concatenate([left, right])
    quads = [(i, (i + 1) % 6, (i + 1) % 6 + 6, i + 6) for i in range(6)]
    caps = [(0, 5, 4, 1), (1, 4, 3, 2), (6, 7, 10, 11), (7, 8, 9, 10)]
    faces = np.array([t for q in [*[q[::-1] for q in quads], *caps] for t in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))])
    slope = float(np.hypot(d / 2 + over, rise + drop))
    along = np.abs(vertices[:, 1] - d / 2) / (d / 2 + over)
    uv = np.array([_roof_uv(roof, (x + 0.25) / _ROOF_M[0], (1 - t) * slope / _ROOF_M[1])
                   for x, t in zip(vertices[:, 0], along, strict=True)])  # fmt: skip
    base = plain(vertices, faces)
    return Part(vertices, faces, uv[faces], base.color, base.gloss)
