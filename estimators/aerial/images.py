"""Images of a flight, read strictly."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from sim.flight_observations import IMAGES
from sim.navigation import ImageRecord

Array = np.ndarray


class FlightImageError(ValueError):
    """An image that cannot be used: one line that names the file."""


def read_image(folder: Path, record: ImageRecord) -> UInt8[Array, "h w *c"]:
    """The image of a record, RGB (h, w, 3) or grey (h, w), of the observations in a folder.

    Raises
        FlightImageError: it is missing, cannot be decoded, or has another size than the record or another depth.
    """
    path = folder / IMAGES / record.file
    try:
        code = np.fromfile(path, np.uint8)
    except OSError as error:
        raise FlightImageError(f"{path}: {(error.strerror or str(error)).lower()}") from error
    # Turned by an EXIF orientation it would no longer fit the camera.
    flags = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(code, flags) if len(code) else None
    except cv2.error:
        image = None
    if image is None:
        raise FlightImageError(f"{path}: not an image, or damaged")
    size = (record.width_px, record.height_px)
    if image.shape[1::-1] != size:
        raise FlightImageError(f"{path}: expected {size[0]}x{size[1]}, found {image.shape[1]}x{image.shape[0]}")
    if image.dtype != np.uint8:
        raise FlightImageError(f"{path}: expected 8 bits, found {image.dtype}")
    return np.asarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
