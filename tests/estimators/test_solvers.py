"""The source's solvers end at the optimum of the fast one, and where plain Gauss-Newton is lost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators.gauss_markov import SingularSystem
from estimators.stereo.conditions import RotationAxis, Smoothing, of_window
from estimators.stereo.datum import choose_three, in_frame, three_point_frame
from estimators.stereo.depth_bias import Weights, observation_model
from estimators.stereo.full_system import linearise, weighted
from estimators.stereo.initial_values import from_cloud, points_by_mean
from estimators.stereo.object_motion import Problem, Solution, Stop, adjust, motion_covariance
from estimators.stereo.solvers import Datum, Method, Pivot, adjust_full
from estimators.stereo.triangulation import triangulate
from sim.pose import exp_so3, log_so3

Array = np.ndarray
Maker = Callable[..., Any]
METHODS: tuple[Method, ...] = ("gauss_newton", "line_search", "levenberg_marquardt")
KNOWN: dict[str, tuple[Smoothing, RotationAxis, int]] = {
    "rate": (Smoothing(rotation=True, weights="fixed"), RotationAxis(), 0),
    "axis": (Smoothing(), RotationAxis("fixed"), 0),
    "uncertain axis": (Smoothing(), RotationAxis("pseudo_observation"), 0),
    "adaptive axis": (Smoothing(), RotationAxis("adaptive"), 0),
    "tied": (Smoothing(), RotationAxis(), 3),
    "all": (Smoothing("velocity", True, "fixed"), RotationAxis("fixed"), 3),
}


def to_problem(scene: Any, sigma_px: float, seed: int = 1, weights: Weights = "estimated") -> Problem:
    o = scene.observe(sigma_px, seed)
    l, C = triangulate(scene.rig, o.tracks.uv, o.tracks.cov)
    model = observation_model(scene.rig, l, C, np.linalg.inv(o.tracks.cov), weights, sigma_px > 0)
    return Problem(o.tracks.frame, o.tracks.track, l, model, len(scene.t_s), len(scene.X))


def assert_same_motion(s: Solution, expected: Solution) -> None:
    """Points in the camera and relative rotations: 1e-6 m and rad, of standard deviations of 1 cm and 1e-3."""
    points = [np.einsum("mab,nb->mna", q.R, q.X) + q.T[:, None] for q in (s, expected)]
    np.testing.assert_allclose(points[0], points[1], atol=1e-6)
    turn = (s.R @ s.R[0].T) @ np.swapaxes(expected.R @ expected.R[0].T, 1, 2)
    np.testing.assert_allclose(log_so3(turn), 0, atol=1e-6)
    assert s.cost == pytest.approx(expected.cost, rel=1e-8)


@pytest.fixture(scope="module")
def scene(make_scene: Maker) -> Any:
    return make_scene(points=40)


@pytest.fixture(scope="module")
def problem(scene: Any) -> Problem:
    return to_problem(scene, 0.2)


@pytest.mark.parametrize("pivot", ["object", "camera"])
@pytest.mark.parametrize("datum", ["inner", "three_points"])
@pytest.mark.parametrize("method", METHODS)
def test_optimum_is_the_fast_one_s(problem: Problem, method: Method, datum: Datum, pivot: Pivot) -> None:
    start = from_cloud(problem.frame, problem.l, problem.m)
    expected = adjust(problem, *start, tolerance=1e-12)
    s = adjust_full(problem, *start, method, datum, tolerance=1e-12, pivot=pivot)
    assert_same_motion(s, expected)
    assert s.iterations <= 12


@pytest.mark.parametrize("datum", ["inner", "three_points"])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("known", KNOWN)
def test_optimum_under_conditions_is_the_fast_one_s(scene: Any, known: str, method: Method, datum: Datum) -> None:
    problem = to_problem(scene, 0.2)
    smoothing, axis, tied = KNOWN[known]
    R, T = from_cloud(problem.frame, problem.l, problem.m)
    start, conditions = of_window(smoothing, axis, scene.t_s, None, (R, T), tied)
    expected = adjust(problem, *start, tolerance=1e-12, conditions=conditions)
    s = adjust_full(problem, *start, method, datum, conditions, tolerance=1e-12)
    assert_same_motion(s, expected)
    np.testing.assert_allclose(s.T[:tied], T[:tied], atol=1e-9)


def test_smoothing_without_ties_depends_on_the_origin_alone(scene: Any) -> None:
    """The velocity of the object's origin is smoothed: the datum says which point that is.

    `adjust` lets it drift with the poses, inner constraints keep it in the centroid; far less than the noise.
    """
    problem = to_problem(scene, 0.2)
    start = from_cloud(problem.frame, problem.l, problem.m)
    start, conditions = of_window(Smoothing("velocity", weights="fixed"), RotationAxis(), scene.t_s, None, start)
    expected = adjust(problem, *start, tolerance=1e-12, conditions=conditions)
    s = adjust_full(problem, *start, conditions=conditions, tolerance=1e-12)
    shift = (s.R[-1] @ s.X.mean(axis=0) + s.T[-1]) - (expected.R[-1] @ expected.X.mean(axis=0) + expected.T[-1])
    cov = motion_covariance(problem.frame, problem.point, s.R, s.X, s.W, 0.04, s.T, conditions)[:3, :3]
    assert np.sqrt(shift @ np.linalg.solve(cov, shift)) < 0.02  # standard deviations


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("stop", "tolerance"), [("decrement", 1e-10), ("update", 1e-6), ("relative_update", 1e-4)])
def test_every_stop_criterion_ends_at_the_optimum(
    problem: Problem, method: Method, stop: Stop, tolerance: float
) -> None:
    start = from_cloud(problem.frame, problem.l, problem.m)
    s = adjust_full(problem, *start, method, stop=stop, tolerance=tolerance)
    best = adjust(problem, *start, tolerance=1e-14)
    # 1e-3 standard deviations of 1 cm and more.
    for q in (0, -1):
        np.testing.assert_allclose(
            s.R[q] @ s.X.T + s.T[q][:, None], best.R[q] @ best.X.T + best.T[q][:, None], atol=1e-5
        )
    assert adjust_full(problem, *start, method, stop=stop, tolerance=1e3 * tolerance).iterations <= s.iterations - 1


@pytest.mark.parametrize("datum", ["inner", "three_points"])
def test_the_frame_stays_where_the_start_puts_it(problem: Problem, datum: Datum) -> None:
    """(3.1.35): the centroid to rounding; (3.1.39): the three points stay in the frame they span."""
    R, T = from_cloud(problem.frame, problem.l, problem.m)
    X = points_by_mean(problem, R, T)
    s = adjust_full(problem, R, T, datum=datum)
    if datum == "inner":
        np.testing.assert_allclose(s.X.mean(axis=0), X.mean(axis=0), atol=1e-12)
        return
    three = choose_three(problem.point, X)
    before, after = three_point_frame(X, three), three_point_frame(s.X, three)
    np.testing.assert_allclose(after[0], before[0], atol=1e-9)
    np.testing.assert_allclose(after[1], before[1], atol=1e-9)
    own = in_frame(s.R, s.T, s.X, *after)[2][three]
    np.testing.assert_allclose([own[0, 0], *own[:2, 1], *own[:, 2]], 0, atol=1e-12)


def test_line_search_needs_no_more_iterations_from_afar(make_scene: Maker) -> None:
    for seed in range(3):
        problem = to_problem(make_scene(points=40, frames=8, distance_m=80.0), 0.2, seed, "observed")
        start = from_cloud(problem.frame, problem.l, problem.m, "principal_axes")
        plain, searched = (adjust_full(problem, *start, method) for method in ("gauss_newton", "line_search"))
        assert searched.iterations <= plain.iterations
        assert searched.cost == pytest.approx(plain.cost, rel=1e-6)


def test_step_control_survives_where_gauss_newton_is_lost(make_scene: Maker) -> None:
    """Rotations wrong by half a radian, 80 m away."""
    scene = make_scene(points=40, frames=8, distance_m=80.0)
    problem = to_problem(scene, 0.2, 4)
    rng = np.random.default_rng(4)
    R, T = exp_so3(rng.normal(0, 0.5, (8, 3))) @ scene.T_co.R, scene.T_co.t + rng.normal(0, 1, (8, 3))
    with pytest.raises(SingularSystem, match=r"diverge|no convergence within 100"):
        adjust_full(problem, R, T, max_iterations=100)
    for method in ("line_search", "levenberg_marquardt"):
        s = adjust_full(problem, R, T, method, tolerance=1e-12, max_iterations=100)
        assert_same_motion(s, adjust(problem, s.R, s.T, tolerance=1e-12))


def test_points_that_no_image_determines_are_a_divergence(make_scene: Maker) -> None:
    """A lost Gauss-Newton leads them to where the information of the images is singular; here it is from the start."""
    scene = make_scene(points=10, frames=4, distance_m=20.0)
    problem = to_problem(scene, 0.2, 4)
    blind = replace(problem.model, W_uv=np.zeros_like(problem.model.W_uv))
    with pytest.raises(SingularSystem, match="diverge"):
        adjust_full(replace(problem, model=blind), scene.T_co.R, scene.T_co.t)


@pytest.mark.parametrize("known", ["nothing", "axis"])
def test_variance_factor_counts_the_conditions(make_scene: Maker, known: str) -> None:
    """Weights state 0.2 px, the noise is 0.3 px: 2.25, also where the axis is a condition that holds."""
    scene, runs, factors = make_scene(points=8, frames=4, distance_m=12.0), 40, []
    for seed in range(runs):
        problem = to_problem(scene, 0.3, seed)
        axis = RotationAxis("fixed" if known == "axis" else "free")
        start, conditions = of_window(Smoothing(), axis, scene.t_s, None, (scene.T_co.R, scene.T_co.t))
        s = adjust_full(problem, *start, conditions=conditions)
        system = linearise(weighted(problem, s.R, s.T, s.X, conditions), s.R, s.T, s.X)
        factors.append(system.variance_factor(s.cost))
    r = 96 - 24 - 24 + 6 + (6 if known == "axis" else 0)  # two of three turns from frame to frame
    assert system.redundancy == r
    # 3.5 sigma of the mean of chi-square over its degrees of freedom.
    assert np.mean(factors) == pytest.approx(2.25, rel=3.5 * np.sqrt(2 / (r * runs)))


def test_without_redundancy_there_is_no_variance_factor(make_scene: Maker) -> None:
    """One frame: as many coordinates as unknowns."""
    scene = make_scene(points=5, frames=1)
    problem = to_problem(scene, 0.0)
    state = scene.T_co.R, scene.T_co.t, scene.X
    with pytest.raises(SingularSystem, match="redundant"):
        linearise(weighted(problem, *state), *state).variance_factor(1.0)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("datum", ["inner", "three_points"])
def test_what_does_not_determine_the_motion_is_singular(make_scene: Maker, method: Method, datum: Datum) -> None:
    scene = make_scene(points=6, frames=3, distance_m=12.0)
    line = np.multiply.outer(np.linspace(-1, 1, 6), [0.4, 0.1, 2.0])
    problem = to_problem(type(scene)(scene.rig, scene.t_s, scene.T_co, line), 0.0)
    with pytest.raises(SingularSystem):
        adjust_full(problem, scene.T_co.R, scene.T_co.t, method, datum)


def test_too_few_iterations_are_no_result(problem: Problem) -> None:
    with pytest.raises(SingularSystem, match="no convergence within 2 iterations"):
        adjust_full(problem, *from_cloud(problem.frame, problem.l, problem.m), max_iterations=2)
