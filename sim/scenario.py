"""The world and the measurement as frozen, validated specs (unknown keys refused). Estimators come in `scenarios.spec`.

Degrees appear here and nowhere deeper; every angle key ends in ``_deg`` or ``_dps``.
"""

from __future__ import annotations

import difflib
import re
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator


class ScenarioError(ValueError):
    """The user's input is wrong: one line that names file and key, what was found and what is allowed."""


class Spec(BaseModel):
    """Base of all specs: frozen, strict about unknown keys and non-finite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)


# Far beyond anything on a road, and near enough for double precision.
Positive = Annotated[float, Field(gt=0, le=1e6)]
NonNegative = Annotated[float, Field(ge=0, le=1e6)]
Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]
Degrees = Annotated[float, Field(ge=-3600, le=3600)]
Transition = Annotated[float, Field(ge=0.05, le=1e3)]
Rate = Annotated[float, Field(ge=0.1, le=1000)]
Coefficient = Annotated[float, Field(ge=-1e3, le=1e3)]
Count = Annotated[int, Field(ge=1, le=100)]
Extent = Annotated[float, Field(ge=0.1, le=100)]
Focal = Annotated[float, Field(ge=1, le=1e6)]
Point2 = tuple[Coordinate, Coordinate]
Fraction = Annotated[float, Field(ge=0, le=1)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9 _.+-]*$", max_length=60)]


# Motions are sampled finely and kept in memory; what software OpenGL can draw; weights are inverse squares.
_LONGEST_S, _LARGEST_PX, _LEAST_SIGMA_PX = 3600, 16384, 1e-6


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


class Event(Spec):
    """At a frame the outermost points on one side of the target come into view for good, or go out of it."""

    kind: Literal["birth", "death"]
    frame: Annotated[int, Field(ge=1)]
    side: Literal["front", "rear", "left", "right", "top", "bottom"]
    depth_m: Positive
    """How far from that side a point may lie."""


class TrueMask(Spec):
    """The front end is told exactly which pixels of the left images show the target."""

    kind: Literal["true"] = "true"


class WrongMask(Spec):
    """The front end is told wrongly which pixels of the left images show the target; all errors add up."""

    kind: Literal["wrong"]
    dilate_px: Annotated[int, Field(ge=-50, le=50)] = 0
    """How far the outline moves outwards; negative: inwards."""
    shift_px: Point2 = (0.0, 0.0)
    """Displacement of the whole mask, right and down."""
    holes: Fraction = 0.0
    """Share of the target's pixels lost in round holes."""
    neighbour: Fraction = 0.0
    """Round blobs of what is beside the target, other vehicles or background, as a share of the target's pixels."""
    frames: Annotated[int, Field(ge=1)] = 5
    """How long holes and blobs stay on the same places of the target."""


class MotionSegmentation(Spec):
    """The front end itself finds the target, by motion and depth."""

    kind: Literal["motion"]


Segmentation = Annotated[TrueMask | WrongMask | MotionSegmentation, Field(discriminator="kind")]


class Measure(Spec):
    """Measured points of the target: projected ones with noise, or tracked in the rendered images."""

    model_config = ConfigDict(populate_by_name=True)

    source: Literal["projection", "images"] = Field(default="projection", alias="from")
    target: str | None = None
    """Name of the observed vehicle; the first one by default."""
    points: Annotated[int, Field(ge=1, le=20_000)] = 120
    """Tracks at a time, as far as so many surface points are in view."""
    segmentation: Segmentation | None = None
    """What the image front end is told of where the target is; the truth by default."""
    sigma_px: NonNegative = 0.2
    """Noise of projected points; that of tracked ones is what it is."""
    stated_sigma_px: Positive | None = None
    """What estimators are told; by default the injected sigma, or the covariance that the front end measures."""
    occlusion: bool = True
    missing_frames: tuple[Annotated[int, Field(ge=0)], ...] = ()
    """Frames without any measurement."""
    events: tuple[Event, ...] = ()
    """Births and deaths of tracks, beside those that follow from the geometry."""

    @model_validator(mode="before")
    @classmethod
    def _true_mask_by_default(cls, data: Any) -> Any:
        images = isinstance(data, dict) and "images" in (data.get("from"), data.get("source"))
        return {"segmentation": TrueMask()} | data if images else data

    @model_validator(mode="after")
    def _only_what_acts(self) -> Measure:
        inert = ("sigma_px", "occlusion", "missing_frames", "events") if self.from_images else ("segmentation",)
        for key in inert:
            if getattr(self, key) != type(self).model_fields[key].default:
                raise ValueError(f"{key}: does nothing to points from {self.source!r}")
        return self

    @model_validator(mode="after")
    def _stated(self) -> Measure:
        if self.stated < _LEAST_SIGMA_PX:
            raise ValueError(f"stated_sigma_px: give at least {_LEAST_SIGMA_PX:g} where sigma_px is {self.sigma_px:g}")
        return self

    @property
    def from_images(self) -> bool:
        return self.source == "images"

    @property
    def gives_masks(self) -> bool:
        """Whether the front end is told where the target is."""
        return self.from_images and not isinstance(self.segmentation, MotionSegmentation)

    @property
    def stated(self) -> float:
        """What is stated of projected points."""
        return self.sigma_px if self.stated_sigma_px is None else self.stated_sigma_px


