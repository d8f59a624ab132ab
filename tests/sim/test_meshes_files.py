"""Mesh files, point grids and the volumes of placed bodies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.meshes import (
    PAINTS,
    MeshError,
    OpenMeshWarning,
    bounding_box,
    load_mesh,
    make_vehicle,
    point_grid,
    sample_surface,
    volumes_intersect,
)
from sim.pose import Pose, exp_so3, rot_z
from sim.textures import linear_from_srgb


@pytest.fixture
def wedge() -> trimesh.Trimesh:
    """4 m along x, low in front (+x), 1 m along y, 2 m high."""
    points = np.array([[0, 0, 0], [4, 0, 0], [0, 0, 2.0]])
    return trimesh.Trimesh(
        np.concatenate([points, points + np.array([0, 1, 0])]),
        [[0, 1, 2], [3, 5, 4], [0, 3, 4], [0, 4, 1], [1, 4, 5], [1, 5, 2], [2, 5, 3], [2, 3, 0]],
        process=False,
    )


@pytest.mark.parametrize("extension", ["ply", "obj", "stl", "glb", "off"])
def test_formats_give_the_same_closed_body(tmp_path: Path, wedge: trimesh.Trimesh, extension: str) -> None:
    wedge.export(tmp_path / f"wedge.{extension}")
    m = load_mesh(tmp_path / f"wedge.{extension}")
    solid = trimesh.Trimesh(m.solid_vertices, m.solid_faces, process=False)
    assert m.name == "wedge"
    assert m.size_m == pytest.approx((4, 1, 2))
    assert solid.is_watertight
    assert solid.volume == pytest.approx(4.0)
    np.testing.assert_allclose(m.solid_vertices.min(axis=0), [-0.8, -0.5, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("forward", "up", "low_end"),
    [("+x", "+z", (4, 0, 0)), ("-x", "+z", (0, 0, 0)), ("+z", "+x", (0, 0, 2)), ("-y", "-z", (0, 0, 0))],
)
def test_axes_of_the_file(
    tmp_path: Path, wedge: trimesh.Trimesh, forward: str, up: str, low_end: tuple[float, float, float]
) -> None:
    """The file's forward end becomes the vehicle's front, checked by a vertex; the turn keeps the volume's sign."""
    wedge.export(tmp_path / "w.ply")
    m = load_mesh(tmp_path / "w.ply", forward=forward, up=up)
    x = np.eye(3)["xyz".index(forward[1])] * (1 if forward[0] == "+" else -1)
    z = np.eye(3)["xyz".index(up[1])] * (1 if up[0] == "+" else -1)
    v = wedge.vertices
    expected = np.array(low_end) @ x - (v @ x).min() - 0.2 * m.size_m[0], np.array(low_end) @ z - (v @ z).min()
    distance = np.linalg.norm(m.solid_vertices[:, [0, 2]] - expected, axis=1)
    assert distance.min() < 1e-6
    assert trimesh.Trimesh(m.solid_vertices, m.solid_faces, process=False).volume == pytest.approx(4.0)


def test_paint_takes_the_place_of_the_file_s_colours(tmp_path: Path, wedge: trimesh.Trimesh) -> None:
    wedge.visual.face_colors = [255, 255, 0, 255]
    wedge.export(tmp_path / "w.ply")
    (own,), (blue,) = (load_mesh(tmp_path / "w.ply", color=c).levels[0] for c in (None, "blue"))
    np.testing.assert_allclose(own.color, np.broadcast_to([1.0, 1.0, 0.0], own.color.shape), atol=1e-9)
    np.testing.assert_allclose(blue.color[0], linear_from_srgb(PAINTS["blue"]))
    assert np.ptp(blue.color, axis=0).max() == 0


def test_scaling(tmp_path: Path, wedge: trimesh.Trimesh) -> None:
    wedge.export(tmp_path / "w.ply")
    assert load_mesh(tmp_path / "w.ply", length_m=6.0).size_m == pytest.approx((6, 1.5, 3))
    assert load_mesh(tmp_path / "w.ply", size_m=(4.5, 1.8, 1.5)).size_m == pytest.approx((4.5, 1.8, 1.5))


def test_inside_out_mesh_is_turned(tmp_path: Path, wedge: trimesh.Trimesh) -> None:
    wedge.invert()
    wedge.export(tmp_path / "w.ply")
    m = load_mesh(tmp_path / "w.ply")
    assert trimesh.Trimesh(m.solid_vertices, m.solid_faces, process=False).volume > 0


def test_open_mesh_warns(tmp_path: Path, wedge: trimesh.Trimesh) -> None:
    wedge.update_faces(np.arange(len(wedge.faces)) > 1)
    wedge.export(tmp_path / "w.ply")
    with pytest.warns(OpenMeshWarning, match="not closed"):
        assert len(load_mesh(tmp_path / "w.ply").solid_faces) == 6


