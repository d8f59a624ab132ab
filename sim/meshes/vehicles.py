"""Parametric vehicles: bodies, wheels and fittings of a kind, scaled to a size, in three levels of detail."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim.archive import freeze
from sim.meshes.atlas import Atlas
from sim.meshes.body import DETAILS, Chassis, Detail, half_width, loft
from sim.meshes.paint import PAINTS, paint_vehicle
from sim.meshes.shapes import SHAPES, Hull, Shape
from sim.meshes.solid import Part, box, face_normals, merged, surface
from sim.meshes.wheels import wheel
from sim.model import VehicleModel
from sim.textures import Color

Array = np.ndarray

VEHICLE_KINDS = tuple(SHAPES)
_SWITCH_M = (85.0, 170.0)
_DARK = (0.01, 0.01, 0.011)
_GLOSS = 0.05


def make_vehicle(
    kind: str,
    rng: np.random.Generator,
    size_m: Sequence[float] | None = None,
    color: str | Color | None = None,
) -> VehicleModel:
    """A vehicle of the kind with its own paint, plate and dirt.

    ``size_m`` is (length, width, height) of its bounding box, the kind's typical size by default; wheels stay round.
    ``color`` is a name of `PAINTS` or sRGB in 0..1; drawn from ``rng`` by default.

    Raises
        ValueError: unknown kind or colour, size not positive.
    """
    if kind not in SHAPES:
        raise ValueError(f"kind: expected one of {', '.join(SHAPES)}, got {kind!r}")
    typical = SHAPES[kind]
    size = _checked_size(typical.size_m if size_m is None else size_m)
    paint = _paint(color, rng)
    shape = _scaled(typical, size)
    atlas = Atlas(size, shape.wheel_radius_m)
    texture = freeze(paint_vehicle(typical, atlas, paint, shape.wheel_radius_m, rng))  # shared by all levels
    parts = [_build(shape, atlas, detail) for detail in DETAILS]
    return VehicleModel(
        name=kind,
        levels=tuple((surface(part, texture, repeat=False),) for part in parts),
        switch_m=_SWITCH_M,
        solid_vertices=parts[0].vertices,
        solid_faces=parts[0].faces,
        size_m=size,
        wheelbase_m=shape.wheelbase_m,
        rear_overhang_m=shape.rear_overhang_m,
        wheel_radius_m=shape.wheel_radius_m,
    )


def _checked_size(size_m: Sequence[float]) -> tuple[float, float, float]:
    size = tuple(float(s) for s in size_m)
    if len(size) != 3 or not all(np.isfinite(s) and s > 0 for s in size):
        raise ValueError(f"size_m: expected (length, width, height) > 0, got {size_m}")
    return size


def _paint(color: str | Color | None, rng: np.random.Generator) -> Color:
    drawn = str(rng.choice(list(PAINTS)))
    if color is None:
        return PAINTS[drawn]
    if isinstance(color, str):
        if color not in PAINTS:
            raise ValueError(f"color: expected one of {', '.join(PAINTS)} or RGB in 0..1, got {color!r}")
        return PAINTS[color]
    if len(color) != 3 or not all(0 <= c <= 1 for c in color):
        raise ValueError(f"color: expected RGB in 0..1, got {color}")
    return color


def _scaled(shape: Shape, size: tuple[float, float, float]) -> Shape:
    """The shape's geometry at another size; round things follow the smaller of the length and height ratios."""
    kx, _, kz = (a / b for a, b in zip(size, shape.size_m, strict=True))
    k = min(kx, kz)

    def hull(h: Hull) -> Hull:
        return replace(
            h,
            top=tuple((x * kx, z * kz) for x, z in h.top),
            flank=tuple((z * kz, share) for z, share in h.flank),
            sill_m=h.sill_m * kz,
            belt_m=h.belt_m * kz,
            corner_m=h.corner_m * k,
            crown_m=h.crown_m * k,
            tail_round=(h.tail_round[0] * k, h.tail_round[1] * k),
            nose_round=(h.nose_round[0] * k, h.nose_round[1] * k),
            tail_bulge_m=h.tail_bulge_m * k,
            nose_bulge_m=h.nose_bulge_m * k,
            smooth_m=h.smooth_m * k,
        )

    return replace(
        shape,
        size_m=size,
        wheelbase_m=shape.wheelbase_m * kx,
        rear_overhang_m=shape.rear_overhang_m * kx,
        wheel_radius_m=shape.wheel_radius_m * k,
        wheel_width_m=shape.wheel_width_m * min(k, size[1] / shape.size_m[1]),
        hulls=tuple(hull(h) for h in shape.hulls),
        panes=tuple((a * kx, b * kx) for a, b in shape.panes),
        belt_m=(shape.belt_m[0] * kz, shape.belt_m[1] * kz),
    )


