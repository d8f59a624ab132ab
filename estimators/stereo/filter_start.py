"""How the vehicle filter begins: its own way from the first frames, and deliberately badly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from estimators.stereo.filter_points import Seen
from estimators.stereo.filter_state import MOTION, State
from estimators.stereo.windows import MIN_POINTS
from sim.pose import Pose

Array = np.ndarray
# The object frame is where the start puts it, by definition; a covariance has to be positive.
DATUM_M, DATUM_RAD = 1e-4, 1e-5
_NO_POINTS = np.empty(0, int)


@dataclass(frozen=True)
class Prior:
    """Standard deviations of the motion at the start: speed [m/s] in every direction, angular rate [rad/s] about the
    vertical (yaw) and about both horizontal axes (tilt)."""

    speed: float
    yaw_rate: float
    tilt_rate: float

    @property
    def variances(self) -> Float[Array, "6"]:
        """Of the twist in a frame with a vertical z axis."""
        return np.array([self.tilt_rate, self.tilt_rate, self.yaw_rate, *[self.speed] * 3]) ** 2


def own_start(first: Seen, second: Seen | None, dt_s: float, prior: Prior) -> tuple[State, Float[Array, "12 12"]]:
    """State without points, and its covariance, at the first frame.

    The origin is the median of the triangulated points, the axes are those of w. The velocity is what moves the points
    both frames have, weighted by their covariance; it is a start value only, for its covariance is the prior's and the
    second frame is still to be measured.
    """
    T = Pose(np.eye(3), np.median(first.T_wc.apply(first.l), axis=0))
    twist = np.concatenate([np.zeros(3), np.zeros(3) if second is None else _velocity(first, second, dt_s)])
    datum = np.array([DATUM_RAD] * 3 + [DATUM_M] * 3) ** 2
    state = State(T, twist, np.empty((0, 3)), _NO_POINTS, _NO_POINTS)
    return state, np.diag(np.concatenate([datum, prior.variances]))


def _velocity(first: Seen, second: Seen, dt_s: float) -> Array:
    """Weighted mean of the points' shifts between two frames; zero where they share too few tracks."""
    _, i, k = np.intersect1d(first.track, second.track, assume_unique=True, return_indices=True)
    if len(i) < MIN_POINTS:
        return np.zeros(3)
    old, new = first.T_wc.R, second.T_wc.R
    W = np.linalg.inv(old @ first.C[i] @ old.T + new @ second.C[k] @ new.T)
    shift = second.T_wc.apply(second.l[k]) - first.T_wc.apply(first.l[i])
    return np.asarray(np.linalg.solve(W.sum(axis=0), np.einsum("kab,kb->a", W, shift)) / dt_s)


@dataclass(frozen=True)
class Error:
    """What a start is wrong by: farther away along the line of sight by a position [m] and faster by a speed [m/s],
    turned about the vertical by an angle [rad]; sigmas: how many of its own standard deviations that is."""

    position: float
    speed: float
    yaw: float
    sigmas: float

    def spoil(
        self, state: State, P: Float[Array, "e e"], T_wc: Pose, up: Float[Array, "3"]
    ) -> tuple[State, Float[Array, "e e"]]:
        """State and covariance P with these errors in them, which the filter takes for unlikely."""
        R_ow = state.T.R.T
        sight = state.T.t - T_wc.t
        sight = R_ow @ (sight / np.linalg.norm(sight))
        error = np.concatenate([R_ow @ up * self.yaw, sight * self.position, np.zeros(3), sight * self.speed])
        P = P.copy()
        P[9:MOTION], P[:, 9:MOTION] = 0, 0
        believed = np.repeat([self.yaw, self.position, 0, self.speed], 3) / self.sigmas
        P[np.arange(MOTION), np.arange(MOTION)] += believed**2
        return state.plus(np.concatenate([error, np.zeros(len(state) - MOTION)])), P
