"""The estimated point cloud over the true vehicle, from the side and from above."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from scipy.spatial import Delaunay

from reports.figures.style import GREY, TRUTH, color, legend, marker, new_figure, robust_limits, styled
from reports.windows import WindowComparison
from sim.truth import Truth

Array = np.ndarray
_ROWS = 3
_REACH = (0.03, 0.05, 0.08, 0.12, 0.2)  # largest circumradius of a triangle, as a share of the extent
_RASTER_M = 0.005
_PANEL_IN = 3.1  # width of one of two panels at column width
_SIDE, _ABOVE = [0, 2], [0, 1]


@styled
def point_cloud(truth: Truth, comparisons: Mapping[str, Sequence[WindowComparison]]) -> Figure:
    """Estimated points in the true vehicle frame, x forward, for a far, a middle and a near window.

    The true pose carries them over, so that a shift is the position error; a line joins each to its true point.
    comparisons: per estimator's label.
    """
    frames = _chosen_frames(comparisons)
    limits = _limits(truth, [c for all_c in comparisons.values() for c in all_c if c.frame in frames])
    (x0, x1), *across = limits
    panel_in = _PANEL_IN * max(high - low for low, high in across) / (x1 - x0)
    figure = new_figure(0.7 + (panel_in + 0.35) * max(1, len(frames)))
    axes = figure.subplots(max(1, len(frames)), 2, squeeze=False, sharex=True, sharey="col")
    body = truth.bodies[truth.target]
    for row, frame in zip(axes, frames, strict=False):
        shown = {label: c for label, all_c in comparisons.items() for c in all_c if c.frame == frame}
        distance = next(iter(shown.values())).truth.position[2]
        for ax, view, name in zip(row, (_SIDE, _ABOVE), ("side", "above"), strict=True):
            _panel(ax, truth, shown, list(comparisons), body.outline_v[:, view], view)
            ax.set_xlim(*limits[0])
            ax.set_ylim(*limits[view[1]])
            ax.set_title(
                f"From {'the side' if name == 'side' else name}, {distance:.0f} m away, t = {truth.t_s[frame]:.2f} s"
            )
            ax.set_ylabel("z, up [m]" if view == _SIDE else "y, left [m]")
    for ax in axes[-1]:
        ax.set_xlabel("x, forward [m]")
    legend(figure, list(axes.flat))
    return figure


def _chosen_frames(comparisons: Mapping[str, Sequence[WindowComparison]]) -> list[int]:
    """Newest frames of the farthest, a middle and the nearest window that most estimators have."""
    distance = {c.frame: c.truth.position[2] for all_c in comparisons.values() for c in all_c}
    common = set(distance)
    for all_c in comparisons.values():
        frames = {c.frame for c in all_c}
        common = common & frames or common
    ordered = sorted(common, key=lambda f: -distance[f])
    if not ordered:
        return []
    return [ordered[i] for i in np.unique(np.linspace(0, len(ordered) - 1, _ROWS).round().astype(int))]


def _limits(truth: Truth, shown: Sequence[WindowComparison]) -> list[tuple[float, float]]:
    """Limits of the vehicle's axes that hold the vehicle and the bulk of the points."""
    box = truth.bodies[truth.target].box_v
    points = [box, *(truth.T_cv[c.frame].inv().apply(c.y_c) for c in shown)]
    return [robust_limits(np.concatenate(points)[:, i], box[:, i]) for i in range(3)]


def _panel(
    ax: Axes,
    truth: Truth,
    shown: Mapping[str, WindowComparison],
    labels: Sequence[str],
    outline: Float[Array, "k 2"],
    view: list[int],
) -> None:
    for i, polygon in enumerate(silhouette(outline)):
        ax.fill(*polygon.T, facecolor="#f0f0f0", edgecolor=GREY, lw=0.9, label="true vehicle" if i == 0 else None)
    for label, c in shown.items():
        rank = labels.index(label)
        T_vc = truth.T_cv[c.frame].inv()
        true, estimated = T_vc.apply(c.p_c)[:, view], T_vc.apply(c.y_c)[:, view]
        ax.plot(true[:, 0], true[:, 1], ".", color=TRUTH, ms=1.6, label="true points", zorder=4)
        joins = np.stack([true, estimated], axis=1)
        ax.add_collection(LineCollection(list(joins), colors=color(rank), linewidths=0.4, alpha=0.5))
        ax.plot(
            estimated[:, 0], estimated[:, 1], marker(rank), color=color(rank), ms=2.8, mew=0, alpha=0.8, label=label
        )
    ax.set_aspect("equal", adjustable="box")


def silhouette(points: Float[Array, "k 2"]) -> list[Float[Array, "p 2"]]:
    """Outer contour of a dense set of surface points [m]: the alpha shape that is just wide enough to hold them all.

    Empty where the points span no area.
    """
    points = np.unique(np.round(points, 4), axis=0)
    if len(points) < 3 or np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-6) < 2:
        return []
    triangles = Delaunay(points).simplices
    radius = _circumradius(points[triangles])
    extent = np.ptp(points, axis=0).max()
    for reach in (*_REACH, np.inf):
        kept = triangles[radius <= reach * extent]
        if len(np.unique(kept)) == len(points):
            contours = _outer_contours(points, kept)
            if len(contours) == 1:
                return contours
    return _outer_contours(points, triangles)


def _circumradius(corners: Float[Array, "t 3 2"]) -> Float[Array, "t"]:
    a, b, c = (np.linalg.norm(corners[:, i] - corners[:, j], axis=1) for i, j in ((0, 1), (1, 2), (2, 0)))
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2
    return np.asarray(a * b * c / (4 * np.maximum(area, 1e-12)))


def _outer_contours(points: Float[Array, "k 2"], triangles: Int[Array, "t 3"]) -> list[Float[Array, "p 2"]]:
    """Contours of the union of triangles, without holes, by a raster of 5 mm."""
    origin = points.min(axis=0) - 2 * _RASTER_M
    raster = np.round((points - origin) / _RASTER_M).astype(np.int32)
    mask = np.zeros(raster.max(axis=0)[::-1] + 3, np.uint8)
    for triangle in raster[triangles]:
        cv2.fillConvexPoly(mask, triangle, 1)
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_TC89_L1)
    return [np.asarray(c[:, 0] * _RASTER_M + origin) for c in contours if len(c) > 2]
