"""Optical flow as it follows from depth, instance and poses: no image is needed."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from jaxtyping import Float, UInt16

from sim.camera import Camera
from sim.pose import Pose

Array = np.ndarray


def optical_flow(
    depth: Float[Array, "h w"],
    instance: UInt16[Array, "h w"],
    camera: Camera,
    T_wc_0: Pose,
    T_wc_1: Pose,
    T_w_items_0: Sequence[Pose],
    T_w_items_1: Sequence[Pose],
    ids: Sequence[int],
) -> Float[Array, "h w 2"]:
    """Where the surface point of each pixel moves between two moments: ``project(T_cc p(u, v, z)) - (u, v)`` [px].

    With ``T_cc = T_wc_1^-1 T_w_item_1 T_w_item_0^-1 T_wc_0`` of the pixel's item (``ids``: instance per item). The sky
    is at infinity and moves with the camera's rotation alone. NaN where the point comes to lie behind the camera.

    Raises ``ValueError`` if items of one instance do not move as one, or the mask holds an instance without item.
    """
    T_cc = _motions(T_wc_0, T_wc_1, T_w_items_0, T_w_items_1, ids)
    uv, rays = _pixel_rays(camera)
    z, owner = depth.ravel(), instance.ravel()
    flow = np.empty((len(z), 2), np.float32)
    for i in np.unique(owner):
        if int(i) not in T_cc:
            raise ValueError(f"instance: the mask holds {i}, which is not among the items' ids")
        R, t = T_cc[int(i)]
        at = np.flatnonzero(owner == i)
        p_c0 = rays[at] if i == 0 else rays[at] * z[at, None]
        flow[at] = camera.project(p_c0 @ R.T + t) - uv[at]
    return flow.reshape(*depth.shape, 2)


@lru_cache(maxsize=2)
def _pixel_rays(camera: Camera) -> tuple[Float[Array, "n 2"], Float[Array, "n 3"]]:
    """All pixel centres, row by row, and their rays of unit depth."""
    w, h = camera.size_px
    uv = np.stack(np.meshgrid(np.arange(w, dtype=float), np.arange(h, dtype=float)), axis=-1).reshape(-1, 2)
    return uv, camera.unproject(uv, np.ones(len(uv)))


def _motions(
    T_wc_0: Pose, T_wc_1: Pose, T_w_items_0: Sequence[Pose], T_w_items_1: Sequence[Pose], ids: Sequence[int]
) -> dict[int, tuple[Array, Array]]:
    """From the first camera frame to the second, (R, t) per instance; rotation alone for 0, the sky."""
    T_c1_w = T_wc_1.inv()
    motions = {0: (T_c1_w.R @ T_wc_0.R, np.zeros(3))}
    for i, T_0, T_1 in zip(ids, T_w_items_0, T_w_items_1, strict=True):
        T = T_c1_w @ T_1 @ T_0.inv() @ T_wc_0
        known = motions.setdefault(int(i), (T.R, T.t))
        if not (np.allclose(known[0], T.R, rtol=0, atol=1e-9) and np.allclose(known[1], T.t, rtol=0, atol=1e-6)):
            raise ValueError(f"ids: items that share instance {i} move differently")
    return motions
