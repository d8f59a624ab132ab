"""The vehicle filter's start from a sliding-window adjustment of its first frames."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from estimators.estimate import EstimationFailed, WindowEstimate
from estimators.stereo.configuration import Configuration
from estimators.stereo.filter_points import Seen, innovation
from estimators.stereo.filter_run import UP
from estimators.stereo.filter_start import DATUM_M, DATUM_RAD
from estimators.stereo.filter_state import MOTION, Noise, State, error_rows, transition
from estimators.stereo.window_adjustment import Points, adjust_window
from sim.observations import Observations
from sim.pose import Pose

Array = np.ndarray


def adjusted_start(
    observations: Observations, points: Points, frames: list[Seen], window: Int[Array, "m"], noise: Noise
) -> tuple[State, Float[Array, "e e"]] | EstimationFailed:
    """State with the points of the newest frame of a window, and its covariance, by adjustment of the window.

    Tracks that the robust detector takes for outliers are left out; the filter may take them in again.
    The newest pose is the datum. The twist is that between the first and the newest pose, its covariance that of all
    poses and points, and that of a mean against the value at its end, a third of what the noise adds meanwhile.
    """
    newest, config = int(window[-1]), Configuration(window=len(window), start_window=len(window), outliers="robust")
    w = adjust_window(config, observations, points, newest, window, None)
    if isinstance(w, EstimationFailed):
        return w
    T_wo = Pose.stack([frames[f].T_wc for f in w.frames]) @ w.T_co
    try:
        Q = _covariance(w, T_wo, [frames[f] for f in w.frames])
    except np.linalg.LinAlgError:
        return EstimationFailed("the adjustment does not determine the start")
    dt_s = float(observations.t_s[newest] - observations.t_s[w.frames[0]])
    twist = (T_wo[0].inv() @ T_wo[-1]).log() / dt_s
    count = np.sum([np.isin(w.track, frames[f].track) for f in w.frames], axis=0)
    state = State(T_wo[-1], twist, w.X_o, w.track, count)
    A, last, n = transition(twist, dt_s), 6 * (len(w.frames) - 1), len(Q)
    J = np.zeros((len(state), n))
    J[:6, last : last + 6] = np.eye(6)
    back = np.linalg.inv(A[:6, 6:])
    J[6:MOTION, last : last + 6], J[6:MOTION, :6] = back, -back @ A[:6, :6]
    J[MOTION:, last + 6 :] = np.eye(len(state) - MOTION)
    P = J @ Q @ J.T
    G, q = noise.inputs(state, UP, dt_s)
    P[6:MOTION, 6:MOTION] += (G * q @ G.T)[6:, 6:] / 3
    seen = np.flatnonzero(np.isin(w.track, frames[newest].track))
    rows = error_rows(seen)
    P = P[np.ix_(rows, rows)]
    return state.select(seen), (P + P.T) / 2


def _covariance(w: WindowEstimate, T_wo: Pose, frames: list[Seen]) -> Array:
    """Of the errors of all poses and points of a window, the newest pose its datum."""
    m, n = len(frames), len(w.track)
    N = np.zeros((6 * m + 3 * n, 6 * m + 3 * n))
    for t, seen in enumerate(frames):
        _, i, k = np.intersect1d(w.track, seen.track, assume_unique=True, return_indices=True)
        pose, point, _ = innovation(w.X_o[i], T_wo[t], seen, k)
        W = np.linalg.inv(seen.R[k])
        a, b = slice(6 * t, 6 * t + 6), 6 * m + 3 * i[:, None] + np.arange(3)
        weighted = np.swapaxes(pose, 1, 2) @ W
        N[a, a] += (weighted @ pose).sum(axis=0)
        mixed = weighted @ point
        N[a, b] += np.moveaxis(mixed, 1, 0)
        N[b, a] += np.swapaxes(mixed, 1, 2)
        N[b[:, :, None], b[:, None, :]] += np.swapaxes(point, 1, 2) @ W @ point
    newest = np.arange(6 * m - 6, 6 * m)
    N[newest, newest] += np.repeat([DATUM_RAD, DATUM_M], 3) ** -2.0
    np.linalg.cholesky(N)
    return np.linalg.inv(N)
