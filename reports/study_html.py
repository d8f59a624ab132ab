"""A study's folder to its metrics, tables, figures and one self-contained report."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from reports import display
from reports.html import embedded, template
from reports.outputs import FIGURES, TABLES
from reports.run import save_figures
from reports.studies import StudyResult, load_study
from sim.archive import write_atomically, write_text

T = TypeVar("T")
_SHOWN_ROWS = 400


def write_study(folder: Path) -> StudyResult:
    """Writes metrics.csv, table.csv (further ones table-LABEL.csv), figures/ and report.html of a study that has run.

    Raises
        ValueError: a table or figure cannot be made with the options it was given.
    """
    result = load_study(folder)
    asked = json.loads((folder / "study.json").read_text("utf-8"))
    write_atomically(folder / "metrics.csv", lambda p: result.metrics.to_csv(p, index=False))
    wanted = asked["table"] or [_default_table(result)]
    tables = [(spec, _made("table", TABLES, spec, result)) for spec in wanted]
    for i, (spec, table) in enumerate(tables):
        name = f"table-{spec['label']}.csv" if i else "table.csv"
        write_atomically(folder / name, lambda p, t=table: t.to_csv(p, index=False))
    figures = {spec["label"]: _made("figure", FIGURES, spec, result) for spec in asked["figure"]}
    images = save_figures(folder / "figures", figures)
    shown = [(_heading(spec), spec["caption"], embedded(images[spec["label"]])) for spec in asked["figure"]]
    provenance = json.loads((folder / "provenance.json").read_text("utf-8"))
    write_text(folder / "report.html", render(result, tables, shown, provenance))
    return result


def _default_table(result: StudyResult) -> dict[str, Any]:
    name = "measures" if result.experiment else "metrics"
    return {"name": name, "label": name, "caption": "", "options": {}}


def _made(kind: str, functions: Mapping[str, Callable[..., T]], spec: Mapping[str, Any], result: StudyResult) -> T:
    try:
        return functions[spec["name"]](result, **spec["options"])
    except (KeyError, ValueError) as error:
        raise ValueError(f"{kind} {spec['label']!r}: {type(error).__name__}: {error}") from error


def render(
    result: StudyResult,
    tables: list[tuple[dict[str, Any], pd.DataFrame]],
    figures: list[tuple[str, str, str]],
    provenance: Mapping[str, Any],
) -> str:
    """The report as one HTML text; figures are (heading, caption, image)."""
    seconds = result.runtimes.groupby("estimator", observed=True)["seconds"].median()
    crashed = result.failures[result.failures["kind"] == "exception"]
    return template("study.html.j2").render(
        title=result.title,
        source=result.source,
        name=result.name,
        scenario=result.scenario,
        experiment=result.experiment,
        seed=result.seed,
        runs=result.runs,
        points=len(result.points),
        tables=[(_heading(spec), spec["caption"], *cells(table)) for spec, table in tables],
        figures=figures,
        crashed=_reasons(crashed),
        failures=[] if result.experiment else _failures(result),
        settings=list(display.settings(next(iter(result.scenarios.values())))),
        keys=list(result.points.columns),
        seconds=[(label or "simulation", s) for label, s in seconds.items()],
        provenance=provenance,
    )


def _heading(spec: Mapping[str, Any]) -> str:
    return str(spec["label"]).replace("_", " ")


def cells(table: pd.DataFrame) -> tuple[list[tuple[str, str]], list[list[str]], int]:
    """Heads with the style of their column, "word" or "number"; rows as text; and how many rows are left out."""
    rows = [[_text(v) for v in row] for row in table.head(_SHOWN_ROWS).itertuples(index=False)]
    names = [c if "." in c else c.replace("_", " ") for c in map(str, table.columns)]
    styles = ["number" if pd.api.types.is_numeric_dtype(kind) else "word" for kind in table.dtypes]
    return list(zip(names, styles, strict=True)), rows, len(table) - len(rows)


def _text(value: Any) -> str:
    if isinstance(value, float | np.floating):
        return display.number(float(value))
    return "" if value is None else str(value)


def _reasons(failures: pd.DataFrame) -> list[tuple[str, int, str, int, str]]:
    """Reason, number, first point and run, and its traceback, of failed runs."""
    return [
        (str(reason), len(part), str(part["point"].iloc[0]), int(part["run"].iloc[0]), str(part["traceback"].iloc[0]))
        for reason, part in failures.groupby("reason", sort=False)
    ]


def _failures(result: StudyResult) -> list[tuple[str, int, int, list[tuple[str, int]]]]:
    """Per estimator: windows tried, failed, and reasons with their numbers."""
    rows = []
    for label in result.estimators:
        support = result.support[result.support["estimator"] == label]
        reasons = result.failures.loc[result.failures["estimator"] == label, "reason"].value_counts(sort=False)
        counted = [(str(k), int(v)) for k, v in reasons.items()]
        rows.append((label, int(support["windows"].sum()), int(support["failed"].sum()), counted))
    return rows