class _Outlier(Spec):
    tracks: Fraction = 0.1
    """Share of the tracks that are outliers of this kind."""


class NoiseOutlier(_Outlier):
    """Coarse noise in all four coordinates of some frames (Siegemund 2008, 3.4.4)."""

    kind: Literal["noise"]
    frames: Annotated[int, Field(ge=1)] = 10
    sigma_px: Positive = 2.0
    min_px: NonNegative = 2.0
    """Smallest absolute value of the added noise."""

    @model_validator(mode="after")
    def _reachable(self) -> NoiseOutlier:
        if self.min_px > 6 * self.sigma_px:
            raise ValueError(f"min_px: {self.min_px} is beyond 6 sigma_px")
        return self


class StereoOutlier(_Outlier):
    """Wrong stereo match: the right coordinates are those of another point near the epipolar line."""

    kind: Literal["stereo"]
    frames: Annotated[int, Field(ge=1)] = 3


class TemporalOutlier(_Outlier):
    """Wrong temporal match: the track jumps to another surface point and stays there."""

    kind: Literal["temporal"]
    radius_px: Positive = 25.0


class SegmentationOutlier(_Outlier):
    """Wrong segmentation: the track lies on a neighbour vehicle, or on the background."""

    kind: Literal["segmentation"]
    on: str = "background"
    """"background" or the name of another vehicle."""


class ReflectionOutlier(_Outlier):
    """A mirrored light that wanders over the body as the geometry changes."""

    kind: Literal["reflection"]


Outlier = Annotated[
    NoiseOutlier | StereoOutlier | TemporalOutlier | SegmentationOutlier | ReflectionOutlier,
    Field(discriminator="kind"),
]


class Scenario(Spec):
    """A stereo scenario: the world and its measurement."""

    title: str
    source: str = ""
    kind: Literal["stereo"]
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    rig: Rig = Rig()
    ego: Ego = Ego()
    world: Road = Road()
    render: Render = Render()
    realism: Realism = Realism()
    vehicle: Annotated[tuple[Vehicle, ...], Field(min_length=1)]
    measure: Measure = Measure()
    outliers: tuple[Outlier, ...] = ()

    @field_validator("vehicle")
    @classmethod
    def _unique_names(cls, vehicles: tuple[Vehicle, ...]) -> tuple[Vehicle, ...]:
        names = [v.name for v in vehicles]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"the name {name!r} is used {names.count(name)} times")
        return vehicles

    @model_validator(mode="after")
    def _consistent(self) -> Scenario:
        names = [v.name for v in self.vehicle]
        if self.measure.target is not None:
            _choose("measure.target", self.measure.target, names)
        for i, outlier in enumerate(self.outliers):
            if isinstance(outlier, SegmentationOutlier):
                others = [n for n in names if n != self.target.name]
                _choose(f"outliers.{i}.on", outlier.on, ["background", *others])
        if self.rig.frames is None and not isinstance(self.target.motion, Labels):
            raise ValueError("rig.frames: a number is needed unless the target's motion is a replay of labels")
        if self.run_seconds > _LONGEST_S:
            raise ValueError(f"rig.frames: the run lasts {self.run_seconds:g} s, allowed are {_LONGEST_S} s")
        if self.measure.from_images:
            self._refuse_what_images_cannot_have()
        if self.rendered and self.render.supersample * max(self.rig.size_px) > _LARGEST_PX:
            raise ValueError(f"render.supersample: images of more than {_LARGEST_PX} fine pixels cannot be drawn")
        if self.rendered and not self.world.roadside and all(v.mesh == "point_grid" for v in self.vehicle):
            raise ValueError("render.enabled: there is nothing to draw but grids of points")
        if self.realism.exposure_ms > 1000 / self.rig.rate_hz:
            raise ValueError(f"realism.exposure_ms: a frame lasts {1000 / self.rig.rate_hz:g} ms, the exposure longer")
        for i, v in enumerate(self.vehicle):
            if isinstance(v.motion, Labels) and v is not self.target:
                raise ValueError(f"vehicle.{i}.motion: only the target can replay labels")
        if sum(o.tracks for o in self.outliers) > 1 + 1e-9:
            raise ValueError("outliers: the shares of tracks add up to more than 1")
        return self

    def _refuse_what_images_cannot_have(self) -> None:
        if self.outliers:
            raise ValueError("outliers: points tracked in images bring their own")
        if self.target.mesh == "point_grid":
            raise ValueError("measure.from: images do not show a point_grid")
        if not self.render.truth_images:
            raise ValueError("render.truth_images: points tracked in images are labelled by them")

    @property
    def rendered(self) -> bool:
        """Whether the run has images: because they are asked for, or because its points are tracked in them."""
        return self.render.enabled or self.measure.from_images

    @property
    def target(self) -> Vehicle:
        wanted = self.measure.target or self.vehicle[0].name
        return next(v for v in self.vehicle if v.name == wanted)

    @property
    def target_index(self) -> int:
        return self.vehicle.index(self.target)

    @property
    def run_seconds(self) -> float:
        """Time from the first to the last frame, where ``rig.frames`` is given [s]."""
        return 0.0 if self.rig.frames is None else (self.rig.frames - 1) / self.rig.rate_hz


