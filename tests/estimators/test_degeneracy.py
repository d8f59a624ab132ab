"""Shapes on a line, as far as their noise can tell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators.gauss_markov import SingularSystem
from estimators.stereo.degeneracy import is_collinear, require_shape
from estimators.stereo.depth_bias import observation_model
from estimators.stereo.object_motion import Problem, Solution, adjust
from estimators.stereo.triangulation import triangulate
from sim.pose import exp_so3

Array = np.ndarray
Maker = Callable[..., Any]
LINES = {"along the view": [0.4, 0.1, 2.0], "across": [1.0, 0.0, 0.0], "upright": [0.0, 1.0, 0.0]}


def weights(X: Array, rng: np.random.Generator) -> Array:
    """Of points seen from 10 m away at the origin: depth fifty times less certain than width, frames 1 to 10."""
    ray = X + np.array([0.0, 0.0, 10.0])
    ray = ray / np.linalg.norm(ray, axis=1)[:, None]
    across = np.eye(3) - ray[:, :, None] * ray[:, None, :]
    W = across + (np.eye(3) - across) / 50**2
    return np.asarray(W * rng.integers(1, 11, len(X))[:, None, None] / 0.002**2)


def noise(N: Array, rng: np.random.Generator) -> Array:
    L = np.linalg.cholesky(N)
    return np.asarray(np.linalg.solve(np.swapaxes(L, 1, 2), rng.standard_normal((len(N), 3, 1)))[:, :, 0])


@pytest.mark.parametrize("n", [3, 5, 30, 200])
@pytest.mark.parametrize("line", LINES)
def test_a_line_is_known_by_its_noise(line: str, n: int) -> None:
    rng = np.random.default_rng(n)
    X = np.multiply.outer(np.linspace(-1, 1, n), LINES[line])
    N = weights(X, rng)
    # One frame has no freedom to fit: all but 1e-4 of the draws, were the line the best one and not near it.
    found = [is_collinear(X + noise(N, rng), N, 1) for _ in range(300)]
    assert np.mean(found) > 0.97


@pytest.mark.parametrize("n", [4, 30, 200])
@pytest.mark.parametrize("line", LINES)
def test_a_strip_is_none(line: str, n: int) -> None:
    """Its points leave the line by twenty standard deviations of the better seen direction."""
    rng = np.random.default_rng(n)
    X = np.multiply.outer(np.linspace(-1, 1, n), LINES[line])
    N = weights(X, rng)
    side = np.cross(LINES[line], [0.0, 0.0, 1.0] if line != "along the view" else [0.0, 1.0, 0.0])
    width = 20 * 0.002 / np.linalg.norm(side)
    X = X + width * np.multiply.outer((-1.0) ** np.arange(n), side)
    assert not any(is_collinear(X + noise(N, rng), N, 10) for _ in range(100))


def test_it_depends_on_no_frame_and_no_unit() -> None:
    rng = np.random.default_rng(1)
    X = np.multiply.outer(np.linspace(-1, 1, 20), LINES["across"])
    N = weights(X, rng)
    R = exp_so3(np.array([0.4, -0.7, 0.2]))
    verdicts = []
    for factor in np.geomspace(1, 10, 40):
        Y = X + factor * noise(N, rng)
        verdicts.append(is_collinear(Y, N, 3))
        assert is_collinear(100 * Y @ R.T + 7.0, R @ N @ R.T / 100**2, 3) == verdicts[-1]
    assert 0 < np.mean(verdicts) < 1


def solved(scene: Any, sigma_px: float, seed: int = 0) -> tuple[Problem, Solution]:
    """Adjusted from the true poses: start values are not the matter here."""
    tracks = scene.observe(sigma_px, seed).tracks
    l, C = triangulate(scene.rig, tracks.uv, tracks.cov)
    model = observation_model(scene.rig, l, C, np.linalg.inv(tracks.cov), "estimated", True)
    m, n = len(scene.t_s), len(scene.X)
    problem = Problem(tracks.frame, tracks.track, l, model, m, n)
    return problem, adjust(problem, scene.T_co.R, scene.T_co.t, max_iterations=200)


@pytest.mark.parametrize("points", [3, 12, 60])
@pytest.mark.parametrize("line", LINES)
def test_an_adjusted_line_is_known(make_scene: Maker, line: str, points: int) -> None:
    """The adjustment turns every frame to where its noise fits best, and the shape grows by it."""
    scene = make_scene(points=points, frames=3, distance_m=30.0)
    scene = replace(scene, X=np.multiply.outer(np.linspace(-1, 1, points), LINES[line]))
    for seed in range(5):
        p, s = solved(scene, 0.2, seed)
        with pytest.raises(SingularSystem, match="the points are collinear"):
            require_shape(p.frame, p.point, s.R, s.X, s.W)


@pytest.mark.parametrize("points", [3, 4, 12, 120])
@pytest.mark.parametrize("distance_m", [10.0, 40.0, 80.0])
def test_a_car_is_none_however_far(make_scene: Maker, points: int, distance_m: float) -> None:
    scene = make_scene(points=points, frames=10, distance_m=distance_m)
    p, s = solved(scene, 0.2)
    require_shape(p.frame, p.point, s.R, s.X, s.W)
