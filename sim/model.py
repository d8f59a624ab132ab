"""What a thing looks like: triangle surfaces with colour, gloss and texture, in several levels of detail."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

from sim.archive import freeze_fields


@dataclass(frozen=True, eq=False)
class Surface:
    """One primitive of the renderer: triangles that share a texture.

    Normals are unit vectors, faces counter-clockwise seen from outside. ``color`` is linear-light RGB in 0..1 per
    vertex and multiplies the texture; ``gloss`` in 0..1 per vertex is the share of mirrored sky at normal incidence
    (0 = matt). ``texture`` is an sRGB image with row 0 at the top; ``uv`` (0, 0) is its bottom-left corner.
    """

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "v 3"]
    color: Float[np.ndarray, "v 3"]
    gloss: Float[np.ndarray, "v"]
    uv: Float[np.ndarray, "v 2"] | None = None
    texture: UInt8[np.ndarray, "h w 3"] | None = None
    repeat: bool = True
    cast_shadow: bool = True

    def __post_init__(self) -> None:
        freeze_fields(self)


@dataclass(frozen=True, eq=False)
class Model:
    """A thing in its own frame; ``levels[0]`` is the finest, level i is used beyond ``switch_m[i - 1]`` metres.

    ``solid_vertices``/``solid_faces`` is the closed surface that decides visibility and carries measured points
    (for levels[0] the rendered surface and the solid are the same to a millimetre). ``size_m`` is (length, width,
    height) of its bounding box.
    """

    name: str
    levels: tuple[tuple[Surface, ...], ...]
    switch_m: tuple[float, ...]
    solid_vertices: Float[np.ndarray, "v 3"]
    solid_faces: Int[np.ndarray, "f 3"]
    size_m: tuple[float, float, float]

    def __post_init__(self) -> None:
        freeze_fields(self)
        if len(self.levels) != len(self.switch_m) + 1:
            raise ValueError(f"Model {self.name}: {len(self.levels)} levels need {len(self.levels) - 1} distances")


@dataclass(frozen=True, eq=False)
class VehicleModel(Model):
    """A vehicle in its frame v: x forward, y left, z up, origin on the ground below the middle of the rear axle."""

    wheelbase_m: float = 2.7
    rear_overhang_m: float = 0.9
    wheel_radius_m: float = 0.31
