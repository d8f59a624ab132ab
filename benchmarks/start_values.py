"""Which start values lead to the best solution: those of Siegemund 2008, 3.7.1.1, and ours, by distance and tracks.

Windows of 10 frames, each started anew; new noise of 0.2 px in every run. Tracks live as long as the scene shows them,
or, "short", four frames from a random phase on, every second of them left out: what frames see of the car then changes
from one to the next. Solutions are compared by their reprojection error (weighted squares, as the adjustment in image
space sums them): the cost v'Wv is none to compare with, since estimated weights fall with the distance of the points
and stay as they are after some iterations. A kind finds the least one, that of the best start with the true poses among
them, where it comes within 0.5. Given are shares of the windows, in parentheses the mean iterations where found; the
share of windows in which taking the least v'Wv of all kinds finds it; and what several kinds find together.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python -m benchmarks.start_values [--runs N] [--scenario NAME ...]
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimators.gauss_markov import SingularSystem
from estimators.stereo import windows
from estimators.stereo.depth_bias import observation_model
from estimators.stereo.initial_values import from_alignment, from_cloud, from_shared_tracks, from_turn
from estimators.stereo.object_motion import Problem, adjust
from estimators.stereo.triangulation import triangulate
from scenarios.spec import read
from sim.observations import Observations
from sim.simulate import simulate
from sim.truth import Truth

Array = np.ndarray
Poses = tuple[Array, Array]
WINDOW, STEP, LIFE, SIGMA_PX, SAME = 10, 6, 4, 0.2, 0.5
RATE_HZ, YAW_RATE = 25.0, 0.3
KINDS: dict[str, Callable[[Problem], Poses]] = {
    "unrotated": lambda p: from_cloud(p.frame, p.l, p.m, "unrotated"),
    "axes_xz": lambda p: from_cloud(p.frame, p.l, p.m, "principal_axes_xz"),
    "axes": lambda p: from_cloud(p.frame, p.l, p.m, "principal_axes"),
    "alignment": lambda p: from_alignment(p.frame, p.point, p.l, p.m),
    "shared": lambda p: from_shared_tracks(p.frame, p.point, p.l, p.m),
    "left": lambda p: from_turn(p.frame, p.l, np.arange(p.m) / RATE_HZ, YAW_RATE),
    "right": lambda p: from_turn(p.frame, p.l, np.arange(p.m) / RATE_HZ, -YAW_RATE),
}
CHOICES = (
    ("unrotated", "axes_xz", "axes"),
    ("unrotated", "axes_xz", "alignment"),
    ("unrotated", "left", "right"),
    ("unrotated", "left", "right", "axes_xz"),
    ("unrotated", "left", "right", "alignment"),
)


@dataclass(frozen=True, eq=False)
class Case:
    """One window: its problem and image points, the true poses and the true distance of the newest frame [m]."""

    problem: Problem
    uv: Array
    truth: Poses
    distance_m: float


def shortened(frame: Array, track: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Rows that stay, and their tracks' new names: lives of four frames, every second left out."""
    life = (frame + rng.integers(0, 2 * LIFE, track.max() + 1)[track]) // LIFE
    rows = np.flatnonzero(life % 2 == 0)
    return rows, track[rows] * (frame.max() + 2 * LIFE) + life[rows]


def cases(observations: Observations, truth: Truth, short: bool, run: int) -> list[Case]:
    """The windows of one run, every sixth newest frame."""
    rng = np.random.default_rng(run)
    frame, track, uv = observations.tracks.frame, observations.tracks.track, truth.labels.uv_true
    if short:
        rows, track = shortened(frame, track, rng)
        frame, uv = frame[rows], uv[rows]
    uv = uv + SIGMA_PX * rng.standard_normal(uv.shape)
    cov = np.broadcast_to(np.eye(4) * SIGMA_PX**2, (len(frame), 4, 4))
    l, C = triangulate(observations.rig, uv, cov)
    W_uv, seen, result = np.linalg.inv(cov), np.unique(frame), []
    for newest in range(WINDOW - 1, len(observations.t_s), STEP):
        chosen, frames = windows.select(frame, track, windows.sliding(seen, newest, WINDOW), 2)
        if len(frames) < 2:
            continue
        names, point = np.unique(track[chosen], return_inverse=True)
        model = observation_model(observations.rig, l[chosen], C[chosen], W_uv[chosen], "estimated", True)
        problem = Problem(np.searchsorted(frames, frame[chosen]), point, l[chosen], model, len(frames), len(names))
        T_cv = truth.T_cv[frames]
        centre = truth.bodies[truth.target].box_v.mean(axis=0)
        result.append(Case(problem, uv[chosen], (T_cv.R, T_cv.t), float(T_cv[-1].apply(centre)[2])))
    return result


def outcomes(case: Case) -> Array:
    """Reprojection error, cost and iterations (3, kinds + 1), infinite where it failed; the true poses last."""
    p, rows = case.problem, []
    for start in [*(kind(p) for kind in KINDS.values()), case.truth]:
        try:
            s = adjust(p, *start)
        except SingularSystem:
            rows.append((np.inf, np.inf, np.inf))
            continue
        Y = np.einsum("kab,kb->ka", s.R[p.frame], s.X[p.point]) + s.T[p.frame]
        error = (p.model.rig.project(Y) - case.uv) / SIGMA_PX
        rows.append((np.sum(error**2), s.cost, s.iterations))
    return np.array(rows).T


def print_scene(name: str, short: bool, runs: int) -> None:
    observations, truth = simulate(read(name, ["render.enabled=false"]))
    windows_ = [case for run in range(runs) for case in cases(observations, truth, short, run)]
    error, cost, steps = np.array([outcomes(case) for case in windows_]).transpose(1, 0, 2)
    hit = error < error.min(axis=1, keepdims=True) + SAME
    by_cost = np.take_along_axis(hit, cost[:, :-1].argmin(axis=1)[:, None], 1)
    lower = np.floor(np.array([case.distance_m for case in windows_]) / 10) * 10
    print(f"\n{name}, {'short' if short else 'long'} tracks, {len(hit)} windows")
    print(" " * 9 + "".join(f"{kind:>14}" for kind in [*KINDS, "truth"]) + f"{'least cost':>14}")
    for start in [*sorted(set(lower), reverse=True), np.nan]:
        part = np.isnan(start) | (lower == start)
        cells = [
            f"{h.mean():>8.2f} ({s[h].mean() if h.any() else 0:>3.0f})"
            for h, s in zip(hit[part].T, steps[part].T, strict=True)
        ]
        print(("all" if np.isnan(start) else f"{start:.0f}-{start + 10:.0f} m").ljust(9), end="")
        print("".join(f"{cell:>14}" for cell in cells) + f"{by_cost[part].mean():>14.2f}")
    for choice in CHOICES:
        together = hit[:, [list(KINDS).index(kind) for kind in choice]].any(axis=1).mean()
        print(f"  {together:.3f}  {', '.join(choice)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--scenario", nargs="+", default=["oncoming", "crossing", "turning"])
    arguments = parser.parse_args()
    for name, short in itertools.product(arguments.scenario, (False, True)):
        print_scene(name, short, arguments.runs)


if __name__ == "__main__":
    main()
