"""Models of the aerial world: triangle meshes that share textures, packed into the flat arrays of the renderer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from sim.aerial.surfaces import FACADE, Surface
from sim.archive import freeze_fields
from sim.textures import linear_from_srgb

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Texture:
    """Albedo in linear light (h, w, 4): RGB, and the share of the instance's paint that is added; row 0 is t = 0.

    For the thermal band, ``coat`` is what takes the paint and ``bare`` what does not; ``engine`` (h, w) is the share of
    the warmth of a running engine, None where there is none.
    """

    texels: Float[Array, "h w 4"]
    repeat: bool
    coat: Surface = FACADE
    bare: Surface = FACADE
    engine: Float[Array, "h w"] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "texels", np.asarray(self.texels, np.float32))
        freeze_fields(self)

    def warmth(self) -> Float[Array, "h w 4"]:
        """Of every texel shade_K, gain_K, reflectivity (`surfaces.Surface`) and the share of the engine's warmth."""
        share = np.clip(self.texels[..., 3:], 0, 1)
        shade, gain, emissivity = np.moveaxis(share * self.coat.row() + (1 - share) * self.bare.row(), -1, 0)
        engine = np.zeros_like(shade) if self.engine is None else self.engine
        return np.stack([shade, gain, 1 - emissivity, engine], axis=-1).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Mesh:
    """Closed triangle mesh in its own frame [m], faces counter-clockwise seen from outside.

    look (v, 4): texture coordinates s, t, openness to the light in 0..1 (1 in the open), gloss in 0..1.
    texture (f,): which texture of the library a face has.
    """

    vertices: Float[Array, "v 3"]
    normals: Float[Array, "v 3"]
    look: Float[Array, "v 4"]
    faces: Int[Array, "f 3"]
    texture: Int[Array, "f"]

    def __post_init__(self) -> None:
        freeze_fields(self)


def merged(parts: Sequence[Mesh]) -> Mesh:
    """Parts as one mesh."""
    shift = np.cumsum([0] + [len(p.vertices) for p in parts])
    return Mesh(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([p.normals for p in parts]),
        np.concatenate([p.look for p in parts]),
        np.concatenate([p.faces + s for p, s in zip(parts, shift, strict=False)]),
        np.concatenate([p.texture for p in parts]),
    )


def polygons(corners: Float[Array, "m n 3"], st: Float[Array, "m n 2"], texture: int, openness: float = 1.0) -> Mesh:
    """Flat convex polygons of n corners each, counter-clockwise seen from outside."""
    m, n = corners.shape[:2]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    k = np.arange(1, n - 1)
    fan = np.stack([np.zeros_like(k), k, k + 1], axis=-1)
    faces = (n * np.arange(m)[:, None, None] + fan).reshape(-1, 3)
    look = np.column_stack([st.reshape(-1, 2), np.full(m * n, openness), np.zeros(m * n)])
    return Mesh(corners.reshape(-1, 3), np.repeat(normal, n, axis=0), look, faces, np.full(len(faces), texture))


def polygon(corners: Float[Array, "n 3"], st: Float[Array, "n 2"], texture: int, openness: float = 1.0) -> Mesh:
    """One flat convex polygon, counter-clockwise seen from outside."""
    return polygons(corners[None], st[None], texture, openness)


@dataclass(frozen=True, eq=False)
class Library:
    """All meshes and textures in flat arrays; mesh m has vertices [vertex_first[m], vertex_first[m + 1]).

    texels are those of the visible bands, warmth the same places as `Texture.warmth` gives them.
    """

    vertices: Float[Array, "v 3"]
    normals: Float[Array, "v 3"]
    look: Float[Array, "v 4"]
    faces: Int[Array, "f 3"]
    texture: Int[Array, "f"]
    vertex_first: Int[Array, "_"]
    face_first: Int[Array, "_"]
    radius: Float[Array, "m"]
    texels: Float[Array, "t 4"]
    warmth: Float[Array, "t 4"]
    textures: Int[Array, "n 4"]

    @staticmethod
    def of(meshes: Sequence[Mesh], textures: Sequence[Texture]) -> Library:
        all_ = merged(meshes)
        vertex_first = np.cumsum([0] + [len(m.vertices) for m in meshes])
        face_first = np.cumsum([0] + [len(m.faces) for m in meshes])
        faces = all_.faces.astype(np.int32)
        sizes = [t.texels.shape[:2] for t in textures]
        begins = np.cumsum([0] + [h * w for h, w in sizes])
        table = [(b, h, w, t.repeat) for b, (h, w), t in zip(begins, sizes, textures, strict=False)]
        return Library(
            all_.vertices,
            all_.normals,
            all_.look,
            faces,
            all_.texture.astype(np.int32),
            vertex_first,
            face_first,
            np.array([np.linalg.norm(m.vertices, axis=1).max() for m in meshes]),
            np.concatenate([t.texels.reshape(-1, 4) for t in textures]),
            np.concatenate([t.warmth().reshape(-1, 4) for t in textures]),
            np.array(table, np.int64),
        )


@dataclass(frozen=True, eq=False)
class Instances:
    """Placed models: mesh (n,), place (n, 12) = rotation times scale by rows, then t; paint (n, 3) in linear light."""

    mesh: Int[Array, "n"]
    place: Float[Array, "n 12"]
    paint: Float[Array, "n 3"]

    def __post_init__(self) -> None:
        freeze_fields(self)

    def __len__(self) -> int:
        return len(self.mesh)

    @cached_property
    def scale(self) -> Float[Array, "n"]:
        """The largest scale of an instance's axes."""
        R = self.place[:, :9].reshape(-1, 3, 3)
        return np.asarray(np.sqrt(np.max(np.sum(R**2, axis=1), axis=1)) if len(R) else np.zeros(0))

    def chosen(self, which: Array) -> Instances:
        return Instances(self.mesh[which], self.place[which], self.paint[which])

    @staticmethod
    def joined(groups: Sequence[Instances]) -> Instances:
        return Instances(*(np.concatenate([getattr(g, name) for g in groups]) for name in ("mesh", "place", "paint")))

    @staticmethod
    def none() -> Instances:
        return Instances(np.zeros(0, np.int64), np.zeros((0, 12)), np.zeros((0, 3), np.float32))


def places(R: Float[Array, "n 3 3"], t: Float[Array, "n 3"]) -> Float[Array, "n 12"]:
    return np.concatenate([R.reshape(-1, 9), t], axis=1)


def linear(*srgb: float) -> Float[Array, "3"]:
    """Linear light of an sRGB colour in 0..1."""
    return np.asarray(linear_from_srgb(srgb), np.float32)
