"""The paired comparison finds what separate intervals do not, and invents nothing."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.stats import ttest_rel

from reports.paired import Paired, paired

RUNS, TIMES = 60, 5


def table(errors: dict[str, np.ndarray]) -> pd.DataFrame:
    """Depth errors (runs, times) of two estimators as error rows, with a bound of one."""
    parts = []
    for label, e in errors.items():
        run, k = np.meshgrid(np.arange(e.shape[0]), np.arange(e.shape[1]), indexing="ij")
        rows = pd.DataFrame({"run": run.ravel(), "t_s": 0.04 * k.ravel(), "error": e.ravel(), "bound": 1.0})
        parts.append(rows.assign(estimator=label, quantity="position", entity="target", axis="z"))
    return pd.concat(parts, ignore_index=True)


def compare(rows: pd.DataFrame, statistic: str = "rms") -> Paired:
    return paired(rows, "a", "b", quantity="position", axis="z", statistic=statistic, entity="target")


@pytest.fixture
def shared() -> np.ndarray:
    """What both estimators suffer from: an offset of every run."""
    return np.random.default_rng(3).normal(0, 1.0, (RUNS, 1)) + np.zeros((RUNS, TIMES))


def test_a_small_difference_beneath_large_common_errors(shared: np.ndarray) -> None:
    rng = np.random.default_rng(4)
    found = compare(table({"a": 1.05 * shared + 0.01 * rng.normal(size=shared.shape), "b": shared}))
    assert found.difference == pytest.approx(0.05 * found.second, rel=0.2)
    assert 0 < found.ci_low < found.difference < found.ci_high
    assert found.p == 1 / 10_000
    assert found.runs == RUNS


def test_the_same_estimator_twice(shared: np.ndarray) -> None:
    for statistic in ("bias", "std", "rms", "p95", "max", "efficiency"):
        found = compare(table({"a": shared, "b": shared}), statistic)
        assert (found.difference, found.ci_low, found.ci_high, found.p) == (0, 0, 0, 1)


def test_p_is_honest() -> None:
    """Equally good estimators are told apart in 5 % of the cases at the level of 5 %: 10 of 200, sigma 3."""
    rng = np.random.default_rng(5)
    below, covered = 0, 0
    for _ in range(200):
        both = rng.normal(size=(20, 1)) + rng.normal(size=(2, 20, TIMES))
        found = compare(table({"a": both[0], "b": both[1]}))
        below += found.p < 0.05
        covered += found.ci_low <= 0 <= found.ci_high
    assert 1 <= below <= 19
    assert covered >= 176  # a percentile interval of 20 runs covers a little less than 95 %: 190 - 4.5 sigma


def test_p_of_a_difference_of_biases_is_that_of_the_t_test(shared: np.ndarray) -> None:
    rng = np.random.default_rng(6)
    a, b = 5 + shared + 0.3 * rng.normal(size=shared.shape), 5.03 + shared + 0.3 * rng.normal(size=shared.shape)
    found = compare(table({"a": a, "b": b}), "bias")
    expected = ttest_rel(a.mean(axis=1), b.mean(axis=1))
    assert found.p == pytest.approx(expected.pvalue, abs=0.02)
    assert found.difference == pytest.approx(a.mean() - b.mean())


def test_only_common_rows_are_compared(shared: np.ndarray) -> None:
    rows = table({"a": shared, "b": shared})
    gone = (rows["estimator"] == "b") & (rows["run"] == 0) & (rows["t_s"] > 0.1)
    found = compare(rows[~gone])
    assert found.unpaired == gone.sum() == 2
    assert found.difference == 0


def test_wrong_calls(shared: np.ndarray) -> None:
    rows = table({"a": shared, "b": shared})
    with pytest.raises(ValueError, match="rmse"):
        compare(rows, "rmse")
    with pytest.raises(ValueError, match="0 runs"):
        compare(rows[rows["estimator"] == "a"])
    with pytest.raises(ValueError, match="1 runs"):
        compare(rows[rows["run"] == 7])
