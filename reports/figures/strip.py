"""A strip of frames with true and estimated box, tracks and outliers drawn in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int, UInt8
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.figures.style import GREY, INLIER, OUTLIERS, TRUTH, color, legend, new_figure, styled
from reports.windows import WindowComparison
from sim.camera import Camera
from sim.observations import Tracks
from sim.pose import Pose
from sim.truth import INLIER as INLIER_KIND
from sim.truth import Truth

Array = np.ndarray
STRIP_FRAMES = 5
_EDGES = [(0, 1), (0, 2), (0, 4), (3, 1), (3, 2), (3, 7), (5, 1), (5, 4), (5, 7), (6, 2), (6, 4), (6, 7)]
_MARGIN = 0.45  # of the box, around it
_MIN_CROP_PX = 60.0
_CROP_ASPECT = 4 / 3
_NEAR_M = 0.1


def strip_frames(comparisons: Mapping[str, Sequence[WindowComparison]], truth: Truth) -> Int[Array, "f"]:
    """Frames to show: evenly spread over those that have an estimate, else over those with visible points, else all."""
    estimated = sorted({c.frame for all_c in comparisons.values() for c in all_c})
    visible = np.flatnonzero(truth.visible_points > 0)
    frames = np.array(estimated) if estimated else visible if len(visible) else np.arange(len(truth.t_s))
    return np.asarray(frames[np.unique(np.linspace(0, len(frames) - 1, STRIP_FRAMES).round().astype(int))])


@styled
def frame_strip(
    truth: Truth,
    tracks: Tracks,
    comparisons: Mapping[str, Sequence[WindowComparison]],
    frames: Int[Array, "f"],
    images: Mapping[int, UInt8[Array, "h w 3"]],
) -> Figure:
    """Left images of some frames: whole above, the target enlarged below. Where there is no image, an empty canvas.

    The estimated box is the true one carried over by the alignment of the estimated on the true points.
    """
    w, h = truth.rig.left.size_px
    n = len(frames)
    column_in = 7.2 / max(n, 1)
    figure = new_figure(column_in * (h / w + 1 / _CROP_ASPECT) + 0.75)
    axes = figure.subplots(2, n, squeeze=False, height_ratios=[h / w, 1 / _CROP_ASPECT])
    for (whole, crop), frame in zip(axes.T, frames.tolist(), strict=True):
        for ax, smoothing in ((whole, "antialiased"), (crop, "nearest")):
            if frame in images:
                ax.imshow(images[frame], interpolation=smoothing)
        u0, v0, u1, v1 = part = _crop(truth, frame)
        whole.plot([u0, u1, u1, u0, u0], [v0, v0, v1, v1, v0], "-", color=color(1), lw=0.8)
        _other_boxes(whole, truth, frame)
        _boxes(crop, truth, comparisons, frame)
        _points(crop, truth, tracks, frame)
        _view(whole, (0, 0, w, h))
        _view(crop, part)
        whole.set_anchor("S")
        crop.set_anchor("N")
        distance = truth.T_cv.apply(truth.reference_v)[frame, 2]
        whole.set_title(f"{truth.t_s[frame]:.2f} s, {distance:.0f} m", fontsize=8)
    legend(figure, list(axes.flat))
    return figure


def _view(ax: Axes, box: tuple[float, float, float, float]) -> None:
    u0, v0, u1, v1 = box
    ax.set_xlim(u0 - 0.5, u1 - 0.5)
    ax.set_ylim(v1 - 0.5, v0 - 0.5)
    ax.set_aspect("equal", adjustable="box")
    ax.set_xticks([])
    ax.set_yticks([])
    ax.grid(visible=False)
    for spine in ax.spines.values():
        spine.set_visible(True)
        spine.set_color(GREY)


def _corners(box_v: Float[Array, "2 3"]) -> Float[Array, "8 3"]:
    return np.array([[box_v[i, 0], box_v[j, 1], box_v[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


def project_box(camera: Camera, T_cv: Pose, box_v: Float[Array, "2 3"]) -> Float[Array, "12 2 2"]:
    """Pixels of the ends of the twelve edges; NaN for edges that reach behind the camera."""
    p = T_cv.apply(_corners(box_v))
    uv = camera.project(np.where(p[:, 2:] > _NEAR_M, p, np.nan))
    return np.asarray(uv[np.array(_EDGES)])


def _draw_box(ax: Axes, edges: Float[Array, "12 2 2"], c: str, width: float, label: str | None) -> None:
    for k, edge in enumerate(edges):
        ax.plot(edge[:, 0], edge[:, 1], "-", color=c, lw=width, label=label if k == 0 else None)


def _other_boxes(ax: Axes, truth: Truth, frame: int) -> None:
    T_cw = truth.T_wc[frame].inv()
    for i, body in enumerate(truth.bodies):
        if i != truth.target:
            _draw_box(ax, project_box(truth.rig.left, T_cw @ body.T_wv[frame], body.box_v), GREY, 0.4, None)


def _boxes(ax: Axes, truth: Truth, comparisons: Mapping[str, Sequence[WindowComparison]], frame: int) -> None:
    _other_boxes(ax, truth, frame)
    camera, box_v = truth.rig.left, truth.bodies[truth.target].box_v
    true = project_box(camera, truth.T_cv[frame], box_v)
    _draw_box(ax, true, "white", 2.4, None)
    _draw_box(ax, true, TRUTH, 1.3, "true box")
    for rank, (label, all_c) in enumerate(comparisons.items()):
        for c in all_c:
            if c.frame == frame:
                edges = project_box(camera, c.T_err @ truth.T_cv[frame], box_v)
                _draw_box(ax, edges, color(rank), 0.9, f"box, {label}")


def _points(ax: Axes, truth: Truth, tracks: Tracks, frame: int) -> None:
    here = tracks.frame == frame
    kind, uv = truth.labels.kind[here], tracks.uv_left[here]
    good = kind == INLIER_KIND
    ax.plot(uv[good, 0], uv[good, 1], "o", color=INLIER, ms=1.8, mew=0, label="track")
    for k, name in enumerate(truth.labels.kinds, start=1):
        bad = kind == k
        if not bad.any():
            continue
        c = OUTLIERS[(k - 1) % len(OUTLIERS)]
        ax.plot(uv[bad, 0], uv[bad, 1], "x", color=c, ms=4, mew=1.1, label=f"outlier: {name}")
        for start, end in zip(truth.labels.uv_true[here][bad, :2], uv[bad], strict=True):
            ax.plot([start[0], end[0]], [start[1], end[1]], "-", color=c, lw=0.6)


def _crop(truth: Truth, frame: int) -> tuple[float, float, float, float]:
    """Window around the true box, of fixed aspect, inside the image where it fits."""
    w, h = truth.rig.left.size_px
    edges = project_box(truth.rig.left, truth.T_cv[frame], truth.bodies[truth.target].box_v).reshape(-1, 2)
    edges = edges[np.isfinite(edges).all(axis=1)]
    if not len(edges):
        return (0, 0, w, h)
    low, high = edges.min(axis=0), edges.max(axis=0)
    centre = np.clip((low + high) / 2, 0, [w, h])
    size = np.maximum((high - low) * (1 + _MARGIN), _MIN_CROP_PX)
    half_u = min(max(size[0], size[1] * _CROP_ASPECT) / 2, max(w, h * _CROP_ASPECT) / 2)
    half = np.array([half_u, half_u / _CROP_ASPECT])
    centre = np.clip(centre, np.minimum(half, [w / 2, h / 2]), np.maximum([w, h] - half, [w / 2, h / 2]))
    return (*(centre - half), *(centre + half))
