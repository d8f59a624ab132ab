"""Tables, figures and statements on boresight calibration, made of results whose answers are known."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from reports.kozempel import boresight_figures, boresight_statements
from reports.kozempel.boresight import ADJUSTED, ANGLES, NO_POSES, PER_IMAGE, ways_table
from reports.kozempel.boresight_design import design_table, images_figure, maps_figure, noise_figure, smallest
from reports.kozempel.boresight_offset import ADJUSTED as OFFSET
from reports.kozempel.boresight_offset import HELD, REFITTED, curves_figure, offset_table
from reports.kozempel.boresight_offset import images_figure as own_offsets_figure
from reports.kozempel.boresight_ties import FOUND, START, ties_figure, ties_table
from reports.studies import StudyResult

RUNS = 6
Rows = Iterable[tuple[Any, ...]]
Points = dict[str, dict[str, Any]]


def result(name: str, cases: tuple[str, ...], points: Points, rows: Rows) -> StudyResult:
    nothing = pd.DataFrame(columns=["point", "run", "estimator", "reason"])
    table = pd.DataFrame(list(rows), columns=["point", "run", "estimator", "quantity", "t_s", "value"])
    return StudyResult(
        folder=Path("nowhere"),
        name=name,
        title="",
        source="",
        scenario="experiment",
        experiment=True,
        seed=1,
        runs=RUNS,
        points=pd.DataFrame(list(points.values()), index=list(points)),
        scenarios=points,
        estimators=cases,
        comparison=nothing,
        nees=nothing,
        outliers=nothing,
        failures=nothing,
        support=nothing,
        measures=table,
        runtimes=nothing,
    )


def by(table: pd.DataFrame, *keys: str) -> dict[Any, Any]:
    """Rows of a table by their values of some columns."""
    return table.set_index(list(keys)).to_dict("index")


def found(sigma: float, run: int, stated: float = 1.0) -> Iterator[tuple[str, float]]:
    """Errors of alternating sign; kappa's are three times those of the others."""
    for angle, factor in zip(ANGLES, (1, 1, 3), strict=True):
        yield f"boresight_{angle}", factor * sigma * (-1) ** run
        yield f"boresight_sigma_{angle}", factor * sigma * stated
    yield "boresight_nees", stated**-2
    yield "boresight_failed", 0.0


def ways(points: Points, scatter: float, px: float) -> Iterator[tuple[Any, ...]]:
    for (point, s), run, case in itertools.product(points.items(), range(RUNS), (PER_IMAGE, ADJUSTED, NO_POSES)):
        size = scatter if s["vibration_deg"] else scatter / 4
        for quantity, v in found(size / 3, run, 0.3 if case == NO_POSES else 1.0):
            yield point, run, case, quantity, 0.0, v
        yield point, run, case, "boresight_px", 0.0, px if s["vibration_deg"] else px / 4
        if case == PER_IMAGE:
            yield from ((point, run, case, f"boresight_scatter_{a}", 0.0, size) for a in ANGLES)
            for image, a in itertools.product(range(1, 10), ANGLES):
                yield point, run, case, f"boresight_image_{a}", float(image), size * (-1) ** (image + run)
            yield from ((point, run, case, "boresight_heading", float(i), 90.0 * (i % 4)) for i in range(1, 10))


def scatter_result(scatter: float, px: float) -> StudyResult:
    points: Points = {
        "clean": {"navigation": "independent", "position_m": 0.05, "vibration_deg": 0.0},
        "worst": {"navigation": "pos_av_410", "position_m": 0.3, "vibration_deg": 0.0},
        "source": {"navigation": "pos_av_410", "position_m": 0.3, "vibration_deg": 0.08},
    }
    return result("kozempel-fig-3-7", (PER_IMAGE, ADJUSTED, NO_POSES), points, ways(points, scatter, px))


def test_scatter_and_residual_are_held_against_the_sources() -> None:
    agreeing = boresight_statements.claims(scatter_result(0.09, 5.4))["holds"]
    assert list(agreeing) == ["yes", "yes", "yes", "yes", "in part", "yes"]
    other = boresight_statements.claims(scatter_result(0.3, 9.0))["holds"]
    assert list(other)[:3] == ["no", "no", "in part"]


