"""Triangulated points, their covariance and their bias, by closed form, Monte-Carlo and sigma points."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.stereo.triangulation import information, second_order_bias, triangulate, undistorted, unscented
from sim.camera import StereoRig

Array = np.ndarray
both_rigs = pytest.mark.parametrize("kind", ["normal", "general"])

POINTS = np.array([[0.5, -0.3, 8.0], [-2.0, 0.4, 20.0], [3.0, 1.0, 35.0], [0.0, 0.0, 12.0]])


def unit(n: int, sigma_px: float = 1.0) -> Array:
    return np.broadcast_to(np.eye(4) * sigma_px**2, (n, 4, 4))


@both_rigs
def test_noise_free_points_are_recovered(rigs: dict[str, StereoRig], kind: str) -> None:
    rng = np.random.default_rng(0)
    p = np.column_stack([rng.uniform(-3, 3, 300), rng.uniform(-2, 2, 300), rng.uniform(6, 80, 300)])
    l, C = triangulate(rigs[kind], rigs[kind].project(p), unit(300, 0.2))
    # At 80 m one ulp of a pixel (1e-13) is Z²/(f B) = 21 m/px of depth.
    np.testing.assert_allclose(l, p, atol=1e-10)
    assert (np.linalg.eigvalsh(C) > 0).all()


def test_normal_case_is_the_closed_form(rigs: dict[str, StereoRig]) -> None:
    """(4.1.7) where both rows agree; else the rows' mean, which least squares gives with equal weights."""
    rig = rigs["normal"]
    rng = np.random.default_rng(1)
    uv = rig.project(POINTS)
    uv[:, [0, 2]] += rng.normal(0, 0.5, (4, 2))
    l, _ = triangulate(rig, uv, unit(4))
    Z = 0.3 * 1000 / (uv[:, 0] - uv[:, 2])
    expected = np.column_stack([(uv[:, 0] - 511.5) / 1000 * Z, (uv[:, 1] - 383.5) / 1000 * Z, Z])
    np.testing.assert_allclose(l, expected, rtol=1e-10)
    uv[:, 3] += 0.4
    np.testing.assert_allclose(triangulate(rig, uv, unit(4))[0][:, 1], (uv[:, 1] + 0.2 - 383.5) / 1000 * Z, rtol=1e-8)


@both_rigs
def test_four_coordinates_enter_with_their_weights(rigs: dict[str, StereoRig], kind: str) -> None:
    """The estimate is where the gradient of the weighted image residuals vanishes."""
    rig = rigs[kind]
    rng = np.random.default_rng(2)
    uv = rig.project(POINTS) + rng.normal(0, 0.3, (4, 4))
    half = rng.normal(size=(4, 4, 4))
    cov = half @ np.swapaxes(half, 1, 2) + np.eye(4)
    l, C = triangulate(rig, uv, cov)
    W = np.linalg.inv(cov)
    J = rig.project_jacobian(l)
    gradient = np.einsum("nab,nac,nc->nb", J, W, uv - rig.project(l))
    # Two Gauss-Newton steps from the linear solution: the gradient in units of its standard deviation.
    whitened = gradient / np.sqrt(np.einsum("naa->na", np.linalg.inv(C)))
    assert np.abs(whitened).max() < 1e-4
    np.testing.assert_allclose(np.linalg.inv(C), information(rig, l, W), rtol=1e-6)


@both_rigs
def test_covariance_by_monte_carlo(rigs: dict[str, StereoRig], kind: str) -> None:
    rig, n, sigma = rigs[kind], 20_000, 0.1
    rng = np.random.default_rng(3)
    for p in POINTS:
        uv = rig.project(p) + sigma * rng.standard_normal((n, 4))
        l, _ = triangulate(rig, uv, unit(n, sigma))
        C = triangulate(rig, rig.project(p[None]), unit(1, sigma))[1][0]
        L = np.linalg.inv(np.linalg.cholesky(C))
        whitened = L @ np.cov(l.T) @ L.T
        # 4.5 standard deviations sqrt(2/n) of a variance, and second order: (sigma_d/d)² = 3e-4 at 35 m.
        assert np.abs(whitened - np.eye(3)).max() < 4.5 * np.sqrt(2 / n) + 3e-3


