"""Outliers: every kind spoils what it says it spoils, labels exactly that, and leaves the rest bit by bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.measure import camera_poses, make_pool, visibility
from sim.noise import choose_tracks
from sim.observations import Observations
from sim.scenario import NoiseOutlier, ReflectionOutlier, Scenario
from sim.simulate import simulate
from sim.streams import stream
from sim.truth import Truth
from sim.world import World

Array = np.ndarray

SPECS: dict[str, dict[str, Any]] = {
    "noise": {"kind": "noise", "tracks": 0.2, "frames": 4, "sigma_px": 2.0, "min_px": 1.5},
    "stereo": {"kind": "stereo", "tracks": 0.2, "frames": 3},
    "temporal": {"kind": "temporal", "tracks": 0.2, "radius_px": 30.0},
    "neighbour": {"kind": "segmentation", "tracks": 0.2, "on": "neighbour"},
    "background": {"kind": "segmentation", "tracks": 0.2, "on": "background"},
    "reflection": {"kind": "reflection", "tracks": 0.2},
}
every_kind = pytest.mark.parametrize("kind", SPECS)


@dataclass(frozen=True)
class Run:
    """Rows of one simulation by (frame, track), beside those of the same scene without outliers."""

    observations: Observations
    truth: Truth
    clean: Observations
    clean_truth: Truth

    @property
    def row_in_clean(self) -> Array:
        """Row of the clean run with the same frame and track, for every row."""
        keys = {k: i for i, k in enumerate(zip(self.clean.tracks.frame, self.clean.tracks.track, strict=True))}
        t = self.observations.tracks
        return np.array([keys[k] for k in zip(t.frame, t.track, strict=True)])

    @property
    def labelled(self) -> Array:
        return self.truth.labels.kind > 0


@pytest.fixture(scope="module")
def run(make_scenario: Callable[..., Scenario], world: World) -> Callable[..., Run]:
    clean = simulate(make_scenario(), 0, world)
    cache: dict[tuple[str, ...], Run] = {}

    def make(*kinds: str) -> Run:
        if kinds not in cache:
            share = 0.2 if len(kinds) == 1 else 0.1
            outliers = [SPECS[k] | {"tracks": share} for k in kinds]
            cache[kinds] = Run(*simulate(make_scenario(outliers=outliers), 0, world), *clean)
        return cache[kinds]

    return make


@every_kind
def test_what_is_not_labelled_is_untouched(run: Callable[..., Run], kind: str) -> None:
    r = run(kind)
    rows, good = r.row_in_clean, ~r.labelled
    np.testing.assert_array_equal(r.observations.tracks.uv[good], r.clean.tracks.uv[rows[good]])
    # What a track's material point does is known for all rows.
    np.testing.assert_array_equal(r.truth.labels.uv_true, r.clean_truth.labels.uv_true[rows])
    assert r.truth.labels.kinds == (SPECS[kind]["kind"],)


@every_kind
def test_what_is_labelled_is_changed(run: Callable[..., Run], kind: str) -> None:
    r = run(kind)
    rows, bad = r.row_in_clean, r.labelled
    assert bad.any()
    # A wrong match by chance at the very same pixels has probability zero.
    assert np.any(r.observations.tracks.uv[bad] != r.clean.tracks.uv[rows[bad]], axis=1).all()
    assert set(r.truth.labels.kind[bad]) == {1}


@every_kind
def test_only_rows_of_spoilt_tracks_are_lost(run: Callable[..., Run], kind: str) -> None:
    r = run(kind)
    lost = np.setdiff1d(np.arange(len(r.clean.tracks)), r.row_in_clean)
    whole = np.setdiff1d(np.unique(r.clean.tracks.track), np.unique(r.clean.tracks.track[lost]))
    spoilt = np.unique(r.observations.tracks.track[r.labelled])
    all_tracks = np.unique(r.clean.tracks.track)
    if kind in ("noise", "stereo"):
        assert not len(lost)
    # Tracks with losses were chosen: as many at most as the share, whether something of them remains or not.
    chosen = np.union1d(np.setdiff1d(all_tracks, whole), spoilt)
    assert len(chosen) <= round(0.2 * len(all_tracks))


@pytest.mark.parametrize("kind", ["noise", "stereo"])
def test_the_share_is_exact(run: Callable[..., Run], kind: str) -> None:
    """Kinds that lose no row."""
    r = run(kind)
    assert len(np.unique(r.observations.tracks.track[r.labelled])) == round(0.2 * len(r.clean_truth.track))


@given(st.integers(0, 200), st.lists(st.floats(0, 0.25), min_size=1, max_size=4), st.integers(0, 1000))
def test_choices_are_disjoint_and_of_the_stated_share(n: int, shares: list[float], seed: int) -> None:
    tracks = 3 * np.arange(n) + 1
    outliers = [NoiseOutlier(kind="noise", tracks=s) for s in shares]
    chosen = choose_tracks(tracks, outliers, np.random.default_rng(seed))
    everything = np.concatenate(chosen)
    assert len(set(everything.tolist())) == len(everything)
    assert np.isin(everything, tracks).all()
    # Shares are rounded cumulatively: each is off by less than one, all together by half of one.
    assert all(abs(len(c) - s * n) <= 1 for c, s in zip(chosen, shares, strict=True))
    assert abs(len(everything) - sum(shares) * n) <= 0.5 + 1e-9


def test_all_tracks_can_be_outliers() -> None:
    outliers = [NoiseOutlier(kind="noise", tracks=0.5), ReflectionOutlier(kind="reflection", tracks=0.5)]
    chosen = choose_tracks(np.arange(7), outliers, np.random.default_rng(0))
    np.testing.assert_array_equal(np.sort(np.concatenate(chosen)), np.arange(7))


def test_kinds_together_are_disjoint(run: Callable[..., Run]) -> None:
    r = run(*SPECS)
    tracks, kind = r.observations.tracks.track, r.truth.labels.kind
    assert set(kind) == set(range(7))
    for t in np.unique(tracks):
        assert len(set(kind[(tracks == t) & (kind > 0)])) <= 1
    rows, good = r.row_in_clean, kind == 0
    np.testing.assert_array_equal(r.observations.tracks.uv[good], r.clean.tracks.uv[rows[good]])


def test_noise_is_coarse_and_no_more_frequent_than_stated(run: Callable[..., Run]) -> None:
    r = run("noise")
    error = r.observations.tracks.uv - r.truth.labels.uv_true
    bad, tracks = r.labelled, r.observations.tracks.track
    assert np.abs(error[bad]).min() >= 1.5
    for t in np.unique(tracks[bad]):
        assert np.count_nonzero(bad & (tracks == t)) == min(4, np.count_nonzero(tracks == t))
    # |N(0, 2)| beyond 1.5: mean 2 phi(0.75) / (2 (1 - Phi(0.75))) * 2 = 2.658, standard deviation 0.94.
    n = 4 * np.count_nonzero(bad)
    assert np.abs(error[bad]).mean() == pytest.approx(2.658, abs=4 * 0.94 / np.sqrt(n))
    assert abs(np.count_nonzero(error[bad] > 0) - n / 2) < 4 * np.sqrt(n) / 2


def test_wrong_stereo_lies_near_the_epipolar_line(run: Callable[..., Run]) -> None:
    r = run("stereo")
    uv, true, bad = r.observations.tracks.uv, r.truth.labels.uv_true, r.labelled
    rows = r.row_in_clean
    # The left image is not concerned.
    np.testing.assert_array_equal(uv[bad, :2], r.clean.tracks.uv[rows[bad], :2])
    # Another point within 2 px of the row and beyond 3 px along it, and the noise of 5 sigma.
    assert np.abs(uv[bad, 3] - true[bad, 3]).max() < 2 + 1
    assert np.abs(uv[bad, 2] - true[bad, 2]).min() > 3 - 1
    tracks = r.observations.tracks.track
    for t in np.unique(tracks[bad]):
        assert np.count_nonzero(bad & (tracks == t)) == min(3, np.count_nonzero(tracks == t))


def test_wrong_temporal_jumps_to_a_near_point_and_stays_with_it(run: Callable[..., Run], world: World) -> None:
    r = run("temporal")
    pool = make_pool(world.actors[0], 60, stream(7, 0, "target/surface/points"))
    pool_uv, seen = visibility(world, 0, pool, True)
    noise = r.clean.tracks.uv - r.clean_truth.labels.uv_true
    tracks, frames = r.observations.tracks.track, r.observations.tracks.frame
    true_now = r.observations.tracks.uv - noise[r.row_in_clean]
    jumps = 0
    for t in np.unique(tracks[r.labelled]):
        rows = np.flatnonzero((tracks == t) & r.labelled)
        # Never before the second frame of its life, and every row after it.
        life = np.flatnonzero(r.clean.tracks.track == t)
        assert frames[rows[0]] > r.clean.tracks.frame[life[0]]
        assert (r.labelled[(tracks == t) & (frames >= frames[rows[0]])]).all()
        distance = np.abs(pool_uv[frames[rows]] - true_now[rows][:, None]).max(axis=2)
        other = np.argmin(distance.max(axis=0))
        # One and the same surface point, seen in all these frames.
        assert distance[:, other].max() < 1e-9
        assert seen[frames[rows], other].all()
        first = r.row_in_clean[rows[0]]
        jump = np.linalg.norm(true_now[rows[0], :2] - r.clean_truth.labels.uv_true[first, :2])
        assert jump > 3
        within = np.linalg.norm(pool_uv[frames[rows[0]], :, :2] - r.truth.labels.uv_true[rows[0], :2], axis=1)
        candidates = seen[frames[rows[0]]] & (within > 3) & (within <= 30)
        began = np.flatnonzero(life == first)[0] > 0
        if candidates.any() and began:
            jumps += jump <= 30
    assert jumps == len(np.unique(tracks[r.labelled]))


def test_wrong_segmentation_moves_with_the_neighbour(run: Callable[..., Run], world: World) -> None:
    r = run("neighbour")
    noise = r.clean.tracks.uv - r.clean_truth.labels.uv_true
    uv = (r.observations.tracks.uv - noise[r.row_in_clean])[r.labelled]
    frames, tracks = r.observations.tracks.frame[r.labelled], r.observations.tracks.track[r.labelled]
    # Triangulated in the normal case, the points stand still with the van, on its body.
    K, base = world.rig.left.K, 0.3
    z = K[0, 0] * base / (uv[:, 0] - uv[:, 2])
    p_c = np.column_stack([(uv[:, 0] - K[0, 2]) / K[0, 0] * z, (uv[:, 1] - K[1, 2]) / K[1, 1] * z, z])
    van = world.actors[1]
    p_v = np.array(
        [
            van.trajectory.pose(world.t_s[k]).inv().apply(camera_poses(world)[0][k].apply(p))
            for k, p in zip(frames, p_c, strict=True)
        ]
    )
    low, high = van.model.solid_vertices.min(axis=0), van.model.solid_vertices.max(axis=0)
    assert (p_v > low - 1e-6).all()
    assert (p_v < high + 1e-6).all()
    for t in np.unique(tracks):
        np.testing.assert_allclose(
            p_v[tracks == t], p_v[tracks == t][:1].repeat(np.count_nonzero(tracks == t), 0), atol=1e-6
        )


def test_wrong_segmentation_on_the_background_stands_still(run: Callable[..., Run], world: World) -> None:
    """The camera stands: so do the pixels of the background."""
    r = run("background")
    noise = r.clean.tracks.uv - r.clean_truth.labels.uv_true
    uv = (r.observations.tracks.uv - noise[r.row_in_clean])[r.labelled]
    tracks = r.observations.tracks.track[r.labelled]
    for t in np.unique(tracks):
        np.testing.assert_allclose(
            uv[tracks == t], uv[tracks == t][:1].repeat(np.count_nonzero(tracks == t), 0), atol=1e-9
        )
    # Behind the target's start (it drives closer), in front of both cameras.
    depth = world.rig.left.K[0, 0] * 0.3 / (uv[:, 0] - uv[:, 2])
    assert (depth > 2).all()
    assert np.abs(uv[:, 1] - uv[:, 3]).max() < 1e-9


@pytest.mark.parametrize("kind", ["neighbour", "background", "reflection"])
def test_foreign_tracks_have_no_material_point(run: Callable[..., Run], kind: str) -> None:
    r = run(kind)
    foreign = np.isin(r.truth.track, r.observations.tracks.track[r.labelled])
    assert np.isnan(r.truth.point_v[foreign]).all()
    assert np.isfinite(r.truth.point_v[~foreign]).all()


def test_a_reflection_obeys_the_law_of_reflection(run: Callable[..., Run], world: World) -> None:
    """In each camera: where a point of the ellipsoid shines, its normal halves the angle between camera and light."""
    r = run("reflection")
    noise = r.clean.tracks.uv - r.clean_truth.labels.uv_true
    uv = (r.observations.tracks.uv - noise[r.row_in_clean])[r.labelled]
    frames, tracks = r.observations.tracks.frame[r.labelled], r.observations.tracks.track[r.labelled]
    actor = world.actors[0]
    low, high = actor.model.solid_vertices.min(axis=0), actor.model.solid_vertices.max(axis=0)
    centre, axes = (low + high) / 2, (high - low) / 2
    lights: dict[int, list[Array]] = {}
    for row, (k, t) in enumerate(zip(frames, tracks, strict=True)):
        T_wv = actor.trajectory.pose(world.t_s[k])
        for side, T_wc in enumerate(camera_poses(world)):
            camera = (world.rig.left, world.rig.right)[side]
            pixel = uv[row, 2 * side : 2 * side + 2]
            T_vc = T_wv.inv() @ T_wc[k]
            ray = T_vc.R @ camera.unproject(pixel, np.array(1.0))
            eye = T_vc.t - centre
            a, b = ray / axes, eye / axes
            A, B, C = a @ a, a @ b, b @ b - 1
            p = eye + (-B - np.sqrt(B * B - A * C)) / A * ray
            n = p / axes**2 / np.linalg.norm(p / axes**2)
            towards = (eye - p) / np.linalg.norm(eye - p)
            assert towards @ n > 0
            lights.setdefault(t, []).append(T_wv.R @ (2 * (towards @ n) * n - towards))
    assert len(lights) > 3
    for directions in lights.values():
        # One distant light for all frames and both cameras; the fixed-point iteration ends far below a pixel.
        np.testing.assert_allclose(directions, np.broadcast_to(directions[0], (len(directions), 3)), atol=1e-4)


def test_a_reflection_begins_at_its_track_and_wanders(run: Callable[..., Run]) -> None:
    r = run("reflection")
    noise = r.clean.tracks.uv - r.clean_truth.labels.uv_true
    true_now = r.observations.tracks.uv - noise[r.row_in_clean]
    drift = []
    for t in np.unique(r.observations.tracks.track[r.labelled]):
        rows = np.flatnonzero(r.observations.tracks.track == t)
        shift = np.linalg.norm(true_now[rows, :2] - r.truth.labels.uv_true[rows, :2], axis=1)
        drift.append(shift[-1])
        life = r.clean.tracks.frame[r.clean.tracks.track == t]
        if r.observations.tracks.frame[rows[0]] == life[0]:
            # Corners of the body stand out of the ellipsoid: the light begins where a ray passes nearest.
            assert shift[0] < 60
    # Of 12 tracks some stay long enough to leave their point.
    assert max(drift) > 5
