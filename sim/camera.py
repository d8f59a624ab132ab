"""Pinhole cameras with Brown distortion and the general stereo rig: projection, its Jacobian and the inverse."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from sim.archive import freeze
from sim.pose import Pose

Array = np.ndarray
_NO_DISTORTION = np.zeros(5)


@dataclass(frozen=True, eq=False)
class Camera:
    """Interior orientation: ``u = f_x x_d + s y_d + c_x``, ``v = f_y y_d + c_y`` with the Brown model for (x_d, y_d).

    K (3, 3) in pixels (Siegemund 2008, (B.0.4)); distortion (k1, k2, p1, p2, k3) in OpenCV's order;
    size_px (width, height). Pixel (0, 0) is the centre of the top-left pixel.
    """

    K: Float[Array, "3 3"]
    size_px: tuple[int, int]
    distortion: Float[Array, "5"] = field(default_factory=lambda: _NO_DISTORTION)

    def __post_init__(self) -> None:
        K, d = np.asarray(self.K, float), np.asarray(self.distortion, float)
        if K.shape != (3, 3) or not np.isfinite(K).all() or not (K[0, 0] > 0 and K[1, 1] > 0):
            raise ValueError(f"Camera.K: expected (3, 3), finite, with positive focal lengths, got {K.tolist()}")
        if d.shape != (5,) or not np.isfinite(d).all():
            raise ValueError(
                f"Camera.distortion: expected 5 finite coefficients (k1, k2, p1, p2, k3), got {d.tolist()}"
            )
        object.__setattr__(self, "K", freeze(K))
        object.__setattr__(self, "distortion", freeze(d))
        object.__setattr__(self, "size_px", (int(self.size_px[0]), int(self.size_px[1])))

    @staticmethod
    def simple(size_px: tuple[int, int], focal_px: float, principal_px: tuple[float, float] | None = None) -> Camera:
        """Square pixels, no skew; the principal point defaults to the image centre ((w - 1)/2, (h - 1)/2)."""
        cx, cy = principal_px or ((size_px[0] - 1) / 2, (size_px[1] - 1) / 2)
        return Camera(np.array([[focal_px, 0, cx], [0, focal_px, cy], [0, 0, 1.0]]), size_px)

    @staticmethod
    def from_fields(fields: dict[str, Any]) -> Camera:
        return Camera(fields["K"], tuple(fields["size_px"]), fields["distortion"])

    @property
    def is_distorted(self) -> bool:
        return bool(np.any(self.distortion))

    @cached_property
    def _fold(self) -> float:
        """Squared radius where r (1 + k1 r² + k2 r⁴ + k3 r⁶) ceases to grow: beyond it the model folds back inwards."""
        k1, k2, _, _, k3 = self.distortion
        roots = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])
        return float(np.min(roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)], initial=np.inf))

    def _before_fold(self, xy: Array) -> Array:
        return np.asarray(np.where(np.sum(xy * xy, axis=-1, keepdims=True) < self._fold, xy, np.nan))

    def distort(self, xy: Float[Array, "*b 2"]) -> Float[Array, "*b 2"]:
        """Ideal to distorted normalised coordinates, Brown model."""
        return self._distort(np.asarray(xy, float))[0]

    def _distort(self, xy: Array) -> tuple[Array, Array]:
        """Distorted coordinates and their Jacobian (..., 2, 2)."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        d_radial = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))  # d radial / d r2, times 2: chain rule with x or y
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        J = np.empty((*x.shape, 2, 2))
        J[..., 0, 0] = radial + x * x * d_radial + 2 * p1 * y + 6 * p2 * x
        J[..., 0, 1] = J[..., 1, 0] = x * y * d_radial + 2 * p1 * x + 2 * p2 * y
        J[..., 1, 1] = radial + y * y * d_radial + 6 * p1 * y + 2 * p2 * x
        return np.stack([xd, yd], axis=-1), J

    def undistort(self, xy_d: Float[Array, "*b 2"]) -> Float[Array, "*b 2"]:
        """Inverse of `distort` by Newton's method, to 1e-12 inside the image; NaN where no ray belongs to the pixel."""
        xy_d = np.asarray(xy_d, float)
        if not self.is_distorted:
            return xy_d
        xy = xy_d.copy()
        for _ in range(20):
            value, J = self._distort(xy)
            xy = xy - np.linalg.solve(J, (value - xy_d)[..., None])[..., 0]
        error = np.abs(self._distort(xy)[0] - xy_d).max(axis=-1, keepdims=True)
        return self._before_fold(np.where(error < 1e-10, xy, np.nan))

    def project(self, p_c: Float[Array, "*b 3"]) -> Float[Array, "*b 2"]:
        """Pixel coordinates of points in the camera frame [m]; NaN behind the camera and beyond the lens model."""
        p = np.asarray(p_c, float)
        z = np.where(p[..., 2] > 0, p[..., 2], np.nan)
        return np.asarray(self.to_pixels(self.distort(self._before_fold(p[..., :2] / z[..., None]))))

    def project_jacobian(self, p_c: Float[Array, "*b 3"]) -> Float[Array, "*b 2 3"]:
        """d(u, v)/d(p_c) [px/m]."""
        p = np.asarray(p_c, float)
        iz = 1 / p[..., 2]
        xy = p[..., :2] * iz[..., None]
        J_n = np.zeros((*p.shape[:-1], 2, 3))
        J_n[..., 0, 0] = J_n[..., 1, 1] = iz
        J_n[..., 0, 2], J_n[..., 1, 2] = -xy[..., 0] * iz, -xy[..., 1] * iz
        J = self._distort(xy)[1] @ J_n if self.is_distorted else J_n
        return np.asarray(self.K[:2, :2] @ J)

    def to_pixels(self, xy_d: Float[Array, "*b 2"]) -> Float[Array, "*b 2"]:
        """Distorted normalised coordinates to pixels."""
        return np.asarray(xy_d @ self.K[:2, :2].T + self.K[:2, 2])

    def normalise(self, uv: Float[Array, "*b 2"]) -> Float[Array, "*b 2"]:
        """Pixels to ideal (undistorted) normalised coordinates (x/z, y/z)."""
        uv = np.asarray(uv, float)
        return self.undistort(np.linalg.solve(self.K[:2, :2], (uv - self.K[:2, 2])[..., None])[..., 0])

    def normalise_jacobian(self, xy: Float[Array, "*b 2"]) -> Float[Array, "*b 2 2"]:
        """d(x, y)/d(u, v) at the ideal normalised point (x, y)."""
        J = self.K[:2, :2] @ self._distort(np.asarray(xy, float))[1]
        return np.asarray(np.linalg.inv(J))

    def unproject(self, uv: Float[Array, "*b 2"], depth: Float[Array, "*b"]) -> Float[Array, "*b 3"]:
        """Point in the camera frame with the given depth z [m] on the ray of a pixel."""
        xy = self.normalise(uv)
        ray = np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)
        return np.asarray(ray * np.asarray(depth, float)[..., None])

    def contains(self, uv: Float[Array, "*b 2"], margin_px: float = 0.0) -> Bool[Array, "*b"]:
        """Whether a pixel lies inside the image (NaN does not)."""
        w, h = self.size_px
        u, v = uv[..., 0], uv[..., 1]
        lo = margin_px - 0.5
        return np.asarray((u >= lo) & (v >= lo) & (u <= w - 1 - lo) & (v <= h - 1 - lo))


