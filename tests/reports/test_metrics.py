"""Pooling, intervals and the exact columns of metrics.csv."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.estimate import EstimationFailed, Failure
from reports.bootstrap import block_indices, interval
from reports.evaluation import evaluate
from reports.metrics import METRIC_COLUMNS, Stack, metrics_table
from reports.statistics import STATISTICS
from sim.pose import Pose

CONTRACT = (
    "scenario,seed,runs,estimator,quantity,axis,statistic,value,unit,direction,n,ci_low,ci_high,reference,source,entity,"
    "bin,point"
)


def number(table, quantity, axis, statistic, entity="target", bin_name=""):
    rows = table[
        (table["quantity"] == quantity)
        & (table["axis"] == axis)
        & (table["statistic"] == statistic)
        & (table["entity"] == entity)
        & (table["bin"] == bin_name)
    ]
    assert len(rows) == 1
    return rows.iloc[0]


@pytest.fixture(scope="module")
def shifted_table(world):
    estimate = world.moved(Pose(np.eye(3), np.array([0.3, 0.0, 0.4])))
    evaluation = evaluate(world.truth, world.tracks, estimate, scenario="box", seed=1, run=0, estimator="known")
    return metrics_table([evaluation], {"simulate": 1.5})


def test_columns_are_those_of_the_contract(shifted_table):
    assert ",".join(shifted_table.columns) == CONTRACT == ",".join(METRIC_COLUMNS)
    assert set(shifted_table["direction"]) <= {"lower", "higher", "zero", "one"}
    assert np.isfinite(shifted_table["value"]).all()
    key = ["estimator", "quantity", "axis", "statistic", "entity", "bin"]
    assert not shifted_table.duplicated(key).any()


def test_a_constant_offset(shifted_table):
    assert number(shifted_table, "position", "z", "bias")["value"] == pytest.approx(0.4)
    assert number(shifted_table, "position", "all", "bias")["value"] == pytest.approx(0.5)
    assert number(shifted_table, "position", "all", "rms")["value"] == pytest.approx(0.5)
    assert number(shifted_table, "position", "all", "max")["value"] == pytest.approx(0.5)
    assert number(shifted_table, "position", "z", "std")["value"] == pytest.approx(0.0, abs=1e-9)
    assert number(shifted_table, "position", "z", "bias", bin_name="30-40 m")["value"] == pytest.approx(0.4)
    crb, row = number(shifted_table, "position", "z", "crb"), number(shifted_table, "position", "z", "efficiency")
    assert row["value"] == pytest.approx(crb["value"] / 0.4)
    assert number(shifted_table, "speed", "all", "rms")["reference"] == "relative"
    # 38 of 40 frames: the first window needs three
    assert number(shifted_table, "trajectory", "all", "converged", entity="")["value"] == pytest.approx(38 / 40)
    assert number(shifted_table, "trajectory", "all", "failed", entity="")["value"] == 0
    assert number(shifted_table, "runtime", "all", "sum", entity="simulate")["value"] == 1.5
    assert number(shifted_table, "position", "z", "rms", entity="smoothed")["n"] == 40


def test_failures_are_counted(world, build_world, keys):
    w = build_world(failures=(Failure(12, "singular"), Failure(13, "singular")))
    table = metrics_table([evaluate(w.truth, w.tracks, w.estimate, **keys)])
    assert number(table, "trajectory", "all", "failed", entity="")["value"] == 2
    assert number(table, "failure", "all", "failed", entity="singular")["value"] == 2
    assert number(table, "trajectory", "all", "converged", entity="")["value"] == pytest.approx(36 / 40)
    whole = metrics_table([evaluate(world.truth, world.tracks, EstimationFailed("none"), **keys)])
    assert number(whole, "trajectory", "all", "converged", entity="")["value"] == 0
    assert number(whole, "trajectory", "all", "failed", entity="")["value"] == 1


def test_runs_are_pooled_by_squares(world, keys):
    runs = [
        evaluate(world.truth, world.tracks, world.moved(Pose(np.eye(3), np.array([0, 0, dz]))), **(keys | {"run": run}))
        for run, dz in enumerate([0.1, 0.3])
    ]
    table = metrics_table(runs)
    rms = number(table, "position", "z", "rms")
    assert rms["value"] == pytest.approx(np.sqrt((0.01 + 0.09) / 2))
    assert rms["runs"] == 2


def test_intervals_over_runs_keep_what_a_run_shares(world, keys):
    """Every run has an offset of its own: the interval of the bias is that of 40 offsets, not of their 1520 windows."""
    offsets = np.random.default_rng(1).normal(0.5, 0.1, 40)
    one = evaluate(world.truth, world.tracks, world.estimate, **keys)
    runs = [
        replace(one, run=run, comparison=one.comparison.assign(run=run, error=one.comparison["error"] + dz))
        for run, dz in enumerate(offsets)
    ]
    row = number(metrics_table(runs), "position", "z", "bias")
    half = 1.96 * offsets.std() / np.sqrt(40)
    # 5 % for 999 replicates, and the quantile of 40 values that are hardly normal
    assert row["ci_high"] - row["ci_low"] == pytest.approx(2 * half, rel=0.1)
    assert row["ci_low"] < offsets.mean() < row["ci_high"]


def test_sums_say_what_the_rows_do():
    """Pooling runs by their sums is pooling their rows, whatever the bias."""
    rng = np.random.default_rng(2)
    values = np.concatenate([1e4 + rng.normal(size=(60, 3)), np.ones((60, 3))], axis=1)
    stack = Stack(np.repeat(np.arange(5), 12), values)
    for name, statistic in STATISTICS.items():
        if statistic.sums is not None:
            pooled = statistic.finish(stack.per_run(statistic).sum(axis=0))
            assert pooled == pytest.approx(statistic.pool(values), rel=1e-12), name
    assert STATISTICS["std"].pool(values) == pytest.approx(np.sqrt(np.trace(np.cov(values[:, :3].T))), rel=1e-9)


def test_vector_statistics_against_numpy():
    rng = np.random.default_rng(0)
    e = rng.normal(size=(50, 3))
    values = np.concatenate([e, 0.5 * np.ones((50, 3))], axis=1)
    length = np.linalg.norm(e, axis=1)
    expected = {
        "bias": np.linalg.norm(e.mean(axis=0)),
        "std": np.sqrt(np.trace(np.cov(e.T))),
        "rms": np.sqrt(np.mean(length**2)),
        "p95": np.quantile(length, 0.95),
        "max": length.max(),
        "crb": np.sqrt(0.75),
        "efficiency": np.sqrt(0.75 / np.mean(length**2)),
    }
    for name, value in expected.items():
        assert STATISTICS[name].pool(values) == pytest.approx(value)


def test_blocks_keep_neighbours_together():
    rows = block_indices(20, 5, 100, np.random.default_rng(0))
    assert rows.shape == (100, 20)
    steps = np.diff(rows, axis=1) % 20
    assert np.all(steps[:, np.arange(19) % 5 != 4] == 1)


@pytest.mark.parametrize(("block", "low", "high"), [(10, 0.85, 0.99), (1, 0.2, 0.7)])
def test_interval_covers_the_mean_of_correlated_errors(block, low, high):
    """Moving averages over 10 values: blocks of that length cover about nine times in ten, single values far less."""
    rng = np.random.default_rng(4)
    covered = 0
    for _ in range(100):
        series = np.convolve(rng.normal(size=209), np.ones(10) / 10, "valid")[:, None]
        a, b = interval(lambda v: v[..., 0].mean(axis=-1), series, block, rng)
        covered += a < 0 < b
    assert low < covered / 100 < high


def test_no_interval_from_too_little_data():
    assert np.isnan(interval(lambda v: v[..., 0].mean(axis=-1), np.zeros((15, 1)), 10, np.random.default_rng(0))).all()
