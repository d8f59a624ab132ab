"""Which points a camera sees, against embree's ray casting and by construction."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

from sim.visibility import facing, hidden

Array = np.ndarray


def wall(z: float, half: float = 1.0) -> Array:
    """A square across the view as two triangles (2, 3, 3)."""
    a, b, c, d = [[x * half, y * half, z] for x, y in [(-1, -1), (1, -1), (1, 1), (-1, 1)]]
    return np.array([[a, b, c], [a, c, d]])


def cast(points: Array, triangles: Array) -> Array:
    """Whether embree finds a triangle between the origin and 1 cm before each point."""
    mesh = trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3), process=False)
    directions = points / np.linalg.norm(points, axis=1)[:, None]
    origins = np.zeros_like(points)
    where, ray, _ = RayMeshIntersector(mesh).intersects_location(origins, directions, multiple_hits=True)
    nearest = np.full(len(points), np.inf)
    np.minimum.at(nearest, ray, np.linalg.norm(where, axis=1))
    return np.asarray(nearest < np.linalg.norm(points, axis=1) - 0.004)


@pytest.mark.parametrize("seed", range(8))
def test_random_scenes_against_embree(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centres = np.column_stack([rng.uniform(-6, 6, (150, 2)), rng.uniform(3, 30, 150)])
    triangles = centres[:, None] + rng.normal(0, 0.8, (150, 3, 3))
    points = np.column_stack([rng.uniform(-6, 6, (4000, 2)), rng.uniform(2, 40, 4000)])
    ours, theirs = hidden(points, triangles), cast(points, triangles)
    # Both sides hide; embree's single precision decides otherwise within 1e-6 rad of an edge or of the end of a ray.
    assert np.count_nonzero(ours != theirs) <= 2
    assert 0.05 < ours.mean() < 0.95


@pytest.mark.parametrize("seed", range(4))
def test_triangles_around_and_behind_the_camera(seed: int) -> None:
    """Triangles that reach behind the image plane have no bounded projection."""
    rng = np.random.default_rng(100 + seed)
    triangles = rng.normal(0, 6, (60, 3, 3))
    points = np.column_stack([rng.uniform(-6, 6, (2000, 2)), rng.uniform(1, 20, 2000)])
    assert np.count_nonzero(hidden(points, triangles) != cast(points, triangles)) <= 2


def test_a_convex_body_hides_its_far_side() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=3)
    mesh.apply_translation([0.5, -0.3, 10])
    points, normals = mesh.triangles_center, mesh.face_normals
    cosine = -np.sum(points * normals, axis=1) / np.linalg.norm(points, axis=1)
    seen = ~hidden(points, mesh.triangles)
    # At grazing rays a neighbour triangle lies within the gap at the ray's end.
    assert seen[cosine > 0.1].all()
    assert not seen[cosine < -0.1].any()
    np.testing.assert_array_equal(facing(points, normals), cosine > 0.08)
    np.testing.assert_array_equal(facing(points, normals, 0.5), cosine > 0.5)


def test_a_wall_hides_what_is_behind_it() -> None:
    points = np.array([[0, 0, 5.0], [0, 0, 15], [0.9, 0.9, 9.9], [1.8, 1.8, 20], [2.2, 0, 20], [0, 0, 10], [0, 0, -20]])
    expected = [False, True, False, True, False, False, True]
    np.testing.assert_array_equal(hidden(points, wall(10)), expected)


def test_a_point_s_own_surface_does_not_hide_it() -> None:
    """Up to 4 mm along the ray: rounding of the point, not a surface."""
    points = np.array([[0, 0, 10.003], [0, 0, 10.005], [0.3, 0.4, 10.0]])
    np.testing.assert_array_equal(hidden(points, wall(10)), [False, True, False])


def test_points_behind_the_camera_are_hidden() -> None:
    points = np.array([[0, 0, -1.0], [0, 0, 0.0], [0.1, 0, 1.0]])
    np.testing.assert_array_equal(hidden(points, wall(10)), [True, True, False])
    np.testing.assert_array_equal(hidden(points, np.empty((0, 3, 3))), [True, True, False])


def test_what_is_behind_the_camera_hides_nothing() -> None:
    assert not hidden(np.array([[0, 0, 5.0]]), wall(-2)).any()


def test_no_points_and_one_point() -> None:
    assert hidden(np.empty((0, 3)), wall(10)).shape == (0,)
    assert hidden(np.array([[0.1, 0.2, 12.0]]), wall(10)).all()  # cells of no extent


def test_inputs_are_not_touched() -> None:
    points, triangles = np.array([[0, 0, 15.0]]), wall(10)
    before = points.copy(), triangles.copy()
    hidden(points, triangles)
    np.testing.assert_array_equal(points, before[0])
    np.testing.assert_array_equal(triangles, before[1])
