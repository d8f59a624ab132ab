"""Which frames and tracks enter a window."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from estimators.stereo.windows import MIN_POINTS, STRATEGIES, select, sliding, thinned, whole, without

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


def test_the_whole_window_grows_without_end() -> None:
    frames = np.array([0, 1, 2, 5, 6, 9])
    assert [whole(frames, newest, 3).tolist() for newest in (0, 5, 9)] == [[0], [0, 1, 2, 5], frames.tolist()]


def test_skipped_frames_are_in_no_window() -> None:
    frames = without(np.arange(12), (3, 7, 40))
    for strategy in STRATEGIES.values():
        windows = [strategy(frames, newest, 6).tolist() for newest in range(12)]
        assert not any({3, 7} & set(w) for w in windows)
        assert windows[7] == windows[6]


def test_a_thinned_window_reaches_back_by_doublings() -> None:
    assert thinned(np.arange(100), 99, 10).tolist() == [72, 80, 84, 88, 92, 94, 96, 97, 98, 99]
    assert (96 - thinned(np.arange(100), 96, 10)).tolist() == [24, 16, 12, 8, 6, 4, 3, 2, 1, 0]


@given(st.lists(st.booleans(), min_size=1, max_size=120), st.integers(1, 16))
def test_properties_of_thinned_windows(seen: list[bool], size: int) -> None:
    """The newest four stay, the size is kept, and what has left never comes back."""
    frames = np.flatnonzero(seen)
    before: set[int] = set()
    for newest in frames.tolist():
        window = thinned(frames, newest, size).tolist()
        assert window[-4:] == sliding(frames, newest, min(size, 4)).tolist()
        assert len(window) <= size
        assert set(window) <= before | {newest}
        before = set(window)


@pytest.mark.parametrize("size", range(1, 20))
def test_a_thinned_window_is_full_in_the_long_run(size: int) -> None:
    lengths = [len(thinned(np.arange(t + 1), t, size)) for t in range(2048, 2112)]
    assert max(lengths) == size
    assert min(lengths) >= size - 1


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


def select_by_sets(frame: Array, track: Array, window: Array, min_overlap: int) -> tuple[Array, Array]:
    """The same in sets of tracks: slow and plain, the oracle."""
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


@given(
    hnp.arrays(bool, st.tuples(st.integers(2, 8), st.integers(1, 12)), elements=st.sampled_from([True, True, False])),
    st.integers(2, 6),
    st.sets(st.integers(0, 9), min_size=1),
)
def test_selection_is_that_of_the_sets(keep: Array, min_overlap: int, window: set[int]) -> None:
    """Any frames, observed or not; tracks with any names."""
    frame, track = np.nonzero(keep)
    names = np.array([7, -3, 10**12, 4, 5, 0, 99, 12, 8, 1, 2, 3])
    for a, b in zip(
        select(frame, names[track], np.array(sorted(window)), min_overlap),
        select_by_sets(frame, names[track], np.array(sorted(window)), min_overlap),
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("min_overlap", [2, 3])
def test_inputs_are_not_touched(min_overlap: int) -> None:
    frame, track = table(["xxx.", "xxxx", ".xxx"])
    before = frame.copy(), track.copy()
    select(frame, track, np.arange(3), min_overlap)
    np.testing.assert_array_equal(frame, before[0])
    np.testing.assert_array_equal(track, before[1])
