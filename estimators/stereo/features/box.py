"""A vehicle boxed by hand in one frame, followed through a sequence: masks for the front end."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float

from estimators.stereo.features import temporal
from estimators.stereo.features.frames import StereoFrame
from estimators.stereo.features.front_end import FrontEnd

Array = np.ndarray
_SHARE = 0.15  # disparities of the vehicle differ by so much from their median
_LEAST_SHARE = 0.15  # of a box that block matching must know for its depth to be trusted
_POINTS = 80
_BLOCK_PX = 5


@dataclass(frozen=True, eq=False)
class BoxedFrame:
    """A frame with the mask of the vehicle in it; box (4,) left, top, right, bottom [px], or None where it is not
    known, and the median disparity [px] of block matching in it, NaN where that knows too little."""

    frame: StereoFrame
    box: Float[Array, "4"] | None
    disparity: float


def follow_box(
    frames: Iterable[StereoFrame], boxes: Mapping[int, Float[Array, "4"]], largest_disparity_px: float
) -> Iterator[BoxedFrame]:
    """Every frame with what is in the box: given in some frames, between them carried on by its points' motion.

    What the box holds of the background is left out by its depth. Before the first box the mask is empty; from where
    the box leaves the image or its points are lost it is empty, too, until a box is given again.
    """
    box: Array | None = None
    before: StereoFrame | None = None
    inside = np.empty((0, 0), bool)
    for k, frame in enumerate(frames):
        if k in boxes:
            box = np.array(boxes[k], float)
        elif box is not None and before is not None:
            box = _carried(before, frame, inside, box)
        if box is None:
            inside, disparity = np.zeros(frame.left.shape, bool), float("nan")
        else:
            inside, disparity = _vehicle(frame, box, largest_disparity_px)
        yield BoxedFrame(replace(frame, mask=inside), box, disparity)
        before = frame


def _carried(before: StereoFrame, frame: StereoFrame, inside: Bool[Array, "h w"], box: Array) -> Array | None:
    """The box moved and scaled as the points in it are; None where they are lost."""
    corners = cv2.goodFeaturesToTrack(before.left, _POINTS, 0.01, 3.0, mask=inside.astype(np.uint8), blockSize=3)
    if corners is None or len(corners) < temporal.ENOUGH:
        return None
    uv = np.asarray(corners, float).reshape(-1, 2)
    now, found = temporal.round_trip(before.left, frame.left, uv, FrontEnd(patch_px=11))
    if found.sum() < temporal.ENOUGH:
        return None
    M, shift = temporal.common_motion(uv[found], now[found])
    scale = float(np.sqrt(abs(np.linalg.det(M))))
    middle = M @ (box[:2] + box[2:]) / 2 + shift
    half = scale * (box[2:] - box[:2]) / 2
    moved = np.concatenate([middle - half, middle + half])
    height, width = frame.left.shape
    seen = moved[0] < width - 5 and moved[2] > 5 and moved[1] < height - 5 and moved[3] > 5
    return moved if seen else None


def _vehicle(frame: StereoFrame, box: Array, largest_px: float) -> tuple[Bool[Array, "h w"], float]:
    """The box's pixels whose disparity is near its median, and that; the whole box where too little is known."""
    height, width = frame.left.shape
    mask = np.zeros((height, width), bool)
    x0, y0 = (int(max(v, 0)) for v in box[:2])
    x1, y1 = min(int(box[2]) + 1, width), min(int(box[3]) + 1, height)
    mask[y0:y1, x0:x1] = True
    found = disparities(frame, (x0, y0, x1, y1), largest_px)
    known = np.isfinite(found)
    if known.mean() < _LEAST_SHARE:
        return mask, float("nan")
    median = float(np.median(found[known]))
    same = (np.abs(found - median) < _SHARE * median).astype(np.uint8)
    solid = cv2.morphologyEx(same, cv2.MORPH_CLOSE, np.ones((2 * _BLOCK_PX + 1,) * 2, np.uint8))
    mask[y0:y1, x0:x1] = solid > 0
    return mask, median


def disparities(frame: StereoFrame, part: tuple[int, int, int, int], largest_px: float) -> Float[Array, "a b"]:
    """Disparities [px] of a part (left, top, right, bottom) of the left image by semi-global matching, NaN unknown."""
    x0, y0, x1, y1 = part
    count = max(16, 16 * int(np.ceil(largest_px / 16)))
    margin = 3 * _BLOCK_PX
    a, b = max(x0 - count - margin, 0), min(x1 + margin, frame.left.shape[1])
    c, d = max(y0 - margin, 0), min(y1 + margin, frame.left.shape[0])
    matcher = cv2.StereoSGBM.create(0, count, _BLOCK_PX, 8 * 25, 32 * 25, 1, 0, 10, 50, 2)
    raw = matcher.compute(frame.left[c:d, a:b], frame.right[c:d, a:b]).astype(float) / 16
    raw[raw <= 0] = np.nan
    return np.asarray(raw[y0 - c : y1 - c, x0 - a : x1 - a])
