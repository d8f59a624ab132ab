"""Object points as states of the vehicle filter: measured in both images, born with a track, dropped with it.

    z = project(T_cw T_wo X) + noise,    dz/d(rotation, position, X) = J R_co [ -S(X)  I  I ]

with the Jacobian J of the projection. A new track's point is X = T_wo^-1 l of its triangulated observation l; with

    dX = R_co' dl + S(X) d_rotation - d_position

it is correlated with the pose and says nothing yet of the motion.

A match is right or wrong as a whole: the gate asks for all four coordinates of a point at once, with the probability
that one coordinate has inside so many sigmas. Where more than half of the points would be gated it is the predicted
motion that is wrong, and all are used. A gated track's point is born again where it is seen now; ``support`` counts
down to -1 and its track stays among the rejected ones until further observations agree (1 or more), among the used ones
with 2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import chi2

from estimators.kalman import Form
from estimators.stereo.filter_state import MOTION, State, error_rows, reset
from sim.camera import StereoRig
from sim.pose import Pose, hat

Array = np.ndarray
REJECTED, USED = 0, 2  # support up to which a track is rejected, from which it is used
# Beyond this share of the points the gate is not the judge of points.
_MOST = 0.5


@dataclass(frozen=True, eq=False)
class Seen:
    """Observations of one frame: tracks (k,) ascending, uv (k, 4) [px] with covariance R (k, 4, 4), triangulated points
    l (k, 3) [m] with covariance C (k, 3, 3) in the left camera frame, whose pose is T_wc."""

    rig: StereoRig
    T_wc: Pose
    track: Int[Array, "k"]
    uv: Float[Array, "k 4"]
    R: Float[Array, "k 4 4"]
    l: Float[Array, "k 3"]
    C: Float[Array, "k 3 3"]


@dataclass(frozen=True, eq=False)
class Corrected:
    """State and covariance after the measurements, innovation squared nis with its degrees of freedom, and which of the
    state's points were gated."""

    state: State
    F: Array
    nis: float
    dof: int
    gated: Bool[Array, "n"]


def correct(form: Form, state: State, F: Array, seen: Seen, gate_sigma: float) -> Corrected:
    """Corrects by the image points of the state's tracks."""
    _, i, k = np.intersect1d(state.track, seen.track, assume_unique=True, return_indices=True)
    pose, point, dz = innovation(state.X[i], state.T, seen, k)
    inside = np.isfinite(dz).all(axis=1)
    gated = np.zeros(len(state.X), bool)
    gated[i[~inside]] = True
    if np.isfinite(gate_sigma):
        beyond = inside & (_distance(form.covariance(F), i, pose, point, dz, seen.R[k]) > _limit(gate_sigma))
        if beyond.sum() <= _MOST * inside.sum():
            gated[i[beyond]], inside = True, inside & ~beyond
    i, k, pose, point, dz = i[inside], k[inside], pose[inside], point[inside], dz[inside]
    H = np.zeros((len(i), 4, len(state)))
    H[:, :, :6] = pose
    for a in range(3):
        H[np.arange(len(i)), :, MOTION + 3 * i + a] = point[:, :, a]
    c = form.correct(np.zeros(len(state)), F, H.reshape(-1, len(state)), dz.ravel(), seen.R[k])
    F = form.predict(c.F, reset(c.x), np.zeros((len(state), 1)), np.zeros(1))
    support = state.support.copy()
    support[i] += 1
    return Corrected(replace(state.plus(c.x), support=support), F, float(c.nis), dz.size, gated)


def innovation(X: Array, T_wo: Pose, seen: Seen, k: Array) -> tuple[Array, Array, Array]:
    """Derivatives by the pose (k, 4, 6) and by the point (k, 4, 3), and the innovation (k, 4), NaN behind a camera."""
    T_co = seen.T_wc.inv() @ T_wo
    y = T_co.apply(X)
    point = seen.rig.project_jacobian(y) @ T_co.R
    return np.concatenate([-point @ hat(X), point], axis=2), point, seen.uv[k] - seen.rig.project(y)


def _distance(P: Array, i: Array, pose: Array, point: Array, dz: Array, R: Array) -> Array:
    """Squared Mahalanobis distance of each point's innovation."""
    at = MOTION + 3 * i[:, None] + np.arange(3)
    joint = np.empty((len(i), 9, 9))
    joint[:, :6, :6] = P[:6, :6]
    joint[:, 6:, 6:] = P[at[:, :, None], at[:, None, :]]
    joint[:, 6:, :6] = P[at, :6]
    joint[:, :6, 6:] = np.swapaxes(joint[:, 6:, :6], 1, 2)
    h = np.concatenate([pose, point], axis=2)
    S = h @ joint @ np.swapaxes(h, 1, 2) + R
    return np.asarray(np.sum(dz * np.linalg.solve(S, np.nan_to_num(dz)[..., None])[..., 0], axis=1))


def _limit(gate_sigma: float) -> float:
    return float(chi2.isf(chi2.sf(gate_sigma**2, 1), 4))


def without_points(form: Form, state: State, F: Array, kept: Int[Array, "s"]) -> tuple[State, Array]:
    """State and covariance of some of the points (indices)."""
    if len(kept) == len(state.X):
        return state, F
    rows = error_rows(kept)
    return state.select(kept), form.start(form.covariance(F)[np.ix_(rows, rows)])


def with_points(
    form: Form, state: State, F: Array, seen: Seen, k: Int[Array, "b"], support: Int[Array, "b"]
) -> tuple[State, Array]:
    """State and covariance with new points, those of the observations k of a frame."""
    if not len(k):
        return state, F
    T_oc = state.T.inv() @ seen.T_wc
    X = T_oc.apply(seen.l[k])
    P = form.covariance(F)
    n, b = len(state), 3 * len(k)
    J = np.concatenate([hat(X), np.broadcast_to(-np.eye(3), (len(k), 3, 3))], axis=2).reshape(b, 6)
    grown = np.empty((n + b, n + b))
    grown[:n, :n] = P
    grown[n:, :n] = J @ P[:6]
    grown[:n, n:] = grown[n:, :n].T
    grown[n:, n:] = J @ P[:6, :6] @ J.T
    own = n + 3 * np.arange(len(k))[:, None] + np.arange(3)
    grown[own[:, :, None], own[:, None, :]] += T_oc.R @ seen.C[k] @ T_oc.R.T
    born = State(
        state.T,
        state.twist,
        np.concatenate([state.X, X]),
        np.concatenate([state.track, seen.track[k]]),
        np.concatenate([state.support, support]),
    )
    return born, form.start((grown + grown.T) / 2)
