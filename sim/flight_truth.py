"""What is true of a flight, for reports alone: poses, calibration, ground, roads, vehicles, control points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from sim import archive
from sim.archive import freeze_fields, write_atomically
from sim.flight_camera import FlightCamera
from sim.pose import Pose
from sim.roads.database import MapErrors
from sim.terrain import ElevationGrid

Array = np.ndarray
_FILE, _VEHICLES = "flight.npz", "vehicles.parquet"
VEHICLE_COLUMNS = (
    *("image", "t_s", "vehicle", "kind", "x_m", "y_m", "z_m", "heading_deg", "speed_mps", "length_m", "width_m"),
    *("height_m", "u_px", "v_px", "pixels", "hidden"),
)


@dataclass(frozen=True, eq=False)
class FlightTruth:
    """The truth of each image (k,) and of the ground.

    t_s (k,) times of exposure; T_wb (k,) poses of the body and T_wc (k,) of the cameras, vibration included; cameras
    and their mountings as they are; terrain the ground; map_errors what is wrong with each
    feature of the estimators' road map (a reader joins pieces of one road);
    control (n, 3) signalised points [m]. ``vehicles`` has the columns VEHICLE_COLUMNS, one row per image and vehicle
    with pixels in it: the point on the ground below the vehicle's middle, heading clockwise from grid north, pixels
    seen and the share hidden by other things.
    """

    t_s: Float[Array, "k"]
    T_wb: Pose
    T_wc: Pose
    cameras: tuple[FlightCamera, ...]
    terrain: ElevationGrid
    map_errors: MapErrors
    control: Float[Array, "n 3"]

    def __post_init__(self) -> None:
        freeze_fields(self)

    def save(self, folder: Path, vehicles: pd.DataFrame) -> None:
        archive.save(folder / _FILE, self)
        write_atomically(folder / _VEHICLES, lambda p: vehicles.to_parquet(p, index=False))

    @staticmethod
    def load(folder: Path) -> tuple[FlightTruth, pd.DataFrame]:
        """The truth of a folder and its vehicles; raises ValueError where it holds none."""
        f: dict[str, Any] = archive.load(folder / _FILE)
        truth = FlightTruth(
            f["t_s"],
            Pose(**f["T_wb"]),
            Pose(**f["T_wc"]),
            tuple(FlightCamera.from_fields(c) for c in f["cameras"]),
            ElevationGrid.from_fields(f["terrain"]),
            MapErrors(**f["map_errors"]),
            f["control"],
        )
        return truth, pd.read_parquet(folder / _VEHICLES)
