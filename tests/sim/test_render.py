"""The rendered images against independent oracles: outlines of markers, ray casting, points moved by hand."""

from __future__ import annotations

import resource
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.ndimage import binary_erosion, label, maximum_filter, minimum_filter
from trimesh.ray.ray_pyembree import RayMeshIntersector

from sim.camera import Camera, StereoRig
from sim.meshes import make_vehicle
from sim.model import Model, Surface
from sim.pose import R_WORLD_FROM_LEVEL_CAMERA, Pose, exp_so3, vehicle_rotation
from sim.render import Item, Light, Renderer, View, optical_flow
from sim.streams import stream

Array = np.ndarray
SIZE = (640, 480)
CAMERA = Camera.simple(SIZE, 620.0)
SKEWED = Camera(np.array([[630.0, 1.5, 300.0], [0, 610.0, 250.0], [0, 0, 1]]), SIZE)
DISTORTED = Camera(CAMERA.K, SIZE, np.array([-0.28, 0.09, 4e-4, -3e-4, -0.01]))
RIG = StereoRig(CAMERA, SKEWED, Pose(exp_so3(np.array([0.01, -0.02, 0.03])), np.array([-0.4, 0.01, -0.02])))
NEIGHBOURS = np.ones((3, 3), bool)
FLAT_LIGHT = Light.daylight(strength=0.0, clouds=0.0, haze_m=np.inf, shadows=False)


def level_camera(x: float = 0.0, y: float = 0.0, z: float = 1.2, turn: tuple[float, float, float] = (0, 0, 0)) -> Pose:
    """T_wc: level and looking along +y, then turned by a rotation vector [rad] in its own frame."""
    return Pose(R_WORLD_FROM_LEVEL_CAMERA @ exp_so3(np.array(turn, float)), np.array([x, y, z]))


def as_model(mesh: trimesh.Trimesh, color: float = 0.5, gloss: float = 0.0) -> Model:
    n = len(mesh.vertices)
    v, f = np.array(mesh.vertices), np.array(mesh.faces)
    surface = Surface(v, f, np.array(mesh.vertex_normals), np.full((n, 3), color), np.full(n, gloss))
    size = np.ptp(v, axis=0)
    return Model("test", ((surface,),), (), v, f, (float(size[0]), float(size[1]), float(size[2])))


def box(*size: float, color: float = 0.5, gloss: float = 0.0) -> Model:
    mesh = trimesh.creation.box(size)
    mesh.unmerge_vertices()  # flat faces
    return as_model(mesh, color, gloss)


@pytest.fixture(scope="module")
def street() -> tuple[list[Item], list[Pose]]:
    """Ground, two items that share instance 1, two boxes and a shining ball."""
    ball = as_model(trimesh.creation.icosphere(3, 0.8), 0.4, gloss=0.1)
    items = [
        Item(box(400, 400, 1), 1),
        Item(box(2, 12, 5), 1),
        Item(box(4, 1.8, 1.4), 2),
        Item(box(2, 3, 2), 700),
        Item(ball, 65535),
    ]
    poses = [
        Pose(np.eye(3), np.array([0, 0, -0.5])),
        Pose(np.eye(3), np.array([-8, 22, 2.5])),
        Pose(exp_so3(np.array([0, 0, 0.5])), np.array([2.2, 14, 0.9])),
        Pose(exp_so3(np.array([0.1, 0.2, -0.9])), np.array([-2, 9, 1.3])),
        Pose(np.eye(3), np.array([0.9, 7, 0.8])),
    ]
    return items, poses


@pytest.fixture(scope="module")
def markers() -> tuple[list[Item], list[Pose], Array]:
    """A white wall with dark tilted discs before it, and the discs' outlines (n, 64, 3) in the world."""
    rng = np.random.default_rng(3)
    angle = np.arange(64) * (2 * np.pi / 64)
    rim = np.column_stack([np.cos(angle), np.zeros(64), np.sin(angle)]) * 0.24
    disc = trimesh.Trimesh(np.vstack([rim, [[0, 0, 0]]]), [[i, (i + 1) % 64, 64] for i in range(64)], process=False)
    items, poses = [Item(box(60, 1, 60), 1)], [Pose(np.eye(3), np.array([0, 16.0, 0]))]
    dark = as_model(disc, 0.02)
    for u in np.arange(40, 630, 66):
        for v in np.arange(40, 470, 66):
            p_c = CAMERA.unproject(np.array([u, v]) + rng.uniform(-8, 8, 2), np.array(rng.uniform(9, 13)))
            items.append(Item(dark, 2))
            poses.append(Pose(exp_so3(rng.normal(0, 0.15, 3)), level_camera().apply(p_c)))
    outlines = np.stack([p.apply(rim) for p in poses[1:]])
    return items, poses, outlines


