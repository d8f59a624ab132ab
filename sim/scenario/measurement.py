"""How a scenario is measured: points or images, segmentation, scripted events, labelled outliers."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, model_validator

from sim.scenario.language import Fraction, NonNegative, Point2, Positive, Spec

_LEAST_SIGMA_PX = 1e-6  # weights are inverse squares


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
