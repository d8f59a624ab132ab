"""The figure of the matrices: every entry a dot in the colour of what makes it, light at any size."""

from __future__ import annotations

import importlib.util
import io
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from estimators.bordered import BorderedSystem
from reports.figures.structure import MATRICES, structure
from reports.figures.style import COLORS

BLUE, SMOOTH, AXIS, TIED = COLORS[:4]


@pytest.fixture(scope="module")
def benchmark() -> ModuleType:
    path = Path(__file__).parents[2] / "benchmarks" / "matrix_structure.py"
    spec = importlib.util.spec_from_file_location("matrix_structure", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def small(benchmark: ModuleType) -> BorderedSystem:
    return benchmark.system(3, 6, 1)


def dots(ax: Any) -> dict[str, set[tuple[int, int]]]:
    """Rows and columns, from zero, of the dots of each colour."""
    return {
        line.get_color(): {(int(y) - 1, int(x) - 1) for x, y in zip(*line.get_data(), strict=True)}
        for line in ax.lines
        if line.get_marker() == "s"
    }


def entries(M: Any) -> set[tuple[int, int]]:
    return {(int(i), int(j)) for i, j in zip(*np.nonzero(M.toarray()), strict=True)}


def test_every_entry_is_a_dot_in_the_colour_of_its_part(small: BorderedSystem) -> None:
    axes = structure(small, small).axes
    assert len(axes) == 2 * len(MATRICES)
    drawn = {name: dots(axes[2 * i]) for i, name in enumerate(MATRICES)}
    for i, name in enumerate(MATRICES):
        M = getattr(small, name)
        assert set().union(*drawn[name].values()) == entries(M)
        assert sum(len(d) for d in drawn[name].values()) == M.nnz
        assert axes[2 * i].get_xlabel() == f"nz = {M.nnz}"
    # 6 points in 3 frames: 54 coordinates, three of smoothing; 36 unknowns.
    assert small.A.shape == (57, 36)
    for name in ("C_ll", "A"):
        assert {i for i, _ in drawn[name][SMOOTH]} == {54, 55, 56}
        assert {i for i, _ in drawn[name][BLUE]} == set(range(54))
    # One turn of the datum, two of three rotations of each frame, the translation of the first.
    columns = {c: {j for _, j in d} for c, d in drawn["H"].items()}
    assert columns == {BLUE: {0}, AXIS: set(range(1, 7)), TIED: {7, 8, 9}}
    # Smoothing joins the poses of different frames, and nothing else does.
    frame = {(i, j): ((i - 18) // 6, (j - 18) // 6) for i, j in entries(small.N) if i >= 18 and j >= 18}
    apart = {cell for cell, (s, t) in frame.items() if s != t}
    assert apart
    assert apart <= drawn["N"][SMOOTH]
    assert all(i >= 18 and j >= 18 for i, j in drawn["N"][SMOOTH])


def test_groups_are_named(small: BorderedSystem) -> None:
    axes = structure(small, small, ["H", "N"]).axes
    assert sorted(t.get_text() for t in axes[0].texts) == ["axis", "datum", "points", "poses", "tied"]
    assert sorted(t.get_text() for t in axes[2].texts) == ["points", "points", "poses", "poses"]


def test_a_large_system_is_rastered_and_light(benchmark: ModuleType, small: BorderedSystem) -> None:
    large = benchmark.system(30, 500, 3, 8)
    figure = structure(small, large)
    for left, right in zip(figure.axes[::2], figure.axes[1::2], strict=True):
        assert not any(line.get_rasterized() for line in left.lines)
        assert len(np.concatenate([line.get_xdata() for line in right.lines])) < 150_000
    assert all(line.get_rasterized() for line in figure.axes[-1].lines if line.get_marker() == "s")
    svg = io.BytesIO()
    figure.savefig(svg, format="svg", dpi=300)
    assert svg.tell() < 1_500_000
    assert figure.axes[-1].get_xlabel() == f"nz = {large.N.nnz}"


def test_command_writes_both_formats(
    benchmark: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["matrix_structure", "--out", str(tmp_path / "new")])
    benchmark.main()
    assert sorted(p.name for p in (tmp_path / "new").iterdir()) == ["structure.png", "structure.svg"]
    assert "nz = " in capsys.readouterr().out
