"""What an adjusted window says of a vehicle: driving direction, speed and yaw rate, Siegemund 2008, 3.8."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from estimators.estimate import Interpretation, WindowEstimate
from sim.pose import R_WORLD_FROM_LEVEL_CAMERA, Pose, log_so3

Array = np.ndarray


def _motion(window: WindowEstimate, t_s: Float[Array, "m"], T_wc: Pose) -> tuple[Array, Array]:
    """Velocity of the centroid [m/s] and angular rate [rad/s] in w, from the last two frames (3.8.5)-(3.8.7)."""
    last = window.frames[-2:]
    T = T_wc[last] @ window.T_co[-2:]
    dt = t_s[last[1]] - t_s[last[0]]
    centre = T.apply(window.X_o.mean(axis=0))
    return (centre[1] - centre[0]) / dt, log_so3(T.R[1] @ T.R[0].T) / dt


def interpret(windows: Sequence[WindowEstimate], t_s: Float[Array, "m"], T_wc: Pose | None) -> Interpretation:
    """Driving direction, speed and yaw rate of every window, over ground where ego poses are observed.

    Without ego poses the camera is taken as level and standing: everything is relative to it. A vehicle is taken to
    drive forwards (3.8.1).
    """
    level = Pose(np.broadcast_to(R_WORLD_FROM_LEVEL_CAMERA, (len(t_s), 3, 3)), np.zeros((len(t_s), 3)))
    motions = [_motion(w, t_s, level if T_wc is None else T_wc) for w in windows]
    v = np.array([m[0] for m in motions]).reshape(-1, 3)
    omega = np.array([m[1] for m in motions]).reshape(-1, 3)
    return Interpretation(
        frame=np.array([w.frames[-1] for w in windows], int),
        heading=np.arctan2(v[:, 0], v[:, 1]),
        speed=np.linalg.norm(v, axis=1),
        yaw_rate=omega[:, 2],
        over_ground=T_wc is not None,
    )
