"""Every option of the sliding-window adjustment, alone and with others: noise-free truth, and what each is for."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators.estimate import EstimationFailed, TrajectoryEstimate, WindowEstimate
from estimators.stereo.conditions import RotationAxis, Smoothing
from estimators.stereo.sliding_window import SlidingWindowAdjustment
from sim.pose import Pose, exp_so3

Array = np.ndarray
Maker = Callable[..., Any]
TURN = Smoothing("turn", True, "fixed")
OPTIONS: dict[str, dict[str, Any]] = {
    "thinned": {"selection": "thinned", "window": 6},
    "growing": {"selection": "growing"},
    "whole": {"selection": "whole"},
    "skipped": {"skipped": (4, 5)},
    "unscented": {"propagation": "unscented", "weights": "averaged"},
    "gauss_newton": {"solver": "gauss_newton"},
    "line_search": {"solver": "line_search"},
    "levenberg_marquardt": {"solver": "levenberg_marquardt"},
    "median": {"points": "median"},
    "propagated": {"points": "propagated"},
    "shared_tracks": {"initial": "shared_tracks"},
    "no propagation": {"propagate": False},
    "three_points": {"datum": "three_points"},
    "tied": {"smoothing": Smoothing(tied=2)},
    "known extent": {"extent_m": 6.0},
    "three batches": {"outliers": "tracks", "batches": 3},
    "axis": {"rotation_axis": RotationAxis("fixed")},
    "turn": {"smoothing": TURN},
    "turn, axis, image space": {"smoothing": TURN, "rotation_axis": RotationAxis("adaptive"), "space": "image"},
    "turn, axis, gauss_newton": {"smoothing": TURN, "rotation_axis": RotationAxis("fixed"), "solver": "gauss_newton"},
    "tied, axis, image space": {
        "smoothing": Smoothing(tied=2),
        "rotation_axis": RotationAxis("fixed"),
        "space": "image",
        "datum": "three_points",
    },
    "robust, turn, thinned": {"outliers": "robust", "smoothing": TURN, "selection": "thinned", "window": 6},
}


@pytest.fixture(scope="module")
def turning(make_scene: Maker) -> Any:
    """A steady turn about the camera's vertical, 14 frames, so that every condition holds."""
    scene = make_scene(points=24, frames=14)
    turn = np.multiply.outer(scene.t_s, [0.0, -0.4, 0.0])
    T = np.einsum("tab,b->ta", exp_so3(turn), [-3.0, 1.0, 14.0])
    return replace(scene, T_co=Pose(exp_so3(turn + np.array([0, 0.3, 0])), T))


def run(scene: Any, sigma_px: float = 0.0, seed: int = 0, **options: Any) -> TrajectoryEstimate:
    estimate = SlidingWindowAdjustment(**options)(scene.observe(sigma_px, seed))
    assert isinstance(estimate, TrajectoryEstimate), estimate
    return estimate


def seen(w: WindowEstimate, k: int = -1) -> Array:
    """Camera coordinates of a window's points in one of its frames."""
    return np.asarray(w.T_co[k].apply(w.X_o))


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
def test_noise_free_motion_is_recovered(turning: Any, options: dict[str, Any]) -> None:
    estimate = run(turning, second_order=False, **options)
    assert not estimate.failures
    for w in estimate.windows:
        for k, frame in enumerate(w.frames):
            np.testing.assert_allclose(seen(w, k), turning.points_c()[frame][w.track], atol=1e-6)


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
def test_noise_stays_within_what_is_stated(turning: Any, options: dict[str, Any]) -> None:
    w = run(turning, 0.2, 5, **options).windows[-1]
    error = seen(w).mean(axis=0) - turning.points_c()[w.frames[-1]][w.track].mean(axis=0)
    assert error @ np.linalg.solve(w.cov[:3, :3], error) < 21.1  # 99.99 % of chi-square with 3 degrees
    assert 0.8 < w.sigma_0 < 1.2


def test_windows_of_the_strategies(turning: Any) -> None:
    frames = {
        name: run(turning, **OPTIONS[name]).windows[-1].frames.tolist() for name in ("thinned", "growing", "whole")
    }
    assert frames["growing"] == frames["whole"] == list(range(14))
    assert frames["thinned"][0] < 14 - 6
    assert len(frames["thinned"]) <= 6
    assert len(run(turning, **OPTIONS["whole"]).windows) == 1
    skipping = run(turning, **OPTIONS["skipped"])
    assert not {4, 5} & {int(t) for w in skipping.windows for t in w.frames}
    assert [int(w.frames[-1]) for w in skipping.windows] == [2, 3, *range(6, 14)]


