"""The front end's input: stereo frames, and how they are read from files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Shaped, UInt8

from sim.observations import Observations

Array = np.ndarray


class ImageError(ValueError):
    """An image that cannot be used: one line that names the file."""


@dataclass(frozen=True, eq=False)
class StereoFrame:
    """Two grey images (h, w), taken at once, and where the target is supposed to be in the left one, or None."""

    left: UInt8[Array, "h w"]
    right: UInt8[Array, "h w"]
    mask: Bool[Array, "h w"] | None = None


def to_grey(image: UInt8[Array, "h w 3"]) -> UInt8[Array, "h w"]:
    """Grey values of a colour image (red, green, blue)."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))


def read_frames(observations: Observations, folder: Path) -> Iterator[StereoFrame]:
    """The images and masks named in observations, files relative to a folder, frame by frame.

    Colour becomes grey; 16 bits become 8, by the range of the sequence's first image.

    Raises
        ImageError: an image is missing, cannot be read, or has another size than the rig's.
    """
    if observations.images is None:
        raise ImageError("the observations name no images")
    yield from read_pairs([(folder / a, folder / b) for a, b in observations.images], observations, folder)


def read_pairs(files: Sequence[tuple[Path, Path]], observations: Observations, folder: Path) -> Iterator[StereoFrame]:
    """Pairs of image files as frames, with the masks the observations name."""
    sizes = (observations.rig.left.size_px, observations.rig.right.size_px)
    ranges: list[tuple[float, float] | None] = [None, None]
    for k, pair in enumerate(files):
        images = []
        for side, path in enumerate(pair):
            raw = _read(path, sizes[side])
            if raw.dtype != np.uint8 and ranges[side] is None:
                ranges[side] = (float(raw.min()), float(raw.max()))
            images.append(_eight_bits(raw, ranges[side]))
        mask = None if observations.masks is None else _read(folder / observations.masks[k], sizes[0]) > 0
        yield StereoFrame(images[0], images[1], mask)


def _read(path: Path, size_px: tuple[int, int]) -> Shaped[Array, "h w"]:
    if not path.is_file():
        raise ImageError(f"{path}: no such image")
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ImageError(f"{path}: cannot be read as an image")
    if image.shape[1::-1] != tuple(size_px):
        raise ImageError(f"{path}: is {image.shape[1]} x {image.shape[0]} px, the rig {size_px[0]} x {size_px[1]} px")
    if image.ndim == 3:
        kind = cv2.COLOR_BGRA2GRAY if image.shape[2] == 4 else cv2.COLOR_BGR2GRAY
        image = cv2.cvtColor(image, kind)
    return np.asarray(image)


def _eight_bits(image: Array, limits: tuple[float, float] | None) -> UInt8[Array, "h w"]:
    if image.dtype == np.uint8:
        return image
    assert limits is not None
    low, high = limits
    scaled = (image.astype(np.float32) - low) * (255 / max(high - low, 1))
    return np.asarray(np.clip(np.rint(scaled), 0, 255), np.uint8)
