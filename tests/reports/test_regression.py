"""Verdicts on two measurements: what counts as a change for the worse, and what is chance."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

from reports.regression import files
from reports.regression.checked import CHECKED
from reports.regression.verdicts import KEY, LEVEL, MAX_RUNS, MIN_RUNS, Pairs, compare

Array = np.ndarray
RUNS = 12
DIRECTIONS = {"rms": "lower", "bias": "zero", "nees": "one", "converged": "higher", "failed": "lower", "fn": "lower"}
UNITS = {"rms": "m", "bias": "m"}


def table(values: dict[str, Array], estimator: str = "e", config: str = "0", scene: str = "s") -> pd.DataFrame:
    """Metrics "quantity axis statistic" with one value per run."""
    rows = []
    for metric, per_run in values.items():
        quantity, axis, statistic = metric.split()
        key = dict(zip(KEY, (scene, config, estimator, quantity, axis, statistic), strict=True))
        labels = key | {"unit": UNITS.get(statistic, "1"), "direction": DIRECTIONS[statistic]}
        rows.append(labels | {str(r): float(v) for r, v in enumerate(per_run)})
    return pd.DataFrame(rows)


def verdict(metric: str, old: Any, new: Any) -> tuple[str, str]:
    """Verdict and reason on one metric, a bias beside an RMS that did not change."""
    rms = {"position z rms": np.full(RUNS, 1.0)} if metric == "position z bias" else {}
    result = compare(table({metric: old, **rms}), table({metric: new, **rms}))
    row = result[result[KEY[3:]].agg(" ".join, axis=1) == metric].iloc[0]
    return row["verdict"], row["reason"]


@pytest.fixture
def noise() -> Array:
    """What the runs have in common, whichever code measures them."""
    return np.random.default_rng(3).normal(size=RUNS)


@pytest.mark.parametrize(
    ("metric", "old", "shift", "expected"),
    [
        ("position z rms", 1.0, 0.1, "worse"),
        ("position z rms", 1.0, -0.1, "better"),
        ("position z rms", 1.0, 0.01, "same"),  # less than 2 %
        ("position z bias", 0.0, 0.2, "worse"),
        ("position z bias", 0.0, -0.2, "worse"),
        ("position z bias", -0.3, 0.2, "better"),
        ("position z bias", -0.3, -0.2, "worse"),
        ("position z bias", -0.3, 0.6, "same"),  # as far on the other side
        ("position z bias", 0.0, 0.05, "same"),  # a twentieth of the RMS
        ("pose all nees", 1.0, 0.2, "worse"),
        ("pose all nees", 1.0, -0.2, "worse"),
        ("pose all nees", 3.0, -0.2, "better"),
        ("pose all nees", 1.0, 0.04, "same"),
        ("outlier all fn", 0.5, 0.3, "worse"),
    ],
)
def test_a_consistent_change_is_judged_by_direction_and_size(
    noise: Array, metric: str, old: float, shift: float, expected: str
) -> None:
    before = old + 0.05 * (noise - noise.mean())
    assert verdict(metric, before, before + shift)[0] == expected


def test_the_same_numbers_are_the_same(noise: Array) -> None:
    values = {" ".join(metric): np.abs(noise) for metric in CHECKED if metric[2] in DIRECTIONS}
    rounding = {k: v * (1 + 1e-6 * np.sign(noise)) for k, v in values.items()}
    assert set(compare(table(values), table(rounding))["verdict"]) == {"same"}


def test_a_change_of_few_runs_is_chance(noise: Array) -> None:
    old = np.full(RUNS, 1.0)
    new = old.copy()
    new[3] = 2.0
    assert verdict("position z rms", old, new) == ("same", "")
    assert verdict("position z rms", old, old * (1 + 0.1 * noise)) == ("same", "")


def test_chance_alone_hardly_ever_fails_a_battery() -> None:
    """500 batteries of 40 metrics, both measurements from one law with heavy tails: about 5 false alarms at 1 %."""
    rng = np.random.default_rng(1)
    statistic, direction = np.full(40, "rms"), np.full(40, "lower")
    alarms = 0
    for _ in range(500):
        shared = rng.normal(size=10)  # hangs the metrics together
        old, new = (np.exp(0.3 * rng.standard_t(4, (40, 10)) + shared) for _ in range(2))
        pairs = Pairs(statistic, direction, old, new)
        alarms += bool((pairs.chance(0.02 * pairs.scale) <= LEVEL).any())
    assert 0 < alarms <= 13  # 99.9 % of a binomial law with 500 draws of 1 %


def test_a_change_is_found_among_many_that_are_none() -> None:
    rng = np.random.default_rng(2)
    metrics = {f"position z{i} rms": np.exp(0.3 * rng.normal(size=RUNS)) for i in range(300)}
    checked = {("position", f"z{i}", "rms"): CHECKED[("position", "z", "rms")] for i in range(300)}
    changed = {k: v * np.exp(0.1 * rng.normal(size=RUNS)) for k, v in metrics.items()}
    changed["position z7 rms"] = metrics["position z7 rms"] * (1.2 + 0.05 * rng.normal(size=RUNS))
    result = compare(table(metrics), table(changed), checked).set_index("axis")
    assert result.index[result["verdict"] != "same"].tolist() == ["z7"]
    assert result.loc["z7", "p"] <= LEVEL


def test_the_fewest_runs_that_can_be_significant() -> None:
    for runs, expected in ((MIN_RUNS, "worse"), (MIN_RUNS - 1, "same")):
        assert verdict("position z rms", np.ones(runs), np.full(runs, 1.2))[0] == expected
    assert MAX_RUNS >= RUNS


def test_failures_need_no_significance() -> None:
    none, one = np.zeros(RUNS), np.eye(RUNS)[4]
    assert verdict("trajectory all failed", none, one) == ("worse", "must not happen")
    assert verdict("trajectory all failed", one, none) == ("better", "must not happen")
    assert verdict("trajectory all converged", 1 - none, 1 - 0.1 * one) == ("worse", "must not happen")
    assert verdict("trajectory all converged", np.full(RUNS, 0.9166667), np.full(RUNS, 0.91667))[0] == "same"


def test_a_run_without_a_value_is_worse_and_one_more_better() -> None:
    whole = np.ones(RUNS)
    lost = np.where(np.arange(RUNS) == 5, np.nan, 1.0)
    assert verdict("position z rms", whole, lost) == ("worse", "runs without a value")
    assert verdict("position z rms", lost, whole) == ("better", "runs without a value")
    assert verdict("position z rms", lost, lost)[0] == "same"
    assert verdict("position z rms", whole, np.full(RUNS, np.nan)) == ("worse", "runs without a value")
    assert verdict("position z rms", np.full(RUNS, np.nan), np.full(RUNS, np.nan))[0] == "same"


def test_an_estimate_that_comes_apart_in_one_run_is_worse() -> None:
    whole = np.ones(RUNS)
    broken = np.where(np.arange(RUNS) == 5, 12.0, 1.0)
    assert verdict("position z rms", whole, broken) == ("worse", "came apart")
    assert verdict("position z rms", broken, whole) == ("better", "came apart")


def test_new_and_missing() -> None:
    old = pd.concat([table({"position z rms": np.ones(RUNS)}, e) for e in ("kept", "gone")])
    old = pd.concat([old, table({"speed all rms": np.ones(RUNS)}, "kept")])
    new = pd.concat([table({"position z rms": np.ones(RUNS)}, e) for e in ("kept", "added")])
    verdicts = compare(old, new).set_index(["estimator", "quantity"])["verdict"].to_dict()
    assert verdicts == {
        ("kept", "position"): "same",
        ("kept", "speed"): "worse",  # still measured, and gave nothing
        ("added", "position"): "new",
        ("gone", "position"): "missing",
    }


def test_a_baseline_of_another_scene_or_option_is_none() -> None:
    old, new = (table({"position z rms": np.full(RUNS, v)}, config=c) for v, c in ((1.0, "a"), (5.0, "b")))
    assert sorted(compare(old, new)["verdict"]) == ["missing", "new"]


def test_a_metric_that_is_no_longer_checked_is_missing() -> None:
    old = table({"position z rms": np.ones(RUNS), "position q rms": np.ones(RUNS)})
    assert compare(old, table({"position z rms": np.ones(RUNS)}))["verdict"].tolist() == ["same", "missing"]


def test_without_baselines_all_is_new(tmp_path: Path) -> None:
    result = compare(files.read_baselines(tmp_path), table({"position z rms": np.ones(RUNS)}))
    assert result["verdict"].tolist() == ["new"]
    assert result["new"].tolist() == [1.0]


def test_rms_is_pooled_by_squares_and_the_rest_averaged() -> None:
    old = table({"position z rms": np.arange(RUNS), "position z bias": np.arange(RUNS)})
    result = compare(old, old).set_index("statistic")
    assert result.loc["rms", "old"] == pytest.approx(np.sqrt(np.mean(np.arange(RUNS) ** 2)))
    assert result.loc["bias", "new"] == pytest.approx(np.arange(RUNS).mean())
    assert result.loc["bias", "smallest"] == pytest.approx(0.1 * result.loc["rms", "old"])


def test_baselines_are_read_as_they_were_written(tmp_path: Path, noise: Array) -> None:
    two = [table({"position z rms": np.abs(noise), "pose all nees": 1 + noise}, scene=s, config="12e4") for s in "ab"]
    whole = pd.concat(two, ignore_index=True)
    whole.loc[1, "3"] = np.nan
    files.write_baselines(tmp_path, whole)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.csv", "b.csv"]
    assert len((tmp_path / "a.csv").read_text().splitlines()) == 3
    pd.testing.assert_frame_equal(files.read_baselines(tmp_path)[whole.columns], whole, rtol=1e-4)
    assert set(compare(files.read_baselines(tmp_path), whole)["verdict"]) == {"same"}
    files.write_baselines(tmp_path, two[1])
    assert [p.name for p in tmp_path.iterdir()] == ["b.csv"]


@pytest.mark.parametrize(
    "text", ["", "a,b\n1,2\n", "config,estimator,quantity,axis,statistic,unit,direction,0\n,,,,,,,x\n"]
)
def test_what_is_no_baseline_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "oncoming.csv").write_text(text)
    with pytest.raises(ValueError, match=r"oncoming\.csv: is no baseline"):
        files.read_baselines(tmp_path)


def test_json_and_junit_hold_every_verdict(tmp_path: Path) -> None:
    old = table({"position z rms": np.ones(RUNS), "speed all rms": np.ones(RUNS), "pose all nees": np.ones(RUNS)})
    new = table({"position z rms": np.full(RUNS, 1.5), "speed all rms": np.ones(RUNS), "shape all rms": np.ones(RUNS)})
    verdicts = compare(old, pd.concat([new, table({"speed all rms": np.ones(RUNS)}, scene="t")]))
    files.write_json(tmp_path / "v.json", verdicts, {"git_commit": "x"})
    stored = json.loads((tmp_path / "v.json").read_text(), parse_constant=lambda c: pytest.fail(c))
    assert stored["counts"] == {"worse": 2, "better": 0, "new": 2, "missing": 0, "same": 1}
    assert stored["git_commit"] == "x"
    assert len(stored["verdicts"]) == 5
    files.write_junit(tmp_path / "j.xml", verdicts)
    root = ElementTree.parse(tmp_path / "j.xml").getroot()
    suites = {s.get("name"): s for s in root}
    assert {k: (s.get("tests"), s.get("failures"), s.get("skipped")) for k, s in suites.items()} == {
        "s": ("4", "2", "1"),
        "t": ("1", "0", "1"),
    }
    failures = {case.get("name"): case.find("failure") for case in suites["s"]}
    message = failures["position z rms"].get("message")
    assert message.startswith("position z rms: 1 -> 1.5 m, 0.5 worse (0.0255 matters), chance 0.00049")
    assert failures["pose nees"].get("message").endswith("runs without a value")
    assert failures["speed rms"] is None
