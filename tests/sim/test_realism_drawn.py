"""Disturbances that are drawn with the world: mirrored surroundings, shadow edges, motion blur, passing cars."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh

from scenarios.footage import exposed, item_poses, items, views
from sim.camera import Camera
from sim.model import Model, Surface
from sim.pose import R_WORLD_FROM_LEVEL_CAMERA, Pose
from sim.realism.passing import Driver, passing_cars
from sim.realism.tone import to_light
from sim.render import PRODUCTS, Item, Light, Renderer, View, mean_light, moments, motion_px
from sim.render.surroundings import shade_axes, shade_pattern, town_plan
from sim.scenario import Scenario, ScenarioError
from sim.sensor import Sensor, expose
from sim.simulate import look
from sim.streams import stream
from sim.world import World, build_world

Array = np.ndarray
CAMERA = Camera.simple((480, 320), 500.0)
T_WC = Pose(R_WORLD_FROM_LEVEL_CAMERA, np.array([0.0, 0.0, 1.2]))
CROSSING: dict[str, Any] = {
    "name": "target",
    "mesh": "sedan",
    "color": "red",
    "motion": {"kind": "crossing", "distance_m": 16.0, "speed_mps": 12.0},
}


def long_wall(gloss: float) -> Model:
    """A plain wall of 60 m across the view, 4 m high, its face at y = 0."""
    mesh = trimesh.creation.box((60.0, 1.0, 4.0))
    mesh.unmerge_vertices()
    n = len(mesh.vertices)
    v, f = np.array(mesh.vertices) + np.array([0, 0.5, 2.0]), np.array(mesh.faces)
    surface = Surface(v, f, np.array(mesh.vertex_normals), np.full((n, 3), 0.4), np.full(n, gloss))
    return Model("wall", ((surface,),), (), v, f, (60.0, 1.0, 4.0))


def sunlight(mirrors: float = 0.0, shade: float = 0.0) -> Light:
    return Light.daylight(215.0, 35.0, mirrors=mirrors, shade=shade)


def drawn(light: Light, gloss: float, x: float, eye: float = 0.0, camera: Camera = CAMERA) -> View:
    poses = [Pose(np.eye(3), np.array([x, 14.0, 0.0]))]
    with Renderer([Item(long_wall(gloss), 1)], light) as renderer:
        return renderer.render(camera, Pose(T_WC.R, T_WC.t + np.array([eye, 0, 0])), poses)


def color(view: View) -> Array:
    assert view.color is not None
    return view.color.astype(float)


def shows(view: View, *instances: int) -> Array:
    """Pixels (h, w) of instances, 0 or 1."""
    assert view.instance is not None
    return np.isin(view.instance, instances).astype(np.uint8)


def assert_same_truth(a: View, b: View) -> None:
    np.testing.assert_array_equal(a.depth, b.depth)
    np.testing.assert_array_equal(a.instance, b.instance)


@pytest.mark.parametrize(("key", "gloss"), [("mirrors", 0.06), ("shade", 0.0)])
def test_what_is_mirrored_and_what_shades_stands_still_while_the_wall_moves_along_itself(
    key: str, gloss: float
) -> None:
    plain = drawn(sunlight(), gloss, 0.0)
    light = sunlight(**{key: 1.0})
    first, moved = drawn(light, gloss, 0.0), drawn(light, gloss, 0.8)
    assert_same_truth(plain, first)
    on_wall = cv2.erode(shows(first, 1), np.ones((9, 9))).astype(bool)
    assert on_wall.mean() > 0.25
    seen = color(first)[on_wall].mean(axis=1)
    assert np.std(seen) > 4 * np.std(color(plain)[on_wall].mean(axis=1))  # the wall itself is plain
    # The wall slides by 29 px under it; single precision and the shadow map leave a grey level.
    assert np.abs(color(moved) - color(first))[on_wall].max() <= 2


def test_shadow_edges_are_fixed_to_the_surface_for_both_cameras_and_reflections_are_not() -> None:
    """From 0.28 m aside, a disparity of 10 px on the wall: shadows have it, what is mirrored lies behind the wall."""
    changed = {}
    for key, gloss in (("mirrors", 0.06), ("shade", 0.0)):
        light = sunlight(**{key: 1.0})
        left, right = (color(drawn(light, gloss, 0.0, eye))[140:180, 60:420] for eye in (0.0, 0.28))
        changed[key] = float(np.abs(left[:, 10:] - right[:, :-10]).mean() / np.std(left))
    assert changed["shade"] < 0.1
    assert changed["mirrors"] > 0.2


def test_reflections_leave_matt_surfaces_alone() -> None:
    plain, mirroring = (drawn(sunlight(mirrors=x), 0.0, 0.0) for x in (0.0, 1.0))
    np.testing.assert_array_equal(plain.color, mirroring.color)


def test_a_level_of_shade_hides_its_share_of_the_sun() -> None:
    """Between no and full shade the light, not the grey value, is linear in the level."""
    light = [to_light(np.asarray(drawn(sunlight(shade=x), 0.0, 0.0).color)) for x in (0.0, 0.5, 1.0)]
    deep = (light[0] - light[2]).mean(axis=2) > 0.25 * light[0].mean()
    assert deep.mean() > 0.02
    half = (light[0] - light[1])[deep] / (light[0] - light[2])[deep]
    assert abs(np.median(half) - 0.5) < 0.02


@pytest.mark.parametrize("elevation", [0.2, 0.9, np.pi / 2])
def test_all_points_of_a_sun_ray_have_the_same_shade(elevation: float) -> None:
    to_sun = np.array([0.6 * np.cos(elevation), -0.8 * np.cos(elevation), np.sin(elevation)])
    p = np.array([3.0, -7.0, 0.4])
    np.testing.assert_allclose(shade_axes(to_sun) @ (p + 5.0 * to_sun), shade_axes(to_sun) @ p, atol=1e-9)


def test_patterns_are_seamless_and_neither_empty_nor_full() -> None:
    shade, town = shade_pattern(stream(0, 0, "x")), town_plan(stream(0, 0, "x"))
    assert 0.2 < shade.mean() < 0.6
    assert 0.2 < (town[..., 0] > 2).mean() < 0.8
    for axis in (0, 1):
        inner = np.abs(np.diff(shade[..., 0], axis=axis)).mean()
        seam = np.abs(np.take(shade[..., 0], 0, axis) - np.take(shade[..., 0], -1, axis)).mean()
        assert seam < 4 * inner


@pytest.fixture(scope="module")
def make(make_scenario: Callable[..., Scenario]) -> Callable[..., Scenario]:
    def build(**realism: Any) -> Scenario:
        return make_scenario(
            rig={"size_px": (400, 300), "focal_px": 400.0, "frames": 3},
            render={"enabled": True},
            vehicle=[CROSSING],
            realism=realism,
        )

    return build


def shown(scenario: Scenario) -> tuple[World, list[tuple[View, View]]]:
    world = build_world(scenario)
    return world, list(views(scenario, world, PRODUCTS))


def test_off_is_bit_identical_to_drawing_and_exposing_without_any_of_it(make: Callable[..., Scenario]) -> None:
    scenario = make()
    world, pairs = shown(scenario)
    road = scenario.world
    with Renderer(items(world), Light.daylight(road.sun_azimuth_deg, road.sun_elevation_deg)) as renderer:
        for k, t in enumerate(world.t_s):
            direct = renderer.render_stereo(world.rig, world.T_wc(t), item_poses(world, t))
            for side, a, b, image in zip(
                ("left", "right"), pairs[k], direct, exposed(scenario, world, k, pairs[k]), strict=True
            ):
                np.testing.assert_array_equal(a.color, b.color)
                assert_same_truth(a, b)
                assert b.color is not None
                sensor = expose(b.color, Sensor(), stream(scenario.seed, 0, f"camera/{side}/sensor/{k}"))
                np.testing.assert_array_equal(image, sensor)


def test_motion_blurs_along_the_motion_only_and_the_truth_is_that_of_the_middle(make: Callable[..., Scenario]) -> None:
    (world, sharp), (_, blurred) = shown(make()), shown(make(exposure_ms=30.0))
    a, b = sharp[1][0], blurred[1][0]
    assert_same_truth(a, b)
    car = cv2.erode(shows(a, 2), np.ones((5, 5))).astype(bool)
    away = cv2.dilate(shows(a, 2), np.ones((3, 41))) == 0
    np.testing.assert_array_equal(color(a)[away], color(b)[away])
    # 12 m/s for 30 ms at 16 m: 9 px of motion to the right.
    along, across = (
        np.abs(np.diff(color(b), axis=axis)).mean(axis=2)[:299, :399][car[:299, :399]].mean()
        / np.abs(np.diff(color(a), axis=axis)).mean(axis=2)[:299, :399][car[:299, :399]].mean()
        for axis in (1, 0)
    )
    assert along < 0.6
    assert across > 0.75
    assert along < 0.75 * across
    # The mean place of the car's light does not move.
    weight = [255.0 - color(v)[..., 1:].mean(axis=2) for v in (a, b)]
    around = cv2.dilate(shows(a, 2), np.ones((3, 41))) > 0
    u = np.broadcast_to(np.arange(400), (300, 400))
    centre = [np.sum((u * w)[around]) / np.sum(w[around]) for w in weight]
    assert abs(centre[0] - centre[1]) < 0.5
    ends = world.t_s[1] - 0.015, world.t_s[1] + 0.015
    poses = item_poses(world, ends[0]), item_poses(world, ends[1])
    T_wc = world.T_wc(ends[0]), world.T_wc(ends[1])
    assert 7.5 < motion_px(a, world.rig.left, T_wc, poses, [i.instance for i in items(world)]) < 11


def test_moments_are_even_odd_in_number_and_a_pixel_apart_at_most() -> None:
    assert moments(0.0).tolist() == moments(0.4).tolist() == [0.0]
    for px in (0.6, 1.0, 2.0, 5.5, 13.9):
        at = moments(px)
        assert len(at) % 2 == 1
        assert at[len(at) // 2] == 0
        np.testing.assert_allclose(np.diff(at), 1 / len(at))
        assert px / len(at) <= 1.0
    assert len(moments(500.0)) == 15


def test_an_exposure_gathers_light_not_grey_values() -> None:
    dark, bright = (np.full((2, 2, 3), grey, np.uint8) for grey in (0, 200))
    mean = mean_light([dark, bright])
    np.testing.assert_allclose(to_light(mean), to_light(bright) / 2, rtol=0.02)
    assert mean[0, 0, 0] > 110


def test_passing_cars_hide_the_target_in_images_and_measurements_alike(make_scenario: Callable[..., Scenario]) -> None:
    def build(n: int) -> Scenario:
        far = {"kind": "straight", "start_m": [-1.0, 34.0], "heading_deg": 180.0, "speed_mps": 5.0}
        return make_scenario(
            rig={"size_px": (400, 300), "focal_px": 400.0, "frames": 40},
            render={"enabled": True},
            vehicle=[{"name": "target", "mesh": "sedan", "motion": far}],
            realism={"occluders": n},
        )

    worlds = [build_world(build(n)) for n in (0, 2)]
    seen = [look(build(n), w).seen.sum(axis=1) for n, w in zip((0, 2), worlds, strict=True)]
    assert [len(w.actors) for w in worlds] == [1, 3]
    assert np.all(seen[1] <= seen[0])
    hidden = np.flatnonzero(seen[1] < 0.3 * seen[0])
    assert np.any(hidden < 20)
    assert np.any(hidden >= 20)
    assert np.any(seen[1] == seen[0])
    k = int(hidden[len(hidden) // 2])
    world = worlds[1]
    with Renderer(items(world)) as renderer:
        view = renderer.render_stereo(
            world.rig, world.T_wc(world.t_s[k]), item_poses(world, world.t_s[k]), frozenset({"depth", "instance"})
        )[0]
    with Renderer(items(worlds[0])) as renderer:
        free = renderer.render_stereo(
            world.rig, world.T_wc(world.t_s[k]), item_poses(worlds[0], world.t_s[k]), frozenset({"depth", "instance"})
        )[0]
    assert view.depth is not None
    assert free.depth is not None
    target = shows(free, 2) > 0
    passing = target & (shows(view, 3, 4) > 0)
    assert passing.sum() > 0.5 * target.sum()
    assert np.all(view.depth[passing] < free.depth[passing])


def test_passing_cars_are_the_same_again_and_refused_where_there_is_no_room(scenario: Scenario, world: World) -> None:
    cars = [Driver(a.name, a.model, a.trajectory) for a in world.actors]
    T_wc = world.T_wc(world.t_s)
    one, two = (passing_cars(1, cars, 0, T_wc, world.t_s, scenario.seed) for _ in range(2))
    np.testing.assert_array_equal(one[0].trajectory.T_wb.t, two[0].trajectory.T_wb.t)
    assert passing_cars(0, cars, 0, T_wc, world.t_s, 1) == []
    with pytest.raises(ScenarioError, match=r"^realism\.occluders: no room for 20 cars"):
        passing_cars(20, cars, 0, T_wc, world.t_s, scenario.seed)


@pytest.mark.parametrize(
    ("realism", "message"),
    [
        ({"rain": 1.5}, "rain"),
        ({"glare": -0.1}, "glare"),
        ({"wiper_s": 0.5}, "should be 0 or at least 0.8"),
        ({"exposure_ms": 41.0}, "a frame lasts 40 ms"),
        ({"occluders": 21}, "occluders"),
        ({"fog": 1.0}, "fog"),
    ],
    ids=lambda x: str(x)[:20],
)
def test_impossible_levels_are_refused(
    make_scenario: Callable[..., Scenario], realism: dict[str, float], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        make_scenario(realism=realism)
