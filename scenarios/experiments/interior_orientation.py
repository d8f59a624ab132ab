"""Interior orientation from images of a calibration wall, measured or photographed (Kozempel 2012, 3.2, Fig. 3.3)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float

from estimators.aerial.image_error import displacements, image_rays, unturned
from estimators.aerial.interior_orientation import (
    NAMES,
    InteriorOrientation,
    calibrate,
    camera_of,
    detect_board,
    interior_jacobian,
    parameters,
)
from estimators.aerial.resection import ImagePoints
from estimators.estimate import EstimationFailed
from scenarios.experiments.steps import check_range
from sim.calibration_wall import Wall, photograph, viewpoints
from sim.camera import Camera
from sim.camera_systems import antar
from sim.pose import Pose
from sim.streams import stream

Array = np.ndarray
SIZE_PX = antar().heads[0].camera.size_px
PAIRS = (("f", "k1"), ("k1", "k2"), ("k2", "k3"), ("cx", "p2"), ("cy", "p1"))
"""Parameters whose correlations are recorded."""
_DISTANCE_M = (4.0, 6.5)
_NOMINAL_SHARE = 0.95
Row = tuple[str, float]


@dataclass(frozen=True)
class WallCalibration:
    """ANTAR's camera with a lens of some 7 px of distortion in the corners; images of a flat or deep wall.

    Corners are measured with normal noise, or found by OpenCV in rendered photographs.
    """

    images: int = 12
    tilt_deg: float = 30.0
    """Of every image against the wall's normal, into directions that go round."""
    depth_m: float = 0.0
    """How far two of the four boards stand before the others; 0 is a flat wall."""
    sigma_px: float = 0.03
    """Noise of a measured corner, and what is stated of one."""
    photographs: bool = False
    focal_px: float = 2502.0
    principal_px: tuple[float, float] = (3.5, -4.0)
    """From the image's middle."""
    radial: tuple[float, float, float] = (-0.12, 0.08, 0.05)
    decentring: tuple[float, float] = (4e-4, -3e-4)
    affinity_px: tuple[float, float] = (4.0, 1.5)
    """B1, B2 of (3.9), times the focal length."""

    def __post_init__(self) -> None:
        check_range("images", self.images, 1, 100)
        check_range("tilt_deg", self.tilt_deg, 0, 50)
        check_range("depth_m", self.depth_m, 0, 2)
        check_range("sigma_px", self.sigma_px, 1e-6, 10)
        check_range("focal_px", self.focal_px, 1500, 1e4)

    @property
    def cases(self) -> tuple[str, ...]:
        """One adjustment."""
        return ("adjustment",)

    @property
    def camera(self) -> Camera:
        """The true camera."""
        (k1, k2, k3), (p1, p2) = self.radial, self.decentring
        cx, cy = (np.array(SIZE_PX) - 1) / 2 + self.principal_px
        return camera_of(np.array([self.focal_px, *self.affinity_px, cx, cy, k1, k2, k3, p1, p2]), SIZE_PX)

    def __call__(self, seed: int, run: int) -> pd.DataFrame:
        """Rows after so many images.

        failed: whether there was no result. points: corners used; corner_noise: their true RMS in a coordinate [px].
        Of every parameter its error and formal sigma; correlations of `PAIRS`; nees of all ten (over ten); sigma_0.
        image_error, image_sigma: RMS of the error of projected directions over the image, true and formal [px];
        image_largest, and largest_turned after the rotation that takes most of it away, which a boresight would [px].
        """
        wall, truth = Wall(self.depth_m), self.camera
        poses = viewpoints(
            self.images, np.deg2rad(self.tilt_deg), _DISTANCE_M, stream(seed, run, "calibration_wall/poses")
        )
        noise = stream(seed, run, "calibration_wall/noise")
        X, true = wall.corners_m, _seen(truth, poses, wall.corners_m)
        points = self._found(wall, poses, noise) if self.photographs else self._measured(true, noise)
        nominal = Camera.simple(SIZE_PX, _NOMINAL_SHARE * self.focal_px)
        found = calibrate(points, X, nominal)
        error = points.uv - true[points.image, points.point]
        rows: list[Row] = [
            ("failed", float(isinstance(found, EstimationFailed))),
            ("points", float(len(points))),
            ("corner_noise", float(np.sqrt(np.mean(error**2)))),
        ]
        if isinstance(found, InteriorOrientation):
            rows += _judged(found, truth)
        return pd.DataFrame(rows, columns=["quantity", "value"]).assign(estimator=self.cases[0], t_s=self.images)

    def _measured(self, true: Float[Array, "m n 2"], rng: np.random.Generator) -> ImagePoints:
        image, point = np.nonzero(self.camera.contains(true, 3.0))
        uv = true[image, point] + rng.normal(0, self.sigma_px, (len(image), 2))
        return ImagePoints(image, point, uv, self.sigma_px)

    def _found(self, wall: Wall, poses: Pose, rng: np.random.Generator) -> ImagePoints:
        """Corners of all boards in photographs."""
        pictures = [photograph(wall, self.camera, poses[k], rng) for k in range(self.images)]
        image, point, uv, first = [], [], [], 0
        for board in wall.boards:
            corners, X = detect_board(pictures, board.pattern, self.sigma_px)
            image.append(corners.image)
            point.append(first + corners.point)
            uv.append(corners.uv)
            first += len(X)
        return ImagePoints(np.concatenate(image), np.concatenate(point), np.concatenate(uv), self.sigma_px)


def _seen(camera: Camera, poses: Pose, X: Float[Array, "n 3"]) -> Float[Array, "m n 2"]:
    """Projections of the corners into all images."""
    T_cw = poses.inv()
    return camera.project(np.einsum("mij,nj->mni", T_cw.R, X) + T_cw.t[:, None])


def _judged(found: InteriorOrientation, truth: Camera) -> Iterator[Row]:
    x = found.x - parameters(truth)
    for name, error, sigma in zip(NAMES, x, found.sigma, strict=True):
        yield f"{name}_error", float(error)
        yield f"{name}_sigma", float(sigma)
    for a, b in PAIRS:
        yield f"{a}_{b}_correlation", float(found.correlation[NAMES.index(a), NAMES.index(b)])
    yield "nees", float(x @ np.linalg.solve(found.cov, x)) / len(x)
    yield "sigma_0", found.sigma_0
    rays = image_rays(truth)
    d = displacements(found.camera, truth, rays)
    G = interior_jacobian(truth, rays)
    yield "image_error", float(np.sqrt(np.mean(np.sum(d**2, axis=1))))
    yield "image_sigma", float(np.sqrt(np.mean(np.einsum("kij,jl,kil->k", G, found.cov, G))))
    yield "image_largest", float(np.linalg.norm(d, axis=1).max())
    yield "largest_turned", float(np.linalg.norm(unturned(truth, rays, d), axis=1).max())
