"""Tables, figures and statements on filters, made of results whose answers are known."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from reports.recursive.precision import holds_up_to, precision_errors, precision_lost, precision_table
from reports.recursive.scalar import gain_table, scalar_figure, start_table, steady_state, tuning_table
from reports.recursive.statements import claims
from reports.studies import StudyResult

FORMS = ("plain", "joseph", "potter", "carlson", "udu")
RANGES = (1e2, 1e4, 1e6, 1e8, 1e10, 1e12)


def result(name: str, cases: tuple[str, ...], settings: dict[str, dict[str, Any]], rows: pd.DataFrame) -> StudyResult:
    """A study of an experiment with rows (point, run, estimator, quantity, t_s, value)."""
    nothing = pd.DataFrame(columns=["point", "run", "estimator", "reason"])
    return StudyResult(
        folder=Path("nowhere"),
        name=name,
        title="",
        source="",
        scenario="experiment",
        experiment=True,
        seed=1,
        runs=int(rows["run"].nunique()),
        points=pd.DataFrame(list(settings.values()), index=list(settings)),
        scenarios=settings,
        estimators=cases,
        comparison=nothing,
        nees=nothing,
        outliers=nothing,
        failures=nothing,
        support=nothing,
        measures=rows,
        runtimes=nothing,
    )


def precision_rows(settings: dict[str, dict[str, Any]]) -> Iterator[tuple[Any, ...]]:
    """Dense forms lose a digit per decade and break from 10^8 on, roots half a digit and never."""
    for (point, s), form, run, step in itertools.product(settings.items(), FORMS, range(4), (1, 10)):
        root = form not in ("plain", "joseph")
        lost = not root and s["range"] / s["spread"] ** 0.25 >= 1e8
        error = 1e-7 * s["range"] ** (0.5 if root else 1.0) * (1 + 0.1 * run)
        yield point, run, form, "lost", step, float(lost)
        yield point, run, form, "least_variance", step, -1.0 if lost else 1.0
        yield point, run, form, "covariance_error", step, np.inf if lost and run == 0 else error
        yield point, run, form, "state_error", step, error


@pytest.fixture(scope="module")
def precision() -> StudyResult:
    settings = {f"{s:g} {r:g}": {"spread": s, "range": r} for s, r in itertools.product((1.0, 1e6), RANGES)}
    columns = ["point", "run", "estimator", "quantity", "t_s", "value"]
    return result("dickmanns-precision", FORMS, settings, pd.DataFrame(list(precision_rows(settings)), columns=columns))


def test_the_range_a_form_survives(precision: StudyResult) -> None:
    alike, apart = holds_up_to(precision, 1.0), holds_up_to(precision, 1e6)
    assert list(alike.index) == list(FORMS)
    assert alike.tolist() == [1e6, 1e6, 1e12, 1e12, 1e12]
    assert apart["plain"] == 1e8
    table = precision_table(precision, steps=10).set_index(["spread", "form"])
    assert table.loc[(1.0, "plain"), "lost at 1e10 [%]"] == 100
    assert table.loc[(1.0, "udu"), "lost at 1e10 [%]"] == 0
    assert table.loc[(1.0, "udu"), "error of P at 1e4"] == pytest.approx(1.15e-5)  # median of four runs
    assert table.loc[(1.0, "plain"), "least variance at 1e10"] == -1


def test_statements_on_precision_follow_the_numbers(precision: StudyResult) -> None:
    found = claims(precision)
    assert list(found["holds"]) == ["yes", "yes", "no", "yes", "yes", "yes"]
    assert "plain 1.00" in found["found here"][3]
    assert "carlson 0.50" in found["found here"][3]
    sound = precision.measures.assign(
        value=precision.measures["value"].where(precision.measures["quantity"] != "lost", 0.0)
    )
    scenarios = {str(k): dict(v) for k, v in precision.scenarios.items()}
    assert list(claims(result("dickmanns-precision", FORMS, scenarios, sound))["holds"][:2]) == ["no", "no"]


def test_figures_of_precision_mark_what_is_lost(precision: StudyResult) -> None:
    figure = precision_errors(precision, steps=10)
    crosses = [line for line in figure.axes[0].lines if line.get_marker() == "x"]
    assert len(crosses) == 2
    assert [np.min(np.asarray(line.get_xdata())) for line in crosses] == [1e8, 1e8]
    lost = {line.get_label(): line.get_ydata() for line in precision_lost(precision).axes[0].lines}
    assert np.asarray(lost["plain"]).tolist() == [0, 0, 0, 100, 100, 100]
    with pytest.raises(ValueError, match="steps: found 7, allowed: 1, 10"):
        precision_errors(precision, steps=7)


def scalar_rows(settings: dict[str, dict[str, Any]], runs: int) -> Iterator[tuple[Any, ...]]:
    """Filters that are what theory says from the first step on; errors two standard deviations off by turns."""
    for (point, s), run, step in itertools.product(settings.items(), range(runs), (1, 5, 20, 100)):
        gain = steady_state(s["noise"])[1]
        stated = s["start"] * s["stated_start"]
        if step == 1:
            gain = stated / (stated + 1)
        sign = (-1) ** run
        slow = 10.0 if s["stated_start"] < 1 and step < 20 else 1.0
        error = slow * np.sqrt(gain) * sign * (0.5 + run / (runs - 1)) / 1.04
        yield point, run, "filter", "gain", step, gain
        yield point, run, "filter", "stated_variance", step, gain
        yield point, run, "filter", "error", step, error
        yield point, run, "filter", "nees", step, error**2 / gain
        yield point, run, "filter", "nis", step, 1.0


@pytest.fixture(scope="module")
def scalar() -> StudyResult:
    usual = {"a": 1.0, "noise": 1 / 90, "stated_noise": 1.0, "start": 100.0, "stated_start": 1.0}
    varied: list[dict[str, float]] = [{}]
    varied += [{"noise": q} for q in (1.0, 18.05)]
    varied += [{"stated_start": f} for f in (1e-4, 1e-2, 1e4)]
    varied += [{"stated_noise": f} for f in (1e-2, 1e2)]
    settings = {str(v): usual | v for v in varied}
    columns = ["point", "run", "estimator", "quantity", "t_s", "value"]
    rows = pd.DataFrame(list(scalar_rows(settings, 20)), columns=columns)
    return result("dickmanns-scalar-filter", ("filter",), settings, rows)


@pytest.mark.parametrize("noise", [1e-3, 1 / 90, 18.05, 1e4])
@pytest.mark.parametrize("a", [1.0, 0.5])
def test_the_steady_state_solves_riccati_s_equation(noise: float, a: float) -> None:
    predicted, gain = steady_state(noise, a)
    assert predicted == pytest.approx(a * a * (1 - gain) * predicted + noise, rel=1e-10)
    assert gain == pytest.approx(predicted / (predicted + 1))


def test_the_source_s_gains(scalar: StudyResult) -> None:
    assert steady_state(18.05)[1] == pytest.approx(0.95)
    assert steady_state(1 / 90)[1] == pytest.approx(0.1)
    table = gain_table(scalar)
    assert table["Q / R"].tolist() == pytest.approx([1 / 90, 1.0, 18.05])
    assert table["gain"].tolist() == pytest.approx(table["gain, Riccati"].tolist())


def test_each_series_varies_one_setting(scalar: StudyResult) -> None:
    start = start_table(scalar)
    assert start["P*(0) / true"].tolist() == [1e-4, 1e-2, 1.0, 1e4]
    assert start["within 10 % from step"].tolist() == [20, 20, 1, 1]
    assert tuning_table(scalar)["stated Q / true Q"].tolist() == [1e-2, 1.0, 1e2]
    assert len(scalar_figure(scalar).axes) == 4


def test_statements_on_tuning_follow_the_numbers(scalar: StudyResult) -> None:
    found = claims(scalar)
    assert list(found["holds"]) == ["yes", "yes", "yes", "yes", "in part", "yes", "no"]


def test_a_study_the_source_says_nothing_of(scalar: StudyResult) -> None:
    with pytest.raises(KeyError):
        claims(result("x", ("filter",), {}, scalar.measures))
