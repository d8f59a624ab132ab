"""The sliding-window adjustment: the estimator of Siegemund 2008 as one configurable callable."""

from __future__ import annotations

import functools
import operator
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from estimators.estimate import EstimationFailed, Failure, TrajectoryEstimate, WindowEstimate
from estimators.gauss_markov import SingularSystem
from estimators.stereo import initial_values, windows
from estimators.stereo.conditions import Conditions, RotationAxis, Smoothing, of_window
from estimators.stereo.depth_bias import Weights, observation_model
from estimators.stereo.image_space import ImageProblem, adjust_images
from estimators.stereo.initial_values import Axes
from estimators.stereo.object_motion import (
    Problem,
    Solution,
    Stop,
    adjust,
    align,
    motion_covariance,
    points_by_mean,
    redundancy,
)
from estimators.stereo.outliers import DETECTORS, select_points
from estimators.stereo.triangulation import triangulate, undistorted
from estimators.stereo.vehicle import interpret
from sim.camera import StereoRig
from sim.observations import Observations
from sim.pose import Pose

Array = np.ndarray
Poses = tuple[Array, Array]
Known = Callable[..., tuple[Poses, Conditions | None]]
# A well-determined window started from its predecessor takes no more iterations; standard deviations a cost may exceed
# its expectation by before other starts are tried.
_EASY, _SURPRISE = 6, 1.5


@dataclass(frozen=True, eq=False)
class _Points:
    """Triangulated observations of the whole sequence, flat, in front of the cameras of an undistorted rig."""

    rig: StereoRig
    frame: Int[Array, "k"]
    track: Int[Array, "k"]
    l: Float[Array, "k 3"]
    C: Float[Array, "k 3 3"]
    uv: Float[Array, "k 4"]
    W_uv: Float[Array, "k 4 4"]


@dataclass(frozen=True, eq=False)
class _Fit:
    """A solution with the start it was reached from and the conditions it was found under."""

    start: Poses
    conditions: Conditions | None
    solution: Solution
    images: ImageProblem | None = None

    def redundancy(self, problem: Problem) -> int:
        poses = (self.solution.R, self.solution.T)
        coordinates = 3 if self.images is None else 4
        return redundancy(problem, self.conditions, poses) + (coordinates - 3) * len(problem.frame)

    @property
    def tied(self) -> bool:
        return self.conditions is not None and self.conditions.tied


