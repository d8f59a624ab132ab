"""Study files: a scenario, what is varied in it, how often it is measured, and the tables and figures made of that.

In place of a scenario it may name a numeric experiment, ``experiment = "single_precision"``.

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
from collections.abc import Sequence
from pathlib import Path
from types import GenericAlias
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, create_model, field_validator, model_validator

from reports.outputs import FIGURES, TABLES
from scenarios import spec
from scenarios.study_outputs import output_type
from scenarios.study_subject import content, validated
from scenarios.study_sweeps import Settings, Sweep, flatten, swept_keys
from scenarios.trial import KEEP, QUANTITIES
from sim.scenario import ScenarioError, Spec, explain, nearest

FOLDER = Path(__file__).parent / "studies"
# Keys of a study that mean nothing to a numeric experiment.
_OF_SCENARIOS = ("estimator", "keep", "examples")


class StudySpec(Spec):
    """A study: what is varied, how often each point is measured, which errors are kept."""

    title: str
    source: str = ""
    kind: Literal["study"]
    scenario: str | None = None
    """Name of a scenario, or a file relative to this one."""
    experiment: str | None = None
    """Name of a numeric experiment, in place of a scenario."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] | None = None
    """By default the scenario's or experiment's."""
    runs: Annotated[int, Field(ge=1, le=1_000_000)] = 100
    """Measurements of every point."""
    set: Annotated[Settings, Field(default_factory=dict)]
    """Settings laid over the scenario or experiment at every point."""
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
    def _scenario_or_experiment(self) -> StudySpec:
        if self.experiment is None and self.scenario is None:
            raise ValueError("scenario: key is missing, or experiment in its place")
        if self.experiment is not None:
            for key in ("scenario", *_OF_SCENARIOS):
                if key in self.model_fields_set:
                    raise ValueError(f"{key}: means nothing beside experiment")
        return self

    @model_validator(mode="after")
    def _once(self) -> StudySpec:
        swept = [key for _, key in swept_keys(self.sweep)]
        for where, key in swept_keys(self.sweep):
            if swept.count(key) > 1:
                raise ValueError(f"{where}: {key} is swept {swept.count(key)} times")
        for kind in ("estimator", "table", "figure"):
            labels: list[str] = [x.title for x in getattr(self, kind)]
            for label in labels:
                if labels.count(label) > 1:
                    raise ValueError(f"{kind}: the label {label!r} is used {labels.count(label)} times")
        return self


@functools.cache
def study_model() -> type[StudySpec]:
    """The model of a study file with the estimators, tables and figures that are registered."""
    types = {
        "estimator": spec.estimator_type(),
        "table": output_type("table", TABLES),
        "figure": output_type("figure", FIGURES),
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
    """The validated study of a file, and what it measures with the study's and the command line's settings.

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
        base = content(study.experiment, study.scenario, path.parent)
        if "estimator" in data:
            base["estimator"] = data["estimator"]
        if study.seed is not None:
            base["seed"] = study.seed
        lay_all(base, study.set, path.parent)
        validated(base)
    except ScenarioError as error:
        prefix = "set." if any(concerns(error, key) for key in study.set) else ""
        raise ScenarioError(f"{path.name}: {prefix}{error}") from error
    _override(study, base, settings)
    if estimators:
        base["estimator"] = _chosen(base.get("estimator", []), estimators)
    return study, base


def _chosen(estimators: Sequence[Settings], labels: Sequence[str]) -> list[Settings]:
    """Those of a scenario's estimators that have these labels."""
    found: dict[str, Settings] = {e.get("label") or e["name"]: e for e in estimators}
    if not found:
        raise ScenarioError(f"--estimator {labels[0]}: an experiment has no estimators")
    for label in labels:
        if label not in found:
            raise ScenarioError(f"--estimator: found {label!r}, {nearest(label, list(found))}")
    return [e for label, e in found.items() if label in labels]


def concerns(error: ScenarioError, key: str) -> bool:
    """Whether an error that begins with a key is about this one, or what lies in it or above it."""
    named = str(error).partition(":")[0]
    return named.startswith(key) or key.startswith(named)


def _override(study: StudySpec, base: Settings, settings: Sequence[str]) -> None:
    """Lays ``--set`` over the scenario or experiment of a study."""
    touched = spec.set_all(base, settings)
    for where, key in swept_keys(study.sweep):
        if key in touched:
            raise ScenarioError(f"--set {key}: the study varies it ({where})")
    try:
        validated(base)
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
