"""Points tracked in rendered images: stages and their cache, labels, studies in memory, and every way to fail."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest

from reports.labelling import KINDS
from scenarios import spec
from scenarios.in_memory import track_in_memory
from scenarios.trial import trial
from sim.observations import Observations
from sim.simulate import simulate
from sim.truth import Truth
from sim.world import build_world
from tests.scenarios.conftest import Command, Result

RUN = Path("runs/oncoming-1")
OTHER = "front_end.quality=0.02"
SMALL = (
    *("measure.from=images", "measure.points=60", "rig.frames=6", "rig.size_px=[400, 300]", "rig.focal_px=390.0"),
    *("world.roadside=false", "render.shadows=false", "render.supersample=1"),
    *("vehicle.0.motion.start_m=[-2.5, 11.0]", "vehicle.1.motion.start_m=[0.0, 16.0]"),
)


@pytest.fixture
def small_run(quick_run: Command) -> Command:
    def call(*settings: str) -> Result:
        return quick_run(*settings, quick=SMALL)

    return call


def stages() -> dict[str, Any]:
    return dict(json.loads((RUN / "provenance.json").read_text())["stages"])


def refused(result: Result, *words: str) -> None:
    assert result.status == 2, result
    (line,) = result.err.strip().splitlines()
    for word in words:
        assert word in line, (word, line)


def test_a_run_tracks_labels_and_reports(small_run: Command) -> None:
    result = small_run()
    assert result.status == 0, result
    assert set(stages()) == {"simulate", "render", "track", "label", "estimate estimated second order"}
    given, tracked = Observations.load(RUN / "observations"), Observations.load(RUN / "tracks")
    assert len(given.tracks) == len(Truth.load(RUN / "truth").track) == 0
    assert len(tracked.tracks) > 100
    assert tracked.images is not None
    assert tracked.masks is not None
    for name in (*tracked.images[3], tracked.masks[3]):
        assert (RUN / "tracks" / name).is_file()
    truth = Truth.load(RUN / "labels")
    assert len(truth.labels.kind) == len(tracked.tracks)
    assert truth.labels.kinds == KINDS
    assert (truth.visible_points >= 30).all()
    metrics = pd.read_csv(RUN / "metrics.csv", keep_default_na=False)
    assert {"u_left", "disparity"} <= set(metrics.loc[metrics["quantity"] == "pixel", "axis"])
    assert metrics.loc[metrics["entity"] == "track, per frame", "unit"].tolist() == ["ms"]
    assert "Image front end" in (RUN / "report.html").read_text()
    assert (RUN / "figures" / "front_end.svg").is_file()


def test_only_what_depends_on_the_front_end_is_done_again(small_run: Command) -> None:
    assert small_run("--stage", "track").status == 0
    assert set(stages()) == {"simulate", "render", "track"}
    assert not (RUN / "estimates").exists()
    image, tracks = RUN / "observations/images/left/000000.png", RUN / "tracks/observations.npz"
    drawn, tracked = image.stat().st_mtime_ns, tracks.stat().st_mtime_ns
    again = small_run()
    assert again.status == 0
    assert "track  from cache" in again.out
    assert (image.stat().st_mtime_ns, tracks.stat().st_mtime_ns) == (drawn, tracked)
    assert small_run(OTHER).status == 2
    assert small_run(OTHER, "--overwrite", "--stage", "track").status == 0
    assert image.stat().st_mtime_ns == drawn
    assert tracks.stat().st_mtime_ns > tracked
    assert small_run("measure.from=projection", "--overwrite", "--stage", "simulate").status == 0
    assert not (RUN / "tracks").exists()
    assert not (RUN / "labels").exists()


def test_the_stated_sigma_replaces_the_measured_covariance(small_run: Command) -> None:
    assert small_run("--stage", "track").status == 0
    measured = Observations.load(RUN / "tracks").tracks
    assert small_run("measure.stated_sigma_px=0.3", "--overwrite", "--stage", "track").status == 0
    stated = Observations.load(RUN / "tracks").tracks
    np.testing.assert_array_equal(stated.uv, measured.uv)
    np.testing.assert_allclose(stated.cov, np.broadcast_to(0.09 * np.eye(4), stated.cov.shape))
    assert not np.allclose(measured.cov, stated.cov)


def pictures(folder: str) -> np.ndarray:
    return np.stack([np.asarray(cv2.imread(str(p), cv2.IMREAD_UNCHANGED)) for p in sorted((RUN / folder).iterdir())])


def test_masks_are_those_of_the_scenario(small_run: Command) -> None:
    def masks(*settings: str) -> np.ndarray:
        assert small_run(*settings, "--overwrite", "--stage", "simulate").status == 0
        return pictures("observations/masks")

    true = masks()
    instance = pictures("truth/instance/left")
    np.testing.assert_array_equal(true, np.where(instance == 2, 255, 0))
    wrong = masks("measure.segmentation={kind='wrong', dilate_px=3}")
    assert ((wrong > 0) & (true == 0)).sum() > 0
    assert not ((wrong == 0) & (true > 0)).any()
    assert small_run("measure.segmentation={kind='motion'}", "--overwrite", "--stage", "simulate").status == 0
    assert not (RUN / "observations/masks").exists()
    assert Observations.load(RUN / "observations").masks is None


def test_nothing_to_see_is_a_failed_estimate_with_a_report(small_run: Command) -> None:
    result = small_run("render.gain=1e-6", "render.read_noise=0", "render.shot_noise=0")
    assert result.status == 1, result
    assert "gave nothing" in result.out
    assert len(Observations.load(RUN / "tracks").tracks) == 0
    assert "Image front end" in (RUN / "report.html").read_text()
    metrics = pd.read_csv(RUN / "metrics.csv", keep_default_na=False)
    assert metrics.loc[metrics["statistic"] == "converged", "value"].astype(float).tolist() == [0.0]


@pytest.mark.parametrize("damage", ["broken", "missing", "small"])
def test_a_damaged_image_is_one_line(small_run: Command, damage: str) -> None:
    assert small_run("--stage", "simulate").status == 0
    image = RUN / "observations/images/right/000002.png"
    if damage == "missing":
        image.unlink()
    elif damage == "broken":
        image.write_bytes(image.read_bytes()[:200])
    else:
        cv2.imwrite(str(image), np.zeros((30, 40, 3), np.uint8))
    refused(small_run(), "000002.png")
    assert not (RUN / "tracks").exists()


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("outliers=[{kind='stereo'}]", ("outliers", "tracked in images")),
        ("measure.sigma_px=0.3", ("measure.sigma_px", "'images'")),
        ("measure.missing_frames=[2]", ("measure.missing_frames", "'images'")),
        ("measure.segmentation.kind='wrogn'", ("measure.segmentation.kind", "did you mean 'wrong'")),
        ("measure.segmentation={kind='wrong', holes=2}", ("measure.segmentation", "holes", "1")),
        ("render.truth_images=false", ("render.truth_images", "labelled")),
        ("vehicle.0.mesh='point_grid'", ("measure.from", "point_grid")),
        ("front_end.no_such_key=3", ("front_end.no_such_key", "unknown key")),
        ("front_end.points=3", ("front_end.points", "unknown key")),
    ],
)
def test_wrong_settings(small_run: Command, setting: str, words: tuple[str, ...]) -> None:
    refused(small_run(setting), *words)
    assert not Path("runs").exists()


def test_what_images_need_does_nothing_to_projected_points(quick_run: Command) -> None:
    refused(quick_run("measure.segmentation.kind='true'"), "measure.segmentation", "'projection'")
    refused(quick_run(OTHER), "front_end", "'projection'")


def test_a_scenario_resolved_twice_is_the_same() -> None:
    scenario = spec.read("oncoming", SMALL)
    text = scenario.model_dump_json(by_alias=True)
    assert spec.run_model().model_validate_json(text).model_dump_json(by_alias=True) == text
    assert scenario.measure.segmentation.kind == "true"
    assert "front_end" in spec.run_model().model_json_schema()["properties"]


def test_a_trial_sees_the_images_of_the_engine(small_run: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tracks and labels of run 0 from memory are those from disk, bit by bit, whether or not what is drawn is kept;
    another run has other noise."""
    settings = "measure.segmentation={kind='wrong', dilate_px=2, holes=0.1, neighbour=0.2}"
    assert small_run(settings).status == 0
    scenario = spec.read("oncoming", (*SMALL, settings))
    world = build_world(scenario)
    tracks = []
    for run, kept in ((0, True), (0, True), (1, True), (0, False)):
        monkeypatch.setattr("scenarios.in_memory._KEPT_BYTES", 2**28 if kept else 0)
        observations, truth = track_in_memory(scenario, run, world, *simulate(scenario, run, world))
        tracks.append(observations.tracks)
        if run == 0:
            assert_same(observations.tracks, Observations.load(RUN / "tracks").tracks)
            labelled = Truth.load(RUN / "labels")
            np.testing.assert_array_equal(truth.point_v, labelled.point_v)
            assert_same(truth.labels, labelled.labels)
    assert len(tracks[2]) != len(tracks[0]) or not np.allclose(tracks[2].uv, tracks[0].uv)


def assert_same(a: Any, b: Any) -> None:
    for name in (f for f in a.__dataclass_fields__ if f != "kinds"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_a_study_can_run_on_images() -> None:
    result = trial(spec.read("oncoming", (*SMALL, "render.enabled=false")), 0)
    assert result.support["wanted"].tolist() == [6]
    assert result.support["estimated"].tolist() >= [3]
    assert (result.comparison["quantity"] == "position").any()
