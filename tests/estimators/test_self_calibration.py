"""The error of a rectified rig is found from a moving camera's tracks alone, and none where there is none."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from estimators.estimate import EstimationFailed
from estimators.stereo.features import FrontEnd, StereoFrame
from estimators.stereo.self_calibration import RectificationError, calibrate
from estimators.stereo.triangulation import triangulate
from sim.camera import Camera, StereoRig
from sim.observations import Tracks
from sim.pose import Pose, exp_so3

RIG = StereoRig.normal_case(Camera.simple((1240, 376), 720.0, (607.0, 185.0)), 0.54)
ERROR = RectificationError(np.array([0.8, -0.3, 1.5, 0.5, -0.4]), np.array([-0.2, 0.4, 0.3, -0.5, -2.0]), np.zeros(5))
SIGMA_PX, FRAMES = 0.1, 13


def _tracks(sigma_px: float, moving: float = 0.0) -> Tracks:
    """A curve driven past points between 6 and 90 m; a share of the points moves by itself."""
    rng = np.random.default_rng(5)
    T_wc = [Pose(np.eye(3), np.zeros(3))]
    for _ in range(FRAMES - 1):
        T_wc.append(T_wc[-1] @ Pose(exp_so3(np.array([0.0, 0.03, 0.0])), np.array([0.05, 0.0, 1.0])))
    rows = []
    for k, T in enumerate(T_wc[:-1]):
        uv = rng.uniform([20, 20], [1220, 356], (250, 2))
        p = RIG.left.unproject(uv, 1 / rng.uniform(1 / 90, 1 / 6, len(uv)))
        walk = np.where(rng.random(len(uv)) < moving, 1.0, 0.0)[:, None] * [0.6, 0.0, 0.3]
        for frame, points in ((k, p), (k + 1, (T_wc[k + 1].inv() @ T).apply(p + walk))):
            uvs = RIG.project(points) + sigma_px * rng.standard_normal((len(uv), 4))
            rows += [(frame, 1000 * k + i, *x) for i, x in enumerate(uvs) if np.isfinite(x).all()]
    table = np.array(sorted(rows))
    frame, track = table[:, 0].astype(int), table[:, 1].astype(int)
    return Tracks(frame, track, table[:, 2:4], table[:, 4:], np.tile(np.eye(4), (len(table), 1, 1)))


def _spoilt(tracks: Tracks, error: RectificationError) -> Tracks:
    opposite = RectificationError(-error.disparity, -error.row, error.sigma)
    return opposite.corrected(RIG, tracks)


def _found(tracks: Tracks) -> RectificationError:
    found = calibrate(RIG, tracks)
    assert isinstance(found, RectificationError)
    return found


def test_an_error_is_found_exactly_without_noise() -> None:
    found = _found(_spoilt(_tracks(0.0), ERROR))
    np.testing.assert_allclose(found.disparity, ERROR.disparity, atol=1e-5)  # steps end at 1e-6
    np.testing.assert_allclose(found.row, ERROR.row, atol=1e-9)


def test_an_error_is_found_in_noise_among_moving_things() -> None:
    found = _found(_spoilt(_tracks(SIGMA_PX, moving=0.15), ERROR))
    # Six groups know their sigma by five degrees of freedom: Student's t leaves 4.8 once in 200.
    assert (np.abs(found.disparity - ERROR.disparity) < 4.8 * found.sigma).all()
    assert (found.sigma < 0.1).all()
    assert (np.abs(found.row - ERROR.row) < 0.1).all()  # 0.14 px in 5000 rows, extrapolated to x, y = 1


def test_a_good_rig_is_left_as_it_is() -> None:
    found = _found(_tracks(SIGMA_PX))
    assert (np.abs(found.disparity) < 4.8 * found.sigma).all()  # as above
    assert abs(found.disparity[0]) < 0.05


def test_corrected_tracks_are_those_of_the_ideal_rig() -> None:
    ideal = _tracks(0.0)
    spoilt = _spoilt(ideal, ERROR)
    assert np.abs(spoilt.uv_right - ideal.uv_right).max() > 0.5
    np.testing.assert_allclose(ERROR.corrected(RIG, spoilt).uv_right, ideal.uv_right, atol=1e-12)


def test_too_few_frames_are_a_failure_as_a_value() -> None:
    tracks = _tracks(SIGMA_PX)
    found = calibrate(RIG, tracks.select(tracks.frame < 4))
    assert isinstance(found, EstimationFailed)
    assert "3 pairs" in found.reason


def test_a_rig_that_is_not_rectified_is_refused() -> None:
    turned = StereoRig(RIG.left, RIG.right, Pose(exp_so3(np.array([0.0, 0.01, 0.0])), RIG.T_rl.t))
    with pytest.raises(ValueError, match="parallel"):
        calibrate(turned, _tracks(SIGMA_PX))


@pytest.mark.shared_data
def test_a_recording_whose_motion_comes_out_long_is_cured(shared_data: Path) -> None:
    folder = shared_data / "kitti_lead_car"
    rig = StereoRig.normal_case(Camera.simple((1241, 376), 718.856, (607.1928, 185.2157)), 386.1448 / 718.856)
    M = np.loadtxt(folder / "poses.txt")[:12].reshape(-1, 3, 4)
    names = [f"{k:06d}.png" for k in range(len(M))]
    frames = [StereoFrame(*(cv2.imread(str(folder / side / n), 0) for side in ("left", "right"))) for n in names]
    tracks = FrontEnd(points=600, distance_px=8.0, patch_px=11)(rig, frames)
    before = _scale(rig, tracks, Pose(M[:, :, :3], M[:, :, 3]))
    after = _scale(rig, _found(tracks).corrected(rig, tracks), Pose(M[:, :, :3], M[:, :, 3]))
    assert 1.05 < before < 1.15  # what plain methods give
    assert abs(after - 1) < 0.04  # 1-2 % from the choice of the polynomial, 1 % from half of the frames


def _scale(rig: StereoRig, tracks: Tracks, T_wc: Pose) -> float:
    """Median length of the motion by OpenCV's PnP against that of the poses."""
    ratios = []
    for k in range(len(T_wc) - 1):
        a, b = tracks.select(tracks.frame == k), tracks.select(tracks.frame == k + 1)
        _, i, j = np.intersect1d(a.track, b.track, return_indices=True)
        p, _ = triangulate(rig, a.uv[i], a.cov[i])
        near = np.isfinite(p).all(axis=1) & (p[:, 2] < 80)
        uv = b.uv_left[j][near]
        _, r, t, inlier = cv2.solvePnPRansac(p[near], uv, rig.left.K, None, iterationsCount=1000, reprojectionError=1.0)
        kept = inlier[:, 0]
        _, t = cv2.solvePnPRefineLM(p[near][kept], uv[kept], rig.left.K, None, r, t)
        ratios.append(np.linalg.norm(t) / np.linalg.norm((T_wc[k + 1].inv() @ T_wc[k]).t))
    return float(np.median(ratios))
