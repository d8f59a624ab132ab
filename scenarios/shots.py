"""What a camera of a world needs to know of its moment for the disturbances: light, sun, and what hides it."""

from __future__ import annotations

import numpy as np

from sim.pose import Pose
from sim.realism import Shot
from sim.realism.glare import sun_share
from sim.render import Light
from sim.scenario import Scenario
from sim.world import World


def daylight(scenario: Scenario) -> Light:
    """The light of a scenario's world, with what is mirrored and what shades."""
    road, realism = scenario.world, scenario.realism
    return Light.daylight(
        road.sun_azimuth_deg,
        road.sun_elevation_deg,
        shadows=scenario.render.shadows,
        mirrors=realism.reflections,
        shade=realism.shadows,
    )


def shot(scenario: Scenario, world: World, side: str, t_s: float, run: int = 0) -> Shot:
    """The moment ``t_s`` of one camera, "left" or "right"."""
    light = daylight(scenario)
    T_lc = Pose.identity() if side == "left" else world.rig.T_rl.inv()
    T_cw = (world.T_wc(t_s) @ T_lc).inv()
    sun_c = T_cw.R @ light.to_sun
    share = _sun_share(world, T_cw, sun_c, t_s) if scenario.realism.glare and sun_c[2] > 0 else 0.0
    return Shot(
        camera=world.rig.left if side == "left" else world.rig.right,
        side=side,
        offset_m=float(T_lc.t[0]),
        baseline_m=float(np.linalg.norm(world.rig.T_rl.t)),
        seed=scenario.seed,
        run=run,
        t_s=t_s,
        sun_c=sun_c,
        sun=share * light.exposure * light.sun,
    )


def _sun_share(world: World, T_cw: Pose, sun_c: np.ndarray, t_s: float) -> float:
    props = [(p.model, T_cw @ p.T_wb) for p in world.props]
    return sun_share([*props, *((a.model, T_cw @ a.trajectory.pose(t_s)) for a in world.actors)], sun_c)
