"""From the light that reaches the sensor to the grey values it reports: blur, vignetting, gain, noise, 8 bits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float, UInt8

Array = np.ndarray
_GREY = np.array([[0.299, 0.587, 0.114]], np.float32)  # ITU-R BT.601, as OpenCV's conversion


@dataclass(frozen=True)
class Sensor:
    """A camera's optics and electronics; numbers in grey levels of 0..255.

    ``blur_px``: standard deviation of the optical blur. ``vignetting``: share of the light lost in the corners.
    ``gain`` multiplies the grey values before they saturate. Noise per pixel and channel has the variance
    ``read_noise**2 + shot_noise**2 * grey / 255``. ``grey``: one channel. ``jpeg_quality`` 1..100, None for lossless.
    """

    blur_px: float = 0.5
    vignetting: float = 0.12
    gain: float = 1.0
    read_noise: float = 1.5
    shot_noise: float = 2.5
    grey: bool = False
    jpeg_quality: int | None = None

    def __post_init__(self) -> None:
        for name in ("blur_px", "vignetting", "read_noise", "shot_noise"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"Sensor.{name}: expected >= 0, got {getattr(self, name)}")
        if not self.gain > 0:
            raise ValueError(f"Sensor.gain: expected > 0, got {self.gain}")
        if self.vignetting > 1:
            raise ValueError(f"Sensor.vignetting: expected at most 1, got {self.vignetting}")
        if self.jpeg_quality is not None and not 1 <= self.jpeg_quality <= 100:
            raise ValueError(f"Sensor.jpeg_quality: expected 1..100, got {self.jpeg_quality}")


def expose(image: UInt8[Array, "h w 3"], sensor: Sensor, rng: np.random.Generator) -> UInt8[Array, "h w *c"]:
    """The image (h, w, 3) RGB or (h, w) grey that the sensor reports; all its randomness comes from ``rng``."""
    signal = cv2.transform(image, _GREY) if sensor.grey else image
    signal = signal.astype(np.float32)
    if sensor.blur_px > 0:
        signal = cv2.GaussianBlur(signal, (0, 0), sensor.blur_px)
    shading = sensor.gain * _shading(image.shape[0], image.shape[1], sensor.vignetting)
    signal *= shading if signal.ndim == 2 else shading[..., None]
    variance = sensor.read_noise**2 + (sensor.shot_noise**2 / 255) * signal
    signal += np.sqrt(variance) * rng.standard_normal(signal.shape, np.float32)
    reported = np.clip(np.rint(signal), 0, 255).astype(np.uint8)
    return reported if sensor.jpeg_quality is None else _through_jpeg(reported, sensor.jpeg_quality)


@lru_cache(maxsize=4)
def _shading(height: int, width: int, vignetting: float) -> Float[Array, "h w"]:
    """Share of the light that arrives: 1 in the middle, ``1 - vignetting`` in the corners, by the fourth power."""
    x, y = np.linspace(-1, 1, width), np.linspace(-1, 1, height)
    r2 = (x[None] ** 2 + y[:, None] ** 2) / 2
    return np.asarray(1 - vignetting * r2**2, np.float32)


def _through_jpeg(image: Array, quality: int) -> Array:
    bgr = image if image.ndim == 2 else image[..., ::-1]
    _, code = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
    decoded = np.asarray(cv2.imdecode(code, cv2.IMREAD_UNCHANGED))
    return np.ascontiguousarray(decoded if decoded.ndim == 2 else decoded[..., ::-1])
