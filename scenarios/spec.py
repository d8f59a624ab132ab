"""A whole scenario file: the world of `sim.scenario` joined with the estimators' own constructor arguments."""

from __future__ import annotations

import copy
import dataclasses
import functools
import operator
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_type_hints

from pydantic import Field, TypeAdapter, ValidationError, create_model, field_validator, model_validator

from estimators import registry
from estimators.stereo.features import FrontEnd
from sim.scenario import Measure, MotionSegmentation, Name, Scenario, ScenarioError, Spec, explain, nearest

FOLDER = Path(__file__).parent
# Keys that hold paths; in a file they are relative to it, on the command line to the working folder.
_PATHS = (
    *(("vehicle", "*", "motion", "labels"), ("vehicle", "*", "mesh"), ("ego", "poses")),
    *(("recording", key) for key in ("left", "right", "calib", "poses", "boxes")),
    *(("ground", key) for key in ("roads", "buildings", "terrain")),
    *(("calibration", key) for key in ("gcp_list", "images")),
)


class EstimatorSpec(Spec):
    """An estimator by its registered name, its label, and its constructor's arguments."""

    builds: ClassVar[type[Any]]
    name: str
    label: Name | None = None

    @property
    def title(self) -> str:
        return self.label or self.name

    @property
    def arguments(self) -> dict[str, Any]:
        return {k: v for k, v in self if k not in ("name", "label")}

    @model_validator(mode="after")
    def _constructible(self) -> EstimatorSpec:
        self.build()
        return self

    def build(self) -> Any:
        """The estimator itself; raises ValueError where its constructor does."""
        return self.builds(**self.arguments)


class FrontEndSpec(Spec):
    """The image front end by its constructor's arguments, but for what ``measure`` says: points and segmentation."""

    @model_validator(mode="after")
    def _constructible(self) -> FrontEndSpec:
        self.build(Measure())
        return self

    def build(self, measure: Measure) -> FrontEnd:
        """The front end itself; raises ValueError where its constructor does."""
        motion = isinstance(measure.segmentation, MotionSegmentation)
        return FrontEnd(points=measure.points, segmentation="motion" if motion else "given", **dict(self))


def constructor(cls: type[Any]) -> dict[str, Any]:
    """The arguments of a dataclass as the fields of a model."""
    hints = get_type_hints(cls)
    fields: dict[str, Any] = {}
    for f in dataclasses.fields(cls):
        if f.default is not dataclasses.MISSING:
            default: Any = f.default
        elif f.default_factory is not dataclasses.MISSING:
            default = Field(default_factory=f.default_factory)
        else:
            default = ...
        fields[f.name] = (hints[f.name], default)
    return fields


def _estimator_model(name: str, cls: type[Any]) -> type[EstimatorSpec]:
    fields = {"name": (Literal[name], ...)} | constructor(cls)
    model = create_model(f"estimator_{name}", __base__=EstimatorSpec, __doc__=cls.__doc__, **fields)
    model.builds = cls
    return model


def _front_end_model() -> type[FrontEndSpec]:
    said = ("points", "segmentation")
    fields = {name: field for name, field in constructor(FrontEnd).items() if name not in said}
    return create_model("front_end", __base__=FrontEndSpec, __doc__=FrontEnd.__doc__, **fields)


def one_of(models: Sequence[type[Spec]], key: str = "name") -> Any:
    """The type of a table in a file that is one of several, told apart by a key."""
    union = functools.reduce(operator.or_, models)
    return Annotated[union, Field(discriminator=key)] if len(models) > 1 else union


def estimator_type(known: Mapping[str, type[Any]] | None = None) -> Any:
    """The type of an ``[[estimator]]``: one of those known, by default those for stereo that are installed."""
    known = registry() if known is None else known
    return one_of([_estimator_model(n, c) for n, c in sorted(known.items())])


