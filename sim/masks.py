"""Masks of the target as a segmentation gets them wrong: outline, place, holes, and pixels of what is beside it."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Bool, Float

from sim.scenario import MotionSegmentation, Scenario, WrongMask
from sim.streams import stream

Array = np.ndarray
_PLACES = 6  # holes, and blobs, at a time


def given_mask(scenario: Scenario, shown: Bool[Array, "h w"], frame: int, run: int = 0) -> Bool[Array, "h w"] | None:
    """What the front end is told of the pixels that truly show the target: they, wrong ones, or nothing."""
    segmentation = scenario.measure.segmentation
    if isinstance(segmentation, MotionSegmentation):
        return None
    if isinstance(segmentation, WrongMask):
        return wrong_mask(shown, segmentation, scenario.seed, run, scenario.target.name, frame)
    return shown


def wrong_mask(
    mask: Bool[Array, "h w"], spec: WrongMask, seed: int, run: int, entity: str, frame: int
) -> Bool[Array, "h w"]:
    """The mask (h, w) of one frame with its errors.

    Holes and blobs are discs, alike in size and placed at random in the mask's bounding box and on its outline. They
    keep their places on the target for ``spec.frames`` frames, so that what is tracked there lives for a while. Each
    kind of error has a random stream of its own.
    """
    if not mask.any():
        return mask
    epoch = frame // spec.frames
    places = {
        kind: stream(seed, run, f"{entity}/mask/{kind}/{epoch}").uniform(size=(_PLACES, 2))
        for kind in ("holes", "neighbour")
    }
    wrong = _dilated(mask, spec.dilate_px) if spec.dilate_px else mask.copy()
    if spec.neighbour:
        # About half of a disc on the outline lies beside the target.
        radius = _radius(2 * spec.neighbour * mask.sum())
        wrong |= _discs(mask.shape, _on_outline(mask, places["neighbour"][:, 0]), radius)
    if spec.holes:
        wrong &= ~_discs(mask.shape, _inside(mask, places["holes"]), _radius(spec.holes * mask.sum()))
    return _shifted(wrong, spec.shift_px) if any(spec.shift_px) else wrong


def _dilated(mask: Array, by_px: int) -> Array:
    """Grown, or eroded where negative, by a disc."""
    size = 2 * abs(by_px) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    change = cv2.dilate if by_px > 0 else cv2.erode
    return np.asarray(change(mask.astype(np.uint8), disc, borderType=cv2.BORDER_REPLICATE), bool)


def _shifted(mask: Array, by_px: tuple[float, float]) -> Array:
    """Moved by whole pixels; what comes in from beyond the image is not the target."""
    moved = np.array([[1, 0, np.rint(by_px[0])], [0, 1, np.rint(by_px[1])]])
    size = (mask.shape[1], mask.shape[0])
    return np.asarray(cv2.warpAffine(mask.astype(np.uint8), moved, size, flags=cv2.INTER_NEAREST), bool)


def _radius(area: float) -> float:
    """Radius of the discs that share an area [px]."""
    return float(np.sqrt(area / (_PLACES * np.pi)))


def _inside(mask: Array, places: Float[Array, "c 2"]) -> Float[Array, "c 2"]:
    """Pixels (u, v) of the mask by their share of its height and of the row there."""
    rows = np.flatnonzero(mask.any(axis=1))
    v = rows[(places[:, 1] * len(rows)).astype(int)]
    columns = [np.flatnonzero(mask[k]) for k in v]
    u = [c[int(share * len(c))] for c, share in zip(columns, places[:, 0], strict=True)]
    return np.stack([u, v], axis=1).astype(float)


def _on_outline(mask: Array, places: Float[Array, "c"]) -> Float[Array, "c 2"]:
    """Pixels (u, v) of the outline by their direction from the mask's middle, as a share of a full turn."""
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(outlines, key=len).reshape(-1, 2).astype(float)
    x, y = (outline - outline.mean(axis=0)).T
    turn = np.arctan2(y, x) / (2 * np.pi) % 1.0
    away = np.abs((turn[None] - places[:, None] + 0.5) % 1.0 - 0.5)
    return np.asarray(outline[away.argmin(axis=1)])


def _discs(shape: tuple[int, ...], centres: Float[Array, "c 2"], radius: float) -> Array:
    filled = np.zeros(shape, np.uint8)
    for u, v in np.rint(centres).astype(int).tolist():
        cv2.circle(filled, (u, v), round(radius), 1, thickness=-1)
    return np.asarray(filled, bool)
