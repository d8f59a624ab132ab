"""Tracked points find their true place on the body, and every way to be wrong its label."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from reports.labelling import KINDS, THRESHOLD_PX, Seen, label, noise_px, read_seen, surface_points
from sim.observations import Tracks
from sim.truth import DEPTH_SCALE, FIRST_VEHICLE, INLIER, Truth
from tests.reports.conftest import make_truth

# The body: a slanted plate, n' p = c in the vehicle frame, inside these bounds of y and z.
NORMAL, OFFSET = np.array([1.0, 0.2, -0.3]), 3.0
HALF_WIDTH, HEIGHT = 0.85, 1.4
FRAMES = 12


@dataclass(frozen=True, eq=False)
class Scene:
    """A turning plate: truth without tracks, depth images, the points (k, 3) on it and their exact tracks."""

    truth: Truth
    depth: list[np.ndarray]
    points: np.ndarray
    tracks: Tracks

    @property
    def seen(self) -> list[Seen]:
        return [Seen.of(d, d > 0) for d in self.depth]


def plate_depth(truth: Truth, frame: int) -> np.ndarray:
    """Depth at every pixel centre where the ray meets the plate, 0 elsewhere."""
    w, h = truth.rig.left.size_px
    uv = np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1).astype(float)
    ray = truth.rig.left.unproject(uv, np.ones((h, w)))
    T_vc = truth.T_cv[frame].inv()
    direction = ray @ T_vc.R.T
    depth = (OFFSET - NORMAL @ T_vc.t) / (direction @ NORMAL)
    p = T_vc.t + depth[..., None] * direction
    return np.where((np.abs(p[..., 1]) < HALF_WIDTH) & (p[..., 2] > 0) & (p[..., 2] < HEIGHT), depth, 0.0)


@pytest.fixture(scope="module")
def scene() -> Scene:
    truth = make_truth(yaw_rate=0.4, ego_speed=0.0, ego_yaw_rate=0.0)
    rng = np.random.default_rng(3)
    yz = rng.uniform([-0.7, 0.15], [0.7, 1.25], (20, 2))
    points = np.column_stack([(OFFSET - yz @ NORMAL[1:]) / NORMAL[0], yz])
    frame, track = np.repeat(np.arange(FRAMES), 20), np.tile(np.arange(20) * 3, FRAMES)
    uv = truth.rig.project(truth.T_cv[frame].apply(np.tile(points, (FRAMES, 1))))
    cov = np.tile(0.04 * np.eye(4), (len(frame), 1, 1))
    tracks = Tracks(frame, track, uv[:, :2], uv[:, 2:], cov)
    return Scene(truth, [plate_depth(truth, k) for k in range(FRAMES)], points, tracks)


def moved(tracks: Tracks, rows: np.ndarray, left: np.ndarray, right: np.ndarray | None = None) -> Tracks:
    """The tracks with some rows displaced in the left image and by the same, or otherwise, in the right one."""
    uv_left, uv_right = tracks.uv_left.copy(), tracks.uv_right.copy()
    uv_left[rows] += left
    uv_right[rows] += left if right is None else right
    return replace(tracks, uv_left=uv_left, uv_right=uv_right)


def kinds(labelled: Truth, rows: np.ndarray) -> set[str]:
    return {("inlier", *KINDS)[k] for k in labelled.labels.kind[rows]}


def test_exact_tracks_find_their_points(scene: Scene) -> None:
    """Inverse depth is linear on a plane, so interpolation between pixels is exact."""
    labelled = label(scene.truth, scene.tracks, scene.seen)
    np.testing.assert_array_equal(labelled.track, np.arange(20) * 3)
    np.testing.assert_allclose(labelled.point_v, scene.points, atol=1e-9)
    np.testing.assert_allclose(labelled.labels.uv_true, scene.tracks.uv, atol=1e-7)
    assert (labelled.labels.kind == INLIER).all()
    assert labelled.labels.sigma_px.max() < 1e-7
    np.testing.assert_array_equal(labelled.visible_points, scene.truth.visible_points)


def test_noise_is_measured_without_the_share_that_the_mean_takes(scene: Scene) -> None:
    """Errors of left and right alike, as a match to the left patch has them; 3 sigma of 480 numbers is 10 %."""
    rng = np.random.default_rng(0)
    noise = 0.15 * rng.standard_normal((len(scene.tracks), 2))
    labelled = label(scene.truth, moved(scene.tracks, np.arange(len(noise)), noise), scene.seen)
    assert labelled.labels.sigma_px[0] == pytest.approx(0.15, rel=0.10)
    assert (labelled.labels.kind == INLIER).all()


def test_every_error_has_its_label(scene: Scene) -> None:
    t = scene.tracks
    of = {k: np.flatnonzero(t.track == k) for k in (0, 3, 6, 9)}
    wrong_match, leapt, slid, beside = of[0][4:6], of[3][9:], of[6], of[9]
    tracks = moved(t, wrong_match, np.zeros(2), np.array([4.0, 0.0]))
    tracks = moved(tracks, leapt, np.array([6.0, 2.0]))
    slide = np.linspace(0, 2.4, FRAMES)[:, None] * np.array([1.0, 0.0])
    tracks = moved(tracks, slid, slide)
    tracks = moved(tracks, beside, np.array([400.0, 0.0]))
    labelled = label(scene.truth, tracks, scene.seen)
    assert kinds(labelled, wrong_match) == {"stereo"}
    assert kinds(labelled, leapt) == {"temporal"}
    assert kinds(labelled, slid) == {"drift", "inlier"}
    assert kinds(labelled, beside) == {"segmentation"}
    assert np.isnan(labelled.point_v[labelled.track == 9]).all()
    assert np.isnan(labelled.labels.uv_true[beside]).all()
    rest = np.setdiff1d(np.arange(len(t)), np.concatenate([wrong_match, leapt, slid, beside]))
    assert kinds(labelled, rest) == {"inlier"}
    np.testing.assert_allclose(labelled.point_v[labelled.track == 3], scene.points[1:2], atol=1e-9)
    slid_error = np.linalg.norm((tracks.uv - labelled.labels.uv_true)[slid, :2], axis=1)
    np.testing.assert_array_equal(labelled.labels.kind[slid] != INLIER, slid_error > THRESHOLD_PX)


def test_a_step_in_depth_is_not_averaged() -> None:
    """Beside a plate at 10 m another at 20 m of the same body, and nothing on the right."""
    depth = np.zeros((5, 9))
    depth[:, 1:4], depth[:, 4:7] = 10.0, 20.0
    seen = Seen.of(depth, depth > 0)
    uv = np.array(
        [[2.5, 2.0], [3.3, 2.2], [3.7, 2.2], [6.4, 2.0], [6.9, 2.0], [7.1, 2.0], [0.2, 2.0], [-3.0, 2.0], [5.0, 99.0]]
    )
    found = 1 / seen.inverse_depth_at(uv, 1000.0)
    np.testing.assert_allclose(found, [10, 10, 20, 20, 20, np.nan, 10, np.nan, np.nan])


def test_a_target_that_is_not_seen_has_no_points(scene: Scene) -> None:
    nothing = [Seen.of(np.zeros_like(d), d > 1e9) for d in scene.depth]
    assert np.isnan(surface_points(scene.truth, scene.tracks, nothing)).all()
    labelled = label(scene.truth, scene.tracks, nothing)
    assert kinds(labelled, np.arange(len(scene.tracks))) == {"segmentation"}
    assert np.isnan(labelled.labels.sigma_px).all()


def test_no_tracks_can_be_labelled(scene: Scene) -> None:
    labelled = label(scene.truth, Tracks.none(), scene.seen)
    assert len(labelled.track) == len(labelled.labels.kind) == 0
    assert labelled.point_v.shape == (0, 3)


def test_depth_images_are_read_as_they_are_written(scene: Scene, tmp_path: Path) -> None:
    """Rounded to 1/256 m; another vehicle is not the target."""
    for kind, image in (
        ("depth", np.rint(scene.depth[0] * DEPTH_SCALE).astype(np.uint16)),
        (
            "instance",
            np.where(np.arange(1024) < 480, FIRST_VEHICLE + 1, FIRST_VEHICLE).astype(np.uint16) * (scene.depth[0] > 0),
        ),
    ):
        (tmp_path / kind / "left").mkdir(parents=True)
        cv2.imwrite(str(tmp_path / kind / "left" / "000000.png"), image.astype(np.uint16))
    pictures = read_seen(tmp_path, scene.truth)
    seen = next(pictures)
    v, u = np.nonzero((scene.depth[0] > 0) & (np.arange(1024) != 479))  # which touches the target
    found = 1 / seen.inverse_depth_at(np.column_stack([u, v]).astype(float), 1000.0)
    expected = np.where(u < 480, np.nan, scene.depth[0][v, u])
    np.testing.assert_allclose(found, expected, atol=0.5 / DEPTH_SCALE)
    assert np.isfinite(expected).any()
    assert np.isnan(expected).any()
    with pytest.raises(ValueError, match=r"000001.png: missing or broken"):
        next(pictures)


def test_noise_needs_more_rows_than_tracks() -> None:
    assert np.isnan(noise_px(np.ones((3, 4)), np.arange(3)))
    assert noise_px(np.array([[1.0], [-1.0]]), np.zeros(2, int)) == pytest.approx(np.sqrt(2))
