"""Dirt on the windscreen: insects, dried drops and smears, out of focus and at other places for each camera."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from sim.camera import Camera
from sim.realism.windscreen import area_m2, defocus_px, laid_over, px_per_m
from sim.streams import stream

Array = np.ndarray
_SPOTS_PER_M2 = 11_000
_MEDIAN_M, _LOG_SPREAD, _LARGEST_M = 0.0015, 0.8, 0.01


@lru_cache(maxsize=4)
def spots(camera: Camera, level: float, seed: int, run: int, side: str) -> Float[Array, "h w"]:
    """Opacity of the dirt per pixel; at level 1 it covers about a quarter of the view."""
    rng = stream(seed, run, f"camera/{side}/dirt")
    (w, h), scale = camera.size_px, px_per_m(camera)
    n = round(level * _SPOTS_PER_M2 * area_m2(camera))
    share = rng.random((n, 6))  # row by row: a higher level adds spots to those of a lower one
    middle = share[:, :2] * (w, h)
    radius = scale * np.minimum(_MEDIAN_M * np.exp(_LOG_SPREAD * ndtri(share[:, 2])), _LARGEST_M)
    longer, turn, opacity = 1 + 0.8 * share[:, 3], 180 * share[:, 4], 0.2 + 0.65 * share[:, 5]
    mask = np.zeros((h, w), np.float32)
    for k in np.argsort(opacity):
        axes = (float(2 * radius[k] * longer[k]), float(2 * radius[k] / longer[k]))
        cv2.ellipse(mask, (middle[k].tolist(), axes, float(turn[k])), float(opacity[k]), cv2.FILLED)
    blurred = np.asarray(cv2.GaussianBlur(mask, (0, 0), max(defocus_px(camera) / 4, 0.3)))
    blurred.flags.writeable = False
    return blurred


def dirty(light: Float[Array, "h w 3"], opacity: Float[Array, "h w"]) -> Float[Array, "h w 3"]:
    """Light through dirt, which hides what is behind and scatters most of the mean light instead."""
    return laid_over(light, opacity, 0.7 * np.asarray(cv2.mean(light)[:3], np.float32))
