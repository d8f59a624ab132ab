"""The figure of the matrices: every entry a dot in the colour of what makes it, light at any size."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest

from estimators.bordered import BorderedSystem
from estimators.stereo.conditions import RotationAxis, Smoothing, of_window
from estimators.stereo.depth_bias import observation_model
from estimators.stereo.full_system import about_camera, linearise, weighted
from estimators.stereo.initial_values import points_by_mean
from estimators.stereo.object_motion import Problem
from estimators.stereo.triangulation import triangulate
from reports.figures.structure import MATRICES, structure
from reports.figures.style import COLORS
from sim.camera import Camera, StereoRig
from sim.pose import exp_so3

BLUE, SMOOTH, AXIS, TIED = COLORS[:4]


RIG = StereoRig.normal_case(Camera.simple((1024, 768), 1000.0), 0.3)
SIGMA_PX, RATE_HZ = 0.2, 25.0
AXIS_C = (0.02, 1.0, -0.05)  # of the ground before a camera that is not quite level


def system(m: int, n: int, tied: int, life: int | None = None, seed: int = 0) -> BorderedSystem:
    """The linearised window of n points in m frames; life: frames a track lives, None for all."""
    rng = np.random.default_rng(seed)
    X, t = rng.uniform([-0.9, -0.7, -2.2], [0.9, 0.7, 2.2], (n, 3)), np.arange(m) / RATE_HZ
    R = exp_so3(np.multiply.outer(0.3 + 0.3 * t, np.array(AXIS_C) / np.linalg.norm(AXIS_C)))
    T = np.array([1.0, 0.5, 20.0]) - np.multiply.outer(10 * t, [0.1, 0.0, 1.0])
    born = np.zeros(n) if life is None else np.sort(rng.integers(2 - life, m - 1, n))
    frames = np.arange(m)[:, None]
    frame, point = np.nonzero((frames >= born) & (frames < born + (life or m)))
    uv = RIG.project(np.einsum("kab,kb->ka", R[frame], X[point]) + T[frame])
    uv = uv + SIGMA_PX * rng.standard_normal(uv.shape)
    cov = np.broadcast_to(np.eye(4) * SIGMA_PX**2, (len(frame), 4, 4))
    l, C = triangulate(RIG, uv, cov)
    problem = Problem(frame, point, l, observation_model(RIG, l, C, np.linalg.inv(cov), "estimated", True), m, n)
    (R, T), conditions = of_window(Smoothing("velocity"), RotationAxis("fixed", axis_c=AXIS_C), t, None, (R, T), tied)
    X = points_by_mean(problem, R, T)
    return about_camera(linearise(weighted(problem, R, T, X, conditions), R, T, X), T)


@pytest.fixture(scope="module")
def small() -> BorderedSystem:
    return system(3, 6, 1)


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


def test_a_large_system_is_rastered_and_light(small: BorderedSystem) -> None:
    large = system(30, 500, 3, 8)
    figure = structure(small, large)
    for left, right in zip(figure.axes[::2], figure.axes[1::2], strict=True):
        assert not any(line.get_rasterized() for line in left.lines)
        assert len(np.concatenate([line.get_xdata() for line in right.lines])) < 150_000
    assert all(line.get_rasterized() for line in figure.axes[-1].lines if line.get_marker() == "s")
    svg = io.BytesIO()
    figure.savefig(svg, format="svg", dpi=300)
    assert svg.tell() < 1_500_000
    assert figure.axes[-1].get_xlabel() == f"nz = {large.N.nnz}"
