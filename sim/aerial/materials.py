"""What the ground is made of: colours, grain, furrows, warmth, by season."""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from sim.aerial.surfaces import ASPHALT, GRAVEL, GREEN, LEAVES, PAVING, SNOW, SOIL, STRAW, WATER, Surface

Array = np.ndarray
Season = Literal["summer", "autumn", "winter"]


@dataclass(frozen=True)
class Material:
    """An sRGB colour in 0..1 and what varies it, as shares of its light.

    grain, mid, coarse: noise of about 0.1 m, 1 m and 20 m; hue: drift between yellow and blue, coarse; furrow: rows of
    a period [m] at an angle [rad] from +x; bare: share of patches in which the soil shows; surface: its warmth.
    """

    red: float
    green: float
    blue: float
    grain: float = 0.06
    mid: float = 0.06
    coarse: float = 0.05
    hue: float = 0.02
    furrow: float = 0.0
    angle: float = 0.0
    period_m: float = 1.0
    bare: float = 0.0
    surface: Surface = GREEN

    def row(self) -> Float[Array, "12"]:
        """Numbers for the painting loop: as listed, the angle as cosine and sine."""
        v = astuple(self)
        return np.array([*v[:8], np.cos(self.angle), np.sin(self.angle), self.period_m, self.bare], np.float32)


MATERIALS = {
    "grass": Material(0.390, 0.405, 0.275, 0.10, 0.08, 0.05, 0.03, bare=0.14),
    "lawn": Material(0.365, 0.405, 0.265, 0.07, 0.05, 0.04, 0.03, bare=0.05),
    "verge": Material(0.420, 0.420, 0.300, 0.10, 0.10, 0.08, 0.05, bare=0.15),
    "garden": Material(0.385, 0.400, 0.275, 0.12, 0.15, 0.05, 0.03, bare=0.28),
    "meadow": Material(0.420, 0.440, 0.275, 0.07, 0.08, 0.09, 0.05, furrow=0.03, period_m=6.0, bare=0.05),
    "crop": Material(0.340, 0.400, 0.230, 0.06, 0.06, 0.06, 0.03, furrow=0.05, period_m=1.4),
    "grain": Material(0.640, 0.560, 0.380, 0.06, 0.05, 0.06, 0.02, furrow=0.04, period_m=1.2, surface=STRAW),
    "stubble": Material(0.560, 0.500, 0.370, 0.08, 0.07, 0.06, 0.02, furrow=0.07, period_m=2.6, surface=STRAW),
    "soil": Material(0.440, 0.370, 0.300, 0.07, 0.09, 0.08, 0.02, furrow=0.09, period_m=1.1, surface=SOIL),
    "forest": Material(0.200, 0.215, 0.140, 0.16, 0.16, 0.05, 0.04, surface=LEAVES),
    "water": Material(0.160, 0.210, 0.215, 0.015, 0.012, 0.03, 0.01, surface=WATER),
    "paving": Material(0.575, 0.555, 0.525, 0.045, 0.045, 0.05, 0.01, surface=PAVING),
    "yard": Material(0.500, 0.485, 0.460, 0.06, 0.08, 0.08, 0.02, bare=0.08, surface=PAVING),
    "gravel": Material(0.585, 0.555, 0.490, 0.08, 0.07, 0.06, 0.01, surface=GRAVEL),
    "lot": Material(0.430, 0.430, 0.430, 0.05, 0.06, 0.06, 0.01, surface=ASPHALT),
}
_SNOW = (0.86, 0.875, 0.90)
_FIELDS: dict[Season, tuple[str, ...]] = {
    "summer": ("crop", "grain", "grain", "meadow", "stubble", "soil", "crop"),
    "autumn": ("soil", "stubble", "meadow", "soil", "crop"),
    "winter": ("soil", "stubble", "meadow", "crop"),
}
# These stay warm, driven on or cleared: less snow lies on them.
_CLEARED = {"paving": 0.55, "yard": 0.6, "lot": 0.45, "gravel": 0.7, "forest": 0.6, "soil": 0.8}


def material(name: str, season: Season, rng: np.random.Generator | None = None) -> Material:
    """A material in a season; with ``rng`` it is one plot of many, a little different and with its own row angle."""
    m = MATERIALS[name]
    if rng is not None:
        light, tint = rng.uniform(0.9, 1.1), rng.uniform(-0.03, 0.03)
        m = replace(
            m,
            red=m.red * light * (1 + tint),
            green=m.green * light,
            blue=m.blue * light * (1 - tint),
            angle=float(rng.uniform(0, np.pi)),
        )
    if season == "autumn" and m.green > m.red:
        m = replace(m, red=1.08 * m.red, green=0.95 * m.green)
    if season == "winter" and name != "water":
        share = _CLEARED.get(name, 0.93)
        r, g, b = ((1 - share) * c + share * s for c, s in zip((m.red, m.green, m.blue), _SNOW, strict=True))
        m = replace(
            m, red=r, green=g, blue=b, grain=0.4 * m.grain, mid=0.5 * m.mid, coarse=0.5 * m.coarse, hue=0.005,
            furrow=0.6 * m.furrow, bare=0.04, surface=m.surface.mixed(SNOW, share),
        )  # fmt: skip
    return m


def field_names(season: Season) -> tuple[str, ...]:
    """Materials of fields, as often as they occur."""
    return _FIELDS[season]