def _write(path: Path, kind: str) -> None:
    if kind == "text":
        path.write_text("this is not a mesh\n")
    elif kind == "empty":
        path.write_bytes(b"")
    elif kind == "no faces":
        path.write_text(
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
            "end_header\n0 0 0\n"
        )
    else:
        value = {"nan": "nan", "degenerate": "0", "flat": "1"}[kind]
        third = "0 0 0" if kind == "degenerate" else f"0 {value} 0"
        path.write_text(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
            f"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n{third}\n3 0 1 2\n"
        )


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("text", "not a mesh that can be read"),
        ("empty", "not a mesh that can be read|no faces"),
        ("no faces", "no faces"),
        ("nan", "not finite"),
        ("degenerate", "degenerate"),
        ("flat", "flat mesh"),
    ],
)
def test_unusable_files_give_one_line(tmp_path: Path, kind: str, message: str) -> None:
    path = tmp_path / "bad.ply"
    _write(path, kind)
    with pytest.raises(MeshError, match=message) as error:
        load_mesh(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_missing_file_and_unknown_format(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="no such mesh file"):
        load_mesh(tmp_path / "none.ply")
    (tmp_path / "car.xyzzy").write_text("1 2 3")
    with pytest.raises(MeshError, match="not a mesh that can be read"):
        load_mesh(tmp_path / "car.xyzzy")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"forward": "x"}, "expected one of"),
        ({"forward": "+z", "up": "-z"}, "must differ"),
        ({"length_m": -1.0}, "positive"),
        ({"length_m": 0.0}, "positive"),
        ({"size_m": (1, 2)}, "positive"),
    ],
)
def test_wrong_calls_are_named(
    tmp_path: Path, wedge: trimesh.Trimesh, arguments: dict[str, object], message: str
) -> None:
    wedge.export(tmp_path / "w.ply")
    with pytest.raises(MeshError, match=message):
        load_mesh(tmp_path / "w.ply", **arguments)  # type: ignore[arg-type]


def test_point_grid_fills_its_box() -> None:
    grid = point_grid((5.0, 1.0, 1.25), (5, 4, 5))
    assert len(grid.solid_vertices) == 100
    assert len(grid.solid_faces) == 0
    assert grid.levels == ((),)
    np.testing.assert_allclose(np.ptp(grid.solid_vertices, axis=0), grid.size_m)
    points, normals = sample_surface(grid, 100, np.random.default_rng(0))
    assert len(np.unique(points, axis=0)) == 100
    assert not normals.any()


@pytest.mark.parametrize(("size", "counts"), [((1, 1, 0), (2, 2, 2)), ((1, 1, 1), (2, 0, 2)), ((1, 1), (2, 2, 2))])
def test_point_grid_refuses(size: tuple[float, ...], counts: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="expected"):
        point_grid(size, counts)


_A, _B = point_grid((4.0, 1.8, 1.5), (2, 2, 2)), point_grid((8.0, 2.5, 3.4), (2, 2, 2))


def _boxes_overlap_by_program(T_ab: Pose) -> bool:
    """Independent oracle: linear feasibility of a point inside both boxes."""
    from scipy.optimize import linprog

    rows, limits = [], []
    for model, R, t in ((_A, np.eye(3), np.zeros(3)), (_B, T_ab.R, T_ab.t)):
        center, half = bounding_box(model)
        for sign in (1, -1):
            rows.append(np.c_[sign * R.T, np.ones(3)])
            limits.append(half + sign * (R.T @ t + center))
    result = linprog(
        [0, 0, 0, -1], np.concatenate(rows), np.concatenate(limits), bounds=[(None, None)] * 3 + [(None, 10)]
    )
    return bool(result.x[3] > 0)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.lists(st.floats(-5, 5), min_size=3, max_size=3), st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_volumes_intersect_agrees_with_a_linear_program(t: list[float], r: list[float]) -> None:
    T = Pose(exp_so3(np.array(r)), np.array(t))
    world = Pose(rot_z(0.7), np.array([3.0, -20.0, 0.1]))
    expected = _boxes_overlap_by_program(T)
    assert bool(volumes_intersect(_A, world, _B, world @ T)) == expected
    assert bool(volumes_intersect(_B, world @ T, _A, world)) == expected


def test_volumes_of_passing_cars() -> None:
    """Two cars side by side with 5 cm between them do not intersect, at 5 cm less they do; a batch of poses at once."""
    car = make_vehicle("sedan", np.random.default_rng(0))
    side = Pose(np.tile(np.eye(3), (4, 1, 1)), np.array([[0, 1.85, 0], [0, 1.75, 0], [4.65, 0, 0], [4.55, 0, 0.0]]))
    np.testing.assert_array_equal(volumes_intersect(car, Pose.identity(), car, side), [False, True, False, True])