def polygon_centroid(outline: Array) -> Array:
    """Area centroid (n, 2) of polygons (n, k, 2)."""
    a, b = outline, np.roll(outline, -1, axis=1)
    cross = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return np.asarray(((a + b) * cross[..., None]).sum(axis=1) / (3 * cross.sum(axis=1))[:, None])


def blob_centroids(image: Array) -> Array:
    """Grey-value centroids (n, 2) of the dark blobs on a bright image that do not touch its border."""
    grey = image.astype(float).mean(axis=-1)
    weight = np.clip(np.median(grey) - grey, 0, None)
    labels, n = label(weight > 0)
    border = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    v, u = np.indices(grey.shape)
    total = np.bincount(labels.ravel(), weight.ravel(), n + 1)
    inner = np.setdiff1d(np.arange(1, n + 1), border)
    return np.stack(
        [np.bincount(labels.ravel(), (weight * c).ravel(), n + 1)[inner] / total[inner] for c in (u, v)], axis=-1
    )


def check_markers(view: View, camera: Camera, T_wc: Pose, outlines: Array) -> None:
    assert view.color is not None
    expected = polygon_centroid(camera.project(T_wc.inv().apply(outlines)))
    found = blob_centroids(view.color)
    error = found[:, None] - expected[None]
    nearest = np.linalg.norm(error, axis=-1).argmin(axis=1)
    error = error[np.arange(len(found)), nearest]
    assert len(found) > 45
    assert np.abs(error).max() < 0.5  # every blob is a marker
    assert np.sqrt(np.mean(error**2)) < 0.02
    assert np.abs(error.mean(axis=0)).max() < 0.01


def test_marker_centroids_agree_with_projection_in_both_cameras(markers: tuple[list[Item], list[Pose], Array]) -> None:
    items, poses, outlines = markers
    T_wc = level_camera()
    with Renderer(items, FLAT_LIGHT) as renderer:
        left, right = renderer.render_stereo(RIG, T_wc, poses)
        check_markers(left, RIG.left, T_wc, outlines)
        check_markers(right, RIG.right, T_wc @ RIG.T_rl.inv(), outlines)


def test_marker_centroids_agree_with_projection_through_a_distorting_lens(
    markers: tuple[list[Item], list[Pose], Array],
) -> None:
    items, poses, outlines = markers
    with Renderer(items, FLAT_LIGHT) as renderer:
        check_markers(renderer.render(DISTORTED, level_camera(), poses), DISTORTED, level_camera(), outlines)


