"""The 4-D vehicle filter: the recursive alternative to an adjustment, Dickmanns 2007, 6.4."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from estimators.estimate import EstimationFailed, Failure, TrajectoryEstimate, WindowEstimate
from estimators.gauss_markov import SingularSystem
from estimators.kalman import FORMS, FormName
from estimators.stereo.filter_adjusted import adjusted_start
from estimators.stereo.filter_centroid import started, window_of_centroid
from estimators.stereo.filter_output import window_of_points
from estimators.stereo.filter_points import REJECTED, USED, Seen, with_points
from estimators.stereo.filter_run import UP, Run, Step, observed_frames
from estimators.stereo.filter_smoother import smoothed
from estimators.stereo.filter_start import Error, Prior, own_start
from estimators.stereo.filter_state import Noise
from estimators.stereo.vehicle import interpret
from estimators.stereo.window_adjustment import Points, triangulated
from estimators.stereo.windows import MIN_POINTS
from sim.observations import Observations
from sim.pose import Pose

Array = np.ndarray


@dataclass(frozen=True)
class VehicleFilter:
    """Motion and shape of a rigid object by an extended Kalman filter: constant turn rate and velocity (CTRV).

    Every frame is predicted and corrected once; nothing is linearised again (Dickmanns 2007, 6.4.2.3). Where ego poses
    are observed the motion is constant in the world, else relative to the camera.

    State
        state: "points" has pose, velocity, angular rate and the object's points as states, measured in both images;
        "centroid" only the motion, measured at the centroid of the triangulated points: it cannot tell how the object
        is turned but from its path.
    Noise of the motion, spectral densities: nothing depends on the frame rate
        longitudinal and lateral (of the horizontal course) and vertical acceleration; angular acceleration about the
        vertical (yaw) and about the horizontal axes (tilt).
    Start
        start: "own" from the first two frames, speed, yaw and tilt rate with the standard deviations given here; "poor"
        the same, but farther away, faster and turned by the ``poor`` values, which are poor_sigmas standard deviations
        of what the filter believes; "adjustment" of the first start_frames frames.
    Filter
        form: how the covariance is carried, see `estimators.kalman`; gate_sigma: a point whose innovation is beyond is
        not used, infinite for no gate; smooth: every frame from all observations, by the Rauch-Tung-Striebel smoother.

    A window's cost is the normalised innovation squared of its newest frame, its redundancy the degrees of freedom.
    """

    state: Literal["points", "centroid"] = "points"
    form: FormName = "udu"
    gate_sigma: float = 4.0
    smooth: bool = False
    longitudinal_noise_mps2_sqrt_s: float = 3.0
    lateral_noise_mps2_sqrt_s: float = 1.0
    vertical_noise_mps2_sqrt_s: float = 0.3
    yaw_noise_radps2_sqrt_s: float = 0.5
    tilt_noise_radps2_sqrt_s: float = 0.1
    start: Literal["own", "poor", "adjustment"] = "own"
    start_frames: int = 10
    speed_sigma_mps: float = 20.0
    yaw_rate_sigma_radps: float = 0.5
    tilt_rate_sigma_radps: float = 0.1
    poor_position_m: float = 2.0
    poor_speed_mps: float = 5.0
    poor_yaw_rad: float = 0.2
    poor_sigmas: float = 5.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, float) and not (value > 0 and (value < np.inf or name == "gate_sigma")):
                raise ValueError(f"VehicleFilter.{name}: {value} is out of range, expected a positive number")
        if self.start_frames < 2:
            raise ValueError(f"VehicleFilter.start_frames: {self.start_frames} is out of range, expected 2 or more")
        if self.start == "adjustment" and self.state == "centroid":
            raise ValueError("VehicleFilter.start: an adjustment starts object points; expected own or poor")

    def __call__(self, observations: Observations) -> TrajectoryEstimate | EstimationFailed:
        started_s = time.perf_counter()
        if len(observations.tracks) and not observations.tracks.informative.any():
            return EstimationFailed("no observation has a finite covariance", ("state the sigma of the image points",))
        results = list(self._estimates(observations))
        found = tuple(r for r in results if isinstance(r, WindowEstimate))
        failures = tuple(r for r in results if isinstance(r, Failure))
        if not found:
            reason = failures[0].reason if failures else "no two frames have three tracks or more"
            return EstimationFailed(reason, (f"{len(failures)} frames failed",))
        return TrajectoryEstimate(
            t_s=observations.t_s,
            windows=found,
            failures=failures,
            interpretation=interpret(found, observations.t_s, observations.T_wc),
            T_wc=observations.T_wc,
            runtime_s=time.perf_counter() - started_s,
        )

    @property
    def _noise(self) -> Noise:
        return Noise(
            self.longitudinal_noise_mps2_sqrt_s,
            self.lateral_noise_mps2_sqrt_s,
            self.vertical_noise_mps2_sqrt_s,
            self.yaw_noise_radps2_sqrt_s,
            self.tilt_noise_radps2_sqrt_s,
        )

    def _estimates(self, observations: Observations) -> Iterator[WindowEstimate | Failure]:
        """One of every frame after the start, in order of the frames but for the failures."""
        points, t_s = triangulated(observations, "linear"), observations.t_s
        frames = observed_frames(observations, points)
        first: Step | None = None
        since = 0
        for newest, window in self._starts(frames):
            found = self._started(observations, points, frames, window)
            if isinstance(found, Step):
                first, since = found, int(window[0])
                break
            yield Failure(newest, found.reason, found.hints)
        if first is None:
            return
        steps: list[Step] = []
        for step in Run(FORMS[self.form], self._noise, self.gate_sigma, self.state == "points").steps(
            first, frames, t_s
        ):
            if isinstance(step, Failure):
                yield step
            elif self.smooth:
                steps.append(step)
            else:
                yield self._window(step, frames, t_s, since)
        for step in smoothed(steps):
            yield self._window(step, frames, t_s, since)

    def _starts(self, frames: list[Seen]) -> Iterator[tuple[int, Array]]:
        """Frames to start with, first those that come first: the newest, and all of them."""
        seen = np.flatnonzero([len(f.track) >= MIN_POINTS for f in frames])
        size = self.start_frames if self.start == "adjustment" else 1
        for end in range(size, len(seen) + 1):
            yield int(seen[end - 1]), seen[end - size : end]

    def _started(
        self, observations: Observations, points: Points, frames: list[Seen], window: Array
    ) -> Step | EstimationFailed:
        form, now, newest = FORMS[self.form], frames[window[-1]], int(window[-1])
        if self.start == "adjustment":
            found = adjusted_start(observations, points, frames, window, self._noise)
            if isinstance(found, EstimationFailed):
                return found
            state, P = found
        else:
            second = next((k for k in range(newest + 1, len(frames)) if len(frames[k].track) >= MIN_POINTS), newest)
            dt_s = float(observations.t_s[second] - observations.t_s[newest])
            prior = Prior(self.speed_sigma_mps, self.yaw_rate_sigma_radps, self.tilt_rate_sigma_radps)
            state, P = own_start(now, frames[second] if second > newest else None, dt_s, prior)
        F = form.start(P)
        if self.state == "points":
            k = np.flatnonzero(~np.isin(now.track, state.track))
            state, F = with_points(form, state, F, now, k, np.ones_like(k))
        else:
            state, P = started(state, P, now)
            F = form.start(P)
        if self.start == "poor":
            error = Error(self.poor_position_m, self.poor_speed_mps, self.poor_yaw_rad, self.poor_sigmas)
            state, P = error.spoil(state, form.covariance(F), now.T_wc, UP)
            F = form.start((P + P.T) / 2)
        return Step.first(newest, now, state, F, form.covariance(F))

    def _window(self, step: Step, frames: list[Seen], t_s: Array, since: int) -> WindowEstimate | Failure:
        """The estimate of a step and the frame before, by observations since a frame."""
        pair = np.array([step.before, step.frame])
        T_wc, dt_s = Pose.stack([frames[k].T_wc for k in pair]), float(t_s[step.frame] - t_s[step.before])
        try:
            if self.state == "centroid":
                found = window_of_centroid(step.state, step.P, pair, T_wc, dt_s, step.seen, step.nis, step.dof)
                return replace(found, since=since)
            used = np.flatnonzero(step.state.support >= USED)
            if len(used) < MIN_POINTS:
                return Failure(step.frame, "fewer than three points have been seen twice")
            rejected = step.state.track[step.state.support <= REJECTED]
            found = window_of_points(step.state, step.P, pair, T_wc, dt_s, used, rejected, step.nis, step.dof)
            return replace(found, since=since)
        except SingularSystem as error:
            return Failure(step.frame, str(error))
