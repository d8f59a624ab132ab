"""One window of an estimate against the truth, by the same material points in both: no gauge and no frame enters.

The tracks of the window that are inliers throughout it carry the comparison. The rigid alignment of their true points
on the estimated ones at the newest frame, ``y = T_err @ p``, carries the vehicle frame over to the estimate; the
window's own poses take it back to the frame before, with the same shape in both.

Where outlier tracks are part of a window, its stated covariance is that of all its tracks while the error is that of
the inliers; the two functionals then differ slightly, and nothing is recomputed for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from estimators.estimate import WindowEstimate
from estimators.stereo.object_motion import align
from sim.observations import Tracks
from sim.pose import Pose, hat, left_jacobian, log_so3
from sim.truth import INLIER, Truth

Array = np.ndarray
MIN_POINTS = 3
AT_REST = 1e-9  # below this speed [m/s] the course has no direction, and the speed no derivative


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of the target at a window's newest frame, vectors (3,) in axes of the left camera.

    position: centroid of the compared points [m]; reference: reference point [m]; lever: from the centroid of the
    window's points to the reference point [m]; velocity of the reference point [m/s] and angular rate omega [rad/s],
    both relative to the camera; speed [m/s] and yaw_rate [rad/s], over ground or relative; course and up: unit vectors
    of the velocity that ``speed`` measures and of the axis of ``yaw_rate``; ego_omega [rad/s], zero where all is
    relative; dt_s between the two newest frames.
    """

    position: Float[Array, "3"]
    reference: Float[Array, "3"]
    lever: Float[Array, "3"]
    velocity: Float[Array, "3"]
    omega: Float[Array, "3"]
    speed: float
    yaw_rate: float
    course: Float[Array, "3"]
    up: Float[Array, "3"]
    ego_omega: Float[Array, "3"]
    dt_s: float


@dataclass(frozen=True, eq=False)
class WindowComparison:
    """A window's estimated and true motion over its inlier tracks (p,) at its newest frame.

    y_c, p_c (p, 3) estimated and true camera coordinates [m]; T_err with ``y ~ T_err @ p``; orientation (3,) rotation
    vector of the estimated cloud against the true one [rad]; shape_m RMS distance after alignment [m]; true_velocity,
    true_omega (3,): the truth by differences of the same two frames, which the covariance is about, where ``truth``
    holds that at the instant.
    """

    window: WindowEstimate
    track: Int[Array, "p"]
    y_c: Float[Array, "p 3"]
    p_c: Float[Array, "p 3"]
    T_err: Pose
    estimate: Motion
    truth: Motion
    orientation: Float[Array, "3"]
    shape_m: float
    true_velocity: Float[Array, "3"]
    true_omega: Float[Array, "3"]

    @property
    def frame(self) -> int:
        return int(self.window.frames[-1])


def inlier_tracks(truth: Truth, tracks: Tracks, window: WindowEstimate) -> Bool[Array, "n"]:
    """Tracks of the window that lie on the target and have no row labelled an outlier in the window's frames."""
    inside = np.isin(tracks.frame, window.frames)
    spoilt = tracks.track[inside & (truth.labels.kind != INLIER)]
    on_target = truth.track[np.isfinite(truth.point_v).all(axis=1)]
    return np.asarray(np.isin(window.track, on_target) & ~np.isin(window.track, spoilt))


def true_outliers(truth: Truth, tracks: Tracks, window: WindowEstimate) -> Int[Array, "q"]:
    """Tracks of a window, used or rejected, that are outliers in it.

    A track that has jumped to another point before the window begins is a good track of that point.
    """
    rows = np.isin(tracks.frame, window.frames) & np.isin(tracks.track, np.concatenate([window.track, window.rejected]))
    kind, track = truth.labels.kind[rows], tracks.track[rows]
    jumped = np.isin(kind, [i + 1 for i, name in enumerate(truth.labels.kinds) if name == "temporal"])
    before = np.unique(track[kind == INLIER])
    return np.unique(track[(kind != INLIER) & (~jumped | np.isin(track, before))])


def compare_window(truth: Truth, tracks: Tracks, window: WindowEstimate, T_wc: Pose | None) -> WindowComparison | None:
    """Estimate against truth at the window's newest frame; T_wc (m,) the ego poses the estimator used, or None.

    None where the window has fewer than two frames or three inlier tracks: nothing can be compared.
    """
    good = inlier_tracks(truth, tracks, window)
    if good.sum() < MIN_POINTS or len(window.frames) < 2:
        return None
    frame, track = int(window.frames[-1]), window.track[good]
    y_all = window.T_co[-1].apply(window.X_o)
    y_c, p_c = y_all[good], truth.points_c(np.array([frame]), track)[0]
    T_err = Pose(*align(p_c, y_c))
    residual = y_c - T_err.apply(p_c)
    true_velocity, true_omega = _differences(
        truth.T_cv[window.frames[-2:]], truth.reference_v, _interval(truth, window)
    )
    return WindowComparison(
        window=window,
        track=track,
        y_c=y_c,
        p_c=p_c,
        T_err=T_err,
        estimate=_estimated_motion(truth, window, T_err, y_c.mean(axis=0), y_all.mean(axis=0), T_wc),
        truth=_true_motion(truth, window, p_c.mean(axis=0), over_ground=T_wc is not None),
        orientation=log_so3(T_err.R),
        shape_m=float(np.sqrt(np.mean(np.sum(residual**2, axis=1)))),
        true_velocity=true_velocity,
        true_omega=true_omega,
    )