def _build(shape: Shape, atlas: Atlas, detail: Detail) -> Part:
    """All parts of one level of detail in the vehicle frame, its bounding box exactly the wanted size."""
    L, W, H = shape.size_m
    r, width, rear = shape.wheel_radius_m, shape.wheel_width_m, shape.rear_overhang_m
    chassis = Chassis((rear, rear + shape.wheelbase_m), 1.17 * r, r, W / 2, W / 2 - width - 0.07)
    solids = [(*loft(h, chassis, detail), _GLOSS) for h in shape.hulls]
    solids += _fittings(shape) if detail.accessories else []
    if len(shape.hulls) > 1:
        solids += _frame(shape)
    low = np.min([v.min(axis=0) for v, *_ in solids], axis=0)
    high = np.max([v.max(axis=0) for v, *_ in solids], axis=0)
    parts = []
    for vertices, faces, hidden, gloss in solids:
        v = (vertices - [low[0], 0, 0]) * [L / (high[0] - low[0]), W / (high[1] - low[1]), H / high[2]] - [rear, 0, 0]
        corners = v[faces]
        uv = atlas.project(corners, face_normals(corners)[0], rear)
        uv[hidden] = atlas.uv("white", np.zeros(2))
        color = np.where(hidden[:, None], np.asarray(_DARK), 1.0)
        parts.append(Part(v, faces, uv, color, np.where(hidden, 0.0, gloss)))
    return merged(parts + _wheels(shape, atlas, detail))


def _wheels(shape: Shape, atlas: Atlas, detail: Detail) -> list[Part]:
    r, width = shape.wheel_radius_m, shape.wheel_width_m
    center, white = atlas.uv("wheel", np.zeros(2)), atlas.uv("white", np.zeros(2))
    scale = float(atlas.uv("wheel", np.array([1.0, 0]))[0] - center[0])
    left = wheel(r, width, detail.wheel_segments, (float(center[0]), float(center[1]), scale), (white[0], white[1]))
    stretch = atlas.shape[1] / atlas.shape[0]
    uv = left.uv.copy()
    face = np.any(uv != white, axis=(1, 2))
    uv[face, :, 1] = center[1] + (uv[face, :, 1] - center[1]) * stretch
    left = replace(left, uv=uv)
    # Without arches the wheel would vanish in the flank, so there it stands as far out as the box allows.
    y = shape.size_m[1] / 2 - width / 2 - (0.025 if detail.arch else 0.0)
    out = []
    for x in (0.0, shape.wheelbase_m):
        one = left.moved((x, y, r))
        out += [one, one.mirrored_y()]
    return out


_Solid = tuple[Array, Array, Array, float]


def _fitting(vertices: Array, faces: Array, dark: bool, gloss: float = 0.0) -> _Solid:
    return vertices, faces, np.full(len(faces), dark), gloss


def _fittings(shape: Shape) -> list[_Solid]:
    """Mirrors and door handles of both sides, inside the vehicle's width."""
    hull = shape.hulls[0]
    W = shape.size_m[1] / 2
    out: list[_Solid] = []
    front = shape.panes[-1][1]
    z = shape.belt_m[1] + 0.02
    x = front - 0.16 * shape.size_m[2]
    y = float(half_width(hull, np.array(x), np.array(z + 0.05), W))
    reach = max(W - y, 0.05)
    mirror, faces = box((x - 0.05, y - 0.03, z), (x + 0.07, y + reach, z + 0.14))
    bow = np.where(mirror[:, 0] > x, 0.78, 1.0)
    mirror[:, 2] = z + 0.07 + (mirror[:, 2] - z - 0.07) * bow
    for side in (1, -1):
        f = faces if side > 0 else faces[:, ::-1]
        out.append(_fitting(mirror * [1, side, 1], f, dark=False, gloss=_GLOSS))
    return out


def _frame(shape: Shape) -> list[_Solid]:
    """A lorry's ladder frame, tanks, lamp carrier and rear bar."""
    L, W, H = shape.size_m
    cab = shape.hulls[0].top[0][0]
    bars = [
        ((0.1 * L, -0.18 * W, 0.16 * H), (0.97 * cab, 0.18 * W, 0.30 * H)),
        ((0.50 * L, 0.26 * W, 0.15 * H), (0.68 * L, 0.46 * W, 0.29 * H)),
        ((0.50 * L, -0.46 * W, 0.15 * H), (0.68 * L, -0.26 * W, 0.29 * H)),
        ((0.004 * L, -0.46 * W, 0.14 * H), (0.02 * L, 0.46 * W, 0.19 * H)),
        ((0.006 * L, -0.14 * W, 0.185 * H), (0.11 * L, 0.14 * W, 0.30 * H)),
    ]
    lamps = _fitting(*box((0.0, -0.47 * W, 0.20 * H), (0.012 * L, 0.47 * W, 0.262 * H)), dark=False)
    return [lamps, *(_fitting(*box(a, b), dark=True) for a, b in bars)]
