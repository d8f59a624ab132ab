"""Study files: a scenario, what is varied in it, how often it is measured, and the tables and figures made of that.

    title = "..."; kind = "study"; scenario = "oncoming"; runs = 100
    [set]
    rig.frames = 30
    [[sweep]]
    kind = "grid"; key = "measure.sigma_px"; values = [0.1, 0.2]
    [[sweep]]
    kind = "sobol"; points = 16; ranges = { vehicle.0.motion.speed_mps = [5.0, 20.0] }
    [[sweep]]
    kind = "label_tracks"; frames = 20
    [[figure]]
    name = "lines"; over = "measure.sigma_px"

A key is dotted as for ``--set``, ``*`` for every item of a list. Written as one quoted string it takes a table as its
value; nested tables are keys of their own.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import GenericAlias
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import Field, ValidationError, create_model, field_validator, model_validator

from reports.outputs import FIGURES, TABLES
from scenarios import spec
from scenarios.trial import KEEP, QUANTITIES
from sim.scenario import Name, ScenarioError, Spec, explain, nearest

FOLDER = Path(__file__).parent / "studies"
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


class Output(Spec):
    """A table or figure by its registered name, with the function's own options."""

    name: str
    label: Name | None = None
    """File name and heading; the name by default."""
    caption: str = ""

    @property
    def title(self) -> str:
        return self.label or self.name

    @property
    def options(self) -> Settings:
        return {k: v for k, v in self if k not in Output.model_fields}


def _output_type(kind: str, functions: Mapping[str, Callable[..., Any]]) -> Any:
    models = []
    for name, function in sorted(functions.items()):
        hints = get_type_hints(function)
        options: dict[str, Any] = {
            p.name: (hints[p.name], ... if p.default is p.empty else p.default)
            for p in inspect.signature(function).parameters.values()
            if p.kind is p.KEYWORD_ONLY
        }
        fields: dict[str, Any] = {"name": (Literal[name], ...)} | options
        models.append(create_model(f"{kind}_{name}", __base__=Output, __doc__=function.__doc__, **fields))
    return spec.one_of(models)


class StudySpec(Spec):
    """A study: what is varied, how often each point is measured, which errors are kept."""

    title: str
    source: str = ""
    kind: Literal["study"]
    scenario: str
    """Name of a scenario, or a file relative to this one."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] | None = None
    """By default the scenario's."""
    runs: Annotated[int, Field(ge=1, le=1_000_000)] = 100
    """Measurements of every point."""
    set: Annotated[Settings, Field(default_factory=dict)]
    """Settings laid over the scenario at every point."""
    sweep: tuple[Sweep, ...] = ()
    """What is varied; several sweeps multiply, the first one outermost."""
    keep: Annotated[tuple[Literal[QUANTITIES], ...], Field(min_length=1)] = KEEP  # type: ignore[valid-type]  # a tuple
    """Quantities whose error rows are stored."""
    examples: bool = False
    """Whether run 0 of every point is kept as a whole, for figures that show a single run."""

    @field_validator("set")
    @classmethod
    def _flat(cls, settings: Settings) -> Settings:
        return flatten(settings)

    @model_validator(mode="after")
    def _once(self) -> StudySpec:
        swept = [key for _, key in self.swept_keys()]
        for where, key in self.swept_keys():
            if swept.count(key) > 1:
                raise ValueError(f"{where}: {key} is swept {swept.count(key)} times")
        for kind in ("estimator", "table", "figure"):
            labels: list[str] = [x.title for x in getattr(self, kind)]
            for label in labels:
                if labels.count(label) > 1:
                    raise ValueError(f"{kind}: the label {label!r} is used {labels.count(label)} times")
        return self

    def swept_keys(self) -> Iterator[tuple[str, str]]:
        """Where in the study a key is swept, and the key."""
        for i, sweep in enumerate(self.sweep):
            if isinstance(sweep, Grid):
                yield f"sweep.{i}.key", sweep.key
            elif isinstance(sweep, LabelTracks):
                yield f"sweep.{i}", sweep.key
            elif isinstance(sweep, PointList):
                yield from ((f"sweep.{i}.points", key) for key in sweep.points[0])
            else:
                yield from ((f"sweep.{i}.ranges", key) for key in sweep.ranges)


