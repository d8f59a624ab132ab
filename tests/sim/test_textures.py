"""Procedural textures: spectrum as stated, seamless, deterministic, drawn where the board says."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from sim.textures import (
    Board,
    asphalt_texture,
    grass,
    leaves,
    linear_from_srgb,
    noise,
    paint_texture,
    slabs,
)

MAKERS = [asphalt_texture, grass, leaves, paint_texture, slabs]


@pytest.mark.parametrize("beta", [0.35, 1.0, 2.4])
def test_noise_has_the_stated_slope(beta: float) -> None:
    """Slope of the radial mean of the periodogram; 1024^2 samples make it sharp to 0.05."""
    field = noise((1024, 1024), beta, np.random.default_rng(0))
    assert field.mean() == pytest.approx(0, abs=1e-4)
    assert field.std() == pytest.approx(1, abs=1e-4)
    P = np.abs(np.fft.fft2(field)) ** 2
    f = np.hypot(np.fft.fftfreq(1024)[:, None], np.fft.fftfreq(1024))
    edges = np.geomspace(0.01, 0.4, 12)
    power = [P[(f >= a) & (f < b)].mean() for a, b in pairwise(edges)]
    slope = np.polyfit(np.log(np.sqrt(edges[1:] * edges[:-1])), np.log(power), 1)[0]
    assert slope == pytest.approx(-beta, abs=0.05)


@pytest.mark.parametrize("make", MAKERS)
def test_textures_are_deterministic_powers_of_two(make: Callable[..., np.ndarray]) -> None:
    a, b, c = (make(np.random.default_rng(s), 256) for s in (1, 1, 2))
    assert a.dtype == np.uint8
    assert a.shape == (256, 256, 3)
    np.testing.assert_array_equal(a, b)
    assert np.any(a != c)


@pytest.mark.parametrize("make", MAKERS)
def test_textures_tile_without_a_seam(make: Callable[..., np.ndarray]) -> None:
    """The step across the border is no larger than the steps inside (5 sigma of their spread over rows)."""
    image = make(np.random.default_rng(3), 512).astype(float).mean(axis=2)
    for field in (image, image.T):
        steps = np.abs(np.diff(field, axis=1)).mean(axis=0)
        seam = np.abs(field[:, 0] - field[:, -1]).mean()
        assert seam < steps.max() + 5 * steps.std() / np.sqrt(len(steps))


def test_srgb_matches_the_standard() -> None:
    # IEC 61966-2-1: the ends, the joint of line and curve, and mid grey.
    x = np.array([0.0, 0.04045, 0.5, 1.0])
    np.testing.assert_allclose(linear_from_srgb(x), [0.0, 0.04045 / 12.92, 0.21404, 1.0], atol=1e-5)


def test_board_draws_to_scale() -> None:
    """A rectangle of 2 x 1 m at 40 px/m covers 80 x 40 pixels at its place, its edges shared by area."""
    image = np.zeros((100, 200, 3), np.float32)
    board = Board(image, (20, 90), (40, -40))
    board.rect(0.5, 0.25, 2.0, 1.0, (1.0, 0.5, 0.0))
    rows, columns = np.nonzero(image[..., 0] > 0.5)
    assert abs(columns.min() - 40) <= 1
    assert abs(columns.max() - 119) <= 1
    assert abs(rows.max() - 79) <= 1
    assert abs(rows.min() - 40) <= 1
    np.testing.assert_allclose(image[60, 80], [1, 0.5, 0])


def test_board_leaves_out_what_is_outside() -> None:
    image = np.zeros((10, 10, 3), np.float32)
    Board(image, (0, 0), (1, 1)).poly([(20, 20), (30, 20), (30, 30)], (1, 1, 1))
    assert not image.any()
    Board(image, (0, 0), (1, 1)).text(7, 7, 6, 6, "X", (1, 1, 1))
    assert image.any()
