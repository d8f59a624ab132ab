"""How far check points in ortho images are from their true places, over passes and methods (Kozempel 2012, 4.1.2)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd

from estimators.aerial.orthorectify import (
    METHODS,
    MapGrid,
    Method,
    footprint,
    ground_points,
    ground_sampling,
    placed,
)
from scenarios.experiments.ortho_budget import GroundShifts, anchor_heights, random_variance
from scenarios.experiments.ortho_flight import SPEED_MPS, SYSTEMS, Overflights, Uncertainty, overfly
from scenarios.experiments.ortho_terrain import HALF_M, Dem, elevation_model, hills
from scenarios.experiments.steps import check_range
from sim.camera import Camera
from sim.flight_path import approaches
from sim.streams import stream
from sim.terrain import ElevationGrid

Array = np.ndarray
Row = tuple[str, str, float, float]
Source = Literal[
    "all", "none", "attitude", "position", "synchronisation", "boresight", "vibration", "interior", "clicks"
]
ZONES = (0.25, 0.5, 0.75, 1.0)
"""Distance from the middle of the image over half its diagonal: outer limits of zones."""
CELLS = (9, 6)
"""Columns and rows of pixels over the image whose errors run 0 tells one by one."""
# Way between two images of a pass, as a part of the image's shorter side.
_APART = 0.2


@dataclass(frozen=True)
class OrthoAccuracy:
    """Passes over one field of check points; every image is put on the map by all methods.

    Rows: ``ortho_...`` are errors on the ground [m], RMS of distances over all images, equally weighted. t_s is the
    number of a pass or an image from 1 on, the outer limit of a zone, or the number of a cell.
    """

    system: Literal["antar", "argos"] = "antar"
    """The camera system whose first head is flown."""
    height_m: float = 500.0
    """Above the mean ground."""
    errors: Source = "all"
    """Which of the sources of error there are."""
    dem: Dem = "exact"
    """What the heights of the ground are known from."""
    relief_m: float = 5.0
    """Standard deviation of the ground's height."""
    position_m: float = 0.3
    """GNSS, each axis."""
    vibration_deg: float = 0.08
    """Of the camera against the body, each axis."""
    headings_deg: tuple[float, ...] = (0.0, 90.0, 180.0)
    """Of the passes."""
    images: int = 3
    """Of every pass."""
    points: int = 400
    """Check points in the field, of which an image sees a part."""

    def __post_init__(self) -> None:
        check_range("height_m", self.height_m, 200, 1500)
        check_range("relief_m", self.relief_m, 0, 50)
        check_range("position_m", self.position_m, 0, 10)
        check_range("vibration_deg", self.vibration_deg, 0, 1)
        check_range("images", self.images, 1, 6)
        check_range("points", self.points, 50, 10_000)
        if not self.headings_deg:
            raise ValueError("headings_deg: should name one pass at least, found none")

    @property
    def cases(self) -> tuple[str, ...]:
        """The methods of orthorectification."""
        return METHODS

    @property
    def uncertainty(self) -> Uncertainty:
        """One sigma of what is not known."""
        return Uncertainty(position=self.position_m, vibration=self.vibration_deg).only(self.errors)

    @property
    def gsd_m(self) -> float:
        """Side of a pixel of the map, (4.1)."""
        return ground_sampling(self.height_m, SYSTEMS[self.system].heads[0].camera)

    def __call__(self, seed: int, run: int) -> pd.DataFrame:
        """Rows of every method.

        ortho: RMS over all; its squares are the sum of those of ortho_common (mean over all), ortho_passes (means of
        passes about it), ortho_images (means of images about their pass's) and ortho_within (points about their
        image's). ortho_pass, ortho_image, ortho_zone: of each. ortho_predicted: by linear propagation. ortho_lost: part
        of the check points that are not in the map. ortho_cell_x, _y: of the pixel _u, _v of the first image in run 0.
        """
        true = hills(self.relief_m, seed, run)
        dem = elevation_model(true, self.dem, seed, run)
        flown = self._flown(seed, run)
        field = self._field(true, flown.camera, seed, run)
        clicks = stream(seed, run, "ortho/clicks")
        sights = [_Sight(flown, k, true, dem, self.gsd_m, field) for k in range(len(flown))]
        noise = [self.uncertainty.clicks * self.gsd_m * clicks.standard_normal(s.uv.shape) for s in sights]
        random = [random_variance(s.shifts, flown, k, self.uncertainty, self.gsd_m) for k, s in enumerate(sights)]
        rows: list[Row] = []
        for method in METHODS:
            errors = [s.errors(method) + e for s, e in zip(sights, noise, strict=True)]
            rows += _pooled(method, errors, flown.line)
            rows += _zones(method, errors, sights)
            squares = [np.mean(s.predicted(method) + v) for s, v in zip(sights, random, strict=True)]
            rows.append((method, "ortho_predicted", 0, float(np.sqrt(np.mean(squares)))))
            if run == 0:
                rows += sights[0].cells(method)
        return pd.DataFrame(rows, columns=["estimator", "quantity", "t_s", "value"])

    def _flown(self, seed: int, run: int) -> Overflights:
        apart = _APART * self.gsd_m * min(SYSTEMS[self.system].heads[0].camera.size_px)
        length = apart * (self.images + 1)
        lines = approaches((0.0, 0.0), length, self.height_m, SPEED_MPS, self.headings_deg)
        return overfly(self.system, lines, self.images, self.uncertainty, seed, run)

    def _field(self, true: ElevationGrid, camera: Camera, seed: int, run: int) -> Array:
        half = min(0.6 * self.gsd_m * max(camera.size_px), 0.95 * HALF_M)
        return true.on_ground(stream(seed, run, "ortho/field").uniform(-half, half, (self.points, 2)))


