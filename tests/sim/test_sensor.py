"""The sensor's effects one by one, each against the figure it is set to."""

from __future__ import annotations

import numpy as np
import pytest

from sim.sensor import Sensor, expose
from sim.streams import stream

IDEAL = Sensor(blur_px=0.0, vignetting=0.0, read_noise=0.0, shot_noise=0.0)
GREY_128 = np.full((200, 300, 3), 128, np.uint8)


def test_ideal_sensor_reports_what_arrives() -> None:
    image = np.random.default_rng(0).integers(0, 256, (40, 50, 3), np.uint8)
    np.testing.assert_array_equal(expose(image, IDEAL, np.random.default_rng(1)), image)


@pytest.mark.parametrize("grey", [False, True])
def test_noise_has_the_stated_variance(grey: bool) -> None:
    sensor = Sensor(blur_px=0.0, vignetting=0.0, read_noise=1.5, shot_noise=2.5, grey=grey)
    noise = expose(GREY_128, sensor, np.random.default_rng(2)).astype(float) - 128
    expected = np.sqrt(1.5**2 + 2.5**2 * 128 / 255 + 1 / 12)  # the last term is the rounding to 8 bits
    assert noise.ndim == (2 if grey else 3)
    assert abs(noise.mean()) < 3.5 * expected / np.sqrt(noise.size)
    assert abs(noise.std() / expected - 1) < 3.5 / np.sqrt(2 * noise.size)


def test_left_and_right_noise_are_uncorrelated_and_repeatable() -> None:
    sensor = Sensor(blur_px=0.0, vignetting=0.0, grey=True)
    left, again, right = (
        expose(GREY_128, sensor, stream(1, 0, name)) for name in ("ego/left/noise", "ego/left/noise", "ego/right/noise")
    )
    np.testing.assert_array_equal(left, again)
    correlation = np.corrcoef(left.ravel(), right.ravel())[0, 1]
    assert abs(correlation) < 3.5 / np.sqrt(left.size)


def test_blur_spreads_a_point_by_its_standard_deviation() -> None:
    image = np.zeros((41, 41, 3), np.uint8)
    image[20, 20] = 255
    spread = expose(image, Sensor(0.8, 0.0, 1.0, 0.0, 0.0), np.random.default_rng(0))[..., 0].astype(float)
    x = np.arange(41) - 20.0
    assert abs(np.sqrt((spread.sum(axis=0) * x**2).sum() / spread.sum()) - 0.8) < 0.05  # 8 bits cut the tails


def test_vignetting_darkens_the_corners_only() -> None:
    image = expose(GREY_128, Sensor(0.0, 0.25, 1.0, 0.0, 0.0), np.random.default_rng(0))
    assert image[0, 0, 0] == image[-1, -1, 0] == 96
    assert image[100, 150, 0] == 128


def test_gain_brightens_and_saturates() -> None:
    image = expose(np.array([[[100, 200, 0]]], np.uint8), Sensor(0.0, 0.0, 1.5, 0.0, 0.0), np.random.default_rng(0))
    np.testing.assert_array_equal(image, [[[150, 255, 0]]])


@pytest.mark.parametrize("grey", [False, True])
def test_jpeg_keeps_the_picture_and_its_channels(grey: bool) -> None:
    ramp = np.stack(np.broadcast_arrays(np.arange(64)[None] * 3, np.arange(64)[:, None] * 2, 30), axis=-1).astype(
        np.uint8
    )
    plain = Sensor(0.0, 0.0, 1.0, 0.0, 0.0, grey)
    jpeg = Sensor(0.0, 0.0, 1.0, 0.0, 0.0, grey, jpeg_quality=95)
    a, b = (expose(ramp, s, np.random.default_rng(0)).astype(float) for s in (plain, jpeg))
    assert a.shape == b.shape
    assert 0 < np.abs(a - b).mean() < 3


@pytest.mark.parametrize(
    "setting",
    [{"blur_px": -1.0}, {"read_noise": float("nan")}, {"gain": 0.0}, {"vignetting": 1.5}, {"jpeg_quality": 0}],
    ids=lambda s: next(iter(s)),
)
def test_impossible_sensors_are_refused(setting: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(setting))):
        Sensor(**setting)  # type: ignore[arg-type]  # one of several fields
