"""Which frames and tracks enter an adjustment: Siegemund 2008, 3.2 and 3.3.

A strategy takes the observed frames (ascending), the newest frame wanted and the size of the window, and gives the
frames of the window, ascending.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from jaxtyping import Bool, Int

Array = np.ndarray
Strategy = Callable[[Int[Array, "f"], int, int], Int[Array, "m"]]

# A rigid motion between two frames needs three points.
MIN_POINTS = 3
# A thinned window keeps so many newest frames, and half as many in every doubling of the age beyond.
_DENSE = 4


def without(frames: Int[Array, "f"], skipped: Iterable[int]) -> Int[Array, "g"]:
    """The frames but for those known to be bad beforehand, as where a wiper hides the object (3.2.2)."""
    return frames[~np.isin(frames, list(skipped))]


def sliding(frames: Int[Array, "f"], newest: int, size: int) -> Int[Array, "m"]:
    """The last ``size`` observed frames up to ``newest``: the window grows from the start and skips missing frames."""
    return np.asarray(frames[frames <= newest][-size:])


def whole(frames: Int[Array, "f"], newest: int, _size: int) -> Int[Array, "m"]:
    """All observed frames up to ``newest``; the best for a closed sequence, with its last frame as the newest (3.2)."""
    return np.asarray(frames[frames <= newest])


def thinned(frames: Int[Array, "f"], newest: int, size: int) -> Int[Array, "m"]:
    """Old frames live longer while the density falls, so that the size stays: for an object that drives away (3.2.2).

    The source names the idea and leaves it. Here the four newest frames stay, then two in every doubling of the age:
    ten frames reach back over 32. Of ages 4·2^i to 8·2^i every 2^(i+1)-th frame is kept, counted from the first
    observed one, so that a frame that has left never comes back and the last window's poses start the next one.
    """
    seen = frames[frames <= newest]
    if size <= _DENSE:
        return np.asarray(seen[-size:])
    age = np.arange(len(seen))[::-1]
    octave = np.maximum(np.frexp(age / _DENSE)[1], 0)
    octaves, odd = divmod(2 * (size - _DENSE), _DENSE)
    reach = _DENSE * 2**octaves
    kept = (np.arange(len(seen)) % 2**octave == 0) & (age < (reach * 3 // 2 if odd else reach))
    return np.asarray(seen[kept])


STRATEGIES: dict[str, Strategy] = {"sliding": sliding, "whole": whole, "thinned": thinned}


def select(
    frame: Int[Array, "k"], track: Int[Array, "k"], window: Int[Array, "m"], min_overlap: int
) -> tuple[Bool[Array, "k"], Int[Array, "w"]]:
    """Rows that enter the adjustment, and the frames of the window that hang together.

    Rows are sorted by frame, as those of `Tracks`. Going back from the newest frame, a frame stays while it shares at
    least three tracks with those that stay; then tracks in fewer than ``min_overlap`` (at least 2) of these frames
    leave (3.3). Empty rows mean there is no such window.
    """
    starts, ends = np.searchsorted(frame, window), np.searchsorted(frame, window, "right")
    rows = np.concatenate([np.arange(a, b) for a, b in zip(starts, ends, strict=True)])
    seen_track = track[rows]
    ids = np.sort(seen_track)
    ids = ids[np.append(True, ids[1:] != ids[:-1])] if len(ids) else ids
    row, column = np.repeat(np.arange(len(window)), ends - starts), np.searchsorted(ids, seen_track)
    present = np.zeros((len(window), len(ids)), bool)
    present[row, column] = True
    stays = _linked(present)
    present[~stays] = False
    while present.any():
        count = np.count_nonzero(present, axis=0)
        present &= count >= max(2, min(min_overlap, np.count_nonzero(stays)))
        unsupported = stays & (np.count_nonzero(present, axis=1) < MIN_POINTS)
        if not unsupported.any():
            break
        stays &= ~unsupported
        present[unsupported] = False
    entering = np.zeros(len(frame), bool)
    entering[rows] = present[row, column]
    return entering, window[stays]


def _linked(present: Bool[Array, "m n"]) -> Bool[Array, "m"]:
    """Frames that share three tracks with those after them that do."""
    stays = np.zeros(len(present), bool)
    stays[-1] = True
    linked = present[-1].copy()
    for t in range(len(present) - 2, -1, -1):
        if np.count_nonzero(linked & present[t]) >= MIN_POINTS:
            stays[t] = True
            linked |= present[t]
    return stays
