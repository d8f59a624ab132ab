"""Outlier detection: residual covariance against a dense one, the tests at their level, the published experiment."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from estimators.gauss_markov import SingularSystem
from estimators.stereo.depth_bias import observation_model
from estimators.stereo.initial_values import from_cloud
from estimators.stereo.object_motion import Problem, Solution, adjust, design, motion_covariance, redundancy
from estimators.stereo.outliers import (
    DETECTORS,
    PRINTED_TRACK_TEST,
    SOURCE_POINT_TEST,
    SOURCE_TRACK_TEST,
    Detector,
    PointTest,
    PriorKnowledge,
    Ransac,
    Robust,
    TrackTest,
    select_points,
)
from estimators.stereo.outliers.ransac import triple_jacobian, triple_poses
from estimators.stereo.outliers.residuals import (
    fit,
    of_solution,
    point_statistics,
    residual_covariance,
    track_statistics,
)
from estimators.stereo.outliers.rigidity import consistency, largest_group
from estimators.stereo.triangulation import triangulate
from sim.camera import StereoRig
from sim.pose import exp_so3, log_so3
from sim.scenario import Scenario
from sim.simulate import simulate
from sim.world import World, build_world

Array = np.ndarray
Maker = Callable[..., Any]


def make_problem(scene: Any, sigma_px: float = 0.2, keep: Array | None = None, seed: int = 1) -> Problem:
    o = scene.observe(sigma_px, seed, keep)
    l, C = triangulate(scene.rig, o.tracks.uv, o.tracks.cov)
    model = observation_model(scene.rig, l, C, np.linalg.inv(o.tracks.cov), "estimated", True)
    return Problem(o.tracks.frame, o.tracks.track, l, model, len(scene.t_s), len(scene.X))


def some_missing(m: int, n: int) -> Array:
    return np.asarray(np.add.outer(np.arange(m), 3 * np.arange(n)) % 4 != 0)


def solve(problem: Problem, start: tuple[Array, Array]) -> Solution:
    return adjust(problem, *start)


def grid(outliers: Sequence[Mapping[str, Any]]) -> Scenario:
    """The experiment of 3.4.4, with a slower car in the next lane that only wrong segmentation brings in."""

    def vehicle(name: str, x_m: float, speed_mps: float) -> dict[str, Any]:
        motion = {"kind": "straight", "start_m": (x_m, 20.0), "heading_deg": 180.0, "speed_mps": speed_mps}
        return {"name": name, "mesh": "point_grid", "size_m": (5.0, 1.25, 1.0), "motion": motion}

    return Scenario.model_validate(
        {
            "title": "grid", "kind": "stereo", "seed": 2,
            "rig": {"size_px": (1024, 768), "focal_px": 1000.0, "baseline_m": 0.3, "rate_hz": 25.0, "frames": 10},
            "vehicle": [vehicle("target", 0.0, 20.0), vehicle("neighbour", 3.0, 15.0)],
            "measure": {"points": 100, "sigma_px": 0.2, "occlusion": False},
            "outliers": outliers, "world": {"roadside": False}, "render": {"enabled": False},
        }
    )  # fmt: skip


@functools.cache
def grid_world() -> World:
    """Outliers are no part of the world."""
    return build_world(grid([]))


def cases(outliers: Sequence[Mapping[str, Any]], runs: int) -> list[tuple[Problem, Array]]:
    """Problems and which of their tracks are wrong."""
    spec = grid(outliers)
    world, result = grid_world(), []
    for run in range(runs):
        o, truth = simulate(spec, run, world)
        l, C = triangulate(o.rig, o.tracks.uv, o.tracks.cov)
        good = np.isfinite(l).all(axis=1)
        good &= np.bincount(o.tracks.track[good], minlength=o.tracks.track.max() + 1)[o.tracks.track] > 1
        _, point = np.unique(o.tracks.track[good], return_inverse=True)
        W_uv = np.linalg.inv(o.tracks.cov[good])
        model = observation_model(o.rig, l[good], C[good], W_uv, "estimated", True)
        problem = Problem(o.tracks.frame[good], point, l[good], model, 10, int(point.max()) + 1)
        result.append((problem, np.bincount(point, truth.labels.kind[good] > 0) > 0))
    return result


def noise(share: float, frames: int = 10) -> dict[str, Any]:
    return {"kind": "noise", "tracks": share, "frames": frames, "sigma_px": 2.0, "min_px": 2.0}


def rates(detector: Detector, data: list[tuple[Problem, Array]]) -> tuple[float, float]:
    """Mean share of the good tracks dropped, mean number of wrong tracks kept."""
    fp, fn = [], []
    for problem, wrong in data:
        verdict = detector(problem, from_cloud(problem.frame, problem.l, problem.m), solve)
        fp.append(np.mean(~verdict.inlier[~wrong]))
        fn.append(np.count_nonzero(verdict.inlier & wrong))
    return float(np.mean(fp)), float(np.mean(fn))


@pytest.fixture(scope="module")
def small(make_scene: Maker) -> Any:
    return make_scene(points=9, frames=4, distance_m=12.0, yaw_rate=1.5)


@pytest.mark.parametrize("missing", [False, True], ids=["all seen", "some missing"])
def test_residual_covariance_is_the_dense_one(small: Any, missing: bool) -> None:
    m, n = 4, 9
    problem = make_problem(small, keep=some_missing(m, n) if missing else None)
    f = of_solution(problem, adjust(problem, small.T_co.R, small.T_co.t))
    k = len(f.frame)
    A = np.zeros((k, 3, 6 * m + 3 * n))
    for row, (t, i) in enumerate(zip(f.frame, f.point, strict=True)):
        A[row, :, 6 * t : 6 * t + 6] = design(f.R[[t]], f.X[[i]])[0]
        A[row, :, 6 * m + 3 * i : 6 * m + 3 * i + 3] = f.R[t]
    # Whitened: C_vv = L (I - J J^+) L' with W^-1 = L L', J = L^-1 A; the rank is known, so the datum needs no care.
    L = np.linalg.cholesky(f.C_ll)
    J = np.linalg.solve(L, A).reshape(3 * k, -1)
    U = np.linalg.svd(J / np.linalg.norm(J, axis=0), full_matrices=False)[0][:, : 6 * m + 3 * n - 6]
    dense = np.eye(3 * k) - U @ U.T
    blocks = residual_covariance(f)
    trace = 0.0
    for i in range(n):
        rows = slice(3 * f.first[i], 3 * f.first[i + 1])
        size = 3 * f.count[i]
        inverse = np.linalg.inv(np.linalg.cholesky(_block_diagonal(f.C_ll[f.first[i] : f.first[i + 1]])))
        whitened = inverse @ blocks[i, :size, :size] @ inverse.T
        # Unit variances; the blocks lose some digits where the reduced normal matrix is ill-conditioned.
        np.testing.assert_allclose(whitened, dense[rows, rows], atol=1e-7)
        np.testing.assert_array_equal(blocks[i, size:, size:], np.eye(blocks.shape[1] - size))
        # The track's own point takes three from the rank.
        assert np.sum(np.linalg.eigvalsh(whitened) > 1e-6) == size - 3
        trace += np.trace(whitened)
        T = track_statistics(f)[i]
        u = inverse @ f.v[f.first[i] : f.first[i + 1]].ravel()
        assert u @ np.linalg.pinv(dense[rows, rows], rcond=1e-6) @ u == pytest.approx(T, rel=1e-5)
    # tr(C_vv P) is the redundancy.
    assert trace == pytest.approx(redundancy(problem), abs=1e-6)


def _block_diagonal(blocks: Array) -> Array:
    out = np.zeros((3 * len(blocks), 3 * len(blocks)))
    for j, block in enumerate(blocks):
        out[3 * j : 3 * j + 3, 3 * j : 3 * j + 3] = block
    return out


def test_statistics_follow_their_distributions(make_scene: Maker) -> None:
    scene = make_scene(points=40, frames=6, distance_m=12.0)
    keep = some_missing(6, 40)
    inside = np.arange(40) % 2 == 0
    T, T_inside, T_outside, T_point, freedom = [], [], [], [], []
    for seed in range(40):
        problem = make_problem(scene, keep=keep, seed=seed)
        f = of_solution(problem, adjust(problem, scene.T_co.R, scene.T_co.t))
        T.append(track_statistics(f))
        T_point.append(point_statistics(f))
        half = select_points(problem, inside)
        s = adjust(half, scene.T_co.R, scene.T_co.t)
        predicted = track_statistics(fit(problem, s.R, s.T, fit(problem, s.R, s.T).X), inside)
        T_inside.append(predicted[inside])
        T_outside.append(predicted[~inside])
        freedom.append(3 * f.count - 3)
    for values, expected in (
        (np.array(T), np.array(freedom)),
        (np.array(T_inside), np.array(freedom)[:, inside]),
        (np.array(T_outside), np.array(freedom)[:, ~inside]),
        (np.array(T_point), np.full_like(T_point, 3)),
    ):
        # Mean of N chi-square values: sigma = sqrt(2 / (N freedom)) of the freedom; 800 and more, correlated: 4 %.
        assert values.sum() / expected.sum() == pytest.approx(1, abs=0.04)
        # 5 % of 800 and more values, correlated: 4 sigma of 400 independent ones.
        assert np.mean(values > chi2.isf(0.05, expected)) == pytest.approx(0.05, abs=0.04)


def test_select_points_is_the_problem_of_these_tracks(small: Any) -> None:
    problem = make_problem(small, keep=some_missing(4, 9))
    keep = np.array([1, 1, 0, 1, 1, 0, 1, 1, 1], bool)
    part = select_points(problem, keep)
    rows = np.isin(problem.point, np.flatnonzero(keep))
    assert part.n == 7
    np.testing.assert_array_equal(np.flatnonzero(keep)[part.point], problem.point[rows])
    np.testing.assert_array_equal(part.l, problem.l[rows])
    for a, b in zip(part.model(part.l), problem.model(problem.l), strict=True):
        np.testing.assert_array_equal(a, b[rows])
    assert select_points(problem, np.ones(9, bool)) is problem
    with pytest.raises(SingularSystem, match="fewer than 3 tracks"):
        select_points(problem, np.arange(9) < 3)


def test_prior_knowledge(rigs: dict[str, StereoRig]) -> None:
    rig, cov = rigs["normal"], np.eye(4) * 0.2**2
    # Depth of the normal case: sigma_Z = Z² sigma sqrt(2) / (f B), at the distance of the centroid plus S_0.
    distance = np.array([20.0, 60.0])
    expected = 5 + 2 * (distance + 5) ** 2 * 0.2 * np.sqrt(2) / 300
    np.testing.assert_allclose(PriorKnowledge(5.0).threshold(rig, cov, distance), expected, rtol=1e-9)
    # Five tracks in two frames; one leaves the object in the second.
    cloud = np.array([[0, 0, 20.0], [1, 0, 20], [-1, 0, 20], [0, 1, 20], [0, -1, 20]])
    l = np.concatenate([cloud, cloud])
    l[7] += [0, 0, 12.0]
    frame, point = np.repeat([0, 1], 5), np.tile(np.arange(5), 2)
    inlier = PriorKnowledge(5.0)(rig, np.tile(cov, (10, 1, 1)), frame, point, l)
    np.testing.assert_array_equal(inlier, [True, True, False, True, True])
    assert PriorKnowledge(12.0)(rig, np.tile(cov, (10, 1, 1)), frame, point, l).all()


def test_triple_poses_and_their_jacobian() -> None:
    rng = np.random.default_rng(4)
    x, h = rng.normal(size=(5, 3, 3)), 1e-6
    R, T = triple_poses(x)
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), (5, 3, 3)), atol=1e-14)
    assert (np.linalg.det(R) > 0).all()
    np.testing.assert_array_equal(T, x[:, 0])
    J = triple_jacobian(x)
    for j in range(9):
        d = np.zeros(9)
        d[j] = h
        (R_a, T_a), (R_b, T_b) = triple_poses(x + d.reshape(3, 3)), triple_poses(x - d.reshape(3, 3))
        turn = log_so3(R_a @ np.swapaxes(R_b, 1, 2)) / (2 * h)
        np.testing.assert_allclose(J[:, :, j], np.concatenate([turn, (T_a - T_b) / (2 * h)], axis=1), atol=1e-6)
    assert np.isnan(triple_poses(np.outer([1.0, 2, 3], [1.0, 1, 1])[None])[0]).any()


def test_ransac() -> None:
    # (3.4.8): ln(1 - P) / ln(1 - 1/8) = 68.97.
    assert Ransac(outlier_share=0.5, confidence=0.9999).iterations == 69
    fp, fn = rates(Ransac(), cases([noise(0.5)], 3))
    # Poses of three tracks are uncertain: few good tracks fall, gross errors in all frames show.
    assert fp < 0.05
    assert fn <= 1 / 3


def test_ransac_needs_tracks_that_span_the_window(small: Any) -> None:
    with pytest.raises(SingularSystem, match="span the window"):
        Ransac().consensus(make_problem(small, keep=some_missing(4, 9)))


@pytest.mark.parametrize(("share", "frames"), [(0.1, 10), (0.3, 1), (0.5, 5)])
def test_corrected_tests_hold_their_level(share: float, frames: int) -> None:
    data = cases([noise(share, frames)], 6)
    for detector in (TrackTest(), PointTest()):
        fp, fn = rates(detector, data)
        # Level 5 %; 300 good tracks and more: 3 sigma = 4 %.
        assert 0.01 <= fp <= 0.09
        assert fn <= 0.1


def test_tests_of_the_source() -> None:
    few, half = cases([noise(0.1)], 6), cases([noise(0.5)], 2)
    fp_track, fn_track = rates(SOURCE_TRACK_TEST, few)
    assert fp_track <= 3 / 90
    assert fn_track == 0
    fp_point, fn_point = rates(SOURCE_POINT_TEST, few)
    assert fp_point > 5 * max(fp_track, 0.03)  # the worst of ten frames at the quantile of one: 1 - 0.95^10 = 40 %
    assert fn_point == 0
    # Ten times ceil(5 %) of the tracks left are 43 of 100: fn = 7 + fp.
    for detector in (SOURCE_TRACK_TEST, SOURCE_POINT_TEST):
        for problem, wrong in half:
            inlier = detector(problem, from_cloud(problem.frame, problem.l, problem.m), solve).inlier
            assert np.count_nonzero(~inlier) == 43
            assert np.count_nonzero(inlier & wrong) == 7 + np.count_nonzero(~inlier & ~wrong)
    # Degrees of freedom as printed in (3.4.14): always the cap.
    assert rates(PRINTED_TRACK_TEST, few[:2])[0] == pytest.approx(33 / 90)


@pytest.mark.parametrize(
    "outliers",
    [
        [],
        [noise(0.6)],
        [noise(0.6, 1)],
        [{"kind": "stereo", "tracks": 0.6, "frames": 10}],
        [{"kind": "temporal", "tracks": 0.6}],
        [noise(0.2), {"kind": "stereo", "tracks": 0.2}, {"kind": "temporal", "tracks": 0.2}],
    ],
    ids=["none", "noise", "one frame", "stereo", "temporal", "all"],
)
def test_robust_detector_survives_a_majority_of_outliers(outliers: list[dict[str, Any]]) -> None:
    data = cases(outliers, 3)
    fp, fn = rates(Robust(), data)
    assert fp <= 0.05  # level 1 %; 120 good tracks and more: 4 sigma = 4 %
    assert fn <= 0.34
    assert Robust()(data[0][0], from_cloud(data[0][0].frame, data[0][0].l, 10), solve).second_group is None


@pytest.mark.parametrize("share", [0.2, 0.35, 0.5])
def test_robust_detector_reports_a_second_group(share: float) -> None:
    for problem, wrong in cases([{"kind": "segmentation", "tracks": share, "on": "neighbour"}], 2):
        verdict = Robust()(problem, from_cloud(problem.frame, problem.l, problem.m), solve)
        assert verdict.second_group is not None
        groups = np.stack([verdict.inlier, verdict.second_group])
        # Which of two halves is the object nobody can tell, but they are told apart; 1 % of 100 tracks: 6 at most.
        own, other = (~wrong, wrong) if share < 0.5 or groups[0, ~wrong].mean() > 0.5 else (wrong, ~wrong)
        assert np.count_nonzero(groups[0] != own) <= 6
        assert np.count_nonzero(groups[1] != other) <= 6
        assert not groups[0, other].any()


@pytest.mark.parametrize("distance_m", [12.0, 40.0])
def test_robust_detector_with_ragged_tracks(make_scene: Maker, distance_m: float) -> None:
    """Tracks are born and die; every third one is off by 3 px to the right image in two of its frames."""
    m, n = 10, 60
    birth = np.arange(n) % 5
    keep = (np.arange(m)[:, None] >= birth) & (np.arange(m)[:, None] < birth + 5 + np.arange(n) % 3)
    keep[:, :20] = True
    scene = make_scene(points=n, frames=m, distance_m=distance_m)
    o = scene.observe(0.2, 3, keep)
    wrong = np.arange(n) % 3 == 0
    uv = o.tracks.uv.copy()
    hit = wrong[o.tracks.track] & np.isin(o.tracks.frame - birth[o.tracks.track] * (o.tracks.track >= 20), [1, 2])
    uv[hit, 2] -= 3.0
    l, C = triangulate(scene.rig, uv, o.tracks.cov)
    model = observation_model(scene.rig, l, C, np.linalg.inv(o.tracks.cov), "estimated", True)
    problem = Problem(o.tracks.frame, o.tracks.track, l, model, m, n)
    verdict = Robust()(problem, from_cloud(problem.frame, l, m), solve)
    assert not (verdict.inlier & wrong).any()
    assert np.count_nonzero(~verdict.inlier & ~wrong) <= 3  # 40 tracks at 1 %: 0.4 expected
    assert len(verdict.solution.X) == np.count_nonzero(verdict.inlier)


def test_graph_of_kept_distances_needs_no_motion() -> None:
    (problem, wrong), = cases([noise(0.6)], 1)  # fmt: skip
    agree, known = consistency(problem, np.linalg.inv(problem.model(problem.l)[1]))
    np.testing.assert_array_equal(agree, agree.T)
    assert not agree.diagonal().any()
    group = largest_group(agree, known, np.ones(problem.n, bool))
    assert np.count_nonzero(group & ~wrong) > 0.8 * np.count_nonzero(~wrong)
    assert np.count_nonzero(group & wrong) <= 1


@pytest.mark.parametrize("name", ["tracks", "points", "robust"])
def test_nothing_but_outliers_is_no_result(name: str) -> None:
    (problem, _), = cases([noise(1.0)], 1)  # fmt: skip
    with pytest.raises(SingularSystem):
        DETECTORS[name](problem, from_cloud(problem.frame, problem.l, problem.m), solve)


@pytest.mark.parametrize("case", ["three tracks", "collinear"])
def test_what_no_detector_can_judge(make_scene: Maker, case: str) -> None:
    scene = make_scene(points=3 if case == "three tracks" else 8, frames=4, distance_m=12.0)
    if case == "collinear":
        scene = type(scene)(scene.rig, scene.t_s, scene.T_co, np.multiply.outer(np.linspace(-1, 1, 8), [0.4, 0.1, 2.0]))
    problem = make_problem(scene, 0.0)

    def judge_and_finish() -> None:
        # Rounding may hide collinearity from the adjustment; the covariance every window needs sees it at the latest.
        verdict = Robust()(problem, (scene.T_co.R, scene.T_co.t), solve)
        part, s = select_points(problem, verdict.inlier), verdict.solution
        motion_covariance(part.frame, part.point, s.R, s.X, s.W, 0.04)

    with pytest.raises(SingularSystem):
        judge_and_finish()


@pytest.mark.parametrize("name", sorted(DETECTORS))
def test_detectors_are_deterministic_and_change_nothing(name: str) -> None:
    (problem, _), = cases([noise(0.1)], 1)  # fmt: skip
    before = problem.l.copy()
    start = from_cloud(problem.frame, problem.l, problem.m)
    a, b = (DETECTORS[name](problem, start, solve) for _ in range(2))
    np.testing.assert_array_equal(a.inlier, b.inlier)
    np.testing.assert_array_equal(a.solution.T, b.solution.T)
    np.testing.assert_array_equal(problem.l, before)
    assert len(a.solution.X) == np.count_nonzero(a.inlier)


def test_datum_of_the_start_does_not_matter(make_scene: Maker) -> None:
    scene = make_scene(points=30, frames=5, distance_m=15.0)
    problem = make_problem(scene)
    Q = exp_so3(np.array([0.5, -1.0, 2.0]))
    R, T = scene.T_co.R, scene.T_co.t
    s = adjust(problem, R, T)
    f = of_solution(problem, s)
    moved = fit(problem, s.R @ Q.T, s.T - (s.R @ Q.T @ np.array([1.0, -2, 3])), s.X @ Q.T + [1.0, -2, 3])
    np.testing.assert_allclose(track_statistics(moved), track_statistics(f), rtol=1e-6)
