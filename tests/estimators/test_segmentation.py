"""The target found by its motion: a textured board before a textured wall, both seen from a rig that may drive."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from estimators.stereo.features import FrontEnd, StereoFrame
from estimators.stereo.features.rigid import Motion, distance, fit
from estimators.stereo.features.segmentation import MotionSegmentation
from sim.camera import Camera, StereoRig
from sim.pose import exp_so3

Array = np.ndarray
SIZE, FOCAL, BASE, WALL_M, HALF_M = (320, 240), 400.0, 0.3, 25.0, (1.2, 0.9)
RIG = StereoRig.normal_case(Camera.simple(SIZE, FOCAL), BASE)
FRAMES = 10
STANDS, DRIVES = (0.0, 0.0, 0.0), (0.01, 0.0, 0.2)


def texture(x: Array, y: Array, contrast: float, seed: int) -> Array:
    """Grey values at places [m] of a random pattern, coarse and fine as nature is."""
    noise = np.random.default_rng(seed).standard_normal((600, 600)).astype(np.float32)
    raster = sum(blurred / blurred.std() for blurred in (cv2.GaussianBlur(noise, (0, 0), s) for s in (2.0, 5.0, 15.0)))
    u, v = ((c / 0.05 + 300).astype(np.float32) for c in (x, y))
    return np.asarray(128 + contrast * cv2.remap(np.asarray(raster), u, v, cv2.INTER_CUBIC))


def street(board_step: tuple[float, ...], rig_step: tuple[float, ...]) -> Iterator[StereoFrame]:
    """Frames with the true mask; steps in metres a frame, across, down and ahead."""
    rng = np.random.default_rng(0)
    u, v = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    x, y = ((c - m) / FOCAL for c, m in zip((u, v), np.array(RIG.left.K)[:2, 2], strict=True))
    for k in range(FRAMES):
        rig = k * np.array(rig_step)
        X = np.array([-1.0, 0.2, 14.0]) + k * np.array(board_step) - rig
        images = []
        for right in (False, True):
            deep = WALL_M - rig[2]
            wall = texture(x * deep + right * BASE + rig[0], y * deep + rig[1], 8.0, 2)
            across, down = x * X[2] + right * BASE - X[0], y * X[2] - X[1]
            inside = (np.abs(across) < HALF_M[0]) & (np.abs(down) < HALF_M[1])
            grey = np.where(inside, texture(across, down, 25.0, 1), wall) + 2.0 * rng.standard_normal(x.shape)
            images.append((np.clip(np.rint(grey), 0, 255).astype(np.uint8), inside))
        yield StereoFrame(images[0][0], images[1][0], images[0][1])


def overlaps(frames: list[StereoFrame]) -> tuple[Array, Array]:
    """Intersection over union with the true mask, and how many pixels are marked, per frame."""
    segment = MotionSegmentation(RIG)
    shares, counts = [], []
    for f in frames:
        mask = segment(f)
        assert f.mask is not None
        shares.append((mask & f.mask).sum() / max((mask | f.mask).sum(), 1))
        counts.append(mask.sum())
    return np.array(shares), np.array(counts)


@pytest.mark.parametrize(
    ("board_step", "rig_step"),
    [
        pytest.param((0.04, 0.0, 0.0), STANDS, id="across, a pixel a frame"),
        pytest.param((0.0, 0.0, -0.5), STANDS, id="oncoming"),
        pytest.param((0.0, 0.0, 0.2), DRIVES, id="ahead, as fast as the rig"),
        pytest.param((0.0, 0.0, -0.3), DRIVES, id="oncoming, seen from a rig that drives"),
    ],
)
def test_what_moves_slowly_is_found_and_kept(board_step: tuple[float, ...], rig_step: tuple[float, ...]) -> None:
    share, _ = overlaps(list(street(board_step, rig_step)))
    assert share[0] == 0  # nothing has moved yet
    assert (share[3:] > 0.5).all()  # a hull of corners leaves the rim out


def test_nothing_is_found_where_nothing_moves() -> None:
    _, marked = overlaps(list(street(STANDS, STANDS)))
    assert (marked == 0).all()


def test_little_is_found_where_only_the_rig_moves() -> None:
    """Edges of the board slide over the wall behind it, which some points take for motion."""
    _, marked = overlaps(list(street(STANDS, DRIVES)))
    assert np.mean(marked > 0) <= 0.2


def test_flat_images_and_the_first_frame_have_no_target() -> None:
    flat = np.full(SIZE[::-1], 90, np.uint8)
    segment = MotionSegmentation(RIG)
    assert not any(segment(StereoFrame(flat, flat)).any() for _ in range(3))


def test_tracks_of_the_front_end_are_on_what_moves() -> None:
    frames = list(street((0.04, 0.0, -0.2), DRIVES))
    tracks = FrontEnd(points=60, segmentation="motion")(RIG, frames)
    at = np.rint(tracks.uv_left).astype(int)
    masks = np.array([f.mask for f in frames])
    assert len(tracks) > 200
    assert masks[tracks.frame, at[:, 1], at[:, 0]].mean() > 0.95


def moved(seed: int, turn: float, sigma: float) -> tuple[Motion, Array, Array, Array]:
    """A motion, points as triangulated before, and what is seen of them now."""
    rng = np.random.default_rng(seed)
    p = rng.uniform([-6, -2, 8], [6, 2, 40], (2000, 3))
    true = Motion(exp_so3(np.array([0.01, turn, -0.01])), np.array([0.1, -0.05, -0.8]), sigma**2)

    def seen(x: Array) -> Array:
        right = RIG.T_rl.apply(x)
        return np.concatenate([x[:, :2] / x[:, 2:], right[:, :2] / right[:, 2:]], axis=1)

    before = seen(p) + sigma * rng.standard_normal((len(p), 4))
    z = BASE / (before[:, 0] - before[:, 2])
    noisy = np.column_stack([before[:, 0], (before[:, 1] + before[:, 3]) / 2, np.ones(len(p))]) * z[:, None]
    return true, noisy, seen(true.apply(p)) + sigma * rng.standard_normal((len(p), 4)), np.ones(len(p))


def test_the_squared_distance_is_chi_square_of_four_degrees() -> None:
    true, p, xy, one = moved(1, 0.02, 1e-4)
    d = distance(RIG.T_rl, true, p, xy, one * true.variance)
    assert d.mean() == pytest.approx(4, abs=4 * np.sqrt(8 / len(d)))  # variance of chi-square: 8


def test_a_motion_is_fitted_among_points_that_do_not_follow_it() -> None:
    true, p, xy, one = moved(2, 0.02, 1e-4)
    xy[::4, 0] += 0.02
    start = Motion(np.eye(3), np.zeros(3), 1e-10)
    found = fit(RIG.T_rl, start, p, xy, one, np.full(6, 10.0))
    assert np.allclose(found.R, true.R, atol=1e-4)
    assert np.allclose(found.t, true.t, atol=0.01)
    assert np.sqrt(found.variance) == pytest.approx(1e-4, rel=0.5)  # a quarter that is off raises the median
