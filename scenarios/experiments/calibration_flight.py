"""Calibration flights of ANTAR over control points, from the same rooms as any flight, but without pictures.

Kozempel 2012, 3.3: points known by DGPS are clicked in images from several directions of approach, and navigation is
post-processed. Flown by `sim.flight`, exposed by `sim.camera_systems`, navigated by `sim.imu`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
from jaxtyping import Float

from estimators.aerial.boresight import ControlPoints
from estimators.aerial.boresight_model import Common, Navigation
from estimators.aerial.resection import ImagePoints
from scenarios.experiments.steps import check_range
from sim.angles import Mounting
from sim.archive import freeze_fields
from sim.camera import Camera
from sim.camera_systems import antar, exposures
from sim.flight import Flight, Gusts, Shaking, Vibration, fly, true_camera_pose
from sim.flight_path import FlightLine, approaches
from sim.geodesy import Georeference
from sim.imu import ChannelErrors, NavigationErrors, navigation_solution, pos_av_410, stamps
from sim.pose import Pose
from sim.streams import stream
from sim.terrain import Bounds, relief

Array = np.ndarray
NavigationKind = Literal["pos_av_410", "independent"]
ANGLES = ("omega", "phi", "kappa")
CONSTANT_SHARE = 0.6
"""What is stated of `pos_av_410`: 0.45 of its variances are constant, 0.45 drift over a minute, longer than a pass."""
MISALIGNED_DEG = 1.5
"""A mounting is off its drawing by up to so much in every angle."""
# Munich, where the source flew, east in its zone: convergence 1.9 degrees.
REFERENCE = Georeference(32632, (691000.0, 5334000.0, 0.0))
_IMAGES_PER_PASS = 6
# Parts of the lowest height: half a side of the field of points, and half the way on which a pass exposes.
_FIELD, _REACH = 0.3, 0.15
_GROUND: Bounds = (-1000.0, -1000.0, 1000.0, 1000.0)
_BORDER_PX = 5.0
# Errors that are new in every image but the same in neighbouring records: navigation is interpolated between two.
_INSTANT_S = 0.05


def navigation_errors(navigation: NavigationKind, position_m: float) -> NavigationErrors:
    """Those of Table 3.1, by default or each new in every image."""
    e = pos_av_410(position_m)
    if navigation == "pos_av_410":
        return e
    own = [ChannelErrors(drift=s, drift_s=_INSTANT_S) for s in (e.stated_attitude, e.stated_position)]
    return replace(e, attitude=own[0], position=own[1])


def recorded_navigation(
    flight: Flight, navigation: NavigationKind, errors: NavigationErrors, seed: int, run: int
) -> Navigation:
    """Post-processed records of the passes, and what is stated of them."""
    solution, _ = navigation_solution(flight.trajectory, REFERENCE, errors, seed, run, within_s=flight.line_s)
    return Navigation.from_solution(solution, REFERENCE, CONSTANT_SHARE if navigation == "pos_av_410" else 0.0)


@dataclass(frozen=True)
class CalibrationPlan:
    """A calibration flight: passes over one field of points, flown in turn, and how well everything is measured."""

    headings_deg: tuple[float, ...] = (0.0, 90.0, 180.0, 270.0)
    """Grid headings of the passes, which are flown again where they would take more than six images each."""
    heights_m: tuple[float, ...] = (500.0,)
    """Of the passes above the ground, one after the other."""
    images: int = 9
    """In all."""
    gcps: int = 8
    """Control points clicked in every image, of those that it sees."""
    navigation: NavigationKind = "pos_av_410"
    """Errors of Table 3.1: mostly constant or slow, as post-processing leaves them; or new in every image."""
    position_m: float = 0.05
    """GNSS, each axis."""
    vibration_deg: float = 0.0
    """Of the camera against the body, each axis."""
    clicks_px: float = 0.5
    """Of a clicked point, each axis."""
    gcp_m: float = 0.02
    """Of a control point, each axis."""
    time_offset_s: float = 0.0
    """An image is exposed so long after its time stamp."""
    jitter_s: float = 0.0
    """Of the time stamps."""
    relief_m: float = 5.0
    """Standard deviation of the ground's height."""
    speed_mps: float = 60.0
    """Over ground."""
    gusts: float = 1.0
    """Of the air, as a multiple of an ordinary day's."""

    def __post_init__(self) -> None:
        if not self.headings_deg:
            raise ValueError("headings_deg: should name one pass at least, found none")
        if not self.heights_m:
            raise ValueError("heights_m: should name one height at least, found none")
        for height in self.heights_m:
            check_range("heights_m", height, 200, 3000)
        check_range("images", self.images, 1, 200)
        check_range("gcps", self.gcps, 2, 100)
        check_range("position_m", self.position_m, 1e-3, 10)
        check_range("vibration_deg", self.vibration_deg, 0, 1)
        check_range("clicks_px", self.clicks_px, 0.01, 20)
        check_range("gcp_m", self.gcp_m, 1e-3, 10)
        check_range("time_offset_s", self.time_offset_s, -0.5, 0.5)
        check_range("jitter_s", self.jitter_s, 0, 0.1)
        check_range("relief_m", self.relief_m, 0, 50)
        check_range("speed_mps", self.speed_mps, 30, 150)
        check_range("gusts", self.gusts, 0, 3)

    def lines(self) -> tuple[FlightLine, ...]:
        """The passes in the order in which they are flown."""
        count = max(len(self.headings_deg), len(self.heights_m))
        rounds = -(-self.images // (_IMAGES_PER_PASS * count))
        flown: list[FlightLine] = []
        for i in list(range(count)) * rounds:
            heading, height = self.headings_deg[i % len(self.headings_deg)], self.heights_m[i % len(self.heights_m)]
            flown += approaches((0.0, 0.0), 3 * _REACH * self.lowest_m, height, self.speed_mps, (heading,))
        return tuple(flown)

    @property
    def lowest_m(self) -> float:
        return min(self.heights_m)

    def errors(self) -> NavigationErrors:
        """What is wrong with navigation and its synchronisation, and what is stated of it."""
        e = navigation_errors(self.navigation, self.position_m)
        return replace(e, time_offset_s=-self.time_offset_s, jitter_s=self.jitter_s)


@dataclass(frozen=True, eq=False)
class CalibrationFlight:
    """What an estimator gets and what it should find.

    camera, points, control, nominal; navigation (m,) at the stamps_s (m,) of the images, and all of it as recorded.
    truth, the poses T_wc (m,) of the exposures; heading_deg (m,) of the pass of each.
    """

    camera: Camera
    points: ImagePoints
    control: ControlPoints
    navigation: Navigation
    recorded: Navigation
    stamps_s: Float[Array, "m"]
    nominal: Mounting
    truth: Common
    T_wc: Pose
    heading_deg: Float[Array, "m"]

    def __post_init__(self) -> None:
        freeze_fields(self)


def calibration_flight(plan: CalibrationPlan, seed: int, run: int) -> CalibrationFlight:
    """One run of a plan."""
    lines = plan.lines()
    flight = flown(lines, plan.gusts, seed, run)
    head = antar().heads[0]
    mounting = misaligned(head.mounting, seed, run)
    t_s, line = _exposed(plan, flight, seed, run)
    shaking = Shaking.draw(Vibration(np.deg2rad(plan.vibration_deg)), "antar", seed, run)
    T_wc = true_camera_pose(flight.trajectory, mounting, shaking, t_s)
    X_w = _field(plan, seed, run)
    errors = plan.errors()
    vibration = float(np.deg2rad(plan.vibration_deg))
    recorded = replace(recorded_navigation(flight, plan.navigation, errors, seed, run), vibration=vibration)
    stamped = stamps(t_s, errors, "antar", seed, run)
    surveyed = X_w + plan.gcp_m * stream(seed, run, "boresight/survey").standard_normal(X_w.shape)
    return CalibrationFlight(
        head.camera,
        _clicked(plan, head.camera, T_wc, X_w, stream(seed, run, "boresight/clicks")),
        ControlPoints(surveyed, plan.gcp_m),
        recorded.at(stamped),
        recorded,
        stamped,
        head.mounting,
        Common(mounting, plan.time_offset_s),
        T_wc,
        np.rad2deg(np.pi / 2 - np.array([lines[i].direction for i in line])) % 360,
    )


@lru_cache(maxsize=64)
def flown(lines: tuple[FlightLine, ...], gusts: float, seed: int, run: int) -> Flight:
    """Kept, for the points of a study differ more in what is measured than in what is flown."""
    roll, pitch, heading = (gusts * s for s in Gusts().sigma)
    return fly(lines, seed, run, gusts=Gusts((roll, pitch, heading)))


def misaligned(drawn: Mounting, seed: int, run: int) -> Mounting:
    """A mounting as it was built."""
    off = stream(seed, run, "boresight/truth").uniform(-MISALIGNED_DEG, MISALIGNED_DEG, 3)
    return Mounting(drawn.boresight + np.deg2rad(off), drawn.lever_b)


def _exposed(plan: CalibrationPlan, flight: Flight, seed: int, run: int) -> tuple[Array, Array]:
    """Times of the images and the pass of each: those of the system's that come nearest to an even spread."""
    exposed = exposures(antar(), flight.line_s, seed, run)
    t_s: list[float] = []
    for p, (begin, end) in enumerate(flight.line_s):
        count = len(range(p, plan.images, len(flight.line_s)))
        half = _REACH * plan.lowest_m / plan.speed_mps
        wanted = (begin + end) / 2 + (np.linspace(-half, half, count) if count > 1 else np.zeros(count))
        own = exposed.t_s[(exposed.line == p) & (exposed.head == 0)]
        t_s += own[np.abs(own[:, None] - wanted).argmin(axis=0)].tolist()
    times = np.unique(t_s)
    return times, np.searchsorted(flight.line_s[:, 0], times, side="right") - 1


def _field(plan: CalibrationPlan, seed: int, run: int) -> Array:
    """Points on the ground about the middle of all passes."""
    rng = stream(seed, run, "boresight/field")
    half = _FIELD * plan.lowest_m
    count = max(60, 5 * plan.gcps)
    ground = relief(_GROUND, 20.0, rng, rms_m=plan.relief_m, wavelengths_m=(100.0, 1000.0))
    return ground.on_ground(rng.uniform(-half, half, (count, 2)))


def _clicked(plan: CalibrationPlan, camera: Camera, T_wc: Pose, X_w: Array, rng: np.random.Generator) -> ImagePoints:
    rows = [(i, points[: plan.gcps]) for i, points in enumerate(_visible(camera, T_wc, X_w, rng))]
    image = np.concatenate([np.full(len(points), i) for i, points in rows])
    point = np.concatenate([points for _, points in rows])
    uv = camera.project(T_wc[image].inv().apply(X_w[point]))
    return ImagePoints(image, point, uv + plan.clicks_px * rng.standard_normal(uv.shape), plan.clicks_px)


def _visible(camera: Camera, T_wc: Pose, X_w: Array, rng: np.random.Generator) -> Iterator[Array]:
    """Of every image the points that it sees, in an order of its own."""
    for i in range(len(T_wc)):
        uv = camera.project(T_wc[i].inv().apply(X_w))
        yield rng.permutation(np.flatnonzero(camera.contains(uv, _BORDER_PX)))
