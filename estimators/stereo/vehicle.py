"""What adjusted windows say of a vehicle: driving direction, motion, place and shape, Siegemund 2008, 3.8.

Frames beside those of `sim`: f on the vehicle (F of the source) and e on our own (its W), both x left, y up, z forward.
The origin of f is that of the object frame, as in the source (^F T_O = 0); that of e is the left camera where nothing
is known of its mounting. Without ego poses the camera counts as level and standing, and all is relative to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from estimators.estimate import Interpretation, VehicleMotion, WindowEstimate
from estimators.stereo.datum import carried_frame
from estimators.stereo.windows import MIN_POINTS
from sim.pose import R_WORLD_FROM_LEVEL_CAMERA, Pose, exp_so3, left_jacobian, log_so3

Array = np.ndarray

# 99 % of the chi-square distribution with two degrees of freedom: below it a horizontal velocity may be none.
_MOVES = -2 * np.log(0.01)


def level_camera(m: int) -> Pose:
    """Poses (m,) of a level camera that looks along +y and stands."""
    return Pose(np.broadcast_to(R_WORLD_FROM_LEVEL_CAMERA, (m, 3, 3)), np.zeros((m, 3)))


def interpret(windows: Sequence[WindowEstimate], t_s: Float[Array, "m"], T_wc: Pose | None) -> Interpretation:
    """Motion and orientation of the vehicle in every window, over ground where ego poses T_wc (m,) are observed.

    It is taken to drive forwards (3.8.1); ego poses count as exact. Motion is that of the centroid of the window's
    points by differences of two frames (3.8.5)-(3.8.7): the last two of the window, or its newest and that of the
    window before. For the latter this one's object frame is laid on that of the window before by the frames and tracks
    both have, so that a datum chosen anew is no motion (3.7.1.3); NaN where they have no frame or fewer than three
    tracks in common.
    """
    ego = level_camera(len(t_s)) if T_wc is None else T_wc
    last = np.array([w.frames[-2:] for w in windows], int).reshape(-1, 2)
    R_co = np.array([w.T_co.R[-2:] for w in windows]).reshape(-1, 2, 3, 3)
    T_wo = ego[last] @ Pose(R_co, np.array([w.T_co.t[-2:] for w in windows]).reshape(-1, 2, 3))
    centre = np.array([w.X_o.mean(axis=0) for w in windows]).reshape(-1, 3)
    dt = t_s[last[:, 1]] - t_s[last[:, 0]]
    velocity, omega = _differences(T_wo, centre, dt)
    J = ground_jacobian(ego.R[last], log_so3(R_co[:, 1] @ _transposed(R_co[:, 0])), dt)
    cov = J @ np.array([w.cov for w in windows]).reshape(-1, 12, 12) @ _transposed(J)
    moves = _moves(velocity, cov)
    heading = _heading(velocity, moves)
    links = [_link(a, b) for a, b in pairwise(windows)]
    across_velocity, across_omega = _across(Pose(T_wo.R[:, 1], T_wo.t[:, 1]), links, centre, t_s[last[:, 1]])
    R_of_now = _transposed(T_wo.R[:, 1]) @ vehicle_axes(heading)
    return Interpretation(
        frame=last[:, 1],
        within=VehicleMotion(velocity, omega, heading),
        across=VehicleMotion(across_velocity, across_omega, _heading(across_velocity, moves)),
        cov=cov,
        R_of=_carried(R_of_now, links),
        R_of_now=R_of_now,
        over_ground=T_wc is not None,
    )


def _transposed(A: Array) -> Array:
    return np.swapaxes(A, -1, -2)


def _differences(T_wo: Pose, centre: Array, dt: Array) -> tuple[Array, Array]:
    """Velocity of the centroid [m/s] and angular rate [rad/s] between two poses each, T_wo (k, 2)."""
    p = T_wo.apply(centre[:, None])
    turn = log_so3(T_wo.R[:, 1] @ _transposed(T_wo.R[:, 0]))
    return (p[:, 1] - p[:, 0]) / dt[:, None], turn / dt[:, None]


def ground_jacobian(
    R_wc: Float[Array, "k 2 3 3"], turn: Float[Array, "k 3"], dt: Float[Array, "k"]
) -> Float[Array, "k 6 12"]:
    """Derivative of velocity and rate in w by the functionals of `WindowEstimate.cov`.

    R_wc: ego rotations at the last two frames; turn: rotation vector of the object between them, in camera axes.
    With c, v and r those functionals: v_w = ((R_1 - R_0) c + t_1 - t_0) / dt + R_0 v and
    exp(omega_w dt) = R_1 exp(r dt) R_0'.
    """
    old, new = R_wc[:, 0], R_wc[:, 1]
    turn_w = log_so3(new @ exp_so3(turn) @ _transposed(old))
    J = np.zeros((len(dt), 6, 12))
    J[:, :3, :3] = (new - old) / dt[:, None, None]
    J[:, :3, 6:9] = old
    J[:, 3:, 9:] = np.linalg.solve(left_jacobian(turn_w), new @ left_jacobian(turn))
    return J


def standard_deviations(said: Interpretation) -> tuple[Float[Array, "k"], Float[Array, "k"], Float[Array, "k"]]:
    """Of speed, heading and yaw rate within the windows, linear; NaN where there is no direction."""
    v = np.where(np.isfinite(said.within.heading)[:, None], said.within.velocity, np.nan)
    along = v / np.linalg.norm(v, axis=1)[:, None]
    aside = np.stack([v[:, 1], -v[:, 0], 0 * v[:, 0]], axis=1) / np.sum(v[:, :2] ** 2, axis=1)[:, None]
    variances = [np.einsum("ka,kab,kb->k", d, said.cov[:, :3, :3], d) for d in (along, aside)]
    return np.sqrt(variances[0]), np.sqrt(variances[1]), np.sqrt(said.cov[:, 5, 5])


def _moves(velocity: Array, cov: Array) -> Array:
    """Whether the horizontal velocity is none with a probability of less than 1 %."""
    v = velocity[:, :2, None]
    return np.asarray((_transposed(v) @ np.linalg.solve(cov[:, :2, :2], v))[:, 0, 0] > _MOVES)


def _heading(velocity: Array, moves: Array) -> Array:
    return np.where(moves, np.arctan2(velocity[:, 0], velocity[:, 1]), np.nan)


def _link(before: WindowEstimate, window: WindowEstimate) -> Pose | None:
    """Object frame of the window before from this one's; None where they share too little."""
    _, old, new = np.intersect1d(before.frames, window.frames, assume_unique=True, return_indices=True)
    _, known, still = np.intersect1d(before.track, window.track, assume_unique=True, return_indices=True)
    if len(new) == 0 or len(still) < MIN_POINTS:
        return None
    return Pose(*carried_frame(before.T_co.R[old], window.T_co.R[new], before.X_o[known], window.X_o[still]))


