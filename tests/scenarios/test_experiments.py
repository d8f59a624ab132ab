"""Numeric experiments: pure functions of seed and run, and studies of them that are refused in one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from reports.measures import MEASURES
from reports.studies import load_study
from scenarios import study, study_spec, study_subject
from scenarios.experiments import EXPERIMENTS
from scenarios.experiments.scalar_filter import ScalarFilter
from scenarios.experiments.single_precision import SinglePrecision
from scenarios.study_console import Progress
from scenarios.study_points import expand
from scenarios.study_subject import decoded
from sim.scenario import ScenarioError
from tests.scenarios.conftest import Command

HEAD = 'title = "t"\nsource = "s"\nkind = "study"\nexperiment = "scalar_filter"\n'


def last(rows: pd.DataFrame, quantity: str) -> pd.Series:
    """Value by case after the last step."""
    chosen = rows[(rows["quantity"] == quantity) & (rows["t_s"] == rows["t_s"].max())]
    return pd.Series(chosen["value"].to_numpy(), index=chosen["estimator"])


SMALL: dict[str, dict[str, Any]] = {
    "boresight_calibration": {"images": 4},
    "boresight_ties": {"points": 50},
    "boresight_time_offset": {"images": 4, "offsets": 5},
    "interior_orientation": {"images": 3},
    "ortho_accuracy": {"images": 1, "points": 50},
    "road_accuracy": {"network": "motorway"},
    "scalar_filter": {"steps": (1, 4)},
    "single_precision": {"steps": (1, 4)},
}


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_an_experiment_follows_from_seed_and_run(name: str) -> None:
    experiment = EXPERIMENTS[name](**SMALL[name])
    rows = [experiment(seed, run) for seed, run in ((1, 2), (1, 2), (1, 3), (2, 2))]
    pd.testing.assert_frame_equal(rows[0], rows[1])
    for other in rows[2:]:
        assert not np.array_equal(rows[0]["value"], other["value"])
    assert set(rows[0]["estimator"]) == set(experiment.cases)
    assert set(rows[0]["quantity"]) <= set(MEASURES)
    if "steps" in SMALL[name]:
        assert set(rows[0]["t_s"]) == {1, 4}


def test_no_form_breaks_where_variances_are_alike() -> None:
    rows = SinglePrecision(range=100.0, steps=(1, 5))(1, 0)
    assert (last(rows, "lost") == 0).all()
    # A hundredfold range costs two of single precision's seven digits, three with the forms' own losses.
    assert (last(rows, "covariance_error") < 1e-3).all()
    assert (last(rows, "state_error") < 1e-2).all()


def test_the_source_s_range_breaks_what_carries_the_covariance_itself() -> None:
    found = [SinglePrecision(range=1e10, steps=(1, 10))(1, run) for run in range(5)]
    lost = pd.concat([last(rows, "lost") for rows in found], axis=1).sum(axis=1)
    assert lost["plain"] == 5
    assert lost[["potter", "carlson", "udu"]].sum() == 0
    for rows in found:
        # Roots: half the range's ten digits of the seven there are, and the losses of ten steps.
        assert last(rows, "covariance_error")[["potter", "carlson", "udu"]].max() < 0.1


@pytest.mark.parametrize("noise", [0.01, 1.0, 100.0])
def test_the_scalar_filter_converges_to_the_root_of_riccati_s_equation(noise: float) -> None:
    rows = ScalarFilter(noise=noise, steps=(1, 400))(1, 0)
    p = noise / 2 + np.sqrt(noise**2 / 4 + noise)  # p = p r / (p + r) + q with r = 1
    assert last(rows, "gain")["filter"] == pytest.approx(p / (p + 1), rel=1e-9)
    assert last(rows, "stated_variance")["filter"] == pytest.approx(p / (p + 1), rel=1e-9)


def test_the_first_gain_is_that_of_the_start_covariance() -> None:
    rows = ScalarFilter(start=9.0, stated_start=11.0, steps=(1,))(1, 0)
    assert last(rows, "gain")["filter"] == pytest.approx(99 / 100)


def test_an_honest_scalar_filter_is_consistent() -> None:
    found = pd.concat([ScalarFilter(noise=0.1, steps=(1, 3, 30))(1, run) for run in range(300)])
    for quantity in ("nees", "nis"):
        means = found[found["quantity"] == quantity].groupby("t_s")["value"].mean()
        assert np.abs(means - 1).max() < 3.5 * np.sqrt(2 / 300)  # 3.5 sigma of the mean of 300 chi-squares


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("[set]\nnoize = 3\n", ("set.noize", "unknown key", "did you mean 'noise'")),
        ("[set]\nnoise = -1\n", ("noise", "-1")),
        ("[set]\nsteps = [3, 2]\n", ("steps", "increase", "[3, 2]")),
        ("[[sweep]]\nkind = 'grid'\nkey = 'start'\nvalues = [1, 0]\n", ("sweep.0.key", "start", "at start=0")),
        ("[[sweep]]\nkind = 'grid'\nkey = 'strat'\nvalues = [1]\n", ("sweep.0.key", "did you mean 'start'")),
        ("[[sweep]]\nkind = 'label_tracks'\n", ("sweep.0.vehicle", "no label file")),
        ("[[estimator]]\nname = 'sliding_window_adjustment'\n", ("estimator", "experiment")),
        ("[[table]]\nname = 'measurez'\n", ("table.0.name", "did you mean 'measures'")),
    ],
)
def test_wrong_files(command: Command, tmp_path: Path, body: str, words: tuple[str, ...]) -> None:
    (tmp_path / "wrong.toml").write_text(HEAD + body)
    refused(command("study", "wrong.toml"), "wrong.toml", *words)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("", ("scenario", "missing", "experiment")),
        ("experiment = 'scalar'", ("experiment", "'scalar'", "did you mean 'scalar_filter'")),
        ("experiment = 'scalar_filter'\nscenario = 'oncoming'", ("scenario", "experiment")),
        ("experiment = 'scalar_filter'\nexamples = true", ("examples", "experiment")),
        ("experiment = 'scalar_filter'\nkeep = ['position']", ("keep", "experiment")),
    ],
)
def test_what_is_measured_is_said_once(command: Command, tmp_path: Path, line: str, words: tuple[str, ...]) -> None:
    (tmp_path / "wrong.toml").write_text(f'title = "t"\nkind = "study"\n{line}\n')
    refused(command("study", "wrong.toml"), "wrong.toml", *words)


def test_wrong_command_lines(command: Command, tmp_path: Path) -> None:
    (tmp_path / "good.toml").write_text(HEAD)
    refused(command("study", "good.toml", "--estimator", "udu"), "--estimator", "no estimators")
    refused(command("study", "good.toml", "--set", "noize=1"), "--set", "noize")


def refused(result: Any, *words: str) -> None:
    """One line with all the words, status 2, nothing written."""
    assert result.status == 2, result
    lines = result.err.strip().splitlines()
    assert len(lines) == 1, lines
    for word in words:
        assert word in lines[0], (word, lines[0])
    assert not Path("runs").exists()


def test_a_point_is_the_same_after_its_way_to_a_worker(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(HEAD + "[set]\nsteps = [2, 3]\n[[sweep]]\nkind = 'grid'\nkey = 'noise'\nvalues = [0.3]\n")
    spec, base = study_spec.read(str(path), ("a=0.5",), seed=7)
    (point,) = expand(spec, base, tmp_path)
    assert point.name == "noise=0.3"
    assert decoded(point.scenario.model_dump_json(by_alias=True)) == point.scenario
    assert point.scenario.build() == ScalarFilter(a=0.5, noise=0.3, steps=(2, 3))
    assert point.scenario.seed == 7


def test_a_study_of_an_experiment_goes_on_and_makes_its_page(tmp_path: Path) -> None:
    file = tmp_path / "study.toml"
    file.write_text(HEAD + "[set]\nsteps = [1, 3]\n[[sweep]]\nkind = 'grid'\nkey = 'noise'\nvalues = [0.1, 10.0]\n")
    asked = [study.Asked(str(file), runs=runs, workers=1, out=tmp_path / "out") for runs in (2, 5)]
    for one in asked:
        assert not study.run(one, Progress(Console(quiet=True))).failed
    result = load_study(tmp_path / "out")
    assert result.experiment
    assert result.estimators == ("filter",)
    assert len(result.measures) == 2 * 5 * 5 * 2
    alone = ScalarFilter(noise=10.0, steps=(1, 3))(1, 4)
    stored = result.measures[(result.measures["run"] == 4) & (result.measures["point"] == "noise=10.0")]
    assert stored["value"].tolist() == alone["value"].tolist()
    table = pd.read_csv(tmp_path / "out" / "table.csv")
    row = table[(table["noise"] == 10) & (table["quantity"] == "error") & (table["step"] == 3)].iloc[0]
    errors = stored_errors(result.measures)
    assert row["value"] == pytest.approx(np.sqrt(np.mean(errors**2)))
    assert row["ci_low"] < row["value"] < row["ci_high"]
    page = (tmp_path / "out" / "report.html").read_text()
    assert "of the experiment" in page
    assert "Windows that could not be estimated" not in page


def stored_errors(measures: pd.DataFrame) -> np.ndarray:
    chosen = (measures["point"] == "noise=10.0") & (measures["quantity"] == "error") & (measures["t_s"] == 3)
    return measures.loc[chosen, "value"].to_numpy()


def test_an_unknown_experiment_has_no_model() -> None:
    with pytest.raises(ScenarioError, match="experiment: found 'x'"):
        study_subject.content("x", None, Path())
