"""Wrong masks are wrong by what was asked for, the same again, and stay in place for a while."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import shift

from sim.masks import given_mask, wrong_mask
from sim.scenario import Scenario, WrongMask

V, U = np.indices((240, 320))
DISC = (U - 150) ** 2 + (V - 120) ** 2 <= 40**2


def wrong(frame: int = 0, seed: int = 1, run: int = 0, mask: np.ndarray = DISC, **errors: Any) -> np.ndarray:
    return wrong_mask(mask, WrongMask(kind="wrong", **errors), seed, run, "target", frame)


@pytest.mark.parametrize("by", [-7, -1, 1, 12])
def test_the_outline_moves(by: int) -> None:
    """A disc grown by a disc is one of the sum of their radii, but for the raster."""
    radius = np.sqrt(wrong(dilate_px=by).sum() / np.pi)
    assert radius == pytest.approx(40 + by, abs=0.6)


def test_the_mask_is_shifted() -> None:
    expected = shift(DISC.astype(int), (-3, 8), order=0).astype(bool)
    np.testing.assert_array_equal(wrong(shift_px=(8.2, -3.0)), expected)
    beyond = wrong(shift_px=(1000.0, 0.0))
    assert not beyond.any()


def test_holes_take_their_share() -> None:
    """Six discs of a fifth together; where they overlap or reach beyond, less is lost."""
    lost = [1 - (wrong(seed=s, holes=0.2) & DISC).sum() / DISC.sum() for s in range(20)]
    assert 0.08 < np.mean(lost) <= 0.2
    assert not (wrong(holes=0.2) & ~DISC).any()


def test_blobs_lie_beside_the_target() -> None:
    added = [(wrong(seed=s, neighbour=0.3) & ~DISC).sum() / DISC.sum() for s in range(20)]
    assert 0.15 < np.mean(added) <= 0.35
    assert (wrong(neighbour=0.3) & DISC).sum() == DISC.sum()


def test_errors_keep_their_places_for_some_frames() -> None:
    first = wrong(holes=0.2, neighbour=0.2, frames=5)
    np.testing.assert_array_equal(wrong(holes=0.2, neighbour=0.2, frames=5), first)
    np.testing.assert_array_equal(wrong(4, holes=0.2, neighbour=0.2, frames=5), first)
    for frame, seed, run in ((5, 1, 0), (0, 2, 0), (0, 1, 1)):
        assert (wrong(frame, seed, run, holes=0.2, neighbour=0.2, frames=5) != first).any()
    assert (wrong(holes=0.2, neighbour=0.3, frames=5) & DISC == wrong(holes=0.2, frames=5) & DISC)[first].all()


def test_a_target_that_is_not_seen_has_no_mask() -> None:
    assert not wrong(mask=np.zeros_like(DISC), dilate_px=5, holes=0.5, neighbour=0.5).any()


def test_the_front_end_is_given_what_the_scenario_says(make_scenario: Callable[..., Scenario]) -> None:
    def given(**measure: Any) -> np.ndarray | None:
        return given_mask(make_scenario(measure={"from": "images"} | measure), DISC, 3)

    default = given()
    assert default is not None
    np.testing.assert_array_equal(default, DISC)
    assert given(segmentation={"kind": "motion"}) is None
    dilated = given(segmentation={"kind": "wrong", "dilate_px": 4})
    assert dilated is not None
    np.testing.assert_array_equal(dilated, wrong(seed=7, frame=3, dilate_px=4))
