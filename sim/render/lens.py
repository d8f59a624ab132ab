"""Lens distortion: the wider ideal image to render, and where each pixel of the distorted one lies in it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Shaped
from scipy.interpolate import RectBivariateSpline

from sim.archive import freeze_fields
from sim.camera import Camera

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Lens:
    """A distorted camera as an ideal one and a resampling.

    Where the distorted image's pixel centres (h, w, 2) and its s x s times as many subpixels (h s, w s, 2) lie in the
    ideal image rendered s times as fine; in pixels of that fine image, float32.
    """

    ideal: Camera
    centers: Float[Array, "h w 2"]
    subpixels: Float[Array, "hs ws 2"]

    def __post_init__(self) -> None:
        freeze_fields(self)

    @staticmethod
    def of(camera: Camera, supersample: int) -> Lens:
        fine = _ideal_pixels(camera, supersample)
        lo, hi = np.floor(fine.min(axis=(0, 1))) - 2, np.ceil(fine.max(axis=(0, 1))) + 2
        K = camera.K.copy()
        K[:2, 2] -= lo
        w, h = (hi - lo + 1).astype(int)

        def place(uv: Array) -> Array:
            return np.asarray((uv - lo + 0.5) * supersample - 0.5, np.float32)

        return Lens(Camera(K, (int(w), int(h))), place(_ideal_pixels(camera, 1)), place(fine))

    def bend(self, image: Shaped[Array, "..."]) -> Shaped[Array, "..."]:
        """The distorted fine image from the ideal fine image, interpolated."""
        return np.asarray(cv2.remap(image, self.subpixels, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    def pick(self, image: Shaped[Array, "..."]) -> Shaped[Array, "..."]:
        """The distorted image from the ideal fine image, each pixel the one nearest to its centre."""
        u, v = np.moveaxis(np.rint(self.centers).astype(int), -1, 0)
        return np.asarray(image[v, u])


def _ideal_pixels(camera: Camera, supersample: int) -> Float[Array, "hs ws 2"]:
    """Where the subpixels of a distorted camera would lie without its distortion.

    Inverted exactly on a grid of 16 px and interpolated by cubic splines, to 1e-4 px for ordinary lenses.
    """
    u, v = ((np.arange(n * supersample) + 0.5) / supersample - 0.5 for n in camera.size_px)
    knots_u, knots_v = (np.linspace(-0.5, n - 0.5, max(n // 16, 4)) for n in camera.size_px)
    xy = camera.normalise(np.stack(np.meshgrid(knots_u, knots_v), axis=-1))
    if not np.isfinite(xy).all():
        raise ValueError(f"camera.distortion: {camera.distortion.tolist()} folds the image before its corners")
    ideal = xy @ camera.K[:2, :2].T + camera.K[:2, 2]
    splines = [RectBivariateSpline(knots_v, knots_u, ideal[..., i]) for i in range(2)]
    return np.stack([spline(v, u) for spline in splines], axis=-1)
