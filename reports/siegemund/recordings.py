"""The source's real recordings, 4.2, on rendered twins: the reconstructed cloud and what the adjustment leaves over.

Figures 4.2.14 and 4.2.16; 4.2.13, 4.2.15, 4.2.17, 4.2.18 and 4.2.19 are trajectories (`reports.siegemund.motion`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from estimators.estimate import TrajectoryEstimate, WindowEstimate
from reports.figures.style import COLORS, GREY, color, legend, marker, new_figure, styled
from reports.run import Run
from reports.studies import StudyResult
from reports.windows import inlier_tracks

Array = np.ndarray
_REACH_M = 5.0  # shown before, behind and beside the middle of the car
_PANEL_IN = 2.6
_ON_M = 0.5  # a point so near to the surface, of which only vertices are known, counts as on it


@dataclass(frozen=True, eq=False)
class Cloud:
    """A window's points (n, 3) in the camera frame at its newest frame [m], which of them are inliers by the truth, the
    car's true outline (k, 3), and its distance [m]."""

    points: Float[Array, "n 3"]
    inlier: Bool[Array, "n"]
    outline: Float[Array, "k 3"]
    distance_m: float


def clouds_above(result: StudyResult, distances_m: tuple[float, ...]) -> Iterator[Cloud]:
    """Of run 0 and the first estimator, in the windows whose newest frame is nearest to the given distances.

    Raises
        FileNotFoundError: the study keeps no examples; ValueError: the estimator gave nothing.
    """
    run = result.example()
    truth, estimate = run.truth, _estimate(run, result.estimators[0])
    body = truth.bodies[truth.target]
    depth = truth.T_cv.apply(body.box_v.mean(axis=0))[:, 2]
    for distance in distances_m:
        window = min(estimate.windows, key=lambda w: abs(depth[w.frames[-1]] - distance))
        frame = int(window.frames[-1])
        yield Cloud(
            window.T_co[-1].apply(window.X_o),
            inlier_tracks(truth, run.observations.tracks, window),
            truth.T_cv[frame].apply(body.outline_v),
            float(depth[frame]),
        )


def _estimate(run: Run, label: str) -> TrajectoryEstimate:
    estimate = run.estimates[label]
    if not isinstance(estimate, TrajectoryEstimate) or not estimate.windows:
        raise ValueError(
            f"{label!r} gave nothing{'' if isinstance(estimate, TrajectoryEstimate) else f': {estimate.reason}'}"
        )
    return estimate


def cloud_above_table(result: StudyResult, *, distances_m: tuple[float, ...]) -> pd.DataFrame:
    """At every distance: points, how many of them are outliers by the truth, the share of points on the car's surface,
    and the median and largest distance from it."""
    rows = []
    for c in clouds_above(result, distances_m):
        off = np.asarray(cKDTree(c.outline).query(c.points)[0], float)
        row = {"distance [m]": c.distance_m, "points": len(off), "outliers": int(np.count_nonzero(~c.inlier))}
        row |= {"on the car [%]": 100 * float(np.mean(off < _ON_M)), "median distance [m]": float(np.median(off))}
        rows.append(row | {"largest distance [m]": float(off.max())})
    return pd.DataFrame(rows)


@styled
def cloud_above(result: StudyResult, *, distances_m: tuple[float, ...]) -> Figure:
    """The reconstructed points from above over the true car, a panel per distance."""
    found = list(clouds_above(result, distances_m))
    figure = new_figure(0.7 + _PANEL_IN)
    axes = figure.subplots(1, len(found), squeeze=False, sharex=True, sharey=True)[0]
    for ax, c in zip(axes, found, strict=True):
        middle = c.outline.mean(axis=0)
        ax.plot(
            *(c.outline - middle)[:, [0, 2]].T, ".", color=GREY, ms=0.8, alpha=0.35, label="true car", rasterized=True
        )
        for good, shade, name in ((True, COLORS[0], "points"), (False, COLORS[1], "points that are outliers")):
            ax.plot(
                *(c.points[c.inlier == good] - middle)[:, [0, 2]].T,
                "o",
                ms=3,
                mfc="none",
                mew=0.8,
                color=shade,
                label=name,
            )
        beyond = int(np.count_nonzero((np.abs(c.points - middle)[:, [0, 2]] > _REACH_M).any(axis=1)))
        ax.text(0.98, 0.97, f"{beyond} more beyond" if beyond else "", transform=ax.transAxes, ha="right", va="top")
        ax.set_title(f"{c.distance_m:.0f} m away")
        ax.set_xlabel("to the right [m]")
        ax.set_xlim(-_REACH_M, _REACH_M)
        ax.set_ylim(-_REACH_M, _REACH_M)
        ax.set_aspect("equal")
    axes[0].set_ylabel("along the line of sight [m]")
    legend(figure, list(axes))
    return figure


def system_error_table(result: StudyResult) -> pd.DataFrame:
    """Per estimator, over the windows of run 0: median of the system error v'Wv, of its ratio to the redundancy, of the
    iterations, and of the tracks left out."""
    run, rows = result.example(), []
    for label in result.estimators:
        windows: tuple[WindowEstimate, ...] = _estimate(run, label).windows
        values = np.array([(w.cost, w.cost / w.redundancy, w.iterations, len(w.rejected)) for w in windows], float)
        rows.append((label, len(windows), *np.median(values, axis=0)))
    columns = ["estimator", "windows", "system error", "per degree of freedom", "iterations", "tracks left out"]
    return pd.DataFrame(rows, columns=columns)


@styled
def system_error(result: StudyResult, *, left: tuple[str, ...], right: tuple[str, ...]) -> Figure:
    """The system error v'Wv that remains, over the number of the window, of run 0; two panels of estimators."""
    run = result.example()
    figure = new_figure(2.9)
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    names = list(dict.fromkeys((*left, *right)))
    for ax, labels in zip(axes, (left, right), strict=True):
        for label in labels:
            _costs(ax, _estimate(run, label), names.index(label), label)
        ax.set_xlabel("window")
        ax.set_yscale("log")
    axes[0].set_ylabel("system error v'Wv")
    legend(figure, list(axes))
    return figure


def _costs(ax: Axes, estimate: TrajectoryEstimate, i: int, label: str) -> None:
    newest = [int(w.frames[-1]) for w in estimate.windows]
    ax.plot(newest, [w.cost for w in estimate.windows], color=color(i), marker=marker(i), ms=3, mew=0, label=label)
