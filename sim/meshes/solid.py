"""Closed triangle parts with colour and texture coordinates, their primitives, and their union into one `Surface`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from sim.model import Surface

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Part:
    """Triangles counter-clockwise from outside; colour (linear), gloss per face, texture coordinates per corner.

    ``normals`` per corner where they are not those of the geometry (foliage is shaded like a round crown); NaN or None
    leaves them to `crease_normals`.
    """

    vertices: Float[Array, "v 3"]
    faces: Int[Array, "f 3"]
    uv: Float[Array, "f 3 2"]
    color: Float[Array, "f 3"]
    gloss: Float[Array, "f"]
    normals: Float[Array, "f 3 3"] | None = None

    def corners(self) -> Float[Array, "f 3 3"]:
        return np.asarray(self.vertices[self.faces])

    def moved(self, offset: Sequence[float]) -> Part:
        return replace(self, vertices=self.vertices + np.asarray(offset, float))

    def placed(self, R: Array, t: Array) -> Part:
        """Turned by R (3, 3) and then moved by t (3,)."""
        normals = None if self.normals is None else self.normals @ R.T
        return replace(self, vertices=self.vertices @ R.T + t, normals=normals)

    def mirrored_y(self) -> Part:
        """Mirror image in y = 0, faces turned so that they still look outward."""
        normals = None if self.normals is None else self.normals[:, ::-1] * [1, -1, 1]
        faces, uv = self.faces[:, ::-1].copy(), self.uv[:, ::-1].copy()
        return replace(self, vertices=self.vertices * [1, -1, 1], faces=faces, uv=uv, normals=normals)


def plain(
    vertices: Array, faces: Array, color: ArrayLike = (1, 1, 1), gloss: float = 0.0, uv: ArrayLike = (0, 0)
) -> Part:
    """A part of one colour, all its corners on one texel ``uv``."""
    n = len(faces)
    return Part(
        np.asarray(vertices, float),
        np.asarray(faces, np.int64),
        np.broadcast_to(np.asarray(uv, float), (n, 3, 2)),
        np.broadcast_to(np.asarray(color, float), (n, 3)),
        np.full(n, float(gloss)),
    )


def face_normals(corners: Float[Array, "f 3 3"]) -> tuple[Float[Array, "f 3"], Float[Array, "f"]]:
    """Unit normals (zero for degenerate faces) and areas."""
    c = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(c, axis=1)
    return c / np.maximum(length, 1e-300)[:, None], length / 2


def tube(rings: Float[Array, "n m 3"]) -> tuple[Array, Array]:
    """Vertices and faces of an open tube through closed rings; rings run counter-clockwise seen from its end."""
    n, m, _ = rings.shape
    i, j = np.meshgrid(np.arange(n - 1), np.arange(m), indexing="ij")
    a, b = i * m + j, i * m + (j + 1) % m
    c, d = a + m, b + m
    faces = np.concatenate([np.stack([a, b, d], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)])
    return rings.reshape(-1, 3), faces


def closed_tube(rings: Float[Array, "n m 3"]) -> tuple[Array, Array]:
    """A tube whose two end rings are closed by fans around their centroids."""
    vertices, faces = tube(rings)
    n, m, _ = rings.shape
    j = np.arange(m)
    first = np.stack([np.full(m, len(vertices)), (j + 1) % m, j], -1)
    last = np.stack([np.full(m, len(vertices) + 1), (n - 1) * m + j, (n - 1) * m + (j + 1) % m], -1)
    vertices = np.concatenate([vertices, rings[0].mean(axis=0)[None], rings[-1].mean(axis=0)[None]])
    return vertices, np.concatenate([faces, first, last])


def lathe(profile: Float[Array, "k 2"], segments: int) -> tuple[Array, Array]:
    """Closed solid of revolution about the y axis; profile (radius, y), y falling, from axis to axis.

    The first meridian points down (-z), so the lowest point is a vertex.
    """
    angle = np.arange(segments) * 2 * np.pi / segments
    ring = np.stack([np.sin(angle), np.zeros(segments), -np.cos(angle)], axis=-1)
    inner = profile[1:-1]
    rings = ring[None] * inner[:, :1, None] + inner[:, 1, None, None] * np.array([0, 1.0, 0])
    vertices, faces = tube(rings)
    j, k = np.arange(segments), (len(inner) - 1) * segments
    top = np.stack([np.full(segments, len(vertices)), (j + 1) % segments, j], -1)
    bottom = np.stack([np.full(segments, len(vertices) + 1), k + j, k + (j + 1) % segments], -1)
    poles = np.array([[0, profile[0, 1], 0], [0, profile[-1, 1], 0]])
    return np.concatenate([vertices, poles]), np.concatenate([faces, top, bottom])


_BOX = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
_BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def box(low: Sequence[float], high: Sequence[float]) -> tuple[Array, Array]:
    """Vertices and faces of a closed axis-parallel box."""
    a, b = np.asarray(low, float), np.asarray(high, float)
    return a + _BOX * (b - a), _BOX_FACES


def crease_normals(vertices: Array, faces: Array, crease_rad: float) -> Float[Array, "f 3 3"]:
    """Unit normal per corner: area-weighted mean of its vertex's faces within ``crease_rad`` of its own."""
    normals, areas = face_normals(vertices[faces])
    corner_vertex = faces.ravel()
    corner_face = np.repeat(np.arange(len(faces)), 3)
    order = np.argsort(corner_vertex, kind="stable")
    count = np.bincount(corner_vertex, minlength=len(vertices))
    start = np.concatenate([[0], np.cumsum(count)[:-1]])
    own_count = count[corner_vertex]
    own = np.repeat(np.arange(len(corner_vertex)), own_count)
    rank = np.arange(len(own)) - np.repeat(np.cumsum(own_count) - own_count, own_count)
    other_face = corner_face[order[np.repeat(start[corner_vertex], own_count) + rank]]
    near = np.einsum("ij,ij->i", normals[corner_face[own]], normals[other_face]) > np.cos(crease_rad)
    weighted = normals[other_face[near]] * areas[other_face[near], None]
    total = np.stack([np.bincount(own[near], weighted[:, k], minlength=len(corner_vertex)) for k in range(3)], axis=-1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    unit = np.where(length > 1e-12, total / np.maximum(length, 1e-12), normals[corner_face])
    return np.asarray(unit.reshape(-1, 3, 3))


def merged(parts: Sequence[Part]) -> Part:
    """All parts in one; their vertices stay apart."""
    shift = np.cumsum([0] + [len(p.vertices) for p in parts[:-1]])
    return Part(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([p.faces + s for p, s in zip(parts, shift, strict=True)]),
        np.concatenate([p.uv for p in parts]),
        np.concatenate([p.color for p in parts]),
        np.concatenate([p.gloss for p in parts]),
        np.concatenate([np.full((len(p.faces), 3, 3), np.nan) if p.normals is None else p.normals for p in parts]),
    )


def surface(
    part: Part,
    texture: Array | None = None,
    crease_rad: float = np.deg2rad(38),
    repeat: bool = True,
) -> Surface:
    """The renderer's primitive: vertices are split only where normal, colour or texture coordinates differ."""
    normals = crease_normals(part.vertices, part.faces, crease_rad)
    if part.normals is not None:
        normals = np.where(np.isnan(part.normals), normals, part.normals)
    n = len(part.faces)
    columns = np.concatenate(
        [
            np.asarray(part.faces, float).reshape(-1, 1),
            np.round(normals, 4).reshape(-1, 3),
            np.round(part.uv, 6).reshape(-1, 2),
            np.repeat(part.color, 3, axis=0),
            np.repeat(part.gloss, 3)[:, None],
        ],
        axis=1,
    )
    keys = np.ascontiguousarray(columns + 0.0).view(np.dtype((np.void, columns.shape[1] * 8))).ravel()
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    return Surface(
        vertices=part.vertices[part.faces.ravel()[first]],
        faces=inverse.reshape(n, 3),
        normals=normals.reshape(-1, 3)[first],
        color=columns[first, 6:9],
        gloss=columns[first, 9],
        uv=part.uv.reshape(-1, 2)[first] if texture is not None else None,
        texture=texture,
        repeat=repeat,
    )
