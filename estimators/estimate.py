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
    second_group (g,) those of them that move together as another rigid body.
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

    def __post_init__(self) -> None:
        freeze_fields(self)


@dataclass(frozen=True, eq=False)
class Failure:
    """A window whose estimation failed: its newest frame and why."""

    frame: int
    reason: str
    hints: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Interpretation:
    """What the windows say of the vehicle, one row per window, at the centroid of its points (Siegemund 2008, 3.8).

    frame (k,) the window's newest frame; heading (k,) driving direction [rad], clockwise from the camera's forward
    axis or, where ego poses are observed, from world +y; speed (k,) [m/s]; yaw_rate (k,) [rad/s], positive to the left
    seen from above. ``over_ground`` says whether ego poses entered; else all is relative to the camera.
    """

    frame: Int[np.ndarray, "k"]
    heading: Float[np.ndarray, "k"]
    speed: Float[np.ndarray, "k"]
    yaw_rate: Float[np.ndarray, "k"]
    over_ground: bool

    def __post_init__(self) -> None:
        freeze_fields(self)


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
        return TrajectoryEstimate(
            f["t_s"], windows, failures, Interpretation(**f["interpretation"]), T_wc, f["runtime_s"]
        )


Estimator = Callable[[Observations], TrajectoryEstimate | EstimationFailed]
"""Anything callable ``Observations -> Estimate | EstimationFailed``; the built-in ones are frozen dataclasses whose
constructor is their configuration."""


def describe(estimator: Any) -> str:
    """First line of an estimator's docstring."""
    return (estimator.__doc__ or "").strip().splitlines()[0]
