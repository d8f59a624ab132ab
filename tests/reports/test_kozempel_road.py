"""Tables, figures and statements on faulty road maps, made of results whose answers are known."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from reports.kozempel.ortho import of
from reports.kozempel.road import classes_table, faults_table, margins_table, pooled, single, value, views
from reports.kozempel.road_figures import classes_figure, displacement_figure, margins_figure
from reports.kozempel.road_statements import claims
from reports.studies import StudyResult

MAPS = ("exact", "displaced", "missing", "outdated", "narrowed", "all")
MARGINS = (0.0, 1.5, 3.0)
VIEWS = (("antar", 500.0, "known"), ("antar", 500.0, "measured"), ("argos", 1400.0, "measured"))
# Parts inside the mask at a margin of 1.5 m: of the right map, and what faults and orientation take away.
TAKEN = {"exact": 0.0, "displaced": 0.03, "missing": 0.02, "outdated": 0.0, "narrowed": 0.01, "all": 0.06}
COLUMNS = ["point", "run", "estimator", "quantity", "t_s", "value"]


def inside(s: dict[str, Any], case: str, margin: float) -> float:
    by_view = 0.0 if s["orientation"] == "known" else 0.01 * s["height_m"] / 500
    by_map = TAKEN[case] * s["displacement_m"] / 1.7
    return float(1 - by_view - by_map + 0.02 * (margin - 1.5) / 1.5)


def rows(points: dict[str, dict[str, Any]], mean_m: float) -> Iterator[tuple[Any, ...]]:
    for (point, s), case, run in itertools.product(points.items(), MAPS, range(6)):
        for margin in MARGINS:
            part = inside(s, case, margin)
            classes = (0, 4) if s["network"] == "motorway" else (2, 4)
            names = ["pavement", "vehicles", *(f"{n}_{c}" for n in ("pavement", "vehicles") for c in classes)]
            yield from ((point, run, case, f"road_{name}", margin, part) for name in names)
            yield point, run, case, "road_whole_vehicles", margin, part - 0.1
            yield point, run, case, "road_excess", margin, 0.2 + margin / 30
            if case in ("displaced", "missing", "narrowed"):
                yield point, run, case, "road_affected", margin, 0.7
        if case == "displaced":
            factor = s["displacement_m"] / 1.7
            yield point, run, case, "road_displacement", 0, factor * (mean_m + 0.1 * (run - 2.5))
            yield point, run, case, "road_displacement_max", 0, factor * (mean_m * 2.6 + run)
            yield from ((point, run, case, "road_beyond", v, float(np.exp(-v / 2))) for v in np.arange(0, 10.5, 0.5))
            yield from ((point, run, case, "road_off", c, 0.02 if c == 4 else 0.01) for c in (0, 2, 4))


def study(mean_m: float = 1.7) -> StudyResult:
    names = ("network", "system", "height_m", "orientation", "displacement_m")
    settings = [(n, *view, 1.7) for n, view in itertools.product(("town", "motorway", "mixed"), VIEWS)]
    settings.append(("mixed", "antar", 500.0, "measured", 3.3))
    points: dict[str, dict[str, Any]] = {str(k): dict(zip(names, s, strict=True)) for k, s in enumerate(settings)}
    nothing = pd.DataFrame(columns=["point", "run", "estimator", "reason"])
    tables: dict[str, Any] = dict.fromkeys(
        ("comparison", "nees", "outliers", "failures", "support", "runtimes"), nothing
    )
    return StudyResult(
        folder=Path("nowhere"),
        name="kozempel-road-accuracy",
        title="",
        source="",
        scenario="road_accuracy",
        experiment=True,
        seed=1,
        runs=6,
        points=pd.DataFrame(list(points.values()), index=list(points)),
        scenarios=points,
        estimators=MAPS,
        measures=pd.DataFrame(list(rows(points, mean_m)), columns=COLUMNS),
        **tables,
    )


@pytest.fixture(scope="module")
def result() -> StudyResult:
    return study()


def test_views_and_single_runs(result: StudyResult) -> None:
    assert views(result) == ["known", "ANTAR at 500 m", "ARGOS at 1400 m"]
    # Once a network and displacement, not once an orientation.
    assert len(single(result, "road_displacement")) == 4 * 6
    assert np.isnan(value(pooled(result), quantity="road_pavement_1"))
    with pytest.raises(ValueError, match="one is needed"):
        value(pooled(result), quantity="road_pavement")


def test_tables_hold_percentages(result: StudyResult) -> None:
    faults = of(faults_table(result), network="town", map="all").iloc[0]
    assert faults["pavement [%]"] == pytest.approx(94)
    assert faults["pavement [%], ANTAR"] == pytest.approx(93)
    assert faults["whole vehicles [%], ANTAR"] == pytest.approx(83)
    assert faults["mask without a road [%]"] == pytest.approx(25)
    assert np.isnan(faults["concerned [%]"])
    assert of(faults_table(result), network="town", map="missing").iloc[0]["concerned [%]"] == pytest.approx(70)
    classes = classes_table(result)
    assert list(of(classes, network="motorway")["class"]) == ["0 (RQ 35.5)", "4 (RQ 7.5)"]
    assert of(classes, network="mixed")["pavement, 3 m"].tolist() == pytest.approx([95, 95])
    margins = margins_table(result)
    assert len(margins) == 3 * 3 * 3
    argos = of(margins, network="town", orientation="ARGOS at 1400 m")
    assert argos["vehicles [%]"].tolist() == pytest.approx([89.2, 91.2, 93.2])


def test_statements_follow_the_numbers(result: StudyResult) -> None:
    assert list(claims(result)["holds"]) == ["yes", "yes", "in part", "yes", "yes", "yes", "yes", "yes"]
    assert list(claims(study(0.8))["holds"])[:2] == ["no", "yes"]
    assert list(claims(study(4.0))["holds"])[:2] == ["no", "no"]


def test_figures_show_all_of_it(result: StudyResult) -> None:
    left, right = displacement_figure(result).axes
    assert len(right.lines) == 3 + 1
    assert right.lines[-1].get_ydata() == pytest.approx([6.1])
    assert len(left.patches) == 1
    axes = margins_figure(result).axes
    assert len(axes) == 6
    shown = {line.get_label(): np.asarray(line.get_ydata()) for line in axes[0].lines}
    np.testing.assert_allclose(shown["right map, known"], [88, 90, 92])
    for ax in classes_figure(result).axes:
        assert sum(str(line.get_label()).startswith("class") for line in ax.lines) == 2
