"""Smoothing of the trajectory, Siegemund 2008, 4.2.3: what it gains where motion is smooth, what it costs at braking.

crossing and turning (Figs. 4.1.9, 4.1.10): RMS over the second half of the sequence of the errors of speed (of the rear
axle; in per cent of the mean true speed) and yaw rate, and the same over the bound of the smoothed model: Fisher
information of the image coordinates at the true geometry with the pseudo-observations' own. Adaptive weights have no
such bound.

braking: a car that brakes with 7 m/s². The lag is the mean difference of speed and truth while it slows down; against
it stands the standard deviation of the speed while the car drives evenly.

    python -m benchmarks.smoothing [--runs N] [--figure FILE.png]
"""

from __future__ import annotations

import argparse
import functools
import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from estimators.estimate import EstimationFailed
from estimators.stereo.conditions import RotationAxis, Smoothing, of_window
from estimators.stereo.sliding_window import SlidingWindowAdjustment
from reports.bootstrap import interval
from reports.consistency import cramer_rao
from reports.errors import compare_windows
from reports.figures.style import TRUTH, color, new_figure, styled
from reports.windows import standard_deviations
from scenarios.spec import read
from sim.simulate import look, simulate
from sim.streams import stream
from sim.world import build_world

Array = np.ndarray
AXIS = RotationAxis("fixed")
TURN = Smoothing("turn", True, "fixed")
VARIANTS: dict[str, SlidingWindowAdjustment] = {
    "none": SlidingWindowAdjustment(),
    "tied (4.2.13)": SlidingWindowAdjustment(smoothing=Smoothing(tied=3)),
    "velocity (4.2.1)": SlidingWindowAdjustment(smoothing=Smoothing("velocity")),
    "both (4.2.18)": SlidingWindowAdjustment(smoothing=Smoothing("velocity", tied=3)),
    "velocity and rate": SlidingWindowAdjustment(smoothing=Smoothing("velocity", True)),
    "turn, adaptive": SlidingWindowAdjustment(smoothing=Smoothing("turn", True)),
    "turn": SlidingWindowAdjustment(smoothing=TURN),
    "turn, axis": SlidingWindowAdjustment(smoothing=TURN, rotation_axis=AXIS),
}
STRENGTHS_MPS2 = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
SMOOTH_SCENES = ("crossing", "turning")
WORKERS = 2
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}


def by_strength(acceleration_mps2: float) -> SlidingWindowAdjustment:
    return SlidingWindowAdjustment(smoothing=Smoothing("turn", True, "fixed", acceleration_mps2=acceleration_mps2))


@dataclass(frozen=True)
class Job:
    scenario: str
    label: str
    estimator: SlidingWindowAdjustment
    run: int


@functools.cache
def _scene(scenario: str) -> tuple[Any, Any, Any]:
    spec = read(scenario, ["render.enabled=false"])
    world = build_world(spec)
    return spec, world, look(spec, world)


def one_run(job: Job) -> pd.DataFrame:
    """True and estimated speed and yaw rate of every window, with the bound of what the estimator knows."""
    spec, world, view = _scene(job.scenario)
    observations, truth = simulate(spec, job.run, world, view)
    estimate = job.estimator(observations)
    if isinstance(estimate, EstimationFailed):
        return pd.DataFrame()
    smoothing, axis = job.estimator.smoothing, job.estimator.rotation_axis
    adaptive = smoothing.weights == "adaptive" and (smoothing.translation != "none" or smoothing.rotation)
    known = None if adaptive or smoothing.tied else functools.partial(of_window, smoothing, axis)
    rows = []
    for c in compare_windows(truth, observations.tracks, estimate):
        no_bound = adaptive or smoothing.tied
        cov = np.full((12, 12), np.nan) if no_bound else cramer_rao(truth, observations.tracks, c, _at(known))
        bound = standard_deviations(cov, c.truth)
        for q in ("speed", "yaw_rate"):
            rows.append((truth.t_s[c.frame], q, getattr(c.truth, q), getattr(c.estimate, q), bound[q][0]))
    table = pd.DataFrame(rows, columns=["t_s", "quantity", "truth", "estimate", "bound"])
    return table.assign(scenario=job.scenario, label=job.label, run=job.run, failed=len(estimate.failures))


def _at(known: Any) -> Any:
    """The conditions of a window from its times, ego poses and true poses."""
    return None if known is None else lambda t_s, T_wc, poses: known(t_s, T_wc, poses)


def simulated(jobs: list[Job]) -> pd.DataFrame:
    os.environ.update(_ONE_THREAD)
    with ProcessPoolExecutor(WORKERS, multiprocessing.get_context("spawn")) as pool:
        return pd.concat(pool.map(one_run, jobs, chunksize=2), ignore_index=True)


def _root_mean(v: Array) -> Array:
    return np.asarray(np.sqrt(v[..., 0].mean(axis=-1)))


