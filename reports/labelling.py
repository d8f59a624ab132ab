"""Where points tracked in images truly were, from true depth, instance and poses: their material points and labels.

The true surface point under a track's left pixel is read from the depth image. The material point of the track is the
place on the body where most of its frames agree; errors are measured pixels minus the projection of that point.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from sim.archive import freeze_fields
from sim.camera import Camera
from sim.observations import Tracks
from sim.pose import Pose
from sim.truth import DEPTH_SCALE, FIRST_VEHICLE, INLIER, Labels, Truth

Array = np.ndarray
KINDS = ("stereo", "temporal", "drift", "segmentation")
# Four to twelve sigma of what tracking attains (0.08 to 0.25 px): noise does not get there, and an error of its size
# is three or more sigma of what estimators are told.
THRESHOLD_PX = 1.0
# A surface that turns away from the image plane by more than 84 degrees cannot be tracked: what is steeper is a step.
_STEEPEST = 10.0


@dataclass(frozen=True, eq=False)
class Seen:
    """The target in one left image: inverse depth (h, w) [1/m] at the pixel centres, 0 where something else is seen.

    Only its bounding box with one pixel around it is kept; ``corner_px`` is the first column and row of that.
    """

    corner_px: tuple[int, int]
    inverse_depth: Float[Array, "h w"]

    def __post_init__(self) -> None:
        freeze_fields(self)

    @staticmethod
    def of(depth: Float[Array, "h w"], shows_target: Bool[Array, "h w"]) -> Seen:
        """From a depth image [m], 0 where unknown, and the pixels that show the target."""
        shows = shows_target & (depth > 0)
        v, u = np.flatnonzero(shows.any(axis=1)), np.flatnonzero(shows.any(axis=0))
        if not len(u):
            return Seen((0, 0), np.zeros((2, 2)))
        box = slice(v[0], v[-1] + 1), slice(u[0], u[-1] + 1)
        inverse = np.divide(1.0, depth[box], out=np.zeros(depth[box].shape), where=shows[box])
        return Seen((int(u[0]) - 1, int(v[0]) - 1), np.pad(inverse, 1))

    def inverse_depth_at(self, uv: Float[Array, "n 2"], focal_px: float) -> Float[Array, "n"]:
        """Inverse depth between pixels [1/m]; NaN where none of the four around shows the target.

        Bilinear, which is exact on a plane; where the four are not one surface, that of the nearest on the target.
        """
        x, last = uv - np.array(self.corner_px), np.array(self.inverse_depth.shape[::-1]) - 2
        low = np.clip(np.floor(x), 0, last).astype(int)
        share = x - low
        (u, v), (s, t), d = low.T, share.T, self.inverse_depth
        around = np.stack([d[v, u], d[v, u + 1], d[v + 1, u], d[v + 1, u + 1]])
        weight = np.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t])
        steps = np.ptp(around, axis=0) > _STEEPEST / focal_px * around.max(axis=0)
        nearest = np.where(around > 0, weight, -1.0).argmax(axis=0)
        found = np.where(steps, around[nearest, np.arange(len(uv))], (weight * around).sum(axis=0))
        outside = (share < 0).any(axis=1) | (share > 1).any(axis=1)
        return np.asarray(np.where(outside | (found <= 0), np.nan, found))


def read_seen(folder: Path, truth: Truth) -> Iterator[Seen]:
    """The target in the left images of a run, from the pictures beside its truth.

    Raises
        ValueError: a picture is missing or broken.
    """
    for k in range(len(truth.t_s)):
        depth, instance = (_read(folder / kind / "left" / f"{k:06d}.png") for kind in ("depth", "instance"))
        yield Seen.of(depth / DEPTH_SCALE, instance == truth.target + FIRST_VEHICLE)


def _read(path: Path) -> Array:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ValueError(f"{path}: missing or broken")
    return np.asarray(image)


def label(truth: Truth, tracks: Tracks, seen: Iterable[Seen]) -> Truth:
    """The truth of a rendered run with the material points and labels of the tracks a front end made in its images.

    seen: the target in every left image. Labels, of every row of the tracks, by errors beyond `THRESHOLD_PX`:

    - segmentation: the track lies on the target in fewer than half its frames; it has no material point
    - temporal: in the left image the point is elsewhere; it leapt, or left the target
    - drift: likewise, but it slid over the body without a leap: aperture, outlines and mirrored light, which cannot be
      told apart
    - stereo: it is where it belongs in the left image, but not in the right one

    ``labels.sigma_px`` is the measured noise of the inliers, pooled over the four coordinates.
    """
    surface_v = surface_points(truth, tracks, seen)
    track, which = np.unique(tracks.track, return_inverse=True)
    point_v = _material_points(truth, tracks, surface_v, which, len(track))
    uv_true = truth.rig.project(truth.T_cv[tracks.frame].apply(point_v[which]))
    kind = _kinds(tracks, tracks.uv - uv_true, ~np.isfinite(surface_v[:, 0]), ~np.isfinite(point_v[which, 0]))
    sigma = np.full(len(kind), noise_px((tracks.uv - uv_true)[kind == INLIER], tracks.track[kind == INLIER]))
    return replace(truth, track=track, point_v=point_v, labels=Labels(kind, uv_true, sigma, KINDS))


def noise_px(error: Float[Array, "n k"], track: Int[Array, "n"]) -> float:
    """Standard deviation per coordinate of errors against the places of tracks, which are means over their own rows."""
    free = len(track) - len(np.unique(track))
    return float(np.sqrt(np.sum(error**2) / (error.shape[1] * free))) if free else np.nan


def surface_points(truth: Truth, tracks: Tracks, seen: Iterable[Seen]) -> Float[Array, "n 3"]:
    """The true point of the body under every left pixel, in the vehicle frame; NaN where something else is seen."""
    points, T_vc, camera = np.full((len(tracks), 3), np.nan), truth.T_cv.inv(), truth.rig.left
    for k, target in enumerate(seen):
        rows = slice(*np.searchsorted(tracks.frame, [k, k + 1]))
        uv = tracks.uv_left[rows]
        points[rows] = T_vc[k].apply(camera.unproject(uv, 1 / target.inverse_depth_at(uv, camera.K[0, 0])))
    return points


def _material_points(
    truth: Truth, tracks: Tracks, surface_v: Array, which: Int[Array, "n"], count: int
) -> Float[Array, "k 3"]:
    """The point of each track; NaN for tracks that lie on the target in fewer than half of their frames."""
    points = np.full((count, 3), np.nan)
    order = np.argsort(which, kind="stable")
    for k, rows in enumerate(np.split(order, np.flatnonzero(np.diff(which[order])) + 1) if count else ()):
        on = rows[np.isfinite(surface_v[rows, 0])]
        if 2 * len(on) >= len(rows):
            T_cv = truth.T_cv[tracks.frame[on]]
            points[k] = _agreed(truth.rig.left, T_cv, tracks.uv_left[on], surface_v[on])
    return points


def _agreed(camera: Camera, T_cv: Pose, uv: Float[Array, "n 2"], surface_v: Float[Array, "n 3"]) -> Float[Array, "3"]:
    """Mean of the surface points of the frames that agree with one of them within the threshold: with that one with
    which most do."""
    moved = np.einsum("nab,kb->nka", T_cv.R, surface_v) + T_cv.t[:, None]
    agree = np.linalg.norm(camera.project(moved) - uv[:, None], axis=-1) <= THRESHOLD_PX
    return np.asarray(surface_v[agree[:, agree.sum(axis=0).argmax()]].mean(axis=0))


def _kinds(
    tracks: Tracks, error: Float[Array, "n 4"], beside: Bool[Array, "n"], foreign: Bool[Array, "n"]
) -> Int[Array, "n"]:
    """Labels of the rows from their errors, whether something else is seen there, and tracks without a point."""
    number = {name: i + 1 for i, name in enumerate(KINDS)}
    left, right = (np.linalg.norm(error[:, side], axis=1) for side in (slice(0, 2), slice(2, 4)))
    moved = ~(left <= THRESHOLD_PX)
    leaping = tracks.track[_leaps(tracks, error[:, :2]) | (moved & beside)]
    slid = ~np.isin(tracks.track, leaping)
    conditions = [foreign, moved & slid, moved, ~(right <= THRESHOLD_PX)]
    names = ("segmentation", "drift", "temporal", "stereo")
    return np.select(conditions, [np.full(len(tracks), number[n]) for n in names], INLIER)


def _leaps(tracks: Tracks, error: Float[Array, "n 2"]) -> Bool[Array, "n"]:
    """Rows whose error differs by more than the threshold from that of the same track's row before."""
    order = np.lexsort((tracks.frame, tracks.track))
    step = np.linalg.norm(np.diff(error[order], axis=0), axis=1)
    leaps = np.zeros(len(tracks), bool)
    leaps[order[1:]] = (np.diff(tracks.track[order]) == 0) & (step > THRESHOLD_PX)
    return leaps
