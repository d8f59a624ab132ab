"""The published tables and figures, made of small studies whose numbers are known."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from reports.siegemund import detectors
from reports.studies import StudyResult

Array = np.ndarray


def result(points: dict[str, dict[str, Any]], estimators: tuple[str, ...], **tables: pd.DataFrame) -> StudyResult:
    """A study with these points (name to settings), labels and tables."""
    categories = {"point": list(points), "estimator": ["", *estimators]}
    empty = pd.DataFrame(columns=["point", "run", "estimator"])
    every = dict.fromkeys(("comparison", "nees", "outliers", "failures", "support", "runtimes"), empty) | tables
    for name, table in every.items():
        every[name] = table.assign(**{c: pd.Categorical(table[c], v) for c, v in categories.items()})
    return StudyResult(
        folder=Path("nowhere"),
        name="study",
        title="",
        source="",
        scenario="point-grid",
        seed=1,
        runs=2,
        points=pd.DataFrame(list(points.values()), index=list(points)),
        scenarios={},
        estimators=estimators,
        **every,
    )


def detected(labels: tuple[str, ...] = ("points", "robust")) -> StudyResult:
    """Two rows of the table, two runs; fp is 10 and 14 of the first detector, 0 and 1 of the second."""
    points = {f"{rho} {t}": {detectors.FRAMES: rho, detectors.SHARE: t} for rho, t in ((10, 0.1), (1, 0.5))}
    rows = [
        {"point": p, "run": run, "estimator": e, "fp": fp[run], "fn": 7, "tp": 43}
        for p, (e, fp), run in itertools.product(points, zip(labels, [(10, 14), (0, 1)], strict=True), range(2))
    ]
    return result(points, labels, outliers=pd.DataFrame(rows))


def test_outlier_table_beside_the_published_numbers() -> None:
    table = detectors.outlier_table(detected())
    assert list(table["theta [%]"]) == [10, 50]
    assert list(table["rho"]) == [10, 1]
    assert list(table["points fp"]) == [12, 12]
    assert list(table["points fp, source"]) == [15.3, 0]
    assert list(table["points fn, source"]) == [0, 7]
    assert list(table["robust fp"]) == [0.5, 0.5]
    assert "robust fp, source" not in table


def test_a_detector_that_gave_nothing_leaves_its_cells_empty() -> None:
    whole = detected()
    table = detectors.outlier_table(replace(whole, outliers=whole.outliers[whole.outliers["estimator"] == "points"]))
    assert table["robust fn"].isna().all()
    assert list(table["points fn"]) == [7, 7]


def test_published_numbers_are_whole() -> None:
    rows = {(theta, rho) for theta in (10, 30, 50) for rho in (10, 5, 1)}
    assert set(detectors.PUBLISHED) == {"points", "tracks", "prior knowledge"}
    for numbers in detectors.PUBLISHED.values():
        assert set(numbers) == rows
    # The cap of ten batches of 5 %: 43 of 100 tracks can go.
    for theta, rho in rows:
        for method in ("points", "tracks"):
            fp, fn = detectors.PUBLISHED[method][theta, rho]
            assert theta < 50 or fn == pytest.approx(7 + fp)


def test_outlier_figure_shows_ours_and_the_source() -> None:
    figure = detectors.outlier_counts(detected())
    left, right = figure.axes
    assert [t.get_text() for t in left.get_yticklabels()] == [
        "10 % of tracks\nin 10 frames",
        "50 % of tracks\nin 1 frame",
    ]
    labels = [t.get_text() for t in figure.legends[0].get_texts()]
    assert labels == ["points", "points, source", "robust"]
    for ax, values in ((left, [15.3, 0]), (right, [0, 7])):
        published = [line for line in ax.get_lines() if line.get_label() == "points, source"]
        np.testing.assert_array_equal(published[0].get_xdata(), values)
