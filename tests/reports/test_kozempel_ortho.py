"""Tables, figures and statements on ortho images, made of results whose answers are known."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from reports.kozempel.ortho import (
    HEIGHTS,
    PUBLISHED_PX,
    SOURCES,
    WHOLE,
    budget,
    budget_table,
    methods_table,
    of,
    passes_table,
    settings,
)
from reports.kozempel.ortho_figures import budget_figure, passes_figure, vectors_figure, zones_figure
from reports.kozempel.ortho_statements import claims
from reports.studies import StudyResult

METHODS = ("map", "exact", "anchor", "forward")
COLUMNS = ["point", "run", "estimator", "quantity", "t_s", "value"]
# RMS [px] of each source alone; 3.0 of each height model but the true one.
PX = dict.fromkeys(SOURCES, 0.5) | {"vibration": 5.0, "position": 2.1, "none": 0.0, "all": 5.5}
HEIGHT_PX = {"exact": 0.0, "srtm": 1.5, "flat": 3.0}
METHOD_PX = {"map": 0.001, "exact": 0.0, "anchor": 1.0, "forward": float(np.sqrt(1 / 6))}


def rows(points: dict[str, dict[str, Any]], gsd_m: pd.Series, scale: float) -> Iterator[tuple[Any, ...]]:
    for (point, s), method, run in itertools.product(points.items(), METHODS, range(4)):
        px = np.sqrt((scale * PX[s["errors"]]) ** 2 + HEIGHT_PX[s["dem"]] ** 2 + METHOD_PX[method] ** 2)
        m = float(px * gsd_m[point]) * (1 + 0.1 * (run - 1.5)) / np.sqrt(1.0125)  # mean square 1 over the four
        for part in ("", "_common", "_passes", "_images", "_within"):
            yield point, run, method, f"ortho{part}", 0, m if not part else m / 2
        yield point, run, method, "ortho_predicted", 0, float(px * gsd_m[point])
        yield point, run, method, "ortho_lost", 0, 0.0
        yield from ((point, run, method, "ortho_pass", k, m * k / 2) for k in (1, 2, 3))
        yield from ((point, run, method, "ortho_image", k, m * k / 5) for k in range(1, 10))
        yield from ((point, run, method, "ortho_zone", z, m * z) for z in (0.25, 0.5, 0.75, 1.0))
        if run == 0:
            for k, (u, v) in enumerate(itertools.product((100.0, 900.0), (100.0, 900.0))):
                for name, value in (("u", u), ("v", v), ("x", m), ("y", -m)):
                    yield point, run, method, f"ortho_cell_{name}", k + 1, value


def study(scale: float = 1.0) -> StudyResult:
    nothing = pd.DataFrame(columns=["point", "run", "estimator", "reason"])
    errors = [("none", d) for d in HEIGHT_PX] + [("all", d) for d in HEIGHT_PX] + [(s, "exact") for s in SOURCES]
    points = {
        f"{system} {e} {d}": {"system": system, "height_m": h, "errors": e, "dem": d}
        for (system, h), (e, d) in itertools.product((("antar", 500.0), ("argos", 1400.0)), errors)
    }
    empty: dict[str, Any] = {
        "comparison": nothing,
        "nees": nothing,
        "outliers": nothing,
        "failures": nothing,
        "support": nothing,
    }
    plain: dict[str, Any] = {"title": "", "source": "", "scenario": "ortho_accuracy", "experiment": True, "seed": 1}
    result = StudyResult(
        folder=Path("nowhere"),
        name="kozempel-ortho-accuracy",
        runs=4,
        points=pd.DataFrame(list(points.values()), index=list(points)),
        scenarios=points,
        estimators=METHODS,
        measures=pd.DataFrame(columns=COLUMNS),
        runtimes=nothing,
        **plain,
        **empty,
    )
    table = pd.DataFrame(list(rows(points, settings(result)["gsd_m"], scale)), columns=COLUMNS)
    fields = {name: getattr(result, name) for name in result.__dataclass_fields__}
    return StudyResult(**fields | {"measures": table})


def row(table: pd.DataFrame, **chosen: str) -> dict[str, Any]:
    """The one row of a table with these words."""
    found = of(table, **chosen)
    assert len(found) == 1
    return {str(k): v for k, v in found.iloc[0].items()}


@pytest.fixture(scope="module")
def result() -> StudyResult:
    return study()


def test_pixels_are_those_of_the_map(result: StudyResult) -> None:
    gsd = settings(result)["gsd_m"]
    assert gsd["antar none exact"] == pytest.approx(0.2)
    assert gsd["argos none exact"] == pytest.approx(0.2019, abs=1e-4)


def test_the_budget_is_that_of_the_sources(result: StudyResult) -> None:
    table = budget(result, "antar").set_index("source")
    assert table["simulated"]["vibration"] == pytest.approx(5.0)
    assert table["simulated"][HEIGHTS] == pytest.approx(1.5)
    assert table["simulated"][WHOLE] == pytest.approx(np.hypot(5.5, 1.5))
    assert table["simulated"]["method: anchor"] == pytest.approx(1.0)
    np.testing.assert_allclose(table["simulated"], table["predicted"])
    shown = budget_table(result)
    assert row(shown, system="antar", error="vibration")["share [%]"] == pytest.approx(100 * 25 / (5.5**2 + 1.5**2))
    assert np.isnan(row(shown, system="antar", error="method: anchor")["share [%]"])
    assert row(shown, system="antar", error=WHOLE)["the source [px]"] == str(PUBLISHED_PX)
    assert set(of(shown, system="argos")["the source [px]"]) == {""}


def test_tables_of_passes_and_methods(result: StudyResult) -> None:
    best = row(passes_table(result), system="antar", method="exact")
    assert best["RMS [px]"] == pytest.approx(np.hypot(5.5, 1.5))
    assert best["RMS [m]"] == pytest.approx(0.2 * best["RMS [px]"])
    assert best["from"] < best["RMS [px]"] < best["to"]
    parts = [best[f"{part} [px]"] for part in ("common", "passes", "images", "within")]
    assert np.sum(np.square(parts)) == pytest.approx(best["RMS [px]"] ** 2)
    methods = methods_table(result)
    known = row(methods, system="argos", heights="exact", method="anchor")
    assert known["RMS [px]"] == pytest.approx(1.0)
    assert known["border [px]"] == pytest.approx(4 * known["middle [px]"])
    assert len(methods) == 2 * 3 * 4


def test_statements_follow_the_numbers(result: StudyResult) -> None:
    assert list(claims(result)["holds"]) == ["yes"] * 8
    twice = claims(study(2.0))
    assert twice["holds"][0] == "no"
    assert twice["holds"][3] == "no"


def test_figures_show_all_of_it(result: StudyResult) -> None:
    left, right = budget_figure(result).axes
    assert len(left.patches) == len(right.patches) == len(budget(result, "antar"))
    assert max(p.get_width() for p in left.patches) == pytest.approx(np.hypot(5.5, 3.0))  # type: ignore[attr-defined]  # a bar
    assert len(passes_figure(result).axes[0].containers) == len(METHODS)
    lines = {line.get_label(): np.asarray(line.get_ydata()) for line in zones_figure(result).axes[0].lines}
    np.testing.assert_allclose(lines["SRTM heights"], 1.5 * np.array([0.25, 0.5, 0.75, 1.0]))
    assert [ax.get_title(loc="left").split("\n")[1] for ax in vectors_figure(result).axes[1:3]] == [
        f"longest arrow {np.sqrt(2) * v * 0.85 / np.sqrt(1.0125):.1f} px" for v in (3.0, 1.0)
    ]
