"""Labelled outliers of all the kinds of Siegemund 2008, 3.4.1, applied to whole tracks of a finished measurement.

Every kind is a function of the draft and the tracks it may spoil; it returns a new draft whose changed rows carry its
label. ``uv_true`` keeps the noise-free pixels of the track's material point, so that every error stays measurable.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import truncnorm

from sim.measure import camera_poses, make_pool, project_points, visibility
from sim.scenario import (
    NoiseOutlier,
    Outlier,
    ReflectionOutlier,
    SegmentationOutlier,
    Spec,
    StereoOutlier,
    TemporalOutlier,
)
from sim.visibility import facing
from sim.world import World

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Draft:
    """Measured rows before they are split into observations and truth.

    frame, track, point (n,) with point an index into the target's pool; uv_true (n, 4) noise-free, uv (n, 4) measured
    pixels; kind (n,) 0 for an inlier, else 1 + index of the outlier spec; keep (n,) rows that remain.
    """

    frame: Int[Array, "n"]
    track: Int[Array, "n"]
    point: Int[Array, "n"]
    uv_true: Float[Array, "n 4"]
    uv: Float[Array, "n 4"]
    kind: Int[Array, "n"]
    keep: Bool[Array, "n"]


@dataclass(frozen=True, eq=False)
class Setting:
    """What an outlier may draw on: the world, the target's noise-free pixels pool_uv (m, p, 4) and their visibility."""

    world: World
    pool_uv: Float[Array, "m p 4"]
    pool_seen: Bool[Array, "m p"]


def choose_tracks(
    tracks: Int[Array, "k"], outliers: Sequence[Outlier], rng: np.random.Generator
) -> list[Int[Array, "c"]]:
    """Disjoint random choices of tracks, each the rounded share of its outlier kind."""
    shuffled = rng.permutation(tracks)
    edges = np.rint(np.cumsum([0.0] + [o.tracks for o in outliers]) * len(tracks)).astype(int)
    return [np.sort(shuffled[a:b]) for a, b in itertools.pairwise(edges)]


def _some_rows(draft: Draft, track: int, count: int, rng: np.random.Generator) -> Int[Array, "c"]:
    rows = np.flatnonzero(draft.track == track)
    return np.sort(rng.choice(rows, min(count, len(rows)), replace=False))


def _changed(draft: Draft, rows: Array, uv: Array, kind: int) -> Draft:
    new_uv, new_kind = draft.uv.copy(), draft.kind.copy()
    new_uv[rows], new_kind[rows] = uv, kind
    return replace(draft, uv=new_uv, kind=new_kind)


def add_noise(draft: Draft, o: NoiseOutlier, tracks: Array, kind: int, _: Setting, rng: np.random.Generator) -> Draft:
    """Coarse noise of at least min_px in each of the four coordinates of some frames (3.4.4)."""
    rows = np.concatenate([_some_rows(draft, t, o.frames, rng) for t in tracks.tolist()] or [np.empty(0, int)])
    size = (len(rows), 4)
    magnitude = truncnorm.ppf(rng.uniform(size=size), o.min_px / o.sigma_px, np.inf) * o.sigma_px
    return _changed(draft, rows, draft.uv_true[rows] + magnitude * rng.choice([-1.0, 1.0], size), kind)


def wrong_stereo(
    draft: Draft, o: StereoOutlier, tracks: Array, kind: int, setting: Setting, rng: np.random.Generator
) -> Draft:
    """In some frames the right coordinates are those of another surface point near the same image row.

    As a matcher does, it looks only where the rays meet in front of the cameras.
    """
    rig = setting.world.rig
    uv = draft.uv.copy()
    rows = np.concatenate([_some_rows(draft, t, o.frames, rng) for t in tracks.tolist()] or [np.empty(0, int)])
    for r in rows:
        k, noise = draft.frame[r], draft.uv[r] - draft.uv_true[r]
        others = setting.pool_uv[k][setting.pool_seen[k]]
        own = draft.uv_true[r]
        row_distance, shift = np.abs(others[:, 3] - own[3]), np.abs(others[:, 2] - own[2])
        far = rig.right.project(rig.T_rl.R @ rig.left.unproject(own[:2], np.array(1.0)))[0] - 1.0
        candidates = others[(row_distance < 2.0) & (shift > 3.0) & (others[:, 2] < far)]
        if len(candidates):
            uv[r, 2:] = rng.choice(candidates)[2:] + noise[2:]
        else:
            step = rng.choice([-1.0, 1.0]) * rng.uniform(3.0, 12.0)
            uv[r, 2] += step if own[2] + step < far else -abs(step)
    return _changed(draft, rows, uv[rows], kind)


