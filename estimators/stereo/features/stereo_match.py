"""The right image's point of every left one: searched along the epipolar line, then registered below a pixel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from estimators.stereo.features import registration
from estimators.stereo.features.frames import StereoFrame
from estimators.stereo.features.templates import Live, Registered, cut, register
from estimators.stereo.triangulation import triangulate
from sim.camera import StereoRig

if TYPE_CHECKING:
    from estimators.stereo.features.front_end import FrontEnd

Array = np.ndarray
_MISSES = 2  # frames in a row without a right point that end a track
_UNIQUE = 0.9  # the second best place may correlate by this share of the best at most
_FROM_GUESS_PX = 1.5
_SLANT = 0.02  # standard deviation of the disparity's change from pixel to pixel on a vehicle
_FAR_M = 1e4
_NO_MASK = np.empty((0, 0), bool)


@dataclass(frozen=True, eq=False)
class Match:
    """Right points uv (n, 2), the covariance [px²] of finding them (n, 2, 2), which are found (n,), and votes (2,):
    how many of the searched points lie before and behind the cameras."""

    uv: Float[Array, "n 2"]
    cov: Float[Array, "n 2 2"]
    found: Bool[Array, "n"]
    votes: Int[Array, "2"]


def match(
    live: Live,
    rig: StereoRig,
    frame: StereoFrame,
    mask: Bool[Array, "a b"],
    config: FrontEnd,
) -> tuple[Live, Match]:
    """The right points of all live tracks, and the tracks that go on."""
    n = len(live)
    eye = np.tile(np.eye(2), (n, 1, 1))
    patch, weight, inside = cut(frame.left, mask, live.uv, eye, config.patch_px)
    guess = live.uv + live.match
    known = inside & np.isfinite(guess).all(axis=1)
    there = _found(frame, live, patch, weight, np.where(known[:, None], guess, live.uv), rig, config)
    found, votes = known & there.good, np.zeros(2, int)
    new = inside & ~found
    if new.any():
        guess[new], unique, votes = _search(frame.right, patch[new], weight[new], live.uv[new], rig, config)
        again = _found(frame, live.select(new), patch[new], weight[new], guess[new], rig, config)
        there.t[new], there.cov[new], found[new] = again.t, again.cov, again.good & unique
    missed = np.where(found, 0, live.missed + 1)
    live = replace(live, match=np.where(found[:, None], there.t - live.uv, np.nan), missed=missed)
    stays = missed < _MISSES
    return live.select(stays), Match(there.t[stays], there.cov[stays], found[stays], votes)


def _found(
    frame: StereoFrame, live: Live, patch: Array, weight: Array, guess: Array, rig: StereoRig, config: FrontEnd
) -> Registered:
    """The left patches in the right image, near a guess, where what is found there leads back to the left place."""
    eye = np.tile(np.eye(2), (len(live), 1, 1))
    r = register(frame.right, patch, weight, guess, eye, registration.STEREO, _SLANT)
    good = r.good & (r.ncc > config.correlation) & (np.linalg.norm(r.t - guess, axis=1) < _FROM_GUESS_PX)
    seen, _, inside = cut(frame.right, _NO_MASK, r.t, eye, config.patch_px)
    back = register(frame.left, seen, weight, live.uv, eye, registration.STEREO, _SLANT)
    good &= inside & back.good & (np.linalg.norm(back.t - live.uv, axis=1) < config.round_trip_px)
    return replace(r, good=good & _on_epipolar_line(rig, live.uv, r.t, config.epipolar_px))


def _search(
    image: Array, patch: Array, weight: Array, uv: Array, rig: StereoRig, config: FrontEnd
) -> tuple[Array, Array, Array]:
    """The place along each epipolar line whose grey values correlate best, whether it stands out, and `Match.votes`."""
    places, before = _epipolar_places(rig, uv, config.nearest_m)
    behind = 2 * places[:, :1] - places  # the line goes on beyond infinity
    t, ncc = np.array(uv), np.zeros((len(uv), 2))
    registration.best_match(image, patch, weight, places, t, ncc)
    mirrored, other = np.array(uv), np.zeros((len(uv), 2))
    registration.best_match(image, patch, weight, behind, mirrored, other)
    good = before & (ncc[:, 0] > 0.7) & (ncc[:, 1] < _UNIQUE * ncc[:, 0])
    wrong = (other[:, 0] > 0.8) & (other[:, 0] > ncc[:, 0] + 0.1)
    return t, good & ~wrong, np.array([np.count_nonzero(good & ~wrong), np.count_nonzero(wrong)])


def _epipolar_places(rig: StereoRig, uv: Float[Array, "n 2"], nearest_m: float) -> tuple[Array, Array]:
    """Places (n, c, 2) in the right image about a pixel apart, from infinity to the nearest depth, and whether they are
    any (n,)."""
    ends = [rig.project(rig.left.unproject(uv, np.full(len(uv), z)))[:, 2:] for z in (_FAR_M, nearest_m)]
    good = np.isfinite(ends[0]).all(axis=1) & np.isfinite(ends[1]).all(axis=1)
    length = np.linalg.norm(ends[1] - ends[0], axis=1)[good]
    count = int(np.clip(np.ceil(length.max(initial=1)), 2, 1000)) + 1
    share = np.linspace(0, 1, count)
    inverse = (1 - share) / _FAR_M + share / nearest_m
    places = np.full((len(uv), count, 2), -1.0)
    rays = rig.left.unproject(uv[good], np.ones(int(good.sum())))
    places[good] = rig.project(rays[:, None] / inverse[:, None])[..., 2:]
    return np.where(np.isfinite(places), places, -1.0), good


def _on_epipolar_line(rig: StereoRig, uv: Array, uv_right: Array, limit_px: float) -> Bool[Array, "n"]:
    """Whether two points may be of one, in front of both cameras: vertically off by the limit at most."""
    both = np.concatenate([uv, uv_right], axis=1)
    point, _ = triangulate(rig, both, np.broadcast_to(np.eye(4), (len(both), 4, 4)))
    known = np.isfinite(point).all(axis=1)
    off = np.full(len(both), np.inf)
    # The adjusted point shares the misfit between both images.
    off[known] = np.sqrt(2) * np.linalg.norm(both[known] - rig.project(point[known]), axis=1)
    return np.asarray(off < limit_px)