def cast_rays(items: list[Item], poses: list[Pose], camera: Camera, T_wc: Pose) -> tuple[Array, Array, Array]:
    """Depth, instance, item (h, w) at the pixel centres; depth from the plane of the triangle that was hit."""
    meshes = [
        trimesh.Trimesh(p.apply(i.model.solid_vertices), i.model.solid_faces, process=False)
        for i, p in zip(items, poses, strict=True)
    ]
    owner = np.repeat(np.arange(len(items)), [len(m.faces) for m in meshes])
    scene = trimesh.util.concatenate(meshes)
    w, h = camera.size_px
    uv = np.stack(np.meshgrid(np.arange(float(w)), np.arange(float(h))), axis=-1).reshape(-1, 2)
    rays = camera.unproject(uv, np.ones(len(uv))) @ T_wc.R.T
    hit = RayMeshIntersector(scene).intersects_first(np.broadcast_to(T_wc.t, rays.shape), rays)
    normal, origin = scene.face_normals[hit], scene.triangles[hit, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.sum(normal * (origin - T_wc.t), axis=-1) / np.sum(normal * rays, axis=-1)
    item = np.where(hit >= 0, owner[hit], -1)
    instance = np.where(hit >= 0, np.array([i.instance for i in items])[owner[hit]], 0)
    return np.where(hit >= 0, depth, 0.0).reshape(h, w), instance.reshape(h, w), item.reshape(h, w)


@pytest.mark.parametrize(
    ("camera", "turn", "tolerance_px"),
    [(CAMERA, (0, 0, 0), 0.0), (SKEWED, (0.1, 0.3, 0.2), 0.0), (DISTORTED, (0.05, 0, 0), 0.36)],
    ids=["plain", "turned, with skew", "distorted"],
)
def test_depth_and_instance_agree_with_ray_casting(
    street: tuple[list[Item], list[Pose]], camera: Camera, turn: tuple[float, float, float], tolerance_px: float
) -> None:
    items, poses = street
    T_wc = level_camera(turn=turn)
    with Renderer(items) as renderer:
        view = renderer.render(camera, T_wc, poses, frozenset({"depth", "instance"}))
    assert view.color is None
    assert view.depth is not None
    assert view.instance is not None
    depth, instance, item = cast_rays(items, poses, camera, T_wc)
    inner = np.any([binary_erosion(item == i, NEIGHBOURS, border_value=1) for i in np.unique(item)], axis=0)
    # Distorted images take the nearest pixel of an ideal one at 2x: the depth may be that of 0.36 px away.
    slope = np.hypot(*np.gradient(depth))
    # 5e-6: single precision through three matrices.
    good = (np.abs(view.depth - depth) <= 5e-6 * depth + 1e-5 + 1.5 * tolerance_px * slope) & (
        view.instance == instance
    )
    assert good[inner].mean() > 0.999
    assert inner.mean() > 0.9


@pytest.mark.parametrize("kind", ["sedan", "van"])
def test_a_vehicle_is_drawn_where_its_measured_surface_is(kind: str) -> None:
    """The surface that carries the measured points, ray cast, against the drawn one, near and far."""
    model = make_vehicle(kind, stream(1, 0, kind))
    items = [Item(model, 7)]
    T_wc = level_camera()
    for distance, heading in ((12.0, 3.6), (30.0, 0.4)):
        poses = [Pose(vehicle_rotation(np.array(heading)), np.array([-1.0, distance, 0.0]))]
        with Renderer(items) as renderer:
            view = renderer.render(CAMERA, T_wc, poses, frozenset({"depth", "instance"}))
        assert view.depth is not None
        assert view.instance is not None
        depth, instance, _ = cast_rays(items, poses, CAMERA, T_wc)
        # Away from edges: the body's outline and where one part of it hides another.
        around = np.where(instance > 0, depth, 1e3)
        inner = (instance > 0) & (maximum_filter(around, 3) - minimum_filter(around, 3) < 0.1)
        good = (np.abs(view.depth - depth) <= 5e-6 * depth + 1e-5) & (view.instance == instance)
        assert inner.sum() > 150
        assert good[inner].mean() > 0.999
        assert np.all((view.instance == instance)[minimum_filter(instance, 3) == maximum_filter(instance, 3)])


def test_flow_agrees_with_moved_surface_points(street: tuple[list[Item], list[Pose]]) -> None:
    items, poses = street
    moved = list(poses)
    moved[2] = Pose(exp_so3(np.array([0, 0, 0.05])), np.array([0.3, -0.4, 0.0])) @ poses[2]
    moved[3] = Pose(poses[3].R, poses[3].t + np.array([0.2, 0.1, 0.05]))
    T_0, T_1 = level_camera(), level_camera(0.05, 0.6, 1.22, (0.01, -0.02, 0.015))
    with Renderer(items) as renderer:
        view = renderer.render(CAMERA, T_0, poses, frozenset({"depth", "instance"}))
    assert view.depth is not None
    assert view.instance is not None
    flow = optical_flow(view.depth, view.instance, CAMERA, T_0, T_1, poses, moved, [i.instance for i in items])
    depth, _, item = cast_rays(items, poses, CAMERA, T_0)
    uv = np.stack(np.meshgrid(np.arange(float(SIZE[0])), np.arange(float(SIZE[1]))), axis=-1)
    p_w = T_0.apply(CAMERA.unproject(uv, depth))
    for i, (start, end) in enumerate(zip(poses, moved, strict=True)):
        mask = binary_erosion(item == i, NEIGHBOURS)
        expected = CAMERA.project(T_1.inv().apply((end @ start.inv()).apply(p_w[mask]))) - uv[mask]
        assert mask.sum() > 500
        np.testing.assert_allclose(flow[mask], expected, rtol=0, atol=0.01)
    sky = view.instance == 0
    far = T_0.apply(CAMERA.unproject(uv[sky], np.full(sky.sum(), 1e9)))
    np.testing.assert_allclose(flow[sky], CAMERA.project(T_1.inv().apply(far)) - uv[sky], rtol=0, atol=0.01)


def test_images_are_reproducible_whatever_was_rendered_before(street: tuple[list[Item], list[Pose]]) -> None:
    items, poses = street
    with Renderer(items) as first, Renderer(items) as second:
        a = first.render(CAMERA, level_camera(), poses)
        second.render(CAMERA, level_camera(1, 5), poses[::-1])
        second.render(DISTORTED, level_camera(2, 0), poses)
        b = second.render(CAMERA, level_camera(), poses)
    for x, y in ((a.color, b.color), (a.depth, b.depth), (a.instance, b.instance)):
        assert x is not None
        assert y is not None
        np.testing.assert_array_equal(x, y)


def test_shadow_falls_away_from_the_sun_and_under_the_body(street: tuple[list[Item], list[Pose]]) -> None:
    items, poses = street
    light = Light.daylight(azimuth_deg=90.0, elevation_deg=45.0)
    down = Pose(np.diag([1.0, -1, -1]), np.array([0.0, 0, 20.0]))
    column = Pose(np.eye(3), np.array([0, 0, 1.0]))
    with Renderer([items[0], Item(box(2, 2, 2), 2)], light) as renderer:
        image = renderer.render(CAMERA, down, [poses[0], column]).color
    assert image is not None
    west, east, north = (image[v, u].astype(float).mean() for u, v in ((258, 240), (381, 240), (320, 180)))
    assert west < 0.85 * east
    assert abs(east - north) < 3


def test_sky_is_the_same_for_every_camera_and_in_a_mirror() -> None:
    light = Light.daylight(azimuth_deg=180.0, haze_m=np.inf, shadows=False, clouds=0.6)
    with Renderer([Item(box(4000, 4000, 1, color=0.0, gloss=1.0), 1)], light) as renderer:
        below = [Pose(np.eye(3), np.array([0, 0, -0.5]))]
        level = renderer.render(CAMERA, level_camera(), below, frozenset({"color"})).color
        turned = renderer.render(SKEWED, level_camera(turn=(0.1, 0.2, 0.1)), below, frozenset({"color"})).color
    assert level is not None
    assert turned is not None
    assert level[:200].std() > 5  # there are clouds to compare
    # 1.5: rounding and the interpolation of the sky's picture; the rows around the horizon show the mirror's end.
    assert np.abs(level[:200].astype(float) - level[:-201:-1]).max() <= 1.5
    u, v = np.meshgrid(np.arange(60.0, 580, 20), np.arange(40.0, 140, 10))
    d_w = level_camera(turn=(0.1, 0.2, 0.1)).R @ SKEWED.unproject(np.stack([u, v], -1), np.ones(u.shape))[..., None]
    uv = CAMERA.project((level_camera().R.T @ d_w)[..., 0])
    inside = CAMERA.contains(uv, 1.0) & (uv[..., 1] < 200)
    at = np.rint(uv[inside]).astype(int)
    difference = level[at[:, 1], at[:, 0]].astype(float) - turned[v[inside].astype(int), u[inside].astype(int)]
    assert inside.sum() > 50
    assert np.abs(difference).max() < 4  # up to 0.7 px apart


def test_memory_stays_flat_and_renderers_can_follow_each_other(street: tuple[list[Item], list[Pose]]) -> None:
    items, poses = street

    def resident_mb() -> float:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6

    small = Camera.simple((160, 120), 150.0)
    before = 0.0
    for cycle in range(12):
        with Renderer(items, supersample=1) as renderer:
            for k in range(4):
                renderer.render(small, level_camera(0.1 * k), poses)
        if cycle == 3:
            before = resident_mb()
    assert resident_mb() - before < 25  # one leaked sky or light map alone is 8 MB each, 8 cycles


def test_what_cannot_be_rendered_is_refused(street: tuple[list[Item], list[Pose]]) -> None:
    items, poses = street
    with pytest.raises(ValueError, match="instance"):
        Item(items[0].model, 0)
    with pytest.raises(ValueError, match="supersample"):
        Renderer(items, supersample=0)
    with Renderer(items) as renderer:
        with pytest.raises(ValueError, match="T_w_items: expected 5 poses"):
            renderer.render(CAMERA, level_camera(), poses[:3])
        with pytest.raises(ValueError, match="products"):
            renderer.render(CAMERA, level_camera(), poses, frozenset({"colour"}))
    with pytest.raises(ValueError, match="closed"):
        renderer.render(CAMERA, level_camera(), poses)
