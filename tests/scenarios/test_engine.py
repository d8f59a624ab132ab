"""Stages, cache, refusal of mixed results, exit statuses and the contract of the output files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from reports.errors import ERROR_COLUMNS
from reports.metrics import METRIC_COLUMNS
from scenarios import spec, store
from sim.observations import Observations
from sim.simulate import simulate
from tests.scenarios.conftest import QUICK, Command

RUN = Path("runs/oncoming-1")


def test_a_run_writes_what_the_contract_says(quick_run: Command) -> None:
    result = quick_run()
    assert result.status == 0, result
    assert "report.html" in result.out
    assert max(len(line) for line in result.out.splitlines()) <= 80
    errors = pd.read_parquet(RUN / "errors.parquet")
    metrics = pd.read_csv(RUN / "metrics.csv")
    assert list(errors.columns) == ERROR_COLUMNS
    assert list(metrics.columns) == METRIC_COLUMNS
    assert set(metrics["scenario"]) == {"oncoming"}
    assert set(metrics["direction"]) <= {"lower", "higher", "zero", "one"}
    html = (RUN / "report.html").read_text()
    assert "http://" not in html.replace("http://www.w3.org", "")
    assert "<script src" not in html
    provenance = json.loads((RUN / "provenance.json").read_text())
    assert set(provenance["stages"]) == {"simulate", "estimate estimated second order"}
    assert provenance["versions"]["numpy"] == np.__version__


def test_finished_stages_come_from_the_cache(quick_run: Command) -> None:
    quick_run()
    before = (RUN / "observations/observations.npz").stat().st_mtime_ns
    again = quick_run()
    assert again.status == 0
    assert "from cache" in again.out
    assert (RUN / "observations/observations.npz").stat().st_mtime_ns == before


@pytest.mark.parametrize("stage", ["simulate", "track", "estimate", "label"])
def test_a_stage_depends_on_what_draws_the_images(stage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("sim/world.py", "scenarios/footage.py", "scenarios/shots.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("a = 1\n")
    monkeypatch.setattr(store, "ROOT", tmp_path)
    code_digest = store.code_digest.__wrapped__
    seen = {code_digest(stage)}
    for name in ("sim/world.py", "scenarios/footage.py", "scenarios/shots.py"):
        (tmp_path / name).write_text("a = 2\n")
        seen.add(code_digest(stage))
    assert len(seen) == 4


def test_what_was_deleted_is_made_again(quick_run: Command) -> None:
    quick_run()
    observed, truth = (RUN / p for p in ("observations/observations.npz", "truth/truth.npz"))
    before = observed.read_bytes()
    truth.unlink()
    observed.unlink()
    assert quick_run().status == 0
    assert truth.exists()
    assert observed.read_bytes() == before


def test_results_of_another_configuration_are_refused_then_replaced(quick_run: Command) -> None:
    quick_run()
    refused = quick_run("measure.sigma_px=0.3")
    assert refused.status == 2
    assert "--overwrite" in refused.err
    before = pd.read_csv(RUN / "metrics.csv")
    replaced = quick_run("measure.sigma_px=0.3", "--overwrite")
    assert replaced.status == 0
    after = pd.read_csv(RUN / "metrics.csv")
    crb = [
        float(m[(m.statistic == "crb") & (m.quantity == "position") & (m.axis == "z")].value.iloc[0])
        for m in (before, after)
    ]
    assert crb[1] == pytest.approx(1.5 * crb[0], rel=1e-6)  # the bound is linear in sigma


def test_nothing_of_a_replaced_configuration_stays(quick_run: Command) -> None:
    quick_run()
    label = "estimator.0.label='other'"
    assert quick_run(label, "--overwrite").status == 0
    assert [p.name for p in (RUN / "estimates").iterdir()] == ["other"]
    assert set(json.loads((RUN / "provenance.json").read_text())["stages"]) == {"simulate", "estimate other"}
    assert quick_run(label, "measure.sigma_px=0.3", "--overwrite", "--stage", "simulate").status == 0
    assert sorted(p.name for p in RUN.iterdir()) == ["observations", "provenance.json", "scenario.json", "truth"]


def test_stages_stop_where_asked(quick_run: Command) -> None:
    assert quick_run("--stage", "simulate").status == 0
    assert not (RUN / "estimates").exists()
    assert quick_run("--stage", "estimate").status == 0
    assert not (RUN / "report.html").exists()
    assert quick_run().status == 0
    assert (RUN / "report.html").exists()


def test_no_estimate_at_all_is_status_1_with_a_report(quick_run: Command) -> None:
    result = quick_run("measure.points=2")
    assert result.status == 1
    assert "gave nothing" in result.out
    assert (RUN / "report.html").exists()
    errors = pd.read_parquet(RUN / "errors.parquet")
    assert (errors["quantity"] == "failure").any()


def test_only_one_of_two_estimators(quick_run: Command) -> None:
    two = (
        "estimator=[{name='sliding_window_adjustment',label='a'},{name='sliding_window_adjustment',label='b',window=4}]"
    )
    assert quick_run(two, "--estimator", "b").status == 0
    assert [p.name for p in (RUN / "estimates").iterdir()] == ["b"]
    assert quick_run(two).status == 0
    assert sorted(set(pd.read_csv(RUN / "metrics.csv")["estimator"].dropna())) == ["a", "b"]


def observations_of(*settings: str) -> Observations:
    return simulate(spec.read("oncoming", [*QUICK, *settings]))[0]


def test_adding_an_estimator_or_a_hidden_car_changes_no_observation() -> None:
    plain = observations_of()
    second = "estimator=[{name='sliding_window_adjustment'},{name='sliding_window_adjustment',label='b',window=4}]"
    far_away = (
        "vehicle=[{name='target',mesh='sedan',color='red',motion={kind='straight',start_m=[-3.5,30.0],heading_deg=180.0,"
        "speed_mps=20.0}},{name='van ahead',mesh='van',color='white',motion={kind='straight',start_m=[0.0,30.0],"
        "speed_mps=14.0}},{name='third',mesh='bus',motion={kind='straight',start_m=[40.0,60.0],speed_mps=1.0}}]"
    )
    for changed in (observations_of(second), observations_of(far_away)):
        for name in ("frame", "track", "uv_left", "uv_right", "cov"):
            assert np.array_equal(getattr(plain.tracks, name), getattr(changed.tracks, name))


def test_every_scenario_that_ships_is_valid_and_named_once() -> None:
    found = spec.names()
    assert set(found) >= {"oncoming", "crossing", "turning", "leading", "replay"}
    for name in found:
        needs = ["recording.left=a", "recording.right=b", "recording.calib=c"] if name == "recording" else []
        read = spec.read(name, needs)
        assert read.title
        assert read.source


def test_schema_accepts_and_names_the_keys(command: Command) -> None:
    result = command("schema")
    assert result.status == 0
    schema = json.loads(result.out)
    kinds = {
        kind: schema["$defs"][name.rpartition("/")[2]] for kind, name in schema["discriminator"]["mapping"].items()
    }
    assert set(kinds) == {"stereo", "recording", "flight", "calibration"}
    assert {"rig", "vehicle", "measure", "estimator"} <= set(kinds["stereo"]["properties"])
    assert {"ground", "flight", "estimator"} <= set(kinds["flight"]["properties"])
    assert all(kind["additionalProperties"] is False for kind in kinds.values())


def test_list_names_everything_within_80_columns(command: Command) -> None:
    result = command("list")
    assert result.status == 0
    for name in (*spec.names(), "sliding_window_adjustment"):
        assert name in result.out
    assert max(len(line) for line in result.out.splitlines()) <= 80
