"""Estimated trajectory parameters over time, 4.1.4: Figures 4.1.8 (oncoming), 4.1.9 (crossing) and 4.1.10 (turning)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.errors import SMOOTHED, UNITS
from reports.figures.style import COLORS, GREY, TRUTH, legend, mark_clipped, new_figure, robust_limits, styled
from reports.siegemund.over_time import draw_mean, draw_runs, over_time
from reports.studies import StudyResult

Array = np.ndarray
PARAMETERS = ("position x", "position z", "velocity x", "velocity z", "driving_direction all", "yaw_rate all")
_NAMES = {
    "speed": "speed of the rear axle",
    "centroid_speed": "speed of the points' centroid",
    "driving_direction": "yaw (driving direction)",
    "yaw_rate": "yaw rate",
}
_ROW_IN = 1.22


def trajectory_table(result: StudyResult, *, parameters: tuple[str, ...] = PARAMETERS) -> pd.DataFrame:
    """Bias, standard deviation, RMS, bound and efficiency of every parameter; angles in degrees."""
    rows = []
    for parameter in parameters:
        quantity, axis = _split(parameter)
        factor, unit = _unit(quantity)
        for estimator in result.estimators:
            row: dict[str, object] = {"parameter": _name(quantity, axis), "unit": unit, "estimator": estimator}
            for statistic in ("bias", "std", "rms", "crb", "efficiency"):
                found = result.select(quantity, axis, statistic)
                value = found.loc[found["estimator"] == estimator, "value"]
                scale = 1.0 if statistic == "efficiency" else factor
                row[statistic] = scale * float(value.iloc[0]) if len(value) else np.nan
            rows.append(row)
    return pd.DataFrame(rows).dropna(axis=1, how="all")


@styled
def trajectory(result: StudyResult, *, parameters: tuple[str, ...] = PARAMETERS) -> Figure:
    """Parameters ("quantity axis") of one run beside the truth, and their errors: of that run, of 95 % of the runs, and
    on average over the runs. Of the study's first estimator."""
    figure = new_figure(0.7 + _ROW_IN * len(parameters))
    axes = figure.subplots(len(parameters), 2, sharex=True, squeeze=False)
    for (left, right), parameter in zip(axes, parameters, strict=True):
        quantity, axis = _split(parameter)
        factor, unit = _unit(quantity)
        first = _first_run(result, quantity, axis, factor)
        _parameter(left, first)
        _error(right, over_time(result, quantity, axis), first, factor)
        left.set_title(_name(quantity, axis))
        right.set_title("error")
        left.set_ylabel(f"[{unit}]")
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    legend(figure, list(axes.flat))
    return figure


def _split(parameter: str) -> tuple[str, str]:
    quantity, _, axis = parameter.partition(" ")
    if quantity not in UNITS or not axis:
        raise ValueError(f"parameters: found {parameter!r}, expected a quantity and an axis, such as 'position x'")
    return quantity, axis


def _unit(quantity: str) -> tuple[float, str]:
    """Factor to the unit of the figure, and that unit."""
    unit = UNITS[quantity]
    return (180 / np.pi, unit.replace("rad", "deg")) if unit.startswith("rad") else (1.0, unit)


def _name(quantity: str, axis: str) -> str:
    along = {"x": ", right", "y": ", down", "z": ", forward"}.get(axis, "")
    return _NAMES.get(quantity, f"{quantity} {axis}") + along


def _first_run(result: StudyResult, quantity: str, axis: str, factor: float) -> pd.DataFrame:
    """t_s, truth, estimate and error of the newest frames of run 0."""
    c = result.comparison
    chosen = (c["quantity"] == quantity) & (c["axis"] == axis) & (c["entity"] != SMOOTHED) & (c["run"] == 0)
    rows = c[chosen & (c["estimator"] == result.estimators[0])].sort_values("t_s")
    truth, error = rows["truth"].to_numpy(float), factor * rows["error"].to_numpy(float)
    truth = factor * (np.unwrap(truth) if quantity == "driving_direction" else truth)
    return pd.DataFrame({"t_s": rows["t_s"].to_numpy(float), "truth": truth, "estimate": truth + error, "error": error})


def _parameter(ax: Axes, first: pd.DataFrame) -> None:
    t, estimate = first["t_s"].to_numpy(float), first["estimate"].to_numpy(float)
    ax.plot(t, first["truth"], color=TRUTH, lw=1.4, label="truth")
    ax.plot(t, estimate, "o", color=COLORS[0], ms=2.4, mew=0, alpha=0.85, label="one run")
    ax.set_ylim(*robust_limits(estimate, first["truth"].to_numpy(float)))
    mark_clipped(ax, t, estimate, COLORS[0])


def _error(ax: Axes, table: pd.DataFrame, first: pd.DataFrame, factor: float) -> None:
    """Errors in the figure's unit, with the bound where there is one."""
    lines = ["mean", "low", "high", "q_low", "q_high", "bound"]
    rows = table[table["estimator"] == table["estimator"].iloc[0]].sort_values("t_s") if len(table) else table
    rows = rows.assign(**{name: factor * rows[name] for name in lines})
    ax.axhline(0, color=TRUTH, lw=0.9)
    draw_runs(ax, rows, 0, "95 % of the runs")
    draw_mean(ax, rows, 1, "mean of the runs, 95 % interval")
    t, error = first["t_s"].to_numpy(float), first["error"].to_numpy(float)
    ax.plot(t, error, "o", color=COLORS[0], ms=2.4, mew=0, alpha=0.85)
    for sign in (-1, 1):
        ax.plot(rows["t_s"], 1.96 * sign * rows["bound"], "--", color=GREY, lw=0.9, label="±1.96 Cramér-Rao bounds")
    bulk = np.quantile(rows[["q_low", "q_high"]].to_numpy(float), [0.05, 0.95]) if len(rows) else np.zeros(1)
    ax.set_ylim(*robust_limits(error, np.append(bulk, 0.0)))
    mark_clipped(ax, t, error, COLORS[0])
