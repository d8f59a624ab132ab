"""The world as a scenario places it: the rig's signs, the ego car under its camera, vehicles that do not touch."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sim.scenario import Rig, Scenario, ScenarioError
from sim.world import World, build_world, camera_mount, make_rig

Maker = Callable[..., Scenario]

LEVEL = Rig(size_px=(800, 600), focal_px=800.0, height_m=1.2, frames=1)


def turned(**changes: object) -> Rig:
    return LEVEL.model_copy(update=changes)


def test_the_right_camera_stands_a_base_to_the_right() -> None:
    rig, nominal = make_rig(LEVEL)
    assert nominal is rig
    assert rig.is_normal_case
    uv = rig.project(np.array([0.0, 0.0, 10.0]))
    # Disparity f B / Z = 24 px.
    np.testing.assert_allclose(uv, [399.5, 299.5, 399.5 - 24, 299.5])


@pytest.mark.parametrize(
    ("rotation_deg", "shift_px"),
    [((0.0, 1.0, 0.0), (-800 * np.tan(np.deg2rad(1)), 0)), ((1.0, 0.0, 0.0), (0, 800 * np.tan(np.deg2rad(1))))],
    ids=["to the right", "upwards"],
)
def test_turning_the_right_camera(rotation_deg: tuple[float, float, float], shift_px: tuple[float, float]) -> None:
    """A camera turned to the right (about y, down) sees things further left; turned upwards (about x), further down."""
    rig, _ = make_rig(turned(right_rotation_deg=rotation_deg, baseline_m=1e-9))
    np.testing.assert_allclose(rig.project(np.array([0.0, 0.0, 10.0]))[2:] - [399.5, 299.5], shift_px, atol=1e-5)


def test_turned_or_not_its_centre_stays() -> None:
    rig, _ = make_rig(turned(right_rotation_deg=(2.0, -3.0, 1.0)))
    np.testing.assert_allclose(rig.T_rl.inv().t, [0.3, 0, 0], atol=1e-15)


def test_the_nominal_rig_differs_where_it_is_told() -> None:
    nominal = LEVEL.nominal.model_copy(update={"focal_px": 810.0})
    rig, believed = make_rig(turned(right_rotation_deg=(0.0, 1.0, 0.0), nominal=nominal))
    assert (rig.left.K[0, 0], believed.left.K[0, 0]) == (800, 810)
    np.testing.assert_array_equal(rig.T_rl.R, believed.T_rl.R)
    straight = LEVEL.nominal.model_copy(update={"right_rotation_deg": (0.0, 0.0, 0.0)})
    rig, believed = make_rig(turned(right_rotation_deg=(0.0, 1.0, 0.0), nominal=straight))
    assert believed.is_normal_case
    assert not rig.is_normal_case


def test_the_camera_looks_forward_and_upwards_by_its_pitch() -> None:
    """On the ego frame: x forward, y left, z up."""
    T_ec = camera_mount(turned(pitch_deg=10.0))
    np.testing.assert_allclose(T_ec.R[:, 0], [0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(T_ec.R[:, 2], [np.cos(np.deg2rad(10)), 0, np.sin(np.deg2rad(10))], atol=1e-15)
    np.testing.assert_array_equal(T_ec.t, [0, 0, 1.2])


def test_the_origin_lies_under_the_camera_at_the_beginning(world: World) -> None:
    T_wc = world.T_wc(0.0)
    np.testing.assert_allclose(T_wc.t, [0, 0, 1.0], atol=1e-12)
    np.testing.assert_allclose(T_wc.R[:, 2], [0, 1, 0], atol=1e-12)
    assert not world.ego_moves


def test_the_reference_point_is_the_middle_of_the_rear_axle(world: World) -> None:
    actor = world.actors[world.target]
    assert actor.name == "target"
    np.testing.assert_array_equal(actor.reference_v, [0, 0, actor.model.wheel_radius_m])
    length = actor.model.size_m[0]
    np.testing.assert_allclose(actor.model.solid_vertices[:, 0].min(), -actor.model.rear_overhang_m, atol=0.02)
    np.testing.assert_allclose(np.ptp(actor.model.solid_vertices[:, 0]), length, atol=0.02)


def test_vehicles_that_touch_are_refused(make_scenario: Maker) -> None:
    vehicles = [
        {
            "name": n,
            "mesh": "hatchback",
            "motion": {"kind": "straight", "start_m": s, "heading_deg": h, "speed_mps": 10.0},
        }
        for n, s, h in (("one", [0.0, 10.0], 0.0), ("two", [0.3, 20.0], 180.0))
    ]
    with pytest.raises(ScenarioError, match=r"'one' and 'two' touch at t = 0\.\d\d s \(frame \d+\)"):
        build_world(make_scenario(vehicle=vehicles))
    vehicles[1]["motion"]["start_m"] = [2.5, 20.0]  # type: ignore[index]
    assert len(build_world(make_scenario(vehicle=vehicles)).actors) == 2


def test_the_world_depends_on_the_seed_alone(make_scenario: Maker, world: World) -> None:
    again = build_world(make_scenario(measure={"points": 7}))
    for a, b in zip(world.actors, again.actors, strict=True):
        np.testing.assert_array_equal(a.model.solid_vertices, b.model.solid_vertices)
        np.testing.assert_array_equal(a.trajectory.T_wb.t, b.trajectory.T_wb.t)
