"""Corners all over the scene, followed in time and matched from left to right by Lucas-Kanade, where speed counts."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from estimators.stereo.features.frames import StereoFrame
from sim.camera import StereoRig

Array = np.ndarray
Box = tuple[float, float, float, float]
_CELL_PX, _BLOCK, _PER_BLOCK = 8, 4, 3  # a point to a cell at most; new ones where a block of cells has fewer than this
_WEAKEST, _SHARP = (
    3e-5,
    2e-4,
)  # smaller eigenvalue of the structure tensor: the least, and where grey noise is no matter
_WINDOW, _LEVELS, _RIM_PX = (9, 9), 3, 5
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 12, 0.02)
_ROUND_TRIP_PX, _EPIPOLAR_PX = 0.3, 0.7


@dataclass(frozen=True, eq=False)
class ScenePoints:
    """Points of the scene seen now: name (n,), left and right pixels (n, 2), normalised image coordinates xy (n, 4),
    their variance (n,) in units of a sharp corner's, and places p (n, k, 3) in the left camera's frame [m] now and in
    the frames before, newest first, NaN where there was none yet.
    """

    name: Int[Array, "n"]
    left: Float32[Array, "n 2"]
    right: Float32[Array, "n 2"]
    xy: Float[Array, "n 4"]
    variance: Float[Array, "n"]
    p: Float[Array, "n k 3"]

    @staticmethod
    def none(frames: int) -> ScenePoints:
        """No points, of which so many frames will be known."""
        nowhere = np.empty((0, 2), np.float32)
        return ScenePoints(np.empty(0, int), nowhere, nowhere, np.empty((0, 4)), np.empty(0), np.empty((0, frames, 3)))


def followed(
    points: ScenePoints, rig: StereoRig, before: StereoFrame | None, now: StereoFrame, box: Box | None
) -> ScenePoints:
    """The points found again in the next frame, and new ones where there are few; in a box (x0, y0, x1, y1) as many as
    there are."""
    left, old = points.left, np.arange(0)
    if before is not None:
        left, seen = _tracked(before.left, now.left, points.left, points.left)
        left, old = left[seen], np.flatnonzero(seen)
    fresh, strength = _corners(now, left, box)
    left = np.concatenate([left, fresh])
    shift = np.zeros_like(left)
    shift[: len(old)] = np.nan_to_num(points.right[old] - points.left[old])
    right, matched = _flow(now.left, now.right, left, left + shift)
    right[~matched] = np.nan
    xy = np.concatenate([rig.left.normalise(left.astype(float)), rig.right.normalise(right.astype(float))], axis=1)
    p = np.full((len(left), *points.p.shape[1:]), np.nan)
    p[:, 0] = _triangulated(rig, xy)
    p[: len(old), 1:] = points.p[old, :-1]
    born = points.name.max(initial=-1) + 1
    name = np.concatenate([points.name[old], born + np.arange(len(fresh))])
    variance = np.concatenate([points.variance[old], 1 + _SHARP / strength])
    good = np.isfinite(p[:, 0, 2])
    return ScenePoints(name[good], left[good], right[good], xy[good], variance[good], p[good])


def _tracked(a: Array, b: Array, uv: Array, guess: Array) -> tuple[Float32[Array, "n 2"], Bool[Array, "n"]]:
    """Where points of one image are in another, and whether they lead back."""
    there, good = _flow(a, b, uv, guess)
    home, back = _flow(b, a, there, uv)
    good &= back & (np.abs(home - uv).max(axis=1) < _ROUND_TRIP_PX)
    return there, good & ((there > _RIM_PX) & (there < np.array(b.shape[::-1]) - _RIM_PX)).all(axis=1)


def _flow(a: Array, b: Array, uv: Array, guess: Array) -> tuple[Array, Bool[Array, "n"]]:
    if not len(uv):
        return uv, np.empty(0, bool)
    there, seen, _ = cv2.calcOpticalFlowPyrLK(
        a, b, uv, guess.copy(), None, None, _WINDOW, _LEVELS, _STOP, cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    return there, seen[:, 0] > 0


def _triangulated(rig: StereoRig, xy: Float[Array, "n 4"]) -> Float[Array, "n 3"]:
    """Points on the left rays, at the depth that the right image says; NaN off the epipolar line or behind."""
    ray = np.concatenate([xy[:, :2], np.ones((len(xy), 1))], axis=1)
    turned, t = ray @ rig.T_rl.R.T, rig.T_rl.t
    # The right point (x, y) of z ray: turned_x z + t_x = x (turned_z z + t_z), and so for y.
    e = turned[:, :2] - xy[:, 2:] * turned[:, 2:]
    g = t[:2] - xy[:, 2:] * t[2]
    z = -np.sum(e * g, axis=1) / np.maximum(np.sum(e * e, axis=1), 1e-12)
    off = np.linalg.norm(e * z[:, None] + g, axis=1) / np.maximum(turned[:, 2] * z + t[2], 1e-6)
    good = (z > 0) & (off * rig.left.K[0, 0] < _EPIPOLAR_PX)
    return np.asarray(np.where(good[:, None], ray * z[:, None], np.nan))


def _corners(frame: StereoFrame, known: Float32[Array, "m 2"], box: Box | None) -> tuple[Array, Array]:
    """The strongest corners of blocks that have few points, and all in the box, one to a cell without a point; and how
    strong they are."""
    c, B = _CELL_PX, _BLOCK
    strength = cv2.cornerMinEigenVal(frame.left, 3)
    for edge in (strength, strength.T):
        edge[:_RIM_PX] = edge[-_RIM_PX:] = 0
    h, w = strength.shape[0] // (c * B) * B, strength.shape[1] // (c * B) * B
    cells = strength[: h * c, : w * c].reshape(h, c, w, c).transpose(0, 2, 1, 3).reshape(h, w, c * c)
    best, peak = cells.argmax(axis=2), cells.max(axis=2)
    x, y = np.minimum((known // c).astype(int), [w - 1, h - 1]).T
    peak[(peak < _WEAKEST)] = 0
    peak[y, x] = 0
    count = np.zeros((h // B, w // B), int)
    np.add.at(count, (y // B, x // B), 1)
    blocks = peak.reshape(h // B, B, w // B, B).transpose(0, 2, 1, 3).reshape(h // B, w // B, B * B)
    ranked = np.sort(blocks, axis=2)[:, :, ::-1]
    least = np.take_along_axis(ranked, np.clip(_PER_BLOCK - 1 - count, 0, None)[:, :, None], axis=2)[:, :, 0]
    least[count >= _PER_BLOCK] = np.inf
    chosen = peak >= np.kron(least, np.ones((B, B)))
    if box is not None:
        x0, y0, x1, y1 = (max(int(side) // c, 0) for side in box)
        chosen[y0 : y1 + 1, x0 : x1 + 1] = True
    y, x = np.nonzero(chosen & (peak > 0))
    row, column = np.divmod(best[y, x], c)
    return np.column_stack([x * c + column, y * c + row]).astype(np.float32), peak[y, x].astype(float)
