"""What cannot be estimated ends as a value with a reason and a hint, whatever the options, and is counted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators.estimate import EstimationFailed, TrajectoryEstimate
from estimators.stereo.outliers import DETECTORS
from estimators.stereo.sliding_window import SlidingWindowAdjustment
from sim.observations import Observations, Tracks

Array = np.ndarray
Maker = Callable[..., Any]
POINTS, FRAMES = 12, 4
noise = pytest.mark.parametrize("sigma_px", [0.0, 0.2])
space = pytest.mark.parametrize("space", ["object", "image"])
outliers = pytest.mark.parametrize("outliers", ["none", *DETECTORS])


def on_a_line(scene: Any) -> Any:
    return replace(scene, X=np.multiply.outer(np.linspace(-1, 1, len(scene.X)), [0.4, 0.1, 2.0]))


def without_overlap(frames: int, points: int) -> Array:
    """Every frame has tracks of its own."""
    return np.asarray(np.arange(points) * frames // points == np.arange(frames)[:, None])


def wild(o: Observations, seed: int = 0) -> Observations:
    """Every track is somewhere else in every frame."""
    rng = np.random.default_rng(seed)
    tracks = o.tracks
    left = rng.uniform([0, 0], [1023, 767], tracks.uv_left.shape)
    right = left + rng.normal(0, 2, left.shape) - np.column_stack([rng.uniform(2, 40, len(left)), np.zeros(len(left))])
    return replace(o, tracks=replace(tracks, uv_left=left, uv_right=right))


def with_covariance(o: Observations, scale: float) -> Observations:
    return replace(o, tracks=replace(o.tracks, cov=scale * o.tracks.cov))


def cases(make_scene: Maker, sigma_px: float) -> dict[str, Observations]:
    scene = make_scene(points=POINTS, frames=FRAMES)
    return {
        "collinear": on_a_line(scene).observe(sigma_px),
        "coincident": replace(scene, X=np.zeros((POINTS, 3))).observe(sigma_px),
        "two tracks": make_scene(points=2, frames=FRAMES).observe(sigma_px),
        "one frame": make_scene(points=POINTS, frames=1).observe(sigma_px),
        "no overlap": scene.observe(sigma_px, keep=without_overlap(FRAMES, POINTS)),
        "no tracks": scene.observe(sigma_px, keep=np.zeros((FRAMES, POINTS), bool)),
    }


REASONS = {
    "collinear": "collinear|no convergence|no three tracks are confirmed|outlier detection leaves",
    "coincident": "collinear|no convergence|no three tracks are confirmed|outlier detection leaves|not determined",
    "two tracks": "no window has enough|fewer than three tracks",
    "one frame": "no window has enough",
    "no overlap": "fewer than three tracks",
    "no tracks": "no window has enough",
}
AGREEMENT = {
    "ransac": "no three tracks are confirmed by another",
    "robust": "no group of tracks moves as one rigid body",
}


@noise
@space
@outliers
@pytest.mark.parametrize("case", REASONS)
def test_what_is_not_determined_fails(make_scene: Maker, case: str, sigma_px: float, space: Any, outliers: Any) -> None:
    result = SlidingWindowAdjustment(space=space, outliers=outliers)(cases(make_scene, sigma_px)[case])
    assert isinstance(result, EstimationFailed), result
    assert any(part in result.reason for part in REASONS[case].split("|")), result.reason
    assert result.hints


@noise
@space
@outliers
def test_three_tracks_are_enough(make_scene: Maker, sigma_px: float, space: Any, outliers: Any) -> None:
    """They determine the motion; two detectors ask for others that agree."""
    scene = make_scene(points=3, frames=6, distance_m=15.0)
    result = SlidingWindowAdjustment(space=space, outliers=outliers)(scene.observe(sigma_px))
    if outliers in AGREEMENT:
        assert isinstance(result, EstimationFailed)
        assert result.reason == AGREEMENT[outliers]
        return
    assert isinstance(result, TrajectoryEstimate), result
    assert not result.failures
    w = result.windows[-1]
    points = w.T_co[-1].apply(w.X_o)
    sigma = np.sqrt(np.diag(w.cov)[:3])
    error = points.mean(axis=0) - scene.points_c()[-1].mean(axis=0)
    # 5 sigma; without noise the second-order correction of a bias that is not there remains.
    assert (np.abs(error) < (5 * sigma if sigma_px else 0.1 * sigma)).all()


@space
@outliers
@pytest.mark.parametrize("seed", range(3))
def test_outliers_alone_are_no_motion(make_scene: Maker, seed: int, space: Any, outliers: Any) -> None:
    """No exception; and what is called a motion says itself that it is none, or is one of a few tracks."""
    result = SlidingWindowAdjustment(space=space, outliers=outliers)(
        wild(make_scene(points=30, frames=FRAMES).observe(), seed)
    )
    if isinstance(result, EstimationFailed):
        assert result.reason
        assert result.hints
    else:
        assert all(w.sigma_0 > 3 or len(w.track) < 10 for w in result.windows)


@pytest.mark.parametrize("value", [np.nan, 0.0, -1.0, -np.inf])
def test_a_covariance_that_is_none_is_refused_where_it_comes_in(scene: Any, value: float) -> None:
    """The only way to an estimator leads through `Tracks`: not a number, zero, negative."""
    tracks = scene.observe(0.2).tracks
    cov = tracks.cov.copy()
    cov[7, 0, 0] = value
    with pytest.raises(ValueError, match=r"Tracks\.cov: not (finite|positive definite) in row 7 "):
        Tracks(tracks.frame, tracks.track, tracks.uv_left, tracks.uv_right, cov)


@space
@pytest.mark.parametrize("scale", [1e-300, 1e-30, 1e30, 1e150, 1e300])
def test_the_largest_and_the_smallest_covariances_are_no_exception(scene: Any, scale: float, space: Any) -> None:
    result = SlidingWindowAdjustment(space=space)(with_covariance(scene.observe(0.2), scale))
    if isinstance(result, EstimationFailed):
        assert result.reason
        assert result.hints
    else:
        assert all(np.isfinite(w.cov).all() and np.isfinite(w.T_co.t).all() for w in result.windows)


def test_lines_in_some_windows_fail_there(make_scene: Maker) -> None:
    """A line of tracks at first, a body later on; its tracks count from their second frame."""
    scene = make_scene(points=40, frames=12)
    line = np.arange(40) < 20
    X = scene.X.copy()
    X[line] = np.multiply.outer(np.linspace(-1, 1, 20), [0.4, 0.1, 2.0])
    keep = np.ones((12, 40), bool)
    keep[:6, ~line] = False
    result = SlidingWindowAdjustment(window=4)(replace(scene, X=X).observe(0.2, keep=keep))
    assert isinstance(result, TrajectoryEstimate)
    failed = {f.frame: f for f in result.failures}
    assert set(failed) == {2, 3, 4, 5, 6}
    assert all("collinear" in f.reason or "no convergence" in f.reason for f in failed.values())
    assert all(f.hints for f in failed.values())
    assert {int(w.frames[-1]) for w in result.windows} == {7, 8, 9, 10, 11}


def infinite(o: Observations, rows: Array) -> Observations:
    cov = np.array(o.tracks.cov)
    cov[rows] = np.diag([np.inf, np.inf, np.inf, np.inf])
    return replace(o, tracks=replace(o.tracks, cov=cov))


@space
@outliers
def test_infinite_covariance_is_no_information(make_scene: Maker, space: Any, outliers: Any) -> None:
    o = make_scene(points=POINTS, frames=FRAMES).observe(0.2)
    estimator = SlidingWindowAdjustment(space=space, outliers=outliers)
    nothing = estimator(infinite(o, np.arange(len(o.tracks))))
    assert isinstance(nothing, EstimationFailed)
    assert nothing.reason == "no observation has a finite covariance"
    assert nothing.hints
    some = o.tracks.track == 3
    with_some, without = estimator(infinite(o, some)), estimator(replace(o, tracks=o.tracks.select(~some)))
    assert type(with_some) is type(without)
    if isinstance(with_some, TrajectoryEstimate) and isinstance(without, TrajectoryEstimate):
        np.testing.assert_array_equal(with_some.windows[-1].X_o, without.windows[-1].X_o)
