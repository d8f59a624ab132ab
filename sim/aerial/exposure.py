"""A large image as a sensor reports it: `sim.sensor.expose` for tens of megapixels, in a fraction of the time."""

from __future__ import annotations

from typing import no_type_check

import cv2
import numba
import numpy as np
from jaxtyping import UInt8

from sim.camera_kernels import threaded
from sim.sensor import Sensor

Array = np.ndarray
_TABLE = 1 << 16
CAMERA = Sensor(blur_px=0.55, vignetting=0.10, gain=1.0, read_noise=1.0, shot_noise=2.0)
"""A good aerial camera: sharp, some 2 grey levels of noise."""


def expose(image: UInt8[Array, "h w 3"], sensor: Sensor, rng: np.random.Generator) -> UInt8[Array, "h w *c"]:
    """The image (h, w, 3) or (h, w) grey that the sensor reports: blur, vignetting, gain, noise, 8 bits, JPEG.

    Noise is drawn from a table of 65536 normal deviates by a generator of its own for every row, whose seeds come from
    ``rng``: the same on any number of threads.
    """
    signal = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[..., None] if sensor.grey else image
    if sensor.blur_px > 0:
        signal = cv2.GaussianBlur(signal, (0, 0), sensor.blur_px).reshape(signal.shape)
    h, w, _ = signal.shape
    grey = np.arange(256, dtype=np.float32)
    sigma = np.sqrt(sensor.read_noise**2 + sensor.shot_noise**2 / 255 * grey, dtype=np.float32)
    normal = rng.standard_normal(_TABLE, np.float32)
    seeds = rng.integers(1, 2**63, h, dtype=np.uint64)
    x2, y2 = np.linspace(-1, 1, w) ** 2, np.linspace(-1, 1, h) ** 2
    out = np.empty_like(signal)
    _report(signal, sigma, normal, seeds, x2, y2, sensor.gain, sensor.vignetting, out)
    reported = out[..., 0] if sensor.grey else out
    return reported if sensor.jpeg_quality is None else _through_jpeg(reported, sensor.jpeg_quality)


@threaded
@no_type_check
def _report(
    signal: Array, sigma: Array, normal: Array, seeds: Array, x2: Array, y2: Array, gain: float, loss: float, out: Array
) -> None:
    """Shading 1 - loss r^4 / 4, noise of a deviation by grey value, rounding; xorshift64 for the noise."""
    for i in numba.prange(signal.shape[0]):
        state = seeds[i]
        for j in range(signal.shape[1]):
            r2 = (x2[j] + y2[i]) / 2
            arrives = np.float32(gain * (1 - loss * r2 * r2))
            for k in range(signal.shape[2]):
                state ^= state << np.uint64(13)
                state ^= state >> np.uint64(7)
                state ^= state << np.uint64(17)
                value = signal[i, j, k] * arrives
                deviation = sigma[min(int(value), 255)] * normal[state >> np.uint64(48)]
                out[i, j, k] = np.uint8(min(max(value + deviation + np.float32(0.5), 0), 255))


def _through_jpeg(image: Array, quality: int) -> Array:
    bgr = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    _, code = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
    decoded = cv2.imdecode(code, cv2.IMREAD_UNCHANGED)
    return np.asarray(decoded if image.ndim == 2 else cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB))
