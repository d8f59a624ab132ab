"""What a scenario shows: rig, ego, vehicles with their motions, street, rendering and what makes seeing hard."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from sim.scenario.language import (
    Coefficient,
    Coordinate,
    Count,
    Degrees,
    Extent,
    Focal,
    Fraction,
    Name,
    NonNegative,
    Point2,
    Positive,
    Rate,
    Spec,
    Transition,
)


class Nominal(Spec):
    """What the estimators believe of the rig where it differs from the truth."""

    focal_px: Focal | None = None
    baseline_m: Positive | None = None
    right_rotation_deg: tuple[Degrees, Degrees, Degrees] | None = None


class Rig(Spec):
    """Stereo rig; both cameras alike, the right one ``baseline_m`` to the right and turned by a rotation vector."""

    size_px: tuple[Annotated[int, Field(ge=16, le=16384)], Annotated[int, Field(ge=16, le=16384)]] = (1024, 768)
    focal_px: Focal = 1000.0
    principal_px: Point2 | None = None
    """Principal point; the image centre by default."""
    distortion: tuple[Coefficient, Coefficient, Coefficient, Coefficient, Coefficient] = (0, 0, 0, 0, 0)
    """Brown coefficients k1, k2, p1, p2, k3 in OpenCV's order."""
    baseline_m: Positive = 0.30
    right_rotation_deg: tuple[Degrees, Degrees, Degrees] = (0, 0, 0)
    """Rotation vector of the right camera against the left one, camera axes."""
    height_m: Positive = 1.0
    pitch_deg: Annotated[float, Field(gt=-45, lt=45)] = 0.0
    """Upwards positive."""
    rate_hz: Rate = 25.0
    frames: Annotated[int, Field(ge=1, le=100_000)] | None = None
    """Number of stereo frames; in a replay by default as many as the label has."""
    nominal: Nominal = Nominal()


class Straight(Spec):
    """Constant velocity; ``start_m`` is the ground point (x, y) below the middle of the rear axle."""

    kind: Literal["straight"]
    start_m: Point2
    heading_deg: Degrees = 0.0
    speed_mps: NonNegative = 10.0


class Crossing(Spec):
    """Constant velocity across the view at a distance, in front of the camera in the middle of the sequence."""

    kind: Literal["crossing"]
    distance_m: Positive = 20.0
    speed_mps: Positive = 10.0
    towards: Literal["right", "left"] = "right"


class Turning(Spec):
    """Straight on, clothoid in, arc, clothoid out: the yaw rate is a trapezoid over time, positive to the left."""

    kind: Literal["turning"]
    start_m: Point2
    heading_deg: Degrees = 0.0
    speed_mps: Positive = 8.0
    turn_deg: Degrees = 90.0
    yaw_rate_dps: Positive = 20.0
    straight_s: NonNegative = 0.4
    clothoid_s: Transition = 0.5

    @model_validator(mode="after")
    def _room_for_clothoids(self) -> Turning:
        if abs(self.turn_deg) < self.yaw_rate_dps * self.clothoid_s:
            raise ValueError(f"turn_deg: |{self.turn_deg}| is less than both clothoids turn alone")
        return self


class Braking(Spec):
    """Constant speed, then a deceleration that builds up within ``rise_s`` until ``final_speed_mps``."""

    kind: Literal["braking"]
    start_m: Point2
    heading_deg: Degrees = 0.0
    speed_mps: Positive = 15.0
    deceleration_mps2: Annotated[float, Field(gt=0, le=15)] = 6.0
    brake_s: NonNegative = 0.5
    rise_s: Transition = 0.2
    final_speed_mps: NonNegative = 0.0


class StopAndGo(Spec):
    """Periods of driving and standing with smooth changes of speed, as in a queue."""

    kind: Literal["stop_and_go"]
    start_m: Point2
    heading_deg: Degrees = 0.0
    speed_mps: Positive = 6.0
    drive_s: Positive = 1.5
    stand_s: NonNegative = 0.7
    change_s: Transition = 0.8


class Labels(Spec):
    """Replay of one track of a KITTI tracking label file, in a flat world, smoothed to the frame rate."""

    kind: Literal["labels"]
    labels: Path
    track: Annotated[int, Field(ge=0)] = 0
    label_rate_hz: Rate = 10.0
    smoothing_m: NonNegative = 0.10
    """Standard deviation of a label's position that the smoothing assumes."""
    smoothing_deg: NonNegative = 3.0
    """Standard deviation of a label's heading that the smoothing assumes."""
    traffic: bool = False
    """Whether the file's other vehicles drive, too, and hide what they hide, in place of the label's occlusion."""


Motion = Annotated[Straight | Crossing | Turning | Braking | StopAndGo | Labels, Field(discriminator="kind")]


class Ego(Spec):
    """The car that carries the rig: it stands, drives a motion, or follows measured camera poses.

    The motion is that of the ground point below the left camera.
    """

    motion: Annotated[Straight | Turning | Braking | StopAndGo, Field(discriminator="kind")] | None = None
    poses: Path | None = None
    """KITTI poses, a row-major 3x4 camera pose a line, at the rate of the labels."""
    observed: bool | None = None
    """Whether estimators are given the ego poses; by default where the ego car moves."""
    sigma_position_m: NonNegative = 0.0
    sigma_rotation_deg: NonNegative = 0.0
    """Noise of the observed ego poses."""

    @model_validator(mode="after")
    def _one_motion(self) -> Ego:
        if self.motion is not None and self.poses is not None:
            raise ValueError("poses: give either motion or poses")
        return self


