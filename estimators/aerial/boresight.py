"""Boresight from ground control points: image by image, as the source does it, and in one adjustment of all images.

Kozempel 2012, 3.3: points known by DGPS are clicked in images from several directions; each image, resected, gives the
boresight angles (3.19)-(3.22); their scatter says how far to trust them (Fig. 3.7). One adjustment weighs images,
navigation and points by their stated sigmas, and can estimate lever arm, time offset and GNSS offset as well.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from estimators.aerial.boresight_adjustment import Adjusted, Block, Values, adjust
from estimators.aerial.boresight_model import Common, Extra, Navigation, angle_jacobian, unknowns
from estimators.aerial.resection import ImagePoints, Resection, resect
from estimators.estimate import EstimationFailed
from sim.angles import Mounting, boresight_angles
from sim.archive import freeze_fields
from sim.camera import Camera
from sim.pose import Pose, exp_so3, log_so3

Array = np.ndarray
# Eigenvalue of a normal matrix with unit diagonal below which a group of unknowns counts as inseparable: for a pair, a
# correlation of 0.99.
_INSEPARABLE = 0.01
# Share of the largest coefficient from which an unknown belongs to the group.
_BELONGS = 0.5


@dataclass(frozen=True, eq=False)
class ControlPoints:
    """Ground control: X_w (n, 3) [m] and the stated sigma_m of each coordinate.

    Raises
        ValueError: coordinates that are not finite, sigma_m <= 0.
    """

    X_w: Float[Array, "n 3"]
    sigma_m: float

    def __post_init__(self) -> None:
        freeze_fields(self)
        if not np.isfinite(self.X_w).all():
            raise ValueError("ControlPoints.X_w: expected finite coordinates")
        if not self.sigma_m > 0:
            raise ValueError(f"ControlPoints.sigma_m: expected > 0, got {self.sigma_m}")


@dataclass(frozen=True, eq=False)
class BoresightPerImage:
    """Boresight angles (omega, phi, kappa) [rad] of every image (m, 3), NaN where its resection failed.

    mean (3,) and scatter (3,), the standard deviation of one image. resections (m,) hold the poses, or why there is
    none.
    """

    angles: Float[Array, "m 3"]
    mean: Float[Array, "3"]
    scatter: Float[Array, "3"]
    resections: tuple[Resection | EstimationFailed, ...]

    def __post_init__(self) -> None:
        freeze_fields(self)


@dataclass(frozen=True)
class Inseparable:
    """Unknowns these images cannot tell apart, and the correlation of the first two.

    Rotations are named by body axes: roll about forward, pitch about right, yaw about down.
    """

    names: tuple[str, ...]
    correlation: float

    def __str__(self) -> str:
        return f"{' and '.join(self.names)} are not separable (correlation {self.correlation:.4f})"


@dataclass(frozen=True, eq=False)
class BoresightEstimate:
    """Boresight and other unknowns that all images share, adjusted together.

    names (c,), x (c,), cov (c, c): omega, phi, kappa [rad], then those asked for of lever arm [m], time offset [s],
    GNSS offset [m]; cov is that of the stated sigmas (variance factor 1), sigma_0 says how well they fit. ``common``
    also holds what was not asked for: as it was given, or the GNSS offset that a constant share of the errors makes.
    T_wc (m,) adjusted camera poses; X_w (n, 3) adjusted points, NaN where no image has them; residuals (k, 2) [px] of
    the measured points that were used; rejected (q, 2) image and point of those left out. rms_px is the root mean
    square distance of points projected by *navigation* and these unknowns (the source's measure; without control by the
    adjusted points). inseparable says what the images do not determine each by itself.
    """

    common: Common
    names: tuple[str, ...]
    x: Float[Array, "c"]
    cov: Float[Array, "c c"]
    inseparable: tuple[Inseparable, ...]
    T_wc: Pose
    X_w: Float[Array, "n 3"]
    residuals: Float[Array, "k 2"]
    rejected: Int[Array, "q 2"]
    rms_px: float
    sigma_0: float
    redundancy: int
    iterations: int

    def __post_init__(self) -> None:
        freeze_fields(self)


def boresight_per_image(
    camera: Camera,
    points: ImagePoints,
    control: ControlPoints,
    navigation: Navigation,
    nominal: Mounting,
    fixed_position: bool = True,
) -> BoresightPerImage | EstimationFailed:
    """Boresight angles of each image by resection, their mean and scatter (the source's way, Fig. 3.7).

    ``nominal`` starts the resections and holds the lever arm. By default positions are held at the navigation's, as in
    the source: of an angle of view of 23 degrees, position and attitude of one image are hardly separable.
    """
    start = Common(nominal).camera_poses(navigation)
    resections = resect(camera, points, control.X_w, start, fixed_position)
    done = [i for i, r in enumerate(resections) if isinstance(r, Resection)]
    if not done:
        reasons = sorted({r.reason for r in resections if isinstance(r, EstimationFailed)})
        return EstimationFailed("no image could be resected: " + "; ".join(reasons))
    R_wc = np.stack([r.T_wc.R for r in resections if isinstance(r, Resection)])
    R_bc = np.swapaxes(navigation.T_wb.R[done], 1, 2) @ R_wc
    angles = np.full((len(resections), 3), np.nan)
    angles[done] = boresight_angles(R_bc)
    middle = R_bc[0] @ exp_so3(np.mean(log_so3(R_bc[0].T @ R_bc), axis=0))
    mean = boresight_angles(middle)
    deviation = np.remainder(angles[done] - mean + np.pi, 2 * np.pi) - np.pi
    scatter = np.sqrt(np.sum(deviation**2, axis=0) / (len(done) - 1)) if len(done) > 1 else np.full(3, np.nan)
    return BoresightPerImage(angles, mean, scatter, resections)


def boresight_from_gcps(
    camera: Camera,
    points: ImagePoints,
    control: ControlPoints,
    navigation: Navigation,
    nominal: Mounting,
    extra: Iterable[Extra] = (),
) -> BoresightEstimate | EstimationFailed:
    """Boresight, and on request lever arm, time offset and GNSS offset, from one adjustment over all images.

    ``nominal`` starts the adjustment; what of it is not estimated is held. Wrong clicks are found by the resection of
    each image alone (`resection.resect`), which no error of navigation can disturb.
    """
    columns, names = unknowns(extra)
    per_image = boresight_per_image(camera, points, control, navigation, nominal)
    if isinstance(per_image, EstimationFailed):
        return per_image
    common = Common(Mounting(per_image.mean, nominal.lever_b))
    T_wc = common.camera_poses(navigation)
    wrong = _wrong_clicks(camera, points, control, T_wc)
    rejected = np.stack([points.image, points.point], axis=1)[wrong]
    points = points.select(~wrong)
    seen, point = np.unique(points.point, return_inverse=True)
    X = control.X_w[seen]
    block = Block(
        camera,
        replace(points, point=point),
        X,
        np.full(len(X), control.sigma_m),
        np.ones(len(points)),
        navigation,
        columns,
    )
    adjusted = adjust(block, Values(T_wc, X, common))
    if isinstance(adjusted, EstimationFailed):
        return adjusted
    X_w = np.full_like(control.X_w, np.nan)
    X_w[seen] = adjusted.values.X
    return estimate(block, adjusted, X, X_w, rejected, names)


def _wrong_clicks(camera: Camera, points: ImagePoints, control: ControlPoints, start: Pose) -> Array:
    wrong = np.zeros(len(points), bool)
    for i, r in enumerate(resect(camera, points, control.X_w, start)):
        if isinstance(r, Resection):
            wrong |= (points.image == i) & np.isin(points.point, r.rejected)
    return wrong


def estimate(
    block: Block, adjusted: Adjusted, X_check: Array, X_w: Array, rejected: Array, names: tuple[str, ...]
) -> BoresightEstimate:
    """The result of an adjustment: angles for body rotations, diagnosis, distances of X_check by navigation."""
    common, points = adjusted.values.common, block.points
    T = np.eye(len(names))
    T[:3, :3] = angle_jacobian(common.mounting)
    uv = block.camera.project(common.camera_poses(block.navigation)[points.image].inv().apply(X_check[points.point]))
    tie_points = int(np.count_nonzero(~np.isfinite(block.sigma_X)))
    redundancy = 2 * len(points) - 3 * tie_points - len(names)
    return BoresightEstimate(
        common,
        ("omega", "phi", "kappa", *names[3:]),
        common.values()[block.columns],
        T @ adjusted.cov @ T.T,
        diagnose(names, adjusted.cov),
        adjusted.values.T_wc,
        X_w,
        adjusted.residuals,
        rejected,
        float(np.sqrt(np.mean(np.sum((uv - points.uv) ** 2, axis=1)))),
        float(np.sqrt(adjusted.cost / redundancy)) if redundancy > 0 else float("nan"),
        redundancy,
        adjusted.iterations,
    )


def diagnose(names: tuple[str, ...], cov: Float[Array, "c c"]) -> tuple[Inseparable, ...]:
    """Groups of unknowns that only a small eigenvalue of the normal matrix with unit diagonal holds apart."""
    N = np.linalg.inv(cov)
    scale, sigma = np.sqrt(np.diag(N)), np.sqrt(np.diag(cov))
    values, vectors = np.linalg.eigh(N / np.outer(scale, scale))
    groups = []
    for vector in np.abs(vectors.T[values < _INSEPARABLE]):
        order = np.argsort(-vector, kind="stable")
        order = order[: max(2, np.count_nonzero(vector > _BELONGS * vector.max()))]
        a, b = order[:2]
        groups.append(Inseparable(tuple(names[i] for i in order), float(cov[a, b] / (sigma[a] * sigma[b]))))
    return tuple(groups)
