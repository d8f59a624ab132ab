"""Measured points of the target: which surface points are seen when, and where they appear in both images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from sim import meshes
from sim.camera import StereoRig
from sim.pose import Pose
from sim.scenario import Event
from sim.streams import stream
from sim.visibility import facing, hidden
from sim.world import Actor, World

Array = np.ndarray

# Surface points to choose from, per point measured at a time: enough to replace what turns out of view.
_POOL = 4
# Share of the silhouette that KITTI's occlusion levels 0..3 hide in a replay.
_HIDDEN_SHARE = np.array([0.0, 0.35, 0.75, 1.0])
# Axis of the vehicle frame and direction along it of every side.
_SIDES = {"front": (0, 1), "rear": (0, -1), "left": (1, 1), "right": (1, -1), "top": (2, 1), "bottom": (2, -1)}


@dataclass(frozen=True, eq=False)
class Pool:
    """Surface points of one vehicle: point_v (p, 3), normal_v (p, 3) or None for a transparent grid."""

    point_v: Float[Array, "p 3"]
    normal_v: Float[Array, "p 3"] | None


def make_pool(actor: Actor, points: int, rng: np.random.Generator) -> Pool:
    """Points to be measured, area-weighted over the body; of a grid all its points."""
    if not len(actor.model.solid_faces):
        return Pool(actor.model.solid_vertices, None)
    return Pool(*meshes.sample_surface(actor.model, _POOL * points, rng))


def camera_poses(world: World) -> tuple[Pose, Pose]:
    """Poses of the left and the right camera over the frames."""
    T_wc = world.T_wc(world.t_s)
    return T_wc, T_wc @ world.rig.T_rl.inv()


def visibility(world: World, who: int, pool: Pool, occlusion: bool) -> tuple[Float[Array, "m p 4"], Bool[Array, "m p"]]:
    """Noise-free pixels of every pool point of one vehicle in every frame, and whether both cameras see it."""
    actor = world.actors[who]
    cameras = camera_poses(world)
    T_wv = actor.trajectory.pose(world.t_s)
    shape = (len(world.t_s), len(pool.point_v))
    uv, seen = np.full((*shape, 4), np.nan), np.zeros(shape, bool)
    for k in range(len(world.t_s)):
        points_c = (cameras[0][k].inv() @ T_wv[k]).apply(pool.point_v)
        uv[k] = world.rig.project(points_c)
        seen[k] = world.rig.left.contains(uv[k, :, :2], 1.0) & world.rig.right.contains(uv[k, :, 2:], 1.0)
        for T_wc in cameras:
            if seen[k].any():
                seen[k, seen[k]] = _unhidden(world, who, pool, T_wc[k], k, seen[k], occlusion)
    if actor.occlusion is not None:
        seen &= _label_occlusion(actor.occlusion, uv)
    return uv, seen


def _unhidden(
    world: World, who: int, pool: Pool, T_wc: Pose, k: int, rows: Bool[Array, "p"], occlusion: bool
) -> Bool[Array, "s"]:
    """Whether nothing stands between one camera and the pool's selected points at frame k."""
    T_cw = T_wc.inv()
    t = world.t_s[k]
    T_cv = T_cw @ world.actors[who].trajectory.pose(t)
    points_c = T_cv.apply(pool.point_v[rows])
    result = np.ones(len(points_c), bool)
    if pool.normal_v is not None:
        result &= facing(points_c, pool.normal_v[rows] @ T_cv.R.T)
    if not occlusion:
        return result
    things = [(a.model, T_cw @ a.trajectory.pose(t)) for a in world.actors] + [
        (p.model, T_cw @ p.T_wb) for p in world.props
    ]
    for model, T_cb in things:
        if len(model.solid_faces) and result.any() and _in_the_way(model.solid_vertices, T_cb, points_c):
            triangles = T_cb.apply(model.solid_vertices)[model.solid_faces]
            result[result] = ~hidden(points_c[result], triangles)
    return result


