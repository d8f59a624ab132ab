"""Every choice the sliding-window adjustment leaves open, in one flat list: the keys of a scenario file."""

from __future__ import annotations

import operator
from dataclasses import dataclass, field
from typing import Literal

from estimators.stereo.conditions import RotationAxis, Smoothing
from estimators.stereo.depth_bias import Weights
from estimators.stereo.initial_values import Axes
from estimators.stereo.object_motion import Stop
from estimators.stereo.triangulation import Propagation

Selection = Literal["sliding", "thinned", "growing", "whole"]
Solver = Literal["newton", "gauss_newton", "line_search", "levenberg_marquardt"]
Outliers = Literal["none", "ransac", "points", "points_source", "tracks", "tracks_source", "robust"]

_BATCHED = ("points", "points_source", "tracks", "tracks_source")
_WHY = {
    "propagation": "says nothing where weights are estimated; expected linear",
    "batches": f"expected 1 or more, with outliers one of {', '.join(_BATCHED)}",
}


@dataclass(frozen=True)
class Configuration:
    """What `SlidingWindowAdjustment` is built of; every part goes with every other.

    Frames and tracks (3.2, 3.3)
        window: number of frames m; start_window: m0, the first adjustment waits for so many; selection: "sliding" the
        last m frames, "thinned" older ones ever farther apart, "growing" all up to the newest, "whole" one adjustment
        of the whole sequence; skipped: frames left out; min_overlap: frames a track shares with the window at least.
    Weights (3.1.5, 4.1.2-4.1.3)
        propagation of the image covariance to the points, "linear" or "unscented"; weights "observed" from it,
        "averaged", or "estimated" at the adjusted points (linear); second_order correction of the triangulated points;
        space: "object" adjusts these points, "image" goes on to the least reprojection error, as a yardstick.
    Solver (2.1, 2.2, 3.5)
        "newton" ours, points solved anew for the poses of every iteration; the source's "gauss_newton", "line_search",
        "levenberg_marquardt" by bordered normal equations; stop, tolerance, max_iterations (2.1.5).
    Outliers (3.4)
        detector among the tracks of a window, see `estimators.stereo.outliers`; batches: of tracks that a statistical
        one may drop at most, None what it does by itself; extent_m: largest extent of the object
        where it is known, 0 where not: tracks farther out go first (3.4.2.1), and start values come from the cloud
        again when the object frame has drifted off by so much (3.7.1.3).
    Start values and datum (3.7, 3.1.7)
        initial: axes of the start values, "best" tries several and keeps that of the least misfit; points: "mean",
        "median" over the frames, or "propagated" from the last window and else the median; propagate: poses from the
        last window, which also keeps the object frame; datum: "inner" constraints, or "three_points" of the cloud.
    What is known of the motion
        smoothing (4.2.3) and rotation_axis (3.6), see `conditions`; outliers are sought without it.
    """

    window: int = 10
    start_window: int = 3
    selection: Selection = "sliding"
    skipped: tuple[int, ...] = ()
    min_overlap: int = 2
    propagation: Propagation = "linear"
    weights: Weights = "estimated"
    second_order: bool = True
    space: Literal["object", "image"] = "object"
    solver: Solver = "newton"
    stop: Stop = "decrement"
    tolerance: float = 1e-6
    max_iterations: int = 50
    outliers: Outliers = "none"
    batches: int | None = None
    extent_m: float = 0.0
    initial: Axes | Literal["best", "shared_tracks"] = "best"
    points: Literal["mean", "median", "propagated"] = "mean"
    propagate: bool = True
    datum: Literal["inner", "three_points"] = "inner"
    smoothing: Smoothing = field(default_factory=Smoothing)
    rotation_axis: RotationAxis = field(default_factory=RotationAxis)

    def __post_init__(self) -> None:
        allowed = {
            "window": self.window >= 2,
            "start_window": 2 <= self.start_window <= self.window,
            "skipped": all(frame >= 0 for frame in self.skipped),
            "min_overlap": 2 <= self.min_overlap <= self.window,
            "propagation": self.propagation == "linear" or self.weights != "estimated",
            "tolerance": self.tolerance > 0,
            "max_iterations": self.max_iterations >= 1,
            "batches": self.batches is None or (self.batches >= 1 and self.outliers in _BATCHED),
            "extent_m": 0 <= self.extent_m < float("inf"),
            "smoothing.tied": self.smoothing.tied < self.window,
        }
        for name, good in allowed.items():
            if not good:
                found = operator.attrgetter(name)(self)
                raise ValueError(f"SlidingWindowAdjustment.{name}: {found} {_WHY.get(name, 'is out of range')}")
