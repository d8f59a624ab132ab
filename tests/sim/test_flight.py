"""Flights: lines are flown exactly, turns are shortest and coordinated, gusts and vibration as stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from sim.angles import Mounting, body_angles
from sim.flight import SAMPLE_HZ, STILL, Flight, Gusts, Shaking, Vibration, fly, true_camera_pose
from sim.flight_path import GRAVITY, FlightLine, approaches, block, shortest_turn, trace, turn_radius
from sim.pose import log_so3

Array = np.ndarray
CROSS = approaches((100.0, 200.0), 2000.0, 500.0, 70.0)
coordinate = st.floats(-3000, 3000)
angle = st.floats(-3.1, 3.1)


@given(coordinate, coordinate, angle, angle)
def test_shortest_turn_arrives(x: float, y: float, a: float, b: float) -> None:
    """At its end in its direction, and not shorter than the crow or longer than two circles more."""
    start, end, radius = np.zeros(2), np.array([x, y]), 400.0
    arcs = shortest_turn(start, a, end, b, radius)
    length = sum(s for _, s in arcs)
    np.testing.assert_allclose(trace(start, a, arcs, np.array([length]))[0], end, atol=1e-8)
    turned = a + sum(curvature * s for curvature, s in arcs)
    assert np.angle(np.exp(1j * (turned - b))) == pytest.approx(0, abs=1e-9)
    assert np.hypot(x, y) - 1e-9 <= length <= np.hypot(x, y) + 4 * np.pi * radius + 4 * radius
    # A way's mirror image is as long.
    mirrored = shortest_turn(start, -a, np.array([x, -y]), -b, radius)
    assert sum(s for _, s in mirrored) == pytest.approx(length, abs=1e-6)


def test_shortest_turns_known_by_hand() -> None:
    ahead = shortest_turn(np.zeros(2), 0.3, 1000 * np.array([np.cos(0.3), np.sin(0.3)]), 0.3, 400.0)
    assert sum(s for _, s in ahead) == pytest.approx(1000)  # straight on, without a circle
    back = shortest_turn(np.zeros(2), 0.0, np.array([0.0, 800.0]), np.pi, 400.0)
    assert sum(s for _, s in back) == pytest.approx(400 * np.pi)  # half a circle to the left
    assert max(curvature for curvature, s in back if s > 1e-6) == pytest.approx(1 / 400)


def test_lines_are_flown_exactly_from_end_to_end() -> None:
    lines = (*CROSS, *block(FlightLine((3000.0, 0.0), (3000.0, 3000.0), 1400.0, 80.0), 400.0, 3))
    flight = fly(lines, 1, 0)
    for line, (begin, end) in zip(lines, flight.line_s, strict=True):
        t = np.linspace(begin, end, 9)
        ideal = np.linspace(line.start_m, line.end_m, 9)
        found = flight.trajectory.pose(t)
        np.testing.assert_allclose(found.t, np.column_stack([ideal, np.full(9, line.height_m)]), atol=1e-7)
        np.testing.assert_allclose(np.linalg.norm(flight.trajectory.velocity(t), axis=-1), line.speed_mps, atol=1e-7)
        rph = body_angles(found.R, 0.0)
        np.testing.assert_allclose(rph[:, :2], 0, atol=1e-6)
        np.testing.assert_allclose(np.exp(1j * rph[:, 2]), np.exp(1j * (np.pi / 2 - line.direction)), atol=1e-9)
    assert flight.line_s[0, 0] == 0
    assert np.all(flight.line_s[1:, 0] > flight.line_s[:-1, 1])


def test_four_approaches_meet_over_the_centre() -> None:
    assert [round(np.rad2deg(np.pi / 2 - line.direction)) % 360 for line in CROSS] == [0, 90, 180, 270]
    for line in CROSS:
        np.testing.assert_allclose(np.mean([line.start_m, line.end_m], axis=0), [100, 200], atol=1e-9)
        assert line.length_m == pytest.approx(2000)


def test_block_alternates_and_moves_to_the_right() -> None:
    east = FlightLine((0.0, 0.0), (1000.0, 0.0), 500.0, 70.0)
    _, second, third = block(east, 300.0, 3)
    np.testing.assert_allclose([second.start_m, second.end_m], [[1000, -300], [0, -300]], atol=1e-9)
    np.testing.assert_allclose([third.start_m, third.end_m], [[0, -600], [1000, -600]], atol=1e-9)


def test_turns_are_banked_as_stated_and_smooth() -> None:
    bank = np.deg2rad(25)
    flight = fly(CROSS[:2], 1, 0, bank=bank)
    t = flight.trajectory.t_s
    rph = body_angles(flight.trajectory.T_wb.R, 0.0)
    right = flight.trajectory.pose(t).R[:, :, 1]
    force = flight.trajectory.acceleration(t) + np.array([0, 0, GRAVITY])
    # Coordinated: nothing pulls sideways in the body, to the spline's own second derivative.
    assert np.abs(np.sum(right * force, axis=-1)).max() < 1e-6 * GRAVITY
    assert np.abs(rph[:, 0]).max() == pytest.approx(bank, abs=1e-3)  # averaging over 4 s shrinks the circle by 1e-4
    assert turn_radius(70.0, bank) == pytest.approx(70**2 / GRAVITY / np.tan(bank))
    assert np.abs(np.diff(rph[:, 0])).max() * SAMPLE_HZ < np.deg2rad(25)  # rolls into 25 degrees in some seconds


def test_wind_turns_the_nose_and_not_the_course() -> None:
    line = FlightLine((0.0, 0.0), (0.0, 2000.0), 500.0, 70.0)
    flight = fly([line], 1, 0, wind_mps=(10.0, 0.0))
    middle = flight.trajectory.pose(10.0)
    np.testing.assert_allclose(middle.t, [0, 700, 500], atol=1e-7)
    assert body_angles(middle.R, 0.0)[2] == pytest.approx(-np.arctan2(10, 70))  # into the wind from the west


def test_climbs_take_circles() -> None:
    low, high = CROSS[0], replace(CROSS[1], height_m=3500.0, speed_mps=80.0)
    flight = fly([low, high], 1, 0)
    v = flight.trajectory.velocity(flight.trajectory.t_s)
    assert np.arctan2(v[:, 2], np.hypot(v[:, 0], v[:, 1])).max() < np.deg2rad(6.01)
    shortest_s = 3000 / (80 * np.tan(np.deg2rad(6.0)))
    circle_m = 2 * np.pi * turn_radius(80.0, np.deg2rad(20))
    assert shortest_s < flight.line_s[1, 0] - flight.line_s[0, 1] < 80 / 70 * shortest_s + circle_m / 70 + 10
    level = fly([low, replace(high, height_m=500.0)], 1, 0)
    assert level.line_s[1, 0] < flight.line_s[1, 0] - circle_m / 80  # the turn alone is too short


def flown(run: int, **options: object) -> Flight:
    return fly([FlightLine((0.0, 0.0), (2000.0, 0.0), 500.0, 70.0)], 3, run, **options)  # type: ignore[arg-type]  # of all kinds


def test_gusts_have_their_sigmas_and_streams() -> None:
    sigma = np.deg2rad([1.0, 0.5, 0.3])
    gusts = Gusts(tuple(sigma.tolist()))
    rph = np.array([body_angles(flown(run, gusts=gusts).trajectory.pose(10.0).R, 0.0) for run in range(200)])
    low, high = chi2.ppf([0.001, 0.999], 200)
    normed = (rph - [0, 0, np.pi / 2]) / sigma
    assert np.all((low < np.sum(normed**2, axis=0)) & (np.sum(normed**2, axis=0) < high))
    correlation = np.corrcoef(normed.T)[np.triu_indices(3, 1)]
    assert np.abs(correlation).max() < 4 / np.sqrt(200)
    other = Gusts((float(sigma[0]), 0.0, 0.0))  # one axis' stream does not depend on another's
    np.testing.assert_allclose(
        body_angles(flown(0, gusts=other).trajectory.pose(10.0).R, 0.0)[0], rph[0, 0], atol=1e-12
    )
    np.testing.assert_array_equal(flown(5, gusts=gusts).trajectory.T_wb.R, flown(5, gusts=gusts).trajectory.T_wb.R)


def test_vibration_turns_the_camera_and_not_the_body() -> None:
    """0.08 degrees about each axis of the camera, independent between images and cameras, and the place unmoved."""
    vibration = Vibration(np.deg2rad(0.08))
    t = np.arange(0, 20, 0.2)
    trajectory = flown(0).trajectory
    mounting = Mounting(np.deg2rad([0.2, -0.1, 90.0]), np.array([0.1, 0.0, 0.1]))
    still = true_camera_pose(trajectory, mounting, Shaking.draw(STILL, "nadir", 1, 0), t)
    np.testing.assert_allclose(still.R, (trajectory.pose(t) @ mounting.T_bc).R, atol=1e-14)
    turns = []
    for run in range(10):
        T_wc = true_camera_pose(trajectory, mounting, Shaking.draw(vibration, "nadir", 1, run), t)
        np.testing.assert_allclose(T_wc.t, still.t, atol=1e-9)
        turns.append(log_so3(np.swapaxes(still.R, -1, -2) @ T_wc.R))
    normed = np.concatenate(turns) / vibration.sigma
    # Images 0.2 s apart are independent against a band of 65 Hz: 1000 values an axis.
    low, high = chi2.ppf([0.001, 0.999], len(normed))
    assert np.all((low < np.sum(normed**2, axis=0)) & (np.sum(normed**2, axis=0) < high))
    other = Shaking.draw(vibration, "left", 1, 0).rotation(t)
    assert np.abs(other - Shaking.draw(vibration, "nadir", 1, 0).rotation(t)).max() > vibration.sigma


def test_refusals() -> None:
    with pytest.raises(ValueError, match="no flight line"):
        fly([], 1, 0)
    with pytest.raises(ValueError, match="bank"):
        fly(CROSS, 1, 0, bank=np.deg2rad(80))
    with pytest.raises(ValueError, match="same point"):
        FlightLine((1.0, 1.0), (1.0, 1.0), 500.0, 70.0)
    with pytest.raises(ValueError, match="speed_mps"):
        FlightLine((0.0, 0.0), (1.0, 1.0), 500.0, 0.0)
