"""The windscreen before the cameras: near, so whatever is on it is out of focus and differs between the cameras."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from sim.camera import Camera

Array = np.ndarray
DISTANCE_M = 0.15  # cameras sit behind the mirror
APERTURE_M = 0.003  # 6 mm at f/2, focused at infinity


def px_per_m(camera: Camera) -> float:
    """Pixels per metre on the windscreen."""
    return float(camera.K[0, 0]) / DISTANCE_M


def defocus_px(camera: Camera) -> float:
    """Diameter of the disc that a point on the windscreen is blurred to."""
    return px_per_m(camera) * APERTURE_M


def area_m2(camera: Camera) -> float:
    """The part of the windscreen that a camera looks through."""
    w, h = camera.size_px
    return w * h / px_per_m(camera) ** 2


def laid_over(
    light: Float[Array, "h w 3"], opacity: Float[Array, "h w"], other: Float[Array, "*hw 3"]
) -> Float[Array, "h w 3"]:
    """Light where a layer of the given opacity (0..1) shows another light instead."""
    return np.asarray(light + opacity[..., None] * (other - light), np.float32)
