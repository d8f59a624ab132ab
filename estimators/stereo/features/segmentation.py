"""Where the target is, from motion and depth alone: the group of points that moves by itself, together and rigidly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from estimators.stereo.features.frames import StereoFrame
from estimators.stereo.features.rigid import Motion, distance, fit
from estimators.stereo.features.scene_points import Box, ScenePoints, followed
from sim.camera import StereoRig

Array = np.ndarray
_LAG = 3  # frames over which motion is judged
_SIGMA_PX = 0.1  # least standard deviation of a coordinate
_LEAST, _LEAST_SCENE, _FOR_SCENE = 4, 20, 400  # points: of a group, of the scene; enough for its motion
_MOVES, _FITS, _BETTER = 30.0, 25.0, 8.0  # squared distances: from the scene's motion, from the group's; by how much
_LINK_M, _LINK_PX = 1.5, 1.5  # neighbours in a group: across and up, and in disparity
_JOIN = 2.0  # times that: others that move as the group does
_THROUGH = 0.25  # still points in a group's hull, as a share of its own, that deny it
_GROWN = 0.5  # share of its size that a group's surroundings are wider, on all sides
_REACH_M = 120.0
_SCENE = np.array([0.1, 0.1, 0.1, 3.0, 3.0, 3.0])  # rotation [rad] and translation [m] over the lag
_GROUP = np.array([0.03, 0.06, 0.03, 5.0, 5.0, 5.0])


@dataclass(frozen=True, eq=False)
class _Scene:
    """Points known now and the lag before: names, pixels, normalised coordinates and their variance in units of a sharp
    corner's, places before and now in the camera's frame [m], and where they are now in units of what links neighbours:
    across, up, and disparity."""

    name: Int[Array, "n"]
    left: Float32[Array, "n 2"]
    xy: Float[Array, "n 4"]
    variance: Float[Array, "n"]
    before: Float[Array, "n 3"]
    now: Float[Array, "n 3"]
    where: Float[Array, "n 3"]


@dataclass
class MotionSegmentation:
    """Called frame by frame; keeps what it saw. The mask is empty where nothing moves by itself."""

    rig: StereoRig
    _before: StereoFrame | None = field(default=None, init=False)
    _points: ScenePoints = field(default_factory=lambda: ScenePoints.none(_LAG + 1), init=False)
    _frames: int = field(default=0, init=False)
    _ego: Motion = field(init=False)
    _members: Int[Array, "m"] = field(default_factory=lambda: np.empty(0, int), init=False)
    _box: Box | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self._ego = Motion(np.eye(3), np.zeros(3), self._least)

    @property
    def _least(self) -> float:
        """The least variance of normalised coordinates."""
        return float((_SIGMA_PX / self.rig.left.K[0, 0]) ** 2)

    def __call__(self, frame: StereoFrame) -> Bool[Array, "h w"]:
        self._points = followed(self._points, self.rig, self._before, frame, self._box)
        lag = min(self._frames, _LAG)
        self._before, self._frames = frame, self._frames + 1
        scene = _read(self._points, self.rig, lag)
        nothing = np.zeros(frame.left.shape, bool)
        if not lag or len(scene.name) < _LEAST_SCENE:
            return nothing
        for group, still in self._groups(scene):
            mask = _hull(scene.left[group], nothing.shape)
            if not _seen_through(scene, group, still, mask):
                self._members, self._box = scene.name[group], _around(scene.left[group], self._box)
                return mask
        self._members, self._box = scene.name[:0], None
        return nothing

    def _groups(self, scene: _Scene) -> Iterator[tuple[Int[Array, "g"], Bool[Array, "n"]]]:
        """Indices of groups that move by themselves, the largest first, where points of the last one count thrice; and
        which points stand still."""
        T_rl, s = self.rig.T_rl, scene
        some = slice(None, None, max(len(s.name) // _FOR_SCENE, 1))
        start = Motion(self._ego.R, self._ego.t, self._least)
        self._ego = ego = fit(T_rl, start, s.before[some], s.xy[some], s.variance[some], _SCENE)
        variance = ego.variance * s.variance
        off = distance(T_rl, ego, s.before, s.xy, variance)
        x = ego.apply(s.before)
        found: list[tuple[int, Motion, Int[Array, "g"]]] = []
        for part in _linked(s.where, np.flatnonzero(off > _MOVES)):
            start = Motion(np.eye(3), np.median(s.now[part] - x[part], axis=0), self._least)
            own = fit(T_rl, start, x[part], s.xy[part], s.variance[part], _GROUP)
            part = part[distance(T_rl, own, x[part], s.xy[part], variance[part]) < _FITS]
            if len(part) >= _LEAST:
                found.append((len(part) + 2 * int(np.isin(s.name[part], self._members).sum()), own, part))
        for _, own, part in sorted(found, key=lambda f: -f[0]):
            own_off = distance(T_rl, own, x, s.xy, variance)
            near, _ = cKDTree(s.where[part]).query(s.where, distance_upper_bound=_JOIN)
            yield np.flatnonzero(np.isfinite(near) & (own_off < _FITS) & (off > own_off + _BETTER)), off < _MOVES


def _read(points: ScenePoints, rig: StereoRig, lag: int) -> _Scene:
    known = np.isfinite(points.p[:, lag, 2]) & (points.p[:, 0, 2] < _REACH_M)
    now, base = points.p[known, 0], float(np.linalg.norm(rig.T_rl.t))
    where = np.column_stack([now[:, :2] / _LINK_M, rig.left.K[0, 0] * base / now[:, 2] / _LINK_PX])
    before = points.p[known, lag]
    return _Scene(points.name[known], points.left[known], points.xy[known], points.variance[known], before, now, where)


def _linked(where: Float[Array, "n 3"], index: Int[Array, "m"]) -> list[Int[Array, "g"]]:
    """Groups of enough points that neighbours link."""
    i, j = cKDTree(where[index]).query_pairs(1.0, output_type="ndarray").T
    graph = coo_array((np.ones(len(i)), (i, j)), shape=(len(index), len(index)))
    _, label = connected_components(graph, directed=False)
    return [index[label == k] for k in np.flatnonzero(np.bincount(label) >= _LEAST)]


def _seen_through(scene: _Scene, group: Int[Array, "g"], still: Bool[Array, "n"], mask: Bool[Array, "h w"]) -> bool:
    """Whether much of what is seen within the group's hull, no nearer than the group, stands still."""
    u, v = np.rint(scene.left).astype(int).T
    behind = scene.where[:, 2] < np.median(scene.where[group, 2]) + 1
    return bool(np.count_nonzero(mask[v, u] & still & behind) > _THROUGH * len(group))


def _hull(uv: Float32[Array, "n 2"], shape: tuple[int, ...]) -> Bool[Array, "h w"]:
    """The hull of points, a pixel wider."""
    canvas = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(canvas, np.rint(cv2.convexHull(uv)).astype(np.int32), 1)
    return np.asarray(cv2.dilate(canvas, np.ones((3, 3), np.uint8)) > 0)


def _around(uv: Float32[Array, "n 2"], last: Box | None) -> Box:
    """The box to look for more points in: around a group, and not much smaller than the last one."""
    low, high = uv.min(axis=0), uv.max(axis=0)
    grown = _GROWN * (high - low) + 8
    low, high = low - grown, high + grown
    if last is not None:
        keep = (1 - _GROWN / 5) / 2 * (np.array(last[2:]) - last[:2])
        middle = (np.array(last[2:]) + last[:2]) / 2
        low, high = np.minimum(low, middle - keep), np.maximum(high, middle + keep)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])
