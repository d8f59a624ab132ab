"""Navigation solutions: exact without errors, with errors of the stated statistics, offset and metadata."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import replace
from datetime import datetime

import numpy as np
import pytest
from scipy.stats import chi2

from sim.camera_systems import antar, argos, exposures
from sim.flight import STILL, Flight, Gusts, Shaking, Vibration, fly, true_camera_pose
from sim.flight_path import FlightLine, approaches
from sim.geodesy import Georeference
from sim.imu import ChannelErrors, NavigationErrors, gauss_markov, navigation_solution, pos_av_410, stamps
from sim.navigation import NavigationSolution, image_records

Array = np.ndarray
MUNICH = Georeference.around(np.array([[11.5, 48.1]]), height_m=500.0)
RUNS = 300
BOUNDS = chi2.ppf([0.001, 0.999], RUNS)


@pytest.fixture(scope="module")
def flight() -> Flight:
    line = FlightLine((-700.0, 300.0), (700.0, -100.0), 500.0, 70.0)
    return fly([line], 1, 0, gusts=Gusts(), wind_mps=(5.0, 5.0))


def test_without_errors_the_solution_is_the_flight(flight: Flight) -> None:
    solution, truth = navigation_solution(flight.trajectory, MUNICH, NavigationErrors(), 1, 0)
    t = np.array([1.0, 7.0025, 13.333, 19.0])
    again = solution.pose(t, MUNICH)
    np.testing.assert_allclose(again.t, flight.trajectory.pose(t).t, atol=1e-6)
    # Linear between records of 200 Hz: some 0.3 rad/s² of gusts times (5 ms)²/8.
    np.testing.assert_allclose(again.R, flight.trajectory.pose(t).R, atol=2e-6)
    at_records = solution.pose(solution.t_s[[0, 700, -1]], MUNICH)
    np.testing.assert_allclose(at_records.R, flight.trajectory.pose(solution.t_s[[0, 700, -1]]).R, atol=1e-12)
    np.testing.assert_array_equal(truth.attitude, 0)
    assert len(solution) == pytest.approx((flight.trajectory.t_s[-1] - flight.trajectory.t_s[0]) * 200, abs=1.5)


def test_heading_and_velocity_refer_to_true_north() -> None:
    """Flying grid north at Munich the true heading is the convergence, 1.86 degrees."""
    north = fly([FlightLine((0.0, -700.0), (0.0, 700.0), 500.0, 70.0)], 1, 0)
    solution, _ = navigation_solution(north.trajectory, MUNICH, NavigationErrors(), 1, 0)
    assert np.rad2deg(solution.rph[:, 2].mean()) == pytest.approx(1.86, abs=0.01)
    gamma = np.deg2rad(1.86)
    expected = [70 * np.cos(gamma), 70 * np.sin(gamma), 0]
    np.testing.assert_allclose(solution.velocity_ned.mean(axis=0), expected, atol=0.02)
    assert solution.geographic[0, 2] == pytest.approx(1000)  # 500 m over the origin's 500 m


def test_gauss_markov_is_stationary_with_its_correlation_time() -> None:
    normal = np.random.default_rng(1).standard_normal((RUNS, 400))
    x = np.array([gauss_markov(row, 0.02) for row in normal])
    for k in (0, 1, 50, 399):
        assert BOUNDS[0] < np.sum(x[:, k] ** 2) < BOUNDS[1]
    for lag in (25, 50, 100):
        products = x[:, 0] * x[:, lag]
        assert products.mean() == pytest.approx(np.exp(-0.02 * lag), abs=4 * products.std() / np.sqrt(RUNS))


@pytest.mark.parametrize(("part", "axis", "expected"), [("white", 0, 2.0), ("bias", 1, 3.0), ("drift", 2, 4.0)])
def test_parts_have_their_sigma(part: str, axis: int, expected: float) -> None:
    errors = ChannelErrors(**{part: (2.0, 3.0, 4.0)})
    drawn = np.array([errors.draw("attitude", 21, 0.5, 1, run) for run in range(RUNS)])
    for k in (0, 20):
        assert BOUNDS[0] < np.sum((drawn[:, k, axis] / expected) ** 2) < BOUNDS[1]
    if part == "bias":
        assert np.ptp(drawn, axis=1).max() == 0


def test_random_walk_grows_with_the_root_of_time() -> None:
    errors = ChannelErrors(walk=(0.5, 0.5, 0.5))
    drawn = np.array([errors.draw("position", 101, 0.1, 1, run) for run in range(RUNS)])
    np.testing.assert_array_equal(drawn[:, 0], 0)
    for k in (10, 100):
        assert BOUNDS[0] < np.sum((drawn[:, k, 0] / (0.5 * np.sqrt(0.1 * k))) ** 2) < BOUNDS[1]


def test_every_part_has_its_own_stream() -> None:
    parts = {"white": (1.0, 1.0, 1.0), "bias": (1.0, 1.0, 1.0), "drift": (1.0, 1.0, 1.0), "walk": (1.0, 1.0, 1.0)}
    alone = {name: ChannelErrors(**{name: value}).draw("attitude", 500, 0.1, 1, 0) for name, value in parts.items()}
    np.testing.assert_allclose(ChannelErrors(**parts).draw("attitude", 500, 0.1, 1, 0), sum(alone.values()), atol=1e-12)
    white = np.column_stack([alone["white"], ChannelErrors(**parts).draw("position", 500, 0.1, 1, 0) * 0])
    assert np.abs(np.corrcoef(white[:, :3].T)[np.triu_indices(3, 1)]).max() < 4 / np.sqrt(500)
    other = ChannelErrors(white=(1.0, 1.0, 1.0)).draw("position", 500, 0.1, 1, 0)
    assert abs(np.corrcoef(other[:, 0], alone["white"][:, 0])[0, 1]) < 4 / np.sqrt(500)


def test_pos_av_410_keeps_the_table() -> None:
    """Table 3.1 as RMS over two minutes of 200 flights; of slow errors, each hardly two values: 4 % (1 sigma)."""
    errors = pos_av_410(0.3)
    attitude = np.array([errors.attitude.draw("attitude", 13, 10.0, 1, run) for run in range(200)])
    rms = np.rad2deg(np.sqrt(np.mean(attitude**2, axis=(0, 1))))
    np.testing.assert_allclose(rms, [0.008, 0.008, 0.015], rtol=0.12)
    np.testing.assert_allclose(np.rad2deg(errors.stated_attitude), [0.008, 0.008, 0.015], rtol=1e-12)
    position = np.array([errors.position.draw("position", 13, 10.0, 1, run) for run in range(200)])
    np.testing.assert_allclose(np.sqrt(np.mean(position**2, axis=(0, 1))), 0.3, rtol=0.12)


def test_errors_enter_the_solution_as_they_are_kept_in_the_truth(flight: Flight) -> None:
    errors = replace(pos_av_410(0.3), antenna_lever_b=(0.5, 0.0, 0.0))
    exact, _ = navigation_solution(flight.trajectory, MUNICH, NavigationErrors(), 1, 0, rate_hz=50.0)
    solution, truth = navigation_solution(flight.trajectory, MUNICH, errors, 1, 0, rate_hz=50.0)
    np.testing.assert_allclose(solution.rph - exact.rph, truth.attitude, atol=1e-12)
    np.testing.assert_array_equal(truth.attitude, errors.attitude.draw("attitude", len(truth.t_s), 0.02, 1, 0))
    moved = MUNICH.from_crs(solution.geographic) - MUNICH.from_crs(exact.geographic)
    np.testing.assert_allclose(moved, truth.position, atol=1e-6)
    lever = truth.position - errors.position.draw("position", len(truth.t_s), 0.02, 1, 0)
    np.testing.assert_allclose(lever, 0.5 * flight.trajectory.pose(truth.t_s).R[:, :, 0], atol=1e-12)
    again, _ = navigation_solution(flight.trajectory, MUNICH, errors, 1, 0, rate_hz=50.0)
    np.testing.assert_array_equal(again.geographic, solution.geographic)
    other, _ = navigation_solution(flight.trajectory, MUNICH, errors, 1, 1, rate_hz=50.0)
    assert np.abs(other.rph - solution.rph).max() > 1e-6


def test_records_of_the_lines_are_those_of_the_flight() -> None:
    """A line's records are the same with and without the rest, and a time between two lines is refused."""
    lines = approaches((0.0, 0.0), 700.0, 500.0, 70.0, (0.0, 180.0))
    flight = fly(lines, 1, 0, gusts=Gusts())
    whole, _ = navigation_solution(flight.trajectory, MUNICH, pos_av_410(), 1, 0, rate_hz=50.0)
    part, truth = navigation_solution(
        flight.trajectory, MUNICH, pos_av_410(), 1, 0, rate_hz=50.0, within_s=flight.line_s
    )
    assert len(part) == pytest.approx(2 * (10 + 2) * 50, abs=4)
    assert len(truth.t_s) == len(part)
    same = np.isin(whole.t_s, part.t_s)
    for name in ("rph", "geographic", "velocity_ned"):
        # SciPy's splines and PROJ give a row alone to a rounding of what they give in a batch.
        np.testing.assert_allclose(getattr(part, name), getattr(whole, name)[same], rtol=1e-13, atol=1e-12)
    inside = flight.line_s.mean(axis=1)
    np.testing.assert_allclose(part.pose(inside, MUNICH).t, whole.pose(inside, MUNICH).t, atol=1e-7)
    with pytest.raises(ValueError, match="lies in a gap of"):
        part.pose(flight.line_s[:1, 1] + 20, MUNICH)


