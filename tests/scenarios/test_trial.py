"""One trial: the same rows in any process and any order, every estimator on the same observations, failures kept."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from reports.evaluation import evaluate
from scenarios import spec
from scenarios.trial import COLUMNS, TABLES, TrialResult, failed, joined, trial
from sim.simulate import simulate

QUICK = ("render.enabled=false", "world.roadside=false", "rig.frames=6", "vehicle.0.motion.start_m=[-3.5, 30.0]")
TWO = "estimator=[{name='sliding_window_adjustment',label='a'},{name='sliding_window_adjustment',label='b',window=4}]"
NOISE = "outliers=[{kind='noise', tracks=0.2}]"


def same(a: TrialResult, b: TrialResult) -> None:
    """All tables but the run times are equal, bit by bit."""
    for name in TABLES[:-1]:
        pd.testing.assert_frame_equal(getattr(a, name), getattr(b, name), check_exact=True)


@pytest.fixture(scope="module")
def scenario() -> Any:
    return spec.read("oncoming", [*QUICK, TWO, NOISE])


def test_the_tables_have_their_columns_whatever_they_hold(scenario: Any) -> None:
    for result in (trial(scenario, 0), failed(3, "reason", "trace")):
        for name in TABLES:
            table = getattr(result, name)
            assert table.dtypes.astype(str).to_dict() == COLUMNS[name]
    assert joined([trial(scenario, 0), failed(3, "r", "t")]).failures["run"].max() == 3


def test_rows_are_those_of_the_evaluation(scenario: Any) -> None:
    observations, truth = simulate(scenario, 2)
    result = trial(scenario, 2, keep=("position", "speed"))
    for estimator in scenario.estimator:
        names: dict[str, Any] = {"scenario": "x", "seed": 1, "run": 2, "estimator": estimator.title}
        expected = evaluate(truth, observations.tracks, estimator.build()(observations), **names)
        kept = expected.comparison[expected.comparison["quantity"].isin(["position", "speed"])]
        found = result.comparison[result.comparison["estimator"] == estimator.title]
        for column in ("quantity", "t_s", "axis", "error", "sigma", "bound", "distance_m"):
            assert found[column].tolist() == pytest.approx(kept[column].tolist(), nan_ok=True, abs=0)
        nees = result.nees[result.nees["estimator"] == estimator.title]
        assert nees["nees"].tolist() == expected.nees["nees"].tolist()


def test_a_trial_is_a_pure_function(scenario: Any, tmp_path: Path) -> None:
    """In another order, again, and in another process."""
    first = {run: trial(scenario, run) for run in (0, 1)}
    for run in (1, 0):
        same(trial(scenario, run), first[run])
    code = (
        "import sys; from scenarios import spec; from scenarios.trial import TABLES, trial;"
        "t = trial(spec.run_model().model_validate_json(sys.argv[1]), 1);"
        "[getattr(t, n).to_parquet(f'{sys.argv[2]}/{n}.parquet') for n in TABLES]"
    )
    command = [sys.executable, "-c", code, scenario.model_dump_json(by_alias=True), str(tmp_path)]
    environment = os.environ | {"PYTHONHASHSEED": "7", "OMP_NUM_THREADS": "1"}
    subprocess.run(command, env=environment, check=True, capture_output=True)
    there = TrialResult(**{name: pd.read_parquet(tmp_path / f"{name}.parquet") for name in TABLES})
    same(there, first[1])


def test_estimators_share_the_observations(scenario: Any) -> None:
    """Common random numbers: an estimator's rows do not depend on who else runs."""
    alone = trial(scenario.model_copy(update={"estimator": scenario.estimator[1:]}), 0)
    both = trial(scenario, 0).comparison
    theirs = both[both["estimator"] == "b"].reset_index(drop=True)
    pd.testing.assert_frame_equal(alone.comparison, theirs, check_exact=True)


def test_outliers_are_counted_in_every_window() -> None:
    detector = "estimator=[{name='sliding_window_adjustment',start_window=6,outliers='robust'}]"
    result = trial(spec.read("oncoming", [*QUICK, NOISE, detector]), 0)
    assert len(result.outliers) == 1
    row = result.outliers.iloc[0]
    assert row["tp"] == 24
    assert row["fn"] == 0


def test_an_estimator_that_gives_nothing_has_a_row() -> None:
    result = trial(spec.read("oncoming", [*QUICK, "measure.points=2"]), 0)
    assert result.failures["kind"].tolist() == ["estimation"]
    assert "window" in result.failures["reason"].iloc[0]
    assert result.support["estimated"].tolist() == [0]
    assert result.comparison.empty
