"""The world and the measurement as frozen, validated specs (unknown keys refused). Estimators come in `scenarios.spec`.

Degrees appear here and nowhere deeper; every angle key ends in ``_deg`` or ``_dps``.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from sim.scenario.language import Focal, Name, Point2, Positive, Rate, ScenarioError, Spec, choose, explain, nearest
from sim.scenario.measurement import (
    Event,
    Measure,
    MotionSegmentation,
    NoiseOutlier,
    Outlier,
    ReflectionOutlier,
    SegmentationOutlier,
    StereoOutlier,
    TemporalOutlier,
    WrongMask,
)
from sim.scenario.scene import (
    Braking,
    Crossing,
    Ego,
    Labels,
    Realism,
    Render,
    Rig,
    Road,
    StopAndGo,
    Straight,
    Turning,
    Vehicle,
)

__all__ = [
    "Braking",
    "Crossing",
    "Ego",
    "Event",
    "Focal",
    "Labels",
    "Measure",
    "MotionSegmentation",
    "Name",
    "NoiseOutlier",
    "Outlier",
    "Point2",
    "Positive",
    "Rate",
    "Realism",
    "ReflectionOutlier",
    "Rig",
    "Road",
    "Scenario",
    "ScenarioError",
    "SegmentationOutlier",
    "Spec",
    "StereoOutlier",
    "StopAndGo",
    "Straight",
    "TemporalOutlier",
    "Turning",
    "Vehicle",
    "WrongMask",
    "explain",
    "nearest",
]

# Motions are sampled finely and kept in memory; what software OpenGL can draw.
_LONGEST_S, _LARGEST_PX = 3600, 16384


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
            choose("measure.target", self.measure.target, names)
        for i, outlier in enumerate(self.outliers):
            if isinstance(outlier, SegmentationOutlier):
                others = [n for n in names if n != self.target.name]
                choose(f"outliers.{i}.on", outlier.on, ["background", *others])
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