def nearest(word: str, allowed: list[str]) -> str:
    """ "(did you mean 'x'?)" where an allowed word is near, else the allowed words."""
    close = difflib.get_close_matches(word, allowed, n=1, cutoff=0.5)
    if close:
        return f"did you mean {close[0]!r}?"
    return "allowed: " + ", ".join(allowed)


def _choose(key: str, found: str, allowed: list[str]) -> None:
    if found not in allowed:
        raise ValueError(f"{key}: found {found!r}, {nearest(found, allowed)}")


def explain(error: ValidationError, root: type[BaseModel]) -> str:
    """One line for the first error of a validation: key, what was found, what is allowed."""
    e = error.errors(include_url=False)[0]
    parts, owner = _locate(root, e["loc"])
    key, found = ".".join(parts), e["input"]
    if e["type"] == "extra_forbidden":
        fields = [f.alias or n for n, f in owner.model_fields.items()]
        return f"{key}: unknown key, {nearest(parts[-1], fields)}"
    if e["type"] in ("missing", "union_tag_not_found"):
        return f"{key}{'' if e['type'] == 'missing' else '.kind'}: key is missing"
    if e["type"] in ("literal_error", "union_tag_invalid"):
        text = e["ctx"].get("expected") or e["ctx"]["expected_tags"]
        allowed = [w.strip().strip("'") for w in str(text).replace(" or ", ", ").split(",")]
        value = e["ctx"].get("tag", found)
        key = key if e["type"] == "literal_error" else f"{key}.{e['ctx']['discriminator'].strip(chr(39))}"
        return f"{key}: found {value!r}, {nearest(str(value), allowed)}"
    message = str(e["msg"]).removeprefix("Value error, ").replace("input should be", "should be")
    message = message.replace("Input should be", "should be")
    plain = not isinstance(found, (dict, list, tuple, BaseModel)) and len(repr(found)) < 80
    joint = "" if not key else "." if re.match(r"[a-z_]+: ", message) else ": "  # a model's message may name its key
    return f"{key}{joint}{message}{f', found {found!r}' if plain else ''}"


def _locate(root: type[BaseModel], loc: tuple[int | str, ...]) -> tuple[list[str], type[BaseModel]]:
    """Key without the tags pydantic adds for unions, and the model that owns its last part."""
    parts: list[str] = []
    owner: type[BaseModel] | None = root
    choices: list[type[BaseModel]] = []
    for i, part in enumerate(loc):
        tagged = [m for m in choices if part in _tags(m)]
        if tagged and (owner is None or part not in owner.model_fields):
            owner, choices = tagged[0], []
            continue
        parts.append(str(part))
        if isinstance(part, str) and owner is not None and i < len(loc) - 1:
            choices = _models_of(owner, part)
            owner = choices[0] if len(choices) == 1 else owner
    return parts, owner or root


def _tags(model: type[BaseModel]) -> tuple[str, ...]:
    """The literal values of a model's discriminator."""
    field = model.model_fields.get("kind") or model.model_fields.get("name")
    return tuple(str(a) for a in getattr(field.annotation, "__args__", ())) if field else ()


def _models_of(owner: type[BaseModel], name: str) -> list[type[BaseModel]]:
    """The models a field may hold."""
    field = next((f for n, f in owner.model_fields.items() if name in (n, f.alias)), None)
    stack, found = [] if field is None else [field.annotation], []
    while stack:
        annotation = stack.pop()
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            found.append(annotation)
        else:
            stack += getattr(annotation, "__args__", ())
    return found