def rms(table: pd.DataFrame, quantity: str) -> tuple[float, float, float, float]:
    """RMS error over all runs with its 95 % interval over the runs, and its ratio to the RMS bound."""
    part = table[table["quantity"] == quantity]
    squares = (part["estimate"] - part["truth"]) ** 2
    per_run = squares.groupby(part["run"]).mean().to_numpy()[:, None]
    value = float(_root_mean(per_run))
    low, high = interval(_root_mean, per_run, 1, stream(0, 0, "smoothing/bootstrap"))
    return value, low, high, value / float(np.sqrt((part["bound"] ** 2).mean()))


def show_smooth(table: pd.DataFrame) -> None:
    for scenario in SMOOTH_SCENES:
        part = table[table["scenario"] == scenario]
        late = part[part["t_s"] > part["t_s"].max() / 2]
        speed = float(late.loc[late["quantity"] == "speed", "truth"].mean())
        print(f"\n{scenario}, {late['run'].nunique()} runs, second half; mean true speed {speed:.2f} m/s")
        print(f"{'':<18} {'speed %':>7} {'95 %':>14} {'/bound':>6}  {'yaw deg/s':>9} {'95 %':>14} {'/bound':>6}")
        for label, rows in late.groupby("label", sort=False):
            cells = []
            for quantity, unit in (("speed", 100 / speed), ("yaw_rate", 180 / np.pi)):
                value, low, high, ratio = rms(rows, quantity)
                over = f"{ratio:6.2f}" if np.isfinite(ratio) else "     -"
                cells.append(f"{value * unit:7.2f} [{low * unit:5.2f} {high * unit:5.2f}] {over}")
            print(f"{label:<18} {cells[0]}  {'':2}{cells[1]}")


def lag(rows: pd.DataFrame) -> tuple[float, float]:
    """Mean difference of speed and truth [m/s] while the car slows down, standard deviation while it drives evenly."""
    speed = rows[rows["quantity"] == "speed"]
    t, truth = speed["t_s"].to_numpy(float), speed["truth"].to_numpy(float)
    error = speed["estimate"].to_numpy(float) - truth
    full = truth.max()
    slows, even = (truth > 0.1 * full) & (truth < 0.9 * full), (truth > 0.99 * full) & (t > 0.4)
    return float(error[slows].mean()), float(error[even].std())


def show_braking(table: pd.DataFrame) -> None:
    part = table[table["scenario"] == "braking"]
    print(f"\nbraking with 7 m/s², {part['run'].nunique()} runs")
    print(f"{'':<24} {'lag m/s':>8} {'std m/s':>8}")
    for label, rows in part.groupby("label", sort=False):
        print(f"{label:<24} {lag(rows)[0]:8.3f} {lag(rows)[1]:8.3f}")


@styled
def price(table: pd.DataFrame) -> Any:
    """Speed of one run at braking, and lag against standard deviation over the strength of the smoothing."""
    part = table[(table["scenario"] == "braking") & (table["quantity"] == "speed")]
    figure = new_figure(3.0)
    left, right = figure.subplots(1, 2, width_ratios=[1.5, 1])
    first = part[part["run"] == part["run"].min()]
    for k, label in enumerate(("none", "velocity (4.2.1)", "turn")):
        rows = first[first["label"] == label]
        left.plot(rows["t_s"], rows["estimate"], color=color(k), label=label)
    left.plot(rows["t_s"], rows["truth"], color=TRUTH, label="truth", zorder=5)
    left.set(xlabel="time [s]", ylabel="speed [m/s]", ylim=(-0.5, 11), title="a car that brakes, one run")
    left.legend(frameon=False)
    points = [(a, *lag(part[part["strength"] == a])) for a in STRENGTHS_MPS2]
    a, lags, stds = np.array(points).T
    right.plot(a, lags, "o-", color=color(1), label="lag at braking")
    right.plot(a, stds, "s-", color=color(0), label="std at even speed")
    for name, y in zip(("lag", "std"), lag(part[part["label"] == "none"]), strict=True):
        right.axhline(y, color=color(1 if name == "lag" else 0), ls=":", lw=0.9)
    right.set(xscale="log", yscale="log", xlabel="stated acceleration [m/s²]", ylabel="m/s")
    right.set_title("price of smoothing; dotted: none")
    right.legend(frameon=False)
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--figure", type=Path)
    arguments = parser.parse_args()
    runs = range(arguments.runs)
    jobs = [Job(s, label, e, r) for s in (*SMOOTH_SCENES, "braking") for label, e in VARIANTS.items() for r in runs]
    strengths = {f"turn, {a:g} m/s²": a for a in STRENGTHS_MPS2}
    jobs += [Job("braking", label, by_strength(a), r) for label, a in strengths.items() for r in runs]
    table = simulated(jobs)
    table["strength"] = table["label"].map(strengths).fillna(0.0)
    show_smooth(table)
    show_braking(table)
    if arguments.figure:
        price(table).savefig(arguments.figure, dpi=160)


if __name__ == "__main__":
    main()
