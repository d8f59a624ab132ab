"""What an estimator could not do is counted by its reason, so that a failure cannot improve an average."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from estimators.estimate import EstimationFailed, TrajectoryEstimate
from estimators.stereo.sliding_window import SlidingWindowAdjustment
from reports.evaluation import evaluate
from reports.metrics import metrics_table
from sim.observations import Observations


def part(o: Observations, rows: np.ndarray) -> Observations:
    return replace(o, tracks=o.tracks.select(rows))


def failures(table: pd.DataFrame) -> dict[str, float]:
    rows = table[table["quantity"] == "failure"]
    assert (rows["direction"] == "lower").all()
    return dict(zip(rows["entity"], rows["value"], strict=True))


def test_windows_that_fail_are_counted_by_reason(world: Any, keys: dict[str, Any]) -> None:
    """Two frames have two tracks left, three have none."""
    tracks = world.tracks
    poor, empty = np.isin(tracks.frame, [10, 20]), np.isin(tracks.frame, [30, 31, 32])
    estimate = SlidingWindowAdjustment()(part(world.observations, ~empty & (~poor | (tracks.track < 2))))
    assert isinstance(estimate, TrajectoryEstimate)
    table = metrics_table([evaluate(world.truth, tracks, estimate, **keys)])
    assert failures(table) == {
        "the newest frame shares fewer than three tracks with the window": 2.0,
        "the newest frame has no observation": 3.0,
    }
    total = table[(table["quantity"] == "trajectory") & (table["statistic"] == "failed")].iloc[0]
    assert (total["value"], total["n"]) == (5.0, 38)
    converged = table[table["statistic"] == "converged"].iloc[0]
    # 40 wanted frames; the first two have no window yet.
    assert converged["value"] == (40 - 2 - 5) / 40


def test_a_trajectory_that_fails_altogether_has_its_row(world: Any, keys: dict[str, Any]) -> None:
    estimate = SlidingWindowAdjustment()(part(world.observations, world.tracks.track < 2))
    assert isinstance(estimate, EstimationFailed)
    table = metrics_table([evaluate(world.truth, world.tracks, estimate, **keys)])
    assert failures(table) == {estimate.reason: 1.0}
    assert table.loc[table["statistic"] == "converged", "value"].tolist() == [0.0]
    assert not table["quantity"].isin(["position", "velocity"]).any()


def test_runs_that_fail_are_counted_beside_those_that_do_not(world: Any, keys: dict[str, Any]) -> None:
    line = world.tracks.track < 2
    good, bad = SlidingWindowAdjustment()(world.observations), SlidingWindowAdjustment()(part(world.observations, line))
    runs = [evaluate(world.truth, world.tracks, e, **(keys | {"run": k})) for k, e in enumerate([good, bad, bad])]
    table = metrics_table(runs)
    assert isinstance(bad, EstimationFailed)
    assert failures(table) == {bad.reason: 2.0}
    assert (table["runs"] == 3).all()
