"""What stands around the street but is in no image itself: it is mirrored in paint and glass, and its shadows fall on
what drives through. Patterns over the ground, fixed to the world and repeated. Pure geometry without OpenGL.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float

from sim.textures import noise

Array = np.ndarray
TOWN_M, SHADE_M = 64.0, 40.0
_TOWN_PX, _SHADE_PX = 512, 2048
_PENUMBRA_PX = 1.6  # sigma 3 cm: the sun's disc past an edge 8 m away


def town_plan(rng: np.random.Generator) -> Float[Array, "s s 3"]:
    """Per place: height of what stands there [m], its brightness, share of it that glints like a window in the sun."""
    shape = (_TOWN_PX, _TOWN_PX)
    blocks, crowns, fronts, panes = (noise(shape, beta, rng) for beta in (3.0, 2.2, 1.6, 1.2))
    height = np.clip(7.0 * np.tanh(8.0 * (blocks - 0.1)) + 1.2 * crowns, 0, 11)
    brightness = np.clip(0.30 + 0.30 * np.tanh(2.0 * fronts), 0.03, 1.0)
    return np.stack([height, brightness, np.clip(2.5 * (panes - 2.2), 0, 1)], axis=-1).astype(np.float32)


def shade_pattern(rng: np.random.Generator) -> Float[Array, "s s 3"]:
    """Share of the sun that is hidden: row = along the shadows, column = across them; all channels the same."""
    size, scale = _SHADE_PX, _SHADE_PX / SHADE_M
    crowns, leaves = noise((size, size), 3.4, rng), noise((size, size), 1.8, rng)
    shade = np.clip(6.0 * (crowns - 0.7) + 1.5 * leaves, 0, 1).astype(np.float32)
    bars = [(45, (0.2, 0.9), (8, 20)), (4, (3, 6), (8, 14))]  # trunks and poles, houses: how many, wide [m], long [m]
    for count, wide, long in bars:
        for _ in range(count):
            _bar(shade, rng.uniform(0, size, 2), scale * rng.uniform(*wide), scale * rng.uniform(*long))
    soft = cv2.GaussianBlur(np.pad(shade, 16, mode="wrap"), (0, 0), _PENUMBRA_PX)[16:-16, 16:-16]
    return np.repeat(soft[..., None], 3, axis=-1)


def _bar(shade: Array, corner: Float[Array, "2"], width: float, length: float) -> None:
    """A full shadow, wrapped around the pattern's borders."""
    size = len(shade)
    rows = np.arange(int(corner[0]), int(corner[0] + length)) % size
    columns = np.arange(int(corner[1]), int(corner[1] + width)) % size
    shade[np.ix_(rows, columns)] = 1.0


def shade_axes(to_sun: Float[Array, "3"]) -> Float[Array, "2 3"]:
    """World to the pattern's (across, along) in periods: all points of one sun ray have the same."""
    level = np.hypot(to_sun[0], to_sun[1])
    ahead = to_sun[:2] / level if level > 1e-6 else np.array([0.0, 1.0])
    across = np.array([ahead[1], -ahead[0], 0.0])
    along = np.array([*ahead, -level / to_sun[2]])
    return np.stack([across, along]) / SHADE_M
