"""The vehicle filter over the noise of its motion and over P*(0): errors, NEES and NIS (Dickmanns 2007, 6.4.4)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import chi2

from reports.bootstrap import interval_of_sums
from reports.consistency import DOF, band
from reports.figures.style import GREY, color, marker, new_figure, styled
from reports.recursive.comparison import BRAKED, lag_sums
from reports.recursive.situations import STEADY_S, curves, nees_of
from reports.studies import StudyResult

Array = np.ndarray
_NOISE = "longitudinal_noise_mps2_sqrt_s"
_LEVEL = 0.95


def _estimator(scenario: Mapping[str, Any], label: str) -> Mapping[str, Any]:
    return next(e for e in scenario["estimator"] if label in (e["label"], e["name"]))


def _series(result: StudyResult, label: str, key: str) -> dict[float, str]:
    """Points in which one argument of an estimator varies and the other one is what it is most often."""
    arguments = {
        p: {k: float(_estimator(s, label)[k]) for k in (_NOISE, "poor_sigmas")} for p, s in result.scenarios.items()
    }
    other = "poor_sigmas" if key == _NOISE else _NOISE
    values = [a[other] for a in arguments.values()]
    usual = max(set(values), key=values.count)
    return dict(sorted((a[key], str(p)) for p, a in arguments.items() if a[other] == usual))


def _rms(result: StudyResult, point: str, label: str, quantity: str) -> tuple[float, float, float]:
    """RMS with its 95 % interval over runs."""
    squares = np.sum(curves(result, point, label, quantity).since(STEADY_S).error ** 2, axis=-1)
    sums = np.stack([np.nansum(squares, axis=1), np.isfinite(squares).sum(axis=1)], axis=1)
    low, high = interval_of_sums(_root_mean, sums)
    return float(_root_mean(sums.sum(axis=0))), low, high


def _root_mean(s: Array) -> Array:
    return np.asarray(np.sqrt(s[..., 0] / s[..., 1]))


def nis_of(result: StudyResult, point: str, label: str) -> tuple[float, float, float]:
    """NIS over its degrees of freedom, all frames and runs, and the 95 % band of an honest filter.

    Innovations of an honest filter are independent from frame to frame, so all of them may be pooled.
    """
    m = result.measures
    rows = m[(m["point"] == point) & (m["estimator"] == label) & (m["t_s"] >= STEADY_S - 1e-9)]
    wide = rows.pivot_table(index=["run", "t_s"], columns="quantity", values="value", observed=True)
    dof = float(wide["nis_dof"].sum())
    low, high = (float(chi2.ppf((1 + side * _LEVEL) / 2, dof)) / dof for side in (-1, 1))
    return float((wide["nis"] * wide["nis_dof"]).sum() / dof), low, high


def _nees(result: StudyResult, point: str, label: str, quantity: str) -> float:
    """NEES of the last frame over its degrees of freedom, mean over the runs."""
    return float(np.nanmean(nees_of(result, point, label, quantity).error[:, -1, 0]))


def noise_table(result: StudyResult, *, estimator: str = "own start") -> pd.DataFrame:
    """Noise of the motion over the default: RMS with intervals, lag of the speed, NEES of the last frame and NIS."""
    series = _series(result, estimator, _NOISE)
    usual = _usual(result, estimator)
    rows = []
    for noise, point in series.items():
        speed, position = (_rms(result, point, estimator, q) for q in ("speed", "position"))
        lag = lag_sums(curves(result, point, estimator, "speed"), BRAKED).sum(axis=0)
        nis = nis_of(result, point, estimator)
        rows.append(
            {
                "√Q / default": noise / usual,
                "position, RMS [m]": position[0],
                "speed, RMS [m/s]": speed[0],
                "from": speed[1],
                "to": speed[2],
                "lag [s]": float(lag[0] / lag[1]),
                "NEES of pose": _nees(result, point, estimator, "pose"),
                "NEES of velocity": _nees(result, point, estimator, "velocity"),
                "NEES band": "{:.2f} … {:.2f}".format(*band(DOF, result.runs, _LEVEL)),
                "NIS": nis[0],
                "NIS band": f"{nis[1]:.3f} … {nis[2]:.3f}",
            }
        )
    return pd.DataFrame(rows)


def _usual(result: StudyResult, label: str) -> float:
    values = [float(_estimator(s, label)[_NOISE]) for s in result.scenarios.values()]
    return max(set(values), key=values.count)


def poor_start_table(result: StudyResult, *, estimator: str = "poor start") -> pd.DataFrame:
    """How sure the filter is of a poor start, P*(0) over the square of the true error, and the RMS it comes to."""
    rows = []
    for sigmas, point in _series(result, estimator, "poor_sigmas").items():
        row: dict[str, float] = {"P*(0) / error²": sigmas**-2}
        for quantity, unit in (("position", "m"), ("speed", "m/s")):
            error = curves(result, point, estimator, quantity)
            for name, part in (
                ("after 0.2 s", _at(error.t_s, 0.2)),
                ("after 0.6 s", _at(error.t_s, 0.6)),
                ("at the end", -1),
            ):
                row[f"{quantity} {name} [{unit}]"] = float(
                    np.sqrt(np.nanmean(np.sum(error.error[:, part] ** 2, axis=-1)))
                )
        row["NEES of pose at the end"] = _nees(result, point, estimator, "pose")
        rows.append(row)
    return pd.DataFrame(rows).sort_values("P*(0) / error²", ignore_index=True)


def _at(t_s: Float[Array, "t"], wanted: float) -> int:
    return int(np.abs(t_s - wanted).argmin())


@styled
def vehicle_figure(result: StudyResult) -> Figure:
    """RMS, NEES and NIS over the noise; position over time after starts the filter is more and less sure of."""
    figure = new_figure(5.4)
    axes = figure.subplots(2, 2)
    table = noise_table(result)
    _draw_noise(axes[0, 0], table, ("speed, RMS [m/s]", "position, RMS [m]"))
    axes[0, 0].fill_between(table["√Q / default"], table["from"], table["to"], color=color(0), alpha=0.25, lw=0)
    axes[0, 0].set_title("Noise of the motion: errors")
    _draw_noise(axes[0, 1], table, ("NEES of pose", "NEES of velocity", "NIS"))
    axes[0, 1].axhspan(*band(DOF, result.runs, _LEVEL), color=GREY, alpha=0.3, lw=0, label="95 % band of NEES")
    axes[0, 1].set_title("Noise of the motion: consistency")
    for ax, quantity, unit in zip(axes[1], ("position", "speed"), ("m", "m/s"), strict=True):
        for i, (sigmas, point) in enumerate(_series(result, "poor start", "poor_sigmas").items()):
            c = curves(result, point, "poor start", quantity)
            label = f"{sigmas**-2:.2g}"
            ax.plot(c.t_s, np.sqrt(np.nanmean(np.sum(c.error**2, axis=-1), axis=0)), color=color(i), label=label)
        ax.set(yscale="log", xlabel="time [s]", ylabel=f"{quantity}, RMS [{unit}]", title="Poor start: P*(0) / error²")
    for ax in axes.flat:
        ax.legend(frameon=False, fontsize=7, handlelength=1.4, labelspacing=0.2)
    return figure


def _draw_noise(ax: Axes, table: pd.DataFrame, columns: tuple[str, ...]) -> None:
    for i, column in enumerate(columns):
        ax.plot(table["√Q / default"], table[column], color=color(i), marker=marker(i), ms=3.5, label=column)
    ax.set(xscale="log", yscale="log", xlabel="√Q / default")
