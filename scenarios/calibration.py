"""A calibration of the boresight from clicked control points: read -> estimate -> report as cached stages."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from estimators.aerial.boresight_observations import BoresightObservations
from estimators.estimate import EstimationFailed
from reports.calibrations.html import write_calibration
from scenarios.calibration_observations import read_observations
from scenarios.engine import Outcome, Progress, asked_for
from scenarios.store import Store, code_digest, config_hash, digest

_READ = ("observations/boresight.npz",)
_SHOWN = 3


def run(
    name: str,
    spec: Any,
    out: Path,
    progress: Progress,
    until: str = "report",
    only: Sequence[str] = (),
    overwrite: bool = False,
) -> Outcome:
    """Takes one calibration through its stages up to ``until``.

    Raises
        ScenarioError: the input is wrong; nothing half-written stays behind.
    """
    chosen = asked_for(spec.estimator, only)
    store = Store.open(out, spec, overwrite)
    key = digest(config_hash(spec.without_estimators), code_digest("read"))
    _read(store, spec, key, progress)
    failed: dict[str, str] = {}
    if until in ("estimate", "report"):
        for estimator in chosen:
            reason = _estimate(store, estimator, key, progress)
            if reason is not None:
                failed[estimator.title] = reason
    if until == "report":
        with progress.stage("report", 1):
            write_calibration(store.folder, name)
    return Outcome(out, failed, len(failed) < len(chosen))


def _read(store: Store, spec: Any, key: str, progress: Progress) -> None:
    if store.is_done("read", key, _READ):
        progress.say("read  from cache")
        store.prepare()
        return
    observations = read_observations(spec)
    store.prepare()
    for line in observations.excluded[:_SHOWN]:
        progress.say(f"left out  {line}")
    if len(observations.excluded) > _SHOWN:
        progress.say(f"left out  {len(observations.excluded) - _SHOWN} more, see excluded.csv")
    store.clear()
    store.run("read", key, _READ, lambda scratch: observations.save(scratch / "observations"))


def _estimate(store: Store, estimator: Any, key: str, progress: Progress) -> str | None:
    """Runs one estimator on the folder of its observations alone; the reason where it gave nothing."""
    folder = f"estimates/{estimator.title}"
    key = digest(key, estimator.model_dump(mode="json"), code_digest("estimate"))
    with progress.stage(f"estimate {estimator.title}", 1):

        def work(scratch: Path) -> None:
            result = estimator.build()(BoresightObservations.load(store.folder / "observations"))
            target = scratch / folder
            target.mkdir(parents=True)
            if isinstance(result, EstimationFailed):
                (target / "failure.json").write_text(json.dumps({"reason": result.reason, "hints": result.hints}))
            else:
                result.save(target)

        store.run(f"estimate {estimator.title}", key, (folder,), work)
    failure = store.folder / folder / "failure.json"
    return str(json.loads(failure.read_text())["reason"]) if failure.is_file() else None
