"""The file of a flight: the world and the flight of `sim.scenario.flight`, and the estimators for its images."""

from __future__ import annotations

import functools
from typing import Annotated

from pydantic import Field, model_validator

from estimators.aerial.registry import FLIGHT_ESTIMATORS
from scenarios import spec
from sim.scenario.flight import FlightScenario


@functools.cache
def flight_model() -> type[FlightScenario]:
    """The model of a flight's file with the estimators for flights."""
    one = spec.estimator_type(FLIGHT_ESTIMATORS)

    class Run(FlightScenario):
        """A flight's file: ground, flight, cameras, navigation, maps and estimators."""

        estimator: Annotated[tuple[one, ...], Field(min_length=1)]  # type: ignore[valid-type]  # made above

        @model_validator(mode="after")
        def _unique_labels(self) -> Run:
            spec.check_labels(self.estimator)
            return self

        @property
        def without_estimators(self) -> FlightScenario:
            return FlightScenario(**{name: getattr(self, name) for name in FlightScenario.model_fields})

    Run.__name__ = "Flight"
    return Run