def _across(T_wo: Pose, links: list[Pose | None], centre: Array, t_s: Array) -> tuple[Array, Array]:
    """Motion between the newest frames, T_wo (k,) at t_s (k,), of consecutive windows."""
    velocity, omega = np.full((len(t_s), 3), np.nan), np.full((len(t_s), 3), np.nan)
    linked = [(k, link) for k, link in enumerate(links, start=1) if link is not None]
    if linked:
        k = np.array([i for i, _ in linked])
        before = T_wo[k - 1] @ Pose.stack([link for _, link in linked])
        pair = Pose(np.stack([before.R, T_wo.R[k]], axis=1), np.stack([before.t, T_wo.t[k]], axis=1))
        velocity[k], omega[k] = _differences(pair, centre[k], t_s[k] - t_s[k - 1])
    return velocity, omega


def _carried(R_of_now: Array, links: list[Pose | None]) -> Array:
    """Orientation of f in o from the first window that knows it, carried on from window to window."""
    R_of = R_of_now.copy()
    for k, link in enumerate(links, start=1):
        if link is not None and np.isfinite(R_of[k - 1]).all():
            R_of[k] = link.R.T @ R_of[k - 1]
    return R_of


def vehicle_axes(heading: Float[Array, "*k"]) -> Float[Array, "*k 3 3"]:
    """R_wf of the heading [rad], clockwise from +y: z along it, y up, x = y x z to the left (3.8.1)."""
    s, c, zero = np.sin(heading), np.cos(heading), 0 * heading
    return np.stack([np.stack(row, axis=-1) for row in ((-c, zero, s), (s, zero, c), (zero, zero + 1, zero))], axis=-2)


def levelled(T_wc: Pose) -> Pose:
    """T_ec (m,): the left camera in the frame e at its place, y up, z forward along the camera's axis.

    Where the mounting of the camera is known, that is to be used instead.
    """
    forward = T_wc.R[..., 2]
    R_we = vehicle_axes(np.arctan2(forward[..., 0], forward[..., 1]))
    return Pose(_transposed(R_we) @ T_wc.R, np.zeros_like(T_wc.t))


def pose_in_ego(window: WindowEstimate, R_of: Float[Array, "3 3"], T_ec: Pose) -> Pose:
    """T_ef of the vehicle at the newest frame: the inverse of ^F M_W, (3.8.4). T_ec: the camera in e at that frame."""
    return T_ec @ window.T_co[-1] @ Pose(R_of, np.zeros(3))


def shape(window: WindowEstimate, R_of: Float[Array, "3 3"]) -> Float[Array, "n 3"]:
    """The adjusted points in f: what the camera sees of the vehicle's surface (3.8.3)."""
    return np.asarray(window.X_o @ R_of)