@dataclass(frozen=True, eq=False)
class StereoRig:
    """Two cameras and their relative orientation; ``p_r = T_rl @ p_c`` (Siegemund 2008, (3.1.1)-(3.1.2))."""

    left: Camera
    right: Camera
    T_rl: Pose

    @staticmethod
    def normal_case(camera: Camera, baseline_m: float) -> StereoRig:
        """Parallel, identical cameras; the right one stands ``baseline_m`` to the right."""
        if not baseline_m > 0:
            raise ValueError(f"baseline_m: expected > 0, got {baseline_m}")
        return StereoRig(camera, camera, Pose(np.eye(3), np.array([-baseline_m, 0, 0])))

    @staticmethod
    def from_fields(fields: dict[str, Any]) -> StereoRig:
        T = fields["T_rl"]
        return StereoRig(Camera.from_fields(fields["left"]), Camera.from_fields(fields["right"]), Pose(T["R"], T["t"]))

    @property
    def is_normal_case(self) -> bool:
        """Parallel axes, base along x, equal undistorted cameras but for the principal point's column."""
        same = np.allclose(np.delete(self.left.K.ravel(), 2), np.delete(self.right.K.ravel(), 2), rtol=0, atol=1e-12)
        return bool(
            same
            and self.left.K[0, 1] == 0
            and not self.left.is_distorted
            and not self.right.is_distorted
            and np.array_equal(self.T_rl.R, np.eye(3))
            and self.T_rl.t[0] < 0
            and not np.any(self.T_rl.t[1:])
        )

    def project(self, p_c: Float[Array, "*b 3"]) -> Float[Array, "*b 4"]:
        """(u_left, v_left, u_right, v_right) of points in the left camera frame; NaN behind either camera."""
        return np.concatenate([self.left.project(p_c), self.right.project(self.T_rl.apply(p_c))], axis=-1)

    def project_jacobian(self, p_c: Float[Array, "*b 3"]) -> Float[Array, "*b 4 3"]:
        """d(u_left, v_left, u_right, v_right)/d(p_c) [px/m]."""
        right = self.right.project_jacobian(self.T_rl.apply(p_c)) @ self.T_rl.R
        return np.concatenate([self.left.project_jacobian(p_c), right], axis=-2)