def test_ways_stand_beside_each_other() -> None:
    r = scatter_result(0.09, 5.4)
    table = by(ways_table(r), "conditions", "way")
    row = table["errors mostly constant, GNSS 30 cm, vibration 0.08°", NO_POSES]
    assert row["κ, RMS [°]"] == pytest.approx(0.09)
    assert row["ω, stated [°]"] == pytest.approx(0.009)
    assert row["NEES"] == pytest.approx(0.3**-2)
    assert np.isnan(row["scatter of ω [°]"])
    figure = boresight_figures.scatter_figure(r)
    assert len(figure.axes) == 6
    honest = boresight_figures.honesty_figure(r)
    names = [label.get_text() for label in honest.axes[0].get_yticklabels()]
    assert names[0].startswith("errors new in every image")


def offsets(points: Points, gain: float, left: float) -> Iterator[tuple[Any, ...]]:
    """Curves with their minimum at the offset where fitted anew, 0 where held; ``left`` of the images above 4 px."""
    ms = np.linspace(-40, 40, 9)
    for (point, s), run in itertools.product(points.items(), range(RUNS)):
        true = 1e3 * s["time_offset_s"]
        for case, low in ((HELD, 0.0), (REFITTED, true)):
            yield from ((point, run, case, "offset_px", t, float(np.hypot(5, 0.2 * (t - low)))) for t in ms)
            yield point, run, case, "offset_minimum", 0.0, low + 0.3 * (-1) ** run
            yield point, run, case, "offset_gain", 0.0, gain
        for image in range(1, 9):
            above = image <= 8 * left and not s["jitter_s"]
            yield point, run, HELD, "offset_image_px", float(image), 5.0 if above else 1.0
            yield point, run, HELD, "offset_image_zero_px", float(image), 5.4
        for quantity, v in (
            *found(0.01, run),
            ("offset_error", 3.0),
            ("offset_sigma", 3.5),
            ("offset_inseparable", 1.0),
        ):
            yield point, run, OFFSET, quantity, 0.0, v


def offset_result(gain: float, left: float) -> StudyResult:
    common: dict[str, Any] = {"headings_deg": [0.0, 180.0], "heights_m": [500.0], "position_m": 0.3, "gusts": 1.0}
    points: Points = {
        "vibration": common | {"vibration_deg": 0.08, "jitter_s": 0.0, "time_offset_s": 0.0},
        "jitter": common | {"vibration_deg": 0.0, "jitter_s": 0.018, "time_offset_s": 0.0},
        "offset": common | {"vibration_deg": 0.0, "jitter_s": 0.0, "time_offset_s": 0.02, "gusts": 0.0},
    }
    return result("kozempel-fig-3-8", (HELD, REFITTED, OFFSET), points, offsets(points, gain, left))


def test_offsets_are_held_against_the_sources() -> None:
    assert list(boresight_statements.claims(offset_result(0.001, 0.25))["holds"]) == [
        "no",  # 0.3 ms about 0 are not -1
        "yes",
        "no",
        "yes",
        "yes",
        "yes",
    ]
    assert list(boresight_statements.claims(offset_result(0.3, 0.0))["holds"])[1:5] == ["no", "yes", "no", "no"]


def test_minima_of_the_curves_stand_in_table_and_figure() -> None:
    r = offset_result(0.001, 0.25)
    row = offset_table(r).iloc[2]
    assert row["flight"] == "500 m, 2 directions, calm air, offset 20 ms, GNSS 0.3 m"
    assert row["lowest, fitted anew [ms]"] == pytest.approx(20)
    assert row["lowest, held [ms]"] == pytest.approx(0)
    assert row["its scatter [ms]"] == pytest.approx(0.3 * np.sqrt(6 / 5))
    assert row["called inseparable from pitch [%]"] == 100
    axes = curves_figure(r).axes
    fitted = next(line for line in axes[2].lines if line.get_label() == REFITTED)
    x, y = (np.asarray(v, float) for v in fitted.get_data())
    assert x[np.argmin(y)] == 20
    assert [ax.get_title(loc="left") for ax in own_offsets_figure(r).axes] == ["vibration", "jitter"]


