"""The whole system: every block by finite differences, the elimination against one sparse solution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import scipy.sparse.linalg

from estimators.bordered import BorderedSystem
from estimators.gauss_markov import SingularSystem
from estimators.stereo.conditions import Conditions, RotationAxis, Smoothing, of_window
from estimators.stereo.datum import choose_three, full_null_space
from estimators.stereo.depth_bias import observation_model
from estimators.stereo.full_system import Weighted, about_camera, about_object, camera_points, linearise, weighted
from estimators.stereo.object_motion import Problem, redundancy
from estimators.stereo.triangulation import triangulate, undistorted
from sim.pose import exp_so3, hat

Array = np.ndarray
Maker = Callable[..., Any]
M, N = 4, 7
AXIS_C = (0.1, 1.0, -0.2)
UNEVEN_S = np.array([0.0, 0.04, 0.12, 0.16])
KNOWN: dict[str, tuple[Smoothing, RotationAxis, int]] = {
    "nothing": (Smoothing(), RotationAxis(), 0),
    "velocity": (Smoothing("velocity"), RotationAxis(), 0),
    "turn and rate": (Smoothing("turn", True, "fixed"), RotationAxis(), 0),
    "axis": (Smoothing(), RotationAxis("fixed", axis_c=AXIS_C), 0),
    "uncertain axis": (Smoothing(), RotationAxis("pseudo_observation", axis_c=AXIS_C), 0),
    "tied": (Smoothing(), RotationAxis(), 2),
    "all": (Smoothing("velocity"), RotationAxis("fixed", axis_c=AXIS_C), 2),
    "smooth, uncertain axis, tied": (Smoothing("velocity", True), RotationAxis("adaptive", axis_c=AXIS_C), 1),
}


@dataclass(frozen=True, eq=False)
class Window:
    """Poses and points beside their optimum, what is known, and the weights there."""

    problem: Problem
    R: Array
    T: Array
    X: Array
    conditions: Conditions | None
    w: Weighted

    def system(self, three: bool = False) -> BorderedSystem:
        chosen = choose_three(self.problem.point, self.X) if three else None
        return linearise(self.w, self.R, self.T, self.X, chosen)


@pytest.fixture(scope="module", params=KNOWN)
def window(request: pytest.FixtureRequest, make_scene: Maker) -> Window:
    return make_window(make_scene, *KNOWN[request.param])


def make_window(make_scene: Maker, smoothing: Smoothing, axis: RotationAxis, tied: int) -> Window:
    scene = make_scene(points=N, frames=M, distance_m=12.0, yaw_rate=1.5)
    o = scene.observe(0.5, 1, np.add.outer(np.arange(M), 3 * np.arange(N)) % 5 != 0)
    rig, uv, cov = undistorted(scene.rig, o.tracks.uv, o.tracks.cov)
    l, C = triangulate(rig, uv, cov)
    model = observation_model(rig, l, C, np.linalg.inv(cov), "estimated", True)
    problem = Problem(o.tracks.frame, o.tracks.track, l, model, M, N)
    rng = np.random.default_rng(2)
    start = exp_so3(rng.normal(0, 0.05, (M, 3))) @ scene.T_co.R, scene.T_co.t + rng.normal(0, 0.2, (M, 3))
    (R, T), conditions = of_window(smoothing, axis, UNEVEN_S, None, start, tied)
    X = scene.X + rng.normal(0, 0.1, (N, 3))
    return Window(problem, R, T, X, conditions, weighted(problem, R, T, X, conditions))


def residuals(window: Window, R: Array, T: Array, X: Array) -> Array:
    """What the rows of A linearise, written once more: points in the camera, then what is known."""
    rows = camera_points(window.problem, R, T, X).ravel()
    if window.conditions is None:
        return rows
    now, at = window.conditions.pseudo_observations(R, T), window.conditions.pseudo_observations(window.R, window.T)
    return np.concatenate([rows, now.e[at.P.any(axis=1)]])


@pytest.mark.parametrize("pivot", ["object", "camera"])
def test_every_column_by_finite_differences(window: Window, pivot: str) -> None:
    """Points, rotations and translations, the latter in both ways to turn."""
    system, h = window.system(), 1e-6
    if pivot == "camera":
        system = about_camera(system, window.T)
    A = system.A.toarray()
    for j, step in enumerate(h * np.eye(A.shape[1])):
        f = []
        for dp in (step, -step):
            d = dp[3 * N :].reshape(M, 6)
            turn = exp_so3(d[:, :3])
            T = window.T if pivot == "object" else np.einsum("tab,tb->ta", turn, window.T)
            f.append(residuals(window, turn @ window.R, T + d[:, 3:], window.X + dp[: 3 * N].reshape(N, 3)))
        # Rounding: 12 m, with smoothing over 0.04 s; truncation 1e-12 of it.
        np.testing.assert_allclose(A[:, j], (f[0] - f[1]) / (2 * h), atol=3e-7)


def test_the_right_side_is_what_is_observed_less_what_is_expected(window: Window) -> None:
    system = window.system()
    k = 3 * len(window.problem.frame)
    v = window.w.residuals(window.R, window.T, window.X)
    np.testing.assert_array_equal(system.dl[:k], -v.ravel())
    assert window.w.cost(window.R, window.T, window.X) == pytest.approx(system.dl @ (system.W @ system.dl), rel=1e-12)
    np.testing.assert_allclose((system.C_ll @ system.W).toarray(), np.eye(len(system.dl)), atol=1e-9)


def test_moving_the_object_frame_changes_no_observation(window: Window) -> None:
    k = 3 * len(window.problem.frame)
    system = window.system()
    np.testing.assert_allclose(system.A[:k] @ full_null_space(window.R, window.X), 0, atol=1e-13)
    assert np.linalg.matrix_rank(system.A[:k].toarray()) == 3 * N + 6 * M - 6


@pytest.mark.parametrize("three", [False, True], ids=["inner", "three points"])
def test_the_elimination_solves_the_bordered_system(window: Window, three: bool) -> None:
    system = window.system(three)
    kkt = system.kkt
    right = np.concatenate([system.b, np.zeros(system.H.shape[1])])
    expected = scipy.sparse.linalg.spsolve(kkt.tocsc(), right)[: len(system.b)]
    elimination = system.eliminate()
    sigma = np.sqrt(elimination.variances())
    step = elimination.solve()
    # In standard deviations of the unknowns, those held by conditions in metres and radians.
    unit = np.where(sigma > 1e-7, sigma, 1)
    np.testing.assert_allclose(step / unit, expected / unit, atol=1e-6)
    np.testing.assert_allclose(system.H.T @ step, 0, atol=1e-9)
    inverse = np.linalg.inv(kkt.toarray())[: len(step), : len(step)]
    C = elimination.covariance()
    np.testing.assert_allclose(C / np.outer(unit, unit), inverse / np.outer(unit, unit), atol=1e-6)
    np.testing.assert_allclose(np.diag(C).clip(0), sigma**2, atol=1e-9 * sigma.max() ** 2)


def test_the_damped_step_is_that_of_the_damped_matrix(window: Window) -> None:
    system, damping = window.system(), 1e3
    u, h = system.H.shape
    H = system.H.toarray()
    dense = np.block([[system.N.toarray() + damping * np.eye(u), H], [H.T, np.zeros((h, h))]])
    expected = np.linalg.solve(dense, np.concatenate([system.b, np.zeros(h)]))[:u]
    np.testing.assert_allclose(system.eliminate(damping).solve(), expected, atol=1e-9 * np.abs(expected).max())


def test_turning_about_the_camera_is_the_same_step(window: Window) -> None:
    """Observations, conditions and so the linear step; only the second order differs."""
    system = window.system()
    other = about_camera(system, window.T)
    step = about_object(other.eliminate().solve(), window.T)
    expected = system.eliminate().solve()
    np.testing.assert_allclose(step, expected, atol=1e-7 * np.abs(expected).max())
    np.testing.assert_allclose(other.H.T @ other.eliminate().solve(), 0, atol=1e-9)


def test_conditions_leave_what_is_free_and_the_datum_what_they_leave_open(window: Window) -> None:
    system = window.system()
    held = system.H[3 * N :, system.conditions["datum"].stop :].toarray()
    assert not system.H[: 3 * N, system.conditions["datum"].stop :].nnz
    free = np.eye(6 * M)
    if window.conditions is not None and window.conditions.free is not None:
        free = window.conditions.free
    np.testing.assert_allclose(held.T @ free, 0, atol=1e-12)
    assert np.linalg.matrix_rank(held) == held.shape[1] == 6 * M - free.shape[1]
    # Neither too little nor too much: the matrix is regular, and the datum costs nothing.
    G = full_null_space(window.R, window.X)
    open_ = np.eye(6) if window.conditions is None else window.conditions.terms.datum
    np.testing.assert_allclose(held.T @ G[3 * N :] @ open_, 0, atol=1e-12)
    assert np.linalg.matrix_rank(system.H[:, system.conditions["datum"]].T @ G @ open_) == open_.shape[1]
    assert system.conditions["datum"].stop == open_.shape[1]
    assert system.redundancy == redundancy(window.problem, window.conditions, (window.R, window.T))


def test_redundancy_without_more_knowledge(make_scene: Maker) -> None:
    window = make_window(make_scene, *KNOWN["nothing"])
    assert window.system().redundancy == 3 * len(window.problem.frame) - 3 * N - 6 * M + 6


def test_parts_are_those_of_the_source(make_scene: Maker) -> None:
    """(3.6.4) of the axis, (4.2.15) of tied frames, (4.2.6)-(4.2.11) of smoothing, in the source's unknowns.

    The printed (4.2.7) takes T before and after; (4.2.4), from which it follows, has T_t: S(T_t) (1/dt+ + 1/dt-).
    """
    window = make_window(make_scene, *KNOWN["all"])
    system = about_camera(window.system(), window.T)
    H = system.H[3 * N :].toarray()
    axis, tied = H[:, system.conditions["axis"]].T, H[:, system.conditions["tied"]].T
    Y_1, Y_2, Y_3 = AXIS_C
    expected = np.array([[1, -Y_1 / Y_2, 0], [0, -Y_3 / Y_2, 1]])
    assert axis.shape == (2 * M, 6 * M)
    for t in range(M):
        np.testing.assert_allclose(axis[2 * t : 2 * t + 2, 6 * t : 6 * t + 3], expected, atol=1e-12)
    assert np.count_nonzero(axis) == 4 * M
    assert tied.shape == (6, 6 * M)
    for t in range(2):
        np.testing.assert_allclose(
            tied[3 * t : 3 * t + 3, 6 * t : 6 * t + 6], np.hstack([-hat(window.T[t]), np.eye(3)]), atol=1e-12
        )
    rows = system.A[system.rows["smoothing"], 3 * N :].toarray().reshape(M - 2, 3, 6 * M)
    step = 1 / np.diff(UNEVEN_S)
    for t in range(1, M - 1):
        before, after = step[t - 1], step[t]
        S = hat(window.T)
        g = np.hstack(
            [
                -before * S[t - 1],
                before * np.eye(3),
                (after + before) * S[t],
                -(after + before) * np.eye(3),
                -after * S[t + 1],
                after * np.eye(3),
            ]
        )
        np.testing.assert_allclose(rows[t - 1, :, 6 * (t - 1) : 6 * (t + 2)], g, atol=1e-9)


def test_weights_without_effect_are_left_out(make_scene: Maker) -> None:
    """Smoothing of translations alone: three rows for an inner frame, none for the rates."""
    window = make_window(make_scene, *KNOWN["velocity"])
    system, k = window.system(), 3 * len(window.problem.frame)
    assert system.rows == {
        "observations": slice(0, k),
        "smoothing": slice(k, k + 3 * (M - 2)),
        "axis": slice(k + 3 * (M - 2), k + 3 * (M - 2)),
    }


def test_points_and_motion_that_are_not_determined(make_scene: Maker) -> None:
    window = make_window(make_scene, *KNOWN["nothing"])
    seen = window.problem.point != 2
    part = replace(
        window.problem,
        frame=window.problem.frame[seen],
        point=window.problem.point[seen],
        l=window.problem.l[seen],
        model=window.problem.model.select(seen),
    )
    w = weighted(part, window.R, window.T, window.X)
    with pytest.raises(SingularSystem, match="point is not determined"):
        linearise(w, window.R, window.T, window.X).eliminate()
    line = np.multiply.outer(np.linspace(-1, 1, N), [0.4, 0.1, 2.0])
    w = weighted(window.problem, window.R, window.T, line)
    with pytest.raises(SingularSystem, match="motion is not determined"):
        linearise(w, window.R, window.T, line).eliminate().solve()
