"""What the fast sensor stage does to a large image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim.aerial.exposure import CAMERA, expose
from sim.sensor import Sensor
from sim.sensor import expose as exact

Array = np.ndarray
PLAIN = Sensor(blur_px=0.0, vignetting=0.0, read_noise=2.0, shot_noise=3.0)


def flat(value: int) -> Array:
    return np.full((400, 300, 3), value, np.uint8)


@pytest.mark.parametrize("value", [40, 200])
def test_noise_has_the_stated_deviation_and_no_bias(value: int) -> None:
    out = expose(flat(value), PLAIN, np.random.default_rng(1)).astype(float)
    sigma = np.sqrt(2.0**2 + 3.0**2 * value / 255 + 1 / 12)
    # 360000 draws: four sigma of the mean and of the deviation.
    assert out.mean() == pytest.approx(value, abs=4 * sigma / 600)
    assert out.std() == pytest.approx(sigma, rel=0.01)
    flattened = (out - out.mean()).reshape(400, -1)
    assert abs(np.mean(flattened[:, 3:] * flattened[:, :-3])) < 0.01 * sigma**2 * 4
    assert abs(np.mean(flattened[1:] * flattened[:-1])) < 0.01 * sigma**2 * 4


def test_it_agrees_with_the_exact_stage_without_noise() -> None:
    image = np.random.default_rng(2).integers(0, 255, (120, 160, 3), dtype=np.uint8)
    sensor = Sensor(blur_px=0.7, vignetting=0.3, gain=1.1, read_noise=0.0, shot_noise=0.0)
    a, b = (f(image, sensor, np.random.default_rng(0)).astype(int) for f in (expose, exact))
    # One level more by rounding the blurred image.
    assert np.abs(a - b).max() <= 2


def test_the_same_seed_gives_the_same_image_in_grey_and_through_jpeg() -> None:
    image = flat(120)
    sensor = replace(CAMERA, grey=True, jpeg_quality=85)
    a, b = (expose(image, sensor, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(a, b)
    assert a.shape == (400, 300)
    color = expose(image, replace(CAMERA, jpeg_quality=95), np.random.default_rng(5))
    assert color.shape == image.shape
    assert abs(int(np.median(color)) - 120) <= 2