@dataclass(frozen=True)
class SlidingWindowAdjustment:
    """Motion and shape of a rigid object by least-squares adjustment over a sliding window (Siegemund 2008, ch. 3-4).

    window: number of frames m; start_window: m0, the first adjustment waits for so many; min_overlap: frames a track
    shares with the window at least (3.3); weights "observed", "averaged" or "estimated" with second_order correction
    (4.1.2-4.1.3); space: "object" adjusts triangulated points, "image" goes on from there to the least reprojection
    error, as a yardstick; outliers: detector among the tracks of a window (3.4), see `estimators.stereo.outliers`;
    initial: axes of the start values (3.7.1.1), "best" tries three and keeps the lower cost;
    propagate: start from the last window where there is one (3.7.1.2), which also keeps the object frame; smoothing
    (4.2.3) and rotation_axis (3.6) what is known of the motion, see `conditions`; outliers are sought without it; stop,
    tolerance, max_iterations (2.1.5).
    """

    window: int = 10
    start_window: int = 3
    min_overlap: int = 2
    weights: Weights = "estimated"
    second_order: bool = True
    space: Literal["object", "image"] = "object"
    outliers: Literal["none", "ransac", "points", "points_source", "tracks", "tracks_source", "robust"] = "none"
    initial: Axes | Literal["best"] = "best"
    propagate: bool = True
    smoothing: Smoothing = field(default_factory=Smoothing)
    rotation_axis: RotationAxis = field(default_factory=RotationAxis)
    stop: Stop = "decrement"
    tolerance: float = 1e-6
    max_iterations: int = 50

    def __post_init__(self) -> None:
        allowed = {
            "window": self.window >= 2,
            "start_window": 2 <= self.start_window <= self.window,
            "min_overlap": 2 <= self.min_overlap <= self.window,
            "smoothing.tied": self.smoothing.tied < self.window,
            "tolerance": self.tolerance > 0,
            "max_iterations": self.max_iterations >= 1,
        }
        for name, good in allowed.items():
            if not good:
                found = operator.attrgetter(name)(self)
                raise ValueError(f"SlidingWindowAdjustment.{name}: {found} is out of range")

    def __call__(self, observations: Observations) -> TrajectoryEstimate | EstimationFailed:
        started = time.perf_counter()
        points = _triangulated(observations)
        observed_frames = np.unique(points.frame)
        results: list[WindowEstimate] = []
        failures: list[Failure] = []
        for newest in range(len(observations.t_s)):
            window = windows.sliding(observed_frames, newest, self.window)
            if len(window) < self.start_window:
                continue
            previous = results[-1] if results and self.propagate else None
            result = self._adjust_window(observations, points, newest, window, previous)
            if isinstance(result, WindowEstimate):
                results.append(result)
            else:
                failures.append(Failure(newest, result.reason, result.hints))
        if not results:
            reason = failures[0].reason if failures else "no window has enough frames with three tracks or more"
            return EstimationFailed(reason, (f"{len(failures)} windows failed", "lower start_window or window"))
        return TrajectoryEstimate(
            t_s=observations.t_s,
            windows=tuple(results),
            failures=tuple(failures),
            interpretation=interpret(results, observations.t_s, observations.T_wc),
            T_wc=observations.T_wc,
            runtime_s=time.perf_counter() - started,
        )

    def _adjust_window(
        self,
        observations: Observations,
        points: _Points,
        newest: int,
        window: Int[Array, "m"],
        previous: WindowEstimate | None,
    ) -> WindowEstimate | EstimationFailed:
        if window[-1] != newest:
            return EstimationFailed("the newest frame has no observation")
        rows, frames = windows.select(points.frame, points.track, window, self.min_overlap)
        if len(frames) < 2 or frames[-1] != newest:
            return EstimationFailed(
                "the newest frame shares fewer than three tracks with the window", ("the tracks are too short",)
            )
        problem, tracks = _problem(points, rows, frames, self)
        T_wc = None if observations.T_wc is None else observations.T_wc[frames]
        known = functools.partial(of_window, self.smoothing, self.rotation_axis, observations.t_s[frames], T_wc)
        try:
            fit = self._best(problem, known, _propagated(observations.t_s, frames, previous))
            inlier, second = np.ones(problem.n, bool), np.zeros(problem.n, bool)
            if self.outliers != "none":
                verdict = DETECTORS[self.outliers](problem, fit.start, self._adjust)
                inlier, solution = verdict.inlier, verdict.solution
                second = second if verdict.second_group is None else verdict.second_group
                problem = select_points(problem, inlier)
                if fit.conditions is not None:
                    solution = self._adjust(problem, fit.start, fit.conditions)
                fit = replace(fit, solution=solution)
            if self.space == "image":
                good = np.flatnonzero(rows)[np.isin(points.track[rows], tracks[inlier])]
                images = ImageProblem(
                    points.rig, problem.frame, problem.point, points.uv[good], points.W_uv[good], problem.m, problem.n
                )
                arguments = (self.stop, self.tolerance, self.max_iterations, fit.conditions)
                fit = replace(fit, solution=adjust_images(images, fit.solution, *arguments), images=images)
            result = _finished(problem, fit, frames, tracks[inlier], observations.t_s, previous)
            return replace(result, rejected=tracks[~inlier], second_group=tracks[second])
        except SingularSystem as error:
            return EstimationFailed(str(error), ("too few or collinear tracks", "outliers among the tracks"))

    def _best(self, problem: Problem, known: Known, propagated: Poses | None) -> _Fit:
        """Fit from the last window; where that fails or is doubtful, the cheapest of it and the cloud's."""
        found: list[_Fit] = []
        error = SingularSystem("no start value")
        if propagated is not None:
            try:
                found.append(self._fit(problem, *known(propagated, self.smoothing.tied)))
                if _is_trusted(problem, found[0]):
                    return found[0]
            except SingularSystem as e:
                error = e
        for start in self._cloud_starts(problem):
            try:
                found.append(self._fit(problem, *known(start)))
            except SingularSystem as e:
                error = e
        if not found:
            raise error
        return min(found, key=lambda fit: fit.solution.cost)

    def _fit(self, problem: Problem, start: Poses, conditions: Conditions | None) -> _Fit:
        return _Fit(start, conditions, self._adjust(problem, start, conditions))

    def _cloud_starts(self, problem: Problem) -> Iterator[Poses]:
        for axes in ("unrotated", "principal_axes_xz") if self.initial == "best" else (self.initial,):
            yield initial_values.from_cloud(problem.frame, problem.l, problem.m, axes)
        if self.initial == "best":
            yield initial_values.from_alignment(problem.frame, problem.point, problem.l, problem.m)

    def _adjust(self, problem: Problem, start: Poses, conditions: Conditions | None = None) -> Solution:
        return adjust(problem, *start, self.stop, self.tolerance, self.max_iterations, conditions)