def check_labels(estimators: Sequence[Any]) -> None:
    """Raises ValueError where two estimators have the same label."""
    labels: list[str] = [e.title for e in estimators]
    for label in labels:
        if labels.count(label) > 1:
            raise ValueError(f"estimator: the label {label!r} is used {labels.count(label)} times")


@functools.cache
def run_model() -> type[Scenario]:
    """The model of a scenario file with the estimators that are installed."""
    one, front_end_model = estimator_type(), _front_end_model()

    class Run(Scenario):
        """A scenario file: world, measurement, image front end and estimators."""

        front_end: front_end_model | None = None  # type: ignore[valid-type]  # made above
        estimator: Annotated[tuple[one, ...], Field(min_length=1)]  # type: ignore[valid-type]  # made above

        @model_validator(mode="before")
        @classmethod
        def _front_end_of_images(cls, data: Any) -> Any:
            measure = data.get("measure") if isinstance(data, dict) else None
            images = isinstance(measure, dict) and measure.get("from") == "images"
            return {"front_end": {}} | data if images else data

        @field_validator("front_end")
        @classmethod
        def _front_end_acts(cls, given: Any, info: Any) -> Any:
            measure = info.data.get("measure")  # not there where it is wrong itself
            if given is not None and measure is not None and not measure.from_images:
                raise ValueError(f"does nothing to points from {measure.source!r}")
            return given

        @model_validator(mode="after")
        def _unique_labels(self) -> Run:
            check_labels(self.estimator)
            return self

    Run.__name__ = "Scenario"
    return Run


KINDS = ("stereo", "recordings", "flights", "calibrations")
"""Folders of the scenarios that ship with the project."""


def names() -> dict[str, Path]:
    """The scenarios that ship with the project, by name."""
    return {p.stem: p for kind in KINDS for p in sorted(FOLDER.glob(f"{kind}/*.toml"))}


def find(name_or_file: str) -> Path:
    """The file of a scenario given by name or path.

    Raises
        ScenarioError: there is neither such a scenario nor such a file.
    """
    return find_in(names(), "scenario", name_or_file)


def find_in(known: Mapping[str, Path], kind: str, name_or_file: str) -> Path:
    """The file of what is known by a name, or is a file itself."""
    if name_or_file in known:
        return known[name_or_file]
    path = Path(name_or_file)
    if path.suffix != ".toml" and not path.exists():
        raise ScenarioError(f"no {kind} {name_or_file!r}, {nearest(name_or_file, list(known))}")
    if not path.is_file():
        raise ScenarioError(f"{path}: no such file")
    return path


def read(name_or_file: str, settings: Sequence[str] = (), seed: int | None = None) -> Any:
    """The validated scenario of a file with ``key.path=value`` settings laid over it.

    Raises
        ScenarioError: one line that names file and key.
    """
    path = find(name_or_file)
    data = load(path)
    touched = set_all(data, settings)
    if seed is not None:
        data["seed"] = seed
    try:
        return validated(data)
    except ScenarioError as error:
        by_seed = seed is not None and str(error).startswith("seed:")
        origin = "--seed" if by_seed else "--set" if any(t in str(error) for t in touched) else path.name
        raise ScenarioError(f"{origin}: {error}") from error


def load(path: Path) -> dict[str, Any]:
    """The content of a TOML file, the paths in it made absolute; not validated."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(f"{path.name}: not valid TOML: {error}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or 'not text'}") from error
    absolutise(data, path.parent)
    return data


def validated(data: dict[str, Any]) -> Any:
    """The scenario of a file's content.

    Raises
        ScenarioError: one line that names the key.
    """
    model = _model(data)
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise ScenarioError(explain(error, model)) from error


_KINDS = ("stereo", "recording", "flight", "calibration")


def _model(data: dict[str, Any]) -> type[Spec]:
    """The model of a file's content, by its kind."""
    if data.get("kind") == "recording":
        from scenarios.recording_spec import recording_model

        return recording_model()
    if data.get("kind") == "flight":
        from scenarios.flight_spec import flight_model

        return flight_model()
    if data.get("kind") == "calibration":
        from scenarios.calibration_spec import calibration_model

        return calibration_model()
    return run_model()


