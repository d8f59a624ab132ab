"""What a calibration of the boresight found, and how well every click fits it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from estimators.aerial.boresight import Inseparable
from estimators.aerial.boresight_model import Common
from estimators.aerial.boresight_observations import BoresightObservations
from sim import archive
from sim.angles import Mounting
from sim.archive import freeze_fields
from sim.pose import Pose

Array = np.ndarray
_FILE = "boresight.npz"


@dataclass(frozen=True, eq=False)
class BoresightResult:
    """Boresight of a camera, with what else was estimated; images (m,) and clicks (k,) are those of the observations.

    names (c,), x (c,), cov (c, c): omega, phi, kappa [rad], then those asked for of lever arm [m], time offset [s],
    GNSS offset [m]; ``common`` holds all of them. by_image (m, 3), sigma_by_image (m, 3) [rad] are the angles of every
    image alone, NaN where there are none. Clicks: ``predicted`` (k, 2) [px] where navigation and the result put the
    point, minus the click (the source's measure, 3.3); ``adjusted`` (k, 2) the same by the pose that was adjusted to
    the image, NaN where it has none; rejected (k,) those taken for wrong. left_out lists images without a part in it,
    one line each. rms_px is the root mean square length of ``predicted`` over the clicks that took part.
    """

    names: tuple[str, ...]
    x: Float[Array, "c"]
    cov: Float[Array, "c c"]
    common: Common
    by_image: Float[Array, "m 3"]
    sigma_by_image: Float[Array, "m 3"]
    predicted: Float[Array, "k 2"]
    adjusted: Float[Array, "k 2"]
    rejected: Bool[Array, "k"]
    left_out: tuple[str, ...]
    inseparable: tuple[Inseparable, ...]
    rms_px: float
    sigma_0: float
    redundancy: int
    runtime_s: float

    def __post_init__(self) -> None:
        freeze_fields(self)

    @property
    def sigma(self) -> Float[Array, "c"]:
        return np.asarray(np.sqrt(np.diag(self.cov)))

    @property
    def used(self) -> Bool[Array, "k"]:
        """Clicks that took part."""
        return np.asarray(np.isfinite(self.adjusted).all(axis=1) & ~self.rejected)

    @staticmethod
    def of(
        observations: BoresightObservations,
        *,
        common: Common,
        T_wc: Pose,
        X_w: Float[Array, "n 3"],
        rejected: Bool[Array, "k"],
        **others: Any,
    ) -> BoresightResult:
        """Residuals from the common unknowns, and from adjusted poses (m,) (NaN: none) and points."""
        o, p = observations, observations.points
        by_navigation = common.camera_poses(o.navigation)[p.image].inv()
        predicted = o.camera.project(by_navigation.apply(o.control.X_w[p.point])) - p.uv
        adjusted = o.camera.project(T_wc[p.image].inv().apply(X_w[p.point])) - p.uv
        used = np.isfinite(adjusted).all(axis=1) & ~rejected
        rms_px = float(np.sqrt(np.mean(np.sum(predicted[used] ** 2, axis=1))))
        return BoresightResult(
            common=common, predicted=predicted, adjusted=adjusted, rejected=rejected, rms_px=rms_px, **others
        )

    def save(self, folder: Path) -> None:
        archive.save(folder / _FILE, self)

    @staticmethod
    def load(folder: Path) -> BoresightResult:
        """Raises ValueError where the folder holds none."""
        f = archive.load(folder / _FILE)
        c = f["common"]
        f["common"] = Common(Mounting(**c["mounting"]), c["time_offset_s"], c["gnss_offset_w"])
        f["inseparable"] = tuple(Inseparable(tuple(g["names"]), g["correlation"]) for g in f["inseparable"])
        return BoresightResult(**(f | {name: tuple(f[name]) for name in ("names", "left_out")}))
