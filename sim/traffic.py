"""Vehicle motions: specs of `sim.scenario` to trajectories of the vehicle frame v (rear axle on the ground)."""

from __future__ import annotations

from collections.abc import Callable
from functools import singledispatch

import numpy as np
from jaxtyping import Float
from scipy.integrate import cumulative_simpson

from sim.pose import Pose, vehicle_rotation
from sim.scenario import Braking, Crossing, Spec, StopAndGo, Straight, Turning
from sim.trajectory import Trajectory

Array = np.ndarray

# Motions are sampled so finely that the spline between samples is exact to well below a micrometre.
SAMPLE_HZ = 200.0
# Beyond the frames on both sides, so that derivatives at the ends are as good as inside.
MARGIN_S = 0.1


def smooth_step(x: Float[Array, "n"]) -> Float[Array, "n"]:
    """0 to 1 with three continuous derivatives: 35 x⁴ - 84 x⁵ + 70 x⁶ - 20 x⁷."""
    x = np.clip(x, 0, 1)
    return np.asarray(x**4 * (35 + x * (-84 + x * (70 - 20 * x))))


def planar(
    start: tuple[float, float],
    heading: float,
    speed: Callable[[Array], Array],
    yaw_rate: Callable[[Array], Array],
    end_s: float,
) -> Trajectory:
    """Motion of the rear axle without side slip from speed [m/s] and yaw rate [rad/s] (positive left) over time.

    ``start`` (x, y) [m] and ``heading`` [rad] hold at t = 0; the trajectory covers [-MARGIN_S, end_s + MARGIN_S].
    """
    h = 1 / SAMPLE_HZ
    t = np.arange(-round(MARGIN_S / h), round((end_s + MARGIN_S) / h) + 2) * h
    fine = np.linspace(t[0], t[-1], 2 * len(t) - 1)
    turned = cumulative_simpson(yaw_rate(fine), x=fine, initial=0.0)
    psi = heading - (turned - np.interp(0.0, fine, turned))
    v = speed(fine)
    xy = cumulative_simpson(np.stack([v * np.sin(psi), v * np.cos(psi)]), x=fine, initial=0.0)
    zero = int(np.argmin(np.abs(fine)))
    p = np.zeros((len(t), 3))
    p[:, :2] = (xy - xy[:, [zero]]).T[::2] + start
    return Trajectory(t, Pose(vehicle_rotation(psi[::2]), p))


def _constant(value: float) -> Callable[[Array], Array]:
    return lambda t: np.full_like(t, value)


@singledispatch
def trajectory(motion: Spec, end_s: float) -> Trajectory:
    """Trajectory of a motion spec over [0, end_s].

    Raises
        TypeError: the motion needs more than time (a replay, see `sim.replay`).
    """
    raise TypeError(f"{type(motion).__name__} up to {end_s} s is not a motion over time alone")


@trajectory.register
def _(motion: Straight, end_s: float) -> Trajectory:
    heading = np.deg2rad(motion.heading_deg)
    return planar(motion.start_m, heading, _constant(motion.speed_mps), _constant(0.0), end_s)


@trajectory.register
def _(motion: Crossing, end_s: float) -> Trajectory:
    sign = 1.0 if motion.towards == "right" else -1.0
    start = (-sign * motion.speed_mps * end_s / 2, motion.distance_m)
    return planar(start, sign * np.pi / 2, _constant(motion.speed_mps), _constant(0.0), end_s)


@trajectory.register
def _(motion: Turning, end_s: float) -> Trajectory:
    rate = np.deg2rad(motion.yaw_rate_dps) * np.sign(motion.turn_deg)
    arc_s = abs(motion.turn_deg) / motion.yaw_rate_dps - motion.clothoid_s
    begin, out = motion.straight_s, motion.straight_s + motion.clothoid_s + arc_s

    def yaw_rate(t: Array) -> Array:
        # The linear ramp is the clothoid; its corners are rounded within a tenth of it for a continuous spline.
        return np.asarray(rate * (_ramp(t, begin, motion.clothoid_s) - _ramp(t, out, motion.clothoid_s)))

    return planar(motion.start_m, np.deg2rad(motion.heading_deg), _constant(motion.speed_mps), yaw_rate, end_s)


def _ramp(t: Array, begin: float, duration: float) -> Array:
    """0 to 1, linear but for rounded corners of a tenth of the duration."""
    w = 0.1 * duration
    x = t - begin

    def rounded(s: Array) -> Array:
        return np.where(s < -w, 0.0, np.where(s > w, s, (s + w) ** 2 / (4 * w)))

    return np.asarray((rounded(x) - rounded(x - duration)) / duration)


@trajectory.register
def _(motion: Braking, end_s: float) -> Trajectory:
    v0, v1, a = motion.speed_mps, min(motion.final_speed_mps, motion.speed_mps), motion.deceleration_mps2
    # A trapezoid of deceleration: rise, hold, fall; the area is v0 - v1.
    rise = min(motion.rise_s, (v0 - v1) / a) if v0 > v1 else motion.rise_s
    hold = max((v0 - v1) / a - rise, 0.0)
    fine = np.arange(-1.0, end_s + 1.0, 1e-3)
    share = _ramp(fine, motion.brake_s, rise) - _ramp(fine, motion.brake_s + rise + hold, rise)
    v = v0 - cumulative_simpson(a * share, x=fine, initial=0.0) if v0 > v1 else np.full_like(fine, v0)

    def speed(t: Array) -> Array:
        return np.asarray(np.interp(t, fine, v))

    return planar(motion.start_m, np.deg2rad(motion.heading_deg), speed, _constant(0.0), end_s)


@trajectory.register
def _(motion: StopAndGo, end_s: float) -> Trajectory:
    period = motion.drive_s + motion.stand_s + 2 * motion.change_s

    def speed(t: Array) -> Array:
        phase = np.mod(t, period)
        stop = smooth_step((phase - motion.drive_s) / motion.change_s)
        go = smooth_step((phase - motion.drive_s - motion.change_s - motion.stand_s) / motion.change_s)
        return np.asarray(motion.speed_mps * (1 - stop + go))

    return planar(motion.start_m, np.deg2rad(motion.heading_deg), speed, _constant(0.0), end_s)
