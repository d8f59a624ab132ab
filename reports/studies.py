"""What a study found: its tables over all points and runs, and the tables and figures any study can make of them.

A function registered in `reports.outputs` takes the `StudyResult` and keyword arguments, which are its options in the
study file:

    [[figure]]
    name = "lines"; over = "measure.sigma_px"; statistic = "rms"
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
from matplotlib.figure import Figure

from reports.figures.sweep import sweep_lines, sweep_map
from reports.measures import MEASURES, measure_rows
from reports.metrics import Pooled, as_table, pooled_rows
from reports.run import Run, load_run

RESULTS = ("comparison", "nees", "outliers", "failures", "support", "measures")
_CATEGORIES = ("point", "estimator", "quantity", "entity", "axis", "kind")


@dataclass(frozen=True, eq=False)
class StudyResult:
    """All runs of a study, every table with the columns point, run and estimator first.

    points: one row per point under its name, a column per swept key; scenarios: the resolved scenario of every point;
    estimators: labels in the file's order. comparison: error rows (quantity, t_s, entity, axis, error, sigma, truth,
    bound, distance_m); nees (quantity, t_s, nees, disjoint); outliers (t_s, tracks, tp, fp, fn, flagged) of every
    window; failures (kind, t_s, reason, traceback), kind "window", "estimation" or "exception" (the whole run, of no
    estimator); support (wanted, estimated, windows, failed, overlap, over_ground) per run; measures
    (quantity, t_s, value), what is no error of a window; runtimes (seconds), the simulation's of no estimator.

    experiment: whether ``scenario`` is that of a numeric experiment, whose cases stand in the place of estimators, and
    whose t_s is a number of steps.
    """

    folder: Path
    name: str
    title: str
    source: str
    scenario: str
    experiment: bool
    seed: int
    runs: int
    points: pd.DataFrame
    scenarios: Mapping[str, Mapping[str, Any]]
    estimators: tuple[str, ...]
    comparison: pd.DataFrame
    nees: pd.DataFrame
    outliers: pd.DataFrame
    failures: pd.DataFrame
    support: pd.DataFrame
    measures: pd.DataFrame
    runtimes: pd.DataFrame

    @cached_property
    def metrics(self) -> pd.DataFrame:
        """The columns of metrics.csv, runs of a point pooled; without run times, so the same whoever ran the study."""
        return as_table(row for point in self.points.index for row in self._point_rows(str(point)))

    def _point_rows(self, point: str) -> Iterator[dict[str, Any]]:
        tables = {name: _only(getattr(self, name), "point", point) for name in RESULTS}
        for estimator in self.estimators:
            of = {name: _only(table, "estimator", estimator) for name, table in tables.items()}
            label = {"scenario": self.scenario, "seed": self.seed, "estimator": estimator, "point": point}
            if len(of["measures"]):
                yield from (row | label for row in measure_rows(of["measures"]))
            if of["support"].empty:
                continue
            pooled = Pooled(
                of["comparison"], of["nees"], of["outliers"], of["failures"]["reason"], of["support"], np.empty(0)
            )
            yield from (row | label for row in pooled_rows(pooled))

    def select(
        self, quantity: str, axis: str, statistic: str, *, entity: str | None = None, bin: str = ""
    ) -> pd.DataFrame:
        """Rows of `metrics` of one statistic, joined with the swept keys; of the target unless an entity is named."""
        m = self.metrics
        rows = m[(m["quantity"] == quantity) & (m["axis"] == axis) & (m["statistic"] == statistic) & (m["bin"] == bin)]
        rows = rows[rows["entity"] != "smoothed"] if entity is None else rows[rows["entity"] == entity]
        return rows.join(self.points, on="point").reset_index(drop=True)

    def example(self, point: str | None = None) -> Run:
        """Run 0 of a point (by default the first) as a whole: truth, observations and estimates.

        Raises
            FileNotFoundError: the study keeps no examples.
        """
        number = 0 if point is None else list(self.points.index).index(point)
        return load_run(self.folder / "examples" / str(number), self.scenario)


def _only(table: pd.DataFrame, column: str, value: str) -> pd.DataFrame:
    return table[table[column] == value]


def load_study(folder: Path) -> StudyResult:
    """Reads the folder of a finished study."""
    study = json.loads((folder / "study.json").read_text("utf-8"))
    points = pd.DataFrame([p["settings"] for p in study["points"]], index=[p["point"] for p in study["points"]])
    order = {"point": list(points.index), "estimator": study["estimators"]}
    files = {name: folder / "results" / f"{name}.parquet" for name in RESULTS}
    files["runtimes"] = folder / "runtimes.parquet"
    plain: dict[str, Any] = {k: study[k] for k in ("name", "title", "source", "scenario", "experiment", "seed", "runs")}
    tables: dict[str, Any] = {name: _read(path, order) for name, path in files.items()}
    return StudyResult(
        folder=folder,
        **plain,
        points=points,
        scenarios={p["point"]: p["scenario"] for p in study["points"]},
        estimators=tuple(study["estimators"]),
        **tables,
    )


def _read(path: Path, order: Mapping[str, list[str]]) -> pd.DataFrame:
    """A table with its repeated strings as categories, points and estimators in the study's order."""
    names = pq.read_schema(path).names
    table: pd.DataFrame = pq.read_table(path, read_dictionary=[c for c in _CATEGORIES if c in names]).to_pandas()
    for column, values in order.items():
        known = ["", *values] if column == "estimator" else values
        # pandas 3.0 leaves the codes of no rows at 8 bits, however many the categories.
        table[column] = table[column].cat.set_categories(known) if len(table) else pd.Categorical([], known)
    return table


