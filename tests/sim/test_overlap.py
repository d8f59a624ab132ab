"""Oriented boxes against shapely."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from sim.overlap import overlapping


@pytest.mark.parametrize("seed", range(5))
def test_the_pairs_are_shapelys(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 150
    centre, angle, size = rng.uniform(0, 60, (n, 2)), rng.uniform(0, 7, n), rng.uniform([2, 1], [14, 3], (n, 2))
    d = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    left = np.stack([-d[:, 1], d[:, 0]], axis=1)
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) / 2
    half = signs[None] * size[:, None]
    corners = centre[:, None] + half[..., :1] * d[:, None] + half[..., 1:] * left[:, None]
    boxes = shapely.polygons(corners)
    expected = {(i, j) for i, j in shapely.STRtree(boxes).query(boxes, predicate="intersects").T if i < j}
    found = [tuple(pair) for pair in overlapping(centre, d, size)]
    assert len(found) == len(set(found)) > 50
    assert set(found) == expected
    moving = rng.random(n) < 0.3
    some = {tuple(pair) for pair in overlapping(centre, d, size, moving)}
    assert some == {(i, j) for i, j in expected if moving[i] or moving[j]}


def test_absent_boxes_overlap_none() -> None:
    centre = np.array([[0.0, 0], [np.nan, np.nan], [0.5, 0]])
    d, size = np.tile([1.0, 0], (3, 1)), np.ones((3, 2))
    assert overlapping(centre, d, size).tolist() == [[0, 2]]
    assert overlapping(centre[1:2], d[:1], size[:1]).shape == (0, 2)
    assert overlapping(centre, d, size, np.array([False, True, False])).shape == (0, 2)
