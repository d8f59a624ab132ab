"""How near the seen outline of a vehicle will come to our own: Siegemund 2008, 3.8.3.

All in the ground plane of the frame e of `vehicle`: x left, z forward. The outline is the convex hull of the adjusted
points; they move on by the relative motion of the last two frames, at constant speed and yaw rate (a constant twist, on
which the choice of a reference point has no influence); a yaw rate that its stated covariance cannot tell from none, as
all are far away, counts as none. Our own vehicle is a rectangle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq, minimize_scalar

from estimators.estimate import WindowEstimate
from sim.archive import freeze_fields
from sim.pose import Pose, exp_so3, log_so3

Array = np.ndarray
_STEP_S = 0.02
# 99 % of the chi-square distribution with one degree of freedom.
_TURNS = 6.63


@dataclass(frozen=True)
class EgoVehicle:
    """Our own vehicle's rectangle; the origin of e lies left_m and ahead_m of its middle."""

    length_m: float
    width_m: float
    left_m: float = 0.0
    ahead_m: float = 0.0

    def corners(self) -> Float[Array, "4 2"]:
        """(x left, z forward), in turn from x to z."""
        x, z = self.width_m / 2, self.length_m / 2
        x_m, z_m = np.array([x, -x, -x, x]) - self.left_m, np.array([z, z, -z, -z]) - self.ahead_m
        return np.stack([x_m, z_m], axis=1)


@dataclass(frozen=True, eq=False)
class Outline:
    """Corners (h, 2) of the hull in the ground plane of e [m] and their velocity (h, 2) relative to it [m/s]."""

    corner: Float[np.ndarray, "h 2"]
    velocity: Float[np.ndarray, "h 2"]

    def __post_init__(self) -> None:
        freeze_fields(self)


@dataclass(frozen=True)
class Approach:
    """Least distance [m] within the horizon and its time from now [s]; collision_s the time of the first contact.

    Where there is none, collision_s is infinite.
    """

    distance_m: float
    time_s: float
    collision_s: float


def outline(window: WindowEstimate, t_s: Float[Array, "m"], T_ec: Pose) -> Outline:
    """The hull of the window's points at its newest frame, with velocities; T_ec (m,) poses of the camera in e."""
    corner, twist = _hull_and_twist(window, t_s, T_ec)
    return Outline(corner, twist[1:] + twist[0] * np.stack([corner[:, 1], -corner[:, 0]], axis=1))


def closest_approach(
    window: WindowEstimate, t_s: Float[Array, "m"], T_ec: Pose, ego: EgoVehicle, horizon_s: float = 5.0
) -> Approach:
    """Where the outline, moved on, comes nearest to our own vehicle within the horizon, and whether they touch."""
    corner, twist = _hull_and_twist(window, t_s, T_ec)
    rectangle = ego.corners()

    def gap(time_s: Array | float) -> Array:
        return _gap(_moved(corner, twist, np.atleast_1d(time_s)), rectangle)

    def distance(time_s: Array | float) -> Array:
        return _distance(_moved(corner, twist, np.atleast_1d(time_s)), rectangle)

    times = np.append(np.arange(0, horizon_s, _STEP_S), horizon_s)
    touching = gap(times) <= 0
    if touching.any():
        first = int(np.argmax(touching))
        contact = 0.0 if first == 0 else float(brentq(lambda t: gap(t)[0], times[first - 1], times[first]))
        return Approach(0.0, contact, contact)
    nearest = int(np.argmin(distance(times)))
    bounds = times[max(nearest - 1, 0)], times[min(nearest + 1, len(times) - 1)]
    found = minimize_scalar(lambda t: float(distance(t)[0]), bounds=bounds, method="bounded", options={"xatol": 1e-9})
    return Approach(float(found.fun), float(found.x), np.inf)


def _hull_and_twist(window: WindowEstimate, t_s: Array, T_ec: Pose) -> tuple[Array, Array]:
    """Corners (h, 2) and the motion (3,) in the plane: rate about y [rad/s], velocity of what is at the origin."""
    last = window.frames[-2:]
    T_eo = T_ec[last] @ window.T_co[-2:]
    dt = t_s[last[1]] - t_s[last[0]]
    angle = log_so3(T_eo.R[1] @ T_eo.R[0].T)[1]
    up = T_ec.R[last[1]][1]
    if (angle / dt) ** 2 < _TURNS * (up @ window.cov[9:, 9:] @ up):
        angle = 0.0
    turn = exp_so3(np.array([0, angle, 0]))
    old, new = T_eo.apply(window.X_o.mean(axis=0)[None]) * [1, 0, 1]
    xi = Pose(turn, new - turn @ old).log() / dt
    points = T_eo[1].apply(window.X_o)[:, [0, 2]]
    return _convex_hull(points), xi[[1, 3, 5]]


def _moved(corner: Array, twist: Array, time_s: Array) -> Array:
    """Corners (t, h, 2) at times from now."""
    xi = np.multiply.outer(time_s, [0, twist[0], 0, twist[1], 0, twist[2]])
    T = Pose.exp(xi)
    points = np.stack([corner[:, 0], 0 * corner[:, 0], corner[:, 1]], axis=1)
    return np.asarray((points @ np.swapaxes(T.R, 1, 2) + T.t[:, None])[..., [0, 2]])


def _convex_hull(points: Array) -> Array:
    """Corners (h, 2) in turn from x to z, by Andrew's chain; two where all points lie on a line."""
    order = np.unique(points.round(9), axis=0)  # points above one another are one
    chains = []
    for row in (order, order[::-1]):
        chain: list[Array] = []
        for p in row:
            while len(chain) > 1 and _turns(chain[-2], chain[-1], p) <= 0:
                chain.pop()
            chain.append(p)
        chains += chain[:-1]
    return np.array(chains)


def _turns(a: Array, b: Array, c: Array) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _gap(P: Array, E: Array) -> Array:
    """Largest separation of convex polygons P (t, h, 2) and E (4, 2) along normals of sides: positive where apart."""
    E = np.broadcast_to(E, (len(P), *E.shape))
    return np.asarray(np.maximum(_separation(P, E), _separation(E, P)))


def _separation(P: Array, E: Array) -> Array:
    """... along the normals of P's sides."""
    side = np.roll(P, -1, axis=1) - P
    normal = np.stack([side[..., 1], -side[..., 0]], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.asarray(
        (np.einsum("tna,tha->tnh", normal, E).min(axis=2) - np.einsum("tna,tha->tnh", normal, P).max(axis=2)).max(
            axis=1
        )
    )


def _distance(P: Array, E: Array) -> Array:
    """Distance of polygons P (t, h, 2) and E (4, 2) that do not touch: of some corner from some side."""
    E = np.broadcast_to(E, (len(P), *E.shape))
    return np.asarray(np.minimum(_corner_to_side(P, E), _corner_to_side(E, P)))


def _corner_to_side(P: Array, E: Array) -> Array:
    side = (np.roll(E, -1, axis=1) - E)[:, None]
    lever = P[:, :, None] - E[:, None]
    along = np.clip(np.sum(lever * side, axis=-1) / np.sum(side * side, axis=-1), 0, 1)
    return np.asarray(np.linalg.norm(lever - along[..., None] * side, axis=-1).min(axis=(1, 2)))
