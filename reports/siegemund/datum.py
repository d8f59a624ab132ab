"""The datum problem, 3.7.1.3, Figure 3.7.10: an object frame that follows the cloud moves when the cloud changes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimators.estimate import TrajectoryEstimate
from reports.figures.style import COLORS, GREY, TRUTH, legend, marker, new_figure, styled
from reports.run import Run
from reports.studies import StudyResult

Array = np.ndarray
_AXES = ("x", "y", "z")


def origin_path(run: Run, label: str, changed: int) -> pd.DataFrame:
    """The object frame's origin at the newest frame of every window, in camera axes: columns t_s and, for each of x, y,
    z, the estimated translation, and its true value: where the material point is that the origin lay on before the
    tracks changed at frame ``changed``; settled: windows that begin after it."""
    estimate = run.estimates[label]
    if not isinstance(estimate, TrajectoryEstimate):
        raise ValueError(f"{label!r} gave nothing: {estimate.reason}")
    frame = np.array([w.frames[-1] for w in estimate.windows])
    T = np.array([w.T_co.t[-1] for w in estimate.windows])
    T_cv = run.truth.T_cv[frame]
    origin_v = np.einsum("kba,kb->ka", T_cv.R, T - T_cv.t)
    # Growing windows, the first ones, fix the origin least well.
    before = (frame < changed) & (
        np.array([len(w.frames) for w in estimate.windows]) == len(estimate.windows[-1].frames)
    )
    true = T_cv.apply(np.broadcast_to(origin_v[before].mean(axis=0), T.shape))
    columns = {f"{kind}_{a}": v[:, i] for kind, v in (("estimate", T), ("truth", true)) for i, a in enumerate(_AXES)}
    settled = np.array([w.frames[0] >= changed for w in estimate.windows])
    return pd.DataFrame({"t_s": run.truth.t_s[frame], "settled": settled} | columns)


def _change(run: Run) -> int:
    """The frame at which tracks are born and die."""
    events: list[dict[str, Any]] = list(run.scenario["measure"]["events"])
    if not events:
        raise ValueError("measure.events: the scenario has none")
    return min(int(e["frame"]) for e in events)


def _paths(result: StudyResult) -> Iterator[tuple[str, pd.DataFrame, float]]:
    """Label, path and time of the change of every estimator, of run 0."""
    run = result.example()
    changed = _change(run)
    for label in result.estimators:
        yield label, origin_path(run, label, changed), float(run.truth.t_s[changed])


def datum_table(result: StudyResult) -> pd.DataFrame:
    """How far the origin has moved on the object from before the change to the end, in one run; beside it what no datum
    enters: the depth error of the points themselves, before and after, of all runs."""
    rows = []
    c = result.comparison
    z = c[(c["quantity"] == "position") & (c["axis"] == "z") & (c["entity"] != "smoothed")]
    for label, path, changed_s in _paths(result):
        moved = _moved(path)
        mine = z[z["estimator"] == label]
        parts = {"before": mine[mine["t_s"] < changed_s], "after": mine[mine["t_s"] >= changed_s]}
        errors = {
            f"RMS of the points' depth, {k} [m]": float(np.sqrt((p["error"] ** 2).mean())) for k, p in parts.items()
        }
        jump = float(np.linalg.norm(moved[path["settled"].to_numpy(bool)].mean(axis=0)))
        rows.append({"start values": label, "origin moved by [m]": jump} | errors)
    return pd.DataFrame(rows)


def _moved(path: pd.DataFrame) -> Float[Array, "k 3"]:
    return np.stack([(path[f"estimate_{a}"] - path[f"truth_{a}"]).to_numpy(float) for a in _AXES], axis=1)


@styled
def datum_problem(result: StudyResult) -> Figure:
    """The estimated translation along the camera's axis, and how far the origin strays from its place on the object.

    One column per estimator, of run 0.

    Raises
        FileNotFoundError: the study keeps no examples.
    """
    paths = list(_paths(result))
    figure = new_figure(4.2)
    axes = figure.subplots(2, len(paths), sharex=True, sharey="row", squeeze=False, height_ratios=[1.1, 1])
    for (upper, lower), (label, path, changed_s) in zip(axes.T, paths, strict=True):
        upper.plot(path["t_s"], path["truth_z"], color=TRUTH, lw=1.4, label="true place of the same point")
        upper.plot(path["t_s"], path["estimate_z"], "o", color=COLORS[0], ms=2.8, mew=0, label="estimate")
        upper.set_title(label)
        _strays(lower, path)
        for ax in (upper, lower):
            ax.axvline(changed_s, color=GREY, lw=0.9, ls=":", label="a fifth of the tracks changes")
        lower.set_xlabel("time [s]")
    axes[0, 0].set_ylabel("translation $T_z$ [m]")
    axes[1, 0].set_ylabel("estimate minus true place [m]")
    legend(figure, list(axes.flat))
    return figure


def _strays(ax: Axes, path: pd.DataFrame) -> None:
    for i, (a, moved) in enumerate(zip(_AXES, _moved(path).T, strict=True)):
        c = COLORS[(2, 3, 0)[i]]
        ax.plot(path["t_s"], moved, marker(i + 1) + "-", color=c, ms=2.6, mew=0, lw=0.8, label=f"{a} of the origin")
    ax.axhline(0, color=TRUTH, lw=0.9)
