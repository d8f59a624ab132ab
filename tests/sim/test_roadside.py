"""The static street: what stands there, that the lanes are free, and that the road has no holes."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from sim.model import Model
from sim.roadside import build_roadside

LAYOUTS = [(2, None, True), (3, None, False), (2, 30.0, True), (2, 25.0, False)]


@cache
def street(lanes: int, crossing: float | None, houses: bool) -> dict[str, Model]:
    world = build_roadside(np.random.default_rng(4), 120.0, lanes, crossing_y=crossing, houses=houses)
    return {name: model for name, model, _ in world}


def corners(model: Model) -> np.ndarray:
    return model.solid_vertices[model.solid_faces]


@pytest.mark.parametrize(("lanes", "crossing", "houses"), LAYOUTS)
def test_everything_is_there_and_light(lanes: int, crossing: float | None, houses: bool) -> None:
    world = street(lanes, crossing, houses)
    assert set(world) == {"ground", "trees", "furniture", "hills"} | ({"houses"} if houses else set())
    assert sum(len(m.solid_faces) for m in world.values()) < 60_000
    assert sum(len(level) for m in world.values() for level in m.levels) <= 9


@pytest.mark.parametrize(("lanes", "crossing", "houses"), LAYOUTS)
def test_nothing_stands_in_a_lane(lanes: int, crossing: float | None, houses: bool) -> None:
    """Below 3.7 m (more than a lorry is high) no triangle of anything but the ground reaches over a lane."""
    for name, model in street(lanes, crossing, houses).items():
        c = corners(model)
        if name == "ground":
            c = c[np.ptp(c[..., 2], axis=1) + c[..., 2].max(axis=1) > 0.01]
        low, high = c.min(axis=1), c.max(axis=1)
        reachable = low[:, 2] < 3.7
        in_street = (high[:, 0] > 1.75 - 3.5 * lanes) & (low[:, 0] < 1.75) & (high[:, 1] > -40) & (low[:, 1] < 120)
        assert not np.any(reachable & in_street), name
        if crossing is not None:
            across = (high[:, 1] > crossing - 3.5) & (low[:, 1] < crossing + 3.5) & (np.abs(low[:, 0]) < 110)
            assert not np.any(reachable & across), name


@pytest.mark.parametrize(("lanes", "crossing", "houses"), LAYOUTS)
def test_ground_has_no_holes(lanes: int, crossing: float | None, houses: bool) -> None:
    """Straight down from anywhere there is ground that looks up."""
    rng = np.random.default_rng(0)
    points = np.stack([rng.uniform(-70, 70, 1500), rng.uniform(-30, 110, 1500)], axis=-1)
    c = corners(street(lanes, crossing, houses)["ground"])
    up = np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0])[:, 2] > 1e-9
    a, ab, ac = c[up, 0, :2], c[up, 1, :2] - c[up, 0, :2], c[up, 2, :2] - c[up, 0, :2]
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    q = points[:, None] - a
    v = (q[..., 0] * ac[:, 1] - q[..., 1] * ac[:, 0]) / area
    w = (ab[:, 0] * q[..., 1] - ab[:, 1] * q[..., 0]) / area
    covered = np.any((v >= -1e-9) & (w >= -1e-9) & (v + w <= 1 + 1e-9), axis=1)
    assert covered.all(), points[~covered][:5]


@pytest.mark.parametrize(("lanes", "crossing", "houses"), LAYOUTS)
def test_surfaces_are_sound(lanes: int, crossing: float | None, houses: bool) -> None:
    for model in street(lanes, crossing, houses).values():
        for s in model.levels[0]:
            np.testing.assert_allclose(np.linalg.norm(s.normals, axis=1), 1, atol=1e-6)
            assert np.isfinite(s.vertices).all()
            assert s.color.min() >= 0
            assert s.color.max() <= 1
            assert s.uv is not None
            if not s.repeat:
                assert s.uv.min() >= 0
                assert s.uv.max() <= 1


def test_road_carries_white_paint_between_the_lanes() -> None:
    markings = street(2, None, True)["ground"].levels[0][1]
    x = markings.vertices[markings.faces].mean(axis=(1,))[:, 0]
    for line in (-1.75, 1.80, -5.30):  # lane divider and edge lines
        assert np.any(np.abs(x - line) < 0.1)


def test_deterministic_and_seeded() -> None:
    a, b, c = (build_roadside(np.random.default_rng(s), 60.0) for s in (1, 1, 2))
    for (_, x, _), (_, y, _) in zip(a, b, strict=True):
        np.testing.assert_array_equal(x.solid_vertices, y.solid_vertices)
        for s, t in zip(x.levels[0], y.levels[0], strict=True):
            np.testing.assert_array_equal(s.texture, t.texture)
            np.testing.assert_array_equal(s.color, t.color)
    trees = [next(m for name, m, _ in w if name == "trees") for w in (a, c)]
    assert trees[0].solid_vertices.shape != trees[1].solid_vertices.shape


@pytest.mark.parametrize("arguments", [{"length_m": 0.0}, {"lanes": 0}, {"lane_m": -3.5}])
def test_wrong_calls_are_named(arguments: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(arguments))):
        build_roadside(np.random.default_rng(0), **arguments)  # type: ignore[arg-type]
