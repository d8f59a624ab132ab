"""One scene for all tests of the measuring half: a turning sedan, a standing van beside it, no pictures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from sim.scenario import Scenario
from sim.world import World, build_world

TARGET: dict[str, Any] = {
    "name": "target",
    "mesh": "sedan",
    "motion": {"kind": "turning", "start_m": [-1.0, 18.0], "heading_deg": 160.0, "turn_deg": 60.0, "yaw_rate_dps": 40.0,
               "straight_s": 0.1},
}  # fmt: skip
NEIGHBOUR: dict[str, Any] = {
    "name": "neighbour",
    "mesh": "van",
    "motion": {"kind": "straight", "start_m": [5.0, 24.0], "heading_deg": 180.0, "speed_mps": 0.0},
}


@pytest.fixture(scope="session")
def make_scenario() -> Callable[..., Scenario]:
    """A scenario of 20 frames with the given top-level keys changed; keys of tables are merged."""

    def make(**changes: Any) -> Scenario:
        fields: dict[str, Any] = {
            "title": "test",
            "kind": "stereo",
            "seed": 7,
            "rig": {"size_px": (800, 600), "focal_px": 800.0, "baseline_m": 0.3, "frames": 20},
            "render": {"enabled": False},
            "world": {"roadside": False},
            "vehicle": [TARGET, NEIGHBOUR],
            "measure": {"points": 60, "sigma_px": 0.2},
        }
        for key, value in changes.items():
            fields[key] = fields[key] | value if isinstance(fields.get(key), dict) else value
        return Scenario.model_validate(fields)

    return make


@pytest.fixture(scope="session")
def scenario(make_scenario: Callable[..., Scenario]) -> Scenario:
    return make_scenario()


@pytest.fixture(scope="session")
def world(scenario: Scenario) -> World:
    return build_world(scenario)
