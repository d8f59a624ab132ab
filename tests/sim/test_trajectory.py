"""Trajectories: samples are met, the four functions belong together, and nothing is extrapolated."""

from __future__ import annotations

import numpy as np
import pytest

from sim.pose import Pose, exp_so3, log_so3, rot_z
from sim.trajectory import Trajectory

Array = np.ndarray


@pytest.fixture(scope="module")
def tumbling() -> Trajectory:
    """A smooth motion in all six degrees of freedom, up to 2 rad/s and 10 m/s."""
    t = np.arange(0, 2.001, 0.05)
    r = np.stack([0.3 * np.sin(2 * t), 0.2 * np.cos(3 * t), 1.5 * t], axis=-1)
    p = np.stack([10 * t, 3 * np.sin(t), 0.2 * np.cos(5 * t)], axis=-1)
    return Trajectory(t, Pose(rot_z(r[:, 2]) @ exp_so3(r * [1, 1, 0]), p))


# Not at the knots, where the third derivative of the spline jumps.
TIMES = np.linspace(0.111, 1.888, 23)


def test_samples_are_met(tumbling: Trajectory) -> None:
    at = tumbling.pose(tumbling.t_s)
    np.testing.assert_allclose(at.t, tumbling.T_wb.t, atol=1e-12)
    np.testing.assert_allclose(at.R, tumbling.T_wb.R, atol=1e-12)


@pytest.mark.parametrize("function", ["velocity", "acceleration"])
def test_derivatives_of_position(tumbling: Trajectory, function: str) -> None:
    h = 1e-5
    below = {"velocity": lambda t: tumbling.pose(t).t, "acceleration": tumbling.velocity}[function]
    numeric = (below(TIMES + h) - below(TIMES - h)) / (2 * h)
    # Rounding 1e-15 * 20 m / 1e-5, truncation h^2 * jerk (25 m/s^3).
    np.testing.assert_allclose(getattr(tumbling, function)(TIMES), numeric, atol=1e-8)


def test_angular_rate(tumbling: Trajectory) -> None:
    h = 1e-5
    R0, R1 = tumbling.pose(TIMES - h).R, tumbling.pose(TIMES + h).R
    numeric = log_so3(R1 @ np.swapaxes(R0, 1, 2)) / (2 * h)
    np.testing.assert_allclose(tumbling.angular_rate(TIMES), numeric, atol=1e-8)


def test_angular_acceleration(tumbling: Trajectory) -> None:
    h = 1e-5
    numeric = (tumbling.angular_rate(TIMES + h) - tumbling.angular_rate(TIMES - h)) / (2 * h)
    np.testing.assert_allclose(tumbling.angular_acceleration(TIMES), numeric, atol=1e-7)


def test_velocity_of_a_point_on_the_body(tumbling: Trajectory) -> None:
    p, h = np.array([2.7, -0.8, 1.1]), 1e-5
    numeric = (tumbling.pose(TIMES + h).apply(p) - tumbling.pose(TIMES - h).apply(p)) / (2 * h)
    np.testing.assert_allclose(tumbling.velocity_of(p, TIMES), numeric, atol=1e-8)
    np.testing.assert_array_equal(tumbling.velocity_of(np.zeros(3), TIMES), tumbling.velocity(TIMES))


def test_between_samples_the_spline_is_good(tumbling: Trajectory) -> None:
    """Error of a cubic spline: 5/384 h^4 f'''' = 1e-5 m for the fastest term 0.2 cos 5t; more at the ends."""
    expected = np.stack([10 * TIMES, 3 * np.sin(TIMES), 0.2 * np.cos(5 * TIMES)], axis=-1)
    np.testing.assert_allclose(tumbling.pose(TIMES).t, expected, atol=3e-5)


def test_one_time_and_many(tumbling: Trajectory) -> None:
    assert tumbling.pose(0.3).t.shape == (3,)
    assert tumbling.velocity(0.3).shape == tumbling.angular_rate(0.3).shape == (3,)
    assert tumbling.velocity_of(np.ones(3), 0.3).shape == (3,)
    np.testing.assert_array_equal(tumbling.pose(TIMES).t[4], tumbling.pose(TIMES[4]).t)
    np.testing.assert_array_equal(tumbling.angular_rate(TIMES)[4], tumbling.angular_rate(float(TIMES[4])))


@pytest.mark.parametrize("function", ["pose", "velocity", "acceleration", "angular_rate", "angular_acceleration"])
def test_outside_is_refused(tumbling: Trajectory, function: str) -> None:
    f = getattr(tumbling, function)
    f(np.array([0.0, 2.0 + 1e-10]))  # rounding of the last time is no extrapolation
    for t in (-1e-3, 2.01, np.array([1.0, 3.0])):
        with pytest.raises(ValueError, match="outside"):
            f(t)


def test_not_a_time_is_refused(tumbling: Trajectory) -> None:
    with pytest.raises(ValueError, match="outside"):
        tumbling.pose(float("nan"))


@pytest.mark.parametrize("t_s", [np.array([0.0, 1.0]), np.array([3.0])])
def test_standing(t_s: Array) -> None:
    pose = Pose(exp_so3(np.array([0.1, 0.2, 0.3])), np.array([1.0, 2, 3]))
    standing = Trajectory.standing(pose, t_s)
    for f in (standing.velocity, standing.acceleration, standing.angular_rate, standing.angular_acceleration):
        np.testing.assert_allclose(f(t_s), 0, atol=1e-12)
    np.testing.assert_allclose(standing.pose(t_s).R[-1], pose.R, atol=1e-14)
    np.testing.assert_allclose(standing.pose(t_s).t[-1], pose.t, atol=1e-14)


@pytest.mark.parametrize("t_s", [[0.0], [0.0, 0.0], [1.0, 0.5], [0.0, np.nan], []])
def test_times_must_increase(t_s: list[float]) -> None:
    n = len(t_s)
    with pytest.raises(ValueError, match="strictly increasing"):
        Trajectory(np.array(t_s), Pose.identity((n,)))


def test_as_many_poses_as_times() -> None:
    with pytest.raises(ValueError, match="expected 3 poses"):
        Trajectory(np.arange(3.0), Pose.identity((2,)))
