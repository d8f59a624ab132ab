"""Boresight of ARGOS without control points, from tie points of three images (Kozempel 2012, 3.4 and Fig. 3.9)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd

from estimators.aerial.boresight import BoresightEstimate
from estimators.aerial.boresight_model import Navigation
from estimators.aerial.boresight_ties import boresight_from_ties, intersect_rays
from estimators.aerial.resection import ImagePoints
from scenarios.experiments.calibration_flight import (
    ANGLES,
    NavigationKind,
    flown,
    misaligned,
    navigation_errors,
    recorded_navigation,
)
from scenarios.experiments.steps import check_range
from sim.angles import Mounting
from sim.camera import Camera
from sim.camera_systems import argos
from sim.flight import STILL, Shaking, true_camera_pose
from sim.flight_path import approaches
from sim.pose import Pose
from sim.streams import stream
from sim.terrain import Bounds, relief

Array = np.ndarray
Row = tuple[str, str, float, float]
START, ADJUSTED = "start values", "adjusted"
Layout = Literal["strip", "opposite", "crossing"]
LAYOUTS: dict[Layout, tuple[tuple[float, float], ...]] = {
    "strip": ((0.0, -0.15), (0.0, 0.0), (0.0, 0.15)),
    "opposite": ((0.0, -0.15), (0.0, 0.15), (180.0, 0.0)),
    "crossing": ((0.0, -0.15), (0.0, 0.15), (90.0, 0.0)),
}
"""Grid heading [deg] of every image, and how far beyond the middle it is taken, in heights."""
_GROUND: Bounds = (-1500.0, -1500.0, 1500.0, 1500.0)
_BORDER_PX = 10.0
# Where points that three images see are looked for, in heights about the middle.
_FIELD = 0.5
_CANDIDATES = 20_000


@dataclass(frozen=True)
class BoresightTies:
    """Three images of one place, points that were matched in all three, and no control."""

    layout: Layout = "opposite"
    """Three images of a strip; or two of one, the third flown the other way or across."""
    height_m: float = 1400.0
    """Above the mean ground."""
    points: int = 200
    """Matched in all three images."""
    matches_px: float = 0.3
    """Of a matched point, each axis."""
    wrong: float = 0.1
    """Part of the points that is matched wrongly in one image, by up to 100 px in each axis."""
    navigation: NavigationKind = "pos_av_410"
    """As of a calibration flight."""
    position_m: float = 0.1
    """GNSS, each axis."""
    start_off_deg: float = 1.0
    """By which every angle is off at the start, up or down."""
    relief_m: float = 15.0
    """Standard deviation of the ground's height."""
    speed_mps: float = 70.0
    """Over ground."""

    def __post_init__(self) -> None:
        check_range("height_m", self.height_m, 300, 3000)
        check_range("points", self.points, 10, 5000)
        check_range("matches_px", self.matches_px, 0.01, 20)
        check_range("wrong", self.wrong, 0, 0.5)
        check_range("position_m", self.position_m, 1e-3, 10)
        check_range("start_off_deg", self.start_off_deg, 0, 10)
        check_range("relief_m", self.relief_m, 0, 100)
        check_range("speed_mps", self.speed_mps, 30, 150)

    @property
    def cases(self) -> tuple[str, ...]:
        """With the boresight as it was at the start, and as found."""
        return START, ADJUSTED

    def __call__(self, seed: int, run: int) -> pd.DataFrame:
        """Rows of both: ties_position and ties_height, RMS errors of the points that are matched rightly [m].

        Of the adjustment boresight_<angle>, boresight_sigma_<angle> [deg], boresight_nees, boresight_failed, and
        ties_missed: part of the wrong points that was not left out.
        """
        return pd.DataFrame(self._rows(seed, run), columns=["estimator", "quantity", "t_s", "value"])

    def _rows(self, seed: int, run: int) -> Iterator[Row]:
        head = argos().heads[0]
        mounting = misaligned(head.mounting, seed, run)
        T_wc, navigation = self._flown(mounting, seed, run)
        X_w, points, wrong = self._matched(head.camera, T_wc, stream(seed, run, "ties/points"))
        up_or_down = stream(seed, run, "ties/start").choice([-1.0, 1.0], 3)
        start = Mounting(mounting.boresight + np.deg2rad(self.start_off_deg) * up_or_down, mounting.lever_b)
        good = np.setdiff1d(np.arange(len(X_w)), wrong)
        seen = intersect_rays(head.camera, points, navigation.T_wb @ start.T_bc, len(X_w))
        yield from _ground(START, (seen - X_w)[good])
        found = boresight_from_ties(head.camera, points, navigation, start)
        if not isinstance(found, BoresightEstimate):
            yield ADJUSTED, "boresight_failed", 0, 1.0
            return
        yield ADJUSTED, "boresight_failed", 0, 0.0
        error = found.x - mounting.boresight
        yield ADJUSTED, "boresight_nees", 0, float(error @ np.linalg.solve(found.cov, error)) / 3
        for angle, e, variance in zip(ANGLES, error, np.diag(found.cov), strict=True):
            yield ADJUSTED, f"boresight_{angle}", 0, float(np.rad2deg(e))
            yield ADJUSTED, f"boresight_sigma_{angle}", 0, float(np.rad2deg(np.sqrt(variance)))
        yield from _ground(ADJUSTED, (found.X_w - X_w)[good])
        if len(wrong):
            yield ADJUSTED, "ties_missed", 0, float(np.mean(~np.isin(wrong, found.rejected[:, 1])))

    def _flown(self, mounting: Mounting, seed: int, run: int) -> tuple[Pose, Navigation]:
        """True camera poses and the navigation of the images, in the order of time."""
        heading, ahead = np.array(LAYOUTS[self.layout]).T
        length = 2 * self.height_m
        passes = tuple(dict.fromkeys(heading.tolist()))
        flight = flown(approaches((0.0, 0.0), length, self.height_m, self.speed_mps, passes), 1.0, seed, run)
        middle = flight.line_s.mean(axis=1)[np.searchsorted(passes, heading)]
        t_s = np.sort(middle + ahead * self.height_m / self.speed_mps)
        errors = navigation_errors(self.navigation, self.position_m)
        navigation = recorded_navigation(flight, self.navigation, errors, seed, run).at(t_s)
        return true_camera_pose(flight.trajectory, mounting, Shaking.draw(STILL, "argos", seed, run), t_s), navigation

    def _matched(self, camera: Camera, T_wc: Pose, rng: np.random.Generator) -> tuple[Array, ImagePoints, Array]:
        """True points that all images see, where they were measured, and which of them wrongly in one image."""
        ground = relief(_GROUND, 20.0, rng, rms_m=self.relief_m, wavelengths_m=(200.0, 1500.0))
        half = _FIELD * self.height_m
        X_w = ground.on_ground(rng.uniform(-half, half, (_CANDIDATES, 2)))
        uv = np.stack([camera.project(T_wc[i].inv().apply(X_w)) for i in range(len(T_wc))])
        seen = np.flatnonzero(camera.contains(uv, _BORDER_PX).all(axis=0))[: self.points]
        uv = uv[:, seen] + self.matches_px * rng.standard_normal((len(T_wc), len(seen), 2))
        wrong = rng.permutation(len(seen))[: int(self.wrong * len(seen))]
        uv[rng.integers(0, len(T_wc), len(wrong)), wrong] += rng.uniform(-100, 100, (len(wrong), 2))
        image, point = (a.ravel() for a in np.indices(uv.shape[:2]))
        return X_w[seen], ImagePoints(image, point, uv.reshape(-1, 2), self.matches_px), wrong


def _ground(case: str, error: Array) -> Iterator[Row]:
    """RMS over the points that have coordinates."""
    square = error[np.isfinite(error[:, 0])] ** 2
    yield case, "ties_position", 0, float(np.sqrt(np.mean(square[:, 0] + square[:, 1])))
    yield case, "ties_height", 0, float(np.sqrt(np.mean(square[:, 2])))
