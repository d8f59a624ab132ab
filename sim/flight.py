"""How an aircraft moves: flight lines, banked turns between them, gusts; and how a camera vibrates in it.

The trajectory is that of the body b (forward, right, down, `sim.angles`) in the world frame w. Vibration turns a camera
against the body, so the IMU does not see it: the "unzureichende Dämpfung" of Kozempel 2012, 3.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from sim.angles import Mounting, body_rotation
from sim.archive import freeze_fields
from sim.flight_path import GRAVITY, FlightLine, along, joining
from sim.pose import Pose, exp_so3
from sim.random_waves import RandomWaves
from sim.streams import stream
from sim.trajectory import Trajectory

Array = np.ndarray
# Enough for gusts of 1 Hz and for a roll's 4 s; between the samples the spline is the truth.
SAMPLE_HZ = 20.0
# An aircraft needs this long to roll into a turn or to begin a climb.
_ROLL_TIME_S = 4.0
# Recording goes on so long before the first and behind the last line.
_MARGIN_S = 2.0
_STEEPEST_CLIMB = np.tan(np.deg2rad(6.0))
_AXES = ("roll", "pitch", "heading")


@dataclass(frozen=True)
class Gusts:
    """Coloured roll, pitch and heading: sigmas [rad], and Dryden's correlation time L / V [s] and a cutoff [Hz]."""

    sigma: tuple[float, float, float] = (0.017, 0.009, 0.009)
    correlation_s: float = 2.5
    cutoff_hz: float = 1.0


@dataclass(frozen=True)
class Vibration:
    """A camera's turning against the body about each of its axes [rad], white between two frequencies."""

    sigma: float = 0.0014
    low_hz: float = 15.0
    high_hz: float = 80.0


CALM = Gusts((0.0, 0.0, 0.0))
STILL = Vibration(0.0)


@dataclass(frozen=True, eq=False)
class Flight:
    """The body's trajectory, and when each flight line (n,) begins and ends: line_s (n, 2)."""

    trajectory: Trajectory
    line_s: Float[Array, "n 2"]

    def __post_init__(self) -> None:
        freeze_fields(self)


def fly(
    lines: Sequence[FlightLine],
    seed: int,
    run: int,
    *,
    bank: float = np.deg2rad(20.0),
    gusts: Gusts = CALM,
    wind_mps: tuple[float, float] = (0.0, 0.0),
) -> Flight:
    """All lines in their order, each exactly from end to end, joined by the shortest turns of the bank angle [rad].

    Turns are coordinated: the roll angle balances the acceleration. Speed and height change between the lines; where
    the way is too short for a climb of 6 degrees, full circles are flown first. In wind (east, north) the nose points
    off the course. Time 0 is the begin of the first line.

    Raises
        ValueError: no line, a bank angle outside (0°, 60°].
    """
    if not lines:
        raise ValueError("fly: no flight line")
    if not 0 < bank <= np.deg2rad(60) + 1e-9:
        raise ValueError(f"bank: expected above 0 and at most 60 degrees, got {np.rad2deg(bank):g}")
    t_s, position, line_s = _positions(lines, bank)
    spline = CubicSpline(t_s, position)
    rph = _coordinated(spline(t_s, 1), spline(t_s, 2), np.array(wind_mps))
    for axis, sigma in enumerate(gusts.sigma):
        rng = stream(seed, run, f"flight/gusts/{_AXES[axis]}")
        rph[:, axis] += RandomWaves.dryden(rng, sigma, gusts.correlation_s, gusts.cutoff_hz)(t_s)
    # The angle here is that against the grid, so no convergence: `sim.imu` adds it for a true heading.
    return Flight(Trajectory(t_s, Pose(body_rotation(rph, 0.0), position)), line_s)


def _positions(lines: Sequence[FlightLine], bank: float) -> tuple[Array, Array, Array]:
    """Times (n,) and positions (n, 3) of the whole flight, and the lines' begin and end (k, 2).

    The ideal way has jumps of curvature. Averaged over the time a roll takes it has none, and remains what it was along
    the lines, whose run-in and run-out are as long as half the average and a little for the spline.
    """
    box = round(_ROLL_TIME_S * SAMPLE_HZ / 3) | 1
    kernel = np.convolve(np.convolve(np.ones(box), np.ones(box)), np.ones(box)) / box**3
    reach = len(kernel) // 2
    lead = reach / SAMPLE_HZ + 0.5
    first, last = 2 * lead + _MARGIN_S, len(lines) - 1
    flown = [along(l, lead if i else first, lead if i < last else first) for i, l in enumerate(lines)]
    pieces = [flown[0]]
    for one, other in pairwise(flown):
        pieces += [joining(one, other, bank, _STEEPEST_CLIMB), other]
    begins = np.cumsum([-first] + [piece.duration_s for piece in pieces])
    line_s = np.array([[t + (lead if i else first), 0.0] for i, t in enumerate(begins[:-1:2])])
    line_s[:, 1] = line_s[:, 0] + [line.length_m / line.speed_mps for line in lines]
    t = np.arange(begins[0], begins[-1], 1 / SAMPLE_HZ)
    owner = np.clip(np.searchsorted(begins, t, side="right") - 1, 0, len(pieces) - 1)
    ideal = np.concatenate([piece.at(t[owner == k] - begins[k]) for k, piece in enumerate(pieces)])
    smooth = np.stack([np.convolve(column, kernel, "valid") for column in ideal.T], axis=-1)
    return t[reach:-reach], smooth, line_s


def _coordinated(velocity: Array, acceleration: Array, wind: Array) -> Array:
    """Roll, pitch and heading against the grid (n, 3) of an aircraft that flies along its nose through moving air."""
    air = velocity[:, :2] - wind
    speed = np.hypot(*air.T)
    right = np.stack([air[:, 1], -air[:, 0]], axis=-1) / speed[:, None]
    roll = np.arctan2(np.sum(acceleration[:, :2] * right, axis=-1), GRAVITY)
    return np.stack([roll, np.arctan2(velocity[:, 2], speed), np.arctan2(air[:, 0], air[:, 1])], axis=-1)


@dataclass(frozen=True, eq=False)
class Shaking:
    """A drawn vibration: rotation of the camera against its mounting at any time."""

    waves: tuple[RandomWaves, RandomWaves, RandomWaves]

    @staticmethod
    def draw(vibration: Vibration, camera: str, seed: int, run: int) -> Shaking:
        """Every camera and axis has a stream of its own."""
        x, y, z = (
            RandomWaves.band(
                stream(seed, run, f"{camera}/vibration/{axis}"), vibration.sigma, vibration.low_hz, vibration.high_hz
            )
            for axis in "xyz"
        )
        return Shaking((x, y, z))

    def rotation(self, t_s: ArrayLike) -> Float[Array, "*b 3 3"]:
        """R of the shaken camera's axes in the resting one's."""
        return exp_so3(np.stack([wave(t_s) for wave in self.waves], axis=-1))


def true_camera_pose(trajectory: Trajectory, mounting: Mounting, shaking: Shaking, t_s: ArrayLike) -> Pose:
    """T_wc at any time: ``T_wb(t) T_bc R_vibration(t)``."""
    T_wc = trajectory.pose(t_s) @ mounting.T_bc
    return Pose(T_wc.R @ shaking.rotation(t_s), T_wc.t)