def design_result() -> StudyResult:
    """0.02° over the root of the images, less with more points; a constant part of 0.01° that none averages."""
    points: Points = {}
    for navigation, headings, images, gcps in itertools.product(
        ("independent", "pos_av_410"), ([0.0], [0.0, 90.0, 180.0, 270.0]), (4, 9, 16), (3, 8)
    ):
        points[f"{navigation} {len(headings)} {images} {gcps}"] = {
            "navigation": navigation,
            "headings_deg": headings,
            "heights_m": [500.0],
            "images": images,
            "gcps": gcps,
        }

    def rows() -> Iterator[tuple[Any, ...]]:
        for (point, s), run in itertools.product(points.items(), range(RUNS)):
            constant = 0.01 if s["navigation"] == "pos_av_410" else 0.0
            sigma = float(np.hypot(constant, (0.016 if s["gcps"] == 8 else 0.02) / np.sqrt(s["images"])))
            yield from ((point, run, ADJUSTED, quantity, 0.0, v) for quantity, v in found(sigma, run))

    return result("kozempel-boresight-design", (ADJUSTED,), points, rows())


def test_the_smallest_design_that_meets_the_goal() -> None:
    r = design_result()
    table = by(smallest(r), "navigation", "directions")
    good = table["errors new in every image", "four directions"]
    assert (good["meets the goal"], good["images"], good["control points per image"]) == ("yes", 9, 8)
    assert good["φ: sigma; RMS (95 %) [°]"] == "0.0053; 0.0053 (0.0053 … 0.0053)"
    none = table["errors mostly constant", "one direction"]
    assert none["meets the goal"].startswith("none")
    assert (none["images"], none["control points per image"]) == (16, 8)
    assert len(design_table(r)) == len(r.points)


def test_designs_are_drawn_with_what_meets_the_goal() -> None:
    r = design_result()
    bold = {t.get_text() for t in maps_figure(r).axes[0].texts if t.get_fontweight() == "bold"}
    assert bold == {f"{v:.4f}" for v in (0.016 / 3, 0.004, 0.005)}
    assert len(images_figure(r).axes) == 6
    with pytest.raises(ValueError, match="gcps, heights: found 7 and '500 m'"):
        images_figure(r, gcps=7)


def test_noise_is_drawn_over_gnss() -> None:
    keys = ("vibration_deg", "clicks_px", "position_m", "navigation")
    values = itertools.product((0.0, 0.08), (0.5, 2.0), (0.05, 0.3), ("independent", "pos_av_410"))
    points: Points = {str(v): dict(zip(keys, v, strict=True)) for v in values}
    rows = [
        (point, run, ADJUSTED, quantity, 0.0, v)
        for (point, s), run in itertools.product(points.items(), range(RUNS))
        for quantity, v in (*found(s["position_m"], run), ("boresight_px", 1.0))
    ]
    figure = noise_figure(result("kozempel-boresight-noise", (ADJUSTED,), points, rows))
    assert [ax.get_title(loc="left") for ax in figure.axes[:2]] == ["vibration 0°", "vibration 0.08°"]
    line = figure.axes[0].lines[0]
    np.testing.assert_allclose(np.asarray(line.get_ydata(), float), [0.05, 0.3])


def ties_result(strip_m: float) -> StudyResult:
    points: Points = {v: {"layout": v, "navigation": "pos_av_410"} for v in ("strip", "opposite", "crossing")}

    def rows() -> Iterator[tuple[Any, ...]]:
        for point, run in itertools.product(points, range(RUNS)):
            m = strip_m if point == "strip" else 0.25
            for case, factor in ((START, 20.0), (FOUND, 1.0)):
                yield point, run, case, "ties_position", 0.0, factor * m
                yield point, run, case, "ties_height", 0.0, factor * m / 5
            for quantity, v in (*found(0.4 if point == "strip" else 0.008, run), ("ties_missed", 0.0)):
                yield point, run, FOUND, quantity, 0.0, v

    return result("kozempel-3-4-ties", (START, FOUND), points, rows())


def test_ties_are_held_against_the_sources() -> None:
    assert list(boresight_statements.claims(ties_result(10.0))["holds"]) == ["in part", "in part", "yes"]
    assert list(boresight_statements.claims(ties_result(0.5))["holds"]) == ["yes", "no", "yes"]
    table = by(ties_table(ties_result(10.0)), "flown")
    assert table["one strip"]["position, 1° off [m]"] == pytest.approx(200)
    assert table["crossing"]["position, adjusted [m]"] == pytest.approx(0.25)
    assert len(ties_figure(ties_result(10.0)).axes) == 2