def test_offset_and_jitter_of_the_stamps() -> None:
    t = np.arange(RUNS) / 5
    errors = NavigationErrors(time_offset_s=0.004, jitter_s=0.001)
    late = stamps(t, errors, "mono", 1, 0) - t - 0.004
    assert BOUNDS[0] < np.sum((late / 0.001) ** 2) < BOUNDS[1]
    np.testing.assert_array_equal(stamps(t, NavigationErrors(), "mono", 1, 0), t)
    assert np.abs(stamps(t, errors, "thermal", 1, 0) - stamps(t, errors, "mono", 1, 0)).max() > 0


def test_a_stamp_too_late_reads_a_later_pose(flight: Flight) -> None:
    """The sign of the offset: 4 ms at 70 m/s put the camera 0.28 m too far along the course."""
    solution, _ = navigation_solution(flight.trajectory, MUNICH, NavigationErrors(), 1, 0)
    t = np.array([10.0])
    late = stamps(t, NavigationErrors(time_offset_s=0.004), "mono", 1, 0)
    moved = solution.pose(late, MUNICH).t - flight.trajectory.pose(t).t
    course = flight.trajectory.velocity(10.0) / 70
    assert moved[0] @ course == pytest.approx(0.28, abs=1e-4)


def test_the_sources_residual_of_five_to_six_pixels() -> None:
    """0.08 degrees of vibration and 0.3 m of GNSS in ANTAR at 500 m; without vibration the IMU alone gives far less.

    A pixel is 0.023 degrees or 0.2 m: sqrt(2 (3.5² + 1.5²)) = 5.4, less the turning that does not reach the middle.
    """
    line = FlightLine((-350.0, 0.0), (350.0, 0.0), 500.0, 70.0)
    flight = fly([line], 1, 0, gusts=Gusts())
    head = antar().heads[0]
    t = np.linspace(4.0, 6.0, 9)
    points = np.random.default_rng(0).uniform([-60, -60, 0], [60, 60, 0], (8, 3))
    errors = pos_av_410(0.3)

    def residuals(vibration: Vibration, run: int) -> Array:
        true = true_camera_pose(flight.trajectory, head.mounting, Shaking.draw(vibration, "mono", 1, run), t)
        solution, _ = navigation_solution(flight.trajectory, MUNICH, errors, 1, run, within_s=np.array([[4.0, 6.0]]))
        found = solution.pose(stamps(t, errors, "mono", 1, run), MUNICH) @ head.mounting.T_bc
        uv = [[head.camera.project(T[i].inv().apply(points)) for i in range(len(t))] for T in (true, found)]
        return np.linalg.norm(np.subtract(*uv), axis=-1)

    shaken = np.sqrt(np.mean([residuals(Vibration(np.deg2rad(0.08)), run) ** 2 for run in range(20)]))
    still = np.sqrt(np.mean([residuals(STILL, run) ** 2 for run in range(20)]))
    assert 4.5 < shaken < 6.5
    assert 1.2 < still < 3.2  # 0.3 m, constant over a line: sqrt(2) 1.5, of 20 lines


