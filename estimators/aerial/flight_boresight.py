"""The boresight of a flight's camera from its own images, by control or by tie points (Kozempel 2012, 3.3, 3.4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Int

from estimators.aerial import gcp_file
from estimators.aerial.boresight import (
    BoresightEstimate,
    BoresightPerImage,
    ControlPoints,
    boresight_from_gcps,
    boresight_per_image,
)
from estimators.aerial.boresight_model import Extra, Navigation
from estimators.aerial.boresight_ties import boresight_from_ties
from estimators.aerial.images import FlightImageError, read_image
from estimators.aerial.resection import ImagePoints
from estimators.aerial.tie_points import match_ties
from estimators.estimate import EstimationFailed
from sim import archive
from sim.archive import freeze_fields
from sim.flight_camera import FlightCamera
from sim.flight_observations import CONTROL, FlightObservations
from sim.pose import Pose

Array = np.ndarray
_FILE = "boresight.npz"
# Tie points need images that show the same ground: no farther apart than this share of the shorter side of one.
_NEAR = 0.6


@dataclass(frozen=True, eq=False)
class FlightBoresight:
    """The boresight of one camera and what else was adjusted with it.

    camera: its name; images (m,) that took part; names (c,), x (c,), cov (c, c): omega, phi, kappa [rad], then those
    asked for; per_image (m, 3) the angles of each image alone [rad], NaN where there are none; points (k, 3) adjusted
    points [m]; measured, rejected: how many image points; rms_px of points projected by navigation; sigma_0;
    inseparable and excluded in words.
    """

    camera: str
    images: Int[Array, "m"]
    names: tuple[str, ...]
    x: Float[Array, "c"]
    cov: Float[Array, "c c"]
    per_image: Float[Array, "m 3"]
    points: Float[Array, "k 3"]
    measured: int
    rejected: int
    rms_px: float
    sigma_0: float
    inseparable: tuple[str, ...]
    excluded: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_fields(self)

    def save(self, folder: Path) -> None:
        archive.save(folder / _FILE, self)

    @staticmethod
    def load(folder: Path) -> FlightBoresight:
        fields: dict[str, Any] = archive.load(folder / _FILE)
        words = {n: tuple(fields[n]) for n in ("names", "inseparable", "excluded")}
        return FlightBoresight(**(fields | words))

    @staticmethod
    def is_in(folder: Path) -> bool:
        return (folder / _FILE).is_file()


@dataclass(frozen=True)
class BoresightFromControl:
    """Boresight from control points clicked in all images, in one adjustment (Kozempel 2012, 3.3).

    What is stated of the clicks (sigma_px), of the points (sigma_gcp_m), of the camera's vibration against the IMU
    (vibration_deg), and which share of the variance of navigation is the same in all images.
    """

    extra: tuple[Extra, ...] = ()
    camera: str | None = None
    sigma_px: float = 0.5
    sigma_gcp_m: float = 0.02
    vibration_deg: float = 0.0
    constant_share: float = 0.5

    def __post_init__(self) -> None:
        _check(self.sigma_px, self.constant_share)
        if not self.sigma_gcp_m > 0:
            raise ValueError(f"sigma_gcp_m: expected > 0, found {self.sigma_gcp_m}")
        if not 0 <= self.vibration_deg <= 5:
            raise ValueError(f"vibration_deg: expected 0 to 5, found {self.vibration_deg}")

    def __call__(
        self, observations: FlightObservations, source: Path, target: Path, advance: Callable[[], None]
    ) -> FlightBoresight | EstimationFailed:
        """Reads the clicks beside the observations in ``source``."""
        del target
        camera, images = _chosen(observations, self.camera)
        if not len(images):
            return EstimationFailed(f"no image of a camera {self.camera or camera.name!r}")
        path = source / CONTROL
        if not path.is_file():
            return EstimationFailed("no control points were clicked in this flight", ("Give control.points.",))
        files = [observations.records[i].file for i in images]
        clicks = gcp_file.in_world(gcp_file.read(path), files, camera.camera, observations.georeference, self.sigma_px)
        if not len(clicks.points):
            return EstimationFailed("no click lies in an image of this camera")
        control = ControlPoints(clicks.X_w, self.sigma_gcp_m)
        used, points = _with_points(images, clicks.points)
        navigation = _navigation(observations, used, self.constant_share, np.deg2rad(self.vibration_deg))
        per_image = boresight_per_image(camera.camera, points, control, navigation, camera.mounting)
        found = boresight_from_gcps(camera.camera, points, control, navigation, camera.mounting, self.extra)
        for _ in observations.records:
            advance()
        if isinstance(found, EstimationFailed):
            return found
        alone = per_image.angles if isinstance(per_image, BoresightPerImage) else np.full((len(used), 3), np.nan)
        return _result(camera.name, used, found, alone, points, clicks.excluded)


@dataclass(frozen=True)
class BoresightFromTies:
    """Boresight without control, from points matched in a few overlapping images (Kozempel 2012, 3.4).

    images: how many; the one in the middle of the flight and those near it that differ most in heading and place.
    """

    extra: tuple[Extra, ...] = ()
    camera: str | None = None
    images: int = 3
    points: int = 400
    sigma_px: float = 0.3
    constant_share: float = 0.5

    def __post_init__(self) -> None:
        _check(self.sigma_px, self.constant_share)
        if not 2 <= self.images <= 20:
            raise ValueError(f"images: expected 2 to 20, found {self.images}")
        if not 10 <= self.points <= 10_000:
            raise ValueError(f"points: expected 10 to 10000, found {self.points}")

    def __call__(
        self, observations: FlightObservations, source: Path, target: Path, advance: Callable[[], None]
    ) -> FlightBoresight | EstimationFailed:
        """Reads the chosen images of the folder ``source``."""
        del target
        camera, images = _chosen(observations, self.camera)
        if not len(images):
            return EstimationFailed(f"no image of a camera {self.camera or camera.name!r}")
        T_wc = observations.T_wc
        ground_m = float(np.median(observations.terrain.heights_m))
        chosen = overlapping(T_wc[images], camera, ground_m, self.images)
        if len(chosen) < 2:
            return EstimationFailed("no two images show the same ground", ("Fly overlapping lines.",))
        used = images[chosen]
        try:
            pictures = [_grey(read_image(source, observations.records[i])) for i in used.tolist()]
        except FlightImageError as error:
            return EstimationFailed(str(error).replace(f"{source}/", ""))
        points = match_ties(pictures, camera.camera, T_wc[used], ground_m, self.sigma_px, self.points)
        for _ in observations.records:
            advance()
        if isinstance(points, EstimationFailed):
            return points
        navigation = _navigation(observations, used, self.constant_share, 0.0)
        found = boresight_from_ties(camera.camera, points, navigation, camera.mounting, self.extra)
        if isinstance(found, EstimationFailed):
            return found
        return _result(camera.name, used, found, np.full((len(used), 3), np.nan), points, ())


def overlapping(T_wc: Pose, camera: FlightCamera, ground_m: float, count: int) -> Int[Array, "m"]:
    """Images near the one in the middle that differ most from each other in heading and place, in the order of time.

    Two images differ by the angle between them plus their distance over the height.
    """
    height = np.maximum(T_wc.t[:, 2] - ground_m, 1.0)
    middle = int(np.argmin(np.linalg.norm(T_wc.t[:, None, :2] - T_wc.t[:, :2], axis=2).sum(axis=1)))
    reach = _NEAR * float(height[middle]) * min(camera.camera.size_px) / float(camera.camera.K[0, 0])
    off = np.linalg.norm(T_wc.t[:, :2] - T_wc.t[middle, :2], axis=1)
    near = np.flatnonzero((off < reach) & (np.arange(len(off)) != middle))
    chosen = [middle]
    while len(near) and len(chosen) < count:
        across = T_wc.R[:, :2, 0] / np.linalg.norm(T_wc.R[:, :2, 0], axis=1, keepdims=True)
        turn = np.arccos(np.clip(across[near] @ across[chosen].T, -1, 1))
        apart = np.linalg.norm(T_wc.t[near][:, None, :2] - T_wc.t[chosen][None, :, :2], axis=2) / height[middle]
        best = int(np.argmax((turn + apart).min(axis=1)))
        chosen.append(int(near[best]))
        near = np.delete(near, best)
    return np.sort(np.array(chosen, int))


def _check(sigma_px: float, constant_share: float) -> None:
    if not sigma_px > 0:
        raise ValueError(f"sigma_px: expected > 0, found {sigma_px}")
    if not 0 <= constant_share < 1:
        raise ValueError(f"constant_share: expected 0 up to below 1, found {constant_share}")


def _chosen(observations: FlightObservations, name: str | None) -> tuple[FlightCamera, Int[Array, "m"]]:
    """A camera, by default the first, and its images; none where there is no such camera."""
    camera = next((c for c in observations.cameras if c.name == name), observations.cameras[0])
    own = [i for i, r in enumerate(observations.records) if r.head == (name or camera.name)]
    return camera, np.array(own, int)


def _with_points(images: Int[Array, "m"], points: ImagePoints) -> tuple[Int[Array, "q"], ImagePoints]:
    """Only the images that have points, and the points numbered by them."""
    has, index = np.unique(points.image, return_inverse=True)
    return images[has], replace(points, image=index)


def _navigation(
    observations: FlightObservations, images: Int[Array, "m"], constant_share: float, vibration: float
) -> Navigation:
    stamps = np.array([observations.records[i].t_s for i in images.tolist()])
    whole = Navigation.from_solution(observations.navigation, observations.georeference, constant_share)
    navigation = whole.at(stamps)
    return replace(navigation, vibration=vibration)


def _grey(image: Array) -> Array:
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))


def _result(
    camera: str,
    images: Int[Array, "m"],
    found: BoresightEstimate,
    per_image: Float[Array, "m 3"],
    points: ImagePoints,
    excluded: tuple[str, ...],
) -> FlightBoresight:
    return FlightBoresight(
        camera,
        images,
        found.names,
        found.x,
        found.cov,
        per_image,
        found.X_w[np.isfinite(found.X_w).all(axis=1)],
        len(points),
        len(found.rejected),
        found.rms_px,
        found.sigma_0,
        tuple(str(group) for group in found.inseparable),
        excluded,
    )
