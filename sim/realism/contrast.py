"""Contrast that rolls: a veil of varying density drifts over the image, and the gain follows nobody knows what."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float

from sim.realism.wander import Wander
from sim.streams import stream

Array = np.ndarray
_TAU_S = 0.4  # in KITTI's frames the car's local mean drifts by a tenth per 0.1 s when the sun glares
_WIDTH = 0.7  # correlation length in image widths
_VEIL, _GAIN, _MISMATCH = 0.7, 0.35, 0.05
_GRID = 24


def veil_density(level: float, seed: int, run: int, t_s: float, size_px: tuple[int, int]) -> Float[Array, "h w"]:
    """Share of the light that the veil replaces, 0 .. 0.7 level, the same for both cameras."""
    w, h = size_px
    x, y = np.meshgrid(np.linspace(0, 1, _GRID), np.linspace(0, h / w, _GRID))
    field = Wander.draw(stream(seed, run, "camera/contrast/veil"), _TAU_S, _WIDTH).at(t_s, np.stack([x, y], axis=-1))
    density = _VEIL * level * (0.5 + 0.5 * np.tanh(1.2 * field))
    return np.asarray(cv2.resize(density.astype(np.float32), size_px, interpolation=cv2.INTER_CUBIC))


def rolling_contrast(
    light: Float[Array, "h w 3"], level: float, seed: int, run: int, side: str, t_s: float
) -> Float[Array, "h w 3"]:
    """``gain ((1 - veil) light + veil mean)``: at level 1 local contrast falls to a third in places, and the gain of
    the two cameras, which do not know of each other, differs by 5 % (one sigma)."""
    veil = veil_density(level, seed, run, t_s, (light.shape[1], light.shape[0]))[..., None]
    gain = _GAIN * Wander.draw(stream(seed, run, "camera/contrast/gain"), _TAU_S).at(t_s)
    gain = gain + _MISMATCH * Wander.draw(stream(seed, run, f"camera/{side}/contrast/gain"), _TAU_S).at(t_s)
    mean = np.asarray(cv2.mean(light)[:3], np.float32)
    return np.asarray(np.float32(np.exp(level * gain)) * (light + veil * (mean - light)), np.float32)
