"""What an estimator may know of a flight: images, their metadata, the navigation solution, nominal cameras, maps."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from sim import archive
from sim.archive import write_text
from sim.flight_camera import FlightCamera
from sim.geodesy import Georeference
from sim.navigation import ImageRecord, NavigationSolution
from sim.pose import Pose
from sim.roads import RoadNetwork
from sim.roads.files import read_roads, write_roads
from sim.terrain import ElevationGrid

Array = np.ndarray
IMAGES, ROADS, CONTROL = "images", "roads.geojson", "gcp_list.txt"
_FILE, _RECORDS = "flight.npz", "images.json"


@dataclass(frozen=True, eq=False)
class FlightObservations:
    """The measurements of one flight; the world frame is that of ``georeference``.

    cameras hold the *nominal* calibration; records (k,) one per image, in the order of time, whose ``file`` is relative
    to the folder `IMAGES`; navigation the solution with its *stated* sigmas; terrain the heights that are known. Beside
    them lie the road map (`roads`) and, where control points were signalised, their clicks in ODM's form (`CONTROL`).
    """

    system: str
    georeference: Georeference
    cameras: tuple[FlightCamera, ...]
    records: tuple[ImageRecord, ...]
    navigation: NavigationSolution
    terrain: ElevationGrid

    def __post_init__(self) -> None:
        names = [c.name for c in self.cameras]
        unknown = {r.head for r in self.records} - set(names)
        if unknown:
            raise ValueError(f"FlightObservations.records: head {sorted(unknown)[0]!r} is none of {', '.join(names)}")

    def __len__(self) -> int:
        return len(self.records)

    def camera(self, image: int) -> FlightCamera:
        """The camera that took an image."""
        head = self.records[image].head
        return next(c for c in self.cameras if c.name == head)

    @property
    def T_wc(self) -> Pose:
        """Measured poses (k,) of the cameras: navigation at the images' stamps and the nominal mountings."""
        stamps = np.array([r.t_s for r in self.records])
        T_wb = self.navigation.pose(stamps, self.georeference)
        T_bc = [self.camera(i).mounting.T_bc for i in range(len(self))]
        return T_wb @ Pose(np.stack([T.R for T in T_bc]), np.stack([T.t for T in T_bc]))

    def save(self, folder: Path, roads: RoadNetwork) -> None:
        """Writes all but the images, and the road map, into a folder."""
        stored = _Stored(self.system, self.georeference, self.cameras, self.navigation, self.terrain)
        archive.save(folder / _FILE, stored)
        write_text(folder / _RECORDS, json.dumps([asdict(r) for r in self.records], indent=1) + "\n")
        write_roads(roads, self.georeference, folder / ROADS)

    @staticmethod
    def load(folder: Path) -> FlightObservations:
        """Raises ValueError where the folder holds none."""
        f = archive.load(folder / _FILE)
        georeference = Georeference(f["georeference"]["epsg"], tuple(f["georeference"]["origin_m"]))
        return FlightObservations(
            f["system"],
            georeference,
            tuple(FlightCamera.from_fields(c) for c in f["cameras"]),
            tuple(ImageRecord(**r) for r in json.loads((folder / _RECORDS).read_text(encoding="utf-8"))),
            NavigationSolution(**f["navigation"]),
            ElevationGrid.from_fields(f["terrain"]),
        )


@dataclass(frozen=True, eq=False)
class _Stored:
    """What is stored as arrays."""

    system: str
    georeference: Georeference
    cameras: tuple[FlightCamera, ...]
    navigation: NavigationSolution
    terrain: ElevationGrid


def read_road_map(folder: Path, georeference: Georeference) -> RoadNetwork:
    """The road map beside the observations of a folder."""
    return read_roads(folder / ROADS, georeference).network
