"""State of the vehicle filter: a rigid body with constant turn rate and velocity, and points fixed to it.

The body o moves in a frame w, the world where ego poses are observed, else the left camera. Its twist (omega, v) in
body axes is constant but for white angular and linear acceleration:

    T_wo(t + dt) = T_wo(t) exp(twist dt)

Errors are those of the body's own frame, T <- T exp(d), twist <- twist + d', X <- X + dX, stacked as

    0:3 rotation   3:6 position   6:9 angular rate   9:12 velocity   12: points, three each

so that their transition depends on the twist alone: d+ = Ad(exp(-twist dt)) d + dt J_r(twist dt) d'.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import expm

from sim.pose import Pose, hat

Array = np.ndarray
MOTION = 12  # error states without points
# Below this speed [m/s] the course does not tell along from aside.
_SLOW_MPS = 1.0


@dataclass(frozen=True, eq=False)
class State:
    """Pose T_wo, twist (6,) of omega [rad/s] and v [m/s] in body axes, points X_o (n, 3) [m] of the tracks (n,).

    support (n,): observations that agree with the point, one at its birth; see `filter_points`.
    """

    T: Pose
    twist: Float[Array, "6"]
    X: Float[Array, "n 3"]
    track: Int[Array, "n"]
    support: Int[Array, "n"]

    def __len__(self) -> int:
        """Number of error states."""
        return MOTION + 3 * len(self.X)

    def plus(self, d: Float[Array, "e"]) -> State:
        """The state with its errors taken off."""
        X = self.X + d[MOTION:].reshape(-1, 3)
        return replace(self, T=self.T @ Pose.exp(d[:6]), twist=self.twist + d[6:MOTION], X=X)

    def minus(self, other: State) -> Float[Array, "e"]:
        """d with ``other.plus(d)`` this state; both have the same points."""
        pose = (other.T.inv() @ self.T).log()
        return np.concatenate([pose, self.twist - other.twist, (self.X - other.X).ravel()])

    def moved(self, dt_s: float) -> State:
        """The state after a time (before, if negative) without noise."""
        return replace(self, T=self.T @ Pose.exp(self.twist * dt_s))

    def select(self, points: Array) -> State:
        """The state with some of its points."""
        return replace(self, X=self.X[points], track=self.track[points], support=self.support[points])


def error_rows(points: Array) -> Int[Array, "e"]:
    """Rows of the error state that a selection (indices) of the points keeps."""
    return np.concatenate([np.arange(MOTION), (MOTION + 3 * points[:, None] + np.arange(3)).ravel()])


def transition(twist: Float[Array, "6"], dt_s: float) -> Float[Array, "12 12"]:
    """Of the errors of pose and twist over a time, exact; points stay as they are."""
    S = hat(twist.reshape(2, 3))
    M = np.zeros((MOTION, MOTION))
    M[:3, :3] = M[3:6, 3:6] = -S[0]
    M[3:6, :3] = -S[1]
    M[:6, 6:] = np.eye(6)
    return np.asarray(expm(M * dt_s))


def reset(d: Float[Array, "e"]) -> Float[Array, "e e"]:
    """Of the errors from those of a state to those of the state corrected by d, whose pose has other axes.

    exp(d + e) = exp(d) exp(J_r(d) e).
    """
    J = np.eye(len(d))
    J[:6, :6] = transition(d[:6], 1.0)[:6, 6:]
    return J


@dataclass(frozen=True)
class Noise:
    """Spectral densities as standard deviations, so that nothing depends on the frame rate.

    Acceleration [m/s² sqrt(s)] along the horizontal course, aside and upwards; angular acceleration [rad/s² sqrt(s)]
    about the vertical (yaw) and about both horizontal axes (tilt).
    """

    longitudinal: float
    lateral: float
    vertical: float
    yaw: float
    tilt: float

    def inputs(
        self, state: State, up: Float[Array, "3"], dt_s: float
    ) -> tuple[Float[Array, "12 12"], Float[Array, "12"]]:
        """G and variances q of what enters the errors of pose and twist over a time, G diag(q) G'.

        White noise of density s² gives [dt³/3, dt²/2; dt²/2, dt] s²: a step of the twist half-way, and the rest of the
        pose. up (3,): the vertical in w. At a crawl the course is no direction, and aside is as free as along.
        """
        axes, aside = _course(state.T.R.T @ up, state.twist[3:])
        lateral = aside * self.lateral**2 + (1 - aside) * self.longitudinal**2
        density = np.array([self.tilt**2, self.tilt**2, self.yaw**2, self.longitudinal**2, lateral, self.vertical**2])
        B = np.zeros((6, 6))
        B[:3, :3] = B[3:, 3:] = axes
        G = np.zeros((MOTION, MOTION))
        G[:6, :6], G[6:, :6], G[:6, 6:] = B * dt_s / 2, B, B
        return G, np.concatenate([density * dt_s, density * dt_s**3 / 12])


def _course(up: Array, v: Array) -> tuple[Array, float]:
    """Axes (columns) along the horizontal part of the velocity v, aside and up; how far the first is a direction."""
    along = v - up * (up @ v)
    speed = np.linalg.norm(along)
    if speed < 1e-6:
        along = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    along = along / np.linalg.norm(along)
    return np.stack([along, np.cross(up, along), up], axis=1), float(speed**2 / (speed**2 + _SLOW_MPS**2))
