"""The image front end on images whose every grey value is known: a textured board before a textured wall."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from estimators.stereo.features import FrontEnd, ImageError, StereoFrame, read_frames, registration
from estimators.stereo.features.templates import cut, register
from estimators.stereo.triangulation import triangulate
from sim.camera import StereoRig
from sim.observations import Observations, Tracks
from sim.pose import Pose, exp_so3
from tests.board import BASE, FOCAL, FRAMES, RIG, SIZE, WALL_M, Board, texture

Array = np.ndarray


@pytest.fixture(scope="module")
def frames() -> list[StereoFrame]:
    return list(Board().frames())


@pytest.fixture(scope="module")
def tracks(frames: list[StereoFrame]) -> Tracks:
    return FrontEnd(points=100)(RIG, frames)


def test_points_are_where_they_should_be(tracks: Tracks) -> None:
    off = Board().errors(tracks)
    inlier = (np.abs(off) < 1).all(axis=1)
    assert inlier.mean() > 0.97
    sigma = 1.4826 * np.median(np.abs(off[inlier]), axis=0)
    assert (sigma < 0.1).all()
    disparity = (off[inlier, 0] - off[inlier, 2]).mean()
    assert abs(disparity) < 0.01  # a hundredth of a pixel: a noise of 0.05 px over thousands of rows leaves 0.001


def test_tracks_are_many_and_live_on(tracks: Tracks) -> None:
    per_frame = np.bincount(tracks.frame, minlength=FRAMES)
    assert per_frame.min() >= 60
    _, life = np.unique(tracks.track, return_counts=True)
    assert life.mean() > 0.5 * FRAMES


def test_the_stated_covariance_is_about_right() -> None:
    """Noise of 15 grey levels outdoes what is stated beyond the residuals; the board has no drift."""
    board = Board(noise=15.0)
    tracks = FrontEnd(points=100, drift_px=0.0)(RIG, board.frames())
    off = board.errors(tracks)
    inlier = (np.abs(off) < 1).all(axis=1)
    nees = np.einsum("ni,nij,nj->n", off[inlier], np.linalg.inv(tracks.cov[inlier]), off[inlier]) / 4
    assert 0.5 < nees.mean() < 1.3  # of thousands of coordinates: 0.03 by chance; floors make it cautious


def test_drift_is_common_to_left_and_right(frames: list[StereoFrame], tracks: Tracks) -> None:
    steady = FrontEnd(points=100, drift_px=0.0)(RIG, frames)
    added = tracks.cov - steady.cov
    assert np.allclose(added, FrontEnd().drift_px ** 2 * np.kron(np.ones((2, 2)), np.eye(2)), atol=1e-12)


def test_a_slanted_surface_keeps_its_disparity() -> None:
    """The right image squeezed by 4 %, as a plane seen obliquely: asymmetric patches must not be drawn aside."""
    u, v = np.meshgrid(np.arange(200.0), np.arange(200.0))
    x = (u - 100) / 0.96 + 100
    left, right = (np.clip(np.rint(texture(c / 50, v / 50, 1)), 0, 255).astype(np.uint8) for c in (u, x))
    uv = np.stack(np.meshgrid(np.arange(30, 170, 12.0), np.arange(30, 170, 12.0)), axis=-1).reshape(-1, 2)
    eye = np.tile(np.eye(2), (len(uv), 1, 1))
    patch, weight, _ = cut(left, np.empty((0, 0), bool), uv, eye, 9)
    true = np.column_stack([0.96 * (uv[:, 0] - 100) + 100, uv[:, 1]])
    rms = []
    for free in (registration.TRANSLATION, registration.STEREO):
        r = register(right, patch, weight, np.rint(true), eye, free, 0.02)
        assert r.good.mean() > 0.9
        rms.append(np.sqrt(np.mean((r.t - true)[r.good, 0] ** 2)))
    assert rms[1] < 0.5 * rms[0]


def test_no_track_leaves_the_mask(frames: list[StereoFrame], tracks: Tracks) -> None:
    for k, frame in enumerate(frames):
        at = np.rint(tracks.uv_left[tracks.frame == k]).astype(int)
        assert frame.mask is not None
        assert frame.mask[at[:, 1], at[:, 0]].all()


def test_without_masks_the_whole_image_is_tracked(frames: list[StereoFrame]) -> None:
    everything = FrontEnd(points=300, distance_px=6)(RIG, [replace(f, mask=None) for f in frames[:4]])
    last = everything.frame == 3
    disparity = everything.uv_left[last, 0] - everything.uv_right[last, 0]
    near = disparity > 2 * FOCAL * BASE / WALL_M
    assert near.sum() > 30
    assert (~near).sum() > 30


def test_what_moves_by_itself_is_found_without_masks(frames: list[StereoFrame]) -> None:
    found = FrontEnd(points=80, segmentation="motion")(RIG, [replace(f, mask=None) for f in frames])
    assert len(found) > 200
    masks = [f.mask for f in frames]
    at = np.rint(found.uv_left).astype(int)
    on_board = [bool(m[v, u]) for m, (u, v) in zip((masks[k] for k in found.frame), at, strict=True) if m is not None]
    assert np.mean(on_board) > 0.9


def test_the_same_frames_give_the_same_tracks(frames: list[StereoFrame], tracks: Tracks) -> None:
    again = FrontEnd(points=100)(RIG, frames)
    assert np.array_equal(again.uv, tracks.uv)
    assert np.array_equal(again.cov, tracks.cov)


@pytest.mark.parametrize("value", [0, 128, 255])
def test_images_without_content_give_nothing(value: int) -> None:
    flat = np.full(SIZE[::-1], value, np.uint8)
    found = FrontEnd()(RIG, [StereoFrame(flat, flat, np.ones_like(flat, bool))] * 3)
    assert len(found) == 0


def test_an_empty_mask_gives_nothing_until_it_is_filled(frames: list[StereoFrame]) -> None:
    nothing = np.zeros(SIZE[::-1], bool)
    found = FrontEnd()(RIG, [replace(frames[0], mask=nothing), *frames[1:4]])
    assert set(found.frame.tolist()) == {1, 2, 3}


def test_swapped_images_are_refused(frames: list[StereoFrame]) -> None:
    swapped = [StereoFrame(f.right, f.left) for f in frames[:4]]
    with pytest.raises(ImageError, match="left and right images are swapped"):
        FrontEnd(points=200, distance_px=6)(RIG, swapped)


def test_images_of_another_size_are_refused(frames: list[StereoFrame]) -> None:
    f = frames[0]
    with pytest.raises(ImageError, match="the left image is 300 x 240 px"):
        FrontEnd()(RIG, [StereoFrame(f.left[:, :300], f.right[:, :300])])


@pytest.mark.parametrize(("name", "value"), [("points", 0), ("patch_px", 8), ("correlation", 1.0), ("margin_px", -1)])
def test_a_wrong_configuration_is_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"FrontEnd.{name}: {value} is out of range"):
        FrontEnd(**{name: value})  # type: ignore[arg-type]  # on purpose


def test_registration_has_no_preference_for_whole_pixels() -> None:
    """Shifts of all fractions of a pixel, as the mean over many patches."""
    u, v = np.meshgrid(np.arange(200.0), np.arange(200.0))
    image = np.clip(np.rint(texture(u / 50, v / 50, 1)), 0, 255).astype(np.uint8)
    uv = np.stack(np.meshgrid(np.arange(20, 180, 12.0), np.arange(20, 180, 12.0)), axis=-1).reshape(-1, 2)
    eye = np.tile(np.eye(2), (len(uv), 1, 1))
    patch, weight, good = cut(image, np.empty((0, 0), bool), uv, eye, 9)
    assert good.all()
    bias = []
    for shift in (0.1, 0.3, 0.5, 0.7, 0.9):
        moved = np.clip(np.rint(texture((u - shift) / 50, v / 50, 1)), 0, 255).astype(np.uint8)
        r = register(moved, patch, weight, uv, eye, registration.TRANSLATION)
        assert r.good.mean() > 0.95
        bias.append((r.t[r.good] - uv[r.good] - [shift, 0]).mean(axis=0))
    assert np.abs(bias).max() < 0.015  # waves of five pixels, near what bicubic interpolation can carry
    assert np.abs(np.mean(bias, axis=0)).max() < 0.002


def test_a_known_warp_is_found() -> None:
    u, v = np.meshgrid(np.arange(200.0), np.arange(200.0))
    image = np.clip(np.rint(texture(u / 50, v / 50, 1)), 0, 255).astype(np.uint8)
    A = np.array([[1.05, 0.03], [-0.02, 0.97]])
    inverse = np.linalg.inv(A)
    x, y = inverse @ np.stack([(u - 100).ravel(), (v - 100).ravel()])
    warped = texture((x.reshape(u.shape) + 100) / 50, (y.reshape(u.shape) + 100) / 50, 1)
    warped = np.clip(np.rint(0.8 * warped + 20), 0, 255).astype(np.uint8)
    uv = np.array([[100.0, 100.0]])
    patch, weight, _ = cut(image, np.empty((0, 0), bool), uv, np.eye(2)[None], 21)
    r = register(warped, patch, weight, uv + 0.6, np.eye(2)[None], registration.AFFINE, iterations=30)
    assert r.good.all()
    assert np.abs(r.t - uv).max() < 0.02
    assert np.abs(r.A[0] - A).max() < 0.01


class Recording:
    """Image files of a sequence, and the observations that name them."""

    def __init__(self, folder: Path, frames: list[StereoFrame]) -> None:
        self.folder, names = folder, []
        for k, f in enumerate(frames):
            names.append((f"left{k}.png", f"right{k}.png"))
            self.write(names[k][0], f.left)
            self.write(names[k][1], f.right)
        empty = np.empty(0, int)
        none = Tracks(empty, empty, np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 4, 4)))
        self.observations = Observations(np.arange(len(frames)) / 25, RIG, none, images=tuple(names))

    def write(self, name: str, image: Array) -> None:
        assert cv2.imwrite(str(self.folder / name), image)

    def read(self) -> list[StereoFrame]:
        return list(read_frames(self.observations, self.folder))


@pytest.fixture
def recording(tmp_path: Path, frames: list[StereoFrame]) -> Recording:
    return Recording(tmp_path, frames[:2])


def test_files_are_read_back(recording: Recording, frames: list[StereoFrame]) -> None:
    found = recording.read()
    assert np.array_equal(found[1].right, frames[1].right)
    assert found[1].mask is None


def test_colour_and_sixteen_bits_become_grey(recording: Recording, frames: list[StereoFrame]) -> None:
    left = frames[0].left
    recording.write("left0.png", np.dstack([left] * 3))
    wide = left.astype(np.uint16) * 100
    recording.write("right0.png", wide)
    found = recording.read()[0]
    assert np.array_equal(found.left, left)
    stretched = (wide - wide.min()) * 255.0 / (wide.max() - wide.min())
    assert np.abs(found.right - stretched).max() <= 1


def test_files_that_cannot_be_used_are_named(recording: Recording, frames: list[StereoFrame]) -> None:
    recording.write("left1.png", frames[0].left[:100])
    with pytest.raises(ImageError, match=r"left1.png: is 320 x 100 px, the rig 320 x 240 px"):
        recording.read()
    (recording.folder / "left1.png").write_bytes(b"\x89PNG\r\n broken")
    with pytest.raises(ImageError, match=r"left1.png: cannot be read as an image"):
        recording.read()
    (recording.folder / "left1.png").unlink()
    with pytest.raises(ImageError, match=r"left1.png: no such image"):
        recording.read()


def test_a_turned_rig_is_followed_too() -> None:
    """The right camera turned by a degree: points lie on slanted lines, some pixels above or below."""
    turned = StereoRig(RIG.left, RIG.right, Pose(exp_so3(np.deg2rad([0.5, 0, 0.3])), np.zeros(3)) @ RIG.T_rl)
    frames = []
    for f in Board().frames():
        K = np.array(RIG.left.K)
        H = K @ exp_so3(np.deg2rad([0.5, 0, 0.3])) @ np.linalg.inv(K)
        frames.append(replace(f, right=cv2.warpPerspective(f.right, H, SIZE, flags=cv2.INTER_CUBIC)))
    found = FrontEnd(points=80)(turned, frames)
    assert len(found) > 500
    assert np.abs(np.median(found.uv_right[:, 1] - found.uv_left[:, 1])) > 1
    on_board = np.array([Board().middle(k)[2] for k in found.frame])
    points, _ = triangulate(turned, found.uv, found.cov)
    assert abs(np.nanmedian(points[:, 2] / on_board) - 1) < 0.01
