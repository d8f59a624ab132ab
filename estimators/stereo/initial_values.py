"""Start values of the object's poses and points: from the cloud or from the last window, Siegemund 2008, 3.7."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from estimators.gauss_markov import sum_by
from estimators.stereo.kernel import extrapolated
from estimators.stereo.object_motion import Problem, align
from sim.pose import exp_so3

Array = np.ndarray
Axes = Literal["unrotated", "principal_axes_xz", "principal_axes"]
Average = Literal["mean", "median"]


def from_cloud(
    frame: Int[Array, "k"], l: Float[Array, "k 3"], m: int, axes: Axes = "principal_axes_xz"
) -> tuple[Float[Array, "m 3 3"], Float[Array, "m 3"]]:
    """Centroid (3.7.1) and principal axes (3.7.2)-(3.7.6) of the cloud of every frame.

    "unrotated" takes the centroid alone (ours): where noise in depth shapes the cloud its axes say little.
    "principal_axes_xz" takes the axes of the cloud projected into the camera's XZ plane, e_y fixed. The source adapts
    the signs to the frame before; we also let the two axes of the plane change places, which they do where the cloud is
    nearly round.
    """
    R, T = np.empty((m, 3, 3)), np.empty((m, 3))
    for t in range(m):
        cloud = l[frame == t]
        T[t] = cloud.mean(axis=0)
        d = cloud - T[t]
        before = R[t - 1] if t else np.eye(3)
        R[t] = _AXES[axes](d, before)
    return R, T


def _axes_xz(d: Array, before: Array) -> Array:
    angle = 0.5 * np.arctan2(2 * np.sum(d[:, 0] * d[:, 2]), np.sum(d[:, 0] ** 2) - np.sum(d[:, 2] ** 2))
    candidates = exp_so3(np.outer(-angle + np.pi / 2 * np.arange(4), [0.0, 1.0, 0.0]))
    return np.asarray(candidates[np.argmax(np.einsum("cab,ab->c", candidates, before))])


def _axes_3d(d: Array, before: Array) -> Array:
    _, vectors = np.linalg.eigh(d.T @ d)
    e_x, e_y = vectors[:, 2], vectors[:, 1]
    e_x = e_x * (1.0 if e_x @ before[:, 0] >= 0 else -1.0)
    e_y = e_y * (1.0 if e_y @ before[:, 1] >= 0 else -1.0)
    return np.stack([e_x, e_y, np.cross(e_x, e_y)], axis=1)


_AXES = {"unrotated": lambda _, before: before, "principal_axes_xz": _axes_xz, "principal_axes": _axes_3d}


def from_alignment(
    frame: Int[Array, "k"], point: Int[Array, "k"], l: Float[Array, "k 3"], m: int
) -> tuple[Float[Array, "m 3 3"], Float[Array, "m 3"]]:
    """Poses by laying every frame's cloud on the one before, over the points both have (ours, where much is turned)."""
    R, T = np.empty((m, 3, 3)), np.empty((m, 3))
    R[0], T[0] = np.eye(3), l[frame == 0].mean(axis=0)
    for t in range(1, m):
        before, now = np.flatnonzero(frame == t - 1), np.flatnonzero(frame == t)
        _, i, j = np.intersect1d(point[before], point[now], return_indices=True)
        if len(i) < 3:
            R[t], T[t] = R[t - 1], l[now].mean(axis=0)
            continue
        Q, shift = align(l[before[i]], l[now[j]])
        R[t], T[t] = Q @ R[t - 1], Q @ T[t - 1] + shift
    return R, T


def from_turn(
    frame: Int[Array, "k"], l: Float[Array, "k 3"], t_s: Float[Array, "m"], yaw_rate: float
) -> tuple[Float[Array, "m 3 3"], Float[Array, "m 3"]]:
    """Centroid (3.7.1) and a constant yaw rate [rad/s] about the camera's vertical, positive to the left (ours).

    Where depth is noisy, a turn too small to show in the axes of the cloud is easily taken for none, a local minimum;
    started from a turn to the right side the adjustment finds it.
    """
    _, T = from_cloud(frame, l, len(t_s), "unrotated")
    return exp_so3(np.multiply.outer(yaw_rate * (t_s - t_s[-1]), [0.0, -1.0, 0.0])), T


