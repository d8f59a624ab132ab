"""Vehicles from mesh files and from nothing but points."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from sim.meshes.paint import PAINTS
from sim.meshes.solid import plain, surface
from sim.model import VehicleModel
from sim.textures import linear_from_srgb

Array = np.ndarray

AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
_GLOSS = 0.05


class MeshError(ValueError):
    """A file is not a usable mesh; the message is one line for the user."""


class OpenMeshWarning(UserWarning):
    """A mesh is not closed: it is used, but its back faces are invisible and points may show through."""


def load_mesh(
    path: str | Path,
    length_m: float | None = None,
    size_m: Sequence[float] | None = None,
    forward: str = "+x",
    up: str = "+z",
    color: str | None = None,
) -> VehicleModel:
    """A vehicle from any mesh file trimesh reads (PLY, OBJ, STL, GLB, OFF ...), in one level of detail.

    ``forward`` and ``up`` name the file's axes. ``length_m`` scales all axes alike, ``size_m`` (length, width, height)
    each axis on its own; with neither, the file is in metres. Wheels are unknown, so the rear axle is put at a fifth of
    the length. ``color``, a name of `PAINTS`, takes the place of the file's colours. Emits `OpenMeshWarning` where the
    surface is not closed.

    Raises
        MeshError: no such file, not a mesh, no faces, coordinates that are not finite, no extent, unknown axes.
    """
    path = Path(path)
    R = _axes(path, forward, up)
    vertices, faces, colors = _read(path)
    vertices = vertices @ R.T
    extent = np.ptp(vertices, axis=0)
    if not np.all(extent > 0):
        raise MeshError(f"{path}: flat mesh, extent {extent[0]:g} x {extent[1]:g} x {extent[2]:g}")
    size = _target_size(path, extent, length_m, size_m)
    vertices = (vertices - vertices.min(axis=0)) * (size / extent)
    rear = 0.2 * size[0]
    vertices = vertices - [rear, size[1] / 2, 0]
    if not _is_closed(vertices, faces):
        warnings.warn(
            f"{path}: the mesh is not closed; parts seen from behind are invisible", OpenMeshWarning, stacklevel=2
        )
    elif _signed_volume(vertices, faces) < 0:
        faces = faces[:, ::-1].copy()
    if color is not None:
        colors = np.broadcast_to(linear_from_srgb(PAINTS[color]), colors.shape)
    part = replace(plain(vertices, faces, gloss=_GLOSS), color=colors)
    return VehicleModel(
        name=path.stem,
        levels=((surface(part),),),
        switch_m=(),
        solid_vertices=vertices,
        solid_faces=faces,
        size_m=(float(size[0]), float(size[1]), float(size[2])),
        wheelbase_m=0.6 * float(size[0]),
        rear_overhang_m=float(rear),
        wheel_radius_m=0.2 * float(size[2]),
    )


def point_grid(size_m: Sequence[float], counts: Sequence[int]) -> VehicleModel:
    """A transparent grid of points without a body (Siegemund 2008, 3.4.4: 100 points in 1 x 5 x 5/4 m).

    ``size_m`` (length, width, height) and ``counts`` per axis; the points are ``solid_vertices``, there are no faces.

    Raises
        ValueError: a size or count that is not positive.
    """
    if len(size_m) != 3 or not all(np.isfinite(s) and s > 0 for s in size_m):
        raise ValueError(f"size_m: expected (length, width, height) > 0, got {list(size_m)}")
    if len(counts) != 3 or not all(int(c) == c and c >= 1 for c in counts):
        raise ValueError(f"counts: expected three whole numbers >= 1, got {list(counts)}")
    L, W, H = (float(s) for s in size_m)
    low = np.array([-0.2 * L, -W / 2, 0.0])
    axes = [
        a + (np.linspace(0, s, c) if c > 1 else np.array([s / 2]))
        for a, s, c in zip(low, (L, W, H), counts, strict=True)
    ]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return VehicleModel(
        name="point_grid",
        levels=((),),
        switch_m=(),
        solid_vertices=points,
        solid_faces=np.zeros((0, 3), np.int64),
        size_m=(L, W, H),
        wheelbase_m=0.6 * L,
        rear_overhang_m=0.2 * L,
        wheel_radius_m=0.0,
    )


def _axes(path: Path, forward: str, up: str) -> Array:
    """Rotation of the file's axes into the vehicle frame."""
    for name, axis in (("forward", forward), ("up", up)):
        if axis not in AXES:
            raise MeshError(f"{path}: {name} axis {axis!r}, expected one of {', '.join(AXES)}")
    if forward[1] == up[1]:
        raise MeshError(f"{path}: forward axis {forward} and up axis {up} must differ")
    x, z = (np.eye(3)["xyz".index(a[1])] * (1 if a[0] == "+" else -1) for a in (forward, up))
    return np.stack([x, np.cross(z, x), z])


