"""Painting a vehicle's texture: body colour, its four views, wheels and dirt."""

from __future__ import annotations

import numpy as np
from jaxtyping import UInt8

from sim.meshes.atlas import Atlas
from sim.meshes.paint_ends import paint_front, paint_rear, paint_top
from sim.meshes.paint_flank import paint_flank
from sim.meshes.painter import Painter
from sim.meshes.shapes import Shape
from sim.meshes.wheels import paint_wheel
from sim.textures import Color, noise, to_texture

Array = np.ndarray

PAINTS: dict[str, Color] = {
    "white": (0.80, 0.80, 0.79),
    "silver": (0.50, 0.51, 0.52),
    "grey": (0.30, 0.31, 0.33),
    "black": (0.085, 0.085, 0.095),
    "red": (0.56, 0.07, 0.07),
    "blue": (0.10, 0.18, 0.40),
    "green": (0.11, 0.25, 0.18),
}


def paint_vehicle(
    shape: Shape, atlas: Atlas, paint: Color, wheel_m: float, rng: np.random.Generator
) -> UInt8[Array, "h w 3"]:
    """The whole texture of a vehicle."""
    image = np.empty((*atlas.shape, 3), np.float32)
    image[:] = paint
    p = Painter(shape, atlas, image, paint, rng)
    paint_flank(p)
    paint_front(p)
    paint_rear(p)
    paint_top(p)
    _dirt(p)
    paint_wheel(atlas.board("wheel", image), wheel_m, rng, p.heavy)
    atlas.board("white", image).rect(-0.1, -0.1, 0.2, 0.2, (1, 1, 1))
    return to_texture(image)


def _dirt(p: Painter) -> None:
    """Uneven paint, road dust that gathers low down, splashes and specks: what a corner tracker finds on a real car."""
    rows, columns = p.image.shape[:2]
    coarse, fine = noise((512, 512), 2.0, p.rng), noise((1024, 1024), 0.9, p.rng)
    coarse = np.tile(np.kron(coarse, np.ones((2, 2), np.float32)), (rows // 1024, columns // 1024))
    fine = np.tile(fine, (rows // 1024, columns // 1024))
    image = p.image
    image *= (1 + 0.030 * coarse + 0.035 * fine)[..., None]
    dust = np.zeros((rows, columns), np.float32)
    scale = p.atlas.scale
    height = (np.arange(rows) + 0.5) / scale
    H = p.atlas.size_m[2]
    for ground in (p.atlas.origins()["side"][1], p.atlas.origins()["front"][1]):
        z = np.where((ground - height > -0.03) & (ground - height < H), ground - height, np.inf)
        dust += (0.55 * np.exp(-np.maximum(z, 0) / 0.28)).astype(np.float32)[:, None]
    dust = np.clip((dust + 0.04) * (1 + 0.45 * coarse + 0.25 * fine), 0, 0.8)
    specks = np.clip(fine - 2.0, 0, 1) * (0.08 + 0.5 * dust)
    image += (np.array([0.46, 0.43, 0.38], np.float32) - image) * np.clip(dust + specks, 0, 0.9)[..., None]
