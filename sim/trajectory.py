"""A motion as four functions of time - pose, velocity, angular rate, acceleration - from sampled poses and a spline."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from sim.archive import freeze
from sim.pose import Pose

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses T_wb (N,) of a body b in the world w at strictly increasing times t_s (N,), N >= 2.

    Between the samples position is a cubic spline and rotation a spline with continuous rate and acceleration
    (SciPy's RotationSpline). Asked outside [t_s[0], t_s[-1]] it raises ValueError: a motion is not extrapolated.
    """

    t_s: Float[Array, "n"]
    T_wb: Pose
    _position: CubicSpline = field(init=False, repr=False)
    _rotation: RotationSpline = field(init=False, repr=False)

    def __post_init__(self) -> None:
        t = np.asarray(self.t_s, float)
        if t.ndim != 1 or len(t) < 2 or not np.all(np.diff(t) > 0):
            raise ValueError("Trajectory.t_s: expected at least two strictly increasing times")
        if self.T_wb.t.shape != (len(t), 3):
            raise ValueError(f"Trajectory.T_wb: expected {len(t)} poses, got {self.T_wb.t.shape[:-1]}")
        object.__setattr__(self, "t_s", freeze(t))
        object.__setattr__(self, "_position", CubicSpline(t, self.T_wb.t))
        object.__setattr__(self, "_rotation", RotationSpline(t, Rotation.from_matrix(self.T_wb.R)))

    @staticmethod
    def standing(pose: Pose, t_s: Float[Array, "n"]) -> Trajectory:
        """A body that does not move between the first and the last time."""
        ends = np.array([t_s[0], t_s[-1]]) if len(t_s) > 1 else np.array([t_s[0] - 1.0, t_s[0] + 1.0])
        return Trajectory(ends, Pose.stack([pose, pose]))

    def _checked(self, t: ArrayLike) -> Array:
        t = np.asarray(t, float)
        slack = 1e-9 * max(1.0, float(np.abs(self.t_s).max()))
        if not np.all((t >= self.t_s[0] - slack) & (t <= self.t_s[-1] + slack)):
            raise ValueError(f"Trajectory: {t.min()}..{t.max()} s is outside {self.t_s[0]}..{self.t_s[-1]} s")
        return np.asarray(np.clip(t, self.t_s[0], self.t_s[-1]))

    def pose(self, t: ArrayLike) -> Pose:
        t = self._checked(t)
        return Pose(self._rotation(t).as_matrix(), self._position(t))

    def velocity(self, t: ArrayLike) -> Float[Array, "*b 3"]:
        """Velocity of the body's origin in world axes [m/s]."""
        return np.asarray(self._position(self._checked(t), 1))

    def acceleration(self, t: ArrayLike) -> Float[Array, "*b 3"]:
        """Acceleration of the body's origin in world axes [m/s²]."""
        return np.asarray(self._position(self._checked(t), 2))

    def angular_rate(self, t: ArrayLike) -> Float[Array, "*b 3"]:
        """Angular rate of the body against the world, in world axes [rad/s]."""
        return self._turned(t, 1)

    def angular_acceleration(self, t: ArrayLike) -> Float[Array, "*b 3"]:
        """Angular acceleration of the body against the world, in world axes [rad/s²]."""
        return self._turned(t, 2)

    def _turned(self, t: ArrayLike, order: Literal[1, 2]) -> Array:
        """SciPy gives rates in body axes; the derivative of a rate turns alike because omega x omega = 0."""
        t = self._checked(t)
        return np.asarray((self._rotation(t).as_matrix() @ self._rotation(t, order)[..., None])[..., 0])

    def velocity_of(self, p_b: Float[Array, "3"], t: ArrayLike) -> Float[Array, "*b 3"]:
        """Velocity of a point fixed in the body, in world axes [m/s]."""
        return np.asarray(self.velocity(t) + np.cross(self.angular_rate(t), self.pose(t).R @ np.asarray(p_b, float)))
