"""The brush for vehicle textures: boards in the kind's own metres, the paint and its shades, common materials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sim.meshes.atlas import Atlas
from sim.meshes.shapes import Shape
from sim.textures import Board, Color

Array = np.ndarray

RUBBER: Color = (0.07, 0.07, 0.075)
GLASS: Color = (0.12, 0.135, 0.14)
SEEN_THROUGH: Color = (0.28, 0.31, 0.33)
PLASTIC: Color = (0.14, 0.14, 0.15)
CHROME: Color = (0.78, 0.79, 0.80)


@dataclass(frozen=True, eq=False)
class Painter:
    """One vehicle's texture in the making; coordinates are the shape's own (typical size, x from the rear bumper)."""

    shape: Shape
    atlas: Atlas
    image: Float[Array, "h w 3"]
    paint: Color
    rng: np.random.Generator

    def board(self, chart: str) -> Board:
        """Board in the typical size's metres, scaled to the vehicle's own."""
        b = self.atlas.board(chart, self.image)
        kx, ky, kz = (a / t for a, t in zip(self.atlas.size_m, self.shape.size_m, strict=True))
        factor = {"side": (kx, kz), "top": (kx, ky), "front": (ky, kz), "rear": (ky, kz)}[chart]
        return Board(b.image, b.origin, (b.scale[0] * factor[0], b.scale[1] * factor[1]))

    @property
    def heavy(self) -> bool:
        """Lorry or bus."""
        return self.shape.wheel_radius_m > 0.4

    @property
    def seam(self) -> Color:
        r, g, b = self.paint
        return (0.30 * r, 0.30 * g, 0.30 * b)

    def tone(self, factor: float) -> Color:
        r, g, b = self.paint
        return (min(r * factor, 1), min(g * factor, 1), min(b * factor, 1))
