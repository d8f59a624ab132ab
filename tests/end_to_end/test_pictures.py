"""A rendered run with every kind of outlier: images, true depth, masks and flow, labels and report belong together."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from reports.labelling import label, read_seen
from sim.camera import Camera
from sim.observations import Observations, Tracks
from sim.truth import Truth
from tests.end_to_end.conftest import run

SETTINGS = (
    "rig.frames=8",
    "rig.size_px=[400, 300]",
    "rig.focal_px=390.0",
    "vehicle.0.motion.start_m=[-3.5, 18.0]",
    "vehicle.1.motion.start_m=[0.0, 16.0]",
    "render.flow=true",
    "measure.points=60",
    "measure.missing_frames=[5]",
    "outliers=[{kind='noise',tracks=0.1,frames=3},{kind='stereo',tracks=0.1},{kind='temporal',tracks=0.1},"
    "{kind='segmentation',tracks=0.1,on='van ahead'},{kind='segmentation',tracks=0.1},{kind='reflection',tracks=0.1}]",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("run") / "out"
    result = run("oncoming", out, *SETTINGS)
    assert result.returncode == 0, result
    return out


def read(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None, path
    return np.asarray(image)


def camera_of(truth: Truth, side: str) -> Camera:
    return truth.rig.left if side == "left" else truth.rig.right


def test_every_frame_has_its_pictures(folder: Path) -> None:
    observations = Observations.load(folder / "observations")
    assert observations.images is not None
    assert len(observations.images) == 8
    for pair in observations.images:
        for name in pair:
            assert read(folder / "observations" / name).shape == (300, 400, 3)
    for side in ("left", "right"):
        assert len(list((folder / "truth" / "depth" / side).iterdir())) == 8
        assert len(list((folder / "truth" / "instance" / side).iterdir())) == 8
        assert len(list((folder / "truth" / "flow" / side).iterdir())) == 7


@pytest.mark.parametrize("side", ["left", "right"])
def test_inliers_lie_on_the_target_of_the_mask_at_their_depth(folder: Path, side: str) -> None:
    observations, truth = Observations.load(folder / "observations"), Truth.load(folder / "truth")
    good = (truth.labels.kind == 0) & np.isin(observations.tracks.track, truth.track[np.isfinite(truth.point_v[:, 0])])
    on_mask, deviations = [], []
    for k in range(8):
        rows = np.flatnonzero(good & (observations.tracks.frame == k))
        uv = truth.labels.uv_true[rows][:, :2] if side == "left" else truth.labels.uv_true[rows][:, 2:]
        u, v = np.rint(uv).astype(int).T
        mask = read(folder / f"truth/instance/{side}/{k:06d}.png")[v, u] == 2 + truth.target
        depth = read(folder / f"truth/depth/{side}/{k:06d}.png")[v, u] / 256.0
        p_c = truth.points_c(np.array([k]), observations.tracks.track[rows])[0]
        z = p_c[:, 2] if side == "left" else truth.rig.T_rl.apply(p_c)[:, 2]
        on_mask += mask.tolist()
        deviations += np.abs(depth - z)[mask].tolist()
    # Points at the outline fall beside it when rounded to a pixel of 4 cm; the surface inside a pixel is sloped.
    assert np.mean(on_mask) > 0.9
    assert np.median(deviations) < 0.03


def test_points_without_noise_are_labelled_as_what_they_are(folder: Path) -> None:
    """Material points and disparities are found again from the rendered depth, far more exactly than tracking is.

    Errors that remain are of points at outlines, where a pixel shows another part of the body.
    """
    observations, truth = Observations.load(folder / "observations"), Truth.load(folder / "truth")
    t, good = (
        observations.tracks,
        (truth.labels.kind == 0) & np.isin(observations.tracks.track, truth.track[np.isfinite(truth.point_v[:, 0])]),
    )
    uv = truth.labels.uv_true[good]
    labelled = label(
        truth,
        Tracks(t.frame[good], t.track[good], uv[:, :2], uv[:, 2:], t.cov[good]),
        read_seen(folder / "truth", truth),
    )
    inlier = labelled.labels.kind == 0
    error = (uv - labelled.labels.uv_true)[inlier]
    assert inlier.mean() > 0.98
    assert np.median(np.abs(error[:, 0] - error[:, 2])) < 0.002
    assert abs(np.mean(error[:, 0] - error[:, 2])) < 0.005
    off = np.linalg.norm(labelled.point_v - truth.point_v[np.isin(truth.track, labelled.track)], axis=1)
    assert np.nanmedian(off) < 0.005


def test_flow_leads_to_where_the_points_are_next(folder: Path) -> None:
    observations, truth = Observations.load(folder / "observations"), Truth.load(folder / "truth")
    inlier = truth.labels.kind == 0
    errors = []
    for k in range(7):
        flow = read(folder / f"truth/flow/left/{k:06d}.png").astype(float)
        rows = {
            t: r
            for t, r in zip(observations.tracks.track, np.arange(len(inlier)), strict=True)
            if inlier[r] and observations.tracks.frame[r] == k
        }
        after = {
            t: r
            for t, r in zip(observations.tracks.track, np.arange(len(inlier)), strict=True)
            if inlier[r] and observations.tracks.frame[r] == k + 1
        }
        for t in rows.keys() & after.keys():
            uv = truth.labels.uv_true[rows[t], :2]
            v, u = np.rint(uv[::-1]).astype(int)
            known, dv, du = flow[v, u]
            if known:
                step = truth.labels.uv_true[after[t], :2] - uv
                errors.append(np.hypot((du - 2**15) / 64 - step[0], (dv - 2**15) / 64 - step[1]))
    # A pixel's flow is that of its centre, up to half a pixel away from the point; the car grows by 4 % a frame.
    assert len(errors) > 50
    assert np.median(errors) < 0.05


def test_labels_name_every_kind_and_the_report_is_there(folder: Path) -> None:
    truth = Truth.load(folder / "truth")
    assert truth.labels.kinds == ("noise", "stereo", "temporal", "segmentation", "segmentation", "reflection")
    assert set(np.unique(truth.labels.kind)) == set(range(7))
    assert truth.visible_points[5] == 0
    assert (folder / "report.html").stat().st_size > 100_000
