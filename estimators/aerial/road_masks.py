"""Where in each image of a flight there can be vehicles: the road map drawn by the measured orientation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from estimators.aerial.orthorectify import OrthoError
from estimators.aerial.road_mask import mask_of_image
from estimators.estimate import EstimationFailed, Failure
from sim import archive
from sim.archive import freeze_fields
from sim.flight_observations import FlightObservations, read_road_map

Array = np.ndarray
MASKS = "masks"
_FILE = "masks.npz"


@dataclass(frozen=True, eq=False)
class RoadMasks:
    """What was made of a flight: image (k,) index and share (k,) of its pixels that are road; images without a mask."""

    image: Int[Array, "k"]
    share: Float[Array, "k"]
    failures: tuple[Failure, ...]

    def __post_init__(self) -> None:
        freeze_fields(self)

    def save(self, folder: Path) -> None:
        archive.save(folder / _FILE, self)

    @staticmethod
    def load(folder: Path) -> RoadMasks:
        f = archive.load(folder / _FILE)
        failures = tuple(Failure(r["frame"], r["reason"], tuple(r["hints"])) for r in f["failures"])
        return RoadMasks(f["image"], f["share"], failures)

    @staticmethod
    def is_in(folder: Path) -> bool:
        return (folder / _FILE).is_file()


def mask_file(folder: Path, image: str) -> Path:
    """The mask of an image, 255 where there is a road."""
    return folder / MASKS / Path(image).with_suffix(".png").name


def read_mask(folder: Path, image: str) -> UInt8[Array, "h w"]:
    path = mask_file(folder, image)
    mask = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if mask is None:
        raise OSError(f"{path}: cannot be read")
    return np.asarray(mask)


@dataclass(frozen=True)
class RoadMasking:
    """Road masks of a flight's images by the road map and RAS-Q widths (Kozempel 2012, 4.2).

    widening_m: more than the widths with their margins.
    """

    widening_m: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.widening_m <= 100:
            raise ValueError(f"widening_m: expected 0 to 100, found {self.widening_m}")

    def __call__(
        self, observations: FlightObservations, source: Path, target: Path, advance: Callable[[], None]
    ) -> RoadMasks | EstimationFailed:
        """Reads the road map of the folder ``source``, writes a PNG for every image into ``target``."""
        network = read_road_map(source, observations.georeference)
        (target / MASKS).mkdir(parents=True)
        T_wc = observations.T_wc
        made: list[tuple[int, float]] = []
        failures = []
        for i, record in enumerate(observations.records):
            camera = observations.camera(i).camera
            try:
                mask = mask_of_image(network, camera, T_wc[i], observations.terrain, self.widening_m).mask
                cv2.imwrite(str(mask_file(target, record.file)), mask)
                made.append((i, float(np.mean(mask > 0))))
            except OrthoError as error:
                failures.append(Failure(i, str(error)))
            advance()
        if not made:
            return EstimationFailed(f"none of {len(observations)} images: {failures[0].reason}")
        image, share = zip(*made, strict=True)
        return RoadMasks(np.array(image, int), np.array(share, float), tuple(failures))
