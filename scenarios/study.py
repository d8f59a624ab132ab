"""A study from its file to its report; started again, it goes on where it was."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from reports.study_html import write_study
from scenarios import engine
from scenarios.study_cluster import connected
from scenarios.study_console import Progress, Silent
from scenarios.study_points import Point, expand
from scenarios.study_spec import find, read
from scenarios.study_store import StudyStore
from scenarios.study_subject import labels, scenario_file
from scenarios.study_work import execute
from sim.archive import write_text
from sim.scenario import ScenarioError


@dataclasses.dataclass(frozen=True)
class Asked:
    """A study as asked for on the command line; ``out`` None means runs/NAME-SEED."""

    study: str
    runs: int | None = None
    workers: int | None = None
    scheduler: str | None = None
    settings: Sequence[str] = ()
    seed: int | None = None
    estimator: Sequence[str] = ()
    out: Path | None = None
    overwrite: bool = False


@dataclasses.dataclass(frozen=True)
class Outcome:
    """A study's folder, and the number of failed runs by reason."""

    folder: Path
    failed: dict[str, int]


def run(asked: Asked, progress: Progress) -> Outcome:
    """Runs what is missing of a study, then writes its tables, figures and report.

    Raises
        ScenarioError: the input is wrong, or the scheduler is not there or not like us.
        StudyStopped: it cannot go on; what is done is stored.
    """
    path = find(asked.study)
    study, base = read(asked.study, asked.settings, asked.seed, asked.runs, asked.estimator)
    try:
        points = expand(study, base, path.parent)
    except ScenarioError as error:
        raise ScenarioError(f"{path.name}: {error}") from error
    seed = int(base.get("seed", 1))
    folder = asked.out or Path("runs") / f"{path.stem}-{seed}"
    with ExitStack() as stack:
        client = stack.enter_context(connected(None, asked.scheduler)) if asked.scheduler else None
        store = stack.enter_context(StudyStore.open(folder, points, study.keep, asked.overwrite))
        missing = sum(len(gap) for i in range(len(points)) for gap in store.missing(i, study.runs))
        if missing:
            client = client or stack.enter_context(connected(asked.workers, None))
            total = len(points) * study.runs
            with progress.of(total, total - missing) as advance:
                execute(client, store, study.runs, study.keep, advance)
        else:
            progress.say(f"all {len(points) * study.runs} runs are there already")
        store.finish(study.runs)
        described = _described(study, points, path, seed)
        write_text(folder / "study.json", json.dumps(described, indent=1) + "\n")
        if study.examples:
            _write_examples(folder, described["scenario"], points)
        return Outcome(folder, _report(folder, path))


def _report(folder: Path, path: Path) -> dict[str, int]:
    """Writes tables, figures and report; the failed runs by reason."""
    try:
        result = write_study(folder)
    except ValueError as error:
        raise ScenarioError(f"{path.name}: {error}") from error
    crashed = result.failures[result.failures["kind"] == "exception"]
    return {str(k): int(v) for k, v in crashed["reason"].value_counts().items()}


def _described(study: Any, points: Sequence[Point], path: Path, seed: int) -> dict[str, Any]:
    """What the reports need to know of a study."""
    outputs = {
        kind: [
            {"name": o.name, "label": o.title, "caption": o.caption, "options": o.options} for o in getattr(study, kind)
        ]
        for kind in ("table", "figure")
    }
    return outputs | {
        "name": path.stem,
        "title": study.title,
        "source": study.source,
        "scenario": study.experiment or scenario_file(study.scenario, path.parent).stem,
        "experiment": study.experiment is not None,
        "seed": seed,
        "runs": study.runs,
        "keep": study.keep,
        "estimators": list(dict.fromkeys(label for p in points for label in labels(p.scenario))),
        "points": [
            {"point": p.name, "settings": p.settings, "scenario": p.scenario.model_dump(mode="json", by_alias=True)}
            for p in points
        ],
    }


def _write_examples(folder: Path, scenario: str, points: Sequence[Point]) -> None:
    """Run 0 of every point as a run folder of its own, with estimates and labels."""
    for i, point in enumerate(points):
        engine.run(scenario, point.scenario, folder / "examples" / str(i), Silent(), until="label", overwrite=True)