def _read(path: Path) -> tuple[Array, Array, Array]:
    """Vertices merged by position, faces without degenerate ones, linear colours per face."""
    if not path.is_file():
        raise MeshError(f"{path}: no such mesh file")
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            mesh = trimesh.load(path, force="mesh", process=False)
    except Exception as error:  # every format has its own reader, and every reader its own errors
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise MeshError(f"{path}: not a mesh that can be read ({reason})") from error
    faces = np.asarray(getattr(mesh, "faces", np.zeros((0, 3))), np.int64).reshape(-1, 3)
    vertices = np.asarray(getattr(mesh, "vertices", np.zeros((0, 3))), float).reshape(-1, 3)
    if len(faces) == 0:
        raise MeshError(f"{path}: the mesh has no faces")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshError(f"{path}: faces refer to vertices that are not there")
    if not np.isfinite(vertices).all():
        raise MeshError(f"{path}: the mesh has coordinates that are not finite")
    colors = _face_colors(mesh, len(faces))
    unique, index = np.unique(np.round(vertices, 9), axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    solid = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    c = np.cross(unique[faces[:, 1]] - unique[faces[:, 0]], unique[faces[:, 2]] - unique[faces[:, 0]])
    solid &= np.linalg.norm(c, axis=1) > 0
    if not solid.any():
        raise MeshError(f"{path}: all faces of the mesh are degenerate")
    return unique, faces[solid], colors[solid]


def _face_colors(mesh: trimesh.Trimesh, count: int) -> Array:
    """Linear colours of the file's faces, light grey where it has none."""
    try:
        visual = mesh.visual.to_color() if mesh.visual.kind == "texture" else mesh.visual
        rgb = np.asarray(visual.face_colors, float)[:, :3] / 255 if visual.kind else None
    except (AttributeError, ValueError, TypeError):
        rgb = None
    if rgb is None or rgb.shape != (count, 3):
        return np.full((count, 3), 0.45)
    return linear_from_srgb(rgb)


def _target_size(path: Path, extent: Array, length_m: float | None, size_m: Sequence[float] | None) -> Array:
    wanted = np.asarray(size_m if size_m is not None else [1.0 if length_m is None else length_m] * 3, float)
    if wanted.shape != (3,) or not np.all(np.isfinite(wanted) & (wanted > 0)):
        raise MeshError(f"{path}: size to scale to must be positive, got {wanted.tolist()}")
    if size_m is not None:
        return wanted
    return np.asarray(extent * (length_m / extent[0] if length_m is not None else 1.0))


def _is_closed(vertices: Array, faces: Array) -> bool:
    """Every directed edge has exactly one opposite twin per use."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    n = len(vertices)
    return bool(np.array_equal(np.sort(edges[:, 0] * n + edges[:, 1]), np.sort(edges[:, 1] * n + edges[:, 0])))


def _signed_volume(vertices: Array, faces: Array) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)
