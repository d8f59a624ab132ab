"""The filter of one state, (6.21)-(6.26): what Q over R and P*(0) do to gain, convergence and consistency.

Three series share one study: those told the truth at several Q, those that are told a wrong P*(0), and those that are
told a wrong Q.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.consistency import band
from reports.figures.style import GREY, color, marker, new_figure, styled
from reports.studies import StudyResult

_SETTINGS = ("a", "noise", "stated_noise", "start", "stated_start")
_SETTLED = 1.1  # RMS over the best one from which on a filter has converged
_LEVEL = 0.95
_STEPS_SHOWN = (5, 20, 100)


def steady_state(noise: float, a: float = 1.0) -> tuple[float, float]:
    """P*, the root of P* = a² P* / (P* + 1) + q that is positive, and the gain P* / (P* + 1); R is 1."""
    half = (noise - 1 + a * a) / 2
    predicted = half + float(np.sqrt(half * half + noise))
    return predicted, predicted / (predicted + 1)


def over_steps(result: StudyResult) -> pd.DataFrame:
    """Metrics with all settings of their point: columns of `_SETTINGS`, quantity, step, value, ci_low, ci_high, n."""
    settings = pd.DataFrame({p: {k: s[k] for k in _SETTINGS} for p, s in result.scenarios.items()}).T.astype(float)
    rows = result.metrics.join(settings, on="point")
    rows["step"] = rows["bin"].astype(int)
    return rows[[*_SETTINGS, "quantity", "step", "value", "ci_low", "ci_high", "n"]]


def _series(result: StudyResult, varied: str) -> pd.DataFrame:
    """The rows of the series in which one setting varies, all others what they are most often."""
    rows = over_steps(result)
    for other in {"noise", "stated_noise", "start", "stated_start"} - {varied}:
        rows = rows[rows[other] == _common(result, other)]
    return rows.sort_values([varied, "step"])


def _common(result: StudyResult, name: str) -> float:
    values = [float(s[name]) for s in result.scenarios.values()]
    return max(set(values), key=values.count)


def _wide(rows: pd.DataFrame, key: str, column: str = "value") -> pd.DataFrame:
    return pd.DataFrame(rows.pivot_table(index=key, columns="quantity", values=column))


def _last(rows: pd.DataFrame) -> pd.DataFrame:
    return pd.DataFrame(rows[rows["step"] == rows["step"].max()])


def gain_table(result: StudyResult) -> pd.DataFrame:
    """Q over R: gain and variance after the last step beside the steady state of Riccati's equation, and the errors.

    Variances over R; the band of NEES and NIS holds 95 % of honest filters.
    """
    rows = _last(_series(result, "noise"))
    value, low, high = (_wide(rows, "noise", c) for c in ("value", "ci_low", "ci_high"))
    n = int(rows["n"].iloc[0])
    steady = np.array([steady_state(q) for q in value.index])
    return pd.DataFrame(
        {
            "Q / R": value.index,
            "gain": value["gain"].to_numpy(),
            "gain, Riccati": steady[:, 1],
            "p": value["stated_variance"].to_numpy(),
            "p, Riccati": steady[:, 1],
            "RMS²": value["error"].to_numpy() ** 2,
            "RMS² from": low["error"].to_numpy() ** 2,
            "RMS² to": high["error"].to_numpy() ** 2,
            "NEES": value["nees"].to_numpy(),
            "NIS": value["nis"].to_numpy(),
            "band": "{:.2f} … {:.2f}".format(*band(1, n, _LEVEL)),
        }
    )


def start_table(result: StudyResult) -> pd.DataFrame:
    """P*(0) over the true variance of the start value: first gain, RMS and NEES after some steps."""
    rows = _series(result, "stated_start")
    rms = rows[rows["quantity"] == "error"].pivot_table(index="stated_start", columns="step", values="value")
    nees = rows[rows["quantity"] == "nees"].pivot_table(index="stated_start", columns="step", values="value")
    gain = rows[rows["quantity"] == "gain"].pivot_table(index="stated_start", columns="step", values="value")
    settled = rms <= _SETTLED * rms.loc[1.0]
    first = [next((int(k) for k in rms.columns if settled.loc[s, k:].all()), np.nan) for s in rms.index]
    table = pd.DataFrame({"P*(0) / true": rms.index, "first gain": gain.iloc[:, 0].to_numpy()})
    for step in (rms.columns[0], *_STEPS_SHOWN):
        table[f"RMS, step {step}"] = rms[step].to_numpy()
    table["within 10 % from step"] = first
    for step in (rms.columns[0], *_STEPS_SHOWN):
        table[f"NEES, step {step}"] = nees[step].to_numpy()
    return table


def tuning_table(result: StudyResult) -> pd.DataFrame:
    """What the filter takes for Q over the truth: gain, errors, NEES and NIS after the last step."""
    rows = _last(_series(result, "stated_noise"))
    value, low, high = (_wide(rows, "stated_noise", c) for c in ("value", "ci_low", "ci_high"))
    n = int(rows["n"].iloc[0])
    return pd.DataFrame(
        {
            "stated Q / true Q": value.index,
            "gain": value["gain"].to_numpy(),
            "RMS": value["error"].to_numpy(),
            "RMS from": low["error"].to_numpy(),
            "RMS to": high["error"].to_numpy(),
            "NEES": value["nees"].to_numpy(),
            "NIS": value["nis"].to_numpy(),
            "band": "{:.2f} … {:.2f}".format(*band(1, n, _LEVEL)),
        }
    )


@styled
def scalar_figure(result: StudyResult) -> Figure:
    """Gain over Q / R; RMS over the steps for several P*(0); RMS, NEES and NIS over the stated Q."""
    figure = new_figure(5.4)
    axes = figure.subplots(2, 2)
    _draw_gain(axes[0, 0], result)
    _draw_start(axes[0, 1], result, "error", "RMS error / √R")
    _draw_tuning(axes[1, 0], result)
    _draw_start(axes[1, 1], result, "nees", "NEES")
    for ax in axes.flat:
        ax.legend(frameon=False, fontsize=7, handlelength=1.4, labelspacing=0.2)
    return figure


def _draw_gain(ax: Axes, result: StudyResult) -> None:
    rows = _last(_series(result, "noise"))
    gain = rows[rows["quantity"] == "gain"]
    x = np.geomspace(gain["noise"].min(), gain["noise"].max(), 200)
    ax.plot(x, [steady_state(q)[1] for q in x], color="black", lw=1, label="Riccati")
    ax.plot(gain["noise"], gain["value"], "o", color=color(0), ms=4, label="filter")
    for k in (0.1, 0.95):
        ax.axhline(k, color=GREY, lw=0.8, ls=":")
        ax.annotate(f"K = {k}", (x[0], k), textcoords="offset points", xytext=(2, 2), fontsize=7, color=GREY)
    ax.set(xscale="log", xlabel="Q / R", ylabel="gain in the steady state", title="Q over R")


def _power(value: float) -> str:
    return f"$10^{{{np.log10(value):.0f}}}$"


def _draw_start(ax: Axes, result: StudyResult, quantity: str, label: str) -> None:
    rows = _series(result, "stated_start")
    rows = rows[rows["quantity"] == quantity]
    for i, (stated, part) in enumerate(rows.groupby("stated_start")):
        ax.plot(
            part["step"],
            part["value"],
            color=color(i),
            marker=marker(i),
            ms=3,
            label=f"true · {_power(float(str(stated)))}",
        )
    if quantity == "nees":
        ax.axhspan(*band(1, int(rows["n"].iloc[0]), _LEVEL), color=GREY, alpha=0.3, lw=0, label="95 % band")
    ax.set(
        xscale="log",
        yscale="log",
        xlabel="step",
        ylabel=label,
        title="P*(0)" if quantity == "error" else "P*(0), consistency",
    )


def _draw_tuning(ax: Axes, result: StudyResult) -> None:
    rows = _last(_series(result, "stated_noise"))
    for i, (quantity, label) in enumerate((("error", "RMS"), ("nees", "NEES"), ("nis", "NIS")), 5):
        part = rows[rows["quantity"] == quantity]
        ax.fill_between(part["stated_noise"], part["ci_low"], part["ci_high"], color=color(i), alpha=0.25, lw=0)
        ax.plot(part["stated_noise"], part["value"], color=color(i), marker=marker(i), ms=3.5, label=label)
    ax.axhspan(*band(1, int(rows["n"].iloc[0]), _LEVEL), color=GREY, alpha=0.3, lw=0, label="95 % band")
    ax.set(xscale="log", yscale="log", xlabel="stated Q / true Q", title="A wrong Q")
