"""Vehicles as seen from the air: the coarse level of `sim.meshes`, with textures whose paint is free."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float

from sim.aerial.library import Mesh, Texture, linear
from sim.aerial.surfaces import GLASS, SHEET
from sim.meshes import VEHICLE_KINDS, make_vehicle
from sim.meshes.atlas import Atlas
from sim.meshes.paint import paint_vehicle
from sim.meshes.shapes import SHAPES, Shape
from sim.textures import linear_from_srgb

Array = np.ndarray
_WIDTH_PX, _SHRINK = 1024, 4
# Where there is no bonnet, the engine is so near the front; its warmth ends softly; and a rolling tyre's share of it.
_UNDER_CAB_M, _SOFT_M, _TYRE = 1.2, 0.12, 0.4
# Share of paints on German roads (Kraftfahrt-Bundesamt, rounded) in sRGB.
PAINTS = {
    "white": ((0.86, 0.86, 0.85), 0.21),
    "silver": ((0.66, 0.67, 0.68), 0.20),
    "grey": ((0.36, 0.37, 0.39), 0.17),
    "black": ((0.10, 0.10, 0.11), 0.22),
    "blue": ((0.13, 0.22, 0.45), 0.09),
    "red": ((0.58, 0.09, 0.08), 0.06),
    "green": ((0.14, 0.27, 0.20), 0.02),
    "beige": ((0.70, 0.66, 0.56), 0.03),
}


@lru_cache(maxsize=1)
def fleet() -> tuple[tuple[Mesh, ...], tuple[Texture, ...]]:
    """One mesh and one texture for every kind of `VEHICLE_KINDS`; origin on the ground below the rear axle."""
    meshes, textures = zip(*(_vehicle(kind, k) for k, kind in enumerate(VEHICLE_KINDS)), strict=True)
    return meshes, textures


def _vehicle(kind: str, texture: int) -> tuple[Mesh, Texture]:
    model = make_vehicle(kind, np.random.default_rng(texture))
    surface = model.levels[-1][0]
    assert surface.uv is not None
    dark = surface.color.mean(axis=1)
    uv = np.stack([surface.uv[:, 0], 1 - surface.uv[:, 1]], axis=-1)
    look = np.column_stack([uv, np.clip(dark, 0.03, 1.0), np.clip(surface.gloss, 0, 1)])
    mesh = Mesh(
        surface.vertices.astype(float),
        surface.normals.astype(float),
        look,
        surface.faces.astype(np.int64),
        np.full(len(surface.faces), texture),
    )
    atlas = Atlas(model.size_m, model.wheel_radius_m, _WIDTH_PX)
    bare, coated = (_painted(kind, atlas, model.wheel_radius_m, value) for value in (0.0, 1.0))
    share = np.clip(coated - bare, 0, 1).mean(axis=2)
    engine = _engine(SHAPES[kind], atlas, model.wheel_radius_m)
    return mesh, Texture(np.dstack([bare, share]), repeat=False, coat=SHEET, bare=GLASS, engine=engine)


def _painted(kind: str, atlas: Atlas, wheel_m: float, value: float) -> Float[Array, "h w 3"]:
    image = paint_vehicle(SHAPES[kind], atlas, (value, value, value), wheel_m, np.random.default_rng(0))
    light = linear_from_srgb(image / 255.0)
    return np.asarray(cv2.resize(light, None, fx=1 / _SHRINK, fy=1 / _SHRINK, interpolation=cv2.INTER_AREA))


def _engine(shape: Shape, atlas: Atlas, wheel_m: float) -> Float[Array, "h w"]:
    """Share of a running engine's warmth: all of it over the engine, some at the wheels."""
    image = np.zeros((*atlas.shape, 3), np.float32)
    length, width, height = shape.size_m
    begins = shape.windscreen[1] if shape.windscreen else length - _UNDER_CAB_M
    one, tyre = (1.0, 1.0, 1.0), (_TYRE, _TYRE, _TYRE)
    atlas.board("top", image).rect(begins, 0.0, length - begins, 0.42 * width, one)
    atlas.board("front", image).rect(-0.35 * width, 0.2 * height, 0.7 * width, 0.4 * height, one)
    atlas.board("wheel", image).disc((0.0, 0.0), wheel_m, tyre)
    soft = cv2.GaussianBlur(image[..., 0], (0, 0), _SOFT_M * atlas.scale)
    return np.asarray(cv2.resize(soft, None, fx=1 / _SHRINK, fy=1 / _SHRINK, interpolation=cv2.INTER_AREA))


def draw_paints(kinds: Sequence[str], rng: np.random.Generator) -> Float[Array, "n 3"]:
    """Paints in linear light, drawn by their share of the traffic; lorries, vans and buses are mostly white."""
    names = list(PAINTS)
    share = np.array([PAINTS[n][1] for n in names])
    drawn = rng.choice(len(names), len(kinds), p=share / share.sum())
    white = rng.random(len(kinds)) < 0.6
    commercial = np.isin(np.asarray(kinds, dtype=object), ["lorry", "bus", "van"])
    drawn[white & commercial] = names.index("white")
    colors = np.array([linear(*PAINTS[n][0]) for n in names])[drawn].reshape(-1, 3)
    return np.asarray(colors * rng.uniform(0.8, 1.15, (len(kinds), 1)), np.float32)
