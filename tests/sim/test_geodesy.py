"""UTM and world frame against pyproj's own inverse problems on the ellipsoid, and every refusal."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod, Transformer

from sim.geodesy import Georeference, ellipsoidal_height

Array = np.ndarray
MUNICH = np.array([11.5, 48.1, 520.0])


def azimuth_and_scale(reference: Georeference, p_w: Array, bearing: float, step_m: float = 20.0) -> tuple[float, float]:
    """Mean true azimuth of a short grid line about p_w and grid length over geodesic: the inverse geodesic problem."""
    d = 0.5 * step_m * np.array([np.sin(bearing), np.cos(bearing)])
    ends = reference.to_crs(np.stack([p_w - d, p_w + d]))
    start, back, length = Geod(ellps="WGS84").inv(*ends[0], *ends[1])
    azimuth = np.angle(np.exp(1j * np.deg2rad(start)) - np.exp(1j * np.deg2rad(back)))
    return float(azimuth), step_m / length


@given(st.floats(-2.9, 2.9), st.floats(-79, 83), st.integers(1, 60), st.floats(-3, 3))
def test_convergence_and_scale_are_those_of_short_lines(dlon: float, lat: float, zone: int, bearing: float) -> None:
    reference = Georeference((32600 if lat >= 0 else 32700) + zone)
    p_w = reference.from_crs(np.array([reference.central_meridian_deg + dlon, lat]))
    azimuth, scale = azimuth_and_scale(reference, p_w, bearing)
    gamma = float(reference.convergence(p_w))
    # The ends are good to a few nanometres of 20 m.
    assert abs(np.angle(np.exp(1j * (azimuth - gamma - bearing)))) < 1e-9
    assert reference.point_scale(p_w) == pytest.approx(scale, abs=2e-9)


def test_convergence_of_the_sources_flights_and_its_sign() -> None:
    """1.86 degrees at Munich in zone 32: true north lies west of grid north east of the central meridian."""
    reference = Georeference.around(MUNICH[None, :2])
    assert (reference.epsg, reference.zone, reference.is_north, reference.central_meridian_deg) == (
        32632,
        32,
        True,
        9.0,
    )
    p_w = reference.from_crs(MUNICH)
    assert np.rad2deg(reference.convergence(p_w)) == pytest.approx(1.86, abs=0.005)  # the figure has two decimals
    north = reference.from_crs(MUNICH + np.array([0, 0.001, 0])) - p_w
    assert np.arctan2(north[0], north[1]) == pytest.approx(-float(reference.convergence(p_w)), abs=1e-6)  # 111 m arc
    assert reference.point_scale(reference.from_crs(np.array([9.0, 48.0]))) == pytest.approx(0.9996, abs=1e-10)
    southern = Georeference(32732).from_crs(np.array([11.5, -48.1]))
    assert np.rad2deg(Georeference(32732).convergence(southern)) == pytest.approx(-1.86, abs=0.005)


@given(st.floats(-179.99, 179.99), st.floats(-79.9, 83.9), st.floats(-100, 9000))
def test_round_trip_and_the_zone_of_the_data(lon: float, lat: float, height: float) -> None:
    reference = Georeference.around(np.array([[lon, lat]]), height_m=300.0)
    assert abs((lon - reference.central_meridian_deg + 180) % 360 - 180) <= 3 + 1e-9
    assert reference.is_north == (lat >= 0)
    point = np.array([lon, lat, height])
    p_w = reference.from_crs(point)
    assert np.abs(p_w[:2]).max() <= 0.5 + 1e-6  # the origin is rounded to metres
    assert p_w[2] == pytest.approx(height - 300, abs=1e-9)
    back = reference.to_crs(p_w)
    # 1e-12 degrees are 1e-7 m; near the pole's side of 84 N a longitude is a tenth of that.
    np.testing.assert_allclose((back - point)[:2] * [np.cos(np.deg2rad(lat)), 1], 0, atol=2e-12)
    assert back[2] == pytest.approx(height, abs=1e-9)


def test_world_is_the_grid_less_its_origin_for_any_system_and_batch() -> None:
    reference = Georeference(32632, (690_000.0, 5_330_000.0, 500.0))
    rng = np.random.default_rng(3)
    p_w = rng.uniform(-2000, 2000, (4, 5, 3))
    grid = reference.to_grid(p_w)
    np.testing.assert_allclose(grid - p_w, np.broadcast_to(reference.origin_m, p_w.shape), atol=1e-9)
    np.testing.assert_allclose(reference.from_grid(grid), p_w, atol=1e-9)
    for crs in (4326, 25832, 3857, "EPSG:32633"):
        points = reference.to_crs(p_w, crs)
        expected = Transformer.from_crs(32632, crs, always_xy=True).transform(grid[..., 0], grid[..., 1])
        np.testing.assert_allclose(points[..., 0], expected[0], rtol=1e-13)
        np.testing.assert_array_equal(points[..., 2], grid[..., 2])
        np.testing.assert_allclose(reference.from_crs(points, crs), p_w, atol=1e-6)  # Web Mercator is iterated
        np.testing.assert_allclose(reference.from_crs(points[..., :2], crs), p_w[..., :2], atol=1e-6)
    assert reference.convergence(p_w).shape == reference.point_scale(p_w).shape == (4, 5)


def test_zone_across_the_date_line() -> None:
    reference = Georeference.around(np.array([[179.9, -17.0], [-179.7, -17.2]]))
    assert reference.epsg == 32701
    assert np.abs(reference.from_crs(np.array([179.9, -17.0]))).max() < 40_000


def test_heights_over_a_geoid_need_a_stated_undulation() -> None:
    np.testing.assert_array_equal(ellipsoidal_height(np.array([500.0, 510.0]), 46.5), [546.5, 556.5])
    for wrong in (465.0, np.nan):
        with pytest.raises(ValueError, match="undulation_m"):
            ellipsoidal_height(500.0, wrong)
    for crs in (9707, 5773, "EPSG:25832+7837"):  # WGS84 + EGM96, EGM96 alone, UTM + DHHN2016
        with pytest.raises(ValueError, match="heights over a geoid"):
            Georeference(32632).from_crs(MUNICH, crs)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Georeference(25832), "Georeference.epsg.*25832"),
        (lambda: Georeference(32661), "Georeference.epsg.*32661"),
        (lambda: Georeference(32632, (0.0, np.nan, 0.0)), "origin_m"),
        (lambda: Georeference.around(np.zeros((0, 2))), "no points"),
        (lambda: Georeference(32632).from_crs(MUNICH, "EPSG:99999"), "EPSG:99999.*not known"),
        (lambda: Georeference(32632).from_crs(np.array([[9.0, 48.0], [20.0, 48.0]])), "1 of 2.*zone 32.*longitude 20"),
        (lambda: Georeference(32632).from_crs(np.array([9.0, 85.0])), "latitude 85"),
        (lambda: Georeference(32632).from_crs(np.array([[9.0, np.nan]])), "1 of 1 points have no coordinates"),
        (lambda: Georeference(32632).from_crs(np.zeros(4)), r"\(4,\)"),
    ],
)
def test_refusals(make: object, message: str) -> None:
    assert callable(make)
    with pytest.raises(ValueError, match=message):
        make()
