"""Result types of estimators, failure as a value, and the one protocol every estimator follows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from sim import archive
from sim.archive import freeze_fields
from sim.observations import Observations
from sim.pose import Pose

_FILE = "estimate.npz"
_NONE = np.empty(0, int)


@dataclass(frozen=True)
class EstimationFailed:
    """Why an estimation gave nothing, and what may help. A value, never an exception."""

    reason: str
    hints: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class WindowEstimate:
    """One adjustment of an object's motion and shape over a window of frames.

    frames (m,) indices of the window's frames, the last one is the newest; T_co (m,) poses of the object frame o in the
    left camera; track (n,) identifiers; X_o (n, 3) points in the object frame [m]; cov (12, 12) joint covariance of the
    gauge-free functionals at the last frame, in left camera axes:

        0:3   centroid of the n points [m]           3:6   rotation of the point cloud [rad]
        6:9   velocity of the centroid [m/s]          9:12  angular rate [rad/s]

    (velocity and rate by differences of the window's last two frames, Siegemund 2008, 3.8.2, second way);
    sigma_0 estimated standard deviation of unit weight (2.1.22), redundancy, iterations; cost v'Wv.
    ``cov`` is that of the *stated* sigmas (variance factor 1). rejected (q,) tracks taken for outliers and left out;
    second_group (g,) those of them that move together as another rigid body. datum (3,) tracks that define the object
    frame, none for the inner datum. since: first frame whose observations entered a recursive estimate, of others -1.
    """

    frames: Int[np.ndarray, "m"]
    T_co: Pose
    track: Int[np.ndarray, "n"]
    X_o: Float[np.ndarray, "n 3"]
    cov: Float[np.ndarray, "12 12"]
    sigma_0: float
    redundancy: int
    iterations: int
    cost: float
    rejected: Int[np.ndarray, "q"] = field(default_factory=lambda: _NONE)
    second_group: Int[np.ndarray, "g"] = field(default_factory=lambda: _NONE)
    datum: Int[np.ndarray, "d"] = field(default_factory=lambda: _NONE)
    since: int = -1

    def __post_init__(self) -> None:
        freeze_fields(self)

    @property
    def oldest(self) -> int:
        """First frame whose observations entered."""
        return int(self.frames[0]) if self.since < 0 else self.since


@dataclass(frozen=True, eq=False)
class Failure:
    """A window whose estimation failed: its newest frame and why."""

    frame: int
    reason: str
    hints: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class VehicleMotion:
    """Motion of a vehicle at the centroid of its points, one row per window, in axes of the world.

    velocity (k, 3) [m/s] and angular rate omega (k, 3) [rad/s]; heading (k,) driving direction [rad], clockwise from
    +y, NaN where the vehicle is not known to move. Without ego poses the world is that of a level, standing camera, +y
    its forward axis.
    """

    velocity: Float[np.ndarray, "k 3"]
    omega: Float[np.ndarray, "k 3"]
    heading: Float[np.ndarray, "k"]

    def __post_init__(self) -> None:
        freeze_fields(self)

    @property
    def speed(self) -> Float[np.ndarray, "k"]:
        return np.asarray(np.linalg.norm(self.velocity, axis=1))

    @property
    def yaw_rate(self) -> Float[np.ndarray, "k"]:
        """[rad/s], positive to the left seen from above."""
        return self.omega[:, 2]


@dataclass(frozen=True, eq=False)
class Interpretation:
    """What the windows say of the vehicle, one row per window (Siegemund 2008, 3.8).

    frame (k,) the window's newest frame. Motion both ways of 3.8.2: ``within`` by the last two frames of the window,
    with the covariance cov (k, 6, 6) of its velocity and rate from the stated sigmas; ``across`` by the newest frames
    of this window and the one before, NaN where there is none, its covariance not known: the two share observations.
    Orientation of the vehicle frame f (x left, y up, z forward) in the object frame (3.8.2): R_of (k, 3, 3) from the
    first window in which it moves, carried on; R_of_now from this window's own driving direction; NaN where not known.
    ``over_ground`` says whether ego poses entered; else all is relative to the camera.
    """

    frame: Int[np.ndarray, "k"]
    within: VehicleMotion
    across: VehicleMotion
    cov: Float[np.ndarray, "k 6 6"]
    R_of: Float[np.ndarray, "k 3 3"]
    R_of_now: Float[np.ndarray, "k 3 3"]
    over_ground: bool

    def __post_init__(self) -> None:
        freeze_fields(self)

    @staticmethod
    def from_fields(f: dict[str, Any]) -> Interpretation:
        """From the nested fields of an archive."""
        motions = {way: VehicleMotion(**f[way]) for way in ("within", "across")}
        return Interpretation(**(f | motions))


@dataclass(frozen=True, eq=False)
class TrajectoryEstimate:
    """The windows of one object in order of their newest frame, their failures and interpretation.

    T_wc (m,) the ego poses that were used, or None. runtime_s is the wall time of the estimation.
    """

    t_s: Float[np.ndarray, "m"]
    windows: tuple[WindowEstimate, ...]
    failures: tuple[Failure, ...]
    interpretation: Interpretation
    T_wc: Pose | None
    runtime_s: float

    def __post_init__(self) -> None:
        freeze_fields(self)

    def save(self, folder: Path) -> None:
        archive.save(folder / _FILE, self)

    @staticmethod
    def load(folder: Path) -> TrajectoryEstimate:
        f = archive.load(folder / _FILE)
        windows = tuple(WindowEstimate(**(w | {"T_co": Pose(**w["T_co"])})) for w in f["windows"])
        failures = tuple(Failure(x["frame"], x["reason"], tuple(x["hints"])) for x in f["failures"])
        T_wc = None if f["T_wc"] is None else Pose(**f["T_wc"])
        said = Interpretation.from_fields(f["interpretation"])
        return TrajectoryEstimate(f["t_s"], windows, failures, said, T_wc, f["runtime_s"])


Estimator = Callable[[Observations], TrajectoryEstimate | EstimationFailed]
"""Anything callable ``Observations -> Estimate | EstimationFailed``; the built-in ones are frozen dataclasses whose
constructor is their configuration."""


def describe(estimator: Any) -> str:
    """First line of an estimator's docstring."""
    return (estimator.__doc__ or "").strip().splitlines()[0]
