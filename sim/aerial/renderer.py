"""Aerial images of a scene, with lens distortion exact to the model, and what is true about every pixel and vehicle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

from sim.aerial import shade_kernels
from sim.aerial.scene import AerialScene
from sim.aerial.sunlight import code_values, light_values
from sim.aerial.traffic_state import VehicleStates
from sim.aerial.view import View, bins, look, shadow_map, sheared
from sim.archive import freeze_fields
from sim.camera import Camera
from sim.pose import Pose

Array = np.ndarray


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


def render(scene: AerialScene, camera: Camera, T_wc: Pose, t_s: float = 0.0, samples: int = 1) -> UInt8[Array, "h w 3"]:
    """The image (h, w, 3), sRGB code values; ``samples`` squared per pixel.

    Raises
        ValueError: fewer than one sample.
    """
    if samples < 1:
        raise ValueError(f"samples: expected at least 1, got {samples}")
    seen = look(scene, camera, T_wc, t_s)
    w, h = camera.size_px
    image = np.empty((h, w, 3), np.uint8)
    light, spacing = scene.world.sunlight, seen.spacing_m(camera)
    level = scene.ground.level(spacing / samples)
    pool, slots = scene.ground.tiles(seen.bounds_m(), level)
    frame, shadow = shadow_map(scene, seen, spacing, seen.states)
    shade_kernels.shade(
        T_wc.t, sheared(seen.ground, frame), seen.rays, pool, slots, scene.ground.grid(level),
        seen.triangles, seen.start, seen.entries, seen.vertex, seen.instances.paint.astype(np.float32),
        scene.library.texels, scene.library.textures, frame, shadow, light.numbers(), light_values(), code_values(),
        samples, image,
    )  # fmt: skip
    return image


def measure(scene: AerialScene, camera: Camera, T_wc: Pose, t_s: float = 0.0) -> AerialTruth:
    """What is true at every pixel's centre, and which vehicles can be seen."""
    view = look(scene, camera, T_wc, t_s)
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


def _only_vehicles(view: View, first: int, camera: Camera) -> tuple[Array, Array, Array]:
    triangles = view.triangles[view.triangles[:, 4] >= first]
    return (triangles, *bins(triangles, view.vertex, camera))