def _in_the_way(vertices: Array, T_cb: Pose, points_c: Array) -> bool:
    """Whether a thing's bounding box can touch the rays to the points: nearer than the farthest, and in their cone."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre, radius = T_cb.apply((low + high) / 2), float(np.linalg.norm(high - low)) / 2
    distance = np.linalg.norm(centre)
    reach = np.linalg.norm(points_c, axis=1).max()
    if distance - radius > reach:
        return False
    if distance <= radius:
        return True
    axis = points_c.mean(axis=0)
    axis = axis / np.linalg.norm(axis)
    unit = points_c / np.linalg.norm(points_c, axis=1)[:, None]
    spread = np.arccos(np.clip((unit @ axis).min(), -1, 1))
    return bool(np.arccos(np.clip(centre @ axis / distance, -1, 1)) <= spread + np.arcsin(radius / distance))


def _label_occlusion(level: Int[Array, "m"], uv: Float[Array, "m p 4"]) -> Bool[Array, "m p"]:
    """What a replayed label's occlusion leaves of the vehicle: its left part hidden, nothing in a gap (-1)."""
    u = uv[:, :, 0]
    empty = ~np.isfinite(u).any(axis=1)
    u = np.where(empty[:, None], 0.0, u)
    low, high = np.nanmin(u, axis=1, keepdims=True), np.nanmax(u, axis=1, keepdims=True)
    share = _HIDDEN_SHARE[np.clip(level, 0, 3)][:, None]
    return np.asarray((u >= low + share * (high - low)) & (level >= 0)[:, None] & ~empty[:, None])


def scripted(pool: Pool, events: Sequence[Event], frames: int) -> Bool[Array, "m p"]:
    """What the scripted births and deaths leave of the pool's points in every frame."""
    left = np.ones((frames, len(pool.point_v)), bool)
    for event in events:
        axis, sign = _SIDES[event.side]
        outwards = sign * pool.point_v[:, axis]
        outermost = outwards >= outwards.max() - event.depth_m
        gone = slice(None, event.frame) if event.kind == "birth" else slice(event.frame, None)
        left[gone, outermost] = False
    return left


@dataclass(frozen=True, eq=False)
class Rows:
    """Track bookkeeping: frame (n,), track (n,) and pool point (n,) of every observation, sorted by (frame, track)."""

    frame: Int[Array, "n"]
    track: Int[Array, "n"]
    point: Int[Array, "n"]


def follow(seen: Bool[Array, "m p"], capacity: int) -> Rows:
    """Tracks begin and end with the visibility of their points, at most ``capacity`` at a time.

    A lost track is replaced by the next point in pool order that is visible and not in use; a point that comes back
    into view begins a new track, as a front end would do.
    """
    current: dict[int, int] = {}  # pool point -> track
    rows: list[tuple[int, int, int]] = []
    begun = 0
    for k, visible in enumerate(seen):
        current = {p: t for p, t in current.items() if visible[p]}
        for p in np.flatnonzero(visible):
            if len(current) >= capacity:
                break
            if int(p) not in current:
                current[int(p)] = begun
                begun += 1
        rows += sorted((k, t, p) for p, t in current.items())
    table = np.array(rows, int).reshape(-1, 3)
    return Rows(table[:, 0], table[:, 1], table[:, 2])


def pixel_noise(seed: int, run: int, entity: str, shape: tuple[int, int]) -> Float[Array, "m p 4"]:
    """Unit noise of every pool point in every frame, drawn whether it is seen or not: left and right are independent
    streams, and what hides a point never shifts another's noise."""
    sides = [stream(seed, run, f"{entity}/{side}/noise").standard_normal((*shape, 2)) for side in ("left", "right")]
    return np.concatenate(sides, axis=2)


def project_points(rig: StereoRig, T_cb: Pose, points_b: Float[Array, "p 3"]) -> Float[Array, "m p 4"]:
    """Pixels of body points over the frames of T_cb (m,)."""
    return rig.project(np.einsum("mab,pb->mpa", T_cb.R, points_b) + T_cb.t[:, None])
