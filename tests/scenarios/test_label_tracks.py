"""The sweep over the cars of a label file, and the battery that ships: from images, and without them."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from reports.studies import load_study
from scenarios import study_spec
from scenarios.study_points import Point, expand
from scenarios.trial import trial
from sim.world import build_world
from tests.scenarios.conftest import Command

BATTERY = "replay-battery"


def row(frame: int, track: int, kind: str = "Car", x: float = 0.0, z: float = 10.0) -> str:
    return f"{frame} {track} {kind} 0 0 0 0 0 0 0 1.5 1.7 4.2 {x} 1.65 {z} -1.5708"


@pytest.fixture
def labels(tmp_path: Path) -> Path:
    standing = ((3, "Car", 20, -3.0), (5, "Van", 30, 6.0), (8, "Car", 19, -7.0))
    lines = [row(f, n, kind, x) for n, kind, k, x in standing for f in range(k)]
    lines += [row(f, 12, "Car", 2.5, 8 + 0.4 * f) for f in range(25)]
    path = tmp_path / "labels.txt"
    path.write_text("\n".join(lines) + "\n")
    return path


def points(*settings: str) -> list[Point]:
    study, base = study_spec.read(BATTERY, settings)
    return expand(study, base, study_spec.FOLDER)


def test_one_point_per_car_that_is_long_enough(labels: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = points(f"vehicle.0.motion.labels={labels}")
    assert [p.settings for p in found] == [{"vehicle.0.motion.track": n} for n in (3, 12)]
    assert all(p.scenario.measure.from_images and p.scenario.vehicle[0].motion.labels == labels for p in found)
    monkeypatch.chdir(labels.parent)  # on the command line paths are relative to the working folder
    assert len(points("vehicle.0.motion.labels=labels.txt")) == 2
    projected = points(f"vehicle.0.motion.labels={labels}", "measure.from=projection")
    assert not any(p.scenario.measure.from_images for p in projected)
    assert [p.scenario.vehicle[0].motion.labels.name for p in points()] == ["overtaking.txt"] * 2


@pytest.mark.shared_data
def test_the_cars_of_a_real_file_see_one_another(shared_data: Path) -> None:
    folder = shared_data / "kitti_tracking"
    files = (f"vehicle.0.motion.labels={folder / '0003.txt'}", f"ego.poses={folder / '0003.camera.txt'}")
    found = points(*files, "world.roadside=false", "measure.from=projection")
    assert [p.settings["vehicle.0.motion.track"] for p in found] == [0, 1, 2, 3, 4, 6, 7, 8]
    world = build_world(found[3].scenario)
    assert {"target", "track 0", "track 2"} <= {a.name for a in world.actors}


STUDY = """
title = "t"
kind = "study"
scenario = "{scenario}"
[[sweep]]
kind = "label_tracks"
{sweep}
"""


@pytest.mark.parametrize(
    ("scenario", "sweep", "settings", "words"),
    [
        ("replay", "frames = 3", (), ("sweep.0.frames", "5", "3")),
        ("replay", "types = ['Cyclist']", (), ("sweep.0.types.0", "'Cyclist'", "Car")),
        ("replay", "vehicle = 1", (), ("sweep.0.vehicle", "vehicle 1 replays no label file")),
        ("oncoming", "", (), ("sweep.0.vehicle", "vehicle 0 replays no label file")),
        ("replay", "frames = 31", (), ("sweep.0", "labels.txt", "has no Car in 31 frames or more")),
        (
            "replay",
            "",
            ("vehicle.0.motion.track=3",),
            ("--set vehicle.0.motion.track", "the study varies it (sweep.0)"),
        ),
        ("replay", "", ("vehicle.0.motion.labels=none.txt",), ("vehicle.0.motion.labels", "none.txt", "no such file")),
    ],
)
def test_wrong_sweeps(
    command: Command, labels: Path, scenario: str, sweep: str, settings: tuple[str, ...], words: tuple[str, ...]
) -> None:
    Path("study.toml").write_text(STUDY.format(scenario=scenario, sweep=sweep))
    replaying = (f"vehicle.0.motion.labels={labels}",) if scenario == "replay" else ()
    result = command("study", "study.toml", *(w for s in (*replaying, *settings) for w in ("--set", s)))
    assert result.status == 2, result
    (line,) = result.err.strip().splitlines()
    assert all(word in line for word in words), line


def test_a_car_is_tracked_in_its_images(labels: Path) -> None:
    small = ("rig.size_px=[310, 94]", "rig.focal_px=180.0", "rig.principal_px=[152.4, 43.2]", "rig.frames=5")
    quick = ("world.roadside=false", "render.shadows=false", "render.supersample=1")
    point = points(f"vehicle.0.motion.labels={labels}", *small, *quick)[1]
    result = trial(point.scenario, 0)
    z = result.comparison.query("quantity == 'position' and axis == 'z' and entity == 'target'")
    assert set(z["estimator"]) == {"plain", "robust"}
    # A rig of a quarter of KITTI's pixels: 0.2 px of disparity are 18 cm at 8 to 10 m, for one point alone.
    assert z["error"].abs().max() < 0.18
    assert (result.outliers["tracks"] > 10).all()


def test_the_battery_from_its_labels_to_its_report(command: Command, labels: Path) -> None:
    quick = ("measure.from=projection", "measure.points=40", "world.roadside=false", "rig.frames=8")
    settings = [w for s in (f"vehicle.0.motion.labels={labels}", *quick) for w in ("--set", s)]
    result = command("study", BATTERY, "--workers", "1", "--out", "out", *settings)
    assert result.status == 0, result
    assert "2/2 runs" in result.out
    study = load_study(Path("out"))
    assert study.outliers["tracks"].max() == 40
    cars = pd.read_csv("out/table-Every car.csv")
    assert list(cars["track"]) == [3, 3, 12, 12]
    assert set(cars["frames"]) == {8}
    assert set(cars["windows failed"]) == {"0 of 6"}
    # Twice the bound: 95 % of the errors of a centred Gaussian are below 1.96 of its sigma; eight windows, some slack.
    bound = study.comparison.query("quantity == 'position' and axis == 'z' and entity == 'target'")["bound"].max()
    assert (cars["95 % position along [m]"] < 3 * bound).all()
    table = pd.read_csv("out/table.csv")
    assert set(table.loc[table["frames of"] == "manoeuvre", "which"]) == {"standing", "straight"}
    assert "Errors by occlusion" in Path("out/report.html").read_text()
