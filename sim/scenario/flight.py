"""What a flight shows: ground, flight lines, cameras, navigation, and what the estimators know of them wrongly."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from sim.scenario.language import Coefficient, Coordinate, Degrees, Fraction, NonNegative, Point2, Positive, Spec

Preset = Literal["motorway", "motorway-jam", "motorway-snow", "inner-city-1", "inner-city-2", "flight-town"]
Triple = tuple[Degrees, Degrees, Degrees]
Offset = tuple[Coordinate, Coordinate, Coordinate]
Share = Annotated[float, Field(gt=0, le=1)]
_LARGEST_GROUND_M = 20_000.0
_CAMERAS = {"antar": ("mono", "thermal"), "argos": ("left", "nadir", "right")}


class Ground(Spec):
    """The ground under a flight: a ready-made world, or the roads (and buildings, and heights) of map files."""

    preset: Preset | None = None
    length_m: Annotated[float, Field(ge=1400, le=_LARGEST_GROUND_M)] | None = None
    """Length of the preset's motorway."""
    longitude_deg: Annotated[float, Field(ge=-180, le=180)] = 11.5
    """Where on Earth the preset's world is; a map says it itself."""
    latitude_deg: Annotated[float, Field(ge=-80, le=84)] = 48.1
    height_m: Annotated[float, Field(ge=-500, le=9000)] = 500.0
    """Ellipsoidal height of the world's z = 0."""
    roads: Path | None = None
    """GeoJSON, GeoPackage or an OpenStreetMap extract."""
    buildings: Path | None = None
    default_height_m: Annotated[float, Field(gt=0, le=900)] = 12.0
    """Of buildings whose height the map does not say."""
    terrain: tuple[Path, ...] = ()
    """SRTM .hgt or GeoTIFF files of heights; without one a map's land is level."""
    voids: Literal["fill", "refuse"] = "fill"
    undulation_m: Annotated[float, Field(ge=-110, le=110)] = 0.0
    """Height of the geoid, to which the files of heights refer, over the ellipsoid."""
    terrain_spacing_m: Annotated[float, Field(ge=1, le=1000)] = 30.0

    @model_validator(mode="after")
    def _one_ground(self) -> Ground:
        if (self.preset is None) == (self.roads is None):
            raise ValueError("roads: give either a preset or roads")
        if self.preset is not None and (self.buildings is not None or self.terrain):
            raise ValueError("buildings, terrain: go with roads, not with a preset")
        if self.length_m is not None and self.preset not in (
            "motorway",
            "motorway-jam",
            "motorway-snow",
            "flight-town",
        ):
            raise ValueError("length_m: goes with the preset of a motorway or flight-town")
        return self


class _Lines(Spec):
    length_m: Annotated[float, Field(ge=10, le=_LARGEST_GROUND_M)] = 2000.0
    offset_m: Point2 = (0.0, 0.0)
    """Of their middle from that of the roads, (east, north)."""


class Strip(_Lines):
    """One straight line."""

    kind: Literal["strip"]
    heading_deg: Degrees = 90.0
    """Against grid north."""


class Approaches(_Lines):
    """Lines over one place from several directions (Kozempel 2012, 3.3)."""

    kind: Literal["approaches"]
    headings_deg: Annotated[tuple[Degrees, ...], Field(min_length=1, max_length=36)] = (0.0, 90.0, 180.0, 270.0)


class Block(_Lines):
    """Parallel lines to and fro."""

    kind: Literal["block"]
    heading_deg: Degrees = 90.0
    lines: Annotated[int, Field(ge=1, le=50)] = 2
    spacing_m: Annotated[float, Field(gt=0, le=5000)] = 500.0


class Air(Spec):
    """What moves the aircraft and shakes its cameras."""

    gusts_deg: tuple[NonNegative, NonNegative, NonNegative] = (1.0, 0.5, 0.5)
    """Standard deviations of roll, pitch and heading."""
    vibration_deg: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Of a camera against the body about each axis, which the IMU does not see."""
    wind_mps: tuple[Annotated[float, Field(ge=-40, le=40)], Annotated[float, Field(ge=-40, le=40)]] = (0.0, 0.0)
    """(East, north)."""


class FlightPlan(Spec):
    """Which cameras fly where."""

    system: Literal["antar", "argos"] = "argos"
    cameras: tuple[str, ...] = ()
    """Heads of the system: antar mono, thermal; argos nadir, left, right. By default mono, nadir."""
    mount_deg: Degrees = 0.0
    """Cameras turned about their axis, clockwise seen from above; 0 or 90 in the source."""
    pattern: Annotated[Strip | Approaches | Block, Field(discriminator="kind")] = Strip(kind="strip")
    height_m: tuple[Annotated[float, Field(ge=50, le=10_000)], ...] = (1400.0,)
    """Above the ground in the middle; several take turns over the lines."""
    speed_mps: Annotated[float, Field(ge=20, le=200)] = 70.0
    bank_deg: Annotated[float, Field(gt=0, le=60)] = 20.0
    frames: Annotated[int, Field(ge=1, le=10_000)] | None = None
    """At most so many images of each camera, the first ones."""
    air: Air = Air()

    @model_validator(mode="before")
    @classmethod
    def _one_height(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("height_m"), int | float):
            return data | {"height_m": (data["height_m"],)}
        return data

    @model_validator(mode="after")
    def _known_cameras(self) -> FlightPlan:
        known = _CAMERAS[self.system]
        for name in self.cameras:
            if name not in known:
                raise ValueError(f"cameras: found {name!r}, allowed: {', '.join(known)}")
        if len(set(self.cameras)) < len(self.cameras):
            raise ValueError(f"cameras: one is named twice in {', '.join(self.cameras)}")
        if not self.height_m:
            raise ValueError("height_m: should have at least one height")
        return self

    @property
    def heads(self) -> tuple[str, ...]:
        """The cameras that fly, in the system's order."""
        chosen = self.cameras or {"antar": ("mono",), "argos": ("nadir",)}[self.system]
        return tuple(name for name in _CAMERAS[self.system] if name in chosen)


