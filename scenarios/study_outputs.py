"""The tables and figures a study asks for: registered functions with their options as the keys of a file."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any, Literal, get_type_hints

from pydantic import create_model

from scenarios.spec import one_of
from scenarios.study_sweeps import Settings
from sim.scenario import Name, Spec


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


def output_type(kind: str, functions: Mapping[str, Callable[..., Any]]) -> Any:
    """The type of a table or figure in a study's file: one of those functions by its name."""
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
    return one_of(models)
