"""Many windows at once: each result is that of a call of its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from estimators.gauss_markov import SingularSystem
from estimators.stereo.batch import adjust_batch
from estimators.stereo.conditions import RotationAxis, Smoothing, of_window
from estimators.stereo.depth_bias import observation_model
from estimators.stereo.object_motion import Problem, Solution, adjust
from estimators.stereo.triangulation import triangulate, undistorted

Array = np.ndarray


def problem_of(scene: Any, seed: int, keep: Array | None = None) -> Problem:
    tracks = scene.observe(0.2, seed, keep).tracks
    rig, uv, cov = undistorted(scene.rig, tracks.uv, tracks.cov)
    l, C = triangulate(rig, uv, cov)
    model = observation_model(rig, l, C, np.linalg.inv(cov), "estimated", True)
    return Problem(tracks.frame, tracks.track, l, model, len(scene.t_s), int(tracks.track.max()) + 1)


@pytest.fixture(scope="module")
def problems(make_scene: Callable[..., Any]) -> list[Problem]:
    """Windows of different sizes; the fourth has a frame without observations."""
    many, large = make_scene(points=40, frames=7, distance_m=15.0), make_scene(points=90, frames=12, distance_m=30.0)
    gap = np.arange(7)[:, None] != np.full(40, 3)
    scenes = (many, None), (large, None), (many, None), (many, gap), (large, None), (many, None), (many, None)
    return [problem_of(scene, seed, keep) for seed, (scene, keep) in enumerate(scenes)]


def unrotated(problem: Problem) -> tuple[Array, Array]:
    """Start poses at the centroids; at the mean of all where a frame has none."""
    R, T = np.tile(np.eye(3), (problem.m, 1, 1)), np.tile(problem.l.mean(axis=0), (problem.m, 1))
    for t in np.unique(problem.frame):
        T[t] = problem.l[problem.frame == t].mean(axis=0)
    return R, T


@pytest.mark.parametrize("threads", [1, 2, 3, 20, None])
def test_each_result_is_that_of_its_own_call(problems: list[Problem], threads: int | None) -> None:
    starts = [unrotated(p) for p in problems]
    results = adjust_batch(problems, starts, threads=threads)
    assert len(results) == len(problems)
    for i, (problem, start, result) in enumerate(zip(problems, starts, results, strict=True)):
        if i == 3:
            assert isinstance(result, SingularSystem)
            with pytest.raises(SingularSystem, match=str(result)):
                adjust(problem, *start)
            continue
        alone = adjust(problem, *start)
        assert isinstance(result, Solution)
        assert (result.cost, result.iterations) == (alone.cost, alone.iterations)
        for name in ("R", "T", "X", "W"):
            np.testing.assert_array_equal(getattr(result, name), getattr(alone, name))


def test_every_window_has_its_own_conditions(problems: list[Problem]) -> None:
    pair = problems[:2]
    starts = [unrotated(p) for p in pair]
    fixed = RotationAxis("fixed")
    levelled, conditions = of_window(Smoothing(), fixed, np.arange(pair[0].m) * 0.04, None, starts[0])
    results = adjust_batch(pair, [levelled, starts[1]], conditions=[conditions, None])
    alone = adjust(pair[0], *levelled, conditions=conditions), adjust(pair[1], *starts[1])
    for result, expected in zip(results, alone, strict=True):
        assert isinstance(result, Solution)
        np.testing.assert_array_equal(result.R, expected.R)


def test_no_windows_no_results() -> None:
    assert adjust_batch([], []) == []


def test_what_does_not_fit_is_named(problems: list[Problem]) -> None:
    start = unrotated(problems[0])
    with pytest.raises(ValueError, match="2 problems, 1 starts"):
        adjust_batch(problems[:2], [start])
    with pytest.raises(ValueError, match="threads"):
        adjust_batch(problems[:1], [start], threads=0)
