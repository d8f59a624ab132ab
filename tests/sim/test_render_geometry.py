"""The renderer's plain geometry, without images: levels of detail, culling, chunks, light boxes, sky."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from sim.camera import Camera
from sim.model import Model, Surface
from sim.pose import R_WORLD_FROM_LEVEL_CAMERA, Pose, exp_so3
from sim.render import Item, Light, RendererUnavailable, context, optical_flow
from sim.render.chunks import chunks
from sim.render.lens import Lens
from sim.render.light import sky_direction, sky_picture
from sim.render.placement import Inventory, Placement, batches, inventory, outside, place
from sim.render.view import Eye, fit_light_box

Array = np.ndarray
CAMERA = Camera.simple((320, 240), 300.0)
LEVEL = Pose(R_WORLD_FROM_LEVEL_CAMERA, np.array([0.0, 0.0, 1.0]))
UP = np.array([0.0, 0.0, 1.0])


def ball(radius: float, subdivisions: int) -> Surface:
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    n = len(mesh.vertices)
    normals = np.array(mesh.vertices) / radius
    return Surface(np.array(mesh.vertices), np.array(mesh.faces), normals, np.full((n, 3), 0.5), np.zeros(n))


def as_model(levels: tuple[tuple[Surface, ...], ...], switch_m: tuple[float, ...] = ()) -> Model:
    s = levels[0][0]
    return Model("test", levels, switch_m, s.vertices, s.faces, (1.0, 1.0, 1.0))


def standing(*places: tuple[float, float]) -> list[Pose]:
    return [Pose(np.eye(3), np.array([x, y, 1.0])) for x, y in places]


def homogeneous(corners: Array) -> Array:
    return np.asarray(np.concatenate([corners, np.ones((*corners.shape[:-1], 1))], axis=-1))


def seen_rows(inv: Inventory, placement: Placement, T_wc: Pose = LEVEL) -> Array:
    eye = Eye.at(CAMERA, T_wc, placement.anchor, placement.corners)
    return np.asarray(inv.item[placement.rows[~outside(homogeneous(placement.corners) @ eye.clip_from_anchor.T)]])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"normals": np.zeros((42, 3))}, "normals"),
        ({"vertices": np.full((42, 3), np.nan)}, "finite"),
        ({"faces": np.array([[0, 1, 42]])}, "faces"),
        ({"texture": np.zeros((4, 4, 3), np.uint8)}, "uv"),
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)
def test_broken_surfaces_are_refused(change: dict[str, Array], message: str) -> None:
    with pytest.raises(ValueError, match=f"Model test: .*{message}"):
        inventory([Item(as_model(((replace(ball(1.0, 1), **change),),)), 1)])  # type: ignore[arg-type]  # by name


def test_level_of_detail_follows_the_distance() -> None:
    model = as_model(tuple((ball(1.0, k),) for k in (3, 2, 1)), (20.0, 60.0))
    items = [Item(model, 1), Item(model, 1), Item(model, 2)]
    inv = inventory(items)
    placement = place(inv, standing((0, 21.6), (0, 21.8), (0, 61.8)), LEVEL.t)  # 20 m and the box's sqrt(3) m
    assert len(inv.surfaces) == 3  # shared by the three items
    np.testing.assert_array_equal(inv.level[placement.rows], [0, 1, 2])


def test_items_that_share_a_surface_are_one_draw_call_in_order_of_distance() -> None:
    model = as_model(((ball(1.0, 1),),))
    inv = inventory([Item(model, 5), Item(model, 6), Item(as_model(((ball(0.5, 1),),)), 7)])
    placement = place(inv, standing((0, 30), (0, 20), (0, 10)), LEVEL.t)
    calls = batches(inv, placement, np.ones(3, bool), np.array([30.0, 20.0, 10.0]))
    assert [call.instance.tolist() for call in calls] == [[7], [6, 5]]
    assert calls[1].T_anchor_items[:, 1, 3].tolist() == [20.0, 30.0]


def test_what_is_beside_or_behind_the_camera_is_not_drawn() -> None:
    model = as_model(((ball(1.0, 2),),))
    inv = inventory([Item(model, 1)] * 5)
    half_width = 10 * 160 / 300
    where = standing((0, 10), (0, -10), (half_width + 3, 10), (half_width + 0.5, 10), (-500, 1000))
    assert seen_rows(inv, place(inv, where, LEVEL.t)).tolist() == [0, 3, 4]


def test_single_precision_loses_nothing_far_from_the_origin() -> None:
    inv = inventory([Item(as_model(((ball(1.0, 1),),)), 1)])
    far = np.array([5e5, 5.4e6, 300.0])
    placement = place(inv, [Pose(np.eye(3), far + np.array([0.1234567, 10, 0]))], far)
    eye = Eye.at(CAMERA, Pose(LEVEL.R, far), placement.anchor, placement.corners)
    p = placement.T_anchor_items[0].astype(np.float32)[:3, 3] - eye.center.astype(np.float32)
    np.testing.assert_allclose(p, [0.1234567, 10, 0], rtol=0, atol=1e-6)


def test_chunks_are_the_surface_in_parts() -> None:
    plane = trimesh.creation.box((200.0, 200.0, 1.0)).subdivide_to_size(4.0)
    n = len(plane.vertices)
    whole = Surface(
        np.array(plane.vertices),
        np.array(plane.faces),
        np.tile(UP, (n, 1)),
        np.random.default_rng(0).random((n, 3)),
        np.zeros(n),
    )
    parts = chunks(whole)
    assert 9 <= len(parts) <= 64
    assert max(np.ptp(p.vertices[:, :2], axis=0).max() for p in parts) < 50
    triangles = np.concatenate([np.concatenate([p.vertices, p.color], axis=1)[p.faces].reshape(-1, 18) for p in parts])
    expected = np.concatenate([whole.vertices, whole.color], axis=1)[whole.faces].reshape(-1, 18)
    np.testing.assert_array_equal(np.unique(triangles, axis=0), np.unique(expected, axis=0))
    assert len(triangles) == len(expected)


def test_light_box_holds_the_casters_that_are_seen_and_no_more() -> None:
    model = as_model(((ball(1.0, 2),),))
    inv = inventory([Item(model, 1)] * 3)
    placement = place(inv, standing((0, 10), (2, 14), (0, -80)), LEVEL.t)
    eye = Eye.at(CAMERA, LEVEL, placement.anchor, placement.corners)
    fitted = fit_light_box(UP, [eye], placement.corners, np.ones(3, bool), 100.0)
    assert fitted is not None
    clip, width_m = fitted
    corners = homogeneous(placement.corners) @ clip.T
    assert np.abs(corners[:2]).max() <= 1.0
    assert np.abs(corners[2]).max() > 1.0
    assert 6.0 < width_m < 9.0
    assert fit_light_box(UP, [eye], placement.corners, np.zeros(3, bool), 100.0) is None


def test_sky_picture_holds_each_direction_where_the_shaders_look_for_it() -> None:
    size = 64
    v, u = (np.indices((size, size)) + 0.5) / size
    inside = np.hypot(2 * u - 1, 2 * v - 1) < 0.95
    d = sky_direction(size)[inside]
    np.testing.assert_allclose(np.linalg.norm(d, axis=-1), 1.0, atol=1e-12)
    uv = 0.5 + 0.5 * d[:, :2] / np.sqrt(2 * (1 + d[:, 2:]))
    np.testing.assert_allclose(uv, np.stack([u, v], axis=-1)[inside], atol=1e-12)


def test_sky_is_brightest_at_the_sun_and_repeats_with_the_seed() -> None:
    light = Light.daylight(azimuth_deg=30.0, elevation_deg=50.0, clouds=0.0)
    picture = sky_picture(light, 256)
    at = np.unravel_index(picture.sum(axis=-1).argmax(), picture.shape[:2])
    assert sky_direction(256)[at] @ light.to_sun > np.cos(np.deg2rad(3))
    cloudy = [sky_picture(Light.daylight(clouds=0.6, seed=s), 64) for s in (1, 1, 2)]
    np.testing.assert_array_equal(cloudy[0], cloudy[1])
    assert np.abs(cloudy[0] - cloudy[2]).max() > 0.1


def test_lens_leads_every_pixel_to_its_place_in_the_ideal_image() -> None:
    camera = Camera(CAMERA.K, CAMERA.size_px, np.array([-0.3, 0.1, 1e-3, -5e-4, 0.0]))
    lens = Lens.of(camera, 2)
    rng = np.random.default_rng(0)
    for u, v in rng.integers(0, [320, 240], (20, 2)):
        ideal = (lens.centers[v, u].astype(float) + 0.5) / 2 - 0.5
        seen = camera.project(np.append(lens.ideal.normalise(ideal), 1.0))
        np.testing.assert_allclose(seen, [u, v], rtol=0, atol=1e-3)  # float32 of fine pixels
    lo, hi = lens.subpixels.min(axis=(0, 1)), lens.subpixels.max(axis=(0, 1))
    assert lo.min() >= 0
    assert (hi < 2 * np.array(lens.ideal.size_px)).all()


def test_flow_refuses_parts_of_one_instance_that_drift_apart() -> None:
    depth, mask = np.full((240, 320), 5.0, np.float32), np.ones((240, 320), np.uint16)
    still = [Pose.identity(), Pose.identity()]
    moved = [Pose.identity(), Pose(exp_so3(np.zeros(3)), np.array([0.1, 0, 0]))]
    with pytest.raises(ValueError, match="share instance 1"):
        optical_flow(depth, mask, CAMERA, LEVEL, LEVEL, still, moved, [1, 1])
    with pytest.raises(ValueError, match="holds 1"):
        optical_flow(depth, mask, CAMERA, LEVEL, LEVEL, still, moved, [2, 3])


def test_missing_opengl_is_one_message_that_names_the_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)
    monkeypatch.setattr(context, "_loads", lambda *_: False)
    with pytest.raises(RendererUnavailable, match=r"libegl1.*libgl1-mesa-dri"):
        context._choose_platform()


@pytest.mark.parametrize(("sun", "message"), [([0.0, 0, 2], "unit"), ([0.0, 0.6, -0.8], "horizon")])
def test_impossible_light_is_refused(sun: list[float], message: str) -> None:
    white = np.ones(3)
    with pytest.raises(ValueError, match=message):
        Light(np.array(sun), white, white, white, white)
