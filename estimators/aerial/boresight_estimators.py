"""The estimators of a calibration, by name: each is a frozen dataclass whose constructor is its configuration."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from estimators.aerial.boresight import boresight_from_gcps, boresight_per_image
from estimators.aerial.boresight_model import Common, Extra, angle_jacobian
from estimators.aerial.boresight_observations import BoresightObservations
from estimators.aerial.boresight_result import BoresightResult
from estimators.aerial.resection import Resection, linearise
from estimators.estimate import EstimationFailed
from sim.angles import Mounting
from sim.pose import Pose

Array = np.ndarray
_ANGLES = ("omega", "phi", "kappa")


@dataclass(frozen=True)
class ImageByImage:
    """Boresight of every image by resection, and their mean (Kozempel 2012, 3.3 and Fig. 3.7).

    ``fixed_position`` holds the positions of the navigation, as the source does. The covariance of the mean is that of
    the images' scatter; a share of navigation's errors that is constant is not averaged.
    """

    fixed_position: bool = True

    def __call__(self, observations: BoresightObservations) -> BoresightResult | EstimationFailed:
        o, started = observations, time.perf_counter()
        found = boresight_per_image(o.camera, o.points, o.control, o.navigation, o.nominal, self.fixed_position)
        if isinstance(found, EstimationFailed):
            return found
        resections = {i: r for i, r in enumerate(found.resections) if isinstance(r, Resection)}
        done = list(resections)
        by_image = _image_covariances(o, found.angles, resections, self.fixed_position)
        redundancy = sum(r.redundancy for r in resections.values())
        squares = sum(r.sigma_0**2 * r.redundancy for r in resections.values() if r.redundancy)
        return BoresightResult.of(
            o,
            names=_ANGLES,
            x=found.mean,
            cov=self._covariance_of_mean(o, found.angles[done], found.mean, by_image[done]),
            common=Common(Mounting(found.mean, o.nominal.lever_b)),
            by_image=found.angles,
            sigma_by_image=np.sqrt(np.einsum("mii->mi", by_image)),
            T_wc=_poses(len(o.images), {i: r.T_wc for i, r in resections.items()}),
            X_w=o.control.X_w,
            rejected=_marked(o, {(i, int(point)) for i, r in resections.items() for point in r.rejected}),
            left_out=_failures(o, found.resections),
            inseparable=(),
            sigma_0=float(np.sqrt(squares / redundancy)) if redundancy else float("nan"),
            redundancy=redundancy,
            runtime_s=time.perf_counter() - started,
        )

    @staticmethod
    def _covariance_of_mean(o: BoresightObservations, angles: Array, mean: Array, cov: Array) -> Array:
        """Scatter over the images, or of one image its own; (3, 3) [rad²]."""
        n = len(angles)
        if n == 1:
            return np.asarray(cov[0])
        deviation = np.remainder(angles - mean + np.pi, 2 * np.pi) - np.pi
        T = angle_jacobian(Mounting(mean, o.nominal.lever_b))
        constant = o.navigation.constant_share * np.diag(o.navigation.sigma_rph**2)
        return np.asarray(deviation.T @ deviation / (n * (n - 1)) + T @ constant @ T.T)


@dataclass(frozen=True)
class OneAdjustment:
    """Boresight from one adjustment of all images, which have their own poses (Kozempel 2012, 3.3).

    ``extra`` asks for what else the images share: the lever arm, a time offset, a GNSS offset. Images that cannot be
    resected take no part.
    """

    extra: tuple[Extra, ...] = ()

    def __call__(self, observations: BoresightObservations) -> BoresightResult | EstimationFailed:
        o, started = observations, time.perf_counter()
        alone = boresight_per_image(o.camera, o.points, o.control, o.navigation, o.nominal)
        if isinstance(alone, EstimationFailed):
            return alone
        good = np.array([isinstance(r, Resection) for r in alone.resections])
        still = np.flatnonzero(good & ~o.knows_motion)
        if "time_offset" in self.extra and len(still):
            return EstimationFailed(
                f"the velocity of {len(still)} images is not known, the first is {o.images[still[0]]}",
                ("Give velocities and rates in the list of images.",),
            )
        points = o.points.select(good[o.points.image])
        found = boresight_from_gcps(o.camera, points, o.control, o.navigation, o.nominal, self.extra)
        if isinstance(found, EstimationFailed):
            return found
        return BoresightResult.of(
            o,
            names=found.names,
            x=found.x,
            cov=found.cov,
            common=found.common,
            by_image=np.full((len(o.images), 3), np.nan),
            sigma_by_image=np.full((len(o.images), 3), np.nan),
            T_wc=_poses(len(o.images), {int(i): found.T_wc[i] for i in np.flatnonzero(good)}),
            X_w=np.where(np.isfinite(found.X_w), found.X_w, o.control.X_w),
            rejected=_marked(o, {(int(image), int(point)) for image, point in found.rejected}),
            left_out=_failures(o, alone.resections),
            inseparable=found.inseparable,
            sigma_0=found.sigma_0,
            redundancy=found.redundancy,
            runtime_s=time.perf_counter() - started,
        )


CALIBRATION_ESTIMATORS: dict[str, type[Any]] = {
    "boresight_adjustment": OneAdjustment,
    "boresight_per_image": ImageByImage,
}


def _poses(images: int, known: dict[int, Pose]) -> Pose:
    """Poses of all images, NaN where none is known."""
    R, t = np.full((images, 3, 3), np.nan), np.full((images, 3), np.nan)
    for i, T_wc in known.items():
        R[i], t[i] = T_wc.R, T_wc.t
    return Pose(R, t)


def _marked(o: BoresightObservations, pairs: set[tuple[int, int]]) -> Array:
    """Which clicks are of these (image, point)."""
    return np.array([pair in pairs for pair in zip(o.points.image.tolist(), o.points.point.tolist(), strict=True)])


def _failures(o: BoresightObservations, resections: tuple[Resection | EstimationFailed, ...]) -> tuple[str, ...]:
    return tuple(f"{o.images[i]}: {r.reason}" for i, r in enumerate(resections) if isinstance(r, EstimationFailed))


def _image_covariances(
    o: BoresightObservations, angles: Float[Array, "m 3"], resections: dict[int, Resection], fixed_position: bool
) -> Float[Array, "m 3 3"]:
    """Covariance of the boresight angles of each image alone [rad²]: clicks, control points, navigation; else NaN.

    Of the resection's estimate ``dx = H dl`` with ``C_ll = sigma² I + sigma_gcp² B B' (+ A_t C_tt A_t')``, to which the
    attitude of the navigation comes in body axes.
    """
    n, p = o.navigation, o.points
    attitude = np.linalg.inv(n.weights()[:, :3, :3]) / (1 - n.constant_share)
    found = np.full((len(o.images), 3, 3), np.nan)
    columns = 3 if fixed_position else 6
    for i, r in resections.items():
        rows = (p.image == i) & ~np.isin(p.point, r.rejected)
        at = linearise(o.camera, Pose(r.T_wc.R[None], r.T_wc.t[None]), o.control.X_w[p.point[rows]])
        A, B = at.A.reshape(-1, 6), at.B
        C_ll = p.sigma_px**2 * np.eye(len(A))
        k = np.arange(len(B))
        C_ll.reshape(len(B), 2, len(B), 2)[k, :, k, :] += o.control.sigma_m**2 * B @ np.swapaxes(B, 1, 2)
        if fixed_position:
            C_ll += (A[:, 3:] * n.sigma_position_m**2) @ A[:, 3:].T
        H = np.linalg.pinv(A[:, :columns])[:3]
        R_bc = n.T_wb.R[i].T @ r.T_wc.R
        T = angle_jacobian(Mounting(angles[i], o.nominal.lever_b))
        found[i] = T @ (R_bc @ H @ C_ll @ H.T @ R_bc.T + attitude[i]) @ T.T
    return found
