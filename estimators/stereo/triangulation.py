"""Points from stereo observations, with covariance: Siegemund 2008, 3.1.5 and 4.1.2.2.

The observations of the adjustment are triangulated points; what is known of their accuracy - covariance and the
second-order bias of the expectation - is evaluated here, at whatever point the caller believes in.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from jaxtyping import Float

from estimators.stereo.kernel import FAR_M as FAR_M
from sim.camera import Camera, StereoRig

Array = np.ndarray
Propagation = Literal["linear", "unscented"]


def undistorted(
    rig: StereoRig, uv: Float[Array, "n 4"], cov: Float[Array, "n 4 4"]
) -> tuple[StereoRig, Float[Array, "n 4"], Float[Array, "n 4 4"]]:
    """The same observations as cameras without distortion would have made them, covariance by linear propagation.

    NaN where no ray belongs to a pixel.
    """
    if not (rig.left.is_distorted or rig.right.is_distorted):
        return rig, uv, cov
    ideal = StereoRig(Camera(rig.left.K, rig.left.size_px), Camera(rig.right.K, rig.right.size_px), rig.T_rl)
    J, uv_ideal = np.zeros((len(uv), 4, 4)), np.empty_like(uv)
    for camera, part in ((rig.left, slice(0, 2)), (rig.right, slice(2, 4))):
        xy = camera.normalise(uv[:, part])
        uv_ideal[:, part] = camera.to_pixels(xy)
        J[:, part, part] = camera.K[:2, :2] @ camera.normalise_jacobian(xy)
    return ideal, uv_ideal, J @ cov @ np.swapaxes(J, 1, 2)


def _normal_case(rig: StereoRig, uv: Array) -> Array:
    """Closed form (4.1.7): Z = B c / d, with the mean of both rows."""
    K, base = rig.left.K, -rig.T_rl.t[0]
    disparity = uv[:, 0] - uv[:, 2] - (K[0, 2] - rig.right.K[0, 2])
    Z = base * K[0, 0] / np.where(disparity > 0, disparity, np.nan)
    x = (uv[:, 0] - K[0, 2]) / K[0, 0]
    y = ((uv[:, 1] + uv[:, 3]) / 2 - K[1, 2]) / K[1, 1]
    return np.stack([x * Z, y * Z, Z], axis=-1)


def _midpoint(rig: StereoRig, uv: Array) -> Array:
    """Middle of the shortest line between the two rays: linear, any relative orientation."""
    n = len(uv)
    left = np.concatenate([rig.left.normalise(uv[:, :2]), np.ones((n, 1))], axis=1)
    right = np.concatenate([rig.right.normalise(uv[:, 2:]), np.ones((n, 1))], axis=1)
    T_lr = rig.T_rl.inv()
    right = right @ T_lr.R.T
    a, b, c = np.sum(left * left, 1), np.sum(left * right, 1), np.sum(right * right, 1)
    d, e = left @ T_lr.t, right @ T_lr.t
    denominator = a * c - b * b
    s = (c * d - b * e) / np.where(denominator > 0, denominator, np.nan)
    t = (b * d - a * e) / np.where(denominator > 0, denominator, np.nan)
    in_front = (s > 0) & (t > 0)
    middle = (s[:, None] * left + T_lr.t + t[:, None] * right) / 2
    return np.where(in_front[:, None], middle, np.nan)


def triangulate(
    rig: StereoRig, uv: Float[Array, "n 4"], cov: Float[Array, "n 4 4"], propagation: Propagation = "linear"
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3 3"]]:
    """Points in the left camera frame [m] and their covariance [m²] (Siegemund 2008, 3.1.5).

    Normal case in closed form, general relative orientation linear; then Gauss-Newton on the image residuals, so that
    the four coordinates enter with their covariance. Rows whose rays do not meet in front of both cameras, nearer than
    `FAR_M`, are NaN.

    propagation: how the covariance of the image coordinates is carried over, "linear" or "unscented" by sigma points.
    Where not all sigma points can be triangulated, or what they span is no covariance, the linear one stands. The mean
    of the sigma points is not used: the source corrects the points by `second_order_bias` (4.1.2.2).
    """
    W_uv = np.linalg.inv(cov)
    points = _points(rig, uv, W_uv)
    good = np.isfinite(points).all(axis=1)
    C = np.full((len(points), 3, 3), np.nan)
    C[good] = np.linalg.inv(information(rig, points[good], W_uv[good]))
    if propagation == "unscented":
        _, C_sigma = unscented(lambda x: _points(rig, x, W_uv), uv, cov)
        whole = np.isfinite(C_sigma).all(axis=(1, 2)) & good
        whole[whole] = np.linalg.eigvalsh(C_sigma[whole])[:, 0] > 0
        C[whole] = C_sigma[whole]
    return points, C


def _points(rig: StereoRig, uv: Array, W_uv: Array) -> Array:
    """Points of weighted image coordinates, NaN where there is none."""
    p = _normal_case(rig, uv) if rig.is_normal_case else _midpoint(rig, uv)
    good = np.isfinite(p).all(axis=1) & (p[:, 2] < FAR_M)
    points = np.full_like(p, np.nan)
    if not good.any():
        return points
    p, uv, W_uv = p[good], uv[good], W_uv[good]
    for _ in range(2):
        J = rig.project_jacobian(p)
        JW = np.swapaxes(J, 1, 2) @ W_uv
        p = p + np.linalg.solve(JW @ J, JW @ (uv - rig.project(p))[:, :, None])[:, :, 0]
    in_front = np.isfinite(rig.project(p)).all(axis=1) & (p[:, 2] < FAR_M)
    points[np.flatnonzero(good)[in_front]] = p[in_front]
    return points


def information(rig: StereoRig, p: Float[Array, "n 3"], W_uv: Float[Array, "n 4 4"]) -> Float[Array, "n 3 3"]:
    """Weight matrix J' W_uv J [1/m²] of a point triangulated from image coordinates with weights W_uv [1/px²].

    Its inverse is the covariance of (4.1.19)-(4.1.21), step 3.
    """
    J = rig.project_jacobian(p)
    return np.asarray(np.swapaxes(J, 1, 2) @ W_uv @ J)


def _projection_curvature(camera: Camera, p: Array, C: Array) -> Array:
    """tr(H C) of both pixel coordinates, (n, 2); H is the Hessian of the ideal projection at p (camera frame)."""
    x, y, z = p.T
    cx = 2 * (x * C[:, 2, 2] / z - C[:, 0, 2]) / z**2
    cy = 2 * (y * C[:, 2, 2] / z - C[:, 1, 2]) / z**2
    return np.asarray(np.stack([cx, cy], axis=1) @ camera.K[:2, :2].T)


def second_order_bias(rig: StereoRig, p: Float[Array, "n 3"], W_uv: Float[Array, "n 4 4"]) -> Float[Array, "n 3"]:
    """Expected triangulated minus true point [m] by the terms of second order.

    The source gives the depth of the normal case, Z (sigma_d/d)² (4.1.13); here all coordinates and any rig, as the
    bias -1/2 C J' W tr(H C) of a least-squares estimate (Box 1971). The curvature of lens distortion is left out.
    """
    J = rig.project_jacobian(p)
    JW = np.swapaxes(J, 1, 2) @ W_uv
    C = np.linalg.inv(JW @ J)
    R = rig.T_rl.R
    curvature = np.concatenate(
        [
            _projection_curvature(rig.left, p, C),
            _projection_curvature(rig.right, rig.T_rl.apply(p), R @ C @ R.T),
        ],
        axis=1,
    )
    return np.asarray(-0.5 * (C @ (JW @ curvature[:, :, None]))[:, :, 0])


def unscented(
    function: Callable[[Array], Array], x: Float[Array, "n d"], C: Float[Array, "n d d"]
) -> tuple[Float[Array, "n e"], Float[Array, "n e e"]]:
    """Mean and covariance of a function of Gaussian vectors by 2d + 1 sigma points (kappa = 3 - d)."""
    d = x.shape[1]
    kappa = 3.0 - d
    L = np.linalg.cholesky((d + kappa) * C)
    offsets = np.concatenate([np.zeros((len(x), 1, d)), np.swapaxes(L, 1, 2), -np.swapaxes(L, 1, 2)], axis=1)
    weights = np.full(2 * d + 1, 0.5 / (d + kappa))
    weights[0] = kappa / (d + kappa)
    y = np.stack([function(x + offsets[:, k]) for k in range(2 * d + 1)], axis=1)
    mean = np.einsum("k,nke->ne", weights, y)
    r = y - mean[:, None]
    return mean, np.einsum("k,nke,nkf->nef", weights, r, r)
