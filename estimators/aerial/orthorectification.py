"""All images of a flight as ortho images and a mosaic for each camera: the estimator around `orthorectify`."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Int

from estimators.aerial.geotiff import read_geotiff, write_geotiff
from estimators.aerial.images import FlightImageError, read_image
from estimators.aerial.mosaic import Mosaic, union
from estimators.aerial.orthorectify import (
    METHODS,
    MapGrid,
    Method,
    Ortho,
    OrthoError,
    footprint,
    ground_sampling,
    orthorectify,
)
from estimators.estimate import EstimationFailed, Failure
from sim import archive
from sim.archive import freeze_fields
from sim.flight_observations import FlightObservations
from sim.pose import Pose

Array = np.ndarray
ORTHOS = "orthos"
_FILE = "orthos.npz"
# A mosaic is held in memory: 8 bytes a pixel.
_LARGEST_MOSAIC_PX = 2.5e8
_OVERVIEW_PX = 2400


@dataclass(frozen=True, eq=False)
class OrthoImages:
    """What was made of a flight: one ortho image per row, and the images that gave none.

    image (k,) index; grid (k, 5) as `MapGrid` has it; T_wc (k,) the poses that were used; seconds (k,) without reading
    and writing, those of the writing in written_s. failures: image in place of the frame, and why.
    """

    method: Method
    image: Int[Array, "k"]
    grid: Float[Array, "k 5"]
    T_wc: Pose
    seconds: Float[Array, "k"]
    written_s: Float[Array, "k"]
    failures: tuple[Failure, ...]

    def __post_init__(self) -> None:
        freeze_fields(self)

    def map_grid(self, row: int) -> MapGrid:
        x, y, gsd, columns, rows = self.grid[row].tolist()
        return MapGrid(x, y, gsd, int(columns), int(rows))

    def save(self, folder: Path) -> None:
        archive.save(folder / _FILE, self)

    @staticmethod
    def load(folder: Path) -> OrthoImages:
        f = archive.load(folder / _FILE)
        failures = tuple(Failure(r["frame"], r["reason"], tuple(r["hints"])) for r in f["failures"])
        return OrthoImages(
            f["method"], f["image"], f["grid"], Pose(**f["T_wc"]), f["seconds"], f["written_s"], failures
        )


@dataclass(frozen=True)
class Orthorectification:
    """Ortho images of a flight by measured position and attitude, as GeoTIFFs, and a mosaic of each camera
    (Kozempel 2012, 4.1).

    gsd_m: side of a pixel; by default that of (4.1) at the median height, in whole centimetres, one for each camera.
    """

    method: Method = "map"
    gsd_m: float | None = None
    cloud_optimised: bool = False
    mosaic: bool = True

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ValueError(f"method: expected one of {', '.join(METHODS)}, found {self.method!r}")
        if self.gsd_m is not None and not 0.005 <= self.gsd_m <= 100:
            raise ValueError(f"gsd_m: expected 0.005 to 100, found {self.gsd_m}")

    def __call__(
        self, observations: FlightObservations, source: Path, target: Path, advance: Callable[[], None]
    ) -> OrthoImages | EstimationFailed:
        """Reads the images of the folder ``source``, writes GeoTIFFs, mosaics and overviews into ``target``."""
        T_wc = observations.T_wc
        sampling = {c.name: self.gsd_m or self._sampling(observations, T_wc, c.name) for c in observations.cameras}
        (target / ORTHOS).mkdir(parents=True)
        rows: list[tuple[int, MapGrid, float, float]] = []
        failures = []
        for i, record in enumerate(observations.records):
            try:
                rows.append((i, *self._one(observations, source, target, i, T_wc[i], sampling[record.head])))
            except (OrthoError, FlightImageError) as error:
                failures.append(Failure(i, _plain(str(error), source)))
            advance()
        if not rows:
            return EstimationFailed(f"none of {len(observations)} images: {failures[0].reason}")
        if self.mosaic:
            for camera in observations.cameras:
                own = [r for r in rows if observations.records[r[0]].head == camera.name]
                reason = _write_mosaic(observations, T_wc, own, target, camera.name) if own else None
                failures += [] if reason is None else [Failure(-1, reason)]
        image, grids, seconds, written = (list(column) for column in zip(*rows, strict=True))
        grid = np.array([[g.x_m, g.y_m, g.gsd_m, g.columns, g.rows] for g in grids], float)
        made = np.array(image, int)
        return OrthoImages(
            self.method, made, grid, T_wc[made], np.array(seconds, float), np.array(written, float), tuple(failures)
        )

    def _sampling(self, observations: FlightObservations, T_wc: Pose, name: str) -> float:
        own = np.array([r.head == name for r in observations.records])
        if not own.any():
            return 1.0
        terrain = observations.terrain
        below = np.nan_to_num(terrain.height(T_wc.t[own, :2]), nan=(terrain.lowest_m + terrain.highest_m) / 2)
        camera = next(c.camera for c in observations.cameras if c.name == name)
        return max(round(ground_sampling(float(np.median(T_wc.t[own, 2] - below)), camera), 2), 0.01)

    def _one(
        self, observations: FlightObservations, source: Path, target: Path, i: int, T_wc: Pose, gsd_m: float
    ) -> tuple[MapGrid, float, float]:
        record = observations.records[i]
        image = read_image(source, record)
        start = time.perf_counter()
        camera = observations.camera(i).camera
        grid = MapGrid.around(footprint(camera, T_wc, observations.terrain)[:, :2], gsd_m)
        ortho = orthorectify(image, camera, T_wc, observations.terrain, method=self.method, grid=grid)
        done = time.perf_counter()
        path = target / ORTHOS / Path(record.file).with_suffix(".tif").name
        write_geotiff(path, ortho, observations.georeference, self.cloud_optimised)
        return grid, done - start, time.perf_counter() - done


def _plain(reason: str, folder: Path) -> str:
    """The reason without the folder, which is another one tomorrow."""
    return reason.replace(f"{folder}{'/'}", "")


def _write_mosaic(
    observations: FlightObservations,
    T_wc: Pose,
    rows: list[tuple[int, MapGrid, float, float]],
    target: Path,
    camera: str,
) -> str | None:
    """Mosaic and overview of one camera's ortho images; why there is none."""
    grid = union(g for _, g, _, _ in rows)
    if grid.columns * grid.rows > _LARGEST_MOSAIC_PX:
        return (
            f"mosaic of {camera}: {grid.columns}x{grid.rows} pixels are more than {_LARGEST_MOSAIC_PX:.1e}; give gsd_m"
        )
    mosaic: Mosaic | None = None
    for i, *_ in rows:
        path = target / ORTHOS / Path(observations.records[i].file).with_suffix(".tif").name
        ortho = read_geotiff(path, observations.georeference)
        mosaic = mosaic or Mosaic(grid, ortho.image.shape[2])
        mosaic.add(ortho, T_wc.t[i, :2])
    assert mosaic is not None
    whole = mosaic.ortho()
    write_geotiff(target / f"mosaic-{camera}.tif", whole, observations.georeference)
    _write_overview(target / f"overview-{camera}.png", whole)
    return None


def _write_overview(path: Path, whole: Ortho) -> None:
    """The mosaic at no more than so many pixels a side, with alpha."""
    step = max(1.0, max(whole.alpha.shape) / _OVERVIEW_PX)
    size = (round(whole.grid.columns / step), round(whole.grid.rows / step))
    rgb = whole.image if whole.image.shape[2] == 3 else np.repeat(whole.image, 3, axis=2)
    bands = np.concatenate([rgb[:, :, ::-1], whole.alpha[:, :, None]], axis=2)
    cv2.imwrite(str(path), cv2.resize(bands, size, interpolation=cv2.INTER_AREA))
