"""How warm surfaces get: what the thermal band knows of a material, where the visible one knows a colour."""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np
from jaxtyping import Float

Array = np.ndarray


@dataclass(frozen=True)
class Surface:
    """A surface's temperature by its balance of heat, linear in the sun it absorbs.

    shade_K: above the air [K] where no sun comes, with the warmth that earlier sun has left and what it has lost to the
    sky. gain_K: what 1 kW/m2 of absorbed light adds [K], less where water evaporates or the body is large. emissivity
    in the thermal infrared (8 to 12 micrometres); the rest is the sky's reflection.
    """

    shade_K: float
    gain_K: float
    emissivity: float

    def mixed(self, other: Surface, share: float) -> Surface:
        """This one with a share of another."""
        return Surface(*((1 - share) * a + share * b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def row(self) -> Float[Array, "3"]:
        """Numbers for the loops."""
        return np.array(astuple(self), np.float32)


# Ours (the source has none), so that on a clear summer noon asphalt is some 20 K warmer than the air, grass 4 K, leaves
# as warm, and water colder.
ASPHALT = Surface(3.5, 24.0, 0.95)
PAVING = Surface(2.5, 24.0, 0.94)
GRAVEL = Surface(1.5, 24.0, 0.93)
SOIL = Surface(0.5, 20.0, 0.94)
STRAW = Surface(0.0, 17.0, 0.95)
GREEN = Surface(-1.5, 8.0, 0.98)
LEAVES = Surface(-0.8, 4.0, 0.98)
WATER = Surface(-4.0, 1.5, 0.985)
SNOW = Surface(-3.5, 7.0, 0.99)
TILES = Surface(-1.0, 32.0, 0.93)
FLAT_ROOF = Surface(-2.0, 36.0, 0.93)
FACADE = Surface(1.5, 20.0, 0.93)
# Thin sheet, cold below; glass over a warm cabin.
SHEET = Surface(0.0, 27.0, 0.92)
GLASS = Surface(1.0, 8.0, 0.85)
