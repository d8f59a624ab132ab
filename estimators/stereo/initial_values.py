"""Start values of the object's poses: from the cloud itself or from the last window, Siegemund 2008, 3.7."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from estimators.stereo.object_motion import align
from sim.pose import exp_so3, log_so3

Array = np.ndarray
Axes = Literal["unrotated", "principal_axes_xz", "principal_axes"]


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


def extrapolate(
    R: Float[Array, "2 3 3"], T: Float[Array, "2 3"], t_s: Float[Array, "2"], t_new_s: float
) -> tuple[Float[Array, "3 3"], Float[Array, "3"]]:
    """Pose at a new time from the two before it, any time steps: (3.7.10)-(3.7.12)."""
    ratio = (t_new_s - t_s[1]) / (t_s[1] - t_s[0])
    r_diff = log_so3(R[1] @ R[0].T)
    return np.asarray(exp_so3(ratio * r_diff) @ R[1]), np.asarray(T[1] + ratio * (T[1] - T[0]))