def from_shared_tracks(
    frame: Int[Array, "k"], point: Int[Array, "k"], l: Float[Array, "k 3"], m: int
) -> tuple[Float[Array, "m 3 3"], Float[Array, "m 3"]]:
    """Unrotated, the centroid carried by the tracks that frames share: least squares of l_it = T_t + X_i (ours).

    The centroids (3.7.1) of each frame's own points jump where tracks come and go; these do not. The points' mean is
    the origin. Frames that share no track with the others, even by way of others, are near all points' mean.
    """
    n = int(point.max()) + 1
    seen = np.zeros((m, n))
    seen[frame, point] = 1
    share = seen / seen.sum(axis=0)
    mean = l.mean(axis=0)
    d = l - mean
    b = sum_by(frame, d - (sum_by(point, d, n) / seen.sum(axis=0)[:, None])[point], m)
    T = np.linalg.lstsq(np.diag(seen.sum(axis=1)) - share @ seen.T, b)[0]
    X = sum_by(point, d - T[frame], n) / seen.sum(axis=0)[:, None]
    return np.broadcast_to(np.eye(3), (m, 3, 3)).copy(), T + mean + X.mean(axis=0)


def points_from_cloud(
    frame: Int[Array, "k"],
    point: Int[Array, "k"],
    l: Float[Array, "k 3"],
    R: Float[Array, "m 3 3"],
    T: Float[Array, "m 3"],
    n: int,
    average: Average,
) -> Float[Array, "n 3"]:
    """Mean or, robust against outliers, median by coordinates of each point's places in the object frame (3.7.13)."""
    Y = np.einsum("kba,kb->ka", R[frame], l - T[frame])
    count = np.bincount(point, minlength=n)
    if average == "mean":
        return np.asarray(sum_by(point, Y, n) / count[:, None])
    start = np.cumsum(count) - count
    X = np.empty((n, 3))
    for a in range(3):
        y = Y[np.lexsort((Y[:, a], point)), a]
        X[:, a] = (y[start + (count - 1) // 2] + y[start + count // 2]) / 2
    return X


def points_by_mean(problem: Problem, R: Float[Array, "m 3 3"], T: Float[Array, "m 3"]) -> Float[Array, "n 3"]:
    """Start values of a problem's points: means of the cloud."""
    return points_from_cloud(problem.frame, problem.point, problem.l, R, T, problem.n, "mean")


def propagated_points(
    track: Int[Array, "n"],
    X: Float[Array, "n 3"],
    known_track: Int[Array, "p"],
    known_X: Float[Array, "p 3"],
) -> Float[Array, "n 3"]:
    """The last window's points where it knew the track (3.7.14), else those given, as from the cloud."""
    _, new, old = np.intersect1d(track, known_track, assume_unique=True, return_indices=True)
    X = X.copy()
    X[new] = known_X[old]
    return X


def has_drifted(X_o: Float[Array, "n 3"], extent_m: float) -> bool:
    """Whether the origin of the object frame is farther from the cloud than the object's extent allows (3.7.1.3).

    Then frame and object have lost each other, and the next start values are to come from the cloud. extent_m: the
    object's longest diagonal. The median distance is asked, that a few outliers neither cause nor hide it.
    """
    return bool(np.median(np.linalg.norm(X_o, axis=1)) > extent_m)


def propagated_poses(
    known_frames: Int[Array, "p"],
    R: Float[Array, "p 3 3"],
    T: Float[Array, "p 3"],
    frames: Int[Array, "m"],
    t_s: Float[Array, "m"],
) -> tuple[Float[Array, "m 3 3"], Float[Array, "m 3"]] | None:
    """Poses of the last window's frames, (3.7.7)-(3.7.9), the newest frame extrapolated to its time in t_s.

    None where the last window lacks more than the newest frame.
    """
    known, old, new = np.intersect1d(known_frames, frames, return_indices=True)
    if len(known) < 2 or len(frames) - len(known) > 1:
        return None
    R_new, T_new = np.empty((len(frames), 3, 3)), np.empty((len(frames), 3))
    R_new[new], T_new[new] = R[old], T[old]
    if len(known) < len(frames):
        R_new[-1], T_new[-1] = extrapolate(R[old[-2:]], T[old[-2:]], t_s[new[-2:]], float(t_s[-1]))
    return R_new, T_new


def extrapolate(
    R: Float[Array, "2 3 3"], T: Float[Array, "2 3"], t_s: Float[Array, "2"], t_new_s: float
) -> tuple[Float[Array, "3 3"], Float[Array, "3"]]:
    """Pose at a new time from the two before it, any time steps: (3.7.10)-(3.7.12)."""
    ratio = float((t_new_s - t_s[1]) / (t_s[1] - t_s[0]))
    R_new, T_new = extrapolated(np.ascontiguousarray(R), np.ascontiguousarray(T), ratio)
    return R_new, T_new
