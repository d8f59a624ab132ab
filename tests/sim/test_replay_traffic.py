"""The other vehicles of a label file: they drive where and when they are labelled, and hide what they hide."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim.scenario import Road, Scenario, ScenarioError
from sim.simulate import simulate
from sim.world import build_world

FRAMES = 12


def row(frame: int, track: int, kind: str, occluded: int, x: float, z: float) -> str:
    size = "2.4 2.0 4.2" if kind == "Van" else "1.5 1.7 4.2"
    return f"{frame} {track} {kind} 0 {occluded} 0 0 0 0 0 {size} {x} 1.65 {z} -1.5708"


@pytest.fixture
def labels(tmp_path: Path) -> Path:
    """A car that stands at 30 m, and one at 12 m before it, labelled in six frames only; a cyclist; a short track."""
    rows = [row(f, 0, "Car", 2 if 4 <= f < 10 else 0, 0.0, 30.0) for f in range(FRAMES)]
    rows += [row(f, 1, "Van", 0, 0.0, 12.0) for f in range(4, 10)]
    rows += [row(f, 2, "Cyclist", 0, 0.0, 8.0) for f in range(FRAMES)]
    rows += [row(f, 3, "Car", 0, 0.0, 8.0) for f in range(3)]
    rows += [row(f, 4, "Car", 0, 0.0, 8.0) for f in range(50, 60)]
    path = tmp_path / "labels.txt"
    path.write_text("\n".join(rows) + "\n")
    return path


def scenario(labels: Path, traffic: bool, poses: Path | None = None) -> Scenario:
    motion = {"kind": "labels", "labels": labels, "track": 0, "traffic": traffic}
    return Scenario.model_validate(
        {
            "title": "t",
            "kind": "stereo",
            "rig": {"rate_hz": 10.0, "height_m": 1.65},
            "ego": {"poses": poses},
            "world": {"roadside": False},
            "render": {"enabled": False},
            "vehicle": [{"name": "target", "mesh": "label", "motion": motion}],
        }
    )


def test_what_hides_the_target_is_in_the_world(labels: Path) -> None:
    spec = scenario(labels, traffic=True)
    world = build_world(spec)
    assert [a.name for a in world.actors] == ["target", "track 1"]
    _, truth = simulate(spec, 0, world)
    hidden = (np.arange(FRAMES) >= 4) & (np.arange(FRAMES) < 10)
    assert (truth.visible_points[~hidden] > 100).all()  # of 480 on the whole body, those on its rear
    assert (truth.visible_points[hidden] == 0).all()  # right behind the van


def test_without_traffic_the_label_says_what_is_hidden(labels: Path) -> None:
    spec = scenario(labels, traffic=False)
    world = build_world(spec)
    assert [a.name for a in world.actors] == ["target"]
    assert world.actors[0].occlusion is not None
    np.testing.assert_array_equal(world.actors[0].occlusion, [0] * 4 + [2] * 6 + [0] * 2)
    _, truth = simulate(spec, 0, world)
    assert (truth.visible_points > 0).all()


def test_too_few_camera_poses_for_the_others(labels: Path, tmp_path: Path) -> None:
    short = labels.read_text().splitlines()
    short += [row(f, 5, "Car", 0, 3.0, 20.0) for f in range(8, 20)]
    labels.write_text("\n".join(short) + "\n")
    poses = tmp_path / "poses.txt"
    poses.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * FRAMES)
    build_world(scenario(labels, False, poses))
    with pytest.raises(ScenarioError, match=r"ego\.poses: .*12 camera poses, but the label goes to frame 19"):
        build_world(scenario(labels, True, poses))


def test_nothing_invented_hides_what_was_seen(labels: Path) -> None:
    """The street would have a tree before a car beside it that the label saw (53 of the points would be left)."""
    labels.write_text("\n".join(row(f, 0, "Car", 0, 10.0, 30.0) for f in range(FRAMES)) + "\n")
    free = scenario(labels, traffic=False)
    free = free.model_copy(update={"rig": free.rig.model_copy(update={"frames": 1})})
    street = free.model_copy(update={"world": Road()})
    np.testing.assert_array_equal(simulate(street)[1].visible_points, simulate(free)[1].visible_points)
