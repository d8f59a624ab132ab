"""Low sun ahead: light that windscreen and lens scatter over the image, and its mirror images between the lenses."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float

from sim.camera import Camera
from sim.model import Model
from sim.pose import Pose
from sim.visibility import hidden

Array = np.ndarray
_DIRTY = 3.0  # level 1 scatters this many times what the eye does
_SUN_RADIUS = np.deg2rad(0.267)
_FAR_M = 1000.0
_COARSE = 4
# Share of a bright surface's light that level 1 scatters by 1 to 10 degrees: the integral of the same law.
_SCATTERED = _DIRTY * 10 * 2 * np.pi * np.log(10) * np.deg2rad(1.0) ** 2
_SPREADS = np.tan(np.deg2rad([1.0, 3.0, 8.0]))
# Ghosts: place on the line from the sun through the middle, radius in image widths, brightness, colour.
_GHOSTS = (
    (-0.45, 0.045, 0.30, (1.0, 0.85, 0.6)),
    (-0.80, 0.080, 0.14, (0.6, 1.0, 0.7)),
    (0.40, 0.025, 0.40, (0.8, 0.8, 1.0)),
    (-1.25, 0.120, 0.08, (1.0, 0.6, 0.8)),
)


def sun_share(things: Sequence[tuple[Model, Pose]], sun_c: Float[Array, "3"]) -> float:
    """Share of the sun's disc that a camera sees past things in their poses T_cb (camera from body)."""
    side = np.cross(sun_c, [0.6, 0.8, 0.0] if abs(sun_c[2]) > 0.5 else [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    angle = np.arange(6) * (np.pi / 3)
    rim = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(sun_c, side)
    points = _FAR_M * np.concatenate([sun_c[None], sun_c + 0.7 * _SUN_RADIUS * rim])
    turn = _turn_ahead(sun_c)  # `hidden` looks along z
    seen = np.ones(len(points), bool)
    for model, T_cb in things:
        if len(model.solid_faces) and seen.any() and _near_ray(model, T_cb, sun_c):
            triangles = T_cb.apply(model.solid_vertices)[model.solid_faces]
            seen[seen] = ~hidden(points[seen] @ turn.T, triangles @ turn.T)
    return float(seen.mean())


def _turn_ahead(direction: Array) -> Array:
    """A rotation that brings a direction to the z axis."""
    x = np.cross(direction, [0.0, 1.0, 0.0] if abs(direction[1]) < 0.9 else [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(direction, x), direction])


def _near_ray(model: Model, T_cb: Pose, direction: Array) -> bool:
    """Whether the sphere around a thing touches the ray from the camera."""
    low, high = model.solid_vertices.min(axis=0), model.solid_vertices.max(axis=0)
    centre, radius = T_cb.apply((low + high) / 2), float(np.linalg.norm(high - low)) / 2
    along = float(centre @ direction)
    reach = radius + float(_SUN_RADIUS) * max(along, 0.0)
    return along > -radius and float(centre @ centre) - along**2 < reach**2


def glaring(
    light: Float[Array, "h w 3"],
    level: float,
    camera: Camera,
    sun_c: Float[Array, "3"],
    sun: Float[Array, "3"],
) -> Float[Array, "h w 3"]:
    """Light with the sun's veil and ghosts and the bloom of whatever is bright.

    Veil: ``L = 10 E / theta²`` of Stiles and Holladay for the eye (E on the pupil, theta in degrees), times 3
    ``level``; a white wall in the sun has ``E / pi``. sun_c: unit vector to the sun in the camera frame; ``sun`` (3,):
    light of a white wall that faces it, 0 where it is hidden. With the sun behind the camera there is only bloom.
    """
    h, w = light.shape[:2]
    small = cv2.resize(light, (w // _COARSE, h // _COARSE), interpolation=cv2.INTER_AREA)
    focal = float(camera.K[0, 0]) / _COARSE
    spread = sum(cv2.GaussianBlur(small, (0, 0), s * focal, borderType=cv2.BORDER_REPLICATE) for s in _SPREADS)
    scattered = level * _SCATTERED
    added = scattered / len(_SPREADS) * np.asarray(spread)
    illuminance = np.pi * max(float(sun_c[2]), 0.0) * np.asarray(sun)
    if illuminance.any():
        added = added + _veil(level, camera, sun_c, small.shape[:2])[..., None] * illuminance
        added = _with_ghosts(added, level, camera, sun_c, sun)
    blended = cv2.resize(added.astype(np.float32), (w, h), interpolation=cv2.INTER_LINEAR)
    return np.asarray((1 - np.float32(scattered)) * light + blended, np.float32)


def _veil(level: float, camera: Camera, sun_c: Array, shape: tuple[int, ...]) -> Array:
    """Veiling light per illuminance on the coarse grid."""
    h, w = shape
    u, v = np.meshgrid((np.arange(w) + 0.5) * _COARSE - 0.5, (np.arange(h) + 0.5) * _COARSE - 0.5)
    xy = camera.normalise(np.stack([u, v], axis=-1))
    cosine = (xy @ sun_c[:2] + sun_c[2]) / np.sqrt(1 + np.sum(xy * xy, axis=-1))
    theta = np.maximum(np.arccos(np.clip(cosine, -1, 1)), _SUN_RADIUS)
    return np.asarray(_DIRTY * level * 10 / np.rad2deg(theta) ** 2)


def _with_ghosts(added: Array, level: float, camera: Camera, sun_c: Array, sun: Array) -> Array:
    """Discs on the line from the sun through the middle of the image, brighter at their rim; on the coarse grid."""
    to_sun = camera.K[:2, :2] @ (sun_c[:2] / max(float(sun_c[2]), 0.1))
    strength = level * np.clip(1.6 - np.linalg.norm(to_sun) / (0.5 * np.hypot(*camera.size_px)), 0, 1)
    if strength == 0:
        return added
    h, w = added.shape[:2]
    u, v = np.arange(w) * _COARSE + (_COARSE - 1) / 2, np.arange(h) * _COARSE + (_COARSE - 1) / 2
    for place, radius, bright, color in _GHOSTS:
        middle, r = camera.K[:2, 2] + place * to_sun, radius * camera.size_px[0]
        distance = np.hypot(u - middle[0], (v - middle[1])[:, None]) / r
        disc = np.clip((1 - distance) * r / 6, 0, 1) * (0.5 + 0.5 * np.minimum(distance, 1) ** 2)
        added = added + (strength * bright * disc)[..., None] * (np.asarray(color) * sun)
    return added
