"""What every registered estimator must do, whatever its method."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimators import ESTIMATORS, registry
from estimators.estimate import EstimationFailed, TrajectoryEstimate, describe
from sim.observations import Observations
from sim.pose import Pose, exp_so3

Array = np.ndarray
Maker = Callable[..., Any]


def digest(value: Any) -> str:
    """All bits of all arrays of a result but its run time."""
    sha = hashlib.sha256()

    def visit(v: Any) -> None:
        if isinstance(v, np.ndarray):
            sha.update(v.tobytes())
        elif isinstance(v, (list, tuple)):
            for item in v:
                visit(item)
        elif hasattr(v, "__dataclass_fields__"):
            for name in v.__dataclass_fields__:
                if name != "runtime_s":
                    visit(getattr(v, name))
        else:
            sha.update(repr(v).encode())

    visit(value)
    return sha.hexdigest()


@pytest.fixture(params=sorted(registry()))
def estimator(request: pytest.FixtureRequest) -> Any:
    return registry()[request.param]()


@pytest.fixture(scope="module")
def observations(make_scene: Maker) -> Observations:
    """Twelve frames, one empty, one with a single track; the ego car moves."""
    scene = make_scene(points=30, frames=12, distance_m=15.0)
    keep = np.ones((12, 30), bool)
    keep[4], keep[8, 1:] = False, False
    T_wc = Pose(exp_so3(np.multiply.outer(scene.t_s, [0.1, 0.2, 0.3])), np.multiply.outer(scene.t_s, [0.0, 3.0, 0.0]))
    o: Observations = scene.observe(0.1, keep=keep, T_wc=T_wc)
    return o


def test_it_is_deterministic_and_touches_nothing(estimator: Any, observations: Observations) -> None:
    before = digest(observations)
    first, second = estimator(observations), estimator(observations)
    assert isinstance(first, TrajectoryEstimate)
    assert digest(first) == digest(second)
    assert digest(observations) == before
    assert first.runtime_s > 0


def test_frames_without_tracks_are_survived(estimator: Any, observations: Observations) -> None:
    result = estimator(observations)
    assert isinstance(result, TrajectoryEstimate)
    newest = [int(w.frames[-1]) for w in result.windows]
    assert newest == sorted(set(newest))
    assert 4 not in newest
    assert newest[-1] == 11
    assert not set(newest) & {f.frame for f in result.failures}
    np.testing.assert_array_equal(result.interpretation.frame, newest)


def test_all_it_says_is_finite_and_its_covariances_are_positive(estimator: Any, observations: Observations) -> None:
    result = estimator(observations)
    assert isinstance(result, TrajectoryEstimate)
    for w in result.windows:
        for a in (w.T_co.R, w.T_co.t, w.X_o, w.cov):
            assert np.isfinite(a).all()
        np.testing.assert_allclose(
            w.T_co.R @ np.swapaxes(w.T_co.R, 1, 2), np.broadcast_to(np.eye(3), w.T_co.R.shape), atol=1e-9
        )
        assert np.linalg.eigvalsh(w.cov)[0] > 0
        assert (np.diff(w.frames) > 0).all()
        assert (np.diff(w.track) > 0).all()
        assert len(w.track) == len(w.X_o)


@pytest.mark.parametrize("case", ["no rows", "one frame", "two tracks", "no frames"])
def test_failure_is_a_value(estimator: Any, observations: Observations, case: str) -> None:
    tracks = observations.tracks
    rows = {
        "no rows": np.zeros(len(tracks), bool),
        "one frame": tracks.frame == 2,
        "two tracks": tracks.track < 2,
        "no frames": np.zeros(len(tracks), bool),
    }[case]
    poor = replace(observations, tracks=tracks.select(rows))
    if case == "no frames":
        poor = replace(poor, t_s=np.empty(0), T_wc=None)
    result = estimator(poor)
    assert isinstance(result, EstimationFailed)
    assert result.reason
    assert all(result.hints)


def test_nan_is_refused_before_it_gets_there(observations: Observations) -> None:
    uv = observations.tracks.uv_left.copy()
    uv[5] = np.nan
    with pytest.raises(ValueError, match=r"Tracks\.uv_left: not finite in row 5"):
        replace(observations.tracks, uv_left=uv)


def test_results_return_from_disk(estimator: Any, observations: Observations, tmp_path: Path) -> None:
    result = estimator(observations)
    assert isinstance(result, TrajectoryEstimate)
    result.save(tmp_path / "estimate")
    loaded = TrajectoryEstimate.load(tmp_path / "estimate")
    assert digest(loaded) == digest(result)
    assert loaded.runtime_s == result.runtime_s
    assert loaded.failures == result.failures or [vars(f) for f in loaded.failures] == [
        vars(f) for f in result.failures
    ]


def test_results_without_ego_poses_return_from_disk(estimator: Any, observations: Observations, tmp_path: Path) -> None:
    result = estimator(replace(observations, T_wc=None))
    assert isinstance(result, TrajectoryEstimate)
    result.save(tmp_path)
    assert TrajectoryEstimate.load(tmp_path).T_wc is None


def test_estimators_describe_themselves_and_are_their_configuration(estimator: Any) -> None:
    assert describe(estimator).endswith(".")
    assert type(estimator)() == estimator
    with pytest.raises(AttributeError):
        estimator.anything = 1


def test_plug_ins_cannot_replace_built_in_ones() -> None:
    assert registry().items() >= ESTIMATORS.items()


def test_order_of_tracks_ids_does_not_matter(estimator: Any, observations: Observations) -> None:
    """Identifiers are names: larger ones in the same order change nothing."""
    renamed = replace(observations, tracks=replace(observations.tracks, track=1000 + 7 * observations.tracks.track))
    a, b = estimator(observations), estimator(renamed)
    assert isinstance(a, TrajectoryEstimate)
    assert isinstance(b, TrajectoryEstimate)
    np.testing.assert_array_equal(a.windows[-1].X_o, b.windows[-1].X_o)
    np.testing.assert_array_equal(1000 + 7 * a.windows[-1].track, b.windows[-1].track)
