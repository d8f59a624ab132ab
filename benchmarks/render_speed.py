"""A view by our renderer at 2x with shadows against stock pyrender at 1x with multisampling and shadows.

Three cars on a road at 1024 x 768; the same meshes, textures, poses and sun, alternating in one process. Prints
the median times and the median of the ratios; then the time of a view of the whole street of `oncoming`.

    python benchmarks/render_speed.py [--repeats N]
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from scenarios import footage, spec
from sim.camera import Camera
from sim.meshes import make_vehicle
from sim.model import Model, Surface
from sim.pose import R_WORLD_FROM_LEVEL_CAMERA, Pose, vehicle_rotation
from sim.render import Item, Light, Renderer
from sim.textures import asphalt, to_texture
from sim.world import build_world

Array = np.ndarray
SIZE, FOCAL_PX = (1024, 768), 1000.0
T_WC = Pose(R_WORLD_FROM_LEVEL_CAMERA, np.array([0.0, 0, 1.2]))
TO_SUN = Light.daylight().to_sun


def road() -> Model:
    half, length, tile = 60.0, 200.0, 8.0
    vertices = np.array([[-half, -20, 0], [half, -20, 0], [half, length, 0], [-half, length, 0]])
    surface = Surface(
        vertices=vertices,
        faces=np.array([[0, 1, 2], [0, 2, 3]]),
        normals=np.tile([0.0, 0, 1], (4, 1)),
        color=np.ones((4, 3)),
        gloss=np.zeros(4),
        uv=vertices[:, :2] / tile,
        texture=to_texture(asphalt((1024, 1024), np.random.default_rng(0))),
        cast_shadow=False,
    )
    return Model("road", ((surface,),), (), vertices, surface.faces, (2 * half, length + 20, 0.0))


def three_cars() -> tuple[list[Item], list[Pose]]:
    rng = np.random.default_rng(1)
    items, poses = [Item(road(), 1)], [Pose.identity()]
    for i, (kind, x, y, heading) in enumerate(
        [("sedan", 1.5, 14, 175), ("estate", -3.5, 12, 60), ("van", 4.5, 22, 200)]
    ):
        items.append(Item(make_vehicle(kind, rng), 2 + i))
        poses.append(Pose(vehicle_rotation(np.deg2rad(heading)), np.array([x, y, 0.0])))
    return items, poses


def ours(items: list[Item], poses: list[Pose]) -> Callable[[], object]:
    renderer = Renderer(items)
    camera = Camera.simple(SIZE, FOCAL_PX)
    return lambda: renderer.render(camera, T_WC, poses, frozenset({"color"}))


def stock(items: list[Item], poses: list[Pose]) -> Callable[[], object]:
    """pyrender as it comes. To be called after `ours`, which chooses the platform. Textures as glTF base colours."""
    import pyrender
    from trimesh.transformations import rotation_matrix

    scene = pyrender.Scene(ambient_light=np.full(3, 0.4), bg_color=np.full(3, 0.7))
    for item, pose in zip(items, poses, strict=True):
        primitives = []
        for s in item.model.levels[0]:
            texture = None if s.texture is None else pyrender.Texture(source=s.texture, source_channels="RGB")
            material = pyrender.MetallicRoughnessMaterial(
                metallicFactor=0.1, roughnessFactor=0.6, baseColorTexture=texture
            )
            color = np.column_stack([s.color, np.ones(len(s.color))]).astype(np.float32)
            primitives.append(
                pyrender.Primitive(
                    s.vertices, s.normals, texcoord_0=s.uv, color_0=color, indices=s.faces, material=material
                )
            )
        mesh = pyrender.Mesh(primitives)
        corners = np.concatenate([s.vertices for s in item.model.levels[0]])
        mesh._bounds = np.array([corners.min(axis=0), corners.max(axis=0)])  # its own computation fails with numpy 2
        scene.add(mesh, pose=pose.matrix())
    z = TO_SUN / np.linalg.norm(TO_SUN)
    x = np.cross([0.0, 0, 1], z) / np.linalg.norm(np.cross([0.0, 0, 1], z))
    sun = np.eye(4)
    sun[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    scene.add(pyrender.DirectionalLight(intensity=3.0), pose=sun)
    eye = T_WC.matrix() @ rotation_matrix(np.pi, [1, 0, 0])
    scene.add(pyrender.IntrinsicsCamera(FOCAL_PX, FOCAL_PX, SIZE[0] / 2, SIZE[1] / 2, znear=0.5, zfar=250.0), pose=eye)
    renderer = pyrender.OffscreenRenderer(*SIZE)
    return lambda: renderer.render(scene, flags=pyrender.RenderFlags.SHADOWS_DIRECTIONAL)


def street(repeats: int) -> Array:
    """Seconds of a view (colour, depth, instance; left and right share the shadows) in frames spread over the run."""
    scenario = spec.read("oncoming")
    world = build_world(scenario)
    road_light = Light.daylight(scenario.world.sun_azimuth_deg, scenario.world.sun_elevation_deg)
    with Renderer(footage.items(world), road_light) as renderer:

        def pair(t: float) -> object:
            return renderer.render_stereo(world.rig, world.T_wc(t), footage.item_poses(world, t))

        times = np.linspace(0, world.t_s[-1], repeats + 1)
        pair(times[0])
        return np.array([seconds(partial(pair, t)) / 2 for t in times[1:]])


def seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=15)
    repeats = parser.parse_args().repeats
    items, poses = three_cars()
    pair = ours(items, poses), stock(items, poses)
    for call in pair * 2:
        call()
    t = np.array([[seconds(call) for call in pair] for _ in range(repeats)]) * 1000
    triangles = sum(len(s.faces) for i in items for s in i.model.levels[0])
    print(f"{platform.machine()}, {triangles} triangles, {SIZE[0]} x {SIZE[1]}, {repeats} alternating runs")
    print(f"ours, 2x, shadows      {np.median(t[:, 0]):7.1f} ms")
    print(f"stock, MSAA, shadows   {np.median(t[:, 1]):7.1f} ms")
    print(f"median ratio           {np.median(t[:, 0] / t[:, 1]):7.2f}")
    print(f"a view of the street   {np.median(street(repeats)) * 1000:7.1f} ms")


if __name__ == "__main__":
    main()