def set_all(data: dict[str, Any], settings: Sequence[str]) -> list[str]:
    """Lays ``--set key.path=value`` over the data, each value TOML, or else a bare string; the keys touched."""
    touched = []
    for setting in settings:
        key, equals, text = setting.partition("=")
        if not equals or not key.strip():
            raise ScenarioError(f"--set {setting}: expected key.path=value")
        try:
            value = tomllib.loads(f"x = {text}")["x"]
        except tomllib.TOMLDecodeError:
            value = text
        try:
            lay(data, key.strip(), value)
        except ScenarioError as error:
            raise ScenarioError(f"--set {error}") from error
        touched.append(key.strip())
    absolutise(data, Path.cwd())
    return touched


def lay(data: dict[str, Any], key: str, value: Any) -> None:
    """Sets one dotted key; a part ``*`` stands for every item of a list.

    Raises
        ScenarioError: there is no such item.
    """
    *parents, last = key.split(".")
    nodes: list[Any] = [data]
    for i, part in enumerate(parents):
        path = ".".join(parents[: i + 1])
        nodes = [
            child
            for node in nodes
            for child in ([node.setdefault(part, {})] if isinstance(node, dict) else _items(node, part, path))
        ]
    for node in nodes:
        if isinstance(node, dict):
            node[last] = copy.deepcopy(value)
        else:
            for i in _indices(node, last, key):
                node[i] = copy.deepcopy(value)


def _items(node: Any, part: str, key: str) -> list[Any]:
    return [node[i] for i in _indices(node, part, key)]


def _indices(node: Any, part: str, key: str) -> Sequence[int]:
    if not isinstance(node, list):
        raise ScenarioError(f"{key}: {key.rpartition('.')[0]!r} has no keys of its own")
    if part == "*":
        return range(len(node))
    if not part.isdigit() or int(part) >= len(node):
        raise ScenarioError(f"{key}: expected an index 0..{len(node) - 1}, found {part!r}")
    return [int(part)]


def absolutise(data: dict[str, Any], base: Path) -> None:
    """Makes the relative paths in a scenario's content absolute."""
    for pattern in _PATHS:
        for owner, last in _owners(data, pattern):
            value = owner.get(last)
            if isinstance(value, list):
                owner[last] = [str((base / v).resolve()) if isinstance(v, str) else v for v in value]
            elif isinstance(value, str) and (last != "mesh" or any(c in value for c in "./\\")):
                owner[last] = str((base / value).resolve())


def _owners(node: Any, pattern: tuple[str, ...]) -> Iterator[tuple[dict[str, Any], str]]:
    if len(pattern) == 1:
        if isinstance(node, dict):
            yield node, pattern[0]
    elif pattern[0] == "*":
        for item in node if isinstance(node, list) else ():
            yield from _owners(item, pattern[1:])
    elif isinstance(node, dict):
        yield from _owners(node.get(pattern[0]), pattern[1:])


def input_files(spec: Scenario) -> list[Path]:
    """Files outside the scenario that its result depends on."""
    data = spec.model_dump(mode="json")
    values = [owner.get(last) for pattern in _PATHS for owner, last in _owners(data, pattern)]
    found = [path for value in values for path in (value if isinstance(value, list) else [value])]
    return [Path(p) for p in found if isinstance(p, str) and ("/" in p or "\\" in p)]


def json_schema() -> dict[str, Any]:
    """JSON Schema of scenario files of all kinds."""
    models = [_model({"kind": kind}) for kind in _KINDS]
    adapter: TypeAdapter[Any] = TypeAdapter(one_of(models, "kind"))
    schema = adapter.json_schema()
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "pruefstand scenario"
    return schema