@functools.cache
def study_model() -> type[StudySpec]:
    """The model of a study file with the estimators, tables and figures that are registered."""
    types = {
        "estimator": spec.estimator_type(),
        "table": _output_type("table", TABLES),
        "figure": _output_type("figure", FIGURES),
    }
    fields: dict[str, Any] = {key: (GenericAlias(tuple, (one, ...)), ()) for key, one in types.items()}
    return create_model("Study", __base__=StudySpec, __doc__="A study file.", **fields)


def names() -> dict[str, Path]:
    """The studies that ship with the project, by name."""
    return {p.stem: p for p in sorted(FOLDER.glob("*.toml"))}


def find(name_or_file: str) -> Path:
    """The file of a study given by name or path.

    Raises
        ScenarioError: there is neither such a study nor such a file.
    """
    return spec.find_in(names(), "study", name_or_file)


def read(
    name_or_file: str,
    settings: Sequence[str] = (),
    seed: int | None = None,
    runs: int | None = None,
    estimators: Sequence[str] = (),
) -> tuple[Any, Settings]:
    """The validated study of a file, and its scenario's content with the study's and the command line's settings.

    estimators: labels of those that are wanted, all by default.

    Raises
        ScenarioError: one line that names file and key.
    """
    path = find(name_or_file)
    data = spec.load(path)
    asked = {key: value for key, value in (("seed", seed), ("runs", runs)) if value is not None}
    try:
        study = study_model().model_validate(data | asked)
    except ValidationError as error:
        message = explain(error, study_model())
        origin = next((f"--{key}" for key in asked if message.startswith(f"{key}:")), path.name)
        raise ScenarioError(f"{origin}: {message}") from error
    try:
        base = spec.load(scenario_file(study, path))
        if "estimator" in data:
            base["estimator"] = data["estimator"]
        if study.seed is not None:
            base["seed"] = study.seed
        lay_all(base, {"render.enabled": False} | study.set, path.parent)
        spec.validated(base)
    except ScenarioError as error:
        prefix = "set." if any(concerns(error, key) for key in study.set) else ""
        raise ScenarioError(f"{path.name}: {prefix}{error}") from error
    _override(study, base, settings)
    if estimators:
        base["estimator"] = _chosen(base, estimators)
    return study, base


def _chosen(base: Settings, labels: Sequence[str]) -> list[Settings]:
    """The estimators of a scenario's content that have these labels."""
    found: dict[str, Settings] = {e.get("label") or e["name"]: e for e in base["estimator"]}
    for label in labels:
        if label not in found:
            raise ScenarioError(f"--estimator: found {label!r}, {nearest(label, list(found))}")
    return [e for label, e in found.items() if label in labels]


def concerns(error: ScenarioError, key: str) -> bool:
    """Whether an error that begins with a key is about this one, or what lies in it or above it."""
    named = str(error).partition(":")[0]
    return named.startswith(key) or key.startswith(named)


def scenario_file(study: StudySpec, path: Path) -> Path:
    """The file of a study's scenario; a file in it is relative to the study's."""
    name = study.scenario
    try:
        return spec.find(str(path.parent / name) if name.endswith(".toml") else name)
    except ScenarioError as error:
        raise ScenarioError(f"scenario: {error}") from error


def _override(study: StudySpec, base: Settings, settings: Sequence[str]) -> None:
    """Lays ``--set`` over the scenario of a study."""
    touched = spec.set_all(base, settings)
    for where, key in study.swept_keys():
        if key in touched:
            raise ScenarioError(f"--set {key}: the study varies it ({where})")
    try:
        spec.validated(base)
    except ScenarioError as error:
        raise ScenarioError(f"--set: {error}") from error


def lay_all(data: Settings, settings: Settings, folder: Path) -> None:
    """Sets dotted keys; paths among their values are relative to a folder."""
    for key, value in settings.items():
        spec.lay(data, key, value)
    spec.absolutise(data, folder)


def json_schema() -> dict[str, Any]:
    """JSON Schema of study files."""
    schema = study_model().model_json_schema()
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "pruefstand study"
    return schema