def wrong_temporal(
    draft: Draft, o: TemporalOutlier, tracks: Array, kind: int, setting: Setting, rng: np.random.Generator
) -> Draft:
    """From a random frame of its life on, the track follows another surface point within radius_px."""
    uv, keep = draft.uv.copy(), draft.keep.copy()
    changed: list[int] = []
    for t in tracks:
        rows = np.flatnonzero(draft.track == t)
        if len(rows) < 2:
            continue
        after = rows[rng.integers(1, len(rows)) :]
        k = draft.frame[after[0]]
        distance = np.linalg.norm(setting.pool_uv[k, :, :2] - draft.uv_true[after[0], :2], axis=1)
        near = np.flatnonzero(setting.pool_seen[k] & (distance > 3.0) & (distance <= o.radius_px))
        if not len(near):
            near = np.flatnonzero(setting.pool_seen[k] & (distance > 3.0))
        if not len(near):
            continue
        other = rng.choice(near)
        noise = draft.uv[after] - draft.uv_true[after]
        uv[after] = setting.pool_uv[draft.frame[after], other] + noise
        keep[after] &= setting.pool_seen[draft.frame[after], other]
        changed += after.tolist()
    return replace(_changed(draft, np.array(changed, int), uv[changed], kind), keep=keep)


def wrong_segmentation(
    draft: Draft, o: SegmentationOutlier, tracks: Array, kind: int, setting: Setting, rng: np.random.Generator
) -> Draft:
    """The whole track lies on a neighbour vehicle or on the background instead of the target."""
    if o.on == "background":
        uv_other, seen = _background(setting, rng, 4 * max(len(tracks), 1))
    else:
        who = next(i for i, a in enumerate(setting.world.actors) if a.name == o.on)
        pool = make_pool(setting.world.actors[who], max(len(tracks), 1), rng)
        uv_other, seen = visibility(setting.world, who, pool, occlusion=True)
    uv, keep = draft.uv.copy(), draft.keep.copy()
    changed: list[int] = []
    for t in tracks:
        rows = np.flatnonzero(draft.track == t)
        frames = draft.frame[rows]
        lives = seen[frames].sum(axis=0)
        other = rng.choice(np.flatnonzero(lives == lives.max()))
        uv[rows] = uv_other[frames, other] + draft.uv[rows] - draft.uv_true[rows]
        keep[rows] &= seen[frames, other]
        changed += rows.tolist()
    return replace(_changed(draft, np.array(changed, int), uv[changed], kind), keep=keep)


