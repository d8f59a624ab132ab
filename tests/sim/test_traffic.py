"""Vehicle motions: speed, heading and yaw rate are what the scenario says, and no vehicle slips sideways."""

from __future__ import annotations

import numpy as np
import pytest

from sim import traffic
from sim.pose import heading_of
from sim.scenario import Braking, Crossing, Labels, Spec, StopAndGo, Straight, Turning
from sim.trajectory import Trajectory

Array = np.ndarray

STRAIGHT = Straight(kind="straight", start_m=(-3.5, 80.0), heading_deg=180.0, speed_mps=20.0)
CROSSING = Crossing(kind="crossing", distance_m=20.0, speed_mps=9.0)
LEFT = Turning(kind="turning", start_m=(2.0, 10.0), heading_deg=20.0, speed_mps=8.0, turn_deg=90.0, yaw_rate_dps=30.0)
RIGHT = LEFT.model_copy(update={"turn_deg": -60.0})
BRAKING = Braking(kind="braking", start_m=(0.0, 10.0), heading_deg=10.0, speed_mps=15.0, deceleration_mps2=6.0)
QUEUE = StopAndGo(kind="stop_and_go", start_m=(0.0, 10.0), speed_mps=6.0)
MOTIONS = {"straight": STRAIGHT, "crossing": CROSSING, "left": LEFT, "right": RIGHT, "braking": BRAKING, "queue": QUEUE}
END_S = 5.0
TIMES = np.linspace(0, END_S, 101)

every_motion = pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS.keys())


def speed(trajectory: Trajectory, t: Array) -> Array:
    return np.linalg.norm(trajectory.velocity(t), axis=-1)


def heading_deg(trajectory: Trajectory, t: Array) -> Array:
    return np.rad2deg(np.unwrap(heading_of(trajectory.pose(t).R)))


@every_motion
def test_no_side_slip_and_no_flight(motion: Spec) -> None:
    T = traffic.trajectory(motion, END_S)
    v_b = np.einsum("tba,tb->ta", T.pose(TIMES).R, T.velocity(TIMES))
    # The spline between 200 Hz samples of the tightest clothoid: micrometres a second.
    np.testing.assert_allclose(v_b[:, 1], 0, atol=2e-5)
    np.testing.assert_array_equal(T.pose(TIMES).t[:, 2], 0)
    assert (v_b[:, 0] > -1e-5).all()
    np.testing.assert_allclose(T.pose(TIMES).R[:, 2], [[0, 0, 1]] * len(TIMES), atol=1e-12)


@every_motion
def test_motions_cover_the_frames_and_a_margin(motion: Spec) -> None:
    T = traffic.trajectory(motion, END_S)
    assert T.t_s[0] <= -traffic.MARGIN_S + 1e-9
    assert T.t_s[-1] >= END_S + traffic.MARGIN_S - 1e-9


@every_motion
def test_motions_of_one_frame_exist(motion: Spec) -> None:
    assert np.isfinite(traffic.trajectory(motion, 0.0).velocity(0.0)).all()


def test_straight() -> None:
    T = traffic.trajectory(STRAIGHT, END_S)
    expected = np.stack([np.full(101, -3.5), 80 - 20 * TIMES, np.zeros(101)], axis=-1)
    np.testing.assert_allclose(T.pose(TIMES).t, expected, atol=1e-9)
    np.testing.assert_allclose(T.velocity(TIMES), [[0, -20, 0]] * 101, atol=1e-9)
    np.testing.assert_allclose(T.angular_rate(TIMES), 0, atol=1e-9)


def test_heading_is_clockwise_from_forward() -> None:
    T = traffic.trajectory(STRAIGHT.model_copy(update={"heading_deg": 30.0}), 1.0)
    np.testing.assert_allclose(T.velocity(0.5), [20 * 0.5, 20 * np.sqrt(0.75), 0], atol=1e-9)


@pytest.mark.parametrize(("towards", "sign"), [("right", 1), ("left", -1)])
def test_crossing_passes_in_front_in_the_middle_of_the_sequence(towards: str, sign: int) -> None:
    T = traffic.trajectory(CROSSING.model_copy(update={"towards": towards}), END_S)
    np.testing.assert_allclose(T.pose(END_S / 2).t, [0, 20, 0], atol=1e-9)
    np.testing.assert_allclose(T.velocity(TIMES), [[sign * 9, 0, 0]] * 101, atol=1e-9)


