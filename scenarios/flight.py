"""A flight: simulate (fly and draw) -> estimate -> report as cached stages of one run folder."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from estimators.estimate import EstimationFailed
from reports.flights.html import write_flight_report
from scenarios.engine import Outcome, Progress, asked_for
from scenarios.flight_footage import write_flight
from scenarios.store import Store, code_digest, config_hash, digest
from sim.flight_observations import FlightObservations
from sim.flight_simulation import simulate_flight

_DRAWN = ("observations", "truth")


def run(
    name: str,
    spec: Any,
    out: Path,
    progress: Progress,
    until: str = "report",
    only: Sequence[str] = (),
    overwrite: bool = False,
) -> Outcome:
    """Takes one flight through its stages up to ``until``.

    Raises
        ScenarioError: the input is wrong; nothing half-written stays behind.
    """
    chosen = asked_for(spec.estimator, only)
    store = Store.open(out, spec, overwrite)
    key = digest(config_hash(spec.without_estimators), code_digest("simulate"))
    _simulate(store, spec.without_estimators, key, progress)
    failed: dict[str, str] = {}
    if until in ("estimate", "report"):
        for estimator in chosen:
            reason = _estimate(store, estimator, key, progress)
            if reason is not None:
                failed[estimator.title] = reason
    if until == "report":
        with progress.stage("report", 1):
            write_flight_report(store.folder, name)
    return Outcome(out, failed, len(failed) < len(chosen))


def _simulate(store: Store, spec: Any, key: str, progress: Progress) -> None:
    if store.is_done("simulate", key, _DRAWN):
        progress.say("simulate  from cache")
        store.prepare()
        return
    with progress.stage("fly", 1):
        flown = simulate_flight(spec)
    store.prepare()
    store.clear()
    with progress.stage("render", len(flown.observations)) as advance:
        store.run("simulate", key, _DRAWN, lambda scratch: write_flight(spec, flown, scratch, advance))


def _estimate(store: Store, estimator: Any, key: str, progress: Progress) -> str | None:
    """Runs one estimator on the folder of the observations alone; the reason where it gave nothing."""
    label, source = estimator.title, store.folder / "observations"
    folder = f"estimates/{label}"
    observations = FlightObservations.load(source)
    key = digest(key, estimator.model_dump(mode="json"), code_digest("estimate"))
    with progress.stage(f"estimate {label}", len(observations)) as advance:
        store.run(f"estimate {label}", key, (folder,), _worker(estimator, observations, source, folder, advance))
    failure = store.folder / folder / "failure.json"
    return str(json.loads(failure.read_text())["reason"]) if failure.is_file() else None


def _worker(
    estimator: Any, observations: FlightObservations, source: Path, folder: str, advance: Callable[[], None]
) -> Callable[[Path], None]:
    def work(scratch: Path) -> None:
        target = scratch / folder
        target.mkdir(parents=True)
        result = estimator.build()(observations, source, target, advance)
        if isinstance(result, EstimationFailed):
            (target / "failure.json").write_text(json.dumps({"reason": result.reason, "hints": result.hints}))
        else:
            result.save(target)

    return work
