"""The elevation grid against SciPy, analytic ground and brute force; procedural relief against its statement."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from sim.streams import stream
from sim.terrain import ElevationGrid, plane, relief

BOUNDS = (-300.0, 200.0, 500.0, 900.0)


@pytest.fixture(scope="module")
def hills() -> ElevationGrid:
    rng = stream(1, 0, "test/terrain/relief")
    return relief(BOUNDS, 10.0, rng, rms_m=12.0, wavelengths_m=(80.0, 600.0), height_m=40.0)


def points(n: int, grid: ElevationGrid, seed: int = 0, margin: float = 0.0) -> np.ndarray:
    x0, y0, x1, y1 = grid.bounds_m
    u = np.random.default_rng(seed).random((n, 2))
    return np.array([x0 + margin, y0 + margin]) + u * (np.array([x1 - x0, y1 - y0]) - 2 * margin)


def test_height_agrees_with_scipy(hills: ElevationGrid) -> None:
    x0, y0, _, _ = hills.bounds_m
    rows, columns = hills.heights_m.shape
    oracle = RegularGridInterpolator((y0 + 10 * np.arange(rows), x0 + 10 * np.arange(columns)), hills.heights_m)
    xy = points(1000, hills)
    np.testing.assert_allclose(hills.height(xy), oracle(xy[:, ::-1]), atol=1e-10)
    np.testing.assert_array_equal(hills.on_ground(xy)[:, 2], hills.height(xy))


def test_nodes_and_edges_belong_to_the_ground_and_nothing_beyond(hills: ElevationGrid) -> None:
    x0, y0, x1, y1 = hills.bounds_m
    corners = np.array([[[x0, y0], [x1, y0]], [[x0, y1], [x1, y1]]])
    np.testing.assert_array_equal(hills.height(corners), hills.heights_m[[[0, 0], [-1, -1]], [[0, -1], [0, -1]]])
    assert hills.contains(corners).all()
    beyond = np.array([[x0 - 1e-6, y0], [x1 + 1e-6, y1], [x0, y1 + 1e-6], [np.nan, y0]])
    assert np.isnan(hills.height(beyond)).all()
    assert np.isnan(hills.normal(beyond)).all()
    assert not hills.contains(beyond).any()


def test_normal_is_perpendicular_to_the_surface(hills: ElevationGrid) -> None:
    xy = points(500, hills, margin=1.0)
    # Off the edges of the cells, where the gradient jumps.
    xy = xy[(np.abs(xy / 10 - np.round(xy / 10)) > 1e-3).all(axis=1)]
    step = 1e-4
    n = hills.normal(xy)
    np.testing.assert_allclose(np.linalg.norm(n, axis=-1), 1, atol=1e-12)
    for axis in np.eye(2):
        up = (hills.height(xy + step * axis) - hills.height(xy - step * axis)) / (2 * step)
        tangent = np.concatenate([np.broadcast_to(axis, xy.shape), up[:, None]], axis=1)
        # Rounding of heights of 1e2 m over a step of 1e-4 m.
        np.testing.assert_allclose(np.sum(n * tangent, axis=1), 0, atol=1e-8)


def test_steep_rays_find_the_ground_point_they_were_aimed_at(hills: ElevationGrid) -> None:
    target = hills.on_ground(points(2000, hills))
    origin = np.array([100.0, 500.0, 1400.0])
    np.testing.assert_allclose(hills.intersect(origin, target - origin), target, atol=1e-6)
    np.testing.assert_allclose(hills.intersect(np.array([origin]), 0.01 * (target - origin)), target, atol=1e-6)


@given(st.integers(0, 10_000))
def test_shallow_rays_meet_the_ground_first_where_dense_sampling_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = ElevationGrid(rng.normal(0, 30, (12, 9)), (5.0, -7.0), 20.0)
    origin = np.array([rng.uniform(-100, 300), rng.uniform(-150, 350), rng.uniform(60, 130)])
    target = grid.on_ground(points(40, grid, seed))
    d = target - origin
    hit = grid.intersect(origin, d)
    t = np.linspace(0, 1.05, 6001)
    along = origin + t[:, None] * d[:, None]
    above = along[..., 2] - grid.height(along[..., :2])
    for k in range(len(d)):
        below = np.flatnonzero(above[k] < 0)
        entered = np.flatnonzero(np.isfinite(above[k]))
        if np.isnan(hit[k]).any():
            # Only rays that come in below the ground at the edge, whose target hides behind it.
            assert len(below)
            assert below[0] == entered[0]
            continue
        s = float((hit[k] - origin) @ d[k] / (d[k] @ d[k]))
        np.testing.assert_allclose(grid.height(hit[k, :2]), hit[k, 2], atol=1e-8)
        if len(below):
            # Between the samples the ray can dip under a crest and out again, never the other way round.
            assert s <= t[below[0]] + 1e-12
        assert s <= 1 + 1e-9


def test_both_methods_meet_the_same_point(hills: ElevationGrid) -> None:
    """A steeper node far away switches all rays from iteration to marching and moves none of them."""
    target = hills.on_ground(points(500, hills, margin=30.0))
    origin = np.array([100.0, 500.0, 600.0])
    spiked = hills.heights_m.copy()
    spiked[0, 0] += 3000
    steep = ElevationGrid(spiked, hills.corner_m, hills.spacing_m)
    assert hills.steepest < 1.5 < 100 < steep.steepest
    np.testing.assert_allclose(
        hills.intersect(origin, target - origin), steep.intersect(origin, target - origin), atol=1e-6
    )


def test_rays_without_ground_meet_nothing(hills: ElevationGrid) -> None:
    above, inside = np.array([100.0, 500.0, 500.0]), np.array([100.0, 500.0])
    directions = np.array([[0, 0, 1], [1, 0, 0], [1, 0, 0.1], [3, 0, -1], [0, 0, 0]], float)
    assert np.isnan(hills.intersect(above, directions)).all()
    below = np.array([*inside, float(hills.height(inside)) - 1])
    assert np.isnan(hills.intersect(below, np.array([[0.0, 0, 1], [0, 0, -1], [1, 0, -0.1]]))).all()
    nadir = hills.intersect(above, np.array([0.0, 0, -2]))
    np.testing.assert_allclose(nadir, hills.on_ground(inside), atol=1e-9)


def test_rays_meet_planes_where_they_must() -> None:
    slope = plane(BOUNDS, 30.0, (0.1, -0.2))
    x0, y0, x1, y1 = BOUNDS
    rng = np.random.default_rng(3)
    origin, d = np.array([100.0, 500.0, 800.0]), rng.normal(0, 0.3, (300, 3)) - [0, 0, 1]
    n, middle = np.array([-0.1, 0.2, 1]), np.array([(x0 + x1) / 2, (y0 + y1) / 2, 30.0])
    expected = origin + (n @ (middle - origin) / (d @ n))[:, None] * d
    hit = slope.intersect(origin, d)
    on_grid = slope.contains(expected[:, :2])
    assert on_grid.sum() > 50
    np.testing.assert_allclose(hit[on_grid], expected[on_grid], atol=1e-6)
    assert np.isnan(hit[~on_grid]).all()
    assert slope.contains(np.array([[x0, y0], [x1, y1]])).all()
    flat = plane(BOUNDS, -3.0)
    assert (flat.lowest_m, flat.highest_m, flat.steepest) == (-3.0, -3.0, 0.0)


def test_relief_has_the_stated_height_deviation_and_band(hills: ElevationGrid) -> None:
    assert hills.heights_m.std() == pytest.approx(12.0, rel=1e-12)
    assert hills.heights_m.mean() == pytest.approx(40.0, rel=1e-12)
    x0, y0, x1, y1 = hills.bounds_m
    assert (x0, y0) == BOUNDS[:2]
    assert x1 >= BOUNDS[2]
    assert y1 >= BOUNDS[3]
    window = np.outer(*(np.hanning(n) for n in hills.heights_m.shape))
    power = np.abs(np.fft.rfft2((hills.heights_m - 40) * window)) ** 2
    f = np.hypot(np.fft.fftfreq(hills.heights_m.shape[0], 10)[:, None], np.fft.rfftfreq(hills.heights_m.shape[1], 10))
    # The window smears by two lines; beyond that nothing is left above the band.
    assert power[f > 1 / 80 + 3 / 700].sum() < 1e-6 * power.sum()


def test_relief_is_deterministic_and_steeper_with_shorter_waves() -> None:
    def of(seed: int, short: float) -> ElevationGrid:
        rng = stream(seed, 0, "t")
        return relief(BOUNDS, 10.0, rng, rms_m=5.0, wavelengths_m=(short, 600.0), exponent=3.0)

    np.testing.assert_array_equal(of(1, 50).heights_m, of(1, 50).heights_m)
    assert np.abs(of(1, 50).heights_m - of(2, 50).heights_m).max() > 1
    assert of(1, 30).steepest > 1.2 * of(1, 200).steepest


def test_wrong_grids_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 2 x 2"):
        ElevationGrid(np.zeros((1, 5)), (0.0, 0.0), 1.0)
    with pytest.raises(ValueError, match="1 heights are not finite"):
        ElevationGrid(np.array([[0, 1], [np.nan, 2]]), (0.0, 0.0), 1.0)
    with pytest.raises(ValueError, match="spacing_m: expected > 0"):
        ElevationGrid(np.zeros((2, 2)), (0.0, 0.0), 0.0)
    with pytest.raises(ValueError, match="wavelengths_m"):
        relief(BOUNDS, 10.0, np.random.default_rng(0), rms_m=1.0, wavelengths_m=(5.0, 100.0))
    with pytest.raises(ValueError, match="expected bounds"):
        plane((0.0, 0.0, -1.0, 5.0))
