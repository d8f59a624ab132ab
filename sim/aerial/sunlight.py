"""Sun, sky and air: what lights the aerial world, how far one sees in it, and how a camera turns light into values."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from sim.textures import linear_from_srgb

Array = np.ndarray
_LEVELS = 8192


@dataclass(frozen=True)
class Sunlight:
    """The sun's azimuth (clockwise from north) and elevation, and what reaches the ground besides it.

    ``sky`` is the share of skylight in the light on open level ground; 1 is an overcast day without shadows.
    ``visibility_m`` is the meteorological range (5 % contrast left) of the haze. Exposure is such that a white
    sheet on level ground has the linear value ``white``; ``balance`` are gains of red, green and blue.
    """

    azimuth_deg: float = 200.0
    elevation_deg: float = 48.0
    sky: float = 0.24
    visibility_m: float = 45000.0
    white: float = 1.05
    balance: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        if not 5 <= self.elevation_deg <= 90:
            raise ValueError(f"Sunlight.elevation_deg: expected 5 to 90, got {self.elevation_deg}")
        if not 0 < self.sky <= 1:
            raise ValueError(f"Sunlight.sky: expected above 0 and at most 1, got {self.sky}")
        if not (self.visibility_m > 0 and self.white > 0 and min(self.balance) > 0):
            raise ValueError("Sunlight: expected visibility_m, white and balance > 0")

    @property
    def direction(self) -> Float[Array, "3"]:
        """Unit vector to the sun in w."""
        a, e = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        return np.array([math.sin(a) * math.cos(e), math.cos(a) * math.cos(e), math.sin(e)])

    def numbers(self) -> Float[Array, "13"]:
        """Sun, sky and air light (RGB each), extinction [1/m], gains: as `shade_kernels.shade` wants them."""
        level = self.direction[2]
        sun = np.array([1.02, 1.0, 0.96]) * (1 - self.sky) / level
        sky = np.array([0.88, 0.98, 1.20]) * self.sky
        air = np.array([0.42, 0.48, 0.56])
        return np.concatenate([sun, sky, air, [3.0 / self.visibility_m], self.white * np.array(self.balance)])


def code_values() -> UInt8[Array, "n"]:
    """sRGB code values of linear light 0..1 in equal steps."""
    x = np.linspace(0, 1, _LEVELS)
    srgb = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * srgb), np.uint8)


def light_values() -> Float[Array, "256"]:
    """Linear light of sRGB code values."""
    return np.asarray(linear_from_srgb(np.arange(256) / 255), np.float32)
