"""What an error table comes to: every statistic of every quantity, pooled over time and runs, as metrics.csv.

Intervals (95 %) are bootstraps: within one run of blocks of a window's length, because neighbouring windows share
frames; over several runs of whole runs (percentiles then have none).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from reports.bootstrap import interval, interval_of_sums
from reports.consistency import DOF, pooled_nees
from reports.errors import SMOOTHED, UNITS
from reports.evaluation import OUTLIER_COLUMNS, Evaluation
from reports.statistics import STATISTICS, Direction, Statistic
from sim.streams import stream

Array = np.ndarray

METRIC_COLUMNS = [
    *("scenario", "seed", "runs", "estimator", "quantity", "axis", "statistic", "value", "unit", "direction", "n"),
    *("ci_low", "ci_high", "reference", "source", "entity", "bin", "point"),
]
_EMPTY = {"ci_low": np.nan, "ci_high": np.nan, "reference": "", "source": "", "entity": "", "bin": "", "point": ""}
SUPPORT_COLUMNS = ["wanted", "estimated", "windows", "failed", "overlap", "over_ground"]
BIN_M = 10.0
MIN_BIN = 3


_BIN_STATISTICS = ("bias", "rms", "crb", "efficiency")


@dataclass(frozen=True, eq=False)
class Pooled:
    """What is known of one estimator over one run or many.

    comparison: error rows (run, quantity, t_s, entity, axis, error, bound, distance_m); nees; outliers of every window;
    failures: their reasons; support: wanted, estimated, windows, failed, overlap and over_ground, one row per run;
    runtime_s of every estimation, as far as known.
    """

    comparison: pd.DataFrame
    nees: pd.DataFrame
    outliers: pd.DataFrame
    failures: pd.Series
    support: pd.DataFrame
    runtime_s: Float[Array, "r"]


def metrics_table(evaluations: Sequence[Evaluation], stages: Mapping[str, float] | None = None) -> pd.DataFrame:
    """The columns of metrics.csv, one row per number; runs of the same scenario, seed and estimator are pooled.

    stages: run times [s] by name, which belong to no estimator.
    """
    groups: dict[tuple[str, int, str], list[Evaluation]] = {}
    for e in evaluations:
        groups.setdefault((e.scenario, e.seed, e.estimator), []).append(e)
    rows = [
        {"scenario": scenario, "seed": seed, "estimator": estimator} | row
        for (scenario, seed, estimator), group in groups.items()
        for row in pooled_rows(_gathered(group))
    ]
    if evaluations:
        first = evaluations[0]
        rows += [
            {"scenario": first.scenario, "seed": first.seed, "runs": 1, "estimator": "", "entity": stage}
            | metric_row("runtime", "all", "sum", seconds, "s", "lower", 1)
            for stage, seconds in (stages or {}).items()
        ]
    return as_table(rows)


def as_table(rows: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """Rows as the columns of metrics.csv, what they leave out empty."""
    return pd.DataFrame([_EMPTY | dict(row) for row in rows], columns=METRIC_COLUMNS)


def _gathered(group: Sequence[Evaluation]) -> Pooled:
    table = pd.concat([e.comparison for e in group], ignore_index=True)
    failed = table["quantity"] == "failure"
    seconds = np.array([e.runtime_s for e in group])
    return Pooled(
        comparison=table[~failed],
        nees=pd.concat([e.nees for e in group], ignore_index=True),
        outliers=pd.concat([e.outliers.assign(run=e.run) for e in group], ignore_index=True),
        failures=table.loc[failed, "entity"],
        support=pd.DataFrame([{name: getattr(e, name) for name in SUPPORT_COLUMNS} for e in group]),
        runtime_s=seconds[np.isfinite(seconds)],
    )


def metric_row(
    quantity: str, axis: str, statistic: str, value: float, unit: str, direction: Direction, n: int
) -> dict[str, Any]:
    return {
        "quantity": quantity,
        "axis": axis,
        "statistic": statistic,
        "value": float(value),
        "unit": unit,
        "direction": direction,
        "n": n,
    }


def pooled_rows(p: Pooled) -> Iterator[dict[str, Any]]:
    """Every metric of one estimator, without the columns that say whose it is."""
    reference = "over ground" if p.support["over_ground"].any() else "relative"
    overlap, runs = int(p.support["overlap"].max()), len(p.support)
    for (quantity, entity), part in p.comparison.groupby(["quantity", "entity"], sort=False, observed=True):
        label = {"entity": entity, "reference": reference if quantity in ("speed", "yaw_rate") else ""}
        yield from ({"runs": runs} | row | label for row in _error_rows(str(quantity), part, overlap, STATISTICS))
        if quantity == "position" and entity != SMOOTHED:
            yield from ({"runs": runs} | row | label for row in _bin_rows(part, overlap))
    for rows in (_nees_rows(p.nees), _support_rows(p)):
        yield from ({"runs": runs} | row for row in rows)


@dataclass(frozen=True, eq=False)
class Stack:
    """Errors and bounds (n, 2k) with the run (n,) of each row, ordered by run and time."""

    run: Int[Array, "n"]
    values: Float[Array, "n k"]

    def bounded(self) -> Stack:
        """The rows whose bound is known."""
        known = np.isfinite(self.values).all(axis=1)
        return Stack(self.run[known], self.values[known])

    def per_run(self, statistic: Statistic) -> Float[Array, "r q"]:
        """Sums of a statistic's summands in every run."""
        assert statistic.sums is not None
        starts = np.flatnonzero(np.append(True, self.run[1:] != self.run[:-1]))
        return np.asarray(np.add.reduceat(statistic.sums(self.values), starts, axis=0))


