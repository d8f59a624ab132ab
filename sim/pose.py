"""Rotations SO(3) and rigid poses SE(3), batched on leading axes, Rodrigues vectors and quaternions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import SupportsIndex

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from sim.archive import freeze

Array = np.ndarray

# Below this squared angle the closed forms lose digits and the series is exact to double precision.
_SMALL = 1e-8


def hat(x: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Skew-symmetric matrix S(x) with ``S(x) y = x × y`` (Siegemund 2008, App. A)."""
    x = np.asarray(x, float)
    S = np.zeros((*x.shape[:-1], 3, 3))
    S[..., 0, 1], S[..., 0, 2], S[..., 1, 2] = -x[..., 2], x[..., 1], -x[..., 0]
    S[..., 1, 0], S[..., 2, 0], S[..., 2, 1] = x[..., 2], -x[..., 1], x[..., 0]
    return S


def _sinc_terms(r: Array) -> tuple[Array, Array, Array]:
    """sin(a)/a, (1 - cos a)/a², (a - sin a)/a³ for the angle a = |r|, by series near zero."""
    a2 = np.sum(r * r, axis=-1)
    small = a2 < _SMALL
    safe = np.where(small, 1.0, a2)
    a = np.sqrt(safe)
    s = np.where(small, 1 - a2 / 6, np.sin(a) / a)
    c = np.where(small, 0.5 - a2 / 24, 2 * np.sin(a / 2) ** 2 / safe)
    d = np.where(small, 1 / 6 - a2 / 120, (a - np.sin(a)) / (safe * a))
    return s, c, d


