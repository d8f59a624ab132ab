"""What is known of an object's motion beyond the observations: Siegemund 2008, 3.6 and 4.2.3.

Pseudo-observations of the poses enter the normal equations with a weight; fixed conditions restrict the pose changes an
adjustment may make. Both concern the poses alone, so they meet the reduced system, after the points are eliminated.

Smooth motion (4.2.1): velocity and turn rate do not change from one time step to the next,

    e_t = v_(t,t+1) - v_(t-1,t) = 0     for every inner frame of the window,

with the velocity of the object's origin in fixed axes, as in the source, or in the object's own axes halfway between
the two frames, which holds for a constant turn, too (ours; up to phi²/24 of the velocity where a turn phi meets uneven
time steps). The source calls the smoothing of rotations unsolved; the
rates enter here by the logarithm of the rotation from frame to frame (ours). Where ego poses are observed the motion is
that over ground.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from estimators.stereo.kernel import (
    BODY_AXES,
    NO_SMOOTHING,
    WORLD_AXES,
    Terms,
    smoothness,
    smoothness_weights,
    tilt,
    tilt_weight,
)
from sim.pose import Pose, exp_so3

Array = np.ndarray
Poses = tuple[Array, Array]
_AXES = {"none": NO_SMOOTHING, "velocity": WORLD_AXES, "turn": BODY_AXES}


@dataclass(frozen=True)
class Smoothing:
    """How smooth the motion is.

    translation: "velocity" constant velocity of the object's origin (4.2.1), "turn" constant in the object's own axes;
    rotation: constant turn rate; weights "adaptive" from the changes themselves with the factor gamma (4.2.12), or
    "fixed" from standard deviations of the accelerations; tied: the first frames of a window keep their translations
    from the last one (4.2.13).
    """

    translation: Literal["none", "velocity", "turn"] = "none"
    rotation: bool = False
    weights: Literal["adaptive", "fixed"] = "adaptive"
    gamma: float = 1.0
    acceleration_mps2: float = 1.0
    angular_acceleration_dps2: float = 20.0
    tied: int = 0

    def __post_init__(self) -> None:
        for name in ("gamma", "acceleration_mps2", "angular_acceleration_dps2"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"smoothing.{name}: {value} is out of range, expected a positive number")
        if self.tied < 0:
            raise ValueError(f"smoothing.tied: {self.tied} is out of range, expected 0 or more frames")


@dataclass(frozen=True)
class RotationAxis:
    """Knowledge that the object turns about one axis only, (3.6.1)-(3.6.4).

    mode: "free" nothing is known; "fixed" the axis is a condition; "pseudo_observation" with the standard deviation
    sigma_deg; "adaptive" with that of the tilts themselves. The axis is the vertical of the world where ego poses are
    observed, else ``axis_c`` in the left camera.
    """

    mode: Literal["free", "fixed", "pseudo_observation", "adaptive"] = "free"
    sigma_deg: float = 0.5
    axis_c: tuple[float, float, float] = (0.0, 1.0, 0.0)

    def __post_init__(self) -> None:
        if not (np.isfinite(self.sigma_deg) and self.sigma_deg > 0):
            raise ValueError(f"rotation_axis.sigma_deg: {self.sigma_deg} is out of range, expected a positive number")
        if not (np.all(np.isfinite(self.axis_c)) and np.linalg.norm(self.axis_c) > 0):
            raise ValueError(f"rotation_axis.axis_c: {self.axis_c} is no direction")


@dataclass(frozen=True, eq=False)
class PseudoObservations:
    """Linearised at some poses: e (q,) is to be zero, e + J dp with J (q, 6m), weights P (q, q); ``count`` of them that
    are independent."""

    e: Float[Array, "q"]
    J: Float[Array, "q p"]
    P: Float[Array, "q q"]
    count: int


@dataclass(frozen=True, eq=False)
class Conditions:
    """The conditions of one window of m frames, as the compiled loop takes them."""

    terms: Terms

    @property
    def free(self) -> Float[Array, "p f"] | None:
        """Orthonormal basis (6m, f) of the pose changes that are allowed; None where all are."""
        return self.terms.free if self.terms.free.size else None

    @property
    def tied(self) -> bool:
        """Whether the translations of some frames are fixed, and with them the object's origin."""
        return not self.terms.datum[3:].any()

    def null_space(self, R: Float[Array, "m 3 3"]) -> Float[Array, "p g"]:
        """Allowed pose changes (6m, g) that only move the object frame."""
        G = np.zeros((len(R), 6, 6))
        G[:, :3, :3] = G[:, 3:, 3:] = R
        return np.asarray(G.reshape(-1, 6) @ self.terms.datum)

    def pseudo_observations(self, R: Float[Array, "m 3 3"], T: Float[Array, "m 3"]) -> PseudoObservations:
        """Everything that is known with a weight, at these poses; adaptive weights from the residuals there."""
        m, t = len(R), self.terms
        e, J_t = smoothness(t, R, T) if len(t.P) else (np.zeros((0, 6)), np.zeros((0, 6, 18)))
        weights = smoothness_weights(t, e)
        tilts = m if t.axis_weight != 0 else 0
        J, P = np.zeros((6 * len(e) + 3 * tilts, 6 * m)), np.zeros((6 * len(e) + 3 * tilts,) * 2)
        for k in range(len(e)):
            J[6 * k : 6 * k + 6, 6 * k : 6 * k + 18] = J_t[k]
            P[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = weights[k]
        count = int(np.count_nonzero(np.diag(P)))
        if not tilts:
            return PseudoObservations(e.ravel(), J, P, count)
        e_axis, J_axis = tilt(t, R)
        i = 6 * len(e)
        for k in range(m):
            J[i + 3 * k : i + 3 * k + 3, 6 * k : 6 * k + 3] = J_axis[k]
        P[i:, i:] = tilt_weight(t, e_axis) * np.eye(3 * m)
        return PseudoObservations(np.concatenate([e.ravel(), e_axis.ravel()]), J, P, count + 2 * m)


@functools.cache
def no_terms(m: int) -> Terms:
    """Nothing is known beyond the observations."""
    none, all_6 = np.zeros((0, 6, 6)), np.eye(6)
    eye, zero = np.tile(np.eye(3), (m, 1, 1)), np.zeros((m, 3))
    return Terms(
        np.ones(m - 1), eye, zero, NO_SMOOTHING, False, none, 0.0, zero, np.zeros(3), 0.0, np.zeros((0, 0)), all_6
    )


def of_window(
    smoothing: Smoothing,
    rotation_axis: RotationAxis,
    t_s: Float[Array, "m"],
    T_wc: Pose | None,
    start: Poses,
    tied: int = 0,
) -> tuple[Poses, Conditions | None]:
    """Conditions of a window with its times and ego poses (m,), and the start poses as the conditions allow them.

    tied: how many of the first frames keep the translations of the start. None where there are no conditions.
    """
    R, T = start
    smooth = len(t_s) > 2 and (smoothing.translation != "none" or smoothing.rotation)
    if not smooth and not tied and rotation_axis.mode == "free":
        return start, None
    m, none = len(t_s), no_terms(len(t_s))
    axis, up = _axis(rotation_axis, R, T_wc)
    if rotation_axis.mode == "fixed":
        R = _levelled(R, axis, up)
    weight = {"pseudo_observation": np.deg2rad(rotation_axis.sigma_deg) ** -2, "adaptive": -1.0}
    terms = Terms(
        dt_s=np.diff(t_s),
        R_wc=none.R_wc if T_wc is None else np.ascontiguousarray(T_wc.R),
        t_wc=none.t_wc if T_wc is None else np.ascontiguousarray(T_wc.t),
        translation=_AXES[smoothing.translation],
        rotation=smoothing.rotation,
        P=_weights(smoothing, t_s) if smooth else none.P,
        gamma=smoothing.gamma if smooth and smoothing.weights == "adaptive" else 0.0,
        axis=axis,
        up=up,
        axis_weight=float(weight.get(rotation_axis.mode, 0.0)),
        free=_free(m, axis if rotation_axis.mode == "fixed" else None, tied),
        datum=_datum(up if rotation_axis.mode != "free" else None, tied > 0),
    )
    return (R, T), Conditions(terms)


def _weights(smoothing: Smoothing, t_s: Array) -> Float[Array, "q 6 6"]:
    """Fixed weights of the changes of velocity and rate, gained over half the time of both steps."""
    gain = (t_s[2:] - t_s[:-2]) / 2
    P = np.zeros((len(gain), 6, 6))
    if smoothing.translation != "none":
        P[:, [0, 1, 2], [0, 1, 2]] = (smoothing.acceleration_mps2 * gain[:, None]) ** -2
    if smoothing.rotation:
        P[:, [3, 4, 5], [3, 4, 5]] = (np.deg2rad(smoothing.angular_acceleration_dps2) * gain[:, None]) ** -2
    return P


def _axis(rotation_axis: RotationAxis, R: Array, T_wc: Pose | None) -> tuple[Float[Array, "m 3"], Float[Array, "3"]]:
    """The axis in the camera at every frame, and in the object: the mean of the start poses."""
    c = np.asarray(rotation_axis.axis_c, float)
    axis = np.tile(c / np.linalg.norm(c), (len(R), 1)) if T_wc is None else -T_wc.R[:, 2]
    up = np.einsum("tba,tb->a", R, axis)
    length = np.linalg.norm(up)
    return np.ascontiguousarray(axis), up / length if length > 0 else R[0].T @ axis[0]


def _levelled(R: Array, axis: Array, up: Array) -> Float[Array, "m 3 3"]:
    """Rotations turned the shortest way so that R up is the axis in every frame."""
    now = np.asarray(R @ up)
    normal, cosine = np.cross(now, axis), np.sum(now * axis, axis=1)
    sine = np.linalg.norm(normal, axis=1)
    factor = np.divide(np.arctan2(sine, cosine), sine, out=np.ones_like(sine), where=sine > 0)
    return np.asarray(exp_so3(normal * factor[:, None]) @ R)


def _free(m: int, axis: Array | None, tied: int) -> Float[Array, "p f"]:
    columns = []
    for t in range(m):
        turns = np.eye(3) if axis is None else axis[t][:, None]
        shifts = np.zeros((3, 0)) if t < tied else np.eye(3)
        for block, row in ((turns, 6 * t), (shifts, 6 * t + 3)):
            column = np.zeros((6 * m, block.shape[1]))
            column[row : row + 3] = block
            columns.append(column)
    return np.ascontiguousarray(np.concatenate(columns, axis=1)) if axis is not None or tied else np.zeros((0, 0))


def _datum(up: Array | None, tied: bool) -> Float[Array, "6 g"]:
    """What of the object frame is left open: a known axis leaves turns about it, tied frames no shifts."""
    turns = np.eye(3) if up is None else up[:, None]
    D = np.zeros((6, turns.shape[1] + (0 if tied else 3)))
    D[:3, : turns.shape[1]] = turns
    if not tied:
        D[3:, turns.shape[1] :] = np.eye(3)
    return D
