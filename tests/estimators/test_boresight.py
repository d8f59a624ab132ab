"""Boresight from control points: Jacobians, exact recovery, honest covariance, diagnosis, wrong clicks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.boresight_flights import ANTAR, MOUNTING, Conditions, Flight, fly
from estimators.aerial.boresight import (
    BoresightEstimate,
    BoresightPerImage,
    ControlPoints,
    boresight_from_gcps,
    boresight_per_image,
)
from estimators.aerial.boresight_model import (
    Common,
    Extra,
    Navigation,
    angle_jacobian,
    navigation_equations,
    unknowns,
)
from estimators.aerial.resection import ImagePoints, moved
from estimators.estimate import EstimationFailed
from sim.angles import Mounting, body_rotation, rotation_map_from_navigation
from sim.geodesy import Georeference
from sim.navigation import NavigationSolution
from sim.pose import Pose, exp_so3
from sim.streams import stream
from sim.trajectory import Trajectory

Array = np.ndarray
EXTRAS: tuple[Extra, ...] = ("lever", "time_offset", "gnss_offset")
EXACT = Conditions(
    lines=((0.0, 500.0), (90.0, 500.0), (180.0, 900.0), (270.0, 900.0)),
    images=16,
    time_offset_s=0.02,
    gnss_offset_m=(0.4, -0.3, 0.6),
    is_exact=True,
)
TWO_HEIGHTS = Conditions(
    lines=((0.0, 500.0), (180.0, 500.0), (0.0, 1000.0), (180.0, 1000.0)), images=18, time_offset_s=0.02
)


CLEAN = Conditions()


def flight(conditions: Conditions = CLEAN, run: int = 0) -> Flight:
    return fly(conditions, np.random.default_rng([3, run]))


def adjusted(f: Flight, extra: Sequence[Extra] = ()) -> BoresightEstimate:
    result = boresight_from_gcps(ANTAR, f.points, f.control, f.navigation, f.nominal, extra)
    assert isinstance(result, BoresightEstimate), result
    return result


def error(f: Flight, result: BoresightEstimate, extra: Sequence[Extra] = ()) -> Array:
    return np.asarray(result.x - f.truth.values()[unknowns(extra)[0]])


def test_equations_of_navigation_by_differences() -> None:
    f = flight(EXACT)
    rng = np.random.default_rng(0)
    T_wc = moved(f.T_wc, rng.normal(0, 0.2, (16, 6)))
    common = Common(Mounting(MOUNTING.boresight, np.array([0.4, -0.3, 0.2])), 0.3, np.array([1.0, 2, 3]))
    e, h = navigation_equations(T_wc, f.navigation, common), 1e-6
    for i in range(6):
        d = np.zeros((16, 6))
        d[:, i] = h
        ahead, back = (navigation_equations(moved(T_wc, s * d), f.navigation, common).r for s in (1, -1))
        np.testing.assert_allclose((ahead - back) / (2 * h), e.J[:, :, i], atol=1e-6)  # rounding of 1e3 m over 1e-6
    for i in range(10):
        g = np.zeros(10)
        g[i] = h
        ahead, back = (navigation_equations(T_wc, f.navigation, common.moved(s * g)).r for s in (1, -1))
        np.testing.assert_allclose((ahead - back) / (2 * h), e.G[:, :, i], atol=1e-6)


@pytest.mark.parametrize("angles_deg", [(0.8, -1.1, 1.7), (2.0, 30.0, -90.0)])
def test_jacobian_of_the_angles_by_differences(angles_deg: tuple[float, float, float]) -> None:
    common = Common(Mounting(np.deg2rad(angles_deg), np.zeros(3)))
    d = 1e-6 * np.eye(10)[:3]
    numeric = [(common.moved(x).mounting.boresight - common.moved(-x).mounting.boresight) / 2e-6 for x in d]
    np.testing.assert_allclose(np.stack(numeric, axis=1), angle_jacobian(common.mounting), atol=1e-8)


def test_sigmas_of_roll_pitch_and_heading_in_body_axes() -> None:
    rph = np.array([[0.4, -0.6, 2.0]])
    sigma = np.array([1e-5, 2e-5, 4e-5])
    rng = np.random.default_rng(0)
    zero = np.zeros((1, 3))
    nav = Navigation(np.zeros(1), Pose(body_rotation(rph, 0.0), zero), zero, zero, sigma, np.ones(3))
    noisy = body_rotation(rph + rng.normal(0, 1, (20000, 3)) * sigma, 0.0)
    R = np.swapaxes(nav.T_wb.R, 1, 2) @ noisy
    theta = np.stack([R[:, 2, 1], R[:, 0, 2], R[:, 1, 0]], axis=1)
    C = np.linalg.inv(nav.weights()[0, :3, :3])
    assert np.mean(np.einsum("ni,ij,nj->n", theta, np.linalg.inv(C), theta)) == pytest.approx(3, abs=0.07)  # 4 sigma
    np.testing.assert_allclose(np.cov(theta.T), C, atol=0.05 * C.max())


@pytest.mark.parametrize("extra", [(), EXTRAS])
def test_exact_measurements_give_the_exact_unknowns(extra: Sequence[Extra]) -> None:
    conditions = EXACT if extra else Conditions(is_exact=True)
    f = flight(conditions)
    nominal = Mounting(f.nominal.boresight, MOUNTING.lever_b + (0.5 if extra else 0.0))
    result = boresight_from_gcps(ANTAR, f.points, f.control, f.navigation, nominal, extra)
    assert isinstance(result, BoresightEstimate)
    assert np.abs(error(f, result, extra)[:3]).max() < 1e-9
    assert np.abs(error(f, result, extra)).max() < 1e-6
    assert result.rms_px < 1e-6
    assert len(result.rejected) == 0
    assert result.names[:3] == ("omega", "phi", "kappa")


def test_clean_conditions_meet_their_bounds_with_honest_covariance() -> None:
    runs, e, nees = 40, [], []
    for run in range(runs):
        f = flight(run=run)
        result = adjusted(f)
        e.append(error(f, result))
        nees.append(e[-1] @ np.linalg.solve(result.cov, e[-1]) / 3)
    sigma = np.rad2deg(np.sqrt(np.mean(np.square(e), axis=0)))
    assert np.all(sigma < [0.006, 0.006, 0.02])
    assert np.all(sigma > [0.002, 0.002, 0.006])  # not better than 9 images of 0.008 / 0.015 degrees can be
    assert abs(np.mean(nees) - 1) < 1.96 * np.sqrt(2 / (3 * runs))
    assert result.inseparable == ()
    assert result.redundancy == 2 * len(f.points) - 3


def test_errors_that_all_images_share_enter_the_covariance() -> None:
    runs, nees, ignored = 40, [], []
    for run in range(runs):
        f = flight(Conditions(constant_share=0.5), run)
        result = adjusted(f)
        e = error(f, result)
        nees.append(e @ np.linalg.solve(result.cov, e) / 3)
        independent = adjusted(replace(f, navigation=replace(f.navigation, constant_share=0.0)))
        e = error(f, independent)
        ignored.append(e @ np.linalg.solve(independent.cov, e) / 3)
    assert abs(np.mean(nees) - 1) < 2.6 * np.sqrt(2 / (3 * runs))  # 99 %
    assert np.mean(ignored) > 2
    assert result.names == ("omega", "phi", "kappa")
    assert np.any(result.common.gnss_offset_w)


def test_vibration_is_new_in_every_image_whatever_share_of_navigation_is_not() -> None:
    runs, nees = 40, []
    for run in range(runs):
        f = flight(Conditions(constant_share=0.5), run)
        shaken = np.deg2rad(0.08) * stream(5, run, "vibration").standard_normal((len(f.navigation), 3))
        T_wb = f.navigation.T_wb
        navigation = replace(f.navigation, T_wb=Pose(T_wb.R @ exp_so3(shaken), T_wb.t), vibration=np.deg2rad(0.08))
        result = adjusted(replace(f, navigation=navigation))
        e = error(f, result)
        nees.append(e @ np.linalg.solve(result.cov, e) / 3)
    assert abs(np.mean(nees) - 1) < 2.6 * np.sqrt(2 / (3 * runs))  # 99 %


def test_vibration_and_gnss_errors_give_the_residuals_and_scatter_of_the_source() -> None:
    rms, scatter = [], []
    for run in range(15):
        f = flight(Conditions(vibration_deg=0.08, sigma_gnss_m=0.3), run)
        rms.append(adjusted(f).rms_px)
        per_image = boresight_per_image(ANTAR, f.points, f.control, f.navigation, f.nominal)
        assert isinstance(per_image, BoresightPerImage)
        scatter.append(np.rad2deg(per_image.scatter))
    assert 4.5 < np.mean(rms) < 6.5
    assert np.all((np.mean(scatter, axis=0) > 0.05) & (np.mean(scatter, axis=0) < 0.12))


def test_the_mean_over_images_is_the_boresight() -> None:
    f = flight()
    per_image = boresight_per_image(ANTAR, f.points, f.control, f.navigation, f.nominal)
    assert isinstance(per_image, BoresightPerImage)
    deviation = np.rad2deg(per_image.mean - f.truth.mounting.boresight)
    assert np.all(np.abs(deviation) < [0.016, 0.016, 0.06])  # 4 sigma of 9 images
    np.testing.assert_allclose(per_image.mean, per_image.angles.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(per_image.scatter, per_image.angles.std(axis=0, ddof=1), rtol=1e-3)


def test_time_offset_at_one_height_and_speed_is_said_to_be_inseparable_from_pitch() -> None:
    result = adjusted(flight(Conditions(lines=((0.0, 500.0), (180.0, 500.0)), time_offset_s=0.02)), ["time_offset"])
    (group,) = result.inseparable
    assert set(group.names) == {"time_offset", "pitch"}
    assert group.correlation < -0.99
    assert "are not separable (correlation -0.99" in str(group)


def test_time_offset_is_recovered_from_two_heights_and_opposite_headings() -> None:
    dt = []
    for run in range(15):
        f = flight(TWO_HEIGHTS, run)
        result = adjusted(f, ["time_offset"])
        assert result.inseparable == ()
        dt.append(error(f, result, ["time_offset"])[3])
    assert np.sqrt(np.mean(np.square(dt))) < 0.004


def test_wrong_clicks_are_named_and_left_out() -> None:
    f = flight()
    uv = f.points.uv.copy()
    uv[[5, 30]] += [[25.0, 0], [-9, 12]]
    spoiled = ImagePoints(f.points.image, f.points.point, uv, 0.5)
    result = boresight_from_gcps(ANTAR, spoiled, f.control, f.navigation, f.nominal)
    assert isinstance(result, BoresightEstimate)
    wrong = np.stack([f.points.image, f.points.point], axis=1)[[5, 30]]
    assert {tuple(r) for r in wrong} <= {tuple(r) for r in result.rejected}
    assert np.all(np.abs(np.rad2deg(error(f, result))) < [0.018, 0.018, 0.06])  # 4.5 sigma


def test_an_image_without_points_takes_no_part() -> None:
    f = flight()
    result = boresight_from_gcps(ANTAR, f.points.select(f.points.image > 1), f.control, f.navigation, f.nominal)
    assert isinstance(result, BoresightEstimate)
    assert np.isfinite(result.T_wc.t).all()
    per_image = boresight_per_image(ANTAR, f.points.select(f.points.image > 1), f.control, f.navigation, f.nominal)
    assert isinstance(per_image, BoresightPerImage)
    assert np.isnan(per_image.angles).all(axis=1).tolist() == [True, True] + [False] * 7


def test_no_points_and_undetermined_unknowns_are_failures() -> None:
    f = flight()
    none = f.points.select(np.zeros(len(f.points), bool))
    failed = boresight_from_gcps(ANTAR, none, f.control, f.navigation, f.nominal)
    assert isinstance(failed, EstimationFailed)
    assert "no points" in failed.reason
    one = f.points.select(f.points.image == 0)
    failed = boresight_from_gcps(ANTAR, one, f.control, f.navigation, f.nominal, EXTRAS)
    assert isinstance(failed, EstimationFailed)
    assert "not determined" in failed.reason


def test_navigation_between_its_records() -> None:
    t = np.linspace(0, 2, 201)
    rph = np.stack([0.1 * np.sin(t), 0.05 * np.cos(t), 0.2 * t], axis=1)
    p = np.stack([60 * t, 5 * np.sin(t), np.full(201, 500.0)], axis=1)
    v = np.gradient(p, t, axis=0)
    nav = Navigation(t, Pose(body_rotation(rph, 0.0), p), v, np.zeros((201, 3)), np.full(3, 1e-4), np.full(3, 0.1))
    when = np.array([0.505, 1.5])
    at = nav.at(when)
    np.testing.assert_allclose(at.T_wb.t[:, 0], 60 * when, atol=1e-9)
    expected = body_rotation(np.stack([0.1 * np.sin(when), 0.05 * np.cos(when), 0.2 * when], axis=1), 0.0)
    np.testing.assert_allclose(at.T_wb.R, expected, atol=5e-6)  # second difference over 8: 0.1 * 0.01² / 8
    with pytest.raises(ValueError, match="outside 0"):
        nav.at(np.array([2.5]))


def test_a_navigation_solution_in_the_world_frame() -> None:
    reference = Georeference(32632, (691000.0, 5334000.0, 500.0))
    t = np.linspace(0, 4, 401)
    p = np.stack([60 * t, 8 * np.sin(t), 500 + 0 * t], axis=1)
    rph = np.stack([0.1 * np.sin(t), 0.05 * np.cos(t), 0.02 * t + 1.5], axis=1)
    moving = Trajectory(t, Pose(body_rotation(rph, reference.convergence(p)), p))
    velocity_n = np.einsum("nji,nj->ni", rotation_map_from_navigation(reference.convergence(p)), moving.velocity(t))
    solution = NavigationSolution(
        t, reference.to_crs(p), rph, velocity_n, np.full(3, 0.05), np.full(3, 1e-4), np.full(3, 0.005)
    )
    nav, inner = Navigation.from_solution(solution, reference), slice(5, -5)
    np.testing.assert_allclose(nav.T_wb.t, p, atol=1e-6)
    np.testing.assert_allclose(nav.T_wb.R, moving.T_wb.R, atol=1e-9)
    np.testing.assert_allclose(nav.velocity_w, moving.velocity(t), atol=1e-9)
    rate_b = np.einsum("nji,nj->ni", moving.T_wb.R, moving.angular_rate(t))
    # third derivative times half the span squared over 6: 0.1 * 0.05² / 6
    np.testing.assert_allclose(nav.rate_b[inner], rate_b[inner], atol=1e-4)


def test_wrong_input_is_refused() -> None:
    navigation = flight().navigation
    with pytest.raises(ValueError, match="sigma_rph: expected > 0"):
        replace(navigation, sigma_rph=np.zeros(3))
    with pytest.raises(ValueError, match="constant_share: expected"):
        replace(navigation, constant_share=1.0)
    with pytest.raises(ValueError, match="vibration: expected >= 0"):
        replace(navigation, vibration=-0.1)
    with pytest.raises(ValueError, match="strictly increasing"):
        replace(navigation, t_s=navigation.t_s[::-1])
    with pytest.raises(ValueError, match="sigma_m: expected > 0"):
        ControlPoints(np.zeros((2, 3)), 0.0)
