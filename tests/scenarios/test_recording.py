"""Real images: a board whose motion is known as a recording on disk, wrong input, and the recordings at hand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from estimators.stereo.features import StereoFrame
from estimators.stereo.features.box import follow_box
from sim.camera import Camera, StereoRig
from tests.board import BASE, FOCAL, FRAMES, HALF_M, RIG, SIZE, Board
from tests.scenarios.conftest import Command

Array = np.ndarray


def box_of(k: int) -> Array:
    """The board's outline in the left image."""
    X = Board().middle(k)
    half = np.array(HALF_M)
    corners = np.array([[*(X[:2] - half), X[2]], [*(X[:2] + half), X[2]]])
    return np.asarray(RIG.left.project(corners).ravel())


@dataclass(frozen=True)
class Files:
    """A recording of the board on disk; the camera stands, what moves is the board alone."""

    folder: Path

    @property
    def settings(self) -> list[str]:
        keys = {"left": "left", "right": "right", "calib": "calib.txt"}
        return [f"recording.{key}={self.folder / name}" for key, name in keys.items()]

    def image(self, side: str, k: int) -> Path:
        return self.folder / side / f"{k:06d}.png"


@pytest.fixture
def files(tmp_path: Path) -> Files:
    found = Files(tmp_path / "recording")
    for k, frame in enumerate(Board().frames()):
        for side, image in (("left", frame.left), ("right", frame.right)):
            found.image(side, k).parent.mkdir(parents=True, exist_ok=True)
            assert cv2.imwrite(str(found.image(side, k)), image)
    c = RIG.left.K[:2, 2]
    left = [FOCAL, 0, c[0], 0, 0, FOCAL, c[1], 0, 0, 0, 1, 0]
    right = [*left[:3], -FOCAL * BASE, *left[4:]]
    rows = [" ".join(map(str, row)) for row in (left, right)]
    (found.folder / "calib.txt").write_text("P0: " + "\nP1: ".join(rows) + "\n")
    (found.folder / "boxes.txt").write_text("0 " + " ".join(f"{v:.1f}" for v in box_of(0)) + "\n")
    return found


def run(command: Command, files: Files, *more: str) -> tuple[int, str]:
    settings = [part for s in (*files.settings, *more) for part in ("--set", s)]
    result = command("run", "recording", *settings, "--estimator", "robust", "--out", "out")
    return result.status, result.err


def test_a_box_is_followed() -> None:
    frames = [StereoFrame(f.left, f.right) for f in Board().frames()]
    followed = list(follow_box(frames, {0: box_of(0)}, 40.0))
    for k, boxed in enumerate(followed):
        assert boxed.box is not None
        assert np.abs(boxed.box - box_of(k)).max() < 3
        assert boxed.disparity == pytest.approx(FOCAL * BASE / Board().middle(k)[2], rel=0.02)


def test_a_vehicle_in_a_box(command: Command, files: Files) -> None:
    boxes = f"recording.boxes={files.folder / 'boxes.txt'}"
    status, err = run(command, files, "recording.target=box", boxes, "recording.rate_hz=25")
    assert status == 0, err
    motions = pd.read_csv("out/motions.csv")
    found = motions.set_index("frame")
    last = FRAMES - 1
    assert found.loc[last, "distance_m"] == pytest.approx(Board().middle(last)[2], rel=0.01)
    step = Board().middle(last) - Board().middle(last - 1)
    assert found.loc[last, "speed_mps"] == pytest.approx(25 * np.linalg.norm(step), abs=1.0)
    metrics = pd.read_csv("out/metrics.csv", keep_default_na=False)
    assert {"epipolar", "sigma_0", "distance_ratio"} <= set(metrics["quantity"])
    assert "block matching" in Path("out/report.html").read_text()


def test_the_camera_stands_before_a_standing_scene(command: Command, files: Files) -> None:
    """The board is left out by its boxes in every frame; the wall says that nothing moves."""
    lines = [f"{k} " + " ".join(f"{v:.1f}" for v in np.clip(box_of(k), 0, 239)) for k in range(FRAMES)]
    (files.folder / "boxes.txt").write_text("\n".join(lines))
    (files.folder / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * FRAMES)
    more = [f"recording.{key}={files.folder / key}.txt" for key in ("boxes", "poses")]
    more += ["front_end.points=200", "recording.self_calibrate=false"]
    status, err = run(command, files, *more)
    assert status == 0, err
    motions = pd.read_csv("out/motions.csv")
    assert len(motions) == FRAMES - 1
    assert motions["rotation_error_deg"].max() < 0.02
    assert motions["translation_error_m"].median() < 0.02  # a wall at 30 m: 0.02 px of 4 px disparity are 0.15 m


