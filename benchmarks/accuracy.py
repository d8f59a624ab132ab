"""What is known about each estimate: systematic error in depth, efficiency, consistency and failures of every variant.

Monte-Carlo runs of the oncoming car without pictures: the same tracks, new noise in every run. Two tables:

depth       windows that grow to 10 frames and slide over its first 30 frames (80 to 57 m), as in
            Figures 4.1.4, 4.1.6 and 4.1.7 of Siegemund 2008: mean depth error of the newest frame's centroid, its 95 %
            interval over the runs, and the same by 10 m of true distance.
efficiency  disjoint windows of 10 frames between 40 and 25 m, two in a run (newest frames at 33 and 25 m), each from
            start values of its own.

Efficiency is sqrt(sum of squared bounds / sum of squared errors) over x, y, z of all windows, with the Cramer-Rao bound
of the true geometry; 95 % bootstrap over the runs. Velocity is that of the middle of the rear axle, by the last two
frames. NEES (expected: 1) is the mean over its six degrees of freedom, of windows that share no frame. Beyond 50 m the
estimated cloud has the shape of its depth noise, and its rotation against the true one is no linear matter any more.

    python -m benchmarks.accuracy [depth] [efficiency] [--runs N] [--frames A:B] [--variants LABEL ...]
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pandas as pd

from estimators.stereo.sliding_window import SlidingWindowAdjustment
from reports.bootstrap import interval
from reports.consistency import DOF, band
from reports.errors import SMOOTHED
from reports.evaluation import Evaluation, evaluate
from reports.metrics import BIN_M
from scenarios.spec import read
from sim.observations import Observations
from sim.simulate import View, look, simulate
from sim.streams import stream
from sim.world import World, build_world

Array = np.ndarray
WINDOW = 10
VARIANTS: dict[str, dict[str, Any]] = {
    "observed": {"weights": "observed", "second_order": False},
    "observed, unscented": {"weights": "observed", "propagation": "unscented", "second_order": False},
    "averaged": {"weights": "averaged", "second_order": False},
    "estimated": {"weights": "estimated", "second_order": False},
    "estimated + 2nd order": {"weights": "estimated", "second_order": True},
    "image space": {"space": "image"},
}
QUANTITIES = ("position", "velocity")
WORKERS = 2
# Each worker's share of two cores; set before NumPy's libraries start in it.
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}


@dataclass(frozen=True)
class Table:
    """What a table is made of: its scenario, frames first to last - 1, number of runs, all windows or disjoint ones."""

    title: str
    frames: tuple[int, int]
    runs: int
    disjoint: bool
    scenario: str = "oncoming"


TABLES = {
    "depth": Table("depth error, all windows", (0, 30), 100, disjoint=False),
    "efficiency": Table("efficiency, disjoint windows", (50, 70), 500, disjoint=True),
}


@cache
def _scene(scenario: str) -> tuple[Any, World, View]:
    spec = read(scenario, ["render.enabled=false"])
    world = build_world(spec)
    return spec, world, look(spec, world)


def parts(table: Table, observations: Observations) -> Iterator[Observations]:
    """What an estimator gets at a time: the frames of the table, or ten after ten; frames keep their numbers."""
    first, last = table.frames
    step = WINDOW if table.disjoint else last - first
    tracks, T_wc = observations.tracks, observations.T_wc
    for a in range(first, last - step + 1, step):
        end = a + step
        rows = (tracks.frame >= a) & (tracks.frame < end)
        ego = None if T_wc is None else T_wc[:end]
        yield replace(observations, t_s=observations.t_s[:end], tracks=tracks.select(rows), T_wc=ego)


@dataclass(frozen=True, eq=False)
class Run:
    """One run of one variant: errors and bounds (windows, 3) of each quantity, true distance (windows,) [m], NEES of
    disjoint windows, windows tried, reasons of failures."""

    error: dict[str, Array]
    bound: dict[str, Array]
    distance_m: Array
    nees: dict[str, Array]
    windows: int
    failures: tuple[str, ...]


def _summary(evaluations: Sequence[Evaluation]) -> Run:
    table = pd.concat([e.comparison for e in evaluations], ignore_index=True)
    nees = pd.concat([e.nees[e.nees["disjoint"].astype(bool)] for e in evaluations], ignore_index=True)
    errors: dict[str, Array] = {}
    bounds: dict[str, Array] = {}
    distance = np.empty(0)
    for quantity in QUANTITIES:
        rows = table[(table["quantity"] == quantity) & (table["entity"] != SMOOTHED)]
        wide = rows.pivot(index="t_s", columns="axis", values=["error", "bound"])  # noqa: PD010 - refuses duplicates
        for target, name in ((errors, "error"), (bounds, "bound")):
            target[quantity] = np.stack([wide[name, a].to_numpy(float) for a in "xyz"], axis=1)
        distance = rows.loc[rows["axis"] == "z", "distance_m"].to_numpy(float)
    return Run(
        errors,
        bounds,
        distance,
        nees={q: nees.loc[nees["quantity"] == q, "nees"].to_numpy(float) for q in ("pose", "velocity")},
        windows=sum(e.windows for e in evaluations),
        failures=tuple(str(f) for f in table.loc[table["quantity"] == "failure", "entity"]),
    )


def one_run(job: tuple[Table, int, Sequence[str]]) -> dict[str, Run]:
    """Every variant on the same noise."""
    table, run, variants = job
    spec, world, view = _scene(table.scenario)
    observations, truth = simulate(spec, run, world, view)
    result = {}
    for label in variants:
        start = WINDOW if table.disjoint else 3
        estimator = SlidingWindowAdjustment(window=WINDOW, start_window=start, **VARIANTS[label])
        estimates = [estimator(given) for given in parts(table, observations)]
        names: dict[str, Any] = {"scenario": table.scenario, "seed": spec.seed, "run": run, "estimator": label}
        result[label] = _summary([evaluate(truth, observations.tracks, e, **names) for e in estimates])
    return result


def simulated(table: Table, variants: Sequence[str]) -> dict[str, list[Run]]:
    """All runs of a table, by variant."""
    os.environ.update(_ONE_THREAD)
    jobs = [(table, run, tuple(variants)) for run in range(table.runs)]
    with ProcessPoolExecutor(WORKERS, multiprocessing.get_context("spawn")) as pool:
        results = list(pool.map(one_run, jobs, chunksize=5))
    return {label: [r[label] for r in results] for label in variants}


def _mean(v: Array) -> Array:
    return np.asarray(v[..., 0].sum(axis=-1) / v[..., 1].sum(axis=-1))


def _root_ratio(v: Array) -> Array:
    return np.asarray(np.sqrt(_mean(v)))


def _pooled(pool: Callable[[Array], Array], per_run: Sequence[tuple[float, float]]) -> tuple[float, float, float]:
    """A ratio of sums over runs with its 95 % interval; NaN where there is nothing."""
    values = np.array([v for v in per_run if v[1] > 0])
    if not len(values):
        return np.nan, np.nan, np.nan
    return float(pool(values)), *interval(pool, values, 1, stream(0, 0, "accuracy/bootstrap"))


def depth_bias(runs: Sequence[Run], near_m: float = 0.0, far_m: float = np.inf) -> tuple[float, float, float]:
    """Mean depth error [m] of the windows whose true distance is in a range."""
    sums = []
    for r in runs:
        inside = (r.distance_m >= near_m) & (r.distance_m < far_m)
        sums.append((float(r.error["position"][inside, 2].sum()), float(inside.sum())))
    return _pooled(_mean, sums)


def efficiency(runs: Sequence[Run], quantity: str) -> tuple[float, float, float]:
    """sqrt(sum of squared bounds / sum of squared errors)."""
    sums = []
    for r in runs:
        known = np.isfinite(r.bound[quantity]).all(axis=1)
        bound, error = (float((x[quantity][known] ** 2).sum()) for x in (r.bound, r.error))
        sums.append((bound, error))
    return _pooled(_root_ratio, sums)


def _cells(values: Sequence[tuple[float, float, float]]) -> str:
    return " ".join(f"{v:6.3f} [{low:6.3f} {high:6.3f}]" for v, low, high in values)


def depth_lines(results: dict[str, list[Run]]) -> Iterator[str]:
    """Depth error over all windows, then by distance."""
    yield f"{'depth error [m]':<24} {'mean':>6} {'95 % interval':>15}"
    for label, runs in results.items():
        yield f"{label:<24} {_cells([depth_bias(runs)])}"
    distances = np.concatenate([r.distance_m for runs in results.values() for r in runs])
    bins = np.unique(np.floor(distances / BIN_M) * BIN_M)
    yield f"\n{'depth error [m] at':<24}" + "".join(f"{f'{b:.0f}-{b + BIN_M:.0f} m':>14}" for b in bins)
    for label, runs in results.items():
        means = [depth_bias(runs, b, b + BIN_M) for b in bins]
        yield f"{label:<24}" + "".join(f"{m:7.3f} ±{(high - low) / 2:5.3f}" for m, low, high in means)


def efficiency_lines(results: dict[str, list[Run]]) -> Iterator[str]:
    """Efficiency of position and velocity, NEES."""
    n = 0
    yield f"\n{'efficiency':<22}" + " ".join(f"{q:>8} {'95 %':>13}" for q in QUANTITIES) + "  NEES p, v"
    for label, runs in results.items():
        cells = _cells([efficiency(runs, q) for q in QUANTITIES])
        nees = [np.concatenate([r.nees[q] for r in runs]) for q in ("pose", "velocity")]
        yield f"{label:<22}{cells} {nees[0].mean() / DOF:5.2f} {nees[1].mean() / DOF:5.2f}"
        n = len(nees[0])
    yield "NEES: 99 % of an honest estimate's lie in {:.3f}..{:.3f}".format(*band(DOF, n))


def failure_lines(results: dict[str, list[Run]]) -> Iterator[str]:
    yield f"\n{'failed windows':<24} {'of':>6}"
    for label, runs in results.items():
        reasons = Counter(reason for r in runs for reason in r.failures)
        yield f"{label:<24} {sum(r.windows for r in runs):>6}  {sum(reasons.values())}"
        yield from (f"    {count:>5}  {reason}" for reason, count in reasons.most_common())


def show(table: Table, variants: Sequence[str]) -> None:
    results = simulated(table, variants)
    first, last = table.frames
    print(f"\n{table.scenario}: {table.title}; frames {first} to {last - 1}, {table.runs} runs\n")
    for lines in (depth_lines, efficiency_lines, failure_lines):
        print("\n".join(lines(results)), flush=True)


def _frames(text: str) -> tuple[int, int]:
    first, _, last = text.partition(":")
    return int(first), int(last)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", choices=[*TABLES, []], default=[], help="default: both")
    parser.add_argument("--runs", type=int)
    parser.add_argument("--frames", type=_frames, help="A:B, without B")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS), metavar="LABEL")
    arguments = parser.parse_args()
    for name in arguments.tables or TABLES:
        table = TABLES[name]
        runs, frames = arguments.runs or table.runs, arguments.frames or table.frames
        show(replace(table, runs=runs, frames=frames), arguments.variants)


if __name__ == "__main__":
    main()
