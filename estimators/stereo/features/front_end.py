"""From stereo images to tracks: corners on the target, followed in time and matched from left to right."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from estimators.stereo.features import stereo_match, temporal
from estimators.stereo.features.frames import ImageError, StereoFrame
from estimators.stereo.features.measured import Rows, measured_tracks
from estimators.stereo.features.segmentation import MotionSegmentation
from estimators.stereo.features.templates import Live
from sim.camera import StereoRig
from sim.observations import Tracks

Array = np.ndarray
_NO_MASK = np.empty((0, 0), bool)


@dataclass(frozen=True)
class FrontEnd:
    """Corners of the target tracked through a stereo sequence.

    points: tracks wanted at a time; patch_px: side of the square of grey values a point is known by, odd;
    distance_px: least distance of a new corner from all others; quality: least corner strength, as a share of the
    strongest; round_trip_px: how far tracking forth and back may end from where it began; correlation: least
    correlation of a patch with its template, in time and from left to right; epipolar_px: largest distance of a right
    point from the epipolar line of the left one; nearest_m: no point is nearer; margin_px: rim of the mask that is left
    out, where background shines through the optical blur; drift_px: how far a patch strays on the body for several
    frames, which no residual shows, as measured on rendered cars; segmentation: "given" masks, if there are any, or
    "motion": the target is what moves otherwise than most of the scene, whatever masks say.
    """

    points: int = 150
    patch_px: int = 9
    distance_px: float = 3.0
    quality: float = 0.005
    round_trip_px: float = 0.5
    correlation: float = 0.85
    epipolar_px: float = 0.8
    nearest_m: float = 3.0
    margin_px: int = 1
    drift_px: float = 0.09
    segmentation: Literal["given", "motion"] = "given"

    def __post_init__(self) -> None:
        allowed = {
            "points": self.points >= 1,
            "patch_px": self.patch_px >= 5 and self.patch_px % 2 == 1,
            "distance_px": self.distance_px > 0,
            "quality": 0 < self.quality < 1,
            "round_trip_px": self.round_trip_px > 0,
            "correlation": 0 < self.correlation < 1,
            "epipolar_px": self.epipolar_px > 0,
            "nearest_m": self.nearest_m > 0,
            "margin_px": self.margin_px >= 0,
            "drift_px": self.drift_px >= 0,
        }
        for name, good in allowed.items():
            if not good:
                raise ValueError(f"FrontEnd.{name}: {getattr(self, name)} is out of range")

    def __call__(self, rig: StereoRig, frames: Iterable[StereoFrame]) -> Tracks:
        """Tracks of a sequence with their measured covariance; none where there is nothing to track.

        Raises
            ImageError: a frame's images are not of the rig's size, or left and right are swapped.
        """
        live, rows, born = Live.none(self.patch_px), [], 0
        previous: StereoFrame | None = None
        segment = MotionSegmentation(rig) if self.segmentation == "motion" else None
        votes = np.zeros(2, int)
        for k, frame in enumerate(frames):
            _check(rig, frame)
            if segment is not None:
                frame = replace(frame, mask=segment(frame))
            mask = _NO_MASK if frame.mask is None else _within(frame.mask, self.margin_px)
            if previous is not None and len(live):
                live = temporal.follow(live, previous.left, frame.left, mask, self)
                live = live.select(_inside(live.uv, frame.left.shape, mask))
            fresh = self._corners(frame, live.uv, mask)
            live = live.joined(Live.born(frame.left, mask, fresh, born, self.patch_px))
            born += len(fresh)
            live, match = stereo_match.match(live, rig, frame, mask, self)
            votes += match.votes
            if votes[1] > 50 and votes[1] > 2 * votes[0]:
                raise ImageError("left and right images are swapped: what is found in both lies behind the cameras")
            rows.append(Rows.of(k, live, match))
            previous = frame
        return measured_tracks(rig, rows, self.drift_px)

    def _corners(self, frame: StereoFrame, known: Float[Array, "n 2"], mask: Bool[Array, "h w"]) -> Float[Array, "c 2"]:
        """Corners that are missing to the wanted number, away from the known ones and the target's outline."""
        wanted = self.points - len(known)
        if wanted <= 0 or (mask.size and not mask.any()):
            return np.empty((0, 2))
        x0, y0, x1, y1 = _bounds(mask, frame.left.shape)
        left = frame.left[y0:y1, x0:x1]
        free = np.full(left.shape, 255, np.uint8)
        if mask.size:
            free[~mask[y0:y1, x0:x1]] = 0
        for u, v in np.rint(known - [x0, y0]).astype(int):
            cv2.circle(free, (int(u), int(v)), int(np.ceil(self.distance_px)), 0, -1)
        found = cv2.goodFeaturesToTrack(left, wanted, self.quality, self.distance_px, mask=free, blockSize=3)
        corners: Array = np.empty((0, 2)) if found is None else np.array(found, float).reshape(-1, 2)
        corners += (x0, y0)
        return np.asarray(corners[_inside(corners, frame.left.shape, _NO_MASK)])


def _within(mask: Bool[Array, "h w"], margin_px: int) -> Bool[Array, "h w"]:
    """The mask without its rim."""
    size = 2 * margin_px + 1
    return np.asarray(cv2.erode(mask.astype(np.uint8), np.ones((size, size), np.uint8)) > 0)


def _check(rig: StereoRig, frame: StereoFrame) -> None:
    for side, image, camera in (("left", frame.left, rig.left), ("right", frame.right, rig.right)):
        if image.shape[::-1] != tuple(camera.size_px):
            raise ImageError(f"the {side} image is {image.shape[1]} x {image.shape[0]} px, the rig's {camera.size_px}")


def _bounds(mask: Bool[Array, "h w"], shape: tuple[int, ...]) -> tuple[int, int, int, int]:
    """The rectangle that holds the mask; the whole image without one."""
    if not mask.size:
        return 0, 0, shape[1], shape[0]
    x, y = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    return int(x[0]), int(y[0]), int(x[-1]) + 1, int(y[-1]) + 1


def _inside(uv: Float[Array, "n 2"], shape: tuple[int, ...], mask: Array) -> Bool[Array, "n"]:
    """Points in the image, and where the mask holds."""
    at: Int[Array, "n 2"] = np.rint(uv).astype(int)
    good = np.asarray(((at >= 3) & (at < [shape[1] - 3, shape[0] - 3])).all(axis=1))
    if mask.size:
        good[good] = mask[at[good, 1], at[good, 0]]
    return good
