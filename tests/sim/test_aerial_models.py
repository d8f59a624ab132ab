"""Shapes of buildings, crowns and vehicles of the aerial world, and their textures."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from sim.aerial import buildings, trees, vehicles
from sim.aerial.library import Library, Mesh, polygon
from sim.buildings_map import Footprint
from sim.meshes import VEHICLE_KINDS
from sim.meshes.shapes import SHAPES

Array = np.ndarray
HOUSE = np.array([[0.0, 0.0], [14.0, 0.0], [14.0, 9.0], [0.0, 9.0]])
COURT = np.array([[0.0, 0.0], [60.0, 0.0], [60.0, 40.0], [0.0, 40.0]])
HOLE = np.array([[20.0, 15.0], [20.0, 25.0], [40.0, 25.0], [40.0, 15.0]])


def built(outline: Array, height: float, holes: tuple[Array, ...] = (), seed: int = 0) -> tuple[Mesh, Array]:
    footprint = Footprint(outline, holes, height, True)
    house = buildings.build(footprint, np.full(len(outline), 5.0), 0, np.random.default_rng(seed))
    return house.mesh, house.at_m


def normals(mesh: Mesh) -> Array:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.asarray(np.cross(b - a, c - a))


@pytest.mark.parametrize("seed", range(6))
def test_a_small_rectangle_gets_walls_and_a_roof_that_covers_it(seed: int) -> None:
    mesh, at = built(HOUSE, 6.0, seed=seed)
    assert at[2] == 5.0
    assert mesh.vertices[:, 2].min() < 0
    up = normals(mesh)
    roof = (up[:, 2] > 1e-9) & (mesh.vertices[mesh.faces].mean(axis=1)[:, 2] > 4.0)
    seen = shapely.union_all([shapely.Polygon(mesh.vertices[f][:, :2] + at[:2]) for f in mesh.faces[roof]])
    assert seen.buffer(0.01).contains(shapely.Polygon(HOUSE))
    assert 5.9 < mesh.vertices[:, 2].max() < 6.0 + 4.5 * np.tan(np.deg2rad(45)) + 2.3


def test_a_large_outline_gets_a_flat_roof_with_its_courtyard_open() -> None:
    mesh, at = built(COURT, 18.0, (HOLE,))
    up = normals(mesh)
    flat = (up[:, 2] > 1e-9) & (np.ptp(mesh.vertices[mesh.faces][..., 2], axis=1) < 1e-9)
    level = np.abs(mesh.vertices[mesh.faces][..., 2].mean(axis=1) - 18.0) < 1e-9
    area = 0.5 * up[flat & level, 2].sum()
    assert area == pytest.approx(60 * 40 - 20 * 10)
    yard = shapely.Polygon(HOLE).buffer(-0.5)
    assert not any(yard.intersects(shapely.Polygon(mesh.vertices[f][:, :2] + at[:2])) for f in mesh.faces[flat & level])


def test_walls_look_outward_also_into_a_courtyard() -> None:
    mesh, at = built(COURT, 18.0, (HOLE,))
    n = normals(mesh)
    corners = mesh.vertices[mesh.faces]
    wall = (np.abs(n[:, 2]) < 1e-9) & (corners[..., 2].min(axis=1) < 0)
    middle = corners[wall].mean(axis=1)[:, :2] + at[:2]
    out = n[wall, :2] / np.linalg.norm(n[wall, :2], axis=1, keepdims=True)
    shape = shapely.Polygon(COURT, [HOLE])
    assert not shapely.contains_xy(shape, middle + 0.1 * out).any()
    assert shapely.contains_xy(shape, middle - 0.1 * out).all()


def test_crowns_are_round_and_look_outward() -> None:
    crowns = trees.crowns(np.random.default_rng(1), 0)
    assert len(crowns) == 2 * trees.SHAPES
    for mesh in crowns:
        reach = np.hypot(*mesh.vertices[:, :2].T)
        assert 0.7 < reach.max() < 1.6
        assert mesh.vertices[:, 2].min() > 0
        corners = mesh.vertices[mesh.faces]
        outward = np.sum(normals(mesh) * (corners.mean(axis=1) - [0, 0, 1.3]), axis=1)
        assert np.mean(outward > 0) > 0.97


def test_vehicles_take_any_paint_but_keep_their_glass_and_tyres() -> None:
    meshes, textures = vehicles.fleet()
    assert len(meshes) == len(textures) == len(VEHICLE_KINDS)
    for mesh, texture, kind in zip(meshes, textures, VEHICLE_KINDS, strict=True):
        assert np.ptp(mesh.vertices[:, 0]) == pytest.approx(SHAPES[kind].size_m[0], rel=0.02)
        share = texture.texels[..., 3]
        assert share.max() > 0.8
        assert np.mean(share < 0.05) > 0.03
    paints = vehicles.draw_paints(["sedan"] * 4000, np.random.default_rng(2))
    assert paints.shape == (4000, 3)
    # A fifth of all cars is white: three sigma of 4000 draws.
    assert np.mean(paints.min(axis=1) > 0.5) == pytest.approx(0.21, abs=0.02)


def test_a_library_keeps_meshes_apart() -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    one, two = polygon(square, square[:, :2], 0), polygon(square[:3] + 4.0, square[:3, :2], 1)
    texture = trees.foliage(np.random.default_rng(0), 16)
    library = Library.of([one, two], [texture, texture])
    assert library.vertex_first.tolist() == [0, 4, 7]
    assert library.face_first.tolist() == [0, 2, 3]
    assert library.faces[2].tolist() == [4, 5, 6]
    assert library.texture.tolist() == [0, 0, 1]
    assert library.textures[1].tolist() == [256, 16, 16, 1]
    assert library.radius[1] == pytest.approx(np.sqrt(25 + 25 + 16))
