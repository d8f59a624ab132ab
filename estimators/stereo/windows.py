"""Which frames and tracks enter an adjustment: Siegemund 2008, 3.2 and 3.3."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Int

Array = np.ndarray

# A rigid motion between two frames needs three points.
MIN_POINTS = 3


def sliding(frames: Int[Array, "f"], newest: int, size: int) -> Int[Array, "m"]:
    """The last ``size`` observed frames up to ``newest``: the window grows from the start and skips missing frames."""
    return np.asarray(frames[frames <= newest][-size:])


def select(
    frame: Int[Array, "k"], track: Int[Array, "k"], window: Int[Array, "m"], min_overlap: int
) -> tuple[Bool[Array, "k"], Int[Array, "w"]]:
    """Rows that enter the adjustment, and the frames of the window that hang together.

    Going back from the newest frame, a frame stays while it shares at least three tracks with those that stay; then
    tracks in fewer than ``min_overlap`` (at least 2) of these frames leave. Empty rows mean there is no such window.
    """
    presence = {int(t): set(track[frame == t].tolist()) for t in window}
    kept = [int(window[-1])]
    linked = set(presence[kept[0]])
    for t in window[-2::-1]:
        if len(linked & presence[int(t)]) >= MIN_POINTS:
            kept.append(int(t))
            linked |= presence[int(t)]
    frames = np.array(sorted(kept))
    rows = np.isin(frame, frames)
    while rows.any():
        ids, counts = np.unique(track[rows], return_counts=True)
        rows &= np.isin(track, ids[counts >= max(2, min(min_overlap, len(frames)))])
        supported = np.array([np.count_nonzero(rows & (frame == t)) >= MIN_POINTS for t in frames])
        if supported.all():
            break
        frames = frames[supported]
        rows &= np.isin(frame, frames)
    return rows, frames
