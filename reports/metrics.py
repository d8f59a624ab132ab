"""What an error table comes to: a registry of statistics, pooled over time and runs, with bootstrap intervals.

Squared errors are pooled, never averaged RMS values; percentiles come from the data. Over several axes ("all") a
statistic is that of the vectors' lengths: the bias is the length of the mean vector, the standard deviation the root of
the summed variances. Intervals (95 %) are block bootstraps: blocks of a window's length within one run, because
neighbouring windows share frames, and of a run's length over several runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd
from jaxtyping import Float

from reports.bootstrap import interval
from reports.consistency import DOF, pooled_nees
from reports.errors import SMOOTHED, UNITS
from reports.evaluation import Evaluation
from sim.streams import stream

Array = np.ndarray
Direction = Literal["lower", "higher", "zero", "one"]

METRIC_COLUMNS = [
    *("scenario", "seed", "runs", "estimator", "quantity", "axis", "statistic", "value", "unit", "direction", "n"),
    *("ci_low", "ci_high", "reference", "source", "entity", "bin", "point"),
]
_EMPTY = {"ci_low": np.nan, "ci_high": np.nan, "reference": "", "source": "", "entity": "", "bin": "", "point": ""}
BIN_M = 10.0
MIN_BIN = 3


@dataclass(frozen=True)
class Statistic:
    """``pool`` maps errors and bounds, stacked (..., n, 2k) as [errors, bounds], to (...).

    unit None means that of the quantity; ``interval`` whether a bootstrap interval makes sense.
    """

    direction: Direction
    pool: Callable[[Float[Array, "*b n k"]], Float[Array, "*b"]]
    unit: str | None = None
    needs_bound: bool = False
    interval: bool = True


def _error(v: Array) -> Array:
    return v[..., : v.shape[-1] // 2]


def _bound(v: Array) -> Array:
    return v[..., v.shape[-1] // 2 :]


def _length(x: Array) -> Array:
    return np.asarray(np.sqrt(np.sum(x * x, axis=-1)))


def _bias(v: Array) -> Array:
    mean = _error(v).mean(axis=-2)
    return np.asarray(mean[..., 0] if mean.shape[-1] == 1 else _length(mean))


def _std(v: Array) -> Array:
    return np.asarray(np.sqrt(_error(v).var(axis=-2, ddof=1).sum(axis=-1)))


def _mean_square(x: Array) -> Array:
    return np.asarray(np.sum(x * x, axis=-1).mean(axis=-1))


def _efficiency(v: Array) -> Array:
    """sqrt(bound / mean squared error); NaN where there is no error at all."""
    bound, error = _mean_square(_bound(v)), _mean_square(_error(v))
    return np.asarray(np.sqrt(np.divide(bound, error, out=np.full_like(bound, np.nan), where=error > 0)))


STATISTICS: dict[str, Statistic] = {
    "bias": Statistic("zero", _bias),
    "std": Statistic("lower", _std),
    "rms": Statistic("lower", lambda v: np.sqrt(_mean_square(_error(v)))),
    "p95": Statistic("lower", lambda v: np.quantile(_length(_error(v)), 0.95, axis=-1)),
    "max": Statistic("lower", lambda v: _length(_error(v)).max(axis=-1), interval=False),
    "crb": Statistic("lower", lambda v: np.sqrt(_mean_square(_bound(v))), needs_bound=True, interval=False),
    "efficiency": Statistic("higher", _efficiency, unit="1", needs_bound=True),
}
_BIN_STATISTICS = ("bias", "rms", "crb", "efficiency")


def metrics_table(evaluations: Sequence[Evaluation], stages: Mapping[str, float] | None = None) -> pd.DataFrame:
    """The columns of metrics.csv, one row per number; runs of the same scenario, seed and estimator are pooled.

    stages: run times [s] by name, which belong to no estimator.
    """
    groups: dict[tuple[str, int, str], list[Evaluation]] = {}
    for e in evaluations:
        groups.setdefault((e.scenario, e.seed, e.estimator), []).append(e)
    rows = [
        {"scenario": scenario, "seed": seed, "runs": len(group), "estimator": estimator} | row
        for (scenario, seed, estimator), group in groups.items()
        for row in _group_rows(group)
    ]
    if evaluations:
        first = evaluations[0]
        rows += [
            {"scenario": first.scenario, "seed": first.seed, "runs": 1, "estimator": "", "entity": stage}
            | _row("runtime", "all", "sum", seconds, "s", "lower", 1)
            for stage, seconds in (stages or {}).items()
        ]
    return pd.DataFrame([_EMPTY | row for row in rows], columns=METRIC_COLUMNS)


def _row(
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


def _group_rows(group: list[Evaluation]) -> Iterator[dict[str, Any]]:
    table = pd.concat([e.comparison for e in group], ignore_index=True)
    reference = "over ground" if group[0].over_ground else "relative"
    errors = table[table["quantity"] != "failure"]
    for (quantity, entity), part in errors.groupby(["quantity", "entity"], sort=False):
        label = {"entity": entity, "reference": reference if quantity in ("speed", "yaw_rate") else ""}
        block = _block(part, max(e.overlap for e in group))
        yield from (row | label for row in _error_rows(str(quantity), part, block, tuple(STATISTICS)))
        if quantity == "position" and entity != SMOOTHED:
            yield from (row | label for row in _bin_rows(part, block))
    yield from _nees_rows(pd.concat([e.nees for e in group], ignore_index=True) if group else None)
    yield from _support_rows(group, table)


def _block(part: pd.DataFrame, overlap: int) -> int:
    """Rows that stay together in the bootstrap: windows that overlap in one run, whole runs otherwise."""
    per_run = part.groupby("run")["t_s"].nunique()
    return min(overlap, int(per_run.iloc[0])) if len(per_run) == 1 else int(per_run.median())


def _stack(part: pd.DataFrame) -> dict[str, Array]:
    """(n, 2k) errors and bounds per axis and, for vectors, over all axes; rows ordered by run and time."""
    wide = part.pivot(  # noqa: PD010 - refuses duplicates, which pivot_table would average
        index=["run", "t_s"], columns="axis", values=["error", "bound"]
    ).sort_index()
    axes = list(dict.fromkeys(part["axis"]))
    stacks = {a: wide[[("error", a), ("bound", a)]].to_numpy() for a in axes}
    if len(axes) > 1:
        stacks["all"] = wide[[(v, a) for v in ("error", "bound") for a in axes]].to_numpy()
    return stacks


def _error_rows(
    quantity: str, part: pd.DataFrame, block: int, statistics: Sequence[str], axes: Sequence[str] | None = None
) -> Iterator[dict[str, Any]]:
    for axis, values in _stack(part).items():
        if axes is not None and axis not in axes:
            continue
        bounded = values[np.isfinite(values).all(axis=1)]
        for name in statistics:
            s = STATISTICS[name]
            data = bounded if s.needs_bound else values
            if len(data) < (2 if name == "std" else 1):
                continue
            value = float(s.pool(data))
            if not np.isfinite(value):
                continue
            row = _row(quantity, axis, name, value, s.unit or UNITS[quantity], s.direction, len(data))
            if s.interval:
                rng = stream(0, 0, f"{quantity}/{axis}/{name}")
                row["ci_low"], row["ci_high"] = interval(s.pool, data, block, rng)
            yield row


def _bin_rows(part: pd.DataFrame, block: int) -> Iterator[dict[str, Any]]:
    """Depth error by true distance."""
    lower = np.floor(part["distance_m"] / BIN_M) * BIN_M
    for start, rows in part.groupby(lower):
        if rows["t_s"].nunique() < MIN_BIN:
            continue
        name = f"{start:.0f}-{start + BIN_M:.0f} m"
        for row in _error_rows("position", rows, block, _BIN_STATISTICS, axes=("z",)):
            yield row | {"bin": name}


def _nees_rows(nees: pd.DataFrame | None) -> Iterator[dict[str, Any]]:
    """Mean NEES over its degrees of freedom, of independent windows only; the 99 % chi-square band as reference."""
    if nees is None or nees.empty:
        return
    for quantity, part in nees[nees["disjoint"].astype(bool)].groupby("quantity", sort=False):
        values = part["nees"].to_numpy(float)[:, None] / DOF
        mean, lower, upper = pooled_nees(part["nees"].to_numpy(float))
        row = _row(str(quantity), "all", "nees", mean, "1", "one", len(values))
        low, high = interval(lambda v: v[..., 0].mean(axis=-1), values, 1, stream(0, 0, f"{quantity}/nees"))
        band = {"reference": f"{lower:.3f}..{upper:.3f}", "source": "99 % chi-square band, disjoint windows"}
        yield row | {"ci_low": low, "ci_high": high} | band


def _support_rows(group: list[Evaluation], table: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Share of the wanted frames that have an estimate, failures by reason, run time."""
    wanted, windows = sum(e.wanted for e in group), sum(e.windows for e in group)
    if wanted:
        share = sum(e.estimated for e in group) / wanted
        yield _row("trajectory", "all", "converged", share, "1", "higher", wanted)
    yield _row("trajectory", "all", "failed", sum(e.failed for e in group), "1", "lower", windows)
    outliers = pd.concat([e.outliers for e in group], ignore_index=True)
    for name in outliers.columns if len(outliers) else ():
        direction: Direction = "higher" if name == "tp" else "lower"
        yield _row("outlier", "all", name, float(outliers[name].astype(float).mean()), "1", direction, len(outliers))
    failures = table[table["quantity"] == "failure"]
    for reason, count in failures["entity"].value_counts(sort=False).items():
        yield _row("failure", "all", "failed", count, "1", "lower", windows) | {"entity": reason}
    seconds = [e.runtime_s for e in group if np.isfinite(e.runtime_s)]
    if seconds:
        yield _row("runtime", "all", "median", float(np.median(seconds)), "s", "lower", len(seconds))
