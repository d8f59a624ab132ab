"""What a calibration of the boresight may know: clicked control points, navigation of the exposures, nominal values."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from estimators.aerial.boresight import ControlPoints
from estimators.aerial.boresight_model import Navigation
from estimators.aerial.resection import ImagePoints
from sim import archive
from sim.angles import Mounting
from sim.archive import freeze_fields
from sim.camera import Camera
from sim.geodesy import Georeference
from sim.pose import Pose

Array = np.ndarray
_FILE = "boresight.npz"


@dataclass(frozen=True, eq=False)
class BoresightObservations:
    """Clicks in m exposures of one camera over n control points; the world frame is that of ``georeference``.

    images (m,) in the order of time and names (n,) of the control points; navigation has one record per exposure, whose
    velocity and rate are zero where ``knows_motion`` (m,) is false. excluded lists, one line each, what was left out
    and why.
    """

    georeference: Georeference
    camera: Camera
    images: tuple[str, ...]
    names: tuple[str, ...]
    points: ImagePoints
    control: ControlPoints
    navigation: Navigation
    knows_motion: Bool[Array, "m"]
    nominal: Mounting
    excluded: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_fields(self)

    def save(self, folder: Path) -> None:
        archive.save(folder / _FILE, self)

    @staticmethod
    def load(folder: Path) -> BoresightObservations:
        """Raises ValueError where the folder holds none."""
        f = archive.load(folder / _FILE)
        georeference, navigation = f["georeference"], f["navigation"]
        return BoresightObservations(
            Georeference(georeference["epsg"], tuple(georeference["origin_m"])),
            Camera.from_fields(f["camera"]),
            tuple(f["images"]),
            tuple(f["names"]),
            ImagePoints(**f["points"]),
            ControlPoints(**f["control"]),
            Navigation(**(navigation | {"T_wb": Pose(**navigation["T_wb"])})),
            f["knows_motion"],
            Mounting(**f["nominal"]),
            tuple(f["excluded"]),
        )