class _Sight:
    """One image: the check points it sees, and where they come to lie."""

    def __init__(
        self, flown: Overflights, image: int, true: ElevationGrid, dem: ElevationGrid, gsd_m: float, field: Array
    ) -> None:
        self.true, self.dem = true, dem
        self.camera, self.T_wc = flown.camera, flown.T_wc[image]
        self.stated = flown.stated_camera, flown.stated_T_wc[image]
        self.grid = MapGrid.around(footprint(*self.stated, dem)[:, :2], gsd_m)
        uv = self.camera.project(self.T_wc.inv().apply(field))
        inside = self.camera.contains(uv)
        self.X, self.uv = field[inside], uv[inside]
        self.shifts = GroundShifts(self.camera, self.T_wc, self.X, true.normal(self.X[:, :2]))

    def errors(self, method: Method) -> Array:
        """Of the points' places (k, 2) [m]; NaN where the map does not hold them."""
        xy = placed(*self.stated, self.dem, self.uv, method, self.grid)
        return np.asarray(xy - self.X[:, :2])

    def predicted(self, method: Method) -> Array:
        """Squares of them (k,) by linear propagation, as far as heights and the method itself make them."""
        height = self.dem.height(self.X[:, :2])
        lens = np.zeros((len(self.X), 2))
        if method == "anchor":
            corner = ground_points(*self.stated, self.dem, _corners(self.camera))[:, 2]
            height = anchor_heights(corner, self.uv, self.camera.size_px)
            lens = self.shifts.seen_by(Camera(self.camera.K, self.camera.size_px))
        known = self.shifts.raised(height - self.X[:, 2]) + lens
        # Places in whole pixels are off by up to half of one in both axes.
        whole = self.grid.gsd_m**2 / 6 if method == "forward" else 0.0
        return np.asarray(np.sum(known**2, axis=-1) + whole)

    def cells(self, method: Method) -> Iterator[Row]:
        """Errors [m] at pixels spread over the image, without clicks."""
        uv = cell_pixels(self.camera.size_px)
        true = ground_points(self.camera, self.T_wc, self.true, uv)[:, :2]
        error = placed(*self.stated, self.dem, uv, method, self.grid) - true
        for quantity, values in zip("xyuv", [*error.T, *uv.T], strict=True):
            yield from ((method, f"ortho_cell_{quantity}", k, float(v)) for k, v in enumerate(values, 1))


def cell_pixels(size_px: tuple[int, int]) -> Array:
    """The middles of all cells of an image, row by row (k, 2)."""
    u, v = ((np.arange(n) + 0.5) * size / n - 0.5 for n, size in zip(CELLS, size_px, strict=True))
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def _corners(camera: Camera) -> Array:
    w, h = camera.size_px
    return np.array([[0, 0], [w - 1, 0], [w - 1, h - 1], [0, h - 1]], float)


def _pooled(method: str, errors: list[Array], line: Array) -> Iterator[Row]:
    """All, of each pass and image, and the nested parts of the whole."""
    means = np.array([np.nanmean(e, axis=0) for e in errors])
    squares = np.array([np.nanmean(np.sum(e**2, axis=-1)) for e in errors])
    of_pass = np.array([means[line == k].mean(axis=0) for k in range(line.max() + 1)])
    common = of_pass.mean(axis=0)
    parts = {
        "ortho": squares,
        "ortho_common": np.sum(common**2),
        "ortho_passes": np.sum((of_pass - common) ** 2, axis=-1),
        "ortho_images": np.sum((means - of_pass[line]) ** 2, axis=-1),
        "ortho_within": squares - np.sum(means**2, axis=-1),
    }
    for quantity, values in parts.items():
        yield method, quantity, 0, float(np.sqrt(np.mean(values)))
    for k in range(len(of_pass)):
        yield method, "ortho_pass", k + 1, float(np.sqrt(squares[line == k].mean()))
    for k, square in enumerate(squares, 1):
        yield method, "ortho_image", k, float(np.sqrt(square))
    yield method, "ortho_lost", 0, float(np.mean(np.isnan(np.concatenate(errors)[:, 0])))


def _zones(method: str, errors: list[Array], sights: list[_Sight]) -> Iterator[Row]:
    square = np.sum(np.concatenate(errors) ** 2, axis=-1)
    half = (np.array(sights[0].camera.size_px) - 1) / 2
    radius = np.linalg.norm(np.concatenate([s.uv for s in sights]) - half, axis=-1) / np.hypot(*half)
    for inner, outer in zip((0.0, *ZONES), ZONES, strict=False):
        chosen = square[(radius > inner) & (radius <= outer)]
        if np.isfinite(chosen).any():
            yield method, "ortho_zone", outer, float(np.sqrt(np.nanmean(chosen)))
