"""The metrics of a front end are those of the noise that was put in."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from reports.front_end import front_end_rows, pixel_errors
from reports.front_end_display import front_end_section
from reports.labelling import KINDS
from reports.metrics import METRIC_COLUMNS, as_table
from sim.observations import Tracks
from sim.truth import Labels, Truth
from tests.reports.conftest import make_observations, make_truth

LEFT, MATCH, BIAS = 0.2, 0.1, 0.03


def tracked(noise: np.ndarray, kind: np.ndarray | None = None) -> tuple[Truth, Tracks]:
    """The tracks of a box with these errors (frames, tracks, 4), and their labels."""
    truth = make_truth(0.0, 0.0, 0.0)
    n = len(truth.labels.kind)
    labels = Labels(np.zeros(n, int) if kind is None else kind, truth.labels.uv_true, np.full(n, LEFT), KINDS)
    uv = truth.labels.uv_true + noise.reshape(-1, 4)
    tracks = replace(make_observations(truth).tracks, uv_left=uv[:, :2], uv_right=uv[:, 2:])
    return replace(truth, labels=labels), tracks


def metrics(truth: Truth, tracks: Tracks, **more: Any) -> pd.DataFrame:
    whose = {"scenario": "box", "seed": 1, "runs": 1, "estimator": ""}
    return as_table(whose | row for row in front_end_rows(truth, tracks, **more))


def get(table: pd.DataFrame, quantity: str, axis: str, statistic: str, entity: str = "", bin_: str = "") -> pd.Series:
    key = {"quantity": quantity, "axis": axis, "statistic": statistic, "entity": entity, "bin": bin_}
    (row,) = (r for _, r in table.iterrows() if all(r[k] == v for k, v in key.items()))
    return row


def noise(seed: int, wander: float = 0.0) -> np.ndarray:
    """White errors of the left image that the right one follows but for its own, and each track's mean taken out, as
    its material point takes it; ``wander``: correlation from frame to frame."""
    rng = np.random.default_rng(seed)
    left = rng.standard_normal((40, 24, 2))
    for k in range(1, 40):
        left[k] = wander * left[k - 1] + np.sqrt(1 - wander**2) * left[k]
    left = LEFT * left
    left -= left.mean(axis=0)
    match = MATCH * rng.standard_normal((40, 24, 2)) + [-BIAS, 0.0]
    return np.concatenate([left, left + match], axis=2)


def covariance() -> np.ndarray:
    """Of such errors."""
    common, own = LEFT**2 * np.tile(np.eye(2), (2, 2)), MATCH**2 * np.diag([0.0, 0, 1, 1])
    return common + own


@pytest.fixture(scope="module")
def white() -> pd.DataFrame:
    truth, tracks = tracked(noise(0))
    return metrics(truth, replace(tracks, cov=np.tile(covariance(), (len(tracks), 1, 1))), seconds_per_frame=0.03)


def test_noise_is_found_with_its_interval(white: pd.DataFrame) -> None:
    """The sigmas that were put in lie within 3.5 standard deviations: the intervals hold two."""
    for axis, sigma in (("u_left", LEFT), ("v_left", LEFT), ("v_right", np.hypot(LEFT, MATCH)), ("disparity", MATCH)):
        row = get(white, "pixel", axis, "std")
        half = (row["ci_high"] - row["ci_low"]) / 2
        assert 0 < half < 0.1 * sigma
        assert abs(row["value"] - sigma) < 1.75 * half
        assert row["ci_low"] < row["value"] < row["ci_high"]
    bias = get(white, "pixel", "disparity", "bias")
    assert abs(bias["value"] - BIAS) < 1.75 * (bias["ci_high"] - bias["ci_low"]) / 2
    assert bias["ci_low"] > 0


def test_an_honest_covariance_is_called_so(white: pd.DataFrame) -> None:
    """The bias adds BIAS² / MATCH² = 0.09 to one of four coordinates."""
    row = get(white, "pixel", "all", "nees")
    assert row["value"] == pytest.approx(1 + 0.09 / 4, abs=3 * np.sqrt(2 / (4 * 960)))
    # The median of 960 chi-squares is known to 3 %.
    assert get(white, "pixel", "all", "median_factor")["value"] == pytest.approx(1, abs=0.06)
    low, high = map(float, row["reference"].split(".."))
    assert low < row["value"] < high


def test_a_dishonest_covariance_is_told_by_its_factor(white: pd.DataFrame) -> None:
    truth, tracks = tracked(noise(0))
    table = metrics(truth, replace(tracks, cov=np.tile(covariance() / 4, (len(tracks), 1, 1))))
    assert get(table, "pixel", "all", "factor")["value"] == pytest.approx(
        2 * get(white, "pixel", "all", "factor")["value"]
    )
    for axis in ("u_left", "disparity"):
        assert get(table, "pixel", axis, "factor")["value"] == pytest.approx(
            2 * get(white, "pixel", axis, "factor")["value"]
        )
    (card,) = (c for c in front_end_section(table).cards if c.title == "Pixel NEES")
    assert card.good is False
    assert "off by 2.0" in card.remark


def test_white_noise_is_not_correlated_and_does_not_drift(white: pd.DataFrame) -> None:
    """A mean over 40 frames taken out leaves a correlation of -1/39."""
    for lag in range(1, 6):
        row = get(white, "pixel", "left", "correlation", "", f"lag {lag}")
        assert row["value"] == pytest.approx(-1 / 39, abs=4 / np.sqrt(2 * 960))
    # 24 tracks, two coordinates: a root mean square is known to 10 %, and they share the first frame's error.
    for age in (1, 5, 20):
        assert get(white, "pixel", "left", "drift", "", f"age {age}")["value"] == pytest.approx(
            np.sqrt(2) * LEFT, rel=0.35
        )


def test_errors_that_last_are_told_by_correlation_and_drift() -> None:
    table = metrics(*tracked(noise(1, wander=0.8)))
    found = [get(table, "pixel", "left", "correlation", "", f"lag {k}")["value"] for k in (1, 2, 3)]
    # The mean of 40 such errors has 8 of their 40 degrees of freedom: estimates are lower by about 0.1.
    assert found == pytest.approx([0.8, 0.64, 0.51], abs=0.17)
    assert found[0] > found[1] > found[2] > 0.2
    drift = [get(table, "pixel", "left", "drift", "", f"age {k}")["value"] for k in (1, 5, 20)]
    assert drift[0] < 0.75 * drift[1] < drift[2]


def test_tracks_and_outliers_are_counted() -> None:
    kind = np.zeros((40, 24), int)
    kind[:, :3], kind[10:20, 3] = 1 + KINDS.index("segmentation"), 1 + KINDS.index("stereo")
    truth, tracks = tracked(noise(0), kind.ravel())
    keep = (tracks.track != 5) | (tracks.frame < 10)
    labels = truth.labels
    labels = Labels(labels.kind[keep], labels.uv_true[keep], labels.sigma_px[keep], KINDS)
    table = metrics(replace(truth, labels=labels), tracks.select(keep), seconds_per_frame=0.03)
    rows = 24 * 40 - 30
    assert get(table, "outlier", "all", "fraction", "segmentation")["value"] == pytest.approx(120 / rows)
    assert get(table, "outlier", "all", "fraction", "stereo")["value"] == pytest.approx(10 / rows)
    assert get(table, "outlier", "all", "fraction", "temporal")["value"] == 0
    assert get(table, "outlier", "all", "fraction", "all")["value"] == pytest.approx(130 / rows)
    assert get(table, "track", "all", "mean")["value"] == pytest.approx(rows / 40)
    assert get(table, "track", "all", "min", "inlier")["value"] == 19  # three, the stereo error and the lost one
    assert get(table, "track", "life", "mean")["value"] == pytest.approx(rows / 24)
    assert get(table, "track", "life", "median")["value"] == 40
    assert get(table, "runtime", "all", "mean", "track, per frame")["value"] == pytest.approx(30)


def test_nothing_tracked_has_rows_that_say_so() -> None:
    truth = make_truth(0.0, 0.0, 0.0)
    nothing = Labels(np.empty(0, int), np.empty((0, 4)), np.empty(0), KINDS)
    truth = replace(truth, labels=nothing, track=np.empty(0, int), point_v=np.empty((0, 3)))
    table = metrics(truth, Tracks.none(), seconds_per_frame=0.01)
    assert list(table.columns) == METRIC_COLUMNS
    assert get(table, "track", "all", "mean", "inlier")["value"] == 0
    assert set(table["quantity"]) == {"track", "runtime"}
    assert len(pixel_errors(truth, Tracks.none())) == 0
    assert [c.title for c in front_end_section(table).cards] == ["Good tracks in a frame", "Time per frame"]


def test_the_section_shows_every_table(white: pd.DataFrame) -> None:
    section = front_end_section(white)
    assert [head for head, _, _ in section.tables] == ["axis", "frames apart", "age [frames]", "label"]
    (axes, *_) = (dict(rows) for head, _, rows in section.tables if head == "axis")
    stated = float(axes["u left"][1].value)
    assert stated == pytest.approx(LEFT, rel=0.01)
    assert "…" in axes["u left"][0].interval


def test_directions_are_stated(white: pd.DataFrame) -> None:
    assert set(white["direction"]) <= {"lower", "higher", "zero", "one"}
    assert white["unit"].notna().all()