@both_rigs
def test_covariance_by_sigma_points(rigs: dict[str, StereoRig], kind: str) -> None:
    rig, sigma = rigs[kind], 0.1
    uv = rig.project(POINTS)
    mean, C = unscented(lambda x: triangulate(rig, x, unit(4, sigma))[0], uv, unit(4, sigma))
    linear = triangulate(rig, uv, unit(4, sigma))[1]
    # Terms of higher order: a few (sigma_d/d)² = 1e-4.
    np.testing.assert_allclose(C, linear, rtol=0.01, atol=1e-3 * np.abs(linear).max(axis=(1, 2), keepdims=True).max())
    # The mean of the sigma points shows the second-order bias.
    bias = second_order_bias(rig, POINTS, np.linalg.inv(unit(4, sigma)))
    np.testing.assert_allclose((mean - POINTS)[:, 2], bias[:, 2], rtol=0.02)


@both_rigs
def test_unscented_propagation_where_the_linear_one_falls_short(rigs: dict[str, StereoRig], kind: str) -> None:
    """At 60 m with sigma 0.4 px, r² = (sigma_d/d)² = 0.0128: the variance of depth is Z² r² (1 + 8 r²).

    Sigma points lie on the axes of the four coordinates: they see what each does alone, 4 of the 8, and nothing of two
    together.
    """
    rig, n, sigma = rigs[kind], 200_000, 0.4
    p = np.array([1.0, 0.3, 60.0])
    noise = np.random.default_rng(6).standard_normal((n, 4))
    l, _ = triangulate(rig, rig.project(p) + sigma * noise, unit(n, sigma))
    uv = rig.project(p[None])
    points, C = triangulate(rig, uv, unit(1, sigma), "unscented")
    same, linear = triangulate(rig, uv, unit(1, sigma))
    np.testing.assert_array_equal(points, same)
    r2 = linear[0, 2, 2] / 60.0**2
    # Sixth order: 69 r^4 = 0.011 of the variance; scatter sqrt(2/n) = 0.003.
    assert np.var(l[:, 2]) / linear[0, 2, 2] == pytest.approx(1 + 8 * r2, abs=0.02)
    assert C[0, 2, 2] / linear[0, 2, 2] == pytest.approx(1 + 4 * r2, abs=0.01)
    assert r2 > 0.01  # the test can tell


def test_unscented_propagation_of_one_coordinate_is_exact_to_fourth_order(rigs: dict[str, StereoRig]) -> None:
    rig, n = rigs["normal"], 200_000
    cov = np.diag([0.4**2, 1e-8, 1e-8, 1e-8])[None]
    uv = rig.project(np.array([[1.0, 0.3, 60.0]]))
    shifted = np.repeat(uv, n, axis=0)
    shifted[:, 0] += 0.4 * np.random.default_rng(7).standard_normal(n)
    l, _ = triangulate(rig, shifted, np.repeat(cov, n, axis=0))
    C = triangulate(rig, uv, cov, "unscented")[1][0]
    # 69 s^4 = 0.003 of the variance with s² = 0.0064, scatter 0.003; the linear one is 0.05 short.
    assert C[2, 2] == pytest.approx(np.var(l[:, 2]), rel=0.0125)
    assert triangulate(rig, uv, cov)[1][0, 2, 2] < 0.96 * C[2, 2]


def test_where_sigma_points_fail_the_linear_covariance_stands(rigs: dict[str, StereoRig]) -> None:
    """A disparity of one standard deviation: some sigma points lie behind infinity."""
    uv = rigs["normal"].project(POINTS)
    uv[1] = [511.5, 383.5, 511.5 - 0.4, 383.5]
    _, linear = triangulate(rigs["normal"], uv, unit(4, 0.4))
    _, C = triangulate(rigs["normal"], uv, unit(4, 0.4), "unscented")
    np.testing.assert_array_equal(C[1], linear[1])
    assert (C[[0, 2, 3], 2, 2] > linear[[0, 2, 3], 2, 2]).all()


def test_unscented_transform_of_a_linear_and_a_quadratic_function() -> None:
    """Exact for linear functions; mean exact for quadratic ones."""
    rng = np.random.default_rng(4)
    A, x = rng.normal(size=(2, 4)), rng.normal(size=(5, 4))
    half = rng.normal(size=(5, 4, 4))
    C = half @ np.swapaxes(half, 1, 2)
    mean, cov = unscented(lambda y: y @ A.T, x, C)
    np.testing.assert_allclose(mean, x @ A.T, atol=1e-12)
    np.testing.assert_allclose(cov, A @ C @ A.T, atol=1e-11)
    mean, _ = unscented(lambda y: np.sum(y * y, axis=1, keepdims=True), x, C)
    np.testing.assert_allclose(mean[:, 0], np.sum(x * x, axis=1) + np.trace(C, axis1=1, axis2=2), rtol=1e-12)


