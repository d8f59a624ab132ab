"""One window from observations to estimate: tracks chosen, poses started, adjusted, outliers left out, datum fixed."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from estimators.estimate import EstimationFailed, WindowEstimate
from estimators.gauss_markov import SingularSystem
from estimators.stereo import initial_values, windows
from estimators.stereo.conditions import Conditions, of_window
from estimators.stereo.configuration import Configuration
from estimators.stereo.datum import carried_frame, choose_three, in_frame, three_point_frame
from estimators.stereo.degeneracy import require_shape
from estimators.stereo.depth_bias import observation_model
from estimators.stereo.image_space import ImageProblem, adjust_images
from estimators.stereo.object_motion import (
    Problem,
    Solution,
    adjust,
    align,
    motion_covariance,
    redundancy,
)
from estimators.stereo.outliers import DETECTORS, PointTest, PriorKnowledge, TrackTest, Verdict, select_points
from estimators.stereo.solvers import adjust_full
from estimators.stereo.triangulation import Propagation, triangulate, undistorted
from sim.camera import StereoRig
from sim.observations import Observations
from sim.pose import Pose

Array = np.ndarray
Poses = tuple[Array, Array]
Known = Callable[..., tuple[Poses, Conditions | None]]
# A well-determined window started from its predecessor takes no more iterations; standard deviations a cost may exceed
# its expectation by before other starts are tried.
_EASY, _SURPRISE = 6, 1.5
# Starts that together find the least reprojection error most often; see benchmarks/start_values.py.
_BEST_AXES: tuple[initial_values.Axes, ...] = ("unrotated", "principal_axes_xz")
_TURN_RADPS = 0.3
# Newton decrement that is enough to tell outliers.
_ROUGH = 1e-2
_HINTS = ("too few or collinear tracks", "outliers among the tracks")


@dataclass(frozen=True, eq=False)
class Points:
    """Triangulated observations of the whole sequence, flat, in front of the cameras of an undistorted rig.

    frame, track (k,); l (k, 3) [m] with covariance C (k, 3, 3); uv (k, 4) [px] with weights W_uv (k, 4, 4).
    """

    rig: StereoRig
    frame: Int[Array, "k"]
    track: Int[Array, "k"]
    l: Float[Array, "k 3"]
    C: Float[Array, "k 3 3"]
    uv: Float[Array, "k 4"]
    W_uv: Float[Array, "k 4 4"]

    def select(self, rows: Array) -> Points:
        return Points(self.rig, *(x[rows] for x in (self.frame, self.track, self.l, self.C, self.uv, self.W_uv)))


def triangulated(observations: Observations, propagation: Propagation) -> Points:
    """The observations as points, but for those that say nothing or whose rays do not meet in front of the cameras."""
    tracks = observations.tracks.select(observations.tracks.informative)
    rig, uv, cov = undistorted(observations.rig, tracks.uv, tracks.cov)
    l, C = triangulate(rig, uv, cov, propagation)
    good = np.isfinite(l).all(axis=1)
    return Points(rig, tracks.frame[good], tracks.track[good], l[good], C[good], uv[good], np.linalg.inv(cov[good]))


@dataclass(frozen=True, eq=False)
class _Window:
    """The observations of one window, its frames (m,) and tracks (n,), and the problem they pose."""

    points: Points
    frames: Int[Array, "m"]
    track: Int[Array, "n"]
    problem: Problem

    @staticmethod
    def of(points: Points, frames: Array, config: Configuration) -> _Window:
        track, point = np.unique(points.track, return_inverse=True)
        frame = np.searchsorted(frames, points.frame)
        model = observation_model(points.rig, points.l, points.C, points.W_uv, config.weights, config.second_order)
        return _Window(points, frames, track, Problem(frame, point, points.l, model, len(frames), len(track)))

    def without(self, inlier: Array) -> _Window:
        """The window of some tracks alone.

        Raises
            SingularSystem: a frame is left with fewer than three tracks.
        """
        rows = inlier[self.problem.point]
        return _Window(self.points.select(rows), self.frames, self.track[inlier], select_points(self.problem, inlier))

    @property
    def images(self) -> ImageProblem:
        p = self.problem
        return ImageProblem(self.points.rig, p.frame, p.point, self.points.uv, self.points.W_uv, p.m, p.n)


@dataclass(frozen=True, eq=False)
class _Fit:
    """A solution with the start it was reached from and the conditions it was found under; redundancy r."""

    start: Poses
    conditions: Conditions | None
    solution: Solution
    r: int

    @property
    def motion(self) -> tuple[Array, Array, Array]:
        return self.solution.R, self.solution.T, self.solution.X

    @property
    def tied(self) -> bool:
        return self.conditions is not None and self.conditions.tied


def _sum(images: ImageProblem, fit: _Fit) -> float:
    return images.cost(*fit.motion)


def _median(images: ImageProblem, fit: _Fit) -> float:
    """Says more than the sum where there are outliers; infinite where many points are behind the cameras."""
    v = images.residuals(*fit.motion)
    squares = np.einsum("ka,kab,kb->k", v, images.W_uv, v)
    return float(np.median(np.nan_to_num(squares, nan=np.inf)))


def adjust_window(
    config: Configuration,
    observations: Observations,
    points: Points,
    newest: int,
    window: Int[Array, "m"],
    previous: WindowEstimate | None,
) -> WindowEstimate | EstimationFailed:
    """The estimate of the frames ``window`` up to ``newest``, started from the previous window where there is one."""
    if not len(window) or window[-1] != newest:
        return EstimationFailed("the newest frame has no observation")
    rows, frames = windows.select(points.frame, points.track, window, config.min_overlap)
    if len(frames) < 2 or frames[-1] != newest:
        return EstimationFailed(
            "the newest frame shares fewer than three tracks with the window", ("the tracks are too short",)
        )
    if previous is not None and config.extent_m and initial_values.has_drifted(previous.X_o, config.extent_m):
        previous = None
    w = _Window.of(points.select(rows), frames, config)
    T_wc = None if observations.T_wc is None else observations.T_wc[frames]
    known = functools.partial(of_window, config.smoothing, config.rotation_axis, observations.t_s[frames], T_wc)
    try:
        good, inlier, second, fit = _Adjustment(config, known, previous, observations.t_s[frames]).robust(w)
        result = _finished(config, good, fit, observations.t_s, previous)
        return replace(result, rejected=w.track[~inlier], second_group=w.track[second])
    except SingularSystem as error:
        return EstimationFailed(str(error), _HINTS)


@dataclass(frozen=True, eq=False)
class _Adjustment:
    """How a window is adjusted: options, conditions that belong to a start, the window before, times of its frames."""

    config: Configuration
    known: Known
    previous: WindowEstimate | None
    t_s: Float[Array, "m"]

    def robust(self, w: _Window) -> tuple[_Window, Array, Array, _Fit]:
        """The window of the good tracks, which (n,) those are, which of the others form a second group, and the fit."""
        c = self.config
        inlier, second = np.ones(len(w.track), bool), np.zeros(len(w.track), bool)
        if c.extent_m:
            cov = np.linalg.inv(w.points.W_uv)
            inlier = PriorKnowledge(c.extent_m)(w.points.rig, cov, w.problem.frame, w.problem.point, w.problem.l)
        good = w.without(inlier)
        start = self._propagated(w.frames)
        tied = 0 if start is None else c.smoothing.tied
        if c.outliers != "none":
            verdict = self._verdict(good, start)
            kept = np.flatnonzero(inlier)
            inlier[kept[~verdict.inlier]] = False
            if verdict.second_group is not None:
                second[kept[verdict.second_group]] = True
            good = good.without(verdict.inlier)
            start = (verdict.solution.R, verdict.solution.T) if start is None else start
        fit = self.best(good, start, tied)
        if c.space == "image":
            solution = adjust_images(good.images, fit.solution, c.stop, c.tolerance, c.max_iterations, fit.conditions)
            fit = replace(fit, solution=solution, r=fit.r + len(good.problem.frame))
        return good, inlier, second, fit

    def _verdict(self, w: _Window, start: Poses | None) -> Verdict:
        """What the detector says, of adjustments that need not end as sharply as the last one.

        The statistical tests and RANSAC weigh points where they are seen: estimated weights make a track that was
        triangulated far too far away outweigh all others.
        """
        detector = self.config.outliers
        rough = replace(self.config, stop="decrement", tolerance=max(self.config.tolerance, _ROUGH))
        if detector == "robust":
            start = next(self._cloud_starts(w.problem)) if start is None else start
            return DETECTORS[detector](w.problem, start, replace(self, config=rough).solve)
        seeing = replace(self, config=replace(rough, weights="observed", propagation="linear"))
        seen = _Window.of(w.points, w.frames, seeing.config)
        return self._detector()(seen.problem, seeing.best(seen, start, 0, _median).start, seeing.solve)

    def _detector(self) -> Callable[..., Verdict]:
        found, batches = DETECTORS[self.config.outliers], self.config.batches
        if batches is None or not isinstance(found, PointTest | TrackTest):
            return found
        return replace(found, max_iterations=batches)

    def best(
        self, w: _Window, start: Poses | None, tied: int, misfit: Callable[[ImageProblem, _Fit], float] | None = None
    ) -> _Fit:
        """Fit from a start; where that fails or is doubtful, of it and the cloud's the one of the least misfit.

        misfit: of the weighted image residuals of a fit. Weights that stay are compared by v'Wv, which was minimised;
        estimated ones fall with the distance of the points, and v'Wv with them.
        """
        tried: list[_Fit | SingularSystem] = []
        if start is not None:
            tried.append(self._attempt(w, start, tied))
            if isinstance(tried[0], _Fit) and _is_trusted(tried[0]):
                return tried[0]
        tried += [self._attempt(w, cloud, 0) for cloud in self._cloud_starts(w.problem)]
        found = [fit for fit in tried if isinstance(fit, _Fit)]
        if not found:
            raise next(error for error in tried if isinstance(error, SingularSystem))
        if misfit is None and w.problem.model.W is not None:
            return min(found, key=lambda fit: fit.solution.cost)
        if len(found) == 1:
            return found[0]
        images, compared = w.images, misfit or _sum
        return min(found, key=lambda fit: compared(images, fit))

    def _propagated(self, frames: Array) -> Poses | None:
        last = self.previous
        if last is None:
            return None
        return initial_values.propagated_poses(last.frames, last.T_co.R, last.T_co.t, frames, self.t_s)

    def _attempt(self, w: _Window, start: Poses, tied: int) -> _Fit | SingularSystem:
        try:
            start, conditions = self.known(start, tied)
            X = self._points(w, start)
            return self.fitted(w.problem, start, conditions, self.solve(w.problem, start, conditions, X))
        except SingularSystem as error:
            return error

    def solve(
        self, problem: Problem, start: Poses, conditions: Conditions | None = None, X: Array | None = None
    ) -> Solution:
        c = self.config
        if c.solver == "newton":
            return adjust(problem, *start, c.stop, c.tolerance, c.max_iterations, conditions, X)
        return adjust_full(problem, *start, c.solver, "inner", conditions, c.stop, c.tolerance, c.max_iterations)

    def fitted(self, problem: Problem, start: Poses, conditions: Conditions | None, s: Solution) -> _Fit:
        return _Fit(start, conditions, s, redundancy(problem, conditions, (s.R, s.T)))

    def _cloud_starts(self, p: Problem) -> Iterator[Poses]:
        initial = self.config.initial
        if initial == "shared_tracks":
            yield initial_values.from_shared_tracks(p.frame, p.point, p.l, p.m)
            return
        if initial != "best":
            yield initial_values.from_cloud(p.frame, p.l, p.m, initial)
            return
        for axes in _BEST_AXES:
            yield initial_values.from_cloud(p.frame, p.l, p.m, axes)
        for yaw_rate in (_TURN_RADPS, -_TURN_RADPS):
            yield initial_values.from_turn(p.frame, p.l, self.t_s, yaw_rate)
        yield initial_values.from_alignment(p.frame, p.point, p.l, p.m)

    def _points(self, w: _Window, start: Poses) -> Array | None:
        """Start values of the points; None for the mean, which the adjustment takes by itself."""
        if self.config.points == "mean":
            return None
        p, last = w.problem, self.previous
        X = initial_values.points_from_cloud(p.frame, p.point, p.l, *start, p.n, "median")
        if self.config.points == "median" or last is None:
            return X
        return initial_values.propagated_points(w.track, X, last.track, last.X_o)


def _is_trusted(fit: _Fit) -> bool:
    """Whether a propagated solution is no local minimum, of which far objects have many: quickly found, or cheap."""
    r = max(fit.r, 1)
    return bool(fit.solution.iterations <= _EASY or fit.solution.cost <= r + _SURPRISE * np.sqrt(2 * r))


def _finished(
    config: Configuration, w: _Window, fit: _Fit, t_s: Float[Array, "f"], previous: WindowEstimate | None
) -> WindowEstimate:
    """The solution with its covariance, in its datum."""
    s, p = fit.solution, w.problem
    if fit.conditions is None:
        require_shape(p.frame, p.point, s.R, s.X, s.W)
    Q, shift, three = _frame(config, w, fit, previous)
    R, T, X = in_frame(s.R, s.T, s.X, Q, shift)
    dt_s = t_s[w.frames[-1]] - t_s[w.frames[-2]]
    return WindowEstimate(
        frames=w.frames,
        T_co=Pose(R, T),
        track=w.track,
        X_o=X,
        cov=motion_covariance(p.frame, p.point, s.R, s.X, s.W, dt_s, s.T, fit.conditions),
        sigma_0=float(np.sqrt(s.cost / fit.r)) if fit.r > 0 else float("nan"),
        redundancy=fit.r,
        iterations=s.iterations,
        cost=s.cost,
        datum=three,
    )


def _frame(
    config: Configuration, w: _Window, fit: _Fit, previous: WindowEstimate | None
) -> tuple[Array, Array, Int[Array, "d"]]:
    """Rotation and shift into the object frame, and the tracks that define it where three do.

    The inner datum is that of the frames and points the last window knew, else of the start values; tied frames hold it
    themselves. Three points hold it while all of them are seen; others then put it where they lie.
    """
    s, none = fit.solution, np.empty(0, int)
    if config.datum == "three_points":
        kept = previous is not None and len(previous.datum) and np.isin(previous.datum, w.track).all()
        if previous is not None and kept:
            three = np.searchsorted(w.track, previous.datum)
        else:
            three = choose_three(w.problem.point, s.X)
        return *three_point_frame(s.X, three), w.track[three]
    if fit.tied:
        return np.eye(3), np.zeros(3), none
    if previous is not None:
        _, old, new = np.intersect1d(previous.frames, w.frames, return_indices=True)
        _, known, still = np.intersect1d(previous.track, w.track, return_indices=True)
        if len(new) and len(still) >= windows.MIN_POINTS:
            return *carried_frame(previous.T_co.R[old], s.R[new], previous.X_o[known], s.X[still]), none
    return *align(s.X, initial_values.points_by_mean(w.problem, *fit.start)), none
