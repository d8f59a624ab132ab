"""The street follows a driven path and leaves it free."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from sim.roadside import Path, build_roadside, follow


def arc(radius: float, angle: float, samples: int = 200) -> np.ndarray:
    """Right turn that starts at the origin heading +y."""
    a = np.linspace(0, angle, samples)
    return np.stack([radius * (1 - np.cos(a)), radius * np.sin(a)], axis=1)


def test_a_straight_path_changes_nothing() -> None:
    path = Path.through(np.stack([np.zeros(50), np.linspace(0, 60, 50)], axis=1), 40.0, 100.0)
    assert path is not None
    points = np.random.default_rng(1).uniform([-60, -35, 0], [60, 150, 10], (200, 3))
    placed, heading = path.place(points)
    np.testing.assert_allclose(placed, points, atol=1e-9)
    np.testing.assert_allclose(heading, 0, atol=1e-12)


def test_an_arc_is_followed_to_a_decimetre() -> None:
    radius = 60.0
    xy = arc(radius, 1.2)
    path = Path.through(xy, 40.0, 100.0)
    assert path is not None
    s = np.linspace(10, radius * 1.2 - 10, 40)
    lane, _ = path.place(np.stack([np.zeros(40), s, np.zeros(40)], axis=1))
    # The smoothing of 4 m rounds an arc of this radius by 4² / 60 / 2 = 0.13 m at its ends, less inside.
    assert cKDTree(arc(radius, 1.2, 20_000)).query(lane[:, :2])[0].max() < 0.15
    aside, heading = path.place(np.stack([np.full(40, 5.0), s, np.zeros(40)], axis=1))
    np.testing.assert_allclose(np.linalg.norm(aside - lane, axis=1), 5.0, atol=1e-6)
    # Clockwise headings grow in a right turn at 1/radius; 5 m inside, the street is shorter by 5/60.
    np.testing.assert_allclose(np.gradient(heading, s), 1 / radius, rtol=0.03)
    squeeze = path.squeeze(np.stack([np.full(40, 5.0), s, np.zeros(40)], axis=1))
    np.testing.assert_allclose(squeeze, 1 - 5 / radius, atol=0.01)


def test_a_standing_ego_car_has_no_path() -> None:
    assert Path.through(np.zeros((20, 2)), 40.0, 100.0) is None


@pytest.mark.parametrize("turn", [0.0, 1.3])
def test_nothing_low_stands_where_something_drives(turn: float) -> None:
    xy = arc(25.0, turn) if turn else np.stack([np.zeros(50), np.linspace(0, 60, 50)], axis=1)
    beside = xy[-1] + np.stack([np.linspace(0, 25, 60), np.linspace(0, 5, 60)], axis=1)  # leaves the road to the right
    driven = np.concatenate([xy, beside])
    street = build_roadside(np.random.default_rng(3), length_m=120.0)
    for name, model, _ in follow(street, Path.through(xy, 40.0, 100.0), driven):
        for surface in model.levels[0]:
            assert np.isfinite(surface.vertices).all()
            np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1, atol=1e-6)
            if name != "ground":
                low = surface.vertices[surface.vertices[:, 2] < 1.0]
                assert cKDTree(driven).query(low[:, :2])[0].min(initial=9.0) > 1.9


@pytest.mark.parametrize("y", [18.0, 27.0, 62.0])
def test_where_a_house_gives_way_nothing_of_its_roof_stays_in_the_air(y: float) -> None:
    street = build_roadside(np.random.default_rng(3))
    across = np.stack([np.linspace(-40, 40, 200), np.full(200, y)], axis=1)
    (before,), (after,) = (
        [m for name, m, _ in things if name == "houses"] for things in (street, follow(street, None, across))
    )
    assert len(after.solid_faces) < len(before.solid_faces)
    parts = trimesh.Trimesh(after.solid_vertices, after.solid_faces).split(only_watertight=False)
    boxes = np.array([p.bounds for p in parts])
    for low, high in boxes[boxes[:, 0, 2] > 2.0]:
        below = (boxes[:, 0, 2] < 1.0) & np.all((boxes[:, 0] < high + 0.6) & (boxes[:, 1] > low - 0.6), axis=1)
        assert below.any(), (low, high)
