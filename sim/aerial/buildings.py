"""Buildings from footprints: walls, flat, gabled or hipped roofs, chimneys and roof fittings, with their textures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from sim.aerial.library import Mesh, Texture, linear, merged, polygon, polygons
from sim.aerial.surfaces import FLAT_ROOF, SNOW, TILES, Surface
from sim.archive import freeze_fields
from sim.buildings_map import Footprint
from sim.textures import linear_from_srgb, noise

Array = np.ndarray
_BELOW_M = 2.5
_LONGEST_WALL_M = 12.0
_STOREY_M = 3.0
_EAVES_M = 0.45
# A footprint that fills its smallest rectangle so far is one, and gets a pitched roof if it is not too wide.
_RECTANGLE, _WIDEST_PITCHED_M = 0.93, 17.0
FACADES = ((0.80, 0.77, 0.70), (0.72, 0.66, 0.56), (0.62, 0.60, 0.58))
ROOF_TILES, ROOF_FLAT, FIRST_FACADE = 0, 1, 2
"""Numbers of the textures that `textures` makes, counted from the first."""
_PITCHED_PAINTS = ((0.56, 0.33, 0.25), (0.50, 0.30, 0.24), (0.44, 0.29, 0.25), (0.36, 0.34, 0.34), (0.30, 0.30, 0.32))
_FLAT_PAINTS = ((0.60, 0.59, 0.57), (0.48, 0.48, 0.48), (0.38, 0.38, 0.39), (0.66, 0.65, 0.62), (0.42, 0.45, 0.40))


@dataclass(frozen=True, eq=False)
class Building:
    """A building: where its mesh's origin stands in w [m], the mesh, and its roof's paint in linear light."""

    at_m: Float[Array, "3"]
    mesh: Mesh
    paint: Float[Array, "3"]

    def __post_init__(self) -> None:
        freeze_fields(self)


def textures(rng: np.random.Generator, season: str = "summer") -> list[Texture]:
    """Tiles and bitumen, which take the paint, then one facade with windows for every colour of `FACADES`."""
    tiles, flat = (SNOW, SNOW) if season == "winter" else (TILES, FLAT_ROOF)
    return [_tiles(tiles, rng), _gravel(flat, rng), *(_facade(c, rng) for c in FACADES)]


def _tiles(surface: Surface, rng: np.random.Generator, size: int = 256) -> Texture:
    """8 m of roof: s along the eaves, t up the roof, a row every third of a metre."""
    light = 1 + 0.07 * noise((size, size), 0.6, rng) + 0.08 * noise((size, size), 1.8, rng)
    row = np.arange(size) / size * 8.0 / 0.333
    light -= 0.16 * (row % 1 < 0.25)[:, None]
    texels = np.zeros((size, size, 4))
    texels[..., 3] = np.clip(light, 0.3, 1.6)
    return Texture(texels, repeat=True, coat=surface, bare=surface)


def _gravel(surface: Surface, rng: np.random.Generator, size: int = 256) -> Texture:
    """25 m of flat roof with stains and seams of the sheets."""
    light = 1 + 0.06 * noise((size, size), 0.5, rng) + 0.12 * noise((size, size), 2.2, rng)
    light[:: size // 8] -= 0.14
    light[:, :: size // 3] -= 0.10
    texels = np.zeros((size, size, 4))
    texels[..., 3] = np.clip(light, 0.4, 1.5)
    return Texture(texels, repeat=True, coat=surface, bare=surface)


def _facade(color: tuple[float, float, float], rng: np.random.Generator, size: int = 64) -> Texture:
    """One storey and one window axis, 3 m each; t = 0 is the floor."""
    srgb = np.empty((size, size, 3))
    srgb[:] = color
    srgb += 0.02 * noise((size, size), 1.0, rng)[..., None]
    srgb[int(0.30 * size) : int(0.80 * size), int(0.28 * size) : int(0.72 * size)] = (0.16, 0.18, 0.21)
    srgb[int(0.27 * size) : int(0.30 * size), int(0.25 * size) : int(0.75 * size)] = 0.75
    texels = np.zeros((size, size, 4))
    texels[..., :3] = linear_from_srgb(np.clip(srgb, 0, 1))
    return Texture(texels, repeat=True)


def build(
    footprint: Footprint, ground_m: Float[Array, "n"], first: int, rng: np.random.Generator, season: str = "summer"
) -> Building:
    """A building whose eaves (flat: roof) are its height above the mean of the ground heights at its corners.

    ``first`` is the number of the first of its `textures`. The roof is pitched where the outline is a rectangle not
    too wide and not too high; its ridge is then above the height.
    """
    outline = footprint.outline_m
    centre = outline.mean(axis=0)
    base = float(np.mean(ground_m))
    at = np.array([*centre, base])
    corners = _as_rectangle(footprint)
    facade = first + FIRST_FACADE + int(rng.integers(len(FACADES)))
    pitched = corners is not None and footprint.height_m < 16 and rng.random() < 0.85
    low = float(np.min(ground_m)) - base - _BELOW_M
    if pitched and corners is not None:
        height = footprint.height_m
        parts = [_walls(corners - centre, low, height, facade)]
        parts += _pitched(corners - centre, height, first + ROOF_TILES, facade, rng)
        color = _PITCHED_PAINTS[rng.integers(len(_PITCHED_PAINTS))]
    else:
        height = footprint.height_m
        parts = [_walls(ring - centre, low, height, facade) for ring in (outline, *footprint.holes_m)]
        parts += _flat(footprint, centre, height, first + ROOF_FLAT, facade, rng)
        color = _FLAT_PAINTS[rng.integers(len(_FLAT_PAINTS))]
    paint = linear(*color) * rng.uniform(0.75, 1.25)
    if season == "winter":
        paint = linear(0.86, 0.87, 0.90) * rng.uniform(0.85, 1.0)
    return Building(at, merged(parts), np.asarray(paint, np.float32))


def _as_rectangle(footprint: Footprint) -> Array | None:
    """Corners (4, 2) counter-clockwise, the first side a long one; None where the footprint is none."""
    shape = footprint.polygon
    box = shapely.minimum_rotated_rectangle(shape)
    if footprint.holes_m or shape.area < _RECTANGLE * box.area:
        return None
    corners = shapely.get_coordinates(shapely.orient_polygons(box))[:-1]
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    if sides[0] < sides[1]:
        corners = np.roll(corners, -1, axis=0)
    return corners if min(sides) <= _WIDEST_PITCHED_M else None


def _walls(ring: Array, low: float, high: float, texture: int) -> Mesh:
    """Walls along a ring, counter-clockwise around what is inside; windows begin at the ground's mean height."""
    corners, st = [], []
    for p, q in pairwise([*ring, ring[0]]):
        length = float(np.hypot(*(q - p)))
        cuts = np.linspace(0, 1, int(length // _LONGEST_WALL_M) + 2)
        axes = max(round(length / 3.0), 1)
        for a, b in pairwise(cuts):
            one, other = p + a * (q - p), p + b * (q - p)
            corners.append([[*one, low], [*other, low], [*other, high], [*one, high]])
            st.append([[a * axes, low], [b * axes, low], [b * axes, high], [a * axes, high]])
    return polygons(np.array(corners), np.array(st) / [1, _STOREY_M], texture, 0.75)


def _pitched(c: Array, height: float, tiles: int, facade: int, rng: np.random.Generator) -> list[Mesh]:
    """A gabled or hipped roof over the rectangle c (4, 2), eaves beyond the walls, and chimneys."""
    along = (c[1] - c[0]) / np.linalg.norm(c[1] - c[0])
    across = np.array([-along[1], along[0]])
    half_l, half_w = float(np.hypot(*(c[1] - c[0]))) / 2, float(np.hypot(*(c[2] - c[1]))) / 2
    middle = c.mean(axis=0)
    pitch = np.tan(np.deg2rad(rng.uniform(28, 45)))
    hip = half_w * 0.9 if rng.random() < 0.3 and half_l > 1.2 * half_w else 0.0
    over, ridge = _EAVES_M, height + half_w * pitch
    eaves = height - over * pitch

    def at(x: Any, y: Any, z: Any) -> Array:
        return np.array([*(middle + x * along + y * across), z])

    L, W, R = half_l + over, half_w + over, half_l + over - (hip + over if hip else 0.0)
    slope = float(np.hypot(W, ridge - eaves)) / 8.0
    parts = []
    for s in (1.0, -1.0):
        side = np.array(
            [at(-s * L, -s * W, eaves), at(s * L, -s * W, eaves), at(s * R, 0, ridge), at(-s * R, 0, ridge)]
        )
        parts.append(polygon(side, np.array([[-L, 0], [L, 0], [R, 8 * slope], [-R, 8 * slope]]) / 8.0, tiles))
        end = np.array([at(s * L, -s * W, eaves), at(s * L, s * W, eaves), at(s * R, 0, ridge)])
        parts.append(polygon(end, np.array([[-W, 0], [W, 0], [0, W]]) / 8.0, tiles if hip else facade))
    # The soffit closes the body, so that its shadow is whole.
    under = np.array([at(-L, -W, eaves), at(-L, W, eaves), at(L, W, eaves), at(L, -W, eaves)])
    parts.append(polygon(under, np.zeros((4, 2)), tiles, 0.3))
    for _ in range(int(rng.integers(0, 3))):
        x, y = rng.uniform(-0.7, 0.7) * R, rng.choice([-1, 1]) * rng.uniform(0.1, 0.5) * half_w
        top = ridge + 0.6
        parts.append(_block(at(x, y, 0)[:2], along, (0.5, 0.7), ridge - 2.0, top, facade, tiles))
    for _ in range(int(rng.integers(0, 4))):
        parts.append(
            _window(
                at, float(rng.choice([-1.0, 1.0])), float(rng.uniform(-0.7, 0.7) * R), half_w, ridge, pitch, facade, rng
            )
        )
    return parts


def _window(
    at: Callable[..., Array],
    side: float,
    x: float,
    half_w: float,
    ridge: float,
    pitch: float,
    facade: int,
    rng: np.random.Generator,
) -> Mesh:
    """A skylight lying on the roof: a pane of the facade's window."""
    y0 = rng.uniform(0.25, 0.55) * half_w
    y1, w, lift = y0 + 0.9, 0.55, 0.06
    z0, z1 = ridge - y0 * pitch + lift, ridge - y1 * pitch + lift
    corners = np.array([at(x - w, -y1, z1), at(x + w, -y1, z1), at(x + w, -y0, z0), at(x - w, -y0, z0)])
    if side < 0:
        corners = np.array([at(x + w, y1, z1), at(x - w, y1, z1), at(x - w, y0, z0), at(x + w, y0, z0)])
    return polygon(corners, np.array([[0.4, 0.4], [0.6, 0.4], [0.6, 0.7], [0.4, 0.7]]), facade)


def _block(at: Array, along: Array, size: tuple[float, float], low: float, high: float, side: int, top: int) -> Mesh:
    """A box on a roof: chimney, lift, ventilation."""
    across = np.array([-along[1], along[0]])
    a, b = along * size[0] / 2, across * size[1] / 2
    ring = np.array([at - a - b, at + a - b, at + a + b, at - a + b])
    sides = [[[*p, low], [*q, low], [*q, high], [*p, high]] for p, q in pairwise([*ring, ring[0]])]
    lid = np.column_stack([ring, np.full(4, high)])
    return merged([polygons(np.array(sides), np.full((4, 4, 2), 0.1), side, 0.8), polygon(lid, ring / 25.0, top)])


def _flat(
    footprint: Footprint, centre: Array, height: float, roof: int, facade: int, rng: np.random.Generator
) -> list[Mesh]:
    """The flat roof, a parapet as a light rim, and boxes on it."""
    shape = footprint.polygon
    parts = [_cover(shape, centre, height, roof)]
    inner = shape.buffer(-0.4)
    if inner.is_empty:
        return parts
    rim = shapely.difference(shape, inner)
    parts.append(_cover(rim, centre, height + 0.02, facade, np.array([0.1, 0.1])))
    room = shape.buffer(-2.5)
    if room.is_empty:
        return parts
    angle = rng.uniform(0, np.pi / 2)
    edge = footprint.outline_m[1] - footprint.outline_m[0]
    along = edge / max(float(np.hypot(*edge)), 1e-9) if len(footprint.outline_m) else np.array([np.cos(angle), 0])
    low, high = np.array(room.bounds[:2]), np.array(room.bounds[2:])
    for _ in range(min(int(shape.area / 90) + 1, 14)):
        p = rng.uniform(low, high)
        if room.contains(shapely.Point(p)):
            size = (float(rng.uniform(0.6, 3.2)), float(rng.uniform(0.6, 2.4)))
            top = height + rng.uniform(0.4, 2.2)
            parts.append(_block(p - centre, along, size, height - 0.1, top, facade, roof))
    return parts


def _cover(shape: object, centre: Array, z: float, texture: int, st: Array | None = None) -> Mesh:
    """Triangles of a polygon at a height."""
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(shape))
    rings = shapely.get_coordinates(shapely.orient_polygons(triangles)).reshape(-1, 4, 2)[:, :3]
    corners = np.concatenate([rings - centre, np.full((len(rings), 3, 1), z)], axis=-1)
    return polygons(corners, rings / 25.0 if st is None else np.broadcast_to(st, rings.shape), texture)
