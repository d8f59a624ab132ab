"""The vehicle filter without a shape: the centroid of each frame's triangulated points is all it measures.

The simple tracker of the literature. It cannot know how the object is turned: its rotation is only the axes that speed
and angular rate are given in, and a turn shows in the path alone, as the course of CTRV. Where other points come into
view the centroid moves on the object, which the filter takes for motion.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import chi2

from estimators.estimate import WindowEstimate
from estimators.kalman import Form
from estimators.stereo.filter_output import pose_jacobian, poses
from estimators.stereo.filter_points import Corrected, Seen
from estimators.stereo.filter_start import DATUM_RAD
from estimators.stereo.filter_state import MOTION, State
from estimators.stereo.object_motion import functionals
from sim.pose import Pose, exp_so3, hat

Array = np.ndarray


def centroid(seen: Seen) -> tuple[Float[Array, "3"], Float[Array, "3 3"]]:
    """Of the points of a frame in w [m], and its covariance [m²]."""
    R, n = seen.T_wc.R, len(seen.l)
    return seen.T_wc.apply(seen.l.mean(axis=0)), R @ seen.C.sum(axis=0) @ R.T / n**2


def correct(form: Form, state: State, F: Array, seen: Seen, gate_sigma: float) -> Corrected:
    """Corrects by the centroid; one beyond the gate is not used, and the prediction stands."""
    z, C = centroid(seen)
    H, dz = np.zeros((3, MOTION)), z - state.T.t
    H[:, 3:6] = state.T.R
    nobody = np.zeros(0, bool)
    if np.isfinite(gate_sigma):
        S = H @ form.covariance(F) @ H.T + C
        if dz @ np.linalg.solve(S, dz) > chi2.isf(chi2.sf(gate_sigma**2, 1), 3):
            return Corrected(state, F, 0.0, 0, nobody)
    c = form.correct(np.zeros(MOTION), F, H, dz, C[None])
    state = state.plus(c.x)
    return Corrected(state, _with_axes_known(form, state, c.F, c.x[:3]), float(c.nis), 3, nobody)


def _with_axes_known(form: Form, state: State, F: Array, turned: Array) -> Array:
    """The covariance of the same motion where all doubt is in the twist: the axes themselves cannot be observed.

    Turned by e, the same velocity has the components v + v x e; the correction itself has ``turned`` the axes.
    """
    M = np.eye(MOTION)
    M[:3, :3], M[3:6, 3:6] = 0, exp_so3(-turned)
    M[6:9, :3], M[9:, :3] = -hat(state.twist[:3]), -hat(state.twist[3:])
    return form.predict(F, M, np.eye(MOTION, 3), np.full(3, DATUM_RAD**2))


def started(state: State, P: Float[Array, "12 12"], seen: Seen) -> tuple[State, Float[Array, "12 12"]]:
    """The start of a filter that knows no shape: at the centroid of the first frame."""
    z, C = centroid(seen)
    P = P.copy()
    P[3:6, 3:6] += state.T.R.T @ C @ state.T.R
    return replace(state, T=Pose(state.T.R, z)), P


def window_of_centroid(
    state: State,
    P: Float[Array, "12 12"],
    frames: Int[Array, "2"],
    T_wc: Pose,
    dt_s: float,
    seen: Seen,
    nis: float,
    dof: int,
) -> WindowEstimate:
    """The estimate of two frames: the newest frame's own points, shifted to where the filter has their centroid.

    How the cloud is turned is as uncertain as its points Y. These have been measured, as their centroid: with the noise
    n of that, cov(state, n) = P H' cov(n)^-1 cov(n), so that cov(state, Y) = P H' cov(n)^-1 cov(n, Y).

    Raises
        SingularSystem: the points are collinear.
    """
    T_co = poses(state, T_wc, dt_s)
    R_oc = T_co.R[1].T
    X = (seen.l - seen.l.mean(axis=0)) @ R_oc.T
    by_pose, by_point = functionals(T_co.R, X, dt_s)
    F = by_pose @ pose_jacobian(state, T_co.R, dt_s)
    F[3:6] = 0
    by_point[:, [0, 1, 2, 6, 7, 8]] = 0
    C = R_oc @ seen.C @ R_oc.T
    shares = np.einsum("nab,ncb->ac", C, by_point)
    cov = F @ P @ F.T + np.einsum("nab,nbc,ndc->ad", by_point, C, by_point)
    if dof:
        both = len(C) * F @ P[:, 3:6] @ np.linalg.solve(C.sum(axis=0), shares)
        cov += both + both.T
    return WindowEstimate(
        frames=frames,
        T_co=T_co,
        track=seen.track,
        X_o=X,
        cov=(cov + cov.T) / 2,
        sigma_0=float(np.sqrt(nis / dof)) if dof else float("nan"),
        redundancy=dof,
        iterations=1,
        cost=nis,
    )
