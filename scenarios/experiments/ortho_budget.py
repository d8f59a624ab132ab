"""What every source of error costs on the ground, by linear propagation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from scenarios.experiments.ortho_flight import (
    ATTITUDE_DEG,
    FOCAL,
    K1,
    Overflights,
    Uncertainty,
)
from sim.camera import Camera
from sim.pose import Pose

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class GroundShifts:
    """How the places of ground points move when something of an image changes.

    A ray d from t meets the ground (normal n) at X = t + d; to first order
    ``dX = dt + dd - d n·(dt + dd - z dh) / (n·d)`` for shifts dt of the projection centre, dd of the ray at X, and dh
    of the ground's height (z upwards). X, d, n (k, 3).
    """

    camera: Camera
    T_wc: Pose
    X: Float[Array, "k 3"]
    normal: Float[Array, "k 3"]

    @property
    def ray(self) -> Float[Array, "k 3"]:
        return np.asarray(self.X - self.T_wc.t)

    def shifted(self, d_ray: Float[Array, "*b k 3"]) -> Float[Array, "*b k 2"]:
        """Horizontal shift [m] where rays, or with them the projection centre, move by d_ray at the ground [m]."""
        n, d = self.normal, self.ray
        along = np.sum(n * d_ray, axis=-1, keepdims=True) / np.sum(n * d, axis=-1, keepdims=True)
        return np.asarray((d_ray - d * along)[..., :2])

    def turned(self, axes_w: Float[Array, "a 3"]) -> Float[Array, "a k 2"]:
        """Shift per radian about axes in the world."""
        return self.shifted(np.cross(axes_w[:, None], self.ray))

    def raised(self, height_m: Float[Array, "k"]) -> Float[Array, "k 2"]:
        """Shift where the ground is taken for so much higher."""
        return self.shifted(np.array([0.0, 0.0, -1.0]) * height_m[:, None])

    def seen_by(self, other: Camera) -> Float[Array, "k 2"]:
        """Shift where another camera is taken for the one that made the image."""
        ideal = self.T_wc.inv().apply(self.X)
        d_xy = other.normalise(self.camera.project(ideal)) - ideal[:, :2] / ideal[:, 2:]
        d_c = np.concatenate([d_xy, np.zeros((len(d_xy), 1))], axis=-1) * ideal[:, 2:]
        return self.shifted(d_c @ self.T_wc.R.T)


def random_variance(
    shifts: GroundShifts, flown: Overflights, image: int, uncertainty: Uncertainty, gsd_m: float
) -> Float[Array, "k"]:
    """Variance of the place of every point, the sum of both axes' [m²]."""
    turned = np.deg2rad(
        np.concatenate(
            [
                np.array(ATTITUDE_DEG)[:, None] * flown.R_wb[image].T * uncertainty.attitude,
                np.array(uncertainty.boresight)[:, None] * flown.T_wc.R[image].T,
                uncertainty.vibration * flown.T_wc.R[image].T,
            ]
        )
    )
    moved = uncertainty.position * np.eye(3)
    late = uncertainty.synchronisation * (flown.velocity[image] + np.cross(flown.rate[image], shifts.ray))
    parts = [shifts.turned(turned), shifts.shifted(moved[:, None] + np.zeros((3, len(shifts.X), 3)))]
    parts += [shifts.shifted(late)[None]]
    if uncertainty.interior:
        parts.append(np.stack([shifts.seen_by(camera) for camera in _one_sigma_off(shifts.camera)]))
    return np.asarray(sum(np.sum(p**2, axis=(0, -1)) for p in parts) + 2 * (uncertainty.clicks * gsd_m) ** 2)


def _one_sigma_off(camera: Camera) -> list[Camera]:
    K, lens = camera.K.copy(), camera.distortion.copy()
    K[[0, 1], [0, 1]] *= 1 + FOCAL
    lens[0] += K1
    return [Camera(K, camera.size_px, camera.distortion), Camera(camera.K, camera.size_px, lens)]


def anchor_heights(corner_m: Float[Array, "4"], uv: Float[Array, "k 2"], size_px: tuple[int, int]) -> Float[Array, "k"]:
    """Heights between those of the image's corners (top left, top right, bottom right, bottom left)."""
    s, t = (uv / (np.array(size_px) - 1)).T
    weights = np.stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t], axis=-1)
    return np.asarray(weights @ corner_m)
