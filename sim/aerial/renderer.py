"""Aerial images of a scene, with lens distortion exact to the model, and what is true about every pixel and vehicle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

from sim.aerial import kernels, shade_kernels, shadow_kernels
from sim.aerial.library import Instances
from sim.aerial.scene import AerialScene
from sim.aerial.sunlight import code_values, light_values
from sim.aerial.traffic_state import VehicleStates
from sim.archive import freeze_fields
from sim.camera import Camera
from sim.camera_kernels import rays_of, view_of
from sim.pose import Pose

Array = np.ndarray
_LARGEST_SHADOW_MAP = 6e7
_TALLEST_M = 40.0


@dataclass(frozen=True, eq=False)
class VisibleVehicles:
    """Vehicles with pixels in the image (if nothing hid them): their states, pixels seen, and the share hidden."""

    states: VehicleStates
    pixels: Int[Array, "n"]
    hidden: Float[Array, "n"]

    def __post_init__(self) -> None:
        freeze_fields(self)


@dataclass(frozen=True, eq=False)
class AerialTruth:
    """At pixel centres: depth along the optical axis [m] (NaN: nothing seen), and whose surface it is.

    ``instance`` is a vehicle's number from 0 on, -1 ground, -2 nothing, -3 tree or building.
    """

    depth: Float[Array, "h w"]
    instance: Int[Array, "h w"]
    vehicles: VisibleVehicles


@dataclass(frozen=True, eq=False)
class _View:
    """What a camera sees of a scene, ready for the loops."""

    ground: Float[Array, "rows columns 7"]
    rays: Float[Array, "rows columns 3"]
    instances: Instances
    vertex: Float[Array, "v 8"]
    triangles: Int[Array, "t 5"]
    start: Int[Array, "_"]
    entries: Int[Array, "e"]
    vehicles: Int[Array, "k"]
    states: VehicleStates


def render(scene: AerialScene, camera: Camera, T_wc: Pose, t_s: float = 0.0, samples: int = 1) -> UInt8[Array, "h w 3"]:
    """The image (h, w, 3), sRGB code values; ``samples`` squared per pixel.

    Raises
        ValueError: fewer than one sample.
    """
    if samples < 1:
        raise ValueError(f"samples: expected at least 1, got {samples}")
    view = _view(scene, camera, T_wc, t_s)
    w, h = camera.size_px
    image = np.empty((h, w, 3), np.uint8)
    xyz = view.ground[..., :3][np.isfinite(view.ground[..., 0])]
    light = scene.world.sunlight
    if len(xyz):
        bounds = (*xyz[:, :2].min(axis=0), *xyz[:, :2].max(axis=0))
        spacing = float(np.median(1 / view.ground[..., 3][view.ground[..., 3] > 0])) / float(camera.K[1, 1])
        level = scene.ground.level(spacing / samples)
        pool, slots = scene.ground.tiles(bounds, level)
    else:
        level, spacing = 0, 1.0
        pool, slots = scene.ground.tiles((0.0, 0.0, 0.0, 0.0), 0)
    frame, shadow = _shadow_map(scene, view, spacing)
    shade_kernels.shade(
        T_wc.t, _sheared(view.ground, frame), view.rays, pool, slots, scene.ground.grid(level),
        view.triangles, view.start, view.entries, view.vertex, view.instances.paint.astype(np.float32),
        scene.library.texels, scene.library.textures, frame, shadow, light.numbers(), light_values(), code_values(),
        samples, image,
    )  # fmt: skip
    return image


def measure(scene: AerialScene, camera: Camera, T_wc: Pose, t_s: float = 0.0) -> AerialTruth:
    """What is true at every pixel's centre, and which vehicles can be seen."""
    view = _view(scene, camera, T_wc, t_s)
    w, h = camera.size_px
    depth, owner = np.empty((h, w), np.float32), np.empty((h, w), np.int32)
    shade_kernels.measure(view.ground, view.triangles, view.start, view.entries, view.vertex, depth, owner)
    first = len(view.instances) - len(view.vehicles)
    own = np.where(owner >= first, owner - first, -1)
    seen = np.bincount(own[own >= 0], minlength=len(view.vehicles))
    # The same without buildings, trees and ground: how much of each there would be to see.
    alone = _only_vehicles(view, first, camera)
    bare = np.full_like(view.ground, np.nan)
    other, free = np.empty_like(depth), np.empty_like(owner)
    shade_kernels.measure(bare, *alone, view.vertex, other, free)
    whole = np.bincount(free[free >= 0] - first, minlength=len(view.vehicles))
    number = view.states.number[view.vehicles]
    table = np.concatenate([np.full(first, -3), number, [-2, -1]]).astype(np.int32)
    shown = np.flatnonzero(whole > 0)
    hidden = 1 - seen[shown] / whole[shown]
    states = view.states.of(view.vehicles[shown])
    return AerialTruth(depth, table[owner], VisibleVehicles(states, seen[shown], np.clip(hidden, 0.0, 1.0)))


def _only_vehicles(view: _View, first: int, camera: Camera) -> tuple[Array, Array, Array]:
    triangles = view.triangles[view.triangles[:, 4] >= first]
    return (triangles, *_bins(triangles, view.vertex, camera))


