"""KITTI's text formats: what is read, and what every broken line says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sim.kitti import read_poses, read_track, read_tracks
from sim.pose import exp_so3
from sim.scenario import ScenarioError


def row(frame: int, track: int, kind: str = "Car", occluded: int = 0, x: float = 1.0, z: float = 20.0) -> str:
    """A label row: box 4, then height, width, length, then x, y, z and ry."""
    return f"{frame} {track} {kind} 0 {occluded} -1.5 100 150 200 250 1.5 1.6 4.2 {x} 1.7 {z} 0.25"


GOOD = [row(f, 2, x=0.5 * f, z=20 + f, occluded=f % 4) for f in range(3, 11)]
DONT_CARE = "3 -1 DontCare -1 -1 -10 219 188 245 218 -1000 -1000 -1000 -10 -1 -1 -1"


@pytest.fixture
def write(tmp_path: Path) -> Callable[[list[str]], Path]:
    def writer(lines: list[str]) -> Path:
        path = tmp_path / "labels.txt"
        path.write_text("\n".join(lines) + "\n")
        return path

    return writer


Writer = Callable[[list[str]], Path]


def test_a_track_is_read(write: Writer) -> None:
    lines = [row(4, 1), DONT_CARE, *reversed(GOOD), "", row(5, 7, "Pedestrian")]
    track = read_track(write(lines), 2)
    assert track.kind == "Car"
    assert track.size_m == (4.2, 1.6, 1.5)  # length, width, height
    np.testing.assert_array_equal(track.frame, np.arange(3, 11))
    np.testing.assert_allclose(track.location_c, [[0.5 * f, 1.7, 20 + f] for f in range(3, 11)])
    np.testing.assert_array_equal(track.ry, np.full(8, 0.25))
    np.testing.assert_array_equal(track.occluded, [f % 4 for f in range(3, 11)])


def test_a_score_column_is_allowed(write: Writer) -> None:
    assert len(read_track(write([line + " 0.98" for line in GOOD]), 2).frame) == 8


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1 2 Car 0 0", "expected 17 columns, found 5"),
        (row(3, 2) + " 1 2", "expected 17 columns, found 19"),
        (row(3, 2).replace("20.0", "twenty"), "not a number: 'twenty'"),
        (row(3, 2).replace("20.0", "nan"), "all numbers finite"),
        (row(3, 2).replace("20.0", "inf"), "all numbers finite"),
        (row(3, 2).replace("3 2 Car", "3.5 2 Car"), "not a number: '3.5'"),
        (row(3, 2).replace("3 2 Car", "-3 2 Car"), "frame must be >= 0"),
    ],
)
def test_a_broken_line_is_named(write: Writer, line: str, message: str) -> None:
    path = write([*GOOD[:2], line, *GOOD[2:]])
    with pytest.raises(ScenarioError, match=message) as error:
        read_track(path, 2)
    assert str(error.value).startswith(f"{path}, line 3: ")
    assert "\n" not in str(error.value)


def test_all_tracks_that_are_long_enough(write: Writer) -> None:
    lines = [*GOOD, *(row(f, 0, "Van") for f in range(20)), *(row(f, 7) for f in range(4)), *[DONT_CARE] * 9]
    path = write(lines)
    assert {n: (t.kind, len(t.frame)) for n, t in read_tracks(path).items()} == {0: ("Van", 20), 2: ("Car", 8)}
    assert list(read_tracks(path, 1)) == [0, 2]  # four frames are never enough
    assert list(read_tracks(path, 20)) == [0]
    np.testing.assert_array_equal(read_tracks(path)[2].location_c, read_track(path, 2).location_c)
    with pytest.raises(ScenarioError, match=r"vehicle\.0\.motion\.labels: cannot read"):
        read_tracks(path.with_name("none.txt"), 20, "vehicle.0.motion")


def test_a_missing_track_names_those_there(write: Writer) -> None:
    path = write([*GOOD, row(3, 5), DONT_CARE])
    with pytest.raises(ScenarioError, match=r"vehicle\.0\.motion\.track: track 9 is not in .*tracks 2, 5"):
        read_track(path, 9, "vehicle.0.motion")
    with pytest.raises(ScenarioError, match="20 tracks between 0 and 19"):
        read_track(write([row(0, i) for i in range(20)]), 99)
    with pytest.raises(ScenarioError, match="no tracks"):
        read_track(write([DONT_CARE]), 0)
    with pytest.raises(ScenarioError, match="no tracks"):
        read_track(write([]), 0)


def test_a_track_that_stands_twice_in_a_frame(write: Writer) -> None:
    with pytest.raises(ScenarioError, match="track 2 stands twice in frame 6"):
        read_track(write([*GOOD, row(6, 2)]), 2)


def test_a_track_too_short_to_be_smoothed(write: Writer) -> None:
    with pytest.raises(ScenarioError, match="has 4 frames; a replay needs at least 5"):
        read_track(write(GOOD[:4]), 2)


def test_a_track_without_a_size(write: Writer) -> None:
    with pytest.raises(ScenarioError, match="has no size"):
        read_track(write([line.replace("1.5 1.6 4.2", "-1 -1 -1") for line in GOOD]), 2)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"labels: cannot read .*none\.txt: no such file"):
        read_track(tmp_path / "none.txt", 0)
    with pytest.raises(ScenarioError, match=r"labels: cannot read .*is a directory"):
        read_track(tmp_path, 0)
    (tmp_path / "image.png").write_bytes(bytes(range(128, 256)))
    with pytest.raises(ScenarioError, match="not a text file"):
        read_track(tmp_path / "image.png", 0)


def pose_line(r: list[float], t: list[float]) -> str:
    M = np.column_stack([exp_so3(np.array(r)), t])
    return " ".join(f"{x:.6e}" for x in M.ravel())


POSES = [pose_line([0, 0.01 * i, 0], [0, 0, float(i)]) for i in range(4)]


def test_poses_are_read_as_rotations(write: Writer) -> None:
    T = read_poses(write([*POSES, ""]))
    assert len(T) == 4
    np.testing.assert_allclose(T.t, [[0, 0, i] for i in range(4)])
    np.testing.assert_allclose(T.R[3], exp_so3(np.array([0, 0.03, 0])), atol=1e-6)  # the file's digits
    # Rounded in the file, but orthogonal to double precision here.
    np.testing.assert_allclose(T.R @ np.swapaxes(T.R, 1, 2), np.broadcast_to(np.eye(3), (4, 3, 3)), atol=1e-14)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (POSES[0] + " 1", "expected 12 finite numbers, found 13"),
        ("1 0 0", "expected 12 finite numbers, found 3"),
        (POSES[0].replace("0.000000e+00", "nan", 1), "expected 12 finite numbers"),
        ("a b c", "not a number"),
        ("2 0 0 0 0 1 0 0 0 0 1 0", "not a rotation"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0", "not a rotation"),
        (pose_line([0.1, 0, 0], [0, 0, 0]).replace("9.950042e-01", "9.000000e-01", 1), "not a rotation"),
    ],
)
def test_a_broken_pose_is_named(write: Writer, line: str, message: str) -> None:
    path = write([POSES[0], line])
    with pytest.raises(ScenarioError, match=message) as error:
        read_poses(path)
    assert str(error.value).startswith(f"{path}, line 2: ")


def test_a_pose_file_without_poses(write: Writer, tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"ego\.poses: .* has no poses"):
        read_poses(write([]))
    with pytest.raises(ScenarioError, match=r"ego\.poses: cannot read"):
        read_poses(tmp_path / "none.txt")


@pytest.mark.shared_data
@pytest.mark.parametrize(("sequence", "track"), [("0004", 2), ("0000", 0), ("0003", 0), ("0010", 0)])
def test_real_labels(shared_data: Path, sequence: str, track: int) -> None:
    label = read_track(shared_data / "kitti_tracking" / f"{sequence}.txt", track)
    assert len(label.frame) >= 30
    assert (label.location_c[:, 2] > 0).any()
