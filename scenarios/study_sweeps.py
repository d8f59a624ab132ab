"""What a study varies: its sweeps, as they stand in its file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from sim.scenario import Spec, nearest

Settings = dict[str, Any]


def flatten(table: Mapping[str, Any], prefix: str = "") -> Settings:
    """Nested tables as dotted keys; what stands under a key that is dotted itself is its value."""
    found: Settings = {}
    for key, value in table.items():
        if isinstance(value, dict) and "." not in key:
            found |= flatten(value, f"{prefix}{key}.")
        else:
            found[prefix + key] = value
    return found


class Grid(Spec):
    """The values of one key; several grids multiply."""

    kind: Literal["grid"]
    key: str
    values: Annotated[tuple[Any, ...], Field(min_length=1)]


class PointList(Spec):
    """Points at which several keys vary together."""

    kind: Literal["list"]
    points: Annotated[tuple[Settings, ...], Field(min_length=1)]

    @field_validator("points")
    @classmethod
    def _flat(cls, points: tuple[Settings, ...]) -> tuple[Settings, ...]:
        flat = tuple(flatten(p) for p in points)
        for i, point in enumerate(flat):
            if set(point) != set(flat[0]):
                raise ValueError(f"point {i} sets {', '.join(point)}, the first one {', '.join(flat[0])}")
        return flat


class _Ranges(Spec):
    ranges: Annotated[Settings, Field(min_length=1)]
    """Lowest and highest value per key; whole numbers give whole numbers."""
    points: Annotated[int, Field(ge=1, le=100_000)]
    log: tuple[str, ...] = ()
    """Keys that are spread evenly in their logarithm."""

    @field_validator("ranges")
    @classmethod
    def _pairs(cls, ranges: Settings) -> Settings:
        flat = flatten(ranges)
        for key, pair in flat.items():
            numbers = isinstance(pair, list | tuple) and len(pair) == 2 and all(type(v) in (int, float) for v in pair)
            if not numbers or not pair[0] < pair[1]:
                raise ValueError(f"{key}: expected [low, high], found {pair!r}")
        return flat

    @model_validator(mode="after")
    def _logarithms(self) -> _Ranges:
        for key in self.log:
            if key not in self.ranges:
                raise ValueError(f"log: found {key!r}, {nearest(key, list(self.ranges))}")
            if not self.ranges[key][0] > 0:
                raise ValueError(f"log: {key} begins at {self.ranges[key][0]}, a logarithm needs more than 0")
        return self


class LatinHypercube(_Ranges):
    """Points spread over ranges so that every key by itself is covered evenly."""

    kind: Literal["latin_hypercube"]


class Sobol(_Ranges):
    """Points of a scrambled Sobol sequence, evenly spread in all keys together."""

    kind: Literal["sobol"]

    @field_validator("points")
    @classmethod
    def _power_of_two(cls, points: int) -> int:
        if points & (points - 1):
            raise ValueError("should be a power of two, or the sequence loses its balance")
        return points


class LabelTracks(Spec):
    """The vehicles of a KITTI tracking label file that are long enough in view, one after the other."""

    kind: Literal["label_tracks"]
    vehicle: Annotated[int, Field(ge=0)] = 0
    """Number of the vehicle whose motion replays the file, which the scenario, the study or ``--set`` names."""
    frames: Annotated[int, Field(ge=5)] = 20
    """Least number of frames in which a car is labelled."""
    types: Annotated[tuple[Literal["Car", "Van", "Truck", "Tram", "Misc"], ...], Field(min_length=1)] = ("Car",)
    """KITTI types."""

    @property
    def key(self) -> str:
        return f"vehicle.{self.vehicle}.motion.track"


Sweep = Annotated[Grid | PointList | LatinHypercube | Sobol | LabelTracks, Field(discriminator="kind")]


def swept_keys(sweeps: Sequence[Sweep]) -> Iterator[tuple[str, str]]:
    """Where in the study a key is swept, and the key."""
    for i, sweep in enumerate(sweeps):
        if isinstance(sweep, Grid):
            yield f"sweep.{i}.key", sweep.key
        elif isinstance(sweep, LabelTracks):
            yield f"sweep.{i}", sweep.key
        elif isinstance(sweep, PointList):
            yield from ((f"sweep.{i}.points", key) for key in sweep.points[0])
        else:
            yield from ((f"sweep.{i}.ranges", key) for key in sweep.ranges)