def _background(setting: Setting, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Static world points that appear just outside the target's outline at some frame."""
    world = setting.world
    T_wc, _ = camera_poses(world)
    points = np.full((count, 3), np.nan)
    frames_with_target = np.flatnonzero(setting.pool_seen.any(axis=1))
    for i in range(count if len(frames_with_target) else 0):
        k = rng.choice(frames_with_target)
        uv = setting.pool_uv[k][setting.pool_seen[k], :2]
        low, high = uv.min(axis=0), uv.max(axis=0)
        side = rng.choice([-1.0, 1.0])
        u = (high[0] if side > 0 else low[0]) + side * rng.uniform(0.02, 0.25) * max(high[0] - low[0], 10.0)
        v = rng.uniform(low[1], high[1] + 0.1 * (high[1] - low[1]))
        T_wv = world.actors[world.target].trajectory.pose(world.t_s[k])
        depth = T_wc[k].inv().apply(T_wv.t)[2] + rng.uniform(1.0, 15.0)
        ray_w = T_wc[k].R @ world.rig.left.unproject(np.array([u, v]), np.array(1.0))
        to_ground = -T_wc[k].t[2] / ray_w[2] if ray_w[2] < 0 else np.inf
        points[i] = T_wc[k].t + min(depth, to_ground) * ray_w
    uv = project_points(world.rig, T_wc.inv(), points)
    rig = world.rig
    return uv, rig.left.contains(uv[..., :2], 1.0) & rig.right.contains(uv[..., 2:], 1.0)


def reflection(
    draft: Draft, _: ReflectionOutlier, tracks: Array, kind: int, setting: Setting, _rng: np.random.Generator
) -> Draft:
    """The track follows the mirror image of a distant light on the body, taken as an ellipsoid in its bounding box.

    Both cameras see their own mirror point: the one whose normal halves the angle between light and camera. Rows where
    that point faces away from a camera are lost.
    """
    world = setting.world
    actor = world.actors[world.target]
    low, high = actor.model.solid_vertices.min(axis=0), actor.model.solid_vertices.max(axis=0)
    centre, axes = (low + high) / 2, (high - low) / 2
    T_wv = actor.trajectory.pose(world.t_s)
    uv, keep = draft.uv.copy(), draft.keep.copy()
    changed: list[int] = []
    for t in tracks:
        rows = np.flatnonzero(draft.track == t)
        frames = draft.frame[rows]
        light_v = _light_for(draft, int(rows[0]), setting, centre, axes)
        light_w = T_wv.R[frames[0]] @ light_v
        for side, T_wc in enumerate(camera_poses(world)):
            eye_v = np.einsum("mba,mb->ma", T_wv.R[frames], T_wc.t[frames] - T_wv.t[frames]) - centre
            p, normal = _mirror_point(eye_v, np.einsum("mba,b->ma", T_wv.R[frames], light_w), axes)
            p_c = (T_wc[frames].inv() @ T_wv[frames]).apply(centre + p)
            camera = world.rig.left if side == 0 else world.rig.right
            columns = slice(2 * side, 2 * side + 2)
            pixels = camera.project(p_c)
            uv[rows, columns] = pixels + (draft.uv - draft.uv_true)[rows, columns]
            keep[rows] &= camera.contains(pixels, 1.0) & facing(p - eye_v, normal)
        changed += rows.tolist()
    return replace(_changed(draft, np.array(changed, int), uv[changed], kind), keep=keep)


def _mirror_point(eye: Array, light: Array, axes: Array) -> tuple[Array, Array]:
    """Points (m, 3) of the ellipsoid, and their normals, that mirror a distant light (m, 3) into the eye (m, 3)."""
    p = np.zeros_like(eye)
    for _ in range(50):  # half steps: whole ones overshoot where the light grazes the body
        towards = (eye - p) / np.linalg.norm(eye - p, axis=1)[:, None]
        normal = towards + light
        normal = normal / np.linalg.norm(normal, axis=1)[:, None]
        p = (p + axes**2 * normal / np.linalg.norm(axes * normal, axis=1)[:, None]) / 2
    return p, normal


def _light_for(draft: Draft, row: int, setting: Setting, centre: Array, axes: Array) -> Array:
    """Direction (vehicle frame at the track's first frame) of a light mirrored where the track begins."""
    world = setting.world
    k = draft.frame[row]
    T_vc = world.actors[world.target].trajectory.pose(world.t_s[k]).inv() @ world.T_wc(world.t_s[k])
    ray = T_vc.R @ world.rig.left.unproject(draft.uv_true[row, :2], np.array(1.0))
    eye = T_vc.t - centre
    # Where the ray meets the ellipsoid, or passes nearest to it.
    a, b = ray / axes, eye / axes
    A, B, C = a @ a, 2 * a @ b, b @ b - 1
    s = (-B - np.sqrt(max(B * B - 4 * A * C, 0.0))) / (2 * A)
    normal = (eye + s * ray) / axes**2
    normal = normal / np.linalg.norm(normal)
    towards = -ray / np.linalg.norm(ray)
    return np.asarray(2 * (normal @ towards) * normal - towards)


_KINDS: dict[type[Spec], Callable[..., Draft]] = {
    NoiseOutlier: add_noise,
    StereoOutlier: wrong_stereo,
    TemporalOutlier: wrong_temporal,
    SegmentationOutlier: wrong_segmentation,
    ReflectionOutlier: reflection,
}


def apply_outliers(
    draft: Draft,
    outliers: Sequence[Outlier],
    setting: Setting,
    make_stream: Callable[[str], np.random.Generator],
) -> Draft:
    """All outliers of a scenario, each kind on its own tracks with its own random stream."""
    chosen = choose_tracks(np.unique(draft.track), outliers, make_stream("outliers/choice"))
    for i, (outlier, tracks) in enumerate(zip(outliers, chosen, strict=True)):
        draft = _KINDS[type(outlier)](draft, outlier, tracks, i + 1, setting, make_stream(f"outliers/{i}"))
    return draft
