"""The 4-D vehicle filter: the recursive alternative to an adjustment, Dickmanns 2007, 6.4."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from estimators.estimate import EstimationFailed, Failure, TrajectoryEstimate, WindowEstimate
from estimators.gauss_markov import SingularSystem
from estimators.kalman import FORMS, FormName
from estimators.stereo.filter_output import window_of_points
from estimators.stereo.filter_points import REJECTED, USED, Seen, correct, with_points, without_points
from estimators.stereo.filter_start import Prior, own_start
from estimators.stereo.filter_state import MOTION, Noise, State, transition
from estimators.stereo.vehicle import interpret, level_camera
from estimators.stereo.window_adjustment import triangulated
from estimators.stereo.windows import MIN_POINTS
from sim.observations import Observations
from sim.pose import Pose

Array = np.ndarray
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class VehicleFilter:
    """Motion and shape of a rigid object by an extended Kalman filter: constant turn rate and velocity (CTRV).

    Every frame is predicted and corrected once; nothing is linearised again (Dickmanns 2007, 6.4.2.3). Where ego poses
    are observed the motion is constant in the world, else relative to the camera.

    State
        state: "points" takes pose, velocity, angular rate and the object's points as states, measured in both images.
    Noise of the motion, spectral densities: nothing depends on the frame rate
        longitudinal, lateral (of the horizontal course), vertical acceleration; angular acceleration about the vertical
        (yaw) and about the horizontal axes (tilt).
    Start
        standard deviations of speed and of yaw and tilt rate before anything was measured.
    Filter
        form: how the covariance is carried, see `estimators.kalman`; gate_sigma: a point whose innovation is beyond is
        not used, infinite for no gate.
    """

    state: Literal["points"] = "points"
    form: FormName = "udu"
    gate_sigma: float = 4.0
    longitudinal_noise_mps2_sqrt_s: float = 3.0
    lateral_noise_mps2_sqrt_s: float = 1.0
    vertical_noise_mps2_sqrt_s: float = 0.3
    yaw_noise_radps2_sqrt_s: float = 0.5
    tilt_noise_radps2_sqrt_s: float = 0.1
    speed_sigma_mps: float = 20.0
    yaw_rate_sigma_radps: float = 0.5
    tilt_rate_sigma_radps: float = 0.1

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, float) and not (value > 0 and (value < np.inf or name == "gate_sigma")):
                raise ValueError(f"VehicleFilter.{name}: {value} is out of range, expected a positive number")

    def __call__(self, observations: Observations) -> TrajectoryEstimate | EstimationFailed:
        started = time.perf_counter()
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
            runtime_s=time.perf_counter() - started,
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
        """One of every frame after the start."""
        frames, t_s = observed_frames(observations), observations.t_s
        T_wc = level_camera(len(t_s)) if observations.T_wc is None else observations.T_wc
        before: Step | None = None
        lost = ""
        for frame, seen in enumerate(frames):
            if before is None:
                if len(seen.track) >= MIN_POINTS:
                    before = self._start(frames, frame, t_s)
                continue
            if lost or len(seen.track) < MIN_POINTS:
                yield Failure(frame, lost or "the frame has fewer than three tracks")
                continue
            try:
                step = self._step(before, frame, seen, float(t_s[frame] - t_s[before.frame]))
            except (ValueError, np.linalg.LinAlgError) as error:
                lost = f"the filter has diverged: {error}"
                yield Failure(frame, lost)
                continue
            yield window(step, before.frame, T_wc, t_s)
            before = step

    def _start(self, frames: list[Seen], first: int, t_s: Array) -> Step:
        second = next((k for k in range(first + 1, len(frames)) if len(frames[k].track) >= MIN_POINTS), None)
        prior = Prior(self.speed_sigma_mps, self.yaw_rate_sigma_radps, self.tilt_rate_sigma_radps)
        now, then = frames[first], None if second is None else frames[second]
        dt_s = 0.0 if second is None else float(t_s[second] - t_s[first])
        state, P = own_start(now, then, dt_s, prior)
        form = FORMS[self.form]
        k = np.arange(len(now.track))
        state, F = with_points(form, state, form.start(P), now, k, np.ones_like(k))
        return Step(first, state, F, form.covariance(F), 0.0, 0)

    def _step(self, before: Step, frame: int, seen: Seen, dt_s: float) -> Step:
        """Prediction to a frame and correction by it.

        Raises
            ValueError, LinAlgError: the covariance is no longer positive definite, or nothing is finite.
        """
        form = FORMS[self.form]
        state, F = without_points(form, before.state, before.F, np.isin(before.state.track, seen.track))
        A, G = np.eye(len(state)), np.zeros((len(state), MOTION))
        A[:MOTION, :MOTION] = transition(state.twist, dt_s)
        G[:MOTION], q = self._noise.inputs(state, _UP, dt_s)
        state, F = state.moved(dt_s), form.predict(F, A, G, q)
        c = correct(form, state, F, seen, self.gate_sigma)
        state, F = without_points(form, c.state, c.F, ~c.gated)
        k = np.flatnonzero(~np.isin(seen.track, state.track))
        support = np.where(np.isin(seen.track[k], c.state.track), -1, 1)
        state, F = with_points(form, state, F, seen, k, support)
        P = form.covariance(F)
        np.linalg.cholesky(P)
        return Step(frame, state, F, P, c.nis, c.dof)


@dataclass(frozen=True, eq=False)
class Step:
    """The filter after the measurements of one frame: F is the covariance P in the form's way."""

    frame: int
    state: State
    F: Array
    P: Array
    nis: float
    dof: int


def observed_frames(observations: Observations) -> list[Seen]:
    """What was observed in each frame."""
    points, m = triangulated(observations, "linear"), len(observations.t_s)
    T_wc = level_camera(m) if observations.T_wc is None else observations.T_wc
    ends = np.searchsorted(points.frame, np.arange(m + 1))
    R = np.linalg.inv(points.W_uv)
    rows = [slice(a, b) for a, b in pairwise(ends)]
    return [
        Seen(points.rig, T_wc[k], points.track[r], points.uv[r], R[r], points.l[r], points.C[r])
        for k, r in enumerate(rows)
    ]


def window(step: Step, before: int, T_wc: Pose, t_s: Array) -> WindowEstimate | Failure:
    """The estimate of a step and the frame before."""
    used = np.flatnonzero(step.state.support >= USED)
    if len(used) < MIN_POINTS:
        return Failure(step.frame, "fewer than three points have been seen twice")
    frames = np.array([before, step.frame])
    dt_s = float(t_s[step.frame] - t_s[before])
    rejected = step.state.track[step.state.support <= REJECTED]
    try:
        return window_of_points(step.state, step.P, frames, T_wc[frames], dt_s, used, rejected, step.nis, step.dof)
    except SingularSystem as error:
        return Failure(step.frame, str(error))
