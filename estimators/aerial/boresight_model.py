"""What navigation says of the exposures, and how it binds the camera poses to boresight, lever arm and offsets.

    R_wc = R_wb R_bc,   t_wc = p_wb + R_wb lever_b          (3.19), Kozempel 2012

The navigation gives R_wb and p_wb at the trigger times, with errors of every image and, where asked for, two that are
common to all: a time offset dt (the exposures come dt after the time tag) and a GNSS offset g:

    R_wb = R_obs exp(omega_b dt) exp(noise),   p_wb = p_obs + v_w dt - g + noise
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from sim.angles import (
    Mounting,
    body_rotation,
    boresight_angles,
    boresight_rotation,
    roll_pitch_heading,
    rotation_map_from_navigation,
)
from sim.archive import freeze_fields
from sim.geodesy import Georeference
from sim.navigation import NavigationSolution
from sim.pose import Pose, exp_so3, hat, interpolate, left_jacobian, log_so3

Array = np.ndarray
# Attitudes this far apart give the rates of a solution that has none: over less, their white noise rules.
_RATE_SPAN_S = 0.1
Extra = Literal["lever", "time_offset", "gnss_offset"]
# Order, names and widths of the common unknowns. Rotations about body axes: forward (roll), right (pitch), down (yaw).
_NAMES: dict[str, tuple[str, ...]] = {
    "boresight": ("roll", "pitch", "yaw"),
    "lever": ("lever_forward", "lever_right", "lever_down"),
    "time_offset": ("time_offset",),
    "gnss_offset": ("gnss_east", "gnss_north", "gnss_up"),
}
GNSS_COLUMNS = (7, 8, 9)


@dataclass(frozen=True, eq=False)
class Navigation:
    """Post-processed navigation (the source's SBET records): attitude and position with velocity and rate.

    t_s (n,) increasing; T_wb (n,) of the IMU (body: forward, right, down) in the world, the meridian convergence
    applied (`sim.angles.body_rotation`); velocity_w (n, 3) [m/s]; rate_b (n, 3) [rad/s]. Stated sigmas of every record:
    sigma_rph (3,) of roll, pitch, heading [rad], sigma_position_m (3,) east, north, up. constant_share is the share of
    their variances that is the same in all records (alignment, reference station): no number of images averages it.
    vibration [rad] is the camera's own turning about each axis, anew in every record and unseen by the IMU.

    Raises
        ValueError: times that do not increase, sigmas that are not positive, a share outside [0, 1), vibration < 0.
    """

    t_s: Float[Array, "n"]
    T_wb: Pose
    velocity_w: Float[Array, "n 3"]
    rate_b: Float[Array, "n 3"]
    sigma_rph: Float[Array, "3"]
    sigma_position_m: Float[Array, "3"]
    constant_share: float = 0.0
    vibration: float = 0.0

    def __post_init__(self) -> None:
        freeze_fields(self)
        if not np.all(np.diff(self.t_s) > 0):
            raise ValueError("Navigation.t_s: expected strictly increasing times")
        for name in ("sigma_rph", "sigma_position_m"):
            if not np.all(getattr(self, name) > 0):
                raise ValueError(f"Navigation.{name}: expected > 0, got {getattr(self, name).tolist()}")
        if not 0 <= self.constant_share < 1:
            raise ValueError(f"Navigation.constant_share: expected [0, 1), got {self.constant_share}")
        if not self.vibration >= 0:
            raise ValueError(f"Navigation.vibration: expected >= 0, got {self.vibration}")

    def __len__(self) -> int:
        return len(self.t_s)

    @staticmethod
    def from_solution(solution: NavigationSolution, reference: Georeference, constant_share: float = 0.0) -> Navigation:
        """A post-processed solution in the world frame; rates by differences of attitude over a tenth of a second."""
        p_w = reference.from_crs(solution.geographic)
        convergence = reference.convergence(p_w)
        R_wb = body_rotation(solution.rph, convergence)
        velocity_w = (rotation_map_from_navigation(convergence) @ solution.velocity_ned[..., None])[..., 0]
        t, last = solution.t_s, len(solution) - 1
        span = max(1, round(_RATE_SPAN_S / 2 / float(np.median(np.diff(t))))) if last else 0
        a, b = np.clip(np.arange(last + 1) - span, 0, last), np.clip(np.arange(last + 1) + span, 0, last)
        rate_b = log_so3(np.swapaxes(R_wb[a], 1, 2) @ R_wb[b]) / np.maximum(t[b] - t[a], 1e-9)[:, None]
        sigmas = solution.sigma_rph, solution.sigma_position
        return Navigation(t, Pose(R_wb, p_w), velocity_w, rate_b, *sigmas, constant_share)

    def pose(self, t_s: ArrayLike) -> Pose:
        """T_wb at any times, between neighbouring records.

        Raises
            ValueError: a time outside the records.
        """
        row, fraction = self._between(np.asarray(t_s, float))
        return interpolate(self.T_wb[row], self.T_wb[row + 1], fraction)

    def at(self, t_s: Float[Array, "m"]) -> Navigation:
        """Navigation at the (increasing) times of the exposures."""
        row, fraction = self._between(t_s)
        f = fraction[:, None]
        v, w = ((1 - f) * a[row] + f * a[row + 1] for a in (self.velocity_w, self.rate_b))
        return replace(self, t_s=t_s, T_wb=self.pose(t_s), velocity_w=v, rate_b=w)

    def _between(self, t: Array) -> tuple[Array, Array]:
        if len(self) < 2 or not np.all((t >= self.t_s[0]) & (t <= self.t_s[-1])):
            raise ValueError(f"Navigation: {t.min()}..{t.max()} s is outside {self.t_s[0]}..{self.t_s[-1]} s")
        row = np.clip(np.searchsorted(self.t_s, t, side="right") - 1, 0, len(self) - 2)
        return row, (t - self.t_s[row]) / (self.t_s[row + 1] - self.t_s[row])

    def weights(self) -> Float[Array, "n 6 6"]:
        """Inverse covariance of the errors of each record alone: attitude (in body axes) and position (in w).

        The sigmas of roll, pitch and heading turn into body axes by the angles themselves.
        """
        rph = roll_pitch_heading(self.T_wb.R)
        roll, pitch = rph[:, 0], rph[:, 1]
        E = np.zeros((len(self), 3, 3))
        E[:, 0, 0] = 1
        E[:, 1, 1], E[:, 2, 1] = np.cos(roll), -np.sin(roll)
        E[:, 0, 2] = -np.sin(pitch)
        E[:, 1, 2], E[:, 2, 2] = np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)
        W = np.zeros((len(self), 6, 6))
        own = 1 - self.constant_share
        C = own * (E * self.sigma_rph**2) @ np.swapaxes(E, 1, 2) + self.vibration**2 * np.eye(3)
        W[:, :3, :3] = np.linalg.inv(C)
        W[:, [3, 4, 5], [3, 4, 5]] = self.sigma_position_m**-2 / own
        return W


@dataclass(frozen=True, eq=False)
class Common:
    """The unknowns that all images share."""

    mounting: Mounting
    time_offset_s: float = 0.0
    gnss_offset_w: Float[Array, "3"] = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        freeze_fields(self)

    def moved(self, d: Float[Array, "10"]) -> Common:
        """Changed by (rotation in body axes, lever arm, time offset, GNSS offset)."""
        R_bc = exp_so3(d[:3]) @ boresight_rotation(self.mounting.boresight)
        mounting = Mounting(boresight_angles(R_bc), self.mounting.lever_b + d[3:6])
        return Common(mounting, self.time_offset_s + float(d[6]), self.gnss_offset_w + d[7:])

    def values(self) -> Float[Array, "10"]:
        """Boresight angles [rad], lever arm [m], time offset [s], GNSS offset [m]."""
        m = self.mounting
        return np.concatenate([m.boresight, m.lever_b, [self.time_offset_s], self.gnss_offset_w])

    def camera_poses(self, navigation: Navigation) -> Pose:
        """T_wc of the exposures as navigation and these unknowns have them."""
        R_wb = navigation.T_wb.R @ exp_so3(navigation.rate_b * self.time_offset_s)
        p_wb = navigation.T_wb.t + navigation.velocity_w * self.time_offset_s - self.gnss_offset_w
        return Pose(R_wb, p_wb) @ self.mounting.T_bc


def unknowns(extra: Iterable[Extra]) -> tuple[list[int], tuple[str, ...]]:
    """Which of the ten common unknowns are estimated, and their names."""
    chosen = {"boresight", *extra}
    named = [(group, name) for group, names in _NAMES.items() for name in names]
    columns = [i for i, (group, _) in enumerate(named) if group in chosen]
    return columns, tuple(named[i][1] for i in columns)


def angle_jacobian(mounting: Mounting) -> Float[Array, "3 3"]:
    """d(omega, phi, kappa) / d(rotation of the camera in body axes).

    ``M = R_x R_y R_z`` of (3.19) changes by ``hat(E d_angles) M`` with the axes E; ``R_bc = A M' F`` of `sim.angles` by
    ``hat(-A M' E d_angles) R_bc``.
    """
    omega, phi, _ = mounting.boresight
    c, s = np.cos(omega), np.sin(omega)
    E = np.array([[1, 0, np.sin(phi)], [0, c, -s * np.cos(phi)], [0, s, c * np.cos(phi)]])
    flip = np.diag([1.0, -1.0, -1.0])
    A_Mt = boresight_rotation(mounting.boresight) @ flip
    return np.asarray(-np.linalg.inv(A_Mt @ E))


@dataclass(frozen=True, eq=False)
class NavigationEquations:
    """Navigation minus poses: residual r (m, 6), its derivatives J (m, 6, 6) by the camera poses and G (m, 6, 10)."""

    r: Float[Array, "m 6"]
    J: Float[Array, "m 6 6"]
    G: Float[Array, "m 6 10"]


def navigation_equations(T_wc: Pose, navigation: Navigation, common: Common) -> NavigationEquations:
    """How far the camera poses are from what navigation says: rotation in body axes [rad], position in w [m].

    With the body of the camera pose, ``R_wb = R_wc R_cb`` and ``p_wb = t_wc - R_wb lever_b``:
    ``r = (log(R_nav' R_wb), p_wb - p_nav)``.
    """
    mounting = common.mounting
    R_bc, lever = boresight_rotation(mounting.boresight), np.asarray(mounting.lever_b)
    R_wb = T_wc.R @ R_bc.T
    R_nav = navigation.T_wb.R @ exp_so3(navigation.rate_b * common.time_offset_s)
    theta = log_so3(np.swapaxes(R_nav, 1, 2) @ R_wb)
    p_nav = navigation.T_wb.t + navigation.velocity_w * common.time_offset_s - common.gnss_offset_w
    r = np.concatenate([theta, T_wc.t - R_wb @ lever - p_nav], axis=1)
    right, left = np.linalg.inv(left_jacobian(-theta)), np.linalg.inv(left_jacobian(theta))
    J, G = np.zeros((len(r), 6, 6)), np.zeros((len(r), 6, 10))
    J[:, :3, :3] = right @ R_bc
    J[:, 3:, :3] = R_wb @ hat(lever) @ R_bc
    J[:, 3:, 3:] = np.eye(3)
    G[:, :3, :3] = -right
    G[:, 3:, :3] = -R_wb @ hat(lever)
    G[:, 3:, 3:6] = -R_wb
    G[:, :3, 6] = -np.einsum("mij,mj->mi", left, navigation.rate_b)
    G[:, 3:, 6] = -navigation.velocity_w
    G[:, 3:, 7:] = np.eye(3)
    return NavigationEquations(r, J, G)
