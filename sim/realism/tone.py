"""Between the renderer's grey values and linear light: where light adds up, it must not be added in grey values."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from jaxtyping import Float, UInt8

Array = np.ndarray


def _response(light: Array) -> Array:
    """The renderer's filmic response to light and its gamma 2 (function ``tone`` of the shaders), in 0..1."""
    ratio = light * (2.51 * light + 0.03) / (light * (2.43 * light + 0.59) + 0.14)
    return np.asarray(np.sqrt(np.clip(ratio, 0, 1)))


@cache
def _light_of_grey() -> Array:
    """Light of the grey values 0..255: the positive root of the response's quadratic equation."""
    y = (np.arange(256) / 255) ** 2
    a, b, c = 2.51 - 2.43 * y, 0.03 - 0.59 * y, -0.14 * y
    return np.asarray((-b + np.sqrt(b * b - 4 * a * c)) / (2 * a), np.float32)


@cache
def _grey_of_light() -> tuple[Array, float]:
    """Grey values over evenly spaced square roots of light, and how many there are per unit."""
    per_unit = 16000.0
    root = np.arange(int(per_unit * np.sqrt(float(_light_of_grey()[-1])) * 1.01) + 1) / per_unit
    return np.rint(255 * _response(root**2)).astype(np.uint8), per_unit


def to_light(image: UInt8[Array, "h w 3"]) -> Float[Array, "h w 3"]:
    """Linear light (float32; a white wall in the sun is about 2, 7.2 the brightest) of an image before the sensor."""
    return np.asarray(cv2.LUT(image, _light_of_grey()))


def to_image(light: Float[Array, "h w 3"]) -> UInt8[Array, "h w 3"]:
    """The image of linear light; inverse of `to_light`."""
    table, per_unit = _grey_of_light()
    root = cv2.sqrt(np.maximum(light, 0, dtype=np.float32))
    at = np.minimum(root * np.float32(per_unit) + np.float32(0.5), len(table) - 1).astype(np.int32)
    return np.asarray(table[at])