def _is_trusted(problem: Problem, fit: _Fit) -> bool:
    """Whether a propagated solution is no local minimum, of which far objects have many: quickly found, or cheap."""
    r = max(fit.redundancy(problem), 1)
    return bool(fit.solution.iterations <= _EASY or fit.solution.cost <= r + _SURPRISE * np.sqrt(2 * r))


def _finished(
    problem: Problem,
    fit: _Fit,
    frames: Int[Array, "m"],
    tracks: Int[Array, "n"],
    t_s: Float[Array, "f"],
    previous: WindowEstimate | None,
) -> WindowEstimate:
    """The solution with its covariance, in the datum of the points known from the last window, else of its start
    values; tied frames hold it themselves.
    """
    s, r = fit.solution, fit.redundancy(problem)
    Q, shift = align(s.X, points_by_mean(problem, *fit.start))
    if fit.tied:
        Q, shift = np.eye(3), np.zeros(3)
    elif previous is not None:
        _, old, new = np.intersect1d(previous.track, tracks, return_indices=True)
        if len(new) >= windows.MIN_POINTS:
            Q, shift = align(s.X[new], previous.X_o[old])
    R, dt_s = s.R @ Q.T, t_s[frames[-1]] - t_s[frames[-2]]
    return WindowEstimate(
        frames=frames,
        T_co=Pose(R, s.T - (R @ shift[:, None])[:, :, 0]),
        track=tracks,
        X_o=s.X @ Q.T + shift,
        cov=motion_covariance(problem.frame, problem.point, s.R, s.X, s.W, dt_s, s.T, fit.conditions),
        sigma_0=float(np.sqrt(s.cost / r)) if r > 0 else float("nan"),
        redundancy=r,
        iterations=s.iterations,
        cost=s.cost,
    )


def _triangulated(observations: Observations) -> _Points:
    tracks = observations.tracks
    rig, uv, cov = undistorted(observations.rig, tracks.uv, tracks.cov)
    l, C = triangulate(rig, uv, cov)
    good = np.isfinite(l).all(axis=1)
    return _Points(rig, tracks.frame[good], tracks.track[good], l[good], C[good], uv[good], np.linalg.inv(cov[good]))


def _problem(
    points: _Points, rows: Array, frames: Array, config: SlidingWindowAdjustment
) -> tuple[Problem, Int[Array, "n"]]:
    tracks, point = np.unique(points.track[rows], return_inverse=True)
    frame = np.searchsorted(frames, points.frame[rows])
    l = points.l[rows]
    model = observation_model(points.rig, l, points.C[rows], points.W_uv[rows], config.weights, config.second_order)
    return Problem(frame, point, l, model, len(frames), len(tracks)), tracks


def _propagated(t_s: Array, frames: Array, previous: WindowEstimate | None) -> Poses | None:
    """Poses of the last window, the newest one extrapolated; None where it does not hold all others (3.7.1.2)."""
    if previous is None:
        return None
    known, old, new = np.intersect1d(previous.frames, frames, return_indices=True)
    if len(known) < 2 or len(frames) - len(known) > 1:
        return None
    R, T = np.empty((len(frames), 3, 3)), np.empty((len(frames), 3))
    R[new], T[new] = previous.T_co.R[old], previous.T_co.t[old]
    if len(known) < len(frames):
        last = old[-2:]
        R[-1], T[-1] = initial_values.extrapolate(
            previous.T_co.R[last], previous.T_co.t[last], t_s[known[-2:]], float(t_s[frames[-1]])
        )
    return R, T