def test_three_points_define_the_frame_while_they_are_seen(turning: Any) -> None:
    windows = run(turning, 0.2, datum="three_points").windows
    for w in windows:
        X = w.X_o[np.searchsorted(w.track, w.datum)]
        np.testing.assert_allclose(X[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]], 0, atol=1e-12)
        np.testing.assert_array_equal(w.datum, windows[0].datum)


def test_the_datum_says_nothing_of_what_is_seen(turning: Any) -> None:
    inner, three = (run(turning, 0.2, datum=d).windows[-1] for d in ("inner", "three_points"))
    np.testing.assert_allclose(seen(inner), seen(three), atol=1e-7)
    np.testing.assert_allclose(inner.cov, three.cov, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("solver", ["gauss_newton", "line_search", "levenberg_marquardt"])
@pytest.mark.parametrize(
    ("known", "atol", "rel"),
    [
        ({}, 1e-6, 1e-8),
        ({"rotation_axis": RotationAxis("fixed")}, 1e-6, 1e-8),
        # What is smooth at one origin is not quite so at another: the optimum moves with the solvers' inner datum.
        ({"smoothing": TURN}, 1e-4, 1e-5),
    ],
    ids=["free", "axis", "smooth"],
)
def test_all_solvers_find_the_same_optimum(
    turning: Any, solver: Any, known: dict[str, Any], atol: float, rel: float
) -> None:
    options: dict[str, Any] = {"tolerance": 1e-12, **known}
    ours, theirs = (run(turning, 0.2, solver=s, **options).windows[-1] for s in ("newton", solver))
    np.testing.assert_allclose(seen(ours), seen(theirs), atol=atol)
    assert ours.cost == pytest.approx(theirs.cost, rel=rel)
    assert ours.redundancy == theirs.redundancy


def test_tied_frames_stay_where_the_last_window_had_them(turning: Any) -> None:
    windows = run(turning, 0.2, smoothing=Smoothing(tied=3)).windows
    for last, w in itertools.pairwise(windows):
        at = np.searchsorted(last.frames, w.frames[:3])
        np.testing.assert_allclose(w.T_co.t[:3], last.T_co.t[at], atol=1e-12)


def test_prior_knowledge_drops_what_is_too_far_out(turning: Any) -> None:
    o = turning.observe(0.2)
    uv_left, uv_right = o.tracks.uv_left.copy(), o.tracks.uv_right.copy()
    far = o.tracks.track == 7
    uv_right[far, 0] = uv_left[far, 0] - 4.0  # 75 m away
    o = replace(o, tracks=replace(o.tracks, uv_left=uv_left, uv_right=uv_right))
    estimate = SlidingWindowAdjustment(extent_m=6.0)(o)
    assert isinstance(estimate, TrajectoryEstimate)
    assert all(w.rejected.tolist() == [7] for w in estimate.windows)


def test_a_frame_that_has_drifted_off_is_put_back_on_the_cloud(make_scene: Maker) -> None:
    scene = make_scene(points=60, frames=30)
    # Ever farther points of a long train: those seen first are soon 20 m away from those seen last.
    X = scene.X + np.multiply.outer(np.arange(60) / 2.0, [0.0, 0.0, 1.0])
    scene = replace(scene, X=X, T_co=Pose(scene.T_co.R * 0 + np.eye(3), scene.T_co.t * [1, 1, 0] + [0, 0, 10.0]))
    first = np.arange(60) / 2.5
    keep = (np.arange(30)[:, None] >= first - 6) & (np.arange(30)[:, None] <= first + 6)
    observations = scene.observe(0.05, keep=keep)
    ends = []
    for extent_m in (0.0, 6.0):
        estimate = SlidingWindowAdjustment(extent_m=extent_m, window=5)(observations)
        assert isinstance(estimate, TrajectoryEstimate)
        ends.append(np.median(np.linalg.norm(estimate.windows[-1].X_o, axis=1)))
    assert ends[0] > 12.0
    assert ends[1] < 8.0


@pytest.mark.parametrize(
    "options",
    [
        {"skipped": (-1,)},
        {"extent_m": -1.0},
        {"extent_m": np.inf},
        {"smoothing": Smoothing(tied=10)},
        {"window": 1},
        {"propagation": "unscented"},
    ],
    ids=str,
)
def test_options_out_of_range_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"is out of range|expected linear"):
        SlidingWindowAdjustment(**options)


def test_all_frames_skipped_is_a_failure(turning: Any) -> None:
    estimate = SlidingWindowAdjustment(skipped=tuple(range(14)))(turning.observe())
    assert isinstance(estimate, EstimationFailed)