def test_image_records_are_the_solution_at_the_stamps(flight: Flight) -> None:
    solution, _ = navigation_solution(flight.trajectory, MUNICH, pos_av_410(), 1, 0)
    system = antar()
    exposed = exposures(system, flight.line_s, 1, 0)
    records = image_records(system, exposed, exposed.t_s, solution, MUNICH)
    assert len(records) == len(exposed)
    mono = [r for r in records if r.head == "mono"]
    for record in mono[::10]:
        k = int(np.argmin(np.abs(solution.t_s - record.t_s)))
        np.testing.assert_allclose(solution.t_s[k], record.t_s, atol=1e-9)  # a record of 200 Hz at each frame of 5 Hz
        place = [record.longitude_deg, record.latitude_deg, record.height_m]
        np.testing.assert_allclose(place, solution.geographic[k], atol=1e-9)
        rph = np.deg2rad([record.roll_deg, record.pitch_deg, record.heading_deg])
        np.testing.assert_allclose(np.exp(1j * rph), np.exp(1j * solution.rph[k]), atol=1e-9)
    assert json.loads(json.dumps(dataclasses.asdict(mono[0])))["width_px"] == 1024
    assert len({r.file for r in records}) == len(records)
    passed = datetime.fromisoformat(mono[5].time_utc) - datetime.fromisoformat(mono[0].time_utc)
    assert passed.total_seconds() == pytest.approx(1.0, abs=1e-6)


def test_refusals(flight: Flight) -> None:
    solution, _ = navigation_solution(flight.trajectory, MUNICH, NavigationErrors(), 1, 0, rate_hz=50.0)
    spoiled = solution.rph.copy()
    spoiled[7, 2] = np.nan
    with pytest.raises(ValueError, match=r"rph: not finite in record 7 \(t ="):
        replace(solution, rph=spoiled)
    with pytest.raises(ValueError, match="strictly increasing"):
        replace(solution, t_s=solution.t_s[::-1].copy())
    with pytest.raises(ValueError, match="white"):
        ChannelErrors(white=(-1.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="drift_s"):
        ChannelErrors(drift_s=0.0)
    exposed = exposures(argos(), [(0.0, 100.0)], 1, 0)
    with pytest.raises(ValueError, match=r"NavigationSolution: .*outside"):
        image_records(argos(), exposed, exposed.t_s, solution, MUNICH)
    assert isinstance(solution, NavigationSolution)
