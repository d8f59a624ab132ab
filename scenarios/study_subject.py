"""What a study measures at its points: a scenario with its estimators, or a numeric experiment with its cases."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from scenarios import experiments, spec
from scenarios.experiments import EXPERIMENTS, ExperimentSpec
from scenarios.study_sweeps import Settings
from scenarios.trial import TrialResult, of_measures, trial
from sim.scenario import ScenarioError, nearest

# Kinds of scenarios that only `run` takes.
_ONCE = ("calibration", "flight", "recording")


def content(experiment: str | None, scenario: str | None, folder: Path) -> Settings:
    """What a scenario's file holds, without images, or the name of an experiment, which has a default for everything.

    folder: what a scenario that is a file is relative to.
    """
    if experiment is not None:
        if experiment not in EXPERIMENTS:
            raise ScenarioError(f"experiment: found {experiment!r}, {nearest(experiment, list(EXPERIMENTS))}")
        return {"experiment": experiment}
    assert scenario is not None
    data = spec.load(scenario_file(scenario, folder))
    if data.get("kind") in _ONCE:
        raise ScenarioError(
            f"scenario: found {scenario!r}, a {data['kind']}; a study varies stereo scenes or experiments"
        )
    spec.lay(data, "render.enabled", False)
    return data


def scenario_file(name: str, folder: Path) -> Path:
    """The file of a study's scenario; a file in it is relative to the study's folder."""
    try:
        return spec.find(str(folder / name) if name.endswith(".toml") else name)
    except ScenarioError as error:
        raise ScenarioError(f"scenario: {error}") from error


def validated(data: Settings) -> Any:
    """The scenario or experiment of its content.

    Raises
        ScenarioError: one line that names the key.
    """
    return experiments.validated(data) if "experiment" in data else spec.validated(data)


def decoded(text: str) -> Any:
    """The scenario or experiment that was resolved and written as JSON."""
    data = json.loads(text)
    model = experiments.experiment_model(data["experiment"]) if "experiment" in data else spec.run_model()
    return model.model_validate_json(text)


def labels(subject: Any) -> tuple[str, ...]:
    """What is compared: estimators or cases."""
    if isinstance(subject, ExperimentSpec):
        return tuple(subject.build().cases)
    return tuple(e.title for e in subject.estimator)


def measured(subject: Any, run: int, keep: tuple[str, ...]) -> TrialResult:
    """One run; whatever it raises is that run's failure."""
    if isinstance(subject, ExperimentSpec):
        return of_measures(run, subject.build()(subject.seed, run))
    return trial(subject, run, keep)
