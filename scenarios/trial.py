"""One trial: a scenario measured once, all its estimators on the same observations, held against the truth.

A pure function of (scenario, run): the same tables in any process and any order. Images, where points are tracked in
them, go from the renderer to the front end frame by frame; nothing of a trial is written to disk.
"""

from __future__ import annotations

import time
from collections.abc import Collection
from dataclasses import dataclass, fields
from functools import cache, lru_cache
from typing import Any

import pandas as pd

from estimators.estimate import EstimationFailed, TrajectoryEstimate
from reports.errors import UNITS
from reports.evaluation import Evaluation, evaluate
from scenarios.store import config_hash
from sim.scenario import Measure, Scenario
from sim.simulate import View, look, simulate
from sim.world import World, build_world

KEEP = ("position", "orientation", "velocity", "speed", "yaw_rate", "shape")
NIS = "nis"
QUANTITIES = (*(q for q in UNITS if q != "failure"), NIS)
_KEPT_SCENES = 4


@dataclass(frozen=True, eq=False)
class TrialResult:
    """Tables of one trial or of many, all with the columns run and estimator first.

    comparison: error rows (quantity, t_s, entity, axis, error, sigma, truth, bound, distance_m) of the kept quantities
    nees: squared errors (quantity, t_s, nees, disjoint) of every window
    outliers: numbers of tracks (t_s, tracks, tp, fp, fn, flagged) of every window
    failures: (kind, t_s, reason, traceback); kind "window", or "estimation" where an estimator gave nothing at all, or
        "exception" where the trial itself failed, of no estimator
    support: (wanted, estimated, windows, failed, overlap, over_ground) as in `Evaluation`, one row per estimator
    measures: what is no error of a window (quantity, t_s, value); t_s of a numeric experiment is a number of steps
    runtimes: seconds, one row per estimator and one of no estimator for the simulation; never the same twice
    """

    comparison: pd.DataFrame
    nees: pd.DataFrame
    outliers: pd.DataFrame
    failures: pd.DataFrame
    support: pd.DataFrame
    measures: pd.DataFrame
    runtimes: pd.DataFrame


TABLES = tuple(f.name for f in fields(TrialResult))
_KEYS = {"run": "int64", "estimator": "str"}
COLUMNS: dict[str, dict[str, str]] = {
    "comparison": _KEYS
    | {"quantity": "str", "t_s": "float64", "entity": "str", "axis": "str"}
    | dict.fromkeys(("error", "sigma", "truth", "bound", "distance_m"), "float64"),
    "nees": _KEYS | {"quantity": "str", "t_s": "float64", "nees": "float64", "disjoint": "bool"},
    "outliers": _KEYS | {"t_s": "float64"} | dict.fromkeys(("tracks", "tp", "fp", "fn", "flagged"), "int64"),
    "failures": _KEYS | {"kind": "str", "t_s": "float64", "reason": "str", "traceback": "str"},
    "support": _KEYS
    | dict.fromkeys(("wanted", "estimated", "windows", "failed", "overlap"), "int64")
    | {"over_ground": "bool"},
    "measures": _KEYS | {"quantity": "str", "t_s": "float64", "value": "float64"},
    "runtimes": _KEYS | {"seconds": "float64"},
}


def trial(spec: Any, run: int, keep: Collection[str] = KEEP) -> TrialResult:
    """Measures a scenario with its estimators (`scenarios.spec`) once and evaluates every estimator on it.

    keep: quantities of `reports.errors.UNITS` whose error rows are wanted, and "nis". World and view are kept.

    Raises
        ScenarioError: the world cannot be made, or the target is never visible; whatever else an estimator raises.
    """
    started = time.perf_counter()
    world, view = _scene(_measured(spec).model_dump_json(by_alias=True), config_hash(_measured(spec)))
    observations, truth = simulate(spec, run, world, view)
    if spec.measure.from_images:
        from scenarios.in_memory import track_in_memory  # needs OpenGL, which projected points do not

        observations, truth = track_in_memory(spec, run, world, observations, truth)
    seconds = {"": time.perf_counter() - started}
    evaluations, outliers, measures = [], [], []
    for estimator in spec.estimator:
        started = time.perf_counter()
        estimate = estimator.build()(observations)
        seconds[estimator.title] = time.perf_counter() - started
        names: dict[str, Any] = {"scenario": "", "seed": spec.seed, "run": run, "estimator": estimator.title}
        evaluations.append(evaluate(truth, observations.tracks, estimate, **names))
        if not isinstance(estimate, EstimationFailed):
            outliers.append(evaluations[-1].outliers.assign(run=run, estimator=estimator.title))
            measures.append(_nis(estimate).assign(run=run, estimator=estimator.title))
    comparison = pd.concat([e.comparison for e in evaluations], ignore_index=True)
    tables = {
        "comparison": comparison[comparison["quantity"].isin(keep)],
        "nees": pd.concat([e.nees for e in evaluations if len(e.nees)] or [pd.DataFrame()]),
        "outliers": pd.concat(outliers or [pd.DataFrame()]),
        "failures": pd.DataFrame([row for e in evaluations for row in _failures(e)]),
        "support": pd.DataFrame([{name: getattr(e, name) for name in COLUMNS["support"]} for e in evaluations]),
        "measures": pd.concat(measures or [pd.DataFrame()]) if NIS in keep else pd.DataFrame(),
        "runtimes": pd.DataFrame([{"run": run, "estimator": k, "seconds": v} for k, v in seconds.items()]),
    }
    return TrialResult(**{name: _typed(name, table) for name, table in tables.items()})


