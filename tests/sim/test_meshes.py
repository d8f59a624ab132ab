"""Parametric vehicles: closed, of the size asked for, with sound normals, the same for the same seed."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import trimesh

from sim.meshes import VEHICLE_KINDS, make_vehicle, sample_surface
from sim.model import Surface, VehicleModel

KITTI_SIZE_M = {
    "sedan": (3.9, 1.65, 1.42), "hatchback": (3.4, 1.55, 1.62), "estate": (4.95, 1.9, 1.55), "van": (5.6, 2.1, 2.4),
    "lorry": (6.4, 2.3, 3.0), "bus": (10.5, 2.6, 3.3),
}  # fmt: skip


@cache
def vehicle(kind: str, scaled: bool = False) -> VehicleModel:
    return make_vehicle(kind, np.random.default_rng(3), KITTI_SIZE_M[kind] if scaled else None)


@pytest.fixture(params=[(k, s) for k in VEHICLE_KINDS for s in (False, True)], ids=lambda p: f"{p[0]}-{p[1]}")
def model(request: pytest.FixtureRequest) -> VehicleModel:
    kind, scaled = request.param
    return vehicle(kind, scaled)


def welded(surface: Surface) -> trimesh.Trimesh:
    """The surface with vertices of equal position merged."""
    _, first, inverse = np.unique(np.round(surface.vertices, 9), axis=0, return_index=True, return_inverse=True)
    return trimesh.Trimesh(surface.vertices[first], inverse.reshape(-1)[surface.faces], process=False)


def test_solid_is_closed_and_turned_outward(model: VehicleModel) -> None:
    solid = trimesh.Trimesh(model.solid_vertices, model.solid_faces, process=False)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    parts = solid.split(only_watertight=False)
    assert len(parts) >= 5  # body and four wheels
    for part in parts:
        assert part.is_watertight
        assert part.volume > 0


def test_every_level_is_closed(model: VehicleModel) -> None:
    for level in model.levels:
        assert len(level) == 1
        edges = np.sort(welded(level[0]).edges, axis=1)
        _, count = np.unique(edges, axis=0, return_counts=True)
        assert np.all(count % 2 == 0)


def test_bounding_box_is_the_size_in_every_level(model: VehicleModel) -> None:
    low = np.array([-model.rear_overhang_m, -model.size_m[1] / 2, 0.0])
    for vertices in (model.solid_vertices, *(level[0].vertices for level in model.levels)):
        np.testing.assert_allclose(vertices.min(axis=0), low, atol=1e-9)
        np.testing.assert_allclose(vertices.max(axis=0), low + model.size_m, atol=1e-9)


def test_finest_level_is_the_solid(model: VehicleModel) -> None:
    surface = model.levels[0][0]
    np.testing.assert_allclose(surface.vertices[surface.faces], model.solid_vertices[model.solid_faces], atol=1e-12)


def test_normals_are_unit_and_on_the_side_of_their_face(model: VehicleModel) -> None:
    for level in model.levels:
        s = level[0]
        np.testing.assert_allclose(np.linalg.norm(s.normals, axis=1), 1, atol=1e-6)
        c = s.vertices[s.faces]
        facing = np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0])
        assert np.all(np.linalg.norm(facing, axis=1) > 0)
        assert np.all(np.einsum("fi,fki->fk", facing, s.normals[s.faces]) > 0)


def test_attributes_are_in_range(model: VehicleModel) -> None:
    for level in model.levels:
        s = level[0]
        for values in (s.color, s.gloss, s.uv):
            assert values is not None
            assert values.min() >= 0
            assert values.max() <= 1
        assert s.texture is not None
        assert all(n & (n - 1) == 0 for n in s.texture.shape[:2])


def test_levels_thin_out(model: VehicleModel) -> None:
    fine, middle, rough = (len(level[0].faces) for level in model.levels)
    assert 4000 < fine < 7500
    assert 1000 < middle < 2500
    assert rough < 500


def test_four_round_wheels_stand_on_the_ground(model: VehicleModel) -> None:
    solid = trimesh.Trimesh(model.solid_vertices, model.solid_faces, process=False)
    wheels = [p for p in solid.split(only_watertight=False) if p.bounds[0, 2] == pytest.approx(0, abs=1e-9)]
    assert len(wheels) == 4
    for wheel in wheels:
        x, _, z = wheel.bounds.mean(axis=0)
        assert min(abs(x), abs(x - model.wheelbase_m)) < 1e-6
        assert np.ptp(wheel.bounds, axis=0)[2] == pytest.approx(2 * model.wheel_radius_m, rel=0.02)
        assert np.ptp(wheel.bounds, axis=0)[0] == pytest.approx(2 * model.wheel_radius_m, rel=0.02)
        assert z == pytest.approx(model.wheel_radius_m, rel=0.02)


@pytest.mark.parametrize("kind", VEHICLE_KINDS)
def test_body_is_symmetric(kind: str) -> None:
    v = vehicle(kind).solid_vertices
    mirrored = v * [1, -1, 1]
    a, b = (np.unique(np.round(x, 6) + 0.0, axis=0) for x in (v, mirrored))
    np.testing.assert_allclose(a, b)


def test_same_seed_same_vehicle_other_seed_other_paint() -> None:
    a, b, c = (make_vehicle("sedan", np.random.default_rng(s), color="red").levels[0][0] for s in (1, 1, 2))
    for field in ("vertices", "faces", "normals", "color", "gloss", "uv", "texture"):
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field))
    assert np.any(a.texture != c.texture)


def test_color_does_not_change_what_the_generator_gives_next() -> None:
    states = []
    for color in ("white", (0.2, 0.3, 0.4), None):
        rng = np.random.default_rng(5)
        make_vehicle("hatchback", rng, color=color)
        states.append(rng.bit_generator.state)
    assert states[0] == states[1] == states[2]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kind": "sedna"}, "kind: expected one of sedan"),
        ({"size_m": (4, 1.8, -1.4)}, "size_m"),
        ({"size_m": (4, 1.8)}, "size_m"),
        ({"size_m": (4, np.nan, 1.4)}, "size_m"),
        ({"color": "rde"}, "color: expected one of"),
        ({"color": (0.1, 0.2, 3.0)}, "color"),
    ],
)
def test_wrong_calls_are_named(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_vehicle(**{"kind": "sedan", "rng": np.random.default_rng(0), **arguments})  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", VEHICLE_KINDS)
def test_sampled_points_lie_on_the_visible_skin(kind: str) -> None:
    m = vehicle(kind)
    points, normals = sample_surface(m, 300, np.random.default_rng(0))
    assert points.shape == normals.shape == (300, 3)
    c = m.solid_vertices[m.solid_faces]
    for p, n in zip(points, normals, strict=True):
        facing = np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0])
        facing /= np.linalg.norm(facing, axis=1, keepdims=True)
        flat = np.abs(np.einsum("fi,fi->f", p - c[:, 0], facing)) < 1e-9
        inside = np.ones(len(c), bool)
        for k in range(3):
            edge = c[:, (k + 1) % 3] - c[:, k]
            inside &= np.einsum("fi,fi->f", np.cross(edge, p - c[:, k]), facing) > -1e-9
        assert np.any(flat & inside & (facing @ n > 1 - 1e-9))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    assert normals[:, 2].min() > -0.5
    assert np.all(np.ptp(points, axis=0) > 0.8 * np.array(m.size_m) * [1, 1, 0.8])


def test_no_sampled_point_hides_in_a_wheel_house() -> None:
    m = vehicle("sedan")
    points, normals = sample_surface(m, 2000, np.random.default_rng(1))
    inner = np.abs(points[:, 1]) < 0.5 * m.size_m[1] - 0.30
    low = points[:, 2] < 1.5 * m.wheel_radius_m
    behind = np.abs(points[:, 0] - m.wheelbase_m / 2) < 0.4 * m.wheelbase_m
    assert not np.any(inner & low & behind & (np.abs(normals[:, 1]) > 0.5))


def test_sampling_is_even_in_area() -> None:
    """The share of points on the roof is the roof's share of the visible area (3 sigma of a binomial of 4000)."""
    m = make_vehicle("bus", np.random.default_rng(0))
    points, _ = sample_surface(m, 4000, np.random.default_rng(2))
    L = m.size_m[0]
    front, rear = (np.mean(np.abs(points[:, 0] + m.rear_overhang_m - x * L) < 0.25 * L) for x in (0.75, 0.25))
    assert abs(front - rear) < 0.06
