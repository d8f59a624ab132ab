"""What the vehicle filter's state says in one frame, in the terms of all estimators: a `WindowEstimate` of two frames.

The older pose is the newest one taken back by the state's own twist, not the state of that frame: so velocity and rate
by differences of the two are what the filter says of the motion at its newest frame.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from estimators.estimate import WindowEstimate
from estimators.stereo.filter_state import MOTION, State, transition
from estimators.stereo.object_motion import functionals
from sim.pose import Pose

Array = np.ndarray


def poses(state: State, T_wc: Pose, dt_s: float) -> Pose:
    """T_co (2,) at the frames of the camera poses T_wc (2,), dt_s apart."""
    return T_wc.inv() @ Pose.stack([state.moved(-dt_s).T, state.T])


def pose_jacobian(state: State, R_co: Float[Array, "2 3 3"], dt_s: float) -> Float[Array, "12 12"]:
    """Derivative of both `poses` - each a rotation about the body's origin and a shift, in camera axes - by the errors
    of pose and twist."""
    own = np.concatenate([transition(state.twist, -dt_s)[:6], np.eye(6, MOTION)]).reshape(2, 2, 3, MOTION)
    return np.asarray(np.einsum("fab,fpbe->fpae", R_co, own).reshape(12, MOTION))


def window_of_points(
    state: State,
    P: Float[Array, "e e"],
    frames: Int[Array, "2"],
    T_wc: Pose,
    dt_s: float,
    used: Int[Array, "u"],
    rejected: Int[Array, "r"],
    nis: float,
    dof: int,
) -> WindowEstimate:
    """The estimate of two frames by the points ``used`` (indices); cost and redundancy are the NIS and its degrees of
    freedom, rejected the tracks that are.

    Raises
        SingularSystem: the points are collinear.
    """
    used = used[np.argsort(state.track[used])]
    T_co, X = poses(state, T_wc, dt_s), state.X[used]
    by_pose, by_point = functionals(T_co.R, X, dt_s)
    F = np.zeros((12, len(state)))
    F[:, :MOTION] = by_pose @ pose_jacobian(state, T_co.R, dt_s)
    for a in range(3):
        F[:, MOTION + 3 * used + a] = by_point[:, :, a].T
    cov = F @ P @ F.T
    return WindowEstimate(
        frames=frames,
        T_co=T_co,
        track=state.track[used],
        X_o=X,
        cov=(cov + cov.T) / 2,
        sigma_0=float(np.sqrt(nis / dof)) if dof else float("nan"),
        redundancy=dof,
        iterations=1,
        cost=nis,
        rejected=np.sort(rejected),
    )
