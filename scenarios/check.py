"""The regression check: a battery of scenes and estimators measured with this code, held against baselines in git.

A battery is a TOML file; every scene is a scenario with settings laid over it and the estimators it is to be measured
with. Its baselines lie in the folder ``baselines`` beside it.

    runs = 12
    [[scene]]
    name = "oncoming"                        # of the baseline file, too
    scenario = "oncoming"                    # a name, or a file relative to this one
    set = { "rig.frames" = 14 }
    each = { name = "sliding_window_adjustment" }    # what all estimators of the scene have in common
    estimator = [ { label = "observed", weights = "observed" }, { label = "whole", selection = "whole" } ]
"""

from __future__ import annotations

import json
import multiprocessing
import os
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
from pydantic import Field, ValidationError, field_validator

from reports.metrics import SUPPORT_COLUMNS, Pooled
from reports.regression.checked import run_values
from reports.regression.files import read_baselines, write_baselines, write_json, write_junit
from reports.regression.verdicts import LABELS, MAX_RUNS, MIN_RUNS, compare
from scenarios import spec
from scenarios.engine import Progress
from scenarios.store import digest, git_commit, versions
from scenarios.trial import TrialResult, trial
from sim.scenario import Name, ScenarioError, Spec, explain

BATTERY = spec.FOLDER / "battery.toml"
Job = tuple[str, str, int]
_OFF = {"render.enabled": False}


class Scene(Spec):
    """A scenario with settings laid over it, and the estimators to measure with."""

    name: Name
    scenario: str
    set: dict[str, Any] = Field(default_factory=dict)
    each: dict[str, Any] = Field(default_factory=dict)
    estimator: Annotated[tuple[dict[str, Any], ...], Field(min_length=1)]


class Battery(Spec):
    """What the regression check measures; every scene so many times."""

    runs: Annotated[int, Field(ge=MIN_RUNS, le=MAX_RUNS)] = MAX_RUNS
    scene: Annotated[tuple[Scene, ...], Field(min_length=1)]

    @field_validator("scene")
    @classmethod
    def _unique_names(cls, scenes: tuple[Scene, ...]) -> tuple[Scene, ...]:
        names = [s.name for s in scenes]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"the name {name!r} is used {names.count(name)} times")
        return scenes


def read_battery(path: Path) -> tuple[int, dict[str, Any]]:
    """Number of runs and the validated scenario of every scene by name.

    Raises
        ScenarioError: one line that names file and key.
    """
    if not path.is_file():
        raise ScenarioError(f"{path}: no such file")
    try:
        battery = Battery.model_validate(spec.load(path))
    except ValidationError as error:
        raise ScenarioError(f"{path.name}: {explain(error, Battery)}") from error
    scenarios = {}
    for scene in battery.scene:
        try:
            scenarios[scene.name] = _scenario(scene, path.parent)
        except ScenarioError as error:
            raise ScenarioError(f"{path.name}: scene {scene.name!r}: {error}") from error
    return battery.runs, scenarios


def _scenario(scene: Scene, folder: Path) -> Any:
    file = folder / scene.scenario
    data = spec.load(spec.find(str(file) if file.is_file() else scene.scenario))
    for key, value in (_OFF | scene.set).items():
        spec.lay(data, key, value)
    spec.absolutise(data, folder)
    return spec.validated(data | {"estimator": [scene.each | e for e in scene.estimator]})


def measure(runs: int, scenarios: Mapping[str, Any], workers: int, progress: Progress) -> pd.DataFrame:
    """Every checked metric of every scene, estimator and run, as `reports.regression.verdicts.compare` takes them."""
    jobs = [(name, s.model_dump_json(by_alias=True), run) for name, s in scenarios.items() for run in range(runs)]
    with progress.stage("check", len(jobs)) as advance:
        tables = []
        for table in _worked(jobs, min(workers, len(jobs))):
            tables.append(table)
            advance()
    values = pd.concat(tables, ignore_index=True)
    configs = {(name, e.title): config(s, e, runs) for name, s in scenarios.items() for e in s.estimator}
    values["config"] = [configs[key] for key in zip(values["scene"], values["estimator"], strict=True)]
    values["run"] = values["run"].astype(str)
    wide = values.pivot_table(index=LABELS, columns="run", values="value", aggfunc="sum")
    return wide[[str(r) for r in range(runs)]].rename_axis(columns=None).reset_index()