def _interval(truth: Truth, window: WindowEstimate) -> float:
    return float(truth.t_s[window.frames[-1]] - truth.t_s[window.frames[-2]])


def _differences(T_cv: Pose, reference_v: Array, dt: float) -> tuple[Array, Array]:
    """Velocity of the reference point and angular rate between two poses, in camera axes."""
    reference = T_cv.apply(reference_v)
    return (reference[1] - reference[0]) / dt, log_so3(T_cv.R[1] @ T_cv.R[0].T) / dt


def _unit(x: Array) -> Array:
    length = np.linalg.norm(x)
    return x / length if length > AT_REST else np.full(3, np.nan)


def _estimated_motion(
    truth: Truth, window: WindowEstimate, T_err: Pose, position: Array, centroid: Array, T_wc: Pose | None
) -> Motion:
    """By differences of the window's two newest frames, Siegemund 2008, 3.8.2, second way."""
    dt = _interval(truth, window)
    T_cv_new = T_err @ truth.T_cv[int(window.frames[-1])]
    T_co = window.T_co[-2:]
    T_cv = T_co @ (T_co[1].inv() @ T_cv_new)
    reference = T_cv.apply(truth.reference_v)
    velocity, omega = _differences(T_cv, truth.reference_v, dt)
    course, up, ego_omega = velocity, np.array([0, -1.0, 0]), np.zeros(3)
    yaw_rate = omega @ up
    if T_wc is not None:
        ego = T_wc[window.frames[-2:]]
        R_cw = ego.R[1].T
        p_w, R_wv = ego.apply(reference), ego.R @ T_cv.R
        course, up = R_cw @ (p_w[1] - p_w[0]) / dt, R_cw[:, 2]
        yaw_rate = log_so3(R_wv[1] @ R_wv[0].T)[2] / dt
        ego_omega = log_so3(ego.R[0].T @ ego.R[1]) / dt
    return Motion(
        position=position,
        reference=reference[1],
        lever=reference[1] - centroid,
        velocity=velocity,
        omega=omega,
        speed=float(np.linalg.norm(course)),
        yaw_rate=float(yaw_rate),
        course=_unit(course),
        up=up,
        ego_omega=ego_omega,
        dt_s=dt,
    )


def _true_motion(truth: Truth, window: WindowEstimate, position: Array, over_ground: bool) -> Motion:
    """At the instant of the newest frame, from the true velocities and rates."""
    t = int(window.frames[-1])
    R_cw = truth.T_wc.R[t].T
    reference = truth.T_cv[t].apply(truth.reference_v)
    velocity, omega = truth.reference_velocity_c()[t], truth.relative_omega_c()[t]
    course, up, ego_omega = velocity, np.array([0, -1.0, 0]), np.zeros(3)
    yaw_rate = omega @ up
    if over_ground:
        course, up, ego_omega = R_cw @ truth.velocity_w[t], R_cw[:, 2], R_cw @ truth.ego_omega_w[t]
        yaw_rate = truth.omega_w[t, 2]
    return Motion(
        position=position,
        reference=reference,
        lever=reference - position,
        velocity=velocity,
        omega=omega,
        speed=float(np.linalg.norm(course)),
        yaw_rate=float(yaw_rate),
        course=_unit(course),
        up=up,
        ego_omega=ego_omega,
        dt_s=_interval(truth, window),
    )


def transport_jacobian(lever: Float[Array, "3"], omega: Float[Array, "3"], dt_s: float) -> Float[Array, "12 12"]:
    """Derivative of (position, rotation, velocity, rate) at a point of the body by the same at its centroid.

    With d the lever and E = exp(omega dt): ``r = c + d``, ``v_r = v_c + (I - E') d / dt`` (differences of two frames;
    omega x d for dt -> 0), and the lever turns with the body, ``delta d = delta theta x d``.
    """
    back = -omega * dt_s
    E_t = np.eye(3) + hat(back) @ left_jacobian(back)  # exp(a) = I + S(a) J(a)
    J = np.eye(12)
    J[0:3, 3:6] = -hat(lever)
    J[6:9, 3:6] = -(np.eye(3) - E_t) @ hat(lever) / dt_s
    J[6:9, 9:12] = -hat(E_t @ lever) @ left_jacobian(back)
    return J


def at_reference(cov: Float[Array, "12 12"], motion: Motion) -> Float[Array, "12 12"]:
    """Covariance of `WindowEstimate.cov` carried from the centroid to the reference point."""
    J = transport_jacobian(motion.lever, motion.omega, motion.dt_s)
    return np.asarray(J @ cov @ J.T)


def standard_deviations(cov: Float[Array, "12 12"], motion: Motion) -> dict[str, Float[Array, "k"]]:
    """Standard deviations per quantity from the covariance of the centroid's functionals; ego poses count as exact."""
    C = at_reference(cov, motion)
    speed = np.concatenate([motion.course @ hat(motion.ego_omega), np.zeros(3), motion.course, np.zeros(3)])
    yaw_rate = np.concatenate([np.zeros(9), motion.up])
    variances = {
        "position": np.diag(cov)[0:3],
        "orientation": np.diag(cov)[3:6],
        "reference_point": np.diag(C)[0:3],
        "velocity": np.diag(C)[6:9],
        "angular_rate": np.diag(C)[9:12],
        "speed": np.array([speed @ C @ speed]),
        "yaw_rate": np.array([yaw_rate @ C @ yaw_rate]),
    }
    return {quantity: np.sqrt(v) for quantity, v in variances.items()}
