"""An oncoming car from 60 to 20 m, tracked in its rendered images: noise of the front end, and what it leads to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sim.observations import Observations
from sim.truth import Truth
from tests.end_to_end.conftest import run

LAST = 30
Pixel = dict[tuple[str, str], tuple[float, float, float]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("run") / "out"
    result = run("oncoming-images", out)
    assert result.returncode == 0, result
    return out


@pytest.fixture(scope="module")
def pixel(folder: Path) -> Pixel:
    """Metrics of the image front end by axis and statistic: value and interval."""
    m = pd.read_csv(folder / "metrics.csv")
    rows = m[(m["quantity"] == "pixel") & m["bin"].isna()]
    columns = [rows[name].tolist() for name in ("axis", "statistic", "value", "ci_low", "ci_high")]
    return {(axis, statistic): (value, low, high) for axis, statistic, value, low, high in zip(*columns, strict=True)}


def test_noise_of_the_front_end(pixel: Pixel) -> None:
    for axis in ("u_left", "v_left", "u_right", "v_right"):
        assert 0.08 < pixel[axis, "std"][0] < 0.25, axis


def test_the_disparity_has_no_bias(pixel: Pixel) -> None:
    bias, low, high = pixel["disparity", "bias"]
    assert abs(bias) < 0.02
    assert low < bias < high < low + 0.04


def test_the_report_says_how_far_the_stated_covariance_is_off(folder: Path, pixel: Pixel) -> None:
    factor = pixel["all", "factor"][0]
    assert factor == pytest.approx(np.sqrt(pixel["all", "nees"][0]))
    assert f"{factor:.2f}" in (folder / "report.html").read_text("utf-8")


def test_tracks_on_a_sedan_at_25_m(folder: Path) -> None:
    depth = Truth.load(folder / "truth").T_cv.t[:, 2]
    tracks = Observations.load(folder / "tracks").tracks
    assert np.sum(tracks.frame == np.argmin(np.abs(depth - 25))) >= 60


def _rms(folder: Path, estimator: str, quantity: str, axis: str) -> float:
    """Of the last frames [m or m/s]."""
    e = pd.read_parquet(folder / "errors.parquet")
    rows = e[(e["estimator"] == estimator) & (e["quantity"] == quantity) & (e["axis"] == axis)]
    rows = rows[rows["entity"] == "target"].sort_values("t_s").tail(LAST)
    assert len(rows) == LAST
    return float(np.sqrt((rows["error"] ** 2).mean()))


def test_speed_and_position_with_and_without_detection(folder: Path) -> None:
    assert _rms(folder, "robust", "speed", "all") < 0.5
    depth = Truth.load(folder / "truth").T_cv.t[-LAST:, 2]
    assert _rms(folder, "robust", "position", "z") < 0.015 * depth.min()
    assert _rms(folder, "plain", "speed", "all") > 3 * _rms(folder, "robust", "speed", "all")
    assert _rms(folder, "plain", "position", "z") > 1.2 * _rms(folder, "robust", "position", "z")
