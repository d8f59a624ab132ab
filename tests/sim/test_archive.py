"""Frozen arrays, and files that are whole or not there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from sim import archive
from sim.archive import freeze, freeze_fields


@dataclass(frozen=True, eq=False)
class Leaf:
    values: np.ndarray
    name: str

    def __post_init__(self) -> None:
        freeze_fields(self)


@dataclass(frozen=True, eq=False)
class Tree:
    leaves: tuple[Leaf, ...]
    table: dict[str, np.ndarray]
    count: int
    ratio: np.float64
    flag: bool
    nothing: None
    text: str
    numbers: np.ndarray


def tree() -> Tree:
    rng = np.random.default_rng(0)
    return Tree(
        leaves=(Leaf(rng.normal(size=(3, 2)), "a"), Leaf(np.arange(4), "ä"), Leaf(np.zeros((0, 3)), "empty")),
        table={"x.y": np.array([True, False]), "z": np.array(2.5)},
        count=7,
        ratio=np.float64(0.1),
        flag=True,
        nothing=None,
        text="Zeile\n2",
        numbers=np.array([np.nan, np.inf, -0.0, 1e-300]),
    )


def test_nested_dataclasses_return_bit_by_bit(tmp_path: Path) -> None:
    t = tree()
    archive.save(tmp_path / "t.npz", t)
    f = archive.load(tmp_path / "t.npz")
    assert [leaf["name"] for leaf in f["leaves"]] == ["a", "ä", "empty"]
    for leaf, loaded in zip(t.leaves, f["leaves"], strict=True):
        assert loaded["values"].dtype == leaf.values.dtype
        np.testing.assert_array_equal(loaded["values"], leaf.values)
    np.testing.assert_array_equal(f["table"]["x.y"], [True, False])
    assert f["table"]["z"].shape == ()
    assert (f["count"], f["ratio"], f["flag"], f["nothing"], f["text"]) == (7, 0.1, True, None, "Zeile\n2")
    assert f["numbers"].tobytes() == t.numbers.tobytes()


def test_same_object_same_bytes(tmp_path: Path) -> None:
    archive.save(tmp_path / "a.npz", tree())
    archive.save(tmp_path / "b.npz", tree())
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_a_failing_writer_leaves_nothing(tmp_path: Path) -> None:
    def broken(path: Path) -> None:
        path.write_text("half")
        raise RuntimeError("disk full")

    with pytest.raises(RuntimeError, match="disk full"):
        archive.write_atomically(tmp_path / "new" / "x.txt", broken)
    assert list((tmp_path / "new").iterdir()) == []


def test_a_failing_writer_keeps_what_was_there(tmp_path: Path) -> None:
    archive.write_text(tmp_path / "x.txt", "old")

    def broken(path: Path) -> None:
        path.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        archive.write_atomically(tmp_path / "x.txt", broken)
    assert [p.name for p in tmp_path.iterdir()] == ["x.txt"]
    assert (tmp_path / "x.txt").read_text() == "old"


def test_a_file_is_not_seen_before_it_is_whole(tmp_path: Path) -> None:
    seen = []

    def writer(path: Path) -> None:
        path.write_text("half")
        seen.append((tmp_path / "x.txt").exists())

    archive.write_atomically(tmp_path / "x.txt", writer)
    assert seen == [False]
    assert (tmp_path / "x.txt").read_text() == "half"


def test_written_files_have_ordinary_permissions(tmp_path: Path) -> None:
    (tmp_path / "ordinary").touch()
    archive.write_text(tmp_path / "x", "ü")
    assert (tmp_path / "x").stat().st_mode == (tmp_path / "ordinary").stat().st_mode
    assert (tmp_path / "x").read_text(encoding="utf-8") == "ü"


def test_foreign_archives_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "foreign.npz", a=np.arange(3))
    with pytest.raises(ValueError, match="not a pruefstand archive"):
        archive.load(tmp_path / "foreign.npz")
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(ValueError, match=r"text\.npz"):
        archive.load(tmp_path / "text.npz")


def test_frozen_arrays_are_read_only_copies() -> None:
    a = np.arange(6.0).reshape(2, 3)
    f = freeze(a)
    a[0, 0] = 9
    assert f[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        f[0, 0] = 1
    assert freeze(f) is f
    assert freeze(a.T).flags.c_contiguous
    view = a[:1]
    view.flags.writeable = False
    g = freeze(view)
    a[0, 1] = 8
    assert g[0, 1] == 1


def test_fields_are_frozen() -> None:
    values = np.arange(3)
    leaf = Leaf(values, "x")
    values[0] = 5
    assert leaf.values[0] == 0
    assert not leaf.values.flags.writeable


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_damaged_files_are_named(tmp_path: Path, share: float) -> None:
    archive.save(tmp_path / "whole.npz", tree())
    whole = (tmp_path / "whole.npz").read_bytes()
    (tmp_path / "damaged.npz").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ValueError, match=r"damaged\.npz"):
        archive.load(tmp_path / "damaged.npz")


def test_a_missing_file_is_missing(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        archive.load(tmp_path / "nothing.npz")
