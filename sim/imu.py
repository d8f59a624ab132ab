"""GNSS/inertial measurement: from a true trajectory to the solution that a system like the POS-AV hands out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

from sim.angles import body_angles, rotation_map_from_navigation
from sim.archive import freeze_fields
from sim.geodesy import Georeference
from sim.navigation import NavigationSolution
from sim.streams import stream
from sim.trajectory import Trajectory

Array = np.ndarray
Triple = tuple[float, float, float]
_ZERO = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class ChannelErrors:
    """Errors of three axes, each the sum of four parts given by their standard deviations.

    white: anew in every record. bias: constant over the flight. drift: first-order Gauss-Markov with the correlation
    time drift_s. walk: random walk from zero at the first record, per √s.
    """

    white: Triple = _ZERO
    bias: Triple = _ZERO
    drift: Triple = _ZERO
    drift_s: float = 100.0
    walk: Triple = _ZERO

    def __post_init__(self) -> None:
        for name in ("white", "bias", "drift", "walk"):
            if not min(getattr(self, name)) >= 0:
                raise ValueError(f"ChannelErrors.{name}: expected standard deviations >= 0, got {getattr(self, name)}")
        if not self.drift_s > 0:
            raise ValueError(f"ChannelErrors.drift_s: expected > 0, got {self.drift_s}")

    def draw(self, channel: str, count: int, step_s: float, seed: int, run: int) -> Float[Array, "n 3"]:
        """Errors of count records at a fixed step; every axis and part has a random stream of its own."""
        out = np.empty((count, 3))
        for axis in range(3):

            def normal(part: str, size: int, axis: int = axis) -> Array:
                return stream(seed, run, f"imu/{channel}/{axis}/{part}").standard_normal(size)

            step = self.walk[axis] * np.sqrt(step_s) * normal("walk", count)
            step[0] = 0.0
            out[:, axis] = (
                self.white[axis] * normal("white", count)
                + self.bias[axis] * normal("bias", 1)
                + self.drift[axis] * gauss_markov(normal("drift", count), step_s / self.drift_s)
                + np.cumsum(step)
            )
        return out


def gauss_markov(normal: Float[Array, "n"], step: float) -> Float[Array, "n"]:
    """First-order Gauss-Markov sequence of unit variance, stationary from the first value on.

    ``x_k = a x_(k-1) + sqrt(1 - a²) n_k``, a = exp(-step), step in correlation times; n_k standard normal.
    """
    a = np.exp(-step)
    innovation = np.sqrt(-np.expm1(-2 * step)) * normal
    innovation[0] = normal[0]
    return np.asarray(lfilter([1.0], [1.0, -a], innovation))


@dataclass(frozen=True)
class NavigationErrors:
    """All that is wrong with a navigation solution and its synchronisation, and what is stated about it.

    attitude (roll, pitch, heading) [rad]; position (east, north, up) [m]; velocity (north, east, down), white [m/s].
    time_offset_s: an exposure at t is stamped t + time_offset_s, plus jitter_s (1 sigma) of its own.
    antenna_lever_b: error of the lever arm to the antenna that the system compensates, in body axes [m].
    The stated sigmas are what estimators are told.
    """

    attitude: ChannelErrors = ChannelErrors()
    position: ChannelErrors = ChannelErrors()
    velocity: Triple = _ZERO
    time_offset_s: float = 0.0
    jitter_s: float = 0.0
    antenna_lever_b: Triple = _ZERO
    stated_attitude: Triple = (0.00014, 0.00014, 0.00026)
    stated_position: Triple = (0.1, 0.1, 0.1)
    stated_velocity: Triple = (0.005, 0.005, 0.005)


def pos_av_410(position_m: float = 0.1) -> NavigationErrors:
    """Applanix POS-AV 410, post-processed (Table 3.1): RMS 0.008, 0.008, 0.015 degrees, 0.05-0.30 m, 0.005 m/s.

    The table gives sums. The share of each part is ours: post-processing leaves mostly what is constant or slow;
    together the variances make the table's over the first two minutes.
    """
    attitude = np.deg2rad([0.008, 0.008, 0.015])
    position = np.full(3, position_m)

    def parts(rms: Array, white: float) -> ChannelErrors:
        slow = np.sqrt((1 - white**2 - 0.02) / 2)
        shares = {"white": white, "bias": slow, "drift": slow, "walk": np.sqrt(0.02 / 60)}
        return ChannelErrors(**{name: tuple((share * rms).tolist()) for name, share in shares.items()}, drift_s=60.0)

    return NavigationErrors(
        attitude=parts(attitude, 0.3),
        position=parts(position, 0.1),
        velocity=(0.005, 0.005, 0.005),
        stated_attitude=tuple(attitude.tolist()),
        stated_position=tuple(position.tolist()),
    )


@dataclass(frozen=True, eq=False)
class NavigationTruth:
    """The errors of each record: attitude (n, 3) [rad], position (n, 3) [m], as `NavigationErrors` orders them."""

    t_s: Float[Array, "n"]
    attitude: Float[Array, "n 3"]
    position: Float[Array, "n 3"]

    def __post_init__(self) -> None:
        freeze_fields(self)


def navigation_solution(
    trajectory: Trajectory,
    reference: Georeference,
    errors: NavigationErrors,
    seed: int,
    run: int,
    *,
    rate_hz: float = 200.0,
    within_s: Float[Array, "k 2"] | None = None,
) -> tuple[NavigationSolution, NavigationTruth]:
    """The solution of a flight at a fixed rate, and its errors.

    ``within_s`` keeps the records from a second before each begin to a second behind each end, as for flight lines;
    their errors are those of the whole flight.
    """
    t = trajectory.t_s[0] + np.arange(int((trajectory.t_s[-1] - trajectory.t_s[0]) * rate_hz + 1e-6) + 1) / rate_hz
    attitude = errors.attitude.draw("attitude", len(t), 1 / rate_hz, seed, run)
    position = errors.position.draw("position", len(t), 1 / rate_hz, seed, run)
    noise = stream(seed, run, "imu/velocity/white").standard_normal((len(t), 3))
    if within_s is not None:
        kept = np.any([(t >= begin - 1) & (t <= end + 1) for begin, end in within_s], axis=0)
        t, attitude, position, noise = t[kept], attitude[kept], position[kept], noise[kept]
    T_wb = trajectory.pose(t)
    position = position + T_wb.R @ np.array(errors.antenna_lever_b)
    convergence = reference.convergence(T_wb.t)
    R_nw = np.swapaxes(rotation_map_from_navigation(convergence), -1, -2)
    velocity = (R_nw @ trajectory.velocity(t)[..., None])[..., 0]
    solution = NavigationSolution(
        t,
        reference.to_crs(T_wb.t + position),
        body_angles(T_wb.R, convergence) + attitude,
        velocity + noise * errors.velocity,
        np.array(errors.stated_position),
        np.array(errors.stated_attitude),
        np.array(errors.stated_velocity),
    )
    return solution, NavigationTruth(t, attitude, position)


def stamps(t_s: Float[Array, "n"], errors: NavigationErrors, camera: str, seed: int, run: int) -> Float[Array, "n"]:
    """What the navigation system's clock records for exposures at t_s: ``t + time_offset_s + jitter``."""
    jitter = stream(seed, run, f"{camera}/trigger/jitter").standard_normal(len(t_s))
    return np.asarray(t_s + errors.time_offset_s + errors.jitter_s * jitter)
