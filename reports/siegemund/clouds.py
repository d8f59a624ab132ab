"""The measured points of a car seen from the side, true, triangulated and adjusted, 4.1.1: Figure 4.1.2."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimators.estimate import TrajectoryEstimate
from estimators.stereo.triangulation import triangulate, undistorted
from reports.figures.style import COLORS, GREY, TRUTH, new_figure, styled
from reports.studies import StudyResult

Array = np.ndarray
_REACH_M = 6.0  # shown before and behind the middle of the car
_COLUMNS = ("ground truth", "triangulated", "adjusted")


@dataclass(frozen=True, eq=False)
class Clouds:
    """Points (p, 3) of one frame in the camera frame [m]: true, triangulated, adjusted."""

    true: Float[Array, "p 3"]
    triangulated: Float[Array, "p 3"]
    adjusted: Float[Array, "p 3"]


def clouds(result: StudyResult, distances_m: tuple[float, ...]) -> Iterator[Clouds]:
    """Of run 0 and the first estimator, in the frames whose points are nearest to the given distances.

    Raises
        FileNotFoundError: the study keeps no examples; ValueError: the estimator gave nothing.
    """
    run = result.example()
    estimate = run.estimates[result.estimators[0]]
    if not isinstance(estimate, TrajectoryEstimate):
        raise ValueError(f"{result.estimators[0]!r} gave nothing: {estimate.reason}")
    window, tracks = estimate.windows[-1], run.observations.tracks
    rig, uv, cov = undistorted(run.observations.rig, tracks.uv, tracks.cov)
    l, _ = triangulate(rig, uv, cov)
    mean_z = run.truth.points_c(window.frames, window.track)[:, :, 2].mean(axis=1)
    for distance in distances_m:
        k = int(np.argmin(np.abs(mean_z - distance)))
        frame = int(window.frames[k])
        rows = np.flatnonzero(
            (tracks.frame == frame) & np.isin(tracks.track, window.track) & np.isfinite(l).all(axis=1)
        )
        known = np.searchsorted(window.track, tracks.track[rows])
        true = run.truth.points_c(np.array([frame]), tracks.track[rows])[0]
        yield Clouds(true, l[rows], window.T_co[k].apply(window.X_o[known]))


def cloud_table(result: StudyResult, *, distances_m: tuple[float, ...]) -> pd.DataFrame:
    """RMS distance from the true points along and across the line of sight at every distance, of one run."""
    rows = []
    for c in clouds(result, distances_m):
        row: dict[str, float] = {"distance [m]": float(c.true[:, 2].mean()), "points": len(c.true)}
        for name, cloud in (("triangulated", c.triangulated), ("adjusted", c.adjusted)):
            off = cloud - c.true
            row[f"{name}, depth [m]"] = float(np.sqrt(np.mean(off[:, 2] ** 2)))
            row[f"{name}, across [m]"] = float(np.sqrt(np.mean(np.sum(off[:, :2] ** 2, axis=1))))
        rows.append(row)
    return pd.DataFrame(rows)


@styled
def point_clouds(result: StudyResult, *, distances_m: tuple[float, ...]) -> Figure:
    """The points from the side, a row per distance: true, triangulated, adjusted, each over the true ones."""
    found = list(clouds(result, distances_m))
    figure = new_figure(0.6 + 1.35 * len(found))
    axes = figure.subplots(len(found), len(_COLUMNS), squeeze=False, sharex=True, sharey=True)
    for row, c in zip(axes, found, strict=True):
        middle = c.true.mean(axis=0)
        for ax, name, cloud in zip(row, _COLUMNS, (c.true, c.triangulated, c.adjusted), strict=True):
            _cloud(ax, c.true - middle, cloud - middle, name)
        row[0].set_ylabel(f"{middle[2]:.0f} m away\nup [m]")
    for ax, name in zip(axes[0], _COLUMNS, strict=True):
        ax.set_title(name)
    figure.supxlabel("distance from the middle of the points along the line of sight [m]", fontsize=8.5)
    axes[0, 0].set_xlim(-_REACH_M, _REACH_M)
    return figure


def _cloud(ax: Axes, true: Array, cloud: Array, name: str) -> None:
    """One panel, the line of sight to the right; what lies beyond it is counted at its edge."""
    if name == _COLUMNS[0]:
        ax.plot(true[:, 2], -true[:, 1], "*", color=TRUTH, ms=4, mew=0)
        return
    ax.plot(true[:, 2], -true[:, 1], "*", color=GREY, ms=3, mew=0, alpha=0.5)
    symbol, c = ("x", COLORS[1]) if name == _COLUMNS[1] else ("o", COLORS[0])
    ax.plot(cloud[:, 2], -cloud[:, 1], symbol, color=c, ms=3, mfc="none", mew=0.8)
    for side, place, align in ((-1, 0.02, "left"), (1, 0.98, "right")):
        beyond = int(np.count_nonzero(side * cloud[:, 2] > _REACH_M))
        if beyond:
            text = f"◂ {beyond} more" if side < 0 else f"{beyond} more ▸"
            ax.text(place, 0.95, text, transform=ax.transAxes, ha=align, va="top", fontsize=7, color=c)
