"""Numeric experiments: what a study measures where no world is needed.

An experiment is a frozen dataclass whose constructor is its configuration, as an estimator's is. A study names it in
place of a scenario, and its keys are varied as those of a scenario are:

    kind = "study"; experiment = "single_precision"; runs = 100
    [set]
    states = 6
    [[sweep]]
    kind = "grid"; key = "range"; values = [1e2, 1e4]
"""

from __future__ import annotations

import functools
from typing import Annotated, Any, Literal, Protocol

import pandas as pd
from pydantic import Field, ValidationError, create_model, model_validator

from scenarios.experiments.boresight_calibration import BoresightCalibration
from scenarios.experiments.boresight_ties import BoresightTies
from scenarios.experiments.boresight_time_offset import BoresightTimeOffset
from scenarios.experiments.interior_orientation import WallCalibration
from scenarios.experiments.ortho_accuracy import OrthoAccuracy
from scenarios.experiments.road_accuracy import RoadAccuracy
from scenarios.experiments.scalar_filter import ScalarFilter
from scenarios.experiments.single_precision import SinglePrecision
from scenarios.spec import constructor
from sim.scenario import ScenarioError, Spec, explain


class Experiment(Protocol):
    """What a study calls with seed and run: a pure function of its configuration and both."""

    @property
    def cases(self) -> tuple[str, ...]:
        """What is compared, in the place of a scenario's estimators."""

    def __call__(self, seed: int, run: int) -> pd.DataFrame:
        """Rows (estimator, quantity, t_s, value): case, what was measured, and after how many steps."""


EXPERIMENTS: dict[str, type[Any]] = {
    "boresight_calibration": BoresightCalibration,
    "boresight_ties": BoresightTies,
    "boresight_time_offset": BoresightTimeOffset,
    "interior_orientation": WallCalibration,
    "ortho_accuracy": OrthoAccuracy,
    "road_accuracy": RoadAccuracy,
    "scalar_filter": ScalarFilter,
    "single_precision": SinglePrecision,
}


class ExperimentSpec(Spec):
    """An experiment by its registered name, its seed, and its constructor's arguments."""

    experiment: str
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1

    @model_validator(mode="after")
    def _constructible(self) -> ExperimentSpec:
        self.build()
        return self

    def build(self) -> Any:
        """The experiment itself; raises ValueError where its constructor does."""
        return EXPERIMENTS[self.experiment](**{k: v for k, v in self if k not in ExperimentSpec.model_fields})


@functools.cache
def experiment_model(name: str) -> type[ExperimentSpec]:
    """The model of an experiment's configuration."""
    cls = EXPERIMENTS[name]
    fields: dict[str, Any] = {"experiment": (Literal[name], ...)} | constructor(cls)
    return create_model(f"experiment_{name}", __base__=ExperimentSpec, __doc__=cls.__doc__, **fields)


def validated(data: dict[str, Any]) -> ExperimentSpec:
    """The experiment of a configuration.

    Raises
        ScenarioError: one line that names the key.
    """
    model = experiment_model(data["experiment"])
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise ScenarioError(explain(error, model)) from error
