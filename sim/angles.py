"""Attitude angles and the frames of a flight: roll-pitch-heading <-> omega-phi-kappa, boresight, lever arm.

The six systems of Kozempel 2012, 3.1, and how this project writes them:

    m   map: east, north, up. The axes of the world frame w (`sim.geodesy`), whose north is *grid* north.
    n   navigation: north, east, down. Its north is *true* north: turned against m by the meridian convergence.
    b   body, the IMU: forward, right, down.   b̄  the body with the axes of a camera: right, forward, up.
    q   his camera system c: x right, y up, z against the view. Our camera c (x right, y down, z forward) is q turned by
        180° about x; q appears in this module alone.
    i   image: mm, y up; p pixels: both in `sim.interior`.

Angles are in radians. A heading refers to true north, the world to grid north, so every function between the two asks
for the convergence (`Georeference.convergence`) and has no default for it.

At the gimbal lock (pitch or phi = ±90°) only one combination of the outer angles is determined. Heading and omega are
then arbitrary, roll and kappa are computed from them: the angles always give the rotation back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from sim.archive import freeze
from sim.pose import Pose

Array = np.ndarray

# (3.17): m <-> n at zero convergence and b <-> b̄; symmetric, its own inverse.
R_MAP_FROM_NAVIGATION = freeze(np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]))
# The source's camera q <-> ours c; its own inverse.
_FLIP = freeze(np.diag([1.0, -1.0, -1.0]))
# UTM's convergence stays below 6.1°, in radians 0.107: what is larger was given in degrees.
_GREATEST_CONVERGENCE = 0.11


def _about(axis: int, angle: ArrayLike) -> Array:
    """Rotation matrices about x, y or z (0, 1, 2)."""
    c, s = np.asarray(np.cos(angle)), np.asarray(np.sin(angle))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.zeros((*c.shape, 3, 3))
    R[..., axis, axis] = 1.0
    R[..., i, i] = R[..., j, j] = c
    R[..., i, j], R[..., j, i] = -s, s
    return R


def rotation_from_roll_pitch_heading(rph: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """R_nb = R_z(heading) R_y(pitch) R_x(roll) (Kozempel 2012, (3.13)-(3.14)).

    Heading clockwise from true north, pitch nose up, roll right side down.
    """
    rph = np.asarray(rph, float)
    return np.asarray(_about(2, rph[..., 2]) @ _about(1, rph[..., 1]) @ _about(0, rph[..., 0]))


def roll_pitch_heading(R_nb: Float[Array, "*b 3 3"]) -> Float[Array, "*b 3"]:
    """Inverse of `rotation_from_roll_pitch_heading`: pitch in [-π/2, π/2], roll and heading in [-π, π]."""
    R = np.asarray(R_nb, float)
    heading = np.arctan2(R[..., 1, 0], R[..., 0, 0])
    pitch = np.arctan2(-R[..., 2, 0], np.hypot(R[..., 0, 0], R[..., 1, 0]))
    c, s = np.cos(heading), np.sin(heading)
    roll = np.arctan2(s * R[..., 0, 2] - c * R[..., 1, 2], c * R[..., 1, 1] - s * R[..., 0, 1])
    return np.stack([roll, pitch, heading], axis=-1)


def _photogrammetric_rotation(opk: Array) -> Array:
    """R_mq = R_x(omega) R_y(phi) R_z(kappa), (3.15)-(3.16)."""
    return np.asarray(_about(0, opk[..., 0]) @ _about(1, opk[..., 1]) @ _about(2, opk[..., 2]))


def _photogrammetric_angles(R: Array) -> Array:
    """(3.20)-(3.22); kappa is taken after omega is undone, which is the same and holds at the gimbal lock too."""
    omega = np.arctan2(-R[..., 1, 2], R[..., 2, 2])
    phi = np.arctan2(R[..., 0, 2], np.hypot(R[..., 1, 2], R[..., 2, 2]))
    c, s = np.cos(omega), np.sin(omega)
    kappa = np.arctan2(c * R[..., 1, 0] + s * R[..., 2, 0], c * R[..., 1, 1] + s * R[..., 2, 1])
    return np.stack([omega, phi, kappa], axis=-1)


def rotation_from_omega_phi_kappa(opk: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """R_wc of our camera from the photogrammetric angles ``R_mq = R_x(omega) R_y(phi) R_z(kappa)`` ((3.15)-(3.16)).

    All zero: looking straight down, the top of the image to grid north; kappa turns it counter-clockwise.
    """
    return np.asarray(_photogrammetric_rotation(np.asarray(opk, float)) @ _FLIP)


def omega_phi_kappa(R_wc: Float[Array, "*b 3 3"]) -> Float[Array, "*b 3"]:
    """Inverse of `rotation_from_omega_phi_kappa` ((3.20)-(3.22)): phi in [-π/2, π/2], omega and kappa in [-π, π]."""
    return _photogrammetric_angles(np.asarray(R_wc, float) @ _FLIP)


def rotation_map_from_navigation(convergence: ArrayLike) -> Float[Array, "*b 3 3"]:
    """R_wn: (3.17) turned by the meridian convergence [rad], so that ``grid bearing = true heading - convergence``.

    Raises
        ValueError: no convergence, one that is not finite, or one beyond UTM's 6.1 degrees (degrees taken for radians).
    """
    if convergence is None:
        raise ValueError("convergence: a heading refers to true north, the grid does not; expected radians, got None")
    gamma = np.asarray(convergence, float)
    if not np.all(np.abs(gamma) <= _GREATEST_CONVERGENCE):
        worst = gamma.ravel()[np.argmax(np.nan_to_num(np.abs(gamma.ravel()), nan=np.inf))]
        raise ValueError(f"convergence: expected radians within ±{_GREATEST_CONVERGENCE}, UTM's range, got {worst}")
    return np.asarray(R_MAP_FROM_NAVIGATION @ _about(2, -gamma))


def body_rotation(rph: Float[Array, "*b 3"], convergence: ArrayLike) -> Float[Array, "*b 3 3"]:
    """R_wb of the body (forward, right, down) from roll, pitch and true heading and the convergence there [rad]."""
    return np.asarray(rotation_map_from_navigation(convergence) @ rotation_from_roll_pitch_heading(rph))


def body_angles(R_wb: Float[Array, "*b 3 3"], convergence: ArrayLike) -> Float[Array, "*b 3"]:
    """Roll, pitch and true heading [rad]: inverse of `body_rotation`."""
    R_wn = rotation_map_from_navigation(convergence)
    return roll_pitch_heading(np.swapaxes(R_wn, -1, -2) @ np.asarray(R_wb, float))


@dataclass(frozen=True, eq=False)
class Mounting:
    """How a camera sits in the body: boresight angles (omega, phi, kappa) [rad] and lever arm [m].

    The boresight matrix of (3.19) turns a point from b̄ to q, ``M = R_x(omega) R_y(phi) R_z(kappa)``. All angles zero:
    the camera looks down with the top of the image forward; kappa = -90 degrees: with the top to the left.
    ``lever_b`` is the projection centre seen from the IMU's reference point, in body axes (forward, right, down).
    """

    boresight: Float[Array, "3"]
    lever_b: Float[Array, "3"]

    def __post_init__(self) -> None:
        for name in ("boresight", "lever_b"):
            value = np.asarray(getattr(self, name), float)
            if value.shape != (3,) or not np.isfinite(value).all():
                raise ValueError(f"Mounting.{name}: expected three finite numbers, got {value.tolist()}")
            object.__setattr__(self, name, freeze(value))

    @property
    def T_bc(self) -> Pose:
        return Pose(boresight_rotation(self.boresight), self.lever_b)


def boresight_rotation(boresight: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """R_bc of our camera from the boresight angles of (3.19)."""
    M = _photogrammetric_rotation(np.asarray(boresight, float))
    return np.asarray(R_MAP_FROM_NAVIGATION @ np.swapaxes(M, -1, -2) @ _FLIP)


def boresight_angles(R_bc: Float[Array, "*b 3 3"]) -> Float[Array, "*b 3"]:
    """Boresight angles (omega, phi, kappa) [rad] of (3.19)-(3.22): inverse of `boresight_rotation`.

    From the orientation of camera and body at one exposure: ``boresight_angles(R_wb.T @ R_wc)``.
    """
    R_bc = np.asarray(R_bc, float)
    return _photogrammetric_angles(_FLIP @ np.swapaxes(R_bc, -1, -2) @ R_MAP_FROM_NAVIGATION)


def camera_pose(
    rph: Float[Array, "*b 3"], p_wb: Float[Array, "*b 3"], convergence: ArrayLike, mounting: Mounting
) -> Pose:
    """T_wc of a camera from an IMU's attitude and position: ``T_wc = T_wb(rph, p_wb, convergence) T_bc``.

    rph roll, pitch, true heading [rad]; p_wb world position of the IMU's reference point [m]; convergence there [rad].
    """
    return Pose(body_rotation(rph, convergence), p_wb) @ mounting.T_bc


def imu_from_camera_pose(
    T_wc: Pose, convergence: ArrayLike, mounting: Mounting
) -> tuple[Float[Array, "*b 3"], Float[Array, "*b 3"]]:
    """Inverse of `camera_pose`: roll, pitch, true heading [rad] and world position [m] of the IMU."""
    T_wb = T_wc @ mounting.T_bc.inv()
    return body_angles(T_wb.R, convergence), T_wb.t
