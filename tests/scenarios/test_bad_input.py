"""Wrong input ends with status 2 and one line that names file and key; nothing half-written stays behind."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from sim.render import RendererUnavailable
from tests.scenarios.conftest import QUICK, Command, Result

LABELS = Path(__file__).resolve().parents[2] / "scenarios" / "data" / "overtaking.txt"


def refused(result: Result, *words: str) -> None:
    """One line on standard error with all the words, status 2, and no output folder."""
    assert result.status == 2, result
    lines = result.err.strip().splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("pruefstand: ")
    for word in words:
        assert word in lines[0], (word, lines[0])
    assert not Path("runs").exists()


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("rig.focal_pxx=900", ("--set", "rig.focal_pxx", "did you mean 'focal_px'")),
        ("rig.focal_px=wide", ("rig.focal_px", "'wide'")),
        ("rig.focal_px=-3", ("rig.focal_px", "greater than or equal to 1", "-3")),
        ("rig.baseline_m=0", ("rig.baseline_m", "greater than 0", "0")),
        ("rig.rate_hz=1e-9", ("rig.rate_hz", "0.1")),
        ("rig.distortion=[-1.5,0,0,0,0]", ("rig.distortion", "folds")),
        ("vehicle.0.motion.heading_deg=1e300", ("vehicle.0.motion.heading_deg", "3600")),
        ("vehicle.0.grid=[9,9,9]", ("--set", "vehicle.0.grid", "sedan")),
        ("vehicle.0.forward='+z'", ("--set", "vehicle.0.forward", "sedan")),
        ("measure.stated_sigma_px=1e-300", ("--set", "measure.stated_sigma_px", "1e-06")),
        ("rig.frames=0", ("rig.frames", "1", "0")),
        ("rig.size_px=[1024]", ("rig.size_px",)),
        ("measure.sigma_px=-0.1", ("measure.sigma_px", "-0.1")),
        ("measure.sigma_px=nan", ("measure.sigma_px", "finite", "nan")),
        ("measure.sigma_px=0", ("stated_sigma_px",)),
        ("measure.points=inf", ("measure.points", "inf")),
        ("measure.from='image'", ("measure.from", "did you mean 'images'")),
        ("measure.target='targt'", ("measure.target", "did you mean 'target'")),
        ("vehicle.0.mesh='sedann'", ("vehicle.0.mesh", "did you mean 'sedan'")),
        ("vehicle.0.mesh='no/such.obj'", ("vehicle.0.mesh", "no/such.obj", "no such mesh file")),
        ("vehicle.7.mesh='van'", ("vehicle.7", "0..1")),
        ("vehicle.0.motion.kind='strait'", ("vehicle.0.motion.kind", "did you mean 'straight'")),
        ("vehicle.0.motion.speed=3", ("vehicle.0.motion.speed", "did you mean 'speed_mps'")),
        ("vehicle.0.color='purpel'", ("vehicle.0.color", "purpel")),
        ("vehicle.1.name='target'", ("'target'", "2 times")),
        ("vehicle=[]", ("vehicle",)),
        ("outliers=[{kind='nois'}]", ("outliers.0.kind", "did you mean 'noise'")),
        ("outliers=[{kind='noise', tracks=0.7}, {kind='stereo', tracks=0.6}]", ("outliers", "more than 1")),
        ("outliers=[{kind='segmentation', on='truck'}]", ("outliers.0.on", "background")),
        ("estimator.0.name='sliding'", ("estimator.0.name", "sliding_window_adjustment")),
        ("estimator.0.weights='estimate'", ("estimator.0.weights", "did you mean 'estimated'")),
        ("estimator.0.window=1", ("window", "1")),
        ("estimator=[]", ("estimator",)),
        ("kind='aerial'", ("kind", "stereo")),
    ],
)
def test_wrong_settings(quick_run: Command, setting: str, words: tuple[str, ...]) -> None:
    refused(quick_run(setting), *words)


def test_what_cannot_be_drawn(quick_run: Command) -> None:
    refused(quick_run("render.enabled=true", "rig.size_px=[16384,16]"), "render.supersample", "16384")
    grid = "vehicle=[{name='g',mesh='point_grid',motion={kind='straight',start_m=[0,20]}}]"
    refused(quick_run(grid, quick=("world.roadside=false",)), "render.enabled", "nothing to draw")


def test_a_machine_without_opengl_is_one_line(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RendererUnavailable("install libegl1")

    monkeypatch.setattr("scenarios.footage.write_footage", fail)
    result = command("run", "oncoming", "--set", "rig.frames=2")
    assert result.status == 3
    assert result.err.strip().splitlines() == ["pruefstand: install libegl1; or --set render.enabled=false"]


def test_mistyped_names(command: Command) -> None:
    refused(command("run", "oncoming", "--set", "nonsense"), "--set nonsense", "key.path=value")
    refused(command("run", "oncomming"), "did you mean 'oncoming'")
    refused(command("runn", "oncoming"), "did you mean 'run'")
    refused(command("run", "oncoming", "--sed", "3", "--estmator", "x"), "--estmator")
    refused(command("run"), "NAME|FILE.toml")
    refused(command("run", "oncoming", "--seed", "-3"), "--seed: seed", "-3")
    refused(command("evaluate"), "evaluate")
    refused(command("run", "oncoming", "--estimator", "estimated second ordr"), "did you mean 'estimated second order'")


def test_missing_or_broken_files(command: Command, tmp_path: Path) -> None:
    refused(command("run", "nowhere.toml"), "nowhere.toml", "no such file")
    broken = tmp_path / "broken.toml"
    broken.write_text("title = 'x'\n[rig\n")
    refused(command("run", str(broken)), "broken.toml", "TOML", "line 2")
    broken.write_bytes(b"\xff\xfe\x00")
    refused(command("run", str(broken)), "broken.toml", "not text")
    broken.write_text("kind = 'stereo'\n")
    refused(command("run", str(broken)), "broken.toml", "title")


def replay(command: Command, *settings: str) -> Result:
    quick = ("render.enabled=false", "world.roadside=false", *settings)
    return command("run", "replay", *[w for s in quick for w in ("--set", s)])


def test_wrong_labels(command: Command, tmp_path: Path) -> None:
    refused(replay(command, "vehicle.0.motion.labels='none.txt'"), "motion.labels", "none.txt", "no such file")
    refused(replay(command, "vehicle.0.motion.track=9"), "track 9", "overtaking.txt", "tracks 0, 1")
    lines = LABELS.read_text().splitlines()
    copy = tmp_path / "labels.txt"
    for number, wrong, word in ((3, "1 2 Car", "17 columns"), (5, lines[4].replace("Car 0", "Car x"), "'x'")):
        copy.write_text("\n".join([*lines[: number - 1], wrong, *lines[number:]]) + "\n")
        refused(replay(command, f"vehicle.0.motion.labels='{copy}'"), "labels.txt", f"line {number}", word)
    copy.write_text("\n".join(lines).replace("Car", "Pedestrian"))
    refused(replay(command, f"vehicle.0.motion.labels='{copy}'"), "Pedestrian", "Car")
    refused(replay(command, "rig.frames=1000"), "rig.frames", "1000", "60")


def test_wrong_poses(command: Command, tmp_path: Path) -> None:
    poses = tmp_path / "poses.txt"
    poses.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0\n")
    refused(replay(command, f"ego.poses='{poses}'"), "poses.txt", "line 2", "12")
    poses.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 3)
    refused(replay(command, f"ego.poses='{poses}'"), "ego.poses", "3 camera poses")
    poses.write_text("1 0 0 0 0 2 0 0 0 0 1 0\n")
    refused(replay(command, f"ego.poses='{poses}'"), "poses.txt", "line 1", "rotation")


def test_a_mesh_that_is_no_mesh(quick_run: Command, tmp_path: Path) -> None:
    mesh = tmp_path / "car.obj"
    for content in (b"", b"hello\n", b"v 0 0 0\nv 1 0 0\n", b"\x00\x01\x02"):
        mesh.write_bytes(content)
        refused(quick_run(f"vehicle.0.mesh='{mesh}'"), "vehicle.0.mesh", "car.obj")


def test_a_target_out_of_view(quick_run: Command) -> None:
    refused(quick_run("vehicle.0.motion.start_m=[0.0, -20.0]"), "measure.target", "never visible")


def test_vehicles_that_touch(quick_run: Command) -> None:
    refused(quick_run("vehicle.1.motion.start_m=[-3.5, 28.0]"), "touch", "frame")


def test_output_that_cannot_be_written(command: Command, tmp_path: Path) -> None:
    occupied = tmp_path / "occupied"
    occupied.mkdir()
    (occupied / "thesis.txt").write_text("x")
    settings = [w for s in QUICK for w in ("--set", s)]
    refused(command("run", "oncoming", *settings, "--out", str(occupied)), "--out", "not a run folder")
    assert [p.name for p in occupied.iterdir()] == ["thesis.txt"]
    below_a_file = occupied / "thesis.txt" / "run"
    refused(command("run", "oncoming", *settings, "--out", str(below_a_file)), "--out", "cannot be written")
    locked = tmp_path / "locked"
    locked.mkdir()
    locked.chmod(stat.S_IRUSR | stat.S_IXUSR)
    if os.access(locked, os.W_OK):  # root may write anywhere; the case above covers it
        return
    refused(command("run", "oncoming", *settings, "--out", str(locked / "run")), "--out", "cannot be written")


def test_a_full_stage_leaves_nothing_half_written(
    quick_run: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("disk on fire")

    monkeypatch.setattr("sim.truth.Truth.save", fail)
    result = quick_run()
    assert result.status == 3
    left = sorted(p.name for p in (tmp_path / "runs" / "oncoming-1").iterdir())
    assert left == ["provenance.json", "scenario.json"]
