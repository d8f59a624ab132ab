"""Every detector of outliers alone, with its time, on the scene of Siegemund 2008, 3.4.4 (`point-grid`), and beyond it.

A share theta of the tracks is wrong in rho frames by noise of 2 px and more in every coordinate. fp and fn are mean
numbers of tracks in a run. Table 3.4.1 itself, and where ours differs from it, is the study `siegemund-table-3-4-1`.

    python -m benchmarks.outlier_table [--runs N]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimators.gauss_markov import SingularSystem
from estimators.stereo.depth_bias import observation_model
from estimators.stereo.initial_values import from_cloud
from estimators.stereo.object_motion import Problem, Solution, adjust
from estimators.stereo.outliers import (
    PRINTED_TRACK_TEST,
    SOURCE_POINT_TEST,
    SOURCE_TRACK_TEST,
    Detector,
    PointTest,
    PriorKnowledge,
    Ransac,
    Robust,
    TrackTest,
)
from estimators.stereo.outliers.residuals import of_solution, residual_covariance
from estimators.stereo.triangulation import triangulate
from reports.siegemund.detectors import PUBLISHED
from scenarios.spec import read
from sim.scenario import Scenario
from sim.simulate import simulate
from sim.world import build_world

Array = np.ndarray
Poses = tuple[Array, Array]
METHODS: dict[str, Detector | PriorKnowledge] = {
    "points": SOURCE_POINT_TEST,
    "points, corrected": PointTest(),
    "tracks": SOURCE_TRACK_TEST,
    "tracks, printed": PRINTED_TRACK_TEST,
    "tracks, batches": TrackTest(final=False, max_iterations=10),
    "tracks, corrected": TrackTest(),
    "prior knowledge": PriorKnowledge(),
    "ransac": Ransac(),
    "robust": Robust(),
}


def scenario(outliers: Sequence[Mapping[str, Any]]) -> Scenario:
    """The scene of 3.4.4 with a slower car in the next lane, which only wrong segmentation brings in."""
    data = read("point-grid").model_dump(by_alias=True, exclude={"estimator"})
    (grid,) = data["vehicle"]
    motion = grid["motion"] | {"start_m": (3.0, 20.0), "speed_mps": 15.0}
    neighbour = grid | {"name": "neighbour", "motion": motion}
    return Scenario.model_validate(data | {"vehicle": [grid, neighbour], "outliers": outliers})


@dataclass(frozen=True, eq=False)
class Case:
    """One run: the problem, its rows of image covariances, which tracks are wrong."""

    problem: Problem
    cov: Array
    wrong: Array


def cases(outliers: Sequence[Mapping[str, Any]], runs: int) -> list[Case]:
    """Runs of the scene, observations that cannot be triangulated and tracks of one frame taken away."""
    spec = scenario(outliers)
    world = build_world(spec)
    result = []
    for run in range(runs):
        observations, truth = simulate(spec, run, world)
        tracks, kind = observations.tracks, truth.labels.kind
        l, C = triangulate(observations.rig, tracks.uv, tracks.cov)
        good = np.isfinite(l).all(axis=1)
        good &= np.bincount(tracks.track[good], minlength=tracks.track.max() + 1)[tracks.track] > 1
        _, point = np.unique(tracks.track[good], return_inverse=True)
        W_uv = np.linalg.inv(tracks.cov[good])
        model = observation_model(observations.rig, l[good], C[good], W_uv, "estimated", True)
        problem = Problem(tracks.frame[good], point, l[good], model, 10, int(point.max()) + 1)
        wrong = np.bincount(point, kind[good] > 0) > 0
        result.append(Case(problem, tracks.cov[good], wrong))
    return result


def solve(problem: Problem, start: Poses) -> Solution:
    return adjust(problem, *start)


@dataclass(frozen=True)
class Score:
    """Mean numbers of good tracks dropped and wrong tracks kept, runs that failed, runs with a second group, median
    time."""

    fp: float
    fn: float
    failed: int
    flagged: int
    time_ms: float


def score(method: Detector | PriorKnowledge, runs: Sequence[Case]) -> Score:
    fp, fn, times, failed, flagged = [], [], [], 0, 0
    for case in runs:
        p = case.problem
        start = from_cloud(p.frame, p.l, p.m)
        began = time.perf_counter()
        try:
            if isinstance(method, PriorKnowledge):
                inlier = method(p.model.rig, case.cov, p.frame, p.point, p.l)
            else:
                verdict = method(p, start, solve)
                inlier = verdict.inlier
                flagged += verdict.second_group is not None
        except SingularSystem:
            failed += 1
            continue
        times.append(1e3 * (time.perf_counter() - began))
        fp.append(np.count_nonzero(~inlier & ~case.wrong))
        fn.append(np.count_nonzero(inlier & case.wrong))
    if failed == len(runs):
        return Score(np.nan, np.nan, failed, flagged, np.nan)
    return Score(float(np.mean(fp)), float(np.mean(fn)), failed, flagged, float(np.median(times)))


def noise(theta: float, rho: int) -> dict[str, Any]:
    return {"kind": "noise", "tracks": theta, "frames": rho, "sigma_px": 2.0, "min_px": 2.0}


def print_table(runs: int) -> None:
    print(f"{'theta':>5} {'rho':>3}  {'method':<16} {'fp':>6} {'fn':>6}   {'published':>14} {'failed':>6} {'ms':>6}")
    for theta, rho in PUBLISHED["points"]:
        data = cases([noise(theta / 100, rho)], runs)
        for name, method in METHODS.items():
            s = score(method, data)
            reference = "{:6.2f} {:6.2f}".format(*PUBLISHED[name][theta, rho]) if name in PUBLISHED else ""
            row = f"{theta:>5} {rho:>3}  {name:<16} {s.fp:6.2f} {s.fn:6.2f}   {reference:>14}"
            print(row, f"{s.failed:>6} {s.time_ms:6.1f}", flush=True)


def print_kinds(runs: int) -> None:
    """Other kinds, and more than half the tracks, by the robust detector."""
    third = 0.6 / 3
    kinds: dict[str, Sequence[Mapping[str, Any]]] = {
        "none": [],
        "60 % noise": [noise(0.6, 10)],
        "60 % noise in one frame": [noise(0.6, 1)],
        "60 % wrong stereo": [{"kind": "stereo", "tracks": 0.6, "frames": 10}],
        "60 % wrong temporal": [{"kind": "temporal", "tracks": 0.6}],
        "60 % of all three": [
            noise(third, 10),
            {"kind": "stereo", "tracks": third},
            {"kind": "temporal", "tracks": third},
        ],
        "30 % background": [{"kind": "segmentation", "tracks": 0.3}],
        **{
            f"{share} % neighbour": [{"kind": "segmentation", "tracks": share / 100, "on": "neighbour"}]
            for share in (10, 20, 35, 40, 45, 50)
        },
    }
    print(f"\n{'robust detector':<26} {'fp':>6} {'fn':>6} {'failed':>7} {'flagged':>8} {'ms':>6}")
    for name, outliers in kinds.items():
        s = score(Robust(), cases(outliers, runs))
        print(f"{name:<26} {s.fp:6.2f} {s.fn:6.2f} {s.failed:>7} {s.flagged:>8} {s.time_ms:6.1f}", flush=True)


def print_time(repeats: int = 100) -> None:
    problem = cases([], 1)[0].problem
    f = of_solution(problem, solve(problem, from_cloud(problem.frame, problem.l, problem.m)))
    print(
        f"\nresidual covariance, 10 frames x 100 tracks: {_median_ms(lambda: residual_covariance(f), repeats):.2f} ms"
    )


def _median_ms(call: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        times.append(1e3 * (time.perf_counter() - began))
    return float(np.median(times))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100)
    runs = parser.parse_args().runs
    print_table(runs)
    print_kinds(runs)
    print_time()


if __name__ == "__main__":
    main()
