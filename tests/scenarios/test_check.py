"""The regression check from the command line, on a small battery with baselines of its own."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints
from xml.etree import ElementTree

import pandas as pd
import pytest

from estimators.stereo import depth_bias, window_adjustment
from estimators.stereo.conditions import RotationAxis, Smoothing
from estimators.stereo.configuration import Configuration
from scenarios import check
from scenarios.study_console import Silent
from tests.scenarios.conftest import Command

BATTERY = """
runs = 8
[[scene]]
name = "far"
scenario = "oncoming"
set = { "rig.frames" = 5, "world.roadside" = false, "vehicle.0.motion.start_m" = [-3.5, 70.0] }
each = { name = "sliding_window_adjustment", selection = "whole" }
estimator = [ { label = "corrected" }, { label = "plain", second_order = false } ]
"""
NESTED = {"smoothing": Smoothing, "rotation_axis": RotationAxis}


@pytest.fixture
def small(tmp_path: Path, command: Command) -> Command:
    """`check` of a small battery, in this process."""
    (tmp_path / "small.toml").write_text(BATTERY)
    return lambda *options: command("check", "small.toml", "--workers", "1", *options)


@pytest.fixture(scope="module")
def baselines(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The baselines of this code."""
    folder = tmp_path_factory.mktemp("battery")
    (folder / "small.toml").write_text(BATTERY)
    check.check(folder / "small.toml", folder / "out", Silent(), workers=1, update=True)
    return folder / "baselines"


@pytest.fixture
def baselined(small: Command, baselines: Path) -> Command:
    """The same with the baselines of this code."""
    shutil.copytree(baselines, "baselines")
    return small


def stored() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(Path("runs/check/verdicts.json").read_text())
    return found


def of(verdict: str) -> set[tuple[str, str, str, str]]:
    rows = [v for v in stored()["verdicts"] if v["verdict"] == verdict]
    return {(v["estimator"], v["quantity"], v["axis"], v["statistic"]) for v in rows}


def test_without_baselines_all_is_new_and_the_way_to_them_is_told(small: Command) -> None:
    result = small()
    assert result.status == 0
    assert "32 new" in result.out
    assert "check --update" in result.out
    assert not Path("baselines").exists()
    assert stored()["counts"]["new"] == 32


def test_the_same_code_is_the_same(baselined: Command) -> None:
    assert [p.name for p in Path("baselines").iterdir()] == ["far.csv"]
    before = Path("baselines/far.csv").read_bytes()
    result = baselined()
    assert result.status == 0
    assert "32 same" in result.out
    assert of("same") | of("worse") == of("same")
    assert Path("baselines/far.csv").read_bytes() == before


def test_two_processes_measure_the_same(tmp_path: Path, baselines: Path) -> None:
    (tmp_path / "small.toml").write_text(BATTERY)
    check.check(tmp_path / "small.toml", tmp_path / "out", Silent(), workers=2, update=True)
    assert (tmp_path / "baselines" / "far.csv").read_bytes() == (baselines / "far.csv").read_bytes()