def test_a_second_run_comes_from_the_cache(command: Command, files: Files) -> None:
    stage = ("--stage", "track", "--out", "out")
    settings = [p for s in (*files.settings, "front_end.points=100") for p in ("--set", s)]
    assert command("run", "recording", *settings, *stage).status == 0
    result = command("run", "recording", *settings, *stage)
    assert "track  from cache" in result.out


def break_size(files: Files) -> None:
    cv2.imwrite(str(files.image("right", 3)), np.zeros((100, 100), np.uint8))


def break_file(files: Files) -> None:
    files.image("left", 2).write_bytes(b"\x89PNG broken")


def remove_frame(files: Files) -> None:
    files.image("right", 4).unlink()


def swap_sides(files: Files) -> None:
    (files.folder / "left").rename(files.folder / "x")
    (files.folder / "right").rename(files.folder / "left")
    (files.folder / "x").rename(files.folder / "right")


def short_poses(files: Files) -> None:
    (files.folder / "boxes.txt").write_text("0 1 2 3\n")


@pytest.mark.parametrize(
    ("broken", "more", "said"),
    [
        (break_size, [], "000003.png: is 100 x 100 px, the rig 320 x 240 px"),
        (break_file, [], "000002.png: cannot be read as an image"),
        (remove_frame, [], "recording.right: has no image '000004', the other side has"),
        (swap_sides, [], "left and right images are swapped"),
        (None, ["recording.left=nowhere"], "is not a folder"),
        (None, ["recording.target=box"], "recording.boxes: target 'box' needs a file"),
        (None, ["recording.focal_px=500"], "calib: give either a file or focal_px, principal_px and baseline_m"),
        (None, ["recording.cameras=[2,3]"], "has 2 matrices of 12 numbers, none number 2"),
        (None, ["recording.poses=nowhere.txt"], "recording.poses: cannot read"),
        (short_poses, ["recording.boxes=recording/boxes.txt"], "line 1: expected frame left top right bottom"),
        (None, ["front_end.patch_px=8"], "FrontEnd.patch_px: 8 is out of range"),
        (None, ["recording.target=car"], "recording.target: found 'car'"),
    ],
)
def test_wrong_input_is_one_line(command: Command, files: Files, broken: object, more: list[str], said: str) -> None:
    if callable(broken):
        broken(files)
    status, err = run(command, files, *more)
    assert status == 2
    assert said in err
    assert len(err.strip().splitlines()) == 1


def test_what_is_missing_is_named(command: Command) -> None:
    result = command("run", "recording")
    assert result.status == 2
    assert "recording.left: key is missing" in result.err


@pytest.mark.parametrize("value", [0, 128])
def test_images_without_content_fail_as_values(command: Command, files: Files, value: int) -> None:
    for k in range(FRAMES):
        for side in ("left", "right"):
            cv2.imwrite(str(files.image(side, k)), np.full(SIZE[::-1], value, np.uint8))
    result = command("run", "recording", *[p for s in files.settings for p in ("--set", s)], "--out", "out")
    assert result.status == 1
    assert "gave nothing" in result.out
    assert Path("out/report.html").is_file()


FARTHEST_PX = 645.24 * 0.5707 / 80
KARLSRUHE = StereoRig.normal_case(Camera.simple((1344, 391), 645.24, (635.96, 194.13)), 0.5707)


def lucas_kanade(a: Array, b: Array, uv: Array) -> tuple[Array, Array]:
    """OpenCV's tracker with its own settings, there and back."""
    there, seen, _ = cv2.calcOpticalFlowPyrLK(a, b, uv, None)
    back, seen_back, _ = cv2.calcOpticalFlowPyrLK(b, a, there, None)
    return there, (seen[:, 0] > 0) & (seen_back[:, 0] > 0) & (np.linalg.norm(back - uv, axis=1) < 0.5)


