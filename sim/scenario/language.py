"""What all files of the bench have in common: strict models, kinds of numbers, and errors in one line."""

from __future__ import annotations

import difflib
import re
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError


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


def nearest(word: str, allowed: list[str]) -> str:
    """ "(did you mean 'x'?)" where an allowed word is near, else the allowed words."""
    close = difflib.get_close_matches(word, allowed, n=1, cutoff=0.5)
    if close:
        return f"did you mean {close[0]!r}?"
    return "allowed: " + ", ".join(allowed)


def choose(key: str, found: str, allowed: list[str]) -> None:
    """Raises ValueError, naming the key, where a word is not among those allowed."""
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
