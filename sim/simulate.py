"""simulate(scenario, seed, run) -> (Observations, Truth): the only place where both products are made."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Int

from sim.measure import Pool, Rows, follow, make_pool, pixel_noise, scripted, visibility
from sim.noise import Draft, Setting, apply_outliers
from sim.observations import Observations, Tracks
from sim.pose import Pose, exp_so3
from sim.scenario import Scenario, ScenarioError
from sim.streams import stream
from sim.truth import Body, Labels, Truth
from sim.world import Actor, World, build_world

Array = np.ndarray
_OUTLINE_POINTS = 4000


@dataclass(frozen=True, eq=False)
class View:
    """What there is to measure, the same in every run: points of the target, their noise-free pixels uv (m, p, 4) and
    whether both cameras see them (m, p), the rows of the tracks."""

    pool: Pool
    uv: Float[Array, "m p 4"]
    seen: Bool[Array, "m p"]
    rows: Rows


def look(scenario: Scenario, world: World) -> View:
    """The view of a scenario's world; of ``measure`` it takes target, points, occlusion and events."""
    spec, name = scenario.measure, scenario.target.name
    pool = make_pool(world.actors[world.target], spec.points, stream(scenario.seed, 0, f"{name}/surface/points"))
    uv, seen = visibility(world, world.target, pool, spec.occlusion)
    seen &= scripted(pool, spec.events, len(seen))
    return View(pool, uv, seen, follow(seen, spec.points))


def simulate(
    scenario: Scenario, run: int = 0, world: World | None = None, view: View | None = None
) -> tuple[Observations, Truth]:
    """Measures the target of a scenario. ``run`` numbers independent repetitions; world and view are the same in all.

    Where points are to be tracked in images, both products are still without tracks.

    Raises
        ScenarioError: the target is never visible, or an input file is wrong.
    """
    world = build_world(scenario) if world is None else world
    view = look(scenario, world) if view is None else view
    draft = _measure(scenario, world, view, run)
    draft = _selected(draft, draft.keep)
    visible_points = np.bincount(draft.frame, minlength=len(world.t_s))
    if not visible_points.any():
        raise ScenarioError(f"measure.target: {scenario.target.name!r} is never visible in both cameras")
    if scenario.measure.from_images:
        draft = _selected(draft, np.zeros(len(draft.frame), bool))
    return _observations(scenario, world, draft, run), _truth(scenario, world, view.pool, draft, visible_points)


def _measure(scenario: Scenario, world: World, view: View, run: int) -> Draft:
    spec, name, rows = scenario.measure, scenario.target.name, view.rows
    missing = [k for k in spec.missing_frames if k < len(view.seen)]
    noise = spec.sigma_px * pixel_noise(scenario.seed, run, name, view.uv.shape[:2])
    uv_true = view.uv[rows.frame, rows.point]
    draft = Draft(
        frame=rows.frame,
        track=rows.track,
        point=rows.point,
        uv_true=uv_true,
        uv=uv_true + noise[rows.frame, rows.point],
        kind=np.zeros(len(rows.frame), int),
        keep=~np.isin(rows.frame, missing),
    )
    setting = Setting(world, view.uv, view.seen)
    return apply_outliers(draft, scenario.outliers, setting, lambda c: stream(scenario.seed, run, f"{name}/{c}"))


def _selected(draft: Draft, rows: Bool[Array, "n"]) -> Draft:
    """Some of the rows."""
    return Draft(**{f.name: getattr(draft, f.name)[rows] for f in fields(Draft)})


def _observations(scenario: Scenario, world: World, draft: Draft, run: int) -> Observations:
    cov = np.broadcast_to(np.eye(4) * scenario.measure.stated**2, (len(draft.frame), 4, 4))
    tracks = Tracks(draft.frame, draft.track, draft.uv[:, :2], draft.uv[:, 2:], cov)
    observed = world.ego_moves if scenario.ego.observed is None else scenario.ego.observed
    T_wc = _observed_ego(scenario, world, run) if observed else None
    return Observations(world.t_s, world.nominal_rig, tracks, scenario.target.name, T_wc)


def _observed_ego(scenario: Scenario, world: World, run: int) -> Pose:
    T = world.T_wc(world.t_s)
    rng = stream(scenario.seed, run, "ego/pose/noise")
    unit = rng.standard_normal((len(world.t_s), 6))
    turn = exp_so3(np.deg2rad(scenario.ego.sigma_rotation_deg) * unit[:, :3])
    return Pose(turn @ T.R, T.t + scenario.ego.sigma_position_m * unit[:, 3:])


def _body(actor: Actor, t_s: Float[Array, "m"]) -> Body:
    v = actor.model.solid_vertices
    step = max(1, len(v) // _OUTLINE_POINTS)
    return Body(actor.name, actor.trajectory.pose(t_s), np.stack([v.min(axis=0), v.max(axis=0)]), v[::step])


def _truth(scenario: Scenario, world: World, pool: Pool, draft: Draft, visible_points: Int[Array, "m"]) -> Truth:
    target, t = world.actors[world.target], world.t_s
    track, first = np.unique(draft.track, return_index=True)
    point_v = pool.point_v[draft.point[first]].copy()
    foreign = [i + 1 for i, o in enumerate(scenario.outliers) if o.kind in ("segmentation", "reflection")]
    point_v[np.isin(draft.kind[first], foreign)] = np.nan
    return Truth(
        t_s=t,
        rig=world.rig,
        T_wc=world.T_wc(t),
        ego_velocity_w=world.ego.velocity_of(world.T_ec.t, t),
        ego_omega_w=world.ego.angular_rate(t),
        bodies=tuple(_body(a, t) for a in world.actors),
        target=world.target,
        velocity_w=target.trajectory.velocity_of(target.reference_v, t),
        omega_w=target.trajectory.angular_rate(t),
        reference_v=target.reference_v,
        track=track,
        point_v=point_v,
        labels=Labels(
            kind=draft.kind,
            uv_true=draft.uv_true,
            sigma_px=np.full(len(draft.frame), scenario.measure.sigma_px),
            kinds=tuple(o.kind for o in scenario.outliers),
        ),
        visible_points=visible_points,
    )
