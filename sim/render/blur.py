"""Motion blur: what the sensor gathers while exposed is the mean light of several moments of one exposure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8

from sim.camera import Camera
from sim.pose import Pose
from sim.realism.tone import to_image, to_light
from sim.render.flow import optical_flow
from sim.render.renderer import View

Array = np.ndarray
_EVERY = 8
_MOST = 15


def motion_px(
    view: View,
    camera: Camera,
    T_wc: tuple[Pose, Pose],
    T_w_items: tuple[Sequence[Pose], Sequence[Pose]],
    ids: Sequence[int],
) -> float:
    """How far the fastest of every eighth pixel (the thousandth apart) moves between two moments."""
    assert view.depth is not None
    assert view.instance is not None
    depth, instance = view.depth[::_EVERY, ::_EVERY], view.instance[::_EVERY, ::_EVERY]
    K = camera.K.copy()
    K[:2] /= _EVERY
    coarse = Camera(K, (depth.shape[1], depth.shape[0]), camera.distortion)
    flow = _EVERY * np.hypot(*np.moveaxis(optical_flow(depth, instance, coarse, *T_wc, *T_w_items, ids), -1, 0))
    return float(np.quantile(flow[np.isfinite(flow)], 0.999)) if np.isfinite(flow).any() else 0.0


def moments(longest_px: float) -> Float[Array, "n"]:
    """An odd number of moments in -1/2..1/2 of the exposure, evenly spread, the middle among them.

    So many that nothing moves more than a pixel from one to the next, but at most 15; one where the longest motion is
    below half a pixel, which the optics blur anyway.
    """
    n = 1 if longest_px < 0.5 else int(np.clip(2 * np.ceil(longest_px / 2) + 1, 3, _MOST))
    return (np.arange(n) + 0.5) / n - 0.5


def mean_light(images: Sequence[UInt8[Array, "h w 3"]]) -> UInt8[Array, "h w 3"]:
    """The image of the mean light of images before the sensor; of one image itself."""
    if len(images) == 1:
        return images[0]
    total = to_light(images[0]).copy()
    for image in images[1:]:
        total += to_light(image)
    return to_image(total / np.float32(len(images)))
