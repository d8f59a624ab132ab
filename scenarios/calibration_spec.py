"""The file of a calibration: clicked control points, images with their navigation, a camera and its mounting."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from estimators.aerial.boresight_estimators import CALIBRATION_ESTIMATORS
from scenarios import spec
from sim.angles import Mounting
from sim.camera import Camera
from sim.scenario import Focal, Name, Point2, Positive, Spec
from sim.scenario.language import Coefficient, Coordinate, Degrees

Pixels = Annotated[int, Field(ge=16, le=65535)]
Triple = tuple[Degrees, Degrees, Degrees]
Sigma = Annotated[float, Field(gt=0, le=180)]


class CalibrationFiles(Spec):
    """What was measured."""

    gcp_list: Path
    """Clicked control points in ODM's form."""
    images: Path
    """Time, position and attitude of every image: a CSV with a head line, or the JSON of a simulated flight."""
    heading: Literal["true", "grid"]
    """Which north the headings refer to; a true one is turned by the meridian convergence."""
    head: Name | None = None
    """Which camera's images, where the list has those of several."""
    undulation_m: Annotated[float, Field(ge=-110, le=110)] = 0.0
    """Height of the geoid over the ellipsoid, where the control points' heights refer to the geoid."""

    @model_validator(mode="before")
    @classmethod
    def _says_which_north(cls, data: Any) -> Any:
        if isinstance(data, dict) and "heading" not in data:
            raise ValueError(
                'heading: say which north the images\' headings refer to, "true" or "grid"; a true heading is turned '
                "by the meridian convergence"
            )
        return data


class NominalCamera(Spec):
    """Interior orientation, held as known."""

    size_px: tuple[Pixels, Pixels]
    focal_px: Focal
    principal_px: Point2 | None = None
    """Principal point; the image centre by default."""
    distortion: tuple[Coefficient, Coefficient, Coefficient, Coefficient, Coefficient] = (0, 0, 0, 0, 0)
    """Brown coefficients k1, k2, p1, p2, k3 in OpenCV's order."""

    @model_validator(mode="after")
    def _has_rays(self) -> NominalCamera:
        w, h = self.size_px
        corners = np.array([[-0.5, -0.5], [w - 0.5, -0.5], [-0.5, h - 0.5], [w - 0.5, h - 0.5]])
        if not np.isfinite(self.build().normalise(corners)).all():
            raise ValueError(f"distortion: {list(self.distortion)} folds the image before its corners")
        return self

    def build(self) -> Camera:
        plain = Camera.simple(self.size_px, self.focal_px, self.principal_px)
        return Camera(plain.K, self.size_px, np.array(self.distortion, float))


class NominalMounting(Spec):
    """How the camera sits on the aircraft, as far as is known."""

    boresight_deg: Triple
    """omega, phi, kappa of (3.19): where the estimation starts."""
    lever_b_m: tuple[Coordinate, Coordinate, Coordinate] = (0.0, 0.0, 0.0)
    """The projection centre seen from the IMU: forward, right, down."""

    def build(self) -> Mounting:
        return Mounting(np.deg2rad(self.boresight_deg), np.array(self.lever_b_m))


class Stated(Spec):
    """Standard deviations, by default those of Table 3.1 and of careful clicks."""

    sigma_px: Positive = 0.5
    """Of each coordinate of a click."""
    sigma_gcp_m: Positive = 0.02
    """Of each coordinate of a control point."""
    sigma_position_m: tuple[Positive, Positive, Positive] = (0.05, 0.05, 0.10)
    """East, north, up."""
    sigma_attitude_deg: tuple[Sigma, Sigma, Sigma] = (0.008, 0.008, 0.015)
    """Roll, pitch, heading, of the camera: with its vibration against the IMU."""
    constant_share: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Share of the variances of navigation that is the same in all images."""


class EarlierBoresight(Spec):
    """What the result is held against: an earlier calibration, or the truth of a simulation."""

    boresight_deg: Triple
    source: str = "an earlier calibration"


class CalibrationSpec(Spec):
    """A calibration without its estimators."""

    title: str
    source: str = ""
    kind: Literal["calibration"]
    calibration: CalibrationFiles
    camera: NominalCamera
    mounting: NominalMounting
    stated: Stated = Stated()
    reference: EarlierBoresight | None = None

    @property
    def seed(self) -> int:
        """Nothing is drawn; the number only names the folder."""
        return 1


@functools.cache
def calibration_model() -> type[CalibrationSpec]:
    """The model of a calibration's file with the estimators for calibrations."""
    one = spec.estimator_type(CALIBRATION_ESTIMATORS)

    class Run(CalibrationSpec):
        """A calibration's file: clicks, images, camera, mounting and estimators."""

        estimator: Annotated[tuple[one, ...], Field(min_length=1)]  # type: ignore[valid-type]  # made above

        @model_validator(mode="after")
        def _unique_labels(self) -> Run:
            spec.check_labels(self.estimator)
            return self

        @property
        def without_estimators(self) -> CalibrationSpec:
            return CalibrationSpec(**{name: getattr(self, name) for name in CalibrationSpec.model_fields})

    Run.__name__ = "Calibration"
    return Run