@pytest.mark.parametrize("motion", [LEFT, RIGHT], ids=["left", "right"])
def test_turning_is_a_trapezoid_of_the_yaw_rate(motion: Turning) -> None:
    T = traffic.trajectory(motion, END_S)
    sign, rate = np.sign(motion.turn_deg), motion.yaw_rate_dps
    yaw = np.rad2deg(T.angular_rate(TIMES)[:, 2])
    begin, ramp = motion.straight_s, motion.clothoid_s
    arc = abs(motion.turn_deg) / rate - ramp
    linear = (
        sign * rate * np.interp(TIMES, [begin, begin + ramp, begin + ramp + arc, begin + 2 * ramp + arc], [0, 1, 1, 0])
    )
    corners = np.array([begin, begin + ramp, begin + ramp + arc, begin + 2 * ramp + arc])
    far = np.abs(TIMES[:, None] - corners).min(axis=1) > 0.1 * ramp + 0.02
    # Away from the rounded corners the ramp is linear: a clothoid at constant speed.
    np.testing.assert_allclose(yaw[far], linear[far], atol=2e-3)
    # A corner rounded over +-w differs by w/4 of the slope at most.
    assert np.abs(yaw - linear).max() < 0.1 * rate / 4 + 0.01
    np.testing.assert_allclose(speed(T, TIMES), motion.speed_mps, atol=1e-5)
    turned = heading_deg(T, TIMES)
    assert turned[0] == pytest.approx(20, abs=1e-9)
    # A left turn takes the clockwise heading back.
    assert turned[-1] - turned[0] == pytest.approx(-motion.turn_deg, abs=1e-4)


def test_turning_starts_where_it_is_told() -> None:
    np.testing.assert_allclose(traffic.trajectory(LEFT, END_S).pose(0.0).t, [2, 10, 0], atol=1e-9)


@pytest.mark.parametrize("final", [0.0, 5.0])
def test_braking(final: float) -> None:
    motion = BRAKING.model_copy(update={"final_speed_mps": final})
    t, T = TIMES, traffic.trajectory(motion, END_S)
    v0, a, begin, rise = 15.0, 6.0, 0.5, 0.2
    v = speed(T, t)
    slowing = (v0 - final) / a
    np.testing.assert_allclose(v[t <= begin - 0.1], v0, atol=1e-4)
    np.testing.assert_allclose(v[t >= begin + rise + slowing + 0.1], final, atol=1e-4)
    full = (t > begin + rise + 0.05) & (t < begin + slowing - 0.05)
    # Decelerations up, hold and down are symmetric: v falls as from a step in the middle of the rise.
    np.testing.assert_allclose(v[full], v0 - a * (t[full] - begin - rise / 2), atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(T.acceleration(t[full]), axis=-1), a, atol=0.01)
    # Distance: constant, then the mean speed over the braking time.
    t_end = begin + rise + slowing
    way = v0 * (begin + rise / 2) + (v0 + final) / 2 * slowing + final * (END_S - t_end + rise / 2)
    assert np.linalg.norm(T.pose(END_S).t - T.pose(0.0).t) == pytest.approx(way, abs=1e-3)


def test_who_drives_slower_than_the_final_speed_does_not_brake() -> None:
    motion = BRAKING.model_copy(update={"final_speed_mps": 20.0})
    np.testing.assert_allclose(speed(traffic.trajectory(motion, END_S), TIMES), 15, atol=1e-9)


def test_light_braking_that_never_reaches_the_full_deceleration() -> None:
    motion = BRAKING.model_copy(update={"final_speed_mps": 14.7, "rise_s": 1.0})
    T = traffic.trajectory(motion, END_S)
    assert speed(T, np.array([END_S]))[0] == pytest.approx(14.7, abs=1e-4)
    assert np.linalg.norm(T.acceleration(np.linspace(0, END_S, 2001)), axis=1).max() < 6.05


def test_stop_and_go() -> None:
    T = traffic.trajectory(QUEUE, 10.0)
    drive, stand, change = QUEUE.drive_s, QUEUE.stand_s, QUEUE.change_s
    period = drive + stand + 2 * change
    t = np.linspace(0, 10, 1001)
    v, phase = speed(T, t), np.mod(t, period)
    np.testing.assert_allclose(v[phase < drive - 0.02], 6, atol=1e-4)
    np.testing.assert_allclose(
        v[(phase > drive + change + 0.02) & (phase < drive + change + stand - 0.02)], 0, atol=1e-4
    )
    assert v.min() >= 0
    assert v.max() <= 6 + 1e-4
    # A smooth step loses half of its time: way of a period = speed * (drive + change).
    way = np.linalg.norm(T.pose(period).t - T.pose(0.0).t)
    assert way == pytest.approx(6 * (drive + change), abs=1e-3)


def test_smooth_step_is_a_smooth_step() -> None:
    x = np.linspace(-0.5, 1.5, 20001)
    y = traffic.smooth_step(x)
    assert y[0] == 0
    assert y[-1] == 1
    assert traffic.smooth_step(np.array([0.5]))[0] == pytest.approx(0.5)
    derivative = y
    for _ in range(3):
        derivative = np.gradient(derivative, x)
        # The highest derivative of the four terms jumps at the ends only from the fourth on.
        assert np.abs(np.diff(derivative)).max() < 0.2


def test_a_replay_is_no_motion_over_time_alone() -> None:
    with pytest.raises(TypeError, match="Labels"):
        traffic.trajectory(Labels(kind="labels", labels="x.txt"), 1.0)  # type: ignore[arg-type]  # pydantic makes a Path