class Vehicle(Spec):
    """A vehicle: one of the built-in kinds, a mesh file, or a transparent grid of points."""

    name: Name
    mesh: str = "sedan"
    """sedan, hatchback, estate, van, lorry, bus, point_grid, label (kind and size from the label), or a mesh file."""
    size_m: tuple[Extent, Extent, Extent] | None = None
    """Length, width, height."""
    grid: tuple[Count, Count, Count] = (5, 4, 5)
    """Points of a point_grid along its length, width and height."""
    forward: Literal["+x", "-x", "+y", "-y", "+z", "-z"] = "+x"
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"] = "+z"
    """Axes of a mesh file."""
    color: Literal["white", "silver", "grey", "black", "red", "blue", "green"] | None = None
    """Paint of the body; by default drawn from the seed, or a mesh file's own colours."""
    motion: Motion

    @property
    def is_file(self) -> bool:
        """Whether ``mesh`` names a file, by a dot or slash."""
        return any(c in self.mesh for c in "./\\")

    @model_validator(mode="after")
    def _only_what_acts(self) -> Vehicle:
        acts = {"forward": self.is_file, "up": self.is_file, "grid": self.mesh == "point_grid"}
        for key, does in acts.items():
            if not does and getattr(self, key) != type(self).model_fields[key].default:
                raise ValueError(f"{key}: does nothing to mesh {self.mesh!r}")
        return self


class Road(Spec):
    """The static world beside and below the traffic."""

    roadside: bool = True
    """Road, buildings, trees, signs and street furniture; without it the vehicles stand before the sky."""
    lanes: Annotated[int, Field(ge=1, le=6)] = 2
    crossing_at_m: Coordinate | None = None
    """Distance of a crossing road, if there is one."""
    sun_azimuth_deg: Degrees = 230.0
    """Clockwise from the driving direction."""
    sun_elevation_deg: Annotated[float, Field(gt=5, le=90)] = 42.0


class Render(Spec):
    """Pictures of the run; projected points need none, tracked ones have them in any case."""

    enabled: bool = True
    supersample: Annotated[int, Field(ge=1, le=4)] = 2
    shadows: bool = True
    blur_px: Annotated[float, Field(ge=0, le=50)] = 0.5
    """Standard deviation of the optical blur."""
    vignetting: Fraction = 0.12
    """Share of the light lost in the corners."""
    gain: Positive = 1.0
    """Exposure: factor on the grey values before they saturate."""
    read_noise: NonNegative = 1.5
    shot_noise: NonNegative = 2.5
    """Grey levels; the noise variance is read_noise² + shot_noise² grey / 255."""
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None = None
    truth_images: bool = True
    """Depth and instance masks, written beside the truth."""
    flow: bool = False
    """Optical flow to the next frame, written beside the truth."""


class Realism(Spec):
    """What makes seeing hard; 0 is off. Levels go from 0 to 1, the worst that still happens on the road."""

    contrast: Fraction = 0
    """Rolling contrast: veil and gain drift over image and time; at 1 local contrast falls to a third in places."""
    glare: Fraction = 0
    """Scatter of windscreen and lens, worst towards a low sun ahead; 1/3 is a human eye, 1 a dirty windscreen."""
    reflections: Fraction = 0
    """Sky, houses and trees mirrored on paint and glass; at 1 three and a half times as strongly as at 0."""
    shadows: Fraction = 0
    """Shadow edges of trees and houses that stand still while cars drive through: share of the sun they hide."""
    dirt: Fraction = 0
    """Spots on the windscreen; at 1 they cover a quarter of the view."""
    rain: Fraction = 0
    """Drops on the windscreen; at 1 some 70 a second fall into a view of 54 degrees."""
    wiper_s: Annotated[float, Field(ge=0, le=60)] = 0
    """Time from one wiper pass, out and back, to the next [s]; 0 for none, else at least 0.8."""
    exposure_ms: Annotated[float, Field(ge=0, le=100)] = 0
    """Exposure time, whose middle is the frame's time: what moves is blurred."""
    exposure_step_ev: Annotated[float, Field(ge=0, le=6)] = 0
    """Largest sudden change of exposure, one a second, which recovers in 0.3 s [stops]."""
    occluders: Annotated[int, Field(ge=0, le=20)] = 0
    """Cars that cross between the camera and the target, evenly spread over the run."""

    @field_validator("wiper_s")
    @classmethod
    def _not_faster_than_wipers_are(cls, period_s: float) -> float:
        if 0 < period_s < 0.8:
            raise ValueError("should be 0 or at least 0.8")
        return period_s

    @property
    def on_the_way(self) -> bool:
        """Whether anything between the world and the sensor disturbs."""
        return any((self.contrast, self.glare, self.dirt, self.rain, self.wiper_s, self.exposure_step_ev))
