"""Tracks followed from one left image to the next by registration to their template, searched by Lucas-Kanade if lost.

Each step of a tracker from frame to frame adds its error to those before; registering to the template a track was born
with undoes the sum, so that errors of a track are independent in time as long as the template serves.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from estimators.stereo.features import registration
from estimators.stereo.features.templates import Live, Registered, register

if TYPE_CHECKING:
    from estimators.stereo.features.front_end import FrontEnd

Array = np.ndarray
LEVELS = 3
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.01)
_DRIFT_PX = 1.5  # how far the template may lie from where the tracker is; farther off it has found something else
ENOUGH, _GROWTH = 6, 0.2  # tracks that tell a similarity, and what it may grow by in a frame
_SERVES = (0.75, 1.33)  # scale from template to image in which its pixels say the same


def follow(
    live: Live, before: UInt8[Array, "h w"], now: UInt8[Array, "h w"], mask: Bool[Array, "a b"], config: FrontEnd
) -> Live:
    """The tracks that are found in the next left image, there.

    A track goes on as it went; where that finds nothing, or it is new, the tracker searches. How the object grows and
    turns in the image is told by all its tracks together; a track by itself only shifts.
    """
    going = np.isfinite(live.step).all(axis=1)
    uv = np.where(going[:, None], live.uv + live.step, live.uv)
    r = register(now, live.patch, live.weight, uv, live.A, registration.TRANSLATION)
    going &= _held(r, uv, config)
    uv = r.t.copy()
    lost = np.flatnonzero(~going)
    uv[lost], found = round_trip(before, now, live.uv[lost], config)
    seen = going.copy()
    seen[lost] = found
    M, shift = common_motion(live.uv[seen], uv[seen])
    uv[~seen] = live.uv[~seen] @ M.T + shift
    r = register(now, live.patch, live.weight, uv, M @ live.A, registration.TRANSLATION)
    held = _held(r, uv, config)
    live = replace(live, step=r.t - live.uv, uv=r.t, A=r.A, cov=r.cov).select(held)
    scale = np.sqrt(np.abs(np.linalg.det(live.A)))
    return live.renewed(now, mask, (scale < _SERVES[0]) | (scale > _SERVES[1]))


def _held(r: Registered, guess: Float[Array, "n 2"], config: FrontEnd) -> Bool[Array, "n"]:
    return np.asarray(r.good & (r.ncc > config.correlation) & (np.linalg.norm(r.t - guess, axis=1) < _DRIFT_PX))


def common_motion(before: Float[Array, "n 2"], now: Float[Array, "n 2"]) -> tuple[Float[Array, "2 2"], Array]:
    """The similarity of the plane that most tracks follow; no change of size or direction where they are few."""
    if len(before) >= ENOUGH:
        M, _ = cv2.estimateAffinePartial2D(before, now, method=cv2.RANSAC, ransacReprojThreshold=1.0)
        if M is not None and abs(np.sqrt(abs(np.linalg.det(M[:, :2]))) - 1) < _GROWTH:
            return M[:, :2], M[:, 2]
    shift = np.median(now - before, axis=0) if len(before) else np.zeros(2)
    return np.eye(2), shift


def round_trip(
    before: UInt8[Array, "h w"], now: UInt8[Array, "h w"], uv: Float[Array, "n 2"], config: FrontEnd
) -> tuple[Float[Array, "n 2"], Bool[Array, "n"]]:
    """Places in another image by pyramidal Lucas-Kanade there and back, and whether each comes home.

    Both images are cut to what the tracker can reach.
    """
    if not len(uv):
        return uv, np.zeros(0, bool)
    reach = 2 * config.patch_px * 2**LEVELS
    x0, y0 = np.maximum(uv.min(axis=0) - reach, 0).astype(int)
    x1, y1 = (uv.max(axis=0) + reach).astype(int) + 1
    before, now = np.ascontiguousarray(before[y0:y1, x0:x1]), np.ascontiguousarray(now[y0:y1, x0:x1])
    corner, size = np.array([x0, y0]), (config.patch_px + 4,) * 2
    start = (uv - corner).astype(np.float32)
    there, seen, _ = cv2.calcOpticalFlowPyrLK(before, now, start, None, None, None, size, LEVELS, _STOP)
    back, seen_back, _ = cv2.calcOpticalFlowPyrLK(now, before, there, None, None, None, size, LEVELS, _STOP)
    home = np.linalg.norm(back - start, axis=1) < config.round_trip_px
    return there.astype(float) + corner, (seen[:, 0] > 0) & (seen_back[:, 0] > 0) & home
