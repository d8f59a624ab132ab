"""What a camera sees of a scene, made ready for the loops: ground at nodes, models in bins, tiles, shadows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from sim.aerial import kernels, shade_kernels, shadow_kernels
from sim.aerial.library import Instances
from sim.aerial.scene import AerialScene
from sim.aerial.traffic_state import VehicleStates
from sim.camera import Camera
from sim.camera_kernels import rays_of, view_of
from sim.pose import Pose
from sim.terrain import Bounds

Array = np.ndarray
_LARGEST_SHADOW_MAP = 6e7
_TALLEST_M = 40.0


@dataclass(frozen=True, eq=False)
class View:
    """What a camera sees of a scene; ``vehicles`` are those of ``states`` that are the last of ``instances``."""

    ground: Float[Array, "rows columns 7"]
    rays: Float[Array, "rows columns 3"]
    instances: Instances
    vertex: Float[Array, "v 8"]
    triangles: Int[Array, "t 5"]
    start: Int[Array, "_"]
    entries: Int[Array, "e"]
    vehicles: Int[Array, "k"]
    states: VehicleStates

    @property
    def ground_m(self) -> Float[Array, "n 3"]:
        """Ground points of the nodes that see ground."""
        return np.asarray(self.ground[..., :3][np.isfinite(self.ground[..., 0])])

    def spacing_m(self, camera: Camera) -> float:
        """Distance of neighbouring pixels on the ground; 1 where none is seen."""
        inverse = self.ground[..., 3][self.ground[..., 3] > 0]
        return float(np.median(1 / inverse)) / float(camera.K[1, 1]) if len(inverse) else 1.0

    def bounds_m(self) -> Bounds:
        """Bounds of the ground that is seen; a point where there is none."""
        xy = self.ground_m[:, :2]
        return (*xy.min(axis=0), *xy.max(axis=0)) if len(xy) else (0.0, 0.0, 0.0, 0.0)


def bins(triangles: Array, vertex: Array, camera: Camera) -> tuple[Array, Array]:
    """Which triangles touch which tile of the image, as `kernels.bins`."""
    tile = shade_kernels.TILE
    columns, rows = (-(-n // tile) for n in camera.size_px)
    start, entries = kernels.bins(triangles, vertex, tile, columns, rows)
    return start, entries


def look(scene: AerialScene, camera: Camera, T_wc: Pose, t_s: float) -> View:
    """What the camera sees at a time [s]."""
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
    return View(ground, rays, instances, vertex, triangles, *bins(triangles, vertex, camera), near, states)


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
    radius = scene.library.radius[instances.mesh] * instances.scale
    d = place[:, 9:] - view[9:12]
    p = d @ view[:9].reshape(3, 3).T
    tangent = np.sqrt(view[22])
    off = np.hypot(p[:, 0], p[:, 1]) - tangent * p[:, 2]
    return np.asarray((off < radius * np.hypot(1, tangent)) & (p[:, 2] > -radius))


def shadow_map(scene: AerialScene, view: View, spacing: float, vehicles: VehicleStates) -> tuple[Array, Array]:
    """Frame and heights of the shadow map over the ground that is seen; what stands, and ``vehicles``, cast shadows."""
    L = scene.world.sunlight.direction
    slant = L[:2] / L[2]
    xyz = view.ground_m
    if not len(xyz):
        return np.array([0.0, 0.0, 1.0, 0.0, *slant]), np.full((2, 2), shadow_kernels.NOTHING, np.float32)
    z0 = float(xyz[:, 2].min())
    level = xyz[:, :2] - (xyz[:, 2:] - z0) * slant
    low, high = level.min(axis=0) - 1.0, level.max(axis=0) + 1.0
    # What stands on the ground rises above it: its own shadows fall before it.
    reach = _TALLEST_M * np.abs(slant)
    low, high = low - reach * (slant > 0), high + reach * (slant < 0)
    spacing = max(spacing, float(np.sqrt(np.prod(high - low) / _LARGEST_SHADOW_MAP)))
    columns, rows = (int(n) + 2 for n in (high - low) / spacing)
    frame = np.array([*low, spacing, z0, *slant])
    groups = (scene.standing, scene.placed(vehicles))
    casters = Instances.joined([g.chosen(_casts(scene, g, frame, rows, columns)) for g in groups])
    library = scene.library
    height = shadow_kernels.cast(
        frame, casters.mesh, casters.place, library.vertex_first, library.face_first, library.vertices, library.faces,
        rows, columns,
    )  # fmt: skip
    return frame, height


def _casts(scene: AerialScene, instances: Instances, frame: Array, rows: int, columns: int) -> Array:
    """Whether an instance's shadow can fall on the map."""
    place = instances.place
    radius = scene.library.radius[instances.mesh] * instances.scale * (1 + np.hypot(frame[4], frame[5]))
    at = place[:, 9:11] - (place[:, 11:] - frame[3]) * frame[4:6]
    size = np.array([columns, rows]) * frame[2]
    return np.asarray(((at > frame[:2] - radius[:, None]) & (at < frame[:2] + size + radius[:, None])).all(axis=1))


def sheared(ground: Array, frame: Array) -> Array:
    """Ground nodes with their place on the shadow map."""
    out = ground.copy()
    out[..., 4:6] = ground[..., :2] - (ground[..., 2:3] - frame[3]) * frame[4:6]
    return out
