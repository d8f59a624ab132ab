"""Where the target is, from motion and depth alone: what moves otherwise than most of the scene, and is nearest."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from estimators.stereo.features.frames import StereoFrame
from estimators.stereo.object_motion import align
from estimators.stereo.triangulation import triangulate
from sim.camera import StereoRig

Array = np.ndarray
_POINTS, _WINDOW, _LEVELS = 1200, (11, 11), 3
_ROUND_TRIP_PX, _EPIPOLAR_PX = 0.5, 1.0
_TRIALS, _MISFIT_PX = 100, 1.0
_NEIGHBOUR_M = 0.12  # points belong together within this share of their distance
_LEAST, _REACH_M = 8, 80.0
_GROWN = 0.12  # of the hull, on all sides


@dataclass
class MotionSegmentation:
    """Called frame by frame; keeps the frame before. The mask is empty where nothing moves by itself."""

    rig: StereoRig
    _before: StereoFrame | None = field(default=None, init=False)
    _moving: int = field(default=0, init=False)

    def __call__(self, frame: StereoFrame) -> Bool[Array, "h w"]:
        before, self._before = self._before, frame
        mask = np.zeros(frame.left.shape, bool)
        if before is None:
            return mask
        uv0, uv1 = _four_images(before, frame)
        if len(uv0) < _LEAST:
            return mask
        unit = np.broadcast_to(np.eye(4), (len(uv0), 4, 4))
        (p0, _), (p1, _) = triangulate(self.rig, uv0, unit), triangulate(self.rig, uv1, unit)
        near = np.isfinite(p0).all(axis=1) & np.isfinite(p1).all(axis=1) & (p1[:, 2] < _REACH_M)
        uv1, p0, p1 = uv1[near], p0[near], p1[near]
        moves = _moves_otherwise(self.rig, p0, p1, uv1)
        group = _nearest_group(p1, moves)
        if len(group):
            _fill(mask, uv1[group, :2])
        return mask


def _four_images(before: StereoFrame, frame: StereoFrame) -> tuple[Float[Array, "n 4"], Float[Array, "n 4"]]:
    """Corners seen in all four images of two frames: left and right places before and now."""
    corners = cv2.goodFeaturesToTrack(before.left, _POINTS, 0.003, 6.0, blockSize=3)
    if corners is None:
        return np.empty((0, 4)), np.empty((0, 4))
    place = [corners.reshape(-1, 2).astype(np.float32)]
    good = np.ones(len(place[0]), bool)
    circle = (before.left, before.right, frame.right, frame.left, before.left)
    for a, b in itertools.pairwise(circle):
        there, seen, _ = cv2.calcOpticalFlowPyrLK(a, b, place[-1], None, winSize=_WINDOW, maxLevel=_LEVELS)
        good &= seen[:, 0] > 0
        place.append(there)
    left0, right0, right1, left1, home = place
    good &= np.linalg.norm(home - left0, axis=1) < _ROUND_TRIP_PX
    uv0, uv1 = np.concatenate([left0, right0], axis=1), np.concatenate([left1, right1], axis=1)
    return uv0[good].astype(float), uv1[good].astype(float)


def _moves_otherwise(rig: StereoRig, p0: Array, p1: Array, uv1: Array) -> Bool[Array, "n"]:
    """Points that do not follow the one rigid motion that most do: RANSAC over three points, by what is seen now."""
    rng = np.random.default_rng(0)
    best = np.zeros(len(p0), bool)
    for _ in range(_TRIALS):
        chosen = rng.choice(len(p0), 3, replace=False)
        fits = _misfit(rig, *align(p0[chosen], p1[chosen]), p0, uv1) < _MISFIT_PX
        if fits.sum() > best.sum():
            best = fits
    if best.sum() < 3:
        return np.zeros(len(p0), bool)
    return np.asarray(_misfit(rig, *align(p0[best], p1[best]), p0, uv1) > 2 * _MISFIT_PX)


def _misfit(rig: StereoRig, R: Array, t: Array, p0: Array, uv1: Array) -> Float[Array, "n"]:
    predicted = rig.project(p0 @ R.T + t)
    off = np.linalg.norm(predicted - uv1, axis=1)
    return np.where(np.isfinite(off), off, np.inf)


def _nearest_group(p: Float[Array, "n 3"], moves: Bool[Array, "n"]) -> Array:
    """Indices of the cluster of moving points that looks largest."""
    index = np.flatnonzero(moves)
    if len(index) < _LEAST:
        return np.empty(0, int)
    # Depth is known far worse than direction, so that distances along the line of sight count less.
    where = np.column_stack([p[index, :2] / p[index, 2:], 0.3 * np.log(p[index, 2])])
    graph = cKDTree(where).sparse_distance_matrix(cKDTree(where), _NEIGHBOUR_M)
    _, label = connected_components(graph, directed=False)
    count = np.bincount(label)
    return index[label == np.argmax(count)] if count.max() >= _LEAST else np.empty(0, int)


def _fill(mask: Bool[Array, "h w"], uv: Float[Array, "n 2"]) -> None:
    hull = cv2.convexHull(uv.astype(np.float32))[:, 0]
    middle = hull.mean(axis=0)
    grown = np.rint(middle + (1 + _GROWN) * (hull - middle)).astype(np.int32)
    canvas = np.zeros(mask.shape, np.uint8)
    cv2.fillConvexPoly(canvas, grown, 1)
    mask |= canvas > 0