def exp_so3(r: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Rotation matrix of the rotation vector r [rad]: axis r/|r|, angle |r|."""
    r = np.asarray(r, float)
    s, c, _ = _sinc_terms(r)
    S = hat(r)
    return np.asarray(np.eye(3) + s[..., None, None] * S + c[..., None, None] * (S @ S))


def log_so3(R: Float[Array, "*b 3 3"]) -> Float[Array, "*b 3"]:
    """Rotation vector [rad] of a rotation matrix, angle in [0, π]."""
    R = np.asarray(R, float)
    flat = R.reshape(-1, 3, 3)
    r = Rotation.from_matrix(flat, assume_valid=True).as_rotvec() if len(flat) else np.zeros((0, 3))
    return r.reshape(R.shape[:-1])


def left_jacobian(r: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """J(r) with ``exp(r + d) ≈ exp(J(r) d) exp(r)`` for small d."""
    r = np.asarray(r, float)
    _, c, d = _sinc_terms(r)
    S = hat(r)
    return np.asarray(np.eye(3) + c[..., None, None] * S + d[..., None, None] * (S @ S))


@dataclass(frozen=True, eq=False)
class Pose:
    """Rigid transformation ``y = R x + t``; R (..., 3, 3), t (..., 3) in metres, same leading axes."""

    R: Float[Array, "*b 3 3"]
    t: Float[Array, "*b 3"]

    def __post_init__(self) -> None:
        R, t = np.asarray(self.R, float), np.asarray(self.t, float)
        if R.shape[-2:] != (3, 3) or t.shape[-1:] != (3,):
            raise ValueError(f"Pose: expected R (..., 3, 3) and t (..., 3), got {R.shape} and {t.shape}")
        batch = np.broadcast_shapes(R.shape[:-2], t.shape[:-1])
        object.__setattr__(self, "R", freeze(np.broadcast_to(R, (*batch, 3, 3))))
        object.__setattr__(self, "t", freeze(np.broadcast_to(t, (*batch, 3))))

    @staticmethod
    def identity(batch: tuple[int, ...] = ()) -> Pose:
        return Pose(np.broadcast_to(np.eye(3), (*batch, 3, 3)), np.zeros((*batch, 3)))

    @staticmethod
    def exp(xi: Float[Array, "*b 6"]) -> Pose:
        """SE(3) exponential of ``(rotation, translation)``."""
        xi = np.asarray(xi, float)
        r = xi[..., :3]
        return Pose(exp_so3(r), (left_jacobian(r) @ xi[..., 3:, None])[..., 0])

    def log(self) -> Float[Array, "*b 6"]:
        r = log_so3(self.R)
        return np.concatenate([r, np.linalg.solve(left_jacobian(r), self.t[..., None])[..., 0]], axis=-1)

    def inv(self) -> Pose:
        Rt = np.swapaxes(self.R, -1, -2)
        return Pose(Rt, -(Rt @ self.t[..., None])[..., 0])

    def apply(self, x: Float[Array, "*c 3"]) -> Float[Array, "*d 3"]:
        """Transformed points; the batch axes of pose and points broadcast."""
        return np.asarray((self.R @ np.asarray(x, float)[..., None])[..., 0] + self.t)

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(self.R @ other.R, (self.R @ other.t[..., None])[..., 0] + self.t)

    def __getitem__(self, index: SupportsIndex | slice | Array) -> Pose:
        """Pose(s) at an index of the first batch axis."""
        if self.t.ndim == 1:
            raise IndexError("a single Pose has no batch axis to index")
        return Pose(self.R[index], self.t[index])

    def __len__(self) -> int:
        return int(self.t.shape[0])

    @staticmethod
    def stack(poses: Sequence[Pose]) -> Pose:
        return Pose(np.stack([p.R for p in poses]), np.stack([p.t for p in poses]))

    def matrix(self) -> Float[Array, "*b 4 4"]:
        M = np.zeros((*self.t.shape[:-1], 4, 4))
        M[..., :3, :3], M[..., :3, 3], M[..., 3, 3] = self.R, self.t, 1.0
        return M


# World (x right, y forward, z up) from a level camera looking forward (x right, y down, z forward).
R_WORLD_FROM_LEVEL_CAMERA = freeze(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))


def rot_z(angle: ArrayLike) -> Float[Array, "*b 3 3"]:
    """Rotation about z by the angle [rad], counter-clockwise."""
    a = np.asarray(angle, float)
    return exp_so3(np.stack([np.zeros_like(a), np.zeros_like(a), a], axis=-1))


def vehicle_rotation(heading: ArrayLike) -> Float[Array, "*b 3 3"]:
    """R_wv of a level vehicle (x forward, y left, z up) with the heading [rad], clockwise from world +y."""
    return rot_z(np.pi / 2 - np.asarray(heading, float))


def heading_of(R_wv: Float[Array, "*b 3 3"]) -> Float[Array, "*b"]:
    """Heading [rad] of a vehicle's forward axis, clockwise from world +y, in (-π, π]."""
    return np.asarray(np.arctan2(R_wv[..., 0, 0], R_wv[..., 1, 0]))


def interpolate(a: Pose, b: Pose, fraction: ArrayLike) -> Pose:
    """Geodesic rotation and linear translation from a (0) to b (1)."""
    f = np.asarray(fraction, float)[..., None]
    return Pose(a.R @ exp_so3(f * log_so3(np.swapaxes(a.R, -1, -2) @ b.R)), a.t + f * (b.t - a.t))


def rodrigues_from_rotation(R: Float[Array, "*b 3 3"]) -> Float[Array, "*b 3"]:
    """Rodrigues vector ``2 tan(angle/2) axis`` (McGlone 2004, 2.1.2); infinite at 180°."""
    r = log_so3(R)
    a = np.linalg.norm(r, axis=-1, keepdims=True)
    factor = np.where(a < 1e-4, 1 + a * a / 12, 2 * np.tan(a / 2) / np.where(a < 1e-4, 1, a))
    return np.asarray(r * factor)


def rotation_from_rodrigues(m: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Inverse of `rodrigues_from_rotation`."""
    m = np.asarray(m, float)
    half = np.linalg.norm(m, axis=-1, keepdims=True) / 2
    factor = np.where(half < 1e-4, 1 - half * half / 3, np.arctan(half) / np.where(half < 1e-4, 1, half))
    return exp_so3(m * factor)


def quaternion_from_rotation(R: Float[Array, "*b 3 3"]) -> Float[Array, "*b 4"]:
    """Unit quaternion (w, x, y, z) with w >= 0."""
    R = np.asarray(R, float)
    q = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat(canonical=True, scalar_first=True)
    return q.reshape(*R.shape[:-2], 4)


def rotation_from_quaternion(q: Float[Array, "*b 4"]) -> Float[Array, "*b 3 3"]:
    """Rotation matrix of a quaternion (w, x, y, z), normalised first."""
    q = np.asarray(q, float)
    return Rotation.from_quat(q.reshape(-1, 4), scalar_first=True).as_matrix().reshape(*q.shape[:-1], 3, 3)
