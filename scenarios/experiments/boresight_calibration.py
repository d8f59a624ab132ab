"""Boresight from control points: image by image, by one adjustment, and by one without poses of the images' own.

Kozempel 2012, 3.3: the angles of single images scatter by 0.05 to 0.12 degrees (Fig. 3.7), and control points projected
with their mean are off by 5 to 6 px.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pandas as pd

from estimators.aerial.boresight import (
    BoresightEstimate,
    BoresightPerImage,
    boresight_from_gcps,
    boresight_per_image,
)
from estimators.aerial.boresight_model import Navigation
from scenarios.experiments.calibration_flight import ANGLES, CalibrationFlight, CalibrationPlan, calibration_flight
from sim.angles import Mounting

Array = np.ndarray
Row = tuple[str, str, float, float]
Way = Literal["per image", "one adjustment", "without own poses"]
PER_IMAGE: Way = "per image"
ADJUSTED: Way = "one adjustment"
NO_POSES: Way = "without own poses"
# Navigation of a thousandth of its sigmas leaves the images no poses of their own.
_EXACT = 1e-3


@dataclass(frozen=True)
class BoresightCalibration(CalibrationPlan):
    """The boresight of a calibration flight in one way or several."""

    ways: tuple[Way, ...] = (PER_IMAGE, ADJUSTED, NO_POSES)
    """The mean of every image's; by one adjustment; by one in which navigation counts as exact."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.ways or len(set(self.ways)) < len(self.ways):
            raise ValueError(f"ways: should name one at least and none twice, found {list(self.ways)}")

    @property
    def cases(self) -> tuple[str, ...]:
        """The ways."""
        return self.ways

    def __call__(self, seed: int, run: int) -> pd.DataFrame:
        """Rows of every way, angles in degrees.

        boresight_<angle>: error; boresight_sigma_<angle>: what is stated of it; boresight_nees per degree of freedom;
        boresight_px: RMS distance of control points projected by navigation and the boresight found;
        boresight_failed. Image by image, t_s its number from 1 on: boresight_image_<angle> minus the true one,
        boresight_heading, boresight_image_px with the mean of all; boresight_scatter_<angle> of an image.
        """
        f = calibration_flight(self, seed, run)
        rows = [row for way in self.ways for row in _found(way, f)]
        return pd.DataFrame(rows, columns=["estimator", "quantity", "t_s", "value"])


def _found(way: Way, f: CalibrationFlight) -> Iterator[Row]:
    args = f.camera, f.points, f.control
    if way == PER_IMAGE:
        return _per_image(f)
    if way == ADJUSTED:
        return _adjusted(way, boresight_from_gcps(*args, f.navigation, f.nominal), f, scaled=False)
    return _adjusted(way, boresight_from_gcps(*args, without_error(f.navigation), f.nominal), f, scaled=True)


def without_error(navigation: Navigation) -> Navigation:
    """Navigation that claims to be exact."""
    return replace(
        navigation,
        sigma_rph=_EXACT * navigation.sigma_rph,
        sigma_position_m=_EXACT * navigation.sigma_position_m,
        constant_share=0.0,
        vibration=0.0,
    )


def _per_image(f: CalibrationFlight) -> Iterator[Row]:
    found = boresight_per_image(f.camera, f.points, f.control, f.navigation, f.nominal)
    if not isinstance(found, BoresightPerImage):
        yield PER_IMAGE, "boresight_failed", 0, 1.0
        return
    true = f.truth.mounting.boresight
    count = np.count_nonzero(np.isfinite(found.angles[:, 0]))
    yield from _errors(PER_IMAGE, found.mean - true, np.diag(found.scatter**2) / count)
    off = np.rad2deg(found.angles - true)
    px = distances(f, Mounting(found.mean, f.nominal.lever_b))
    yield PER_IMAGE, "boresight_px", 0, float(np.sqrt(np.mean(px**2)))
    for i, image in enumerate(off):
        yield PER_IMAGE, "boresight_heading", i + 1, float(f.heading_deg[i])
        own = px[f.points.image == i]
        if np.isfinite(image).all():
            yield PER_IMAGE, "boresight_image_px", i + 1, float(np.sqrt(np.mean(own**2)))
            yield from ((PER_IMAGE, f"boresight_image_{a}", i + 1, v) for a, v in zip(ANGLES, image, strict=True))
    for angle, scatter in zip(ANGLES, np.rad2deg(found.scatter), strict=True):
        yield PER_IMAGE, f"boresight_scatter_{angle}", 0, float(scatter)


def distances(f: CalibrationFlight, mounting: Mounting) -> Array:
    """Of the clicked points (k,) from where navigation and a boresight project them [px]."""
    T_wc = (f.navigation.T_wb @ mounting.T_bc)[f.points.image]
    uv = f.camera.project(T_wc.inv().apply(f.control.X_w[f.points.point]))
    return np.asarray(np.linalg.norm(uv - f.points.uv, axis=1))


def _adjusted(case: str, found: object, f: CalibrationFlight, scaled: bool) -> Iterator[Row]:
    """``scaled``: the covariance by the variance factor, as is usual where nothing is known of the errors' sizes."""
    if not isinstance(found, BoresightEstimate):
        yield case, "boresight_failed", 0, 1.0
        return
    factor = found.sigma_0**2 if scaled else 1.0
    yield from _errors(case, found.x[:3] - f.truth.mounting.boresight, factor * found.cov[:3, :3])
    yield case, "boresight_px", 0, found.rms_px


def _errors(case: str, error: Array, cov: Array) -> Iterator[Row]:
    yield case, "boresight_failed", 0, 0.0
    yield case, "boresight_nees", 0, float(error @ np.linalg.solve(cov, error)) / len(error)
    for angle, e, sigma in zip(ANGLES, np.rad2deg(error), np.rad2deg(np.sqrt(np.diag(cov))), strict=True):
        yield case, f"boresight_{angle}", 0, float(e)
        yield case, f"boresight_sigma_{angle}", 0, float(sigma)
