"""The language of study files: what is expanded, and what is refused in one line that names the key."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios import study_spec
from scenarios.study_points import Point, expand
from sim.scenario import ScenarioError
from tests.scenarios.conftest import Command

HEAD = 'title = "t"\nkind = "study"\nscenario = "oncoming"\n'
SIGMA = '[[sweep]]\nkind = "grid"\nkey = "measure.sigma_px"\nvalues = [0.1, 0.2]\n'
Points = Callable[..., list[Point]]


@pytest.fixture
def points(tmp_path: Path) -> Points:
    """The points of a study file with a body, by default without any command line."""

    def call(body: str, settings: tuple[str, ...] = (), **asked: Any) -> list[Point]:
        path = tmp_path / "study.toml"
        path.write_text(HEAD + body)
        study, base = study_spec.read(str(path), settings, **asked)
        return expand(study, base, tmp_path)

    return call


def test_a_study_without_sweeps_is_one_point(points: Points) -> None:
    (point,) = points("[set]\nrig.frames = 9\n")
    assert point.name == ""
    assert point.scenario.rig.frames == 9
    assert not point.scenario.render.enabled


def test_grids_multiply_the_first_outermost(points: Points) -> None:
    found = points(SIGMA + '[[sweep]]\nkind = "grid"\nkey = "vehicle.0.motion.start_m.1"\nvalues = [30, 50.5]\n')
    assert [p.name for p in found] == [
        f"measure.sigma_px={s}; vehicle.0.motion.start_m.1={y}" for s in (0.1, 0.2) for y in (30, 50.5)
    ]
    assert [p.scenario.vehicle[0].motion.start_m[1] for p in found] == [30, 50.5, 30, 50.5]
    assert found[0].scenario.vehicle[0].motion.start_m[0] == -3.5


def test_keys_of_a_list_vary_together_and_may_hold_tables(points: Points) -> None:
    body = """
    [[sweep]]
    kind = "list"
    points = [
        { measure.sigma_px = 0.1, outliers = [] },
        { "measure.sigma_px" = 0.3, outliers = [{ kind = "stereo", tracks = 0.2 }] },
    ]
    [[sweep]]
    kind = "grid"
    key = "vehicle.0.motion"
    values = [{ kind = "crossing", distance_m = 15.0 }]
    """
    found = points(body)
    assert [(p.scenario.measure.sigma_px, len(p.scenario.outliers)) for p in found] == [(0.1, 0), (0.3, 1)]
    assert {p.scenario.vehicle[0].motion.kind for p in found} == {"crossing"}


def test_arguments_of_estimators(points: Points) -> None:
    body = """
    [[sweep]]
    kind = "grid"
    key = "estimator.*.window"
    values = [5, 8]
    [[estimator]]
    name = "sliding_window_adjustment"
    label = "a"
    [[estimator]]
    name = "sliding_window_adjustment"
    label = "b"
    """
    assert [[e.window for e in p.scenario.estimator] for p in points(body)] == [[5, 5], [8, 8]]


def latin(kind: str, n: int) -> str:
    ranges = "{ measure.sigma_px = [0.1, 10.0], measure.points = [20, 22], rig.focal_px = [500, 1500.0] }"
    return f'[[sweep]]\nkind = "{kind}"\npoints = {n}\nlog = ["measure.sigma_px"]\nranges = {ranges}\n'


@pytest.mark.parametrize("kind", ["latin_hypercube", "sobol"])
def test_quasi_random_points_cover_their_ranges(points: Points, kind: str) -> None:
    found = [p.scenario for p in points(latin(kind, 64))]
    strata = np.sort(np.floor(64 * np.log([s.measure.sigma_px / 0.1 for s in found]) / np.log(100)))
    assert np.array_equal(strata, np.arange(64))  # one point in every 64th of the logarithm
    assert np.array_equal(np.sort([np.floor(64 * (s.rig.focal_px - 500) / 1000) for s in found]), np.arange(64))
    counts = np.bincount([s.measure.points for s in found])[20:]
    assert len(counts) == 3
    assert counts.min() >= 20


def test_quasi_random_points_follow_from_the_seed(points: Points) -> None:
    names = [[p.name for p in points(latin("sobol", 8), seed=seed)] for seed in (1, 1, 2)]
    assert names[0] == names[1] != names[2]
    for p in points(latin("sobol", 8)):  # the name says exactly where the point is
        assert f"measure.sigma_px={p.scenario.measure.sigma_px}" in p.name


def test_paths_are_relative_to_the_study(points: Points, tmp_path: Path) -> None:
    (point,) = points("[set]\nego.poses = 'drive/poses.txt'\n")
    assert point.scenario.ego.poses == tmp_path / "drive" / "poses.txt"


def test_the_command_line_lays_over_the_study(points: Points) -> None:
    (point,) = points("runs = 7\n[set]\nrig.frames = 9\n", ("rig.frames=11",), seed=5)
    assert point.scenario.rig.frames == 11
    assert point.scenario.seed == 5


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("rums = 3\n", ("rums", "did you mean 'runs'")),
        ("runs = 0\n", ("runs", "1", "0")),
        ("keep = ['positon']\n", ("keep.0", "did you mean 'position'")),
        ("[set]\nrig.frame = 3\n", ("set.rig.frame", "did you mean 'frames'")),
        ("[set]\nestimator.3.window = 3\n", ("set.estimator.3", "0..0")),
        ("[[sweep]]\nkind = 'gird'\n", ("sweep.0.kind", "did you mean 'grid'")),
        ("[[sweep]]\nkind = 'grid'\nkey = 'measure.sigma_px'\nvalues = []\n", ("sweep.0.values", "at least 1")),
        (SIGMA.replace("sigma_px", "sigma"), ("sweep.0.key", "measure.sigma", "did you mean")),
        (SIGMA.replace("0.2", "-1"), ("sweep.0.key", "measure.sigma_px", "-1", "at measure.sigma_px=-1")),
        (SIGMA.replace("0.2", "0.1"), ("sweep", "measure.sigma_px=0.1", "twice")),
        (SIGMA + SIGMA, ("measure.sigma_px", "2 times")),
        ("[[sweep]]\nkind = 'list'\npoints = [{ seed = 1 }, { runs = 2 }]\n", ("sweep.0.points", "runs", "seed")),
        (latin("sobol", 12), ("sweep.0.points", "power of two", "12")),
        (latin("sobol", 8).replace("[0.1, 10.0]", "[3, 1]"), ("sweep.0.ranges", "measure.sigma_px", "[3, 1]")),
        (latin("sobol", 8).replace("[0.1, 10.0]", "[0, 1]"), ("sweep.0", "log", "measure.sigma_px", "more than 0")),
        ("[[estimator]]\nname = 'slidin'\n", ("estimator.0.name", "sliding_window_adjustment")),
        ("[[estimator]]\nname = 'sliding_window_adjustment'\nwindow = 1\n", ("estimator.0", "window", "1")),
        ("[[table]]\nname = 'metricks'\n", ("table.0.name", "did you mean 'metrics'")),
        ("[[figure]]\nname = 'lines'\n", ("figure.0.over", "missing")),
        ("[[figure]]\nname = 'lines'\nover = 'x'\nlog_xx = true\n", ("figure.0.log_xx", "did you mean 'log_x'")),
        ("[[table]]\nname = 'metrics'\n[[table]]\nname = 'metrics'\n", ("table", "'metrics'", "2 times")),
    ],
)
def test_wrong_files(command: Command, tmp_path: Path, body: str, words: tuple[str, ...]) -> None:
    (tmp_path / "wrong.toml").write_text(HEAD + body)
    refused(command("study", "wrong.toml"), "wrong.toml", *words)


def refused(result: Any, *words: str) -> None:
    """One line with all the words, status 2, nothing written."""
    assert result.status == 2, result
    lines = result.err.strip().splitlines()
    assert len(lines) == 1, lines
    for word in words:
        assert word in lines[0], (word, lines[0])
    assert not Path("runs").exists()


def test_wrong_command_lines(command: Command, tmp_path: Path) -> None:
    (tmp_path / "good.toml").write_text(HEAD + SIGMA)
    refused(command("study", "depth-bias-mapp"), "did you mean 'depth-bias-map'")
    refused(command("study", "nowhere.toml"), "nowhere.toml", "no such file")
    refused(command("study", "good.toml", "--runs", "0"), "--runs", "0")
    refused(command("study", "good.toml", "--seed", "-1"), "--seed", "-1")
    refused(command("study", "good.toml", "--workers", "0"), "--workers", "0")
    refused(command("study", "good.toml", "--set", "measure.sigma_px=1"), "--set measure.sigma_px", "sweep.0.key")
    refused(command("study", "good.toml", "--set", "rig.frame=1"), "--set", "rig.frame")
    refused(command("study", "good.toml", "--workers", "1", "--scheduler", "tcp://x:1"), "--scheduler")
    (tmp_path / "bad.toml").write_text(HEAD.replace("oncoming", "oncomming"))
    refused(command("study", "bad.toml"), "bad.toml", "scenario", "did you mean 'oncoming'")


def test_every_study_that_ships_is_valid() -> None:
    for name, path in study_spec.names().items():
        study, base = study_spec.read(name)
        assert study.title
        assert study.source
        assert expand(study, base, path.parent)


def test_schema_and_list_know_studies(command: Command) -> None:
    schema = command("schema", "study")
    assert schema.status == 0
    assert '"sweep"' in schema.out
    listed = command("list")
    assert "depth-bias-map" in listed.out
    assert max(len(line) for line in listed.out.splitlines()) <= 80


def test_only_the_estimators_asked_for() -> None:
    _, base = study_spec.read("siegemund-table-3-4-1", estimators=["tracks", "points"])
    assert [e["label"] for e in base["estimator"]] == ["points", "tracks"]
    with pytest.raises(ScenarioError, match=r"^--estimator: found 'track', did you mean 'tracks'"):
        study_spec.read("siegemund-table-3-4-1", estimators=["track"])


@pytest.mark.parametrize("name", ["flight-town", "recording", "boresight-gcps"])
def test_a_study_of_what_only_runs_is_refused(name: str, command: Command, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(f'title = "t"\nkind = "study"\nscenario = "{name}"\nruns = 1\n')
    result = command("study", "mine.toml")
    assert result.status == 2
    assert f"scenario: found '{name}', a " in result.err
    assert result.err.count("\n") == 1
