"""From camera and light to the matrices of OpenGL. Pure geometry without OpenGL.

Images are drawn upside down: clip y points down like the pixels' v, so the framebuffer's row 0 is the image's top.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from sim.camera import Camera
from sim.pose import Pose

Array = np.ndarray
_NEAREST_M = 0.3


def clip_from_camera(camera: Camera, near_m: float, far_m: float) -> Float[Array, "4 4"]:
    """Projection of an undistorted camera; pixel (0, 0) is half a pixel inside the corner of the viewport."""
    w, h = camera.size_px
    (fx, skew, cx), (_, fy, cy) = camera.K[0], camera.K[1]
    span = far_m - near_m
    return np.array(
        [
            [2 * fx / w, 2 * skew / w, 2 * (cx + 0.5) / w - 1, 0],
            [0, 2 * fy / h, 2 * (cy + 0.5) / h - 1, 0],
            [0, 0, (far_m + near_m) / span, -2 * far_m * near_m / span],
            [0, 0, 1, 0],
        ]
    )


def depth_range(corners: Float[Array, "r 8 3"], T_c_anchor: Float[Array, "4 4"]) -> tuple[float, float]:
    """Near and far plane [m] around what boxes can be in front of the camera."""
    z = corners @ T_c_anchor[2, :3] + T_c_anchor[2, 3]
    far = max(1.01 * float(z.max(initial=0.0)), 2 * _NEAREST_M)
    ahead = z.min(axis=-1)[z.max(axis=-1) > _NEAREST_M]
    near = float(np.clip(0.99 * ahead.min(initial=far), _NEAREST_M, far / 2))
    return near, far


@dataclass(frozen=True, eq=False)
class Eye:
    """One camera in place: T_c_anchor (4, 4), clip_from_anchor (4, 4), its centre (3,) in the anchor frame.

    The anchor (3,) is that frame's origin in the world.
    """

    camera: Camera
    T_c_anchor: Float[Array, "4 4"]
    clip_from_anchor: Float[Array, "4 4"]
    center: Float[Array, "3"]
    anchor: Float[Array, "3"]

    @staticmethod
    def at(camera: Camera, T_wc: Pose, anchor: Float[Array, "3"], corners: Float[Array, "r 8 3"]) -> Eye:
        center = T_wc.t - anchor
        T = Pose(T_wc.R, center).inv().matrix()
        return Eye(camera, T, clip_from_camera(camera, *depth_range(corners, T)) @ T, center, anchor)

    def rays(self, n: int) -> Float[Array, "m 3"]:
        """Directions of n x n pixels spread over the image with its borders, length 1 along the optical axis."""
        w, h = self.camera.size_px
        u, v = np.meshgrid(np.linspace(-0.5, w - 0.5, n), np.linspace(-0.5, h - 0.5, n))
        xy = self.camera.normalise(np.stack([u, v], axis=-1).reshape(-1, 2))
        return np.asarray(np.column_stack([xy, np.ones(len(xy))]) @ self.T_c_anchor[:3, :3])

    def ray_of_clip(self) -> Float[Array, "4 4"]:
        """World direction of the clip coordinates (x, y, 1), in the upper left 3 x 3."""
        M = np.eye(4)
        M[:3, :3] = np.linalg.inv(clip_from_camera(self.camera, 1.0, 2.0)[[0, 1, 3], :3] @ self.T_c_anchor[:3, :3])
        return M


def seen_points(eye: Eye, corners: Float[Array, "r 8 3"], range_m: float) -> Float[Array, "m 3"]:
    """Ends of view rays where they are inside the scene's box, at most ``range_m`` of them (along the axis)."""
    lo, hi = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    rays = eye.rays(9)
    safe = np.where(np.abs(rays) < 1e-9, 1e-9, rays)
    t = np.sort(np.stack([(lo - eye.center) / safe, (hi - eye.center) / safe]), axis=0)
    enter, leave = np.maximum(t[0].max(axis=-1), 0.0), t[1].min(axis=-1)
    hit = leave > enter
    start = enter[hit]
    ends = np.concatenate([start, np.minimum(leave[hit], start + range_m)])
    return np.asarray(eye.center + np.concatenate([rays[hit], rays[hit]]) * ends[:, None])


def fit_light_box(
    to_light: Float[Array, "3"],
    eyes: Sequence[Eye],
    corners: Float[Array, "r 8 3"],
    casts: Bool[Array, "r"],
    range_m: float,
) -> tuple[Float[Array, "4 4"], float] | None:
    """Clip coordinates of parallel light, and the width of the box [m]; None where no shadow can be seen.

    The box holds what is both seen and, along the light, covered by something that casts shadows; its sides follow
    the first camera's image.
    """
    seen = np.concatenate([seen_points(e, corners, range_m) for e in eyes])
    if not len(seen) or not casts.any():
        return None
    side = np.cross(eyes[0].T_c_anchor[1, :3], to_light)
    if np.linalg.norm(side) < 0.1:
        side = np.cross(eyes[0].T_c_anchor[2, :3], to_light)
    x = side / np.linalg.norm(side)
    R = np.stack([x, np.cross(-to_light, x), -to_light])
    p, q = seen @ R.T, corners @ R.T
    lo, hi = p.min(axis=0), p.max(axis=0)
    boxes_lo, boxes_hi = q[casts].min(axis=1), q[casts].max(axis=1)
    near = np.all((boxes_hi[:, :2] > lo[:2]) & (boxes_lo[:, :2] < hi[:2]), axis=-1)
    if not near.any():
        return None
    lo[:2] = np.maximum(lo[:2], boxes_lo[near, :2].min(axis=0)) - 0.5
    hi[:2] = np.minimum(hi[:2], boxes_hi[near, :2].max(axis=0)) + 0.5
    lo[2] = boxes_lo[near, 2].min() - 0.5
    hi[2] = max(hi[2], boxes_hi[near, 2].max()) + 0.5
    M = np.eye(4)
    M[:3, :3] = 2 / (hi - lo)[:, None] * R
    M[:3, 3] = -(hi + lo) / (hi - lo)
    return M, float((hi - lo)[:2].max())