def _bins(triangles: Array, vertex: Array, camera: Camera) -> tuple[Array, Array]:
    tile = shade_kernels.TILE
    columns, rows = (-(-n // tile) for n in camera.size_px)
    start, entries = kernels.bins(triangles, vertex, tile, columns, rows)
    return start, entries


def _view(scene: AerialScene, camera: Camera, T_wc: Pose, t_s: float) -> _View:
    view = view_of(camera, T_wc)
    ground, rays = _nodes(scene, camera, T_wc, view)
    states = scene.vehicles(t_s)
    seen = _may_be_seen(scene, scene.standing, view)
    moving = scene.placed(states)
    near = np.flatnonzero(_may_be_seen(scene, moving, view))
    instances = Instances.joined([scene.standing.chosen(seen), moving.chosen(near)])
    library = scene.library
    counts = np.diff(library.vertex_first)[instances.mesh]
    first = np.cumsum(np.concatenate([[0], counts]))
    vertex = np.empty((first[-1], kernels.VERTEX), np.float32)
    sun = scene.world.sunlight.direction
    kernels.place_vertices(
        view, sun, instances.mesh, instances.place, first, library.vertex_first, library.vertices, library.normals,
        library.look, vertex,
    )  # fmt: skip
    triangles = kernels.front_faces(
        instances.mesh, first, library.vertex_first, library.face_first, library.faces, library.texture, vertex,
        *camera.size_px,
    )  # fmt: skip
    return _View(ground, rays, instances, vertex, triangles, *_bins(triangles, vertex, camera), near, states)


def _nodes(scene: AerialScene, camera: Camera, T_wc: Pose, view: Array) -> tuple[Array, Array]:
    """Ground (x, y, z, 1/depth, -, -, share of sunlight) and rays at every `STEP`th pixel and one step beyond."""
    step = shade_kernels.STEP
    u, v = (np.arange(-1, -(-n // step) + 2) * float(step) for n in camera.size_px)
    rays = rays_of(view, u, v)
    terrain = scene.world.terrain
    xyz = terrain.intersect(T_wc.t, rays)
    depth = (xyz - T_wc.t) @ T_wc.R[:, 2]
    ground = np.full((*xyz.shape[:2], 7), np.nan)
    ground[..., :3] = xyz
    ground[..., 3] = 1 / depth
    ground[..., 6] = np.maximum(terrain.normal(xyz[..., :2]) @ scene.world.sunlight.direction, 0.0)
    return ground, rays


def _may_be_seen(scene: AerialScene, instances: Instances, view: Array) -> Array:
    """Whether an instance's ball touches the cone of the image, by the rays along its border."""
    place = instances.place
    scale = np.sqrt(np.max(np.sum(place[:, :9].reshape(-1, 3, 3) ** 2, axis=1), axis=1)) if len(place) else np.zeros(0)
    radius = scene.library.radius[instances.mesh] * scale
    d = place[:, 9:] - view[9:12]
    p = d @ view[:9].reshape(3, 3).T
    tangent = np.sqrt(view[22])
    off = np.hypot(p[:, 0], p[:, 1]) - tangent * p[:, 2]
    return np.asarray((off < radius * np.hypot(1, tangent)) & (p[:, 2] > -radius))


def _shadow_map(scene: AerialScene, view: _View, spacing: float) -> tuple[Array, Array]:
    """Frame and heights of the shadow map over the ground that is seen."""
    L = scene.world.sunlight.direction
    slant = L[:2] / L[2]
    xyz = view.ground[..., :3][np.isfinite(view.ground[..., 0])]
    if not len(xyz):
        return np.array([0.0, 0.0, 1.0, 0.0, *slant]), np.full((2, 2), shadow_kernels.NOTHING, np.float32)
    z0 = float(xyz[:, 2].min())
    sheared = xyz[:, :2] - (xyz[:, 2:] - z0) * slant
    low, high = sheared.min(axis=0) - 1.0, sheared.max(axis=0) + 1.0
    # What stands on the ground rises above it: its own shadows fall before it.
    reach = _TALLEST_M * np.abs(slant)
    low, high = low - reach * (slant > 0), high + reach * (slant < 0)
    spacing = max(spacing, float(np.sqrt(np.prod(high - low) / _LARGEST_SHADOW_MAP)))
    columns, rows = (int(n) + 2 for n in (high - low) / spacing)
    frame = np.array([*low, spacing, z0, *slant])
    casters = Instances.joined([scene.standing, scene.placed(view.states)])
    casters = casters.chosen(_casts(scene, casters, frame, rows, columns))
    library = scene.library
    height = shadow_kernels.cast(
        frame, casters.mesh, casters.place, library.vertex_first, library.face_first, library.vertices, library.faces,
        rows, columns,
    )  # fmt: skip
    return frame, height


def _casts(scene: AerialScene, instances: Instances, frame: Array, rows: int, columns: int) -> Array:
    """Whether an instance's shadow can fall on the map."""
    place = instances.place
    scale = np.sqrt(np.max(np.sum(place[:, :9].reshape(-1, 3, 3) ** 2, axis=1), axis=1)) if len(place) else np.zeros(0)
    radius = scene.library.radius[instances.mesh] * scale * (1 + np.hypot(frame[4], frame[5]))
    at = place[:, 9:11] - (place[:, 11:] - frame[3]) * frame[4:6]
    size = np.array([columns, rows]) * frame[2]
    return np.asarray(((at > frame[:2] - radius[:, None]) & (at < frame[:2] + size + radius[:, None])).all(axis=1))


def _sheared(ground: Array, frame: Array) -> Array:
    """Ground nodes with their place on the shadow map."""
    out = ground.copy()
    out[..., 4:6] = ground[..., :2] - (ground[..., 2:3] - frame[3]) * frame[4:6]
    return out