def _worked(jobs: Sequence[Job], workers: int) -> Iterator[pd.DataFrame]:
    """Results of the jobs as they come; a single worker is this process."""
    if workers == 1:
        yield from map(_work, jobs)
        return
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        try:
            for future in as_completed([pool.submit(_work, job) for job in jobs]):
                yield future.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _work(job: Job) -> pd.DataFrame:
    """The checked metrics of all estimators of a scene in one run."""
    scene, scenario, run = job
    try:
        result = trial(spec.run_model().model_validate_json(scenario), run)
    except Exception as error:  # whatever an estimator raises, said with its scene and run
        raise RuntimeError(f"scene {scene!r}, run {run}: {type(error).__name__}: {error}") from error
    labels = result.support["estimator"]
    tables = [run_values(_pooled(result, label)).assign(scene=scene, estimator=label, run=run) for label in labels]
    return pd.concat(tables, ignore_index=True)


def _pooled(result: TrialResult, label: str) -> Pooled:
    names = ("comparison", "nees", "outliers", "failures", "support", "runtimes")
    comparison, nees, outliers, failures, support, runtimes = (
        table[table["estimator"] == label] for table in (getattr(result, name) for name in names)
    )
    seconds = runtimes["seconds"].to_numpy()
    return Pooled(comparison, nees, outliers, failures["reason"], support[SUPPORT_COLUMNS], seconds)


def config(scenario: Any, estimator: Any, runs: int) -> str:
    """What a baseline was made of, as far as it is not default: another one is no baseline."""
    given = scenario.model_dump(mode="json", exclude_defaults=True, exclude={"estimator", "title", "source"})
    text = json.dumps([given, estimator.model_dump(mode="json", exclude_defaults=True), runs], sort_keys=True)
    for path in spec.input_files(scenario):
        text = text.replace(json.dumps(str(path))[1:-1], path.name)
    return digest(text)[:8]


@dataclass(frozen=True)
class Outcome:
    """The verdicts on every metric, as `reports.regression.verdicts.compare` gives them; where the baselines are."""

    verdicts: pd.DataFrame
    baselines: Path

    @property
    def worse(self) -> bool:
        return bool((self.verdicts["verdict"] == "worse").any())

    @property
    def unknown(self) -> bool:
        """Whether there are metrics without a baseline."""
        return bool((self.verdicts["verdict"] == "new").any())


def _require_writable(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ScenarioError(f"{folder}: cannot be written: {reason}") from error


def check(battery: Path, out: Path, progress: Progress, workers: int | None = None, update: bool = False) -> Outcome:
    """Measures a battery and compares it with its baselines, which it rewrites where ``update``.

    workers: processes, by default one per processor. Writes verdicts.json and junit.xml into ``out``.

    Raises
        ScenarioError: battery or baselines are wrong, or a folder cannot be written.
    """
    if workers is not None and workers < 1:
        raise ScenarioError(f"--workers: expected 1 or more, found {workers}")
    runs, scenarios = read_battery(battery)
    folder = battery.parent / "baselines"
    try:
        old = read_baselines(folder)
    except ValueError as error:
        raise ScenarioError(str(error)) from error
    for path in (out, folder) if update else (out,):
        _require_writable(path)
    started = time.perf_counter()
    new = measure(runs, scenarios, workers or os.cpu_count() or 1, progress)
    verdicts = compare(old, new)
    about = {"battery": battery.name, "runs": runs, "git_commit": git_commit(), "versions": versions()}
    write_json(out / "verdicts.json", verdicts, about | {"seconds": round(time.perf_counter() - started, 1)})
    write_junit(out / "junit.xml", verdicts)
    if update:
        write_baselines(folder, new)
    return Outcome(verdicts, folder)