class Calibration(Spec):
    """Interior orientation of all cameras and their mounting; what of it the estimators do not know."""

    distortion: tuple[Coefficient, Coefficient, Coefficient, Coefficient, Coefficient] = (0, 0, 0, 0, 0)
    """Brown coefficients k1, k2, p1, p2, k3 in OpenCV's order."""
    nominal_distortion: tuple[Coefficient, Coefficient, Coefficient, Coefficient, Coefficient] | None = None
    """What the estimators believe; by default the truth."""
    focal_error: Annotated[float, Field(ge=-0.1, le=0.1)] = 0.0
    """True focal length over the nominal one, minus one."""
    principal_error_px: Point2 = (0.0, 0.0)
    """True minus nominal."""
    boresight_error_deg: Triple = (0.0, 0.0, 0.0)
    """True minus nominal boresight angles omega, phi, kappa (3.19)."""
    lever_error_m: Offset = (0.0, 0.0, 0.0)
    """True minus nominal lever arm, body axes."""


class NavigationSystem(Spec):
    """Errors of the GNSS/inertial system and of its synchronisation with the cameras."""

    errors: Literal["pos-av-410", "none"] = "pos-av-410"
    """Table 3.1 of the source: 0.008, 0.008, 0.015 degrees, or none."""
    position_m: Annotated[float, Field(gt=0, le=100)] = 0.1
    """RMS of each coordinate; the table says 0.05 to 0.30."""
    attitude_factor: Annotated[float, Field(ge=0, le=1000)] = 1.0
    """Of the table's angles."""
    time_offset_s: Annotated[float, Field(ge=-1, le=1)] = 0.0
    """An exposure at t is stamped t + time_offset_s."""
    jitter_s: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    antenna_lever_error_m: Offset = (0.0, 0.0, 0.0)
    rate_hz: Annotated[float, Field(ge=20, le=1000)] = 200.0


class ElevationModel(Spec):
    """The heights that the estimators know."""

    spacing_m: Annotated[float, Field(ge=1, le=1000)] | None = None
    """By default the true grid's."""
    error_m: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Standard deviation of a smooth error."""
    error_length_m: Annotated[float, Field(ge=20, le=10_000)] = 300.0
    """Shortest wavelength of it."""


class RoadMap(Spec):
    """The road map that the estimators know: displaced, with missing, outdated and too narrow roads."""

    displacement_m: Annotated[float, Field(ge=0, le=100)] = 1.7
    correlation_m: Annotated[float, Field(gt=0, le=10_000)] = 150.0
    missing: Fraction = 0.04
    outdated: Fraction = 0.04
    narrowed: Fraction = 0.15


class Imaging(Spec):
    """How the images come about."""

    samples: Annotated[int, Field(ge=1, le=4)] = 1
    """Squared per pixel."""
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None = 95
    """None: PNG, without loss; images of the thermal camera always are."""
    exposure_s: Annotated[float, Field(gt=0, le=1)] = 0.001
    sun_azimuth_deg: Annotated[float, Field(ge=0, lt=360)] | None = None
    sun_elevation_deg: Annotated[float, Field(ge=5, le=90)] | None = None
    sky: Share | None = None
    """Share of skylight: 1 is an overcast day without shadows. By default, as the sun, the preset's."""
    visibility_m: Annotated[float, Field(ge=1000, le=1e6)] | None = None
    balance: tuple[Share, Share, Share] | None = None
    """Gains of red, green and blue: a wrong white balance."""
    truth_images: bool = False
    """Depth and instance of every pixel beside the table of vehicles; 130 MB for an ARGOS frame before compression."""


class Control(Spec):
    """Signalised ground control points, known by DGPS and clicked in the images: a list in ODM's form."""

    points: Annotated[int, Field(ge=0, le=1000)] = 0
    spread_m: Positive = 150.0
    """They lie in a square of this half side about the middle."""
    sigma_m: Annotated[float, Field(gt=0, le=10)] = 0.02
    sigma_px: Annotated[float, Field(gt=0, le=100)] = 0.5


class FlightScenario(Spec):
    """A flight over a ground, without its estimators."""

    title: str
    source: str = ""
    kind: Literal["flight"]
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    ground: Ground
    flight: FlightPlan = FlightPlan()
    calibration: Calibration = Calibration()
    navigation: NavigationSystem = NavigationSystem()
    elevation: ElevationModel = ElevationModel()
    map: RoadMap = RoadMap()
    imaging: Imaging = Imaging()
    control: Control = Control()
