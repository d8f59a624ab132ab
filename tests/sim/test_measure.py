"""Which points are measured when: visibility against ray casting, and the book-keeping of tracks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from trimesh.ray.ray_pyembree import RayMeshIntersector

from sim.measure import Pool, camera_poses, follow, make_pool, pixel_noise, project_points, scripted, visibility
from sim.meshes import point_grid
from sim.scenario import Event, Scenario
from sim.world import World, build_world

Array = np.ndarray

views = hnp.arrays(bool, st.tuples(st.integers(0, 12), st.integers(1, 10)))


@given(views, st.integers(1, 12))
def test_follow(seen: Array, capacity: int) -> None:
    rows = follow(seen, capacity)
    keys = list(zip(rows.frame.tolist(), rows.track.tolist(), strict=True))
    assert keys == sorted(set(keys))
    assert seen[rows.frame, rows.point].all()
    for k in range(len(seen)):
        now = rows.frame == k
        # As many as there is room for, and no point twice.
        assert np.count_nonzero(now) == min(capacity, np.count_nonzero(seen[k]))
        assert len(set(rows.point[now].tolist())) == np.count_nonzero(now)
    begins = []
    for t in np.unique(rows.track):
        life, point = rows.frame[rows.track == t], rows.point[rows.track == t]
        # One material point, without a pause, until it is lost.
        assert len(set(point.tolist())) == 1
        np.testing.assert_array_equal(life, np.arange(life[0], life[0] + len(life)))
        assert life[-1] == len(seen) - 1 or not seen[life[-1] + 1, point[0]]
        begins.append(life[0])
    # Numbered without gaps in order of birth.
    np.testing.assert_array_equal(np.unique(rows.track), np.arange(len(begins)))
    assert begins == sorted(begins)


def test_a_lost_track_is_replaced_and_does_not_resume() -> None:
    seen = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], bool)
    rows = follow(seen, 2)
    lives = {t: (rows.frame[rows.track == t].tolist(), rows.point[rows.track == t][0]) for t in range(4)}
    assert lives == {0: ([0, 1, 2], 0), 1: ([0], 1), 2: ([1, 2, 3], 2), 3: ([3], 1)}


def test_one_pixel_noise_for_every_point_and_frame() -> None:
    noise = pixel_noise(1, 0, "target", (30, 200))
    assert noise.shape == (30, 200, 4)
    # 6000 samples a column: 4.5 standard deviations of mean, variance and correlation.
    flat = noise.reshape(-1, 4)
    assert np.abs(flat.mean(axis=0)).max() < 4.5 / np.sqrt(6000)
    assert np.abs(flat.std(axis=0) - 1).max() < 4.5 / np.sqrt(2 * 6000)
    assert np.abs(np.corrcoef(flat.T) - np.eye(4)).max() < 4.5 / np.sqrt(6000)
    # More frames do not change the first ones.
    np.testing.assert_array_equal(pixel_noise(1, 0, "target", (40, 200))[:30], noise)


@pytest.fixture(scope="module")
def pool(world: World) -> Pool:
    return make_pool(world.actors[world.target], 120, np.random.default_rng(0))


def cast(world: World, who: int, pool: Pool) -> Array:
    """Which points both cameras see, by embree and the cosine of the surface alone."""
    seen = np.ones((len(world.t_s), len(pool.point_v)), bool)
    assert pool.normal_v is not None
    for k, t in enumerate(world.t_s):
        placed = [a.trajectory.pose(t).apply(a.model.solid_vertices)[a.model.solid_faces] for a in world.actors]
        triangles = np.concatenate(placed).reshape(-1, 3)
        mesh = trimesh.Trimesh(triangles, np.arange(len(triangles)).reshape(-1, 3), process=False)
        T_wv = world.actors[who].trajectory.pose(t)
        points, normals = T_wv.apply(pool.point_v), pool.normal_v @ T_wv.R.T
        for side, T_wc in enumerate(camera_poses(world)):
            rays = points - T_wc.t[k]
            length = np.linalg.norm(rays, axis=1)
            unit = rays / length[:, None]
            origins = np.broadcast_to(T_wc.t[k], rays.shape)
            where, ray, _ = RayMeshIntersector(mesh).intersects_location(origins, unit, multiple_hits=False)
            depth = np.full(len(points), np.inf)
            depth[ray] = np.linalg.norm(where - T_wc.t[k], axis=1)
            camera = (world.rig.left, world.rig.right)[side]
            uv = camera.project(T_wc[k].inv().apply(points))
            seen[k] &= (np.sum(unit * normals, axis=1) < -0.08) & (depth > length - 0.004) & camera.contains(uv, 1.0)
    return seen


def test_visibility_against_ray_casting(world: World, pool: Pool) -> None:
    _, seen = visibility(world, world.target, pool, occlusion=True)
    expected = cast(world, world.target, pool)
    # Edges of panels within embree's single precision and the gap of 4 mm.
    assert np.mean(seen != expected) < 0.002
    assert 0.1 < seen.mean() < 0.9


def test_another_vehicle_hides_the_target(make_scenario: Callable[..., Scenario], world: World, pool: Pool) -> None:
    vehicles = make_scenario().model_dump(mode="json", exclude_none=True)["vehicle"]
    vehicles[1]["motion"] = {"kind": "straight", "start_m": [-1.8, 8.0], "heading_deg": 90.0, "speed_mps": 3.0}
    crossed = build_world(make_scenario(vehicle=vehicles))
    _, seen = visibility(crossed, 0, pool, occlusion=True)
    assert np.mean(seen != cast(crossed, 0, pool)) < 0.002
    _, free = visibility(world, 0, pool, occlusion=True)
    _, transparent = visibility(crossed, 0, pool, occlusion=False)
    # It takes away and never gives; without occlusion everything that faces the cameras is seen.
    assert not (seen & ~free).any()
    assert np.count_nonzero(seen) < 0.8 * np.count_nonzero(free)
    assert not (free & ~transparent).any()


def test_pixels_are_those_of_the_rig(world: World, pool: Pool) -> None:
    uv, _ = visibility(world, world.target, pool, occlusion=False)
    T_wc, T_wr = camera_poses(world)
    T_wv = world.actors[world.target].trajectory.pose(world.t_s)
    np.testing.assert_allclose(project_points(world.rig, T_wc.inv() @ T_wv, pool.point_v), uv, atol=1e-9)
    # The right camera stands a base to the right.
    base = np.einsum("mba,mb->ma", T_wc.R, T_wr.t - T_wc.t)
    np.testing.assert_allclose(base, [[0.3, 0, 0]] * len(world.t_s), atol=1e-12)


def test_a_grid_of_points_is_transparent(world: World) -> None:
    grid = point_grid((1.0, 5.0, 1.25), (2, 10, 5))
    actor = replace(world.actors[0], model=grid)
    pool = make_pool(actor, 7, np.random.default_rng(0))
    np.testing.assert_array_equal(pool.point_v, grid.solid_vertices)
    _, seen = visibility(replace(world, actors=(actor,), target=0), 0, pool, occlusion=True)
    assert seen.all()


def test_scripted_births_and_deaths() -> None:
    # Four layers of six points a metre apart: the rearmost is born as the foremost dies.
    grid = Pool(point_grid((3.0, 1.0, 1.0), (4, 3, 2)).solid_vertices, None)
    events = [
        Event(kind="birth", frame=2, side="rear", depth_m=0.5),
        Event(kind="death", frame=2, side="front", depth_m=0.5),
    ]
    left = scripted(grid, events, 5)
    layer = np.searchsorted(np.unique(grid.point_v[:, 0]), grid.point_v[:, 0])
    expected = np.array([[k >= 2, True, True, k < 2] for k in range(5)])
    np.testing.assert_array_equal(left, expected[:, layer])
    # All room is taken all the time, and no track of the middle ends.
    rows = follow(left, 18)
    np.testing.assert_array_equal(np.bincount(rows.frame), 18)
    np.testing.assert_array_equal(np.sort(np.bincount(rows.track)), np.repeat([2, 3, 5], [6, 6, 12]))


@pytest.mark.parametrize(("side", "axis", "sign"), [("left", 1, 1), ("right", 1, -1), ("top", 2, 1), ("bottom", 2, -1)])
def test_sides_of_the_vehicle(side: str, axis: int, sign: int) -> None:
    grid = Pool(point_grid((3.0, 1.0, 1.0), (4, 3, 2)).solid_vertices, None)
    event = Event.model_validate({"kind": "death", "frame": 1, "side": side, "depth_m": 0.1})
    gone = ~scripted(grid, [event], 2)[1]
    outwards = sign * grid.point_v[:, axis]
    np.testing.assert_array_equal(gone, outwards == outwards.max())


@pytest.mark.parametrize(("level", "share"), [(0, 1.0), (1, 0.65), (2, 0.25), (3, 0.0), (-1, 0.0)])
def test_a_label_s_occlusion_hides_the_left_part(world: World, pool: Pool, level: int, share: float) -> None:
    actor = replace(world.actors[0], occlusion=np.full(len(world.t_s), level))
    alone = replace(world, actors=(replace(actor, occlusion=None),), target=0)
    uv, free = visibility(alone, 0, pool, occlusion=True)
    _, seen = visibility(replace(alone, actors=(actor,)), 0, pool, occlusion=True)
    assert not (seen & ~free).any()
    low, high = uv[:, :, 0].min(axis=1, keepdims=True), uv[:, :, 0].max(axis=1, keepdims=True)
    inside = uv[:, :, 0] >= high - share * (high - low)
    # Level 3 leaves the outermost point at most.
    assert np.count_nonzero(seen != (free & inside & (share > 0))) <= len(world.t_s) * (level == 3)
