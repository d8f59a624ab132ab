"""Single precision against double precision: errors of the covariance and the state, and lost positive definiteness."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.figures.style import GREY, color, legend, marker, new_figure, styled
from reports.studies import StudyResult

SOURCE_RANGE = 1e10
STEPS = 10
_EPSILON = float(np.finfo(np.float32).eps)
_SHOWN = {
    "covariance_error": "largest relative error\nof a variance",
    "state_error": "error of the state\n[standard deviations]",
}


def pooled(result: StudyResult, quantity: str, step: int) -> pd.DataFrame:
    """What was measured after so many steps: columns spread, range, estimator, value, ci_low, ci_high.

    Raises
        ValueError: the study has not looked at this step.
    """
    m = result.metrics
    rows = m[(m["quantity"] == quantity) & (m["bin"] == str(step))].join(result.points, on="point")
    if rows.empty:
        raise ValueError(f"steps: found {step}, allowed: {', '.join(sorted(set(m['bin']), key=int))}")
    return rows[["spread", "range", "estimator", "value", "ci_low", "ci_high"]]


def holds_up_to(result: StudyResult, spread: float) -> pd.Series:
    """Largest range up to which a form stayed positive definite in all runs and steps; 0 where it never did."""
    last = int(result.metrics["bin"].astype(int).max())
    rows = pooled(result, "lost", last)
    rows = rows[rows["spread"] == spread].pivot_table(index="range", columns="estimator", values="value")
    sound = (rows.sort_index() == 0).cumprod().astype(bool)
    return sound.apply(lambda s: float(s.index[s].max()) if s.any() else 0.0)[list(result.estimators)]


def precision_table(result: StudyResult, *, steps: int = STEPS) -> pd.DataFrame:
    """Every form: how far it stays positive definite, and its errors at ranges of 10^4 and the source's 10^10.

    Medians over the runs after ``steps``; lost: share of the runs, up to the last step.
    """
    last = int(result.metrics["bin"].astype(int).max())
    rows = []
    for spread in dict.fromkeys(result.points["spread"]):
        up_to = holds_up_to(result, spread)
        for form in result.estimators:
            row: dict[str, object] = {"spread": spread, "form": form, "positive definite up to range": up_to[form]}
            row["lost at 1e10 [%]"] = 100 * _at(result, "lost", last, spread, SOURCE_RANGE, form)
            for name, quantity in (("P", "covariance_error"), ("x", "state_error")):
                for level in (1e4, SOURCE_RANGE):
                    heading = f"error of {name} at {'1e4' if level == 1e4 else '1e10'}"
                    row[heading] = _at(result, quantity, steps, spread, level, form)
            row["least variance at 1e10"] = _at(result, "least_variance", steps, spread, SOURCE_RANGE, form)
            rows.append(row)
    return pd.DataFrame(rows)


def _at(result: StudyResult, quantity: str, step: int, spread: float, level: float, form: str) -> float:
    rows = _of(pooled(result, quantity, step), spread, form)
    return float(rows.loc[rows["range"] == level, "value"].iloc[0])


def _of(rows: pd.DataFrame, spread: float, form: str) -> pd.DataFrame:
    """Rows of one form in the order of the range."""
    return rows[(rows["spread"] == spread) & (rows["estimator"] == form)].sort_values("range")


@styled
def precision_errors(result: StudyResult, *, steps: int = STEPS) -> Figure:
    """Errors of variances and state over the range, medians; a cross where a run was no longer positive definite."""
    spreads = list(dict.fromkeys(result.points["spread"]))
    figure = new_figure(5.8)
    axes = figure.subplots(2, len(spreads), sharex=True, sharey="row", squeeze=False)
    lost = pooled(result, "lost", steps)
    for row, (quantity, label) in zip(axes, _SHOWN.items(), strict=True):
        errors = pooled(result, quantity, steps)
        for ax, spread in zip(row, spreads, strict=True):
            for i, form in enumerate(result.estimators):
                _draw(ax, _of(errors, spread, form), _of(lost, spread, form), i, form)
            ax.set(xscale="log", yscale="log")
            _mark_ranges(ax)
        row[0].set_ylabel(label)
    for ax, spread in zip(axes[0], spreads, strict=True):
        ax.set_title(_spread_title(spread))
    figure.supxlabel("variance of the start position / variance of a measurement", fontsize=8.5)
    legend(figure, list(axes.flat))
    return figure


def _draw(ax: Axes, errors: pd.DataFrame, lost: pd.DataFrame, i: int, form: str) -> None:
    x, y = errors["range"].to_numpy(float), errors["value"].to_numpy(float)
    ax.plot(x, y, color=color(i), marker=marker(i), ms=3, label=form)
    broken = lost["value"].to_numpy(float) > 0
    if broken.any():
        ax.plot(x[broken], y[broken], "x", color=color(i), ms=7, mew=1.3)


def _mark_ranges(ax: Axes) -> None:
    ax.axvline(1 / _EPSILON, color=GREY, lw=0.9, ls=":", label="1 / precision")
    ax.axvline(SOURCE_RANGE, color=GREY, lw=0.9, ls="--", label="the source's range")


def _spread_title(spread: float) -> str:
    if spread == 1:
        return "position and velocity known alike"
    return f"velocity known $10^{{{np.log10(spread):.0f}}}$ times better"


@styled
def precision_lost(result: StudyResult) -> Figure:
    """Share of the runs that are no longer positive definite after the last step, over the range."""
    spreads = list(dict.fromkeys(result.points["spread"]))
    last = int(result.metrics["bin"].astype(int).max())
    figure = new_figure(2.9)
    axes = figure.subplots(1, len(spreads), sharey=True, squeeze=False)[0]
    lost = pooled(result, "lost", last)
    for ax, spread in zip(axes, spreads, strict=True):
        for i, form in enumerate(result.estimators):
            rows = _of(lost, spread, form)
            ax.plot(rows["range"], 100 * rows["value"], color=color(i), marker=marker(i), ms=3.5, label=form)
        ax.set(xscale="log", title=_spread_title(spread))
        _mark_ranges(ax)
    axes[0].set_ylabel("runs lost [%]")
    figure.supxlabel("variance of the start position / variance of a measurement", fontsize=8.5)
    legend(figure, list(axes))
    return figure
