"""Which frames and tracks enter a window."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from estimators.stereo.windows import MIN_POINTS, select, sliding

Array = np.ndarray


def table(keep: list[str]) -> tuple[Array, Array]:
    """One string a frame, one character a track, '.' where it is not seen."""
    frame, track = np.nonzero(np.array([[c != "." for c in line] for line in keep]))
    return frame, 10 * track


def test_a_sliding_window_grows_then_slides_and_skips_missing_frames() -> None:
    frames = np.array([0, 1, 2, 5, 6, 9])
    windows = [sliding(frames, newest, 3).tolist() for newest in range(10)]
    assert windows == [
        [0], [0, 1], [0, 1, 2], [0, 1, 2], [0, 1, 2], [1, 2, 5], [2, 5, 6], [2, 5, 6], [2, 5, 6], [5, 6, 9],
    ]  # fmt: skip


def chosen(keep: list[str], min_overlap: int = 2, window: list[int] | None = None) -> tuple[list[str], list[int]]:
    frame, track = table(keep)
    rows, frames = select(frame, track, np.array(range(len(keep)) if window is None else window), min_overlap)
    grid = np.full((len(keep), len(keep[0])), ".")
    grid[frame[rows], track[rows] // 10] = "x"
    return ["".join(line) for line in grid], frames.tolist()


def test_what_is_seen_everywhere_enters() -> None:
    assert chosen(["xxxx"] * 3) == (["xxxx"] * 3, [0, 1, 2])


def test_only_the_window_s_frames_enter() -> None:
    assert chosen(["xxxx"] * 4, window=[1, 3]) == (["....", "xxxx", "....", "xxxx"], [1, 3])


def test_short_tracks_leave() -> None:
    keep = ["xxxx..", "xxxxx.", "xxxx.x"]
    assert chosen(keep) == (["xxxx..", "xxxx..", "xxxx.."], [0, 1, 2])
    keep = ["xxx.x", "xxxxx", "xxxx."]
    assert chosen(keep, 2)[0] == keep
    assert chosen(keep, 3)[0] == ["xxx..", "xxx..", "xxx.."]


def test_a_longer_overlap_than_the_window_is_the_window() -> None:
    assert chosen(["xxx", "xxx"], 5) == (["xxx", "xxx"], [0, 1])


def test_frames_hang_together_over_others() -> None:
    """The first frame shares three tracks with the middle one, none with the newest."""
    keep = ["xxx...", "xxxxxx", "...xxx"]
    assert chosen(keep) == (keep, [0, 1, 2])


def test_frames_that_share_too_few_tracks_leave() -> None:
    assert chosen(["xx.xxx...", "xxxxxx...", "......xxx"])[1] in ([2], [])
    # Two common tracks with the rest are not enough.
    assert chosen(["xxx....", ".xxxxx.", "..xxxxx"]) == ([".......", "..xxxx.", "..xxxx."], [1, 2])


def test_a_frame_that_loses_its_tracks_leaves_too() -> None:
    """The oldest frame hangs on tracks that the overlap takes away."""
    keep = ["xxx...", "xxxxxx", "...xxx", "...xxx"]
    assert chosen(keep, 3) == (["......", "...xxx", "...xxx", "...xxx"], [1, 2, 3])


def test_no_overlap_gives_no_rows() -> None:
    rows, frames = select(*table(["xxx...", "...xxx"]), np.array([0, 1]), 2)
    assert not rows.any()
    assert len(frames) < 2


@given(hnp.arrays(bool, st.tuples(st.integers(2, 7), st.integers(1, 9))), st.integers(2, 5))
def test_properties_of_every_selection(keep: Array, min_overlap: int) -> None:
    frame, track = np.nonzero(keep)
    rows, frames = select(frame, track, np.arange(len(keep)), min_overlap)
    assert np.isin(frame[rows], frames).all()
    assert (np.diff(frames) > 0).all()
    if not rows.any():
        return
    # Every frame is supported and every track long enough.
    for t in frames:
        assert np.count_nonzero(rows & (frame == t)) >= MIN_POINTS
    _, counts = np.unique(track[rows], return_counts=True)
    assert (counts >= max(2, min(min_overlap, len(frames)))).all()


@pytest.mark.parametrize("min_overlap", [2, 3])
def test_inputs_are_not_touched(min_overlap: int) -> None:
    frame, track = table(["xxx.", "xxxx", ".xxx"])
    before = frame.copy(), track.copy()
    select(frame, track, np.arange(3), min_overlap)
    np.testing.assert_array_equal(frame, before[0])
    np.testing.assert_array_equal(track, before[1])
