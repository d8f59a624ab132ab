"""The vehicle filter's loop over the frames: predict, correct, points that end and are born."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from estimators.estimate import Failure
from estimators.kalman import Form
from estimators.stereo import filter_centroid, filter_points
from estimators.stereo.filter_points import Seen, with_points, without_points
from estimators.stereo.filter_state import MOTION, Noise, State, error_rows, transition
from estimators.stereo.vehicle import level_camera
from estimators.stereo.window_adjustment import Points
from estimators.stereo.windows import MIN_POINTS
from sim.observations import Observations

Array = np.ndarray
# Of w: the world's, or that of a camera taken to be level.
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Step:
    """The filter after the measurements of one frame.

    F is the covariance P in the form's way; nis the normalised innovation squared, dof its degrees of freedom. What the
    smoother needs: which points (indices) of the step before are among this state's first ones, the state predicted of
    them and its covariance, and the transition A of pose and twist. before: the frame of the last step.
    """

    frame: int
    before: int
    seen: Seen
    state: State
    F: Array
    P: Float[Array, "e e"]
    nis: float
    dof: int
    kept: Int[Array, "s"]
    predicted: State
    P_predicted: Float[Array, "p p"]
    A: Float[Array, "12 12"]

    @staticmethod
    def first(frame: int, seen: Seen, state: State, F: Array, P: Array) -> Step:
        """Where a filter begins."""
        return Step(frame, frame, seen, state, F, P, 0.0, 0, np.arange(len(state.X)), state, P, np.eye(MOTION))


def observed_frames(observations: Observations, points: Points) -> list[Seen]:
    """What was observed in each frame; without ego poses w is the world of a level, standing camera."""
    m = len(observations.t_s)
    T_wc = level_camera(m) if observations.T_wc is None else observations.T_wc
    R, ends = np.linalg.inv(points.W_uv), np.searchsorted(points.frame, np.arange(m + 1))
    rows = [slice(a, b) for a, b in pairwise(ends)]
    return [
        Seen(points.rig, T_wc[k], points.track[r], points.uv[r], R[r], points.l[r], points.C[r])
        for k, r in enumerate(rows)
    ]


@dataclass(frozen=True, eq=False)
class Run:
    """What does not change from step to step; shape: whether the object's points are states."""

    form: Form
    noise: Noise
    gate_sigma: float
    shape: bool

    def steps(self, step: Step, frames: Sequence[Seen], t_s: Float[Array, "m"]) -> Iterator[Step | Failure]:
        """One of every frame after the first step."""
        lost = ""
        for frame in range(step.frame + 1, len(frames)):
            if lost or len(frames[frame].track) < MIN_POINTS:
                yield Failure(frame, lost or "the frame has fewer than three tracks")
                continue
            try:
                step = self._next(step, frame, frames[frame], float(t_s[frame] - t_s[step.frame]))
                yield step
            except (ValueError, np.linalg.LinAlgError) as error:
                lost = f"the filter diverged at frame {frame}: {error}"
                yield Failure(frame, lost)

    def _next(self, last: Step, frame: int, seen: Seen, dt_s: float) -> Step:
        """Prediction to a frame and correction by it.

        Raises
            ValueError, LinAlgError: the covariance is no longer positive definite, or something is not finite.
        """
        form, measurement = self.form, filter_points if self.shape else filter_centroid
        kept = np.flatnonzero(np.isin(last.state.track, seen.track))
        state, F = without_points(form, last.state, last.F, kept)
        A, G = np.eye(len(state)), np.zeros((len(state), MOTION))
        A[:MOTION, :MOTION] = transition(state.twist, dt_s)
        G[:MOTION], q = self.noise.inputs(state, UP, dt_s)
        predicted, F = state.moved(dt_s), form.predict(F, A, G, q)
        c = measurement.correct(form, predicted, F, seen, self.gate_sigma)
        good = np.flatnonzero(~c.gated)
        rows = error_rows(good)
        P_predicted = form.covariance(F)[np.ix_(rows, rows)]
        state, F = without_points(form, c.state, c.F, good)
        if self.shape:
            k = np.flatnonzero(~np.isin(seen.track, state.track))
            support = np.where(np.isin(seen.track[k], predicted.track), -1, 1)
            state, F = with_points(form, state, F, seen, k, support)
        P = form.covariance(F)
        np.linalg.cholesky(P)
        if not (np.isfinite(state.twist).all() and np.isfinite(state.T.t).all()):
            raise ValueError("its state is not finite")
        A = A[:MOTION, :MOTION]
        return Step(
            frame, last.frame, seen, state, F, P, c.nis, c.dof, kept[good], predicted.select(good), P_predicted, A
        )