def metrics(
    result: StudyResult,
    *,
    quantity: str = "position",
    axis: str = "z",
    statistics: tuple[str, ...] = ("bias", "rms", "crb", "efficiency"),
    bin: str = "",
) -> pd.DataFrame:
    """Statistics with their 95 % intervals, one row per point and estimator."""
    keys = ["point", "estimator"]
    found = pd.DataFrame([(p, e) for p in result.points.index for e in result.estimators], columns=keys).join(
        result.points, on="point"
    )
    for statistic in statistics:
        rows = result.select(quantity, axis, statistic, bin=bin)
        names = {"value": statistic, "ci_low": f"{statistic}_low", "ci_high": f"{statistic}_high"}
        part = rows[[*keys, *names]].rename(columns=names).dropna(axis=1, how="all")
        found = found.merge(part, on=keys, how="left")
    return found.drop(columns="point")


def lines(
    result: StudyResult,
    *,
    over: str,
    x_label: str = "",
    quantity: str = "position",
    axis: str = "z",
    statistic: str = "rms",
    bin: str = "",
    bound: bool = False,
    log_x: bool = False,
    log_y: bool = False,
) -> Figure:
    """A statistic over a swept key, a line per estimator and per value of the other keys."""
    rows = result.select(quantity, axis, statistic, bin=bin)
    others = [k for k in result.points.columns if k != over]
    rows["line"] = _lines(rows, ["estimator", *others])
    limit = None
    if bound:
        bounds = result.select(quantity, axis, "crb", bin=bin)
        bounds["line"] = _lines(bounds, others)
        limit = bounds.groupby(["line", over], sort=False)["value"].mean().reset_index()
    labels = (x_label or over, _label(rows, quantity, axis, statistic))
    return sweep_lines(rows, over, labels, bound=limit, log_x=log_x, log_y=log_y)


def measures(result: StudyResult) -> pd.DataFrame:
    """What an experiment measured, pooled over runs, with 95 % intervals."""
    m = result.metrics
    rows = m[m["quantity"].isin(MEASURES)].join(result.points, on="point").rename(columns={"bin": "step"})
    columns = [*result.points.columns, "estimator", "step", "quantity", "statistic", "value", "ci_low", "ci_high"]
    return rows[columns].reset_index(drop=True)


def _lines(rows: pd.DataFrame, columns: list[str]) -> list[str]:
    return [", ".join(map(str, v)) for v in rows[columns].to_numpy()]


def heat_map(
    result: StudyResult,
    *,
    x: str,
    y: str,
    x_label: str = "",
    y_label: str = "",
    quantity: str = "position",
    axis: str = "z",
    statistic: str = "rms",
    bin: str = "",
    log: bool = False,
) -> Figure:
    """A statistic over two swept keys, a panel per estimator."""
    rows = result.select(quantity, axis, statistic, bin=bin)
    labels = (x_label or x, y_label or y, _label(rows, quantity, axis, statistic))
    return sweep_map(rows, x, y, labels, result.estimators, log)


def _label(rows: pd.DataFrame, quantity: str, axis: str, statistic: str) -> str:
    what = quantity.replace("_", " ") + (f" {axis}" if axis != "all" else "")
    unit = rows["unit"].iloc[0] if len(rows) else "1"
    return f"{statistic} of {what}" + (f" [{unit}]" if unit != "1" else "")