def test_bias_of_the_normal_case_is_the_source_s(rigs: dict[str, StereoRig]) -> None:
    """Depth: Z (sigma_d/d)² with sigma_d² = 2 sigma², (4.1.13); the ray keeps its direction."""
    sigma = 0.2
    bias = second_order_bias(rigs["normal"], POINTS, np.linalg.inv(unit(4, sigma)))
    d = 300 / POINTS[:, 2]
    relative = 2 * sigma**2 / d**2
    np.testing.assert_allclose(bias[:, 2], POINTS[:, 2] * relative, rtol=1e-9)
    # Laterally the left ray's own noise counts as well: E[dx dZ] = Z/f * cov(u, Z) = -Z² sigma² / (f d).
    expected = POINTS[:, 0] * relative - POINTS[:, 2] / 1000 * sigma**2 / d
    np.testing.assert_allclose(bias[:, 0], expected, rtol=1e-9)


@both_rigs
def test_bias_by_monte_carlo(rigs: dict[str, StereoRig], kind: str) -> None:
    """Two-sided: the mean of the triangulated points is off by the stated bias, no less and no more."""
    rig, n, sigma = rigs[kind], 100_000, 0.5
    rng = np.random.default_rng(5)
    for p in POINTS[1:3]:
        noise = rng.standard_normal((n // 2, 4))
        uv = rig.project(p) + sigma * np.concatenate([noise, -noise])  # antithetic: odd orders cancel
        l, _ = triangulate(rig, uv, unit(n, sigma))
        pairs = (l[: n // 2] + l[n // 2 :]) / 2 - p
        bias = second_order_bias(rig, p[None], np.linalg.inv(unit(1, sigma)))[0]
        error, spread = pairs.mean(axis=0) - bias, pairs.std(axis=0) / np.sqrt(n // 2)
        # Fourth order: 3 (sigma_d/d)² of the bias itself (3 * 0.0068 at 35 m), and lens distortion left out (general).
        assert (np.abs(error) < 4.5 * spread + 0.025 * np.abs(bias[2])).all()
        assert bias[2] > 20 * spread[2]  # the test can tell


def test_rays_that_do_not_meet_in_front_have_no_point(rigs: dict[str, StereoRig]) -> None:
    for rig in rigs.values():
        uv = rig.project(POINTS)
        good = triangulate(rig, uv, unit(4))[0]
        uv[1, 2] = uv[1, 0] + 60  # diverging
        l, C = triangulate(rig, uv, unit(4))
        assert np.isnan(l[1]).all()
        assert np.isnan(C[1]).all()
        np.testing.assert_array_equal(l[[0, 2, 3]], good[[0, 2, 3]])


@pytest.mark.parametrize("disparity", [0.0, 1e-12, 1e-9, 1e-3])
def test_almost_parallel_rays_break_nothing(rigs: dict[str, StereoRig], disparity: float) -> None:
    uv = rigs["normal"].project(POINTS)
    good = triangulate(rigs["normal"], uv, unit(4))[0]
    uv[1] = [511.5, 383.5, 511.5 - disparity, 383.5]
    l, _ = triangulate(rigs["normal"], uv, unit(4))
    np.testing.assert_array_equal(l[[0, 2, 3]], good[[0, 2, 3]])
    assert np.isnan(l[1]).all() or l[1, 2] > 1e4


@both_rigs
def test_nothing_gives_nothing(rigs: dict[str, StereoRig], kind: str) -> None:
    l, C = triangulate(rigs[kind], np.empty((0, 4)), np.empty((0, 4, 4)))
    assert l.shape == (0, 3)
    assert C.shape == (0, 3, 3)


def test_undistorted_observations_see_the_same_points_as_accurately(rigs: dict[str, StereoRig]) -> None:
    rng = np.random.default_rng(4)
    uv = rigs["general"].project(POINTS)
    half = rng.normal(size=(4, 4, 4))
    cov = half @ np.swapaxes(half, 1, 2)
    rig, uv_ideal, cov_ideal = undistorted(rigs["general"], uv, cov)
    assert not rig.left.is_distorted
    np.testing.assert_allclose(uv_ideal, rig.project(POINTS), atol=1e-9)
    # What they say of the points' accuracy does not change.
    before = information(rigs["general"], POINTS, np.linalg.inv(cov))
    after = information(rig, POINTS, np.linalg.inv(cov_ideal))
    np.testing.assert_allclose(after, before, rtol=1e-8, atol=1e-8 * np.abs(before).max())
    same = undistorted(rigs["normal"], uv, cov)
    assert same[0] is rigs["normal"]
    np.testing.assert_array_equal(same[1], uv)