def failed(run: int, reason: str, traceback: str) -> TrialResult:
    """The tables of a trial that ended with an exception."""
    row = {"run": run, "estimator": "", "kind": "exception", "t_s": float("nan")}
    return _only("failures", pd.DataFrame([row | {"reason": reason, "traceback": traceback}]))


def of_measures(run: int, measures: pd.DataFrame) -> TrialResult:
    """The tables of a numeric experiment's run, whose rows are (estimator, quantity, t_s, value)."""
    return _only("measures", measures.assign(run=run))


def _only(filled: str, rows: pd.DataFrame) -> TrialResult:
    """Tables of which one has rows."""
    return TrialResult(**{name: _typed(name, rows if name == filled else pd.DataFrame()) for name in TABLES})


def joined(results: Collection[TrialResult]) -> TrialResult:
    """The tables of several trials, one below the other."""
    return TrialResult(**{name: pd.concat([getattr(r, name) for r in results], ignore_index=True) for name in TABLES})


def _typed(name: str, table: pd.DataFrame) -> pd.DataFrame:
    """A table with exactly the columns and types of its kind, whatever it holds."""
    if table.empty:
        return _no_rows(name).copy()
    columns = COLUMNS[name]
    found = table[list(columns)]
    other = {c: t for (c, t), dtype in zip(columns.items(), found.dtypes, strict=True) if dtype != t}
    return (found.astype(other) if other else found).reset_index(drop=True)


@cache
def _no_rows(name: str) -> pd.DataFrame:
    return pd.DataFrame(columns=list(COLUMNS[name])).astype(COLUMNS[name])


def _failures(e: Evaluation) -> list[dict[str, Any]]:
    rows = e.comparison[e.comparison["quantity"] == "failure"]
    return [
        {"run": e.run, "estimator": e.estimator, "kind": "estimation" if pd.isna(t_s) else "window", "t_s": t_s}
        | {"reason": reason, "traceback": ""}
        for t_s, reason in zip(rows["t_s"], rows["entity"], strict=True)
    ]


def _nis(estimate: TrajectoryEstimate) -> pd.DataFrame:
    """Cost over redundancy of every window, and the redundancy: of a filter the normalised innovation squared of a
    frame over its degrees of freedom, of an adjustment the variance factor.
    """
    rows = []
    for w in estimate.windows:
        if w.redundancy > 0:
            t_s = float(estimate.t_s[w.frames[-1]])
            rows += [(NIS, t_s, w.cost / w.redundancy), ("nis_dof", t_s, float(w.redundancy))]
    return pd.DataFrame(rows, columns=["quantity", "t_s", "value"])


def _measured(spec: Scenario) -> Scenario:
    """What world and view depend on: neither noise nor outliers nor estimators."""
    m = spec.measure
    seen = Measure(points=m.points, occlusion=m.occlusion, target=m.target, events=m.events)
    other = ("title", "source", "measure", "outliers")
    parts = {k: getattr(spec, k) for k in Scenario.model_fields if k not in other}
    return Scenario(title="", measure=seen, **parts)


@lru_cache(maxsize=_KEPT_SCENES)
def _scene(scenario: str, _files: str) -> tuple[World, View]:
    """World and view of a scenario in JSON; the second argument stands for the content of its input files."""
    spec = Scenario.model_validate_json(scenario)
    world = build_world(spec)
    return world, look(spec, world)