def test_a_lost_correction_is_found_and_named(baselined: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second-order correction of the triangulated points, switched off in the code."""
    before = Path("baselines/far.csv").read_bytes()
    whole = depth_bias.observation_model
    monkeypatch.setattr(window_adjustment, "observation_model", lambda *a: whole(*a[:-1], second_order=False))
    result = baselined()
    assert result.status == 1
    assert ("corrected", "position", "z", "bias") in of("worse")
    assert not [key for key in of("worse") | of("better") if key[0] == "plain"]
    lines = result.out.splitlines()
    assert "worse" in lines[1]
    assert any("far" in line and "corrected" in line and "position z bias" in line for line in lines)
    assert max(map(len, lines)) <= 80
    cases = ElementTree.parse("runs/check/junit.xml").getroot().iter("testcase")
    failed = {(c.get("classname"), c.get("name")) for c in cases if c.find("failure") is not None}
    assert ("far.corrected", "position z bias") in failed

    update = baselined("--update")
    assert update.status == 0
    assert "position z bias" in update.out
    assert Path("baselines/far.csv").read_bytes() != before


def test_an_estimation_that_newly_fails_is_worse(baselined: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: Any) -> Any:
        return window_adjustment.EstimationFailed("points on a line")

    monkeypatch.setattr("estimators.stereo.sliding_window.adjust_window", fails)
    assert baselined().status == 1
    reasons = {v["reason"] for v in stored()["verdicts"] if v["verdict"] == "worse"}
    assert reasons == {"must not happen", "runs without a value"}


def test_another_scene_or_option_has_no_baseline(baselined: Command) -> None:
    Path("small.toml").write_text(BATTERY.replace("second_order = false", "second_order = false, window = 8"))
    assert baselined().status == 0
    assert stored()["counts"] == {"worse": 0, "better": 0, "new": 16, "missing": 16, "same": 16}


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("runs = 8", "runs = 7", ("small.toml", "runs", "8", "7")),
        ("runs = 8", "seed = 8", ("small.toml", "seed", "unknown key")),
        ('"oncoming"', '"oncomin"', ("small.toml", "'far'", "did you mean 'oncoming'")),
        ("rig.frames", "rig.framse", ("small.toml", "'far'", "rig.framse", "did you mean 'frames'")),
        ("second_order", "third_order", ("small.toml", "'far'", "estimator.1.third_order")),
        ('"plain"', '"corrected"', ("small.toml", "'far'", "2 times")),
        ("[[scene]]", "[scene]", ("small.toml", "scene")),
        ("runs", "runs runs", ("small.toml", "not valid TOML")),
    ],
)
def test_a_wrong_battery_is_one_line(
    command: Command, tmp_path: Path, old: str, new: str, words: tuple[str, ...]
) -> None:
    (tmp_path / "small.toml").write_text(BATTERY.replace(old, new, 1))
    refused(command("check", "small.toml"), *words)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("none.toml",), ("none.toml", "no such file")),
        (("small.toml", "--workers", "0"), ("--workers", "1 or more")),
        (("small.toml", "--updat", "x"), ("unrecognized", "x")),
        (("small.toml", "--out", "small.toml"), ("small.toml", "cannot be written")),
    ],
)
def test_wrong_options_are_one_line(
    command: Command, tmp_path: Path, options: tuple[str, ...], words: tuple[str, ...]
) -> None:
    (tmp_path / "small.toml").write_text(BATTERY)
    refused(command("check", *options), *words)


def test_a_wrong_baseline_is_one_line(small: Command) -> None:
    Path("baselines").mkdir()
    Path("baselines/far.csv").write_text("no,baseline\n1,2\n")
    refused(small(), "far.csv", "is no baseline")


def refused(result: Any, *words: str) -> None:
    assert result.status == 2, result
    lines = result.err.strip().splitlines()
    assert len(lines) == 1, lines
    for word in ("pruefstand: ", *words):
        assert word in lines[0], (word, lines[0])
    assert not Path("runs").exists()


def test_the_battery_uses_every_option() -> None:
    """Every choice of the estimator is in the project's battery, every number is somewhere not the default."""
    _, scenarios = check.read_battery(check.BATTERY)
    estimators = [e.build() for s in scenarios.values() for e in s.estimator]
    parts = [(Configuration, estimators)]
    parts += [(cls, [getattr(e, key) for e in estimators]) for key, cls in NESTED.items()]
    for cls, values in parts:
        for option, hint in get_type_hints(cls).items():
            used = {getattr(v, option) for v in values}
            assert choices(hint) <= used, (cls.__name__, option, choices(hint) - used)
            assert len(used) > 1, (cls.__name__, option)


def choices(hint: Any) -> set[Any]:
    """The values a type allows, as far as it lists them."""
    if hint is bool:
        return {True, False}
    if get_origin(hint) is Literal:
        return set(get_args(hint))
    return {value for part in get_args(hint) for value in choices(part)}


def test_the_battery_has_baselines() -> None:
    """One file per scene, of the scenes and options as they are; `pruefstand check --update` makes them."""
    runs, scenarios = check.read_battery(check.BATTERY)
    for name, scenario in scenarios.items():
        table = pd.read_csv(check.BATTERY.parent / "baselines" / f"{name}.csv", dtype={"config": str})
        expected = {(e.title, check.config(scenario, e, runs)) for e in scenario.estimator}
        assert set(zip(table["estimator"], table["config"], strict=True)) == expected