def stacks(part: pd.DataFrame) -> dict[str, Stack]:
    """Errors of one quantity and entity per axis and, for vectors, over all axes."""
    wide = part.pivot(  # noqa: PD010 - refuses duplicates, which pivot_table would average
        index=["run", "t_s"], columns="axis", values=["error", "bound"]
    ).sort_index()
    axes = list(dict.fromkeys(part["axis"]))
    run = wide.index.get_level_values("run").to_numpy()
    error, bound = (wide[value][axes].to_numpy() for value in ("error", "bound"))
    found = {a: Stack(run, np.stack([error[:, i], bound[:, i]], axis=1)) for i, a in enumerate(axes)}
    if len(axes) > 1:
        found["all"] = Stack(run, np.hstack([error, bound]))
    return found


def estimate(statistic: Statistic, stack: Stack, overlap: int, component: str) -> tuple[float, float, float]:
    """A statistic with its 95 % interval, NaN where there is none.

    Of one run by blocks of ``overlap`` neighbouring windows, of several by whole runs.
    """
    value = float(statistic.pool(stack.values))
    if not statistic.interval:
        return value, np.nan, np.nan
    if stack.run[0] == stack.run[-1]:
        return value, *interval(statistic.pool, stack.values, overlap, stream(0, 0, component))
    if statistic.sums is None or statistic.finish is None:
        return value, np.nan, np.nan
    return value, *interval_of_sums(statistic.finish, stack.per_run(statistic))


def _error_rows(
    quantity: str, part: pd.DataFrame, overlap: int, names: Iterable[str], axes: Sequence[str] | None = None
) -> Iterator[dict[str, Any]]:
    for axis, stack in stacks(part).items():
        if axes is not None and axis not in axes:
            continue
        bounded = stack.bounded()
        for name in names:
            s = STATISTICS[name]
            data = bounded if s.needs_bound else stack
            if len(data.run) < (2 if name == "std" else 1):
                continue
            value, low, high = estimate(s, data, overlap, f"{quantity}/{axis}/{name}")
            if np.isfinite(value):
                row = metric_row(quantity, axis, name, value, s.unit or UNITS[quantity], s.direction, len(data.run))
                yield row | {"ci_low": low, "ci_high": high}


def _bin_rows(part: pd.DataFrame, overlap: int) -> Iterator[dict[str, Any]]:
    """Depth error by true distance."""
    depth = part[part["axis"] == "z"]
    for start, rows in depth.groupby(np.floor(depth["distance_m"] / BIN_M) * BIN_M):
        if len(rows) < MIN_BIN:
            continue
        name = f"{start:.0f}-{start + BIN_M:.0f} m"
        for row in _error_rows("position", rows, overlap, _BIN_STATISTICS, axes=("z",)):
            yield row | {"bin": name}


def _nees_rows(nees: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Mean NEES over its degrees of freedom, of independent windows only; the 99 % chi-square band as reference."""
    for quantity, part in nees[nees["disjoint"].astype(bool)].groupby("quantity", sort=False, observed=True):
        values = part["nees"].to_numpy(float)[:, None] / DOF
        mean, lower, upper = pooled_nees(part["nees"].to_numpy(float))
        row = metric_row(str(quantity), "all", "nees", mean, "1", "one", len(values))
        low, high = interval(lambda v: v[..., 0].mean(axis=-1), values, 1, stream(0, 0, f"{quantity}/nees"))
        band = {"reference": f"{lower:.3f}..{upper:.3f}", "source": "99 % chi-square band, disjoint windows"}
        yield row | {"ci_low": low, "ci_high": high} | band


def _ratio(s: Array) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(s[..., 0] / s[..., 1])


def _over_runs(sums: pd.DataFrame) -> dict[str, float]:
    """95 % interval of the ratio of two sums, given per run."""
    low, high = interval_of_sums(_ratio, sums.to_numpy(float))
    return {"ci_low": low, "ci_high": high}


def _support_rows(p: Pooled) -> Iterator[dict[str, Any]]:
    """Share of the wanted frames that have an estimate, tracks taken for outliers, failures by reason, run time."""
    wanted, estimated, windows, failed = (int(p.support[k].sum()) for k in SUPPORT_COLUMNS[:4])
    if wanted:
        row = metric_row("trajectory", "all", "converged", estimated / wanted, "1", "higher", wanted)
        yield row | _over_runs(p.support[["estimated", "wanted"]])
    yield metric_row("trajectory", "all", "failed", failed, "1", "lower", windows)
    yield from _outlier_rows(p.outliers)
    for reason, count in p.failures.value_counts(sort=False).items():
        yield metric_row("failure", "all", "failed", count, "1", "lower", windows) | {"entity": reason}
    if len(p.runtime_s):
        yield metric_row("runtime", "all", "median", float(np.median(p.runtime_s)), "s", "lower", len(p.runtime_s))


def _outlier_rows(outliers: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Mean numbers of tracks in a window; none where there is nothing to count."""
    if not outliers[OUTLIER_COLUMNS].to_numpy().any():
        return
    for name in OUTLIER_COLUMNS:
        counts = outliers[name].astype(float)
        row = metric_row("outlier", "all", name, counts.mean(), "1", "higher" if name == "tp" else "lower", len(counts))
        yield row | _over_runs(counts.groupby(outliers["run"]).agg(["sum", "size"]))