def pnp(shared: Path, rng: np.random.Generator) -> tuple[Array, Array]:
    """Rotation vector [rad] and translation [m] of the camera by OpenCV alone: 1000 corners, Lucas-Kanade, PnP with
    RANSAC; and their standard deviations by bootstrap."""
    left, right, later = (cv2.imread(str(shared / f"karlsruhe_stereo/I{n}.png"), 0) for n in ("1p", "2p", "1c"))
    corners = cv2.goodFeaturesToTrack(left, 1000, 0.005, 8).reshape(-1, 2)
    matched, good = lucas_kanade(left, right, corners)
    uv, good_later = lucas_kanade(left, later, corners)
    disparity = corners[:, 0] - matched[:, 0]
    good &= good_later & (np.abs(corners[:, 1] - matched[:, 1]) < 1) & (disparity > FARTHEST_PX)
    depth = 645.24 * 0.5707 / disparity[good].astype(float)
    points, uv, K = KARLSRUHE.left.unproject(corners[good].astype(float), depth), uv[good], np.array(KARLSRUHE.left.K)
    assert len(points) > 400

    def solve(rows: Array) -> Array:
        _, r, t, inlier = cv2.solvePnPRansac(points[rows], uv[rows], K, None, reprojectionError=1.0)
        chosen = rows[inlier[:, 0]]
        r, t = cv2.solvePnPRefineLM(points[chosen], uv[chosen], K, None, r, t)
        return np.concatenate([r.ravel(), t.ravel()])

    drawn = [solve(rng.integers(0, len(points), len(points))) for _ in range(30)]
    return solve(np.arange(len(points))), np.std(drawn, axis=0)


@pytest.mark.shared_data
def test_the_karlsruhe_pair(command: Command, shared_data: Path, tmp_path: Path) -> None:
    """0.25 m forward and 0.6 degrees, as PnP on the same images says."""
    for side, name in (("1", "left"), ("2", "right")):
        (tmp_path / name).mkdir()
        for k, time in enumerate("pc"):
            (tmp_path / name / f"{k}.png").symlink_to(shared_data / f"karlsruhe_stereo/I{side}{time}.png")
    keys = ["left=left", "right=right", "focal_px=645.24", "principal_px=[635.96,194.13]", "baseline_m=0.5707"]
    result = command("run", "recording", *[p for k in keys for p in ("--set", f"recording.{k}")], "--out", "out")
    assert result.status == 0, result.err
    m = pd.read_csv("out/motions.csv").iloc[0]
    assert 0.5 < m["sigma_0"] < 2
    assert m["forward_m"] == pytest.approx(0.25, abs=0.05)
    assert m["rotation_deg"] == pytest.approx(0.6, abs=0.15)
    found, sigma = pnp(shared_data, np.random.default_rng(1))
    assert abs(m["distance_m"] - np.linalg.norm(found[3:])) < 3 * np.hypot(sigma[5], m["distance_sigma_m"])
    turned = np.rad2deg(np.linalg.norm(found[:3]))
    assert abs(m["rotation_deg"] - turned) < 3 * np.rad2deg(np.linalg.norm(sigma[:3]))


@pytest.fixture(scope="module")
def lead_car(shared_data: Path) -> list[str]:
    folder = shared_data / "kitti_lead_car"
    names = {"left": "left", "right": "right", "calib": "calib.txt", "poses": "poses.txt"}
    return [p for k, name in names.items() for p in ("--set", f"recording.{k}={folder / name}")]


@pytest.mark.shared_data
def test_the_camera_on_a_motorway_ramp(command: Command, lead_car: list[str]) -> None:
    result = command("run", "recording", *lead_car, "--estimator", "robust", "--out", "out")
    assert result.status == 0, result.err
    m = pd.read_csv("out/motions.csv")
    assert m["rotation_error_deg"].median() < 0.1
    assert m["translation_error_m"].median() < 0.12
    # The rectification is off by about a pixel of disparity, which is found without poses: docs/recordings.md.
    assert m["scale"].median() == pytest.approx(1, abs=0.03)
    assert "standard deviation [px]" in Path("out/report.html").read_text()


@pytest.mark.shared_data
def test_the_car_ahead(command: Command, lead_car: list[str], tmp_path: Path) -> None:
    (tmp_path / "boxes.txt").write_text("0 714 150 840 196\n")
    more = ["--set", "recording.target=box", "--set", "recording.boxes=boxes.txt"]
    result = command("run", "recording", *lead_car, *more, "--out", "out")
    assert result.status == 0, result.err
    m = pd.read_csv("out/motions.csv")
    near = m[(m["estimator"] == "robust and smooth") & (m["frame"] <= 12) & (m["frame"] >= 4)]
    assert ((near["distance_m"] / near["matched_distance_m"] - 1).abs() < 0.05).all()
    assert (near["speed_mps"] - near["matched_speed_mps"]).abs().median() < 1.5
    assert (near["speed_sigma_mps"] < 2).all()
    assert (m[m["frame"] <= 12]["tracks"] + m[m["frame"] <= 12]["rejected"]).groupby(m["frame"]).max().median() >= 20
