"""Trees, bushes and the wooded horizon: trunks with branches, crowns of small leaf clusters that look outward."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from sim.meshes.solid import Part, closed_tube, face_normals, merged

Array = np.ndarray
_UP = np.array([0.0, 0.0, 1.0])
_BARK = np.array([0.16, 0.12, 0.09])


def _limb(start: Array, end: Array, r0: float, r1: float, sides: int = 6) -> Part:
    """A tapering closed limb."""
    d = (end - start) / np.linalg.norm(end - start)
    side = np.cross(d, [0.3, 0.9, 0.2])
    side /= np.linalg.norm(side)
    up = np.cross(d, side)
    a = np.arange(sides) * 2 * np.pi / sides
    ring = np.cos(a)[:, None] * side + np.sin(a)[:, None] * up
    vertices, faces = closed_tube(np.stack([start + r0 * ring, end + r1 * ring]))
    uv = np.zeros((len(faces), 3, 2)) + 0.02 * vertices[faces][..., [0, 2]]
    return Part(vertices, faces, uv, np.broadcast_to(_BARK * 1.6, (len(faces), 3)), np.zeros(len(faces)))


def _clusters(center: Array, radius: Array, count: int, size: float, tint: Array, rng: np.random.Generator) -> Part:
    """Leaf clusters: triangles scattered over the shell of an ellipsoid, facing outward, shaded like it."""
    d = rng.standard_normal((count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    depth = rng.uniform(0.84, 1.08, (count, 1))
    at = center + d * radius * depth
    n = d + 0.5 * rng.standard_normal((count, 3))
    n -= np.minimum(np.sum(n * d, axis=1, keepdims=True) - 0.3, 0) * d
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    a = np.cross(n, rng.standard_normal((count, 3)))
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b = np.cross(n, a)
    angle = np.array([0.0, 2.1, 4.2]) + rng.uniform(-0.5, 0.5, (count, 3))
    s = size * rng.uniform(0.55, 1.25, (count, 3))
    plane = np.stack([s * np.cos(angle), s * np.sin(angle)], axis=-1)
    vertices = at[:, None] + plane[..., :1] * a[:, None] + plane[..., 1:] * b[:, None]
    uv = rng.uniform(0, 1, (count, 1, 2)) + 0.5 * plane / 0.9
    light = rng.uniform(0.65, 1.2, count) * (0.85 + 0.25 * d[:, 2])
    color = np.clip(light[:, None] * tint, 0, 1)
    round_ = d + 0.45 * n
    round_ /= np.linalg.norm(round_, axis=1, keepdims=True)
    normals = np.repeat(round_[:, None], 3, axis=1)
    faces = np.arange(3 * count).reshape(-1, 3)
    return Part(vertices.reshape(-1, 3), faces, uv, color, np.zeros(count), normals)


def _lump(center: Array, radius: Array, rows: int, columns: int, tint: Array, rng: np.random.Generator) -> Part:
    """A closed, uneven ball of foliage, darker below."""
    theta = np.linspace(0, np.pi, rows + 2)[1:-1, None]
    phi = (np.arange(columns) + 0.5 * rng.random()) * 2 * np.pi / columns
    d = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -np.cos(theta) + 0 * phi], axis=-1)
    vertices, faces = closed_tube(center + d * rng.uniform(0.80, 1.05, (rows, columns, 1)) * radius)
    corners = vertices[faces]
    out = corners - center
    normals = out / np.linalg.norm(out, axis=-1, keepdims=True)
    across = np.where(np.abs(normals[..., 2:]).mean(axis=1, keepdims=True) > 0.75, out[..., :2], out[..., [0, 2]])
    side = np.abs(normals[..., 0]).mean(axis=1) > 0.65
    across[side] = out[side][..., 1:]
    light = rng.uniform(0.75, 1.1, len(faces)) * (0.72 + 0.25 * normals[..., 2].mean(axis=1))
    color = np.clip(light[:, None] * tint, 0, 1)
    return Part(vertices, faces, across / 1.5 + rng.random(2), color, np.zeros(len(faces)), normals)


def _foliage(center: Array, radius: Array, detail: float, leaf: float, tint: Array, rng: np.random.Generator) -> Part:
    """A lump with leaf clusters standing off it, so that its outline is ragged."""
    rows, columns = (5, 9) if detail > 0.6 else (4, 7) if detail > 0.3 else (3, 5)
    lump = _lump(center, 0.9 * radius, rows, columns, tint, rng)
    return merged([lump, _clusters(center, radius, int(14 + 60 * detail), leaf, tint, rng)])


def tree(
    position: tuple[float, float, float], height: float, detail: float, rng: np.random.Generator, stem: float = 0.3
) -> Part:
    """A broad-leaved tree; ``detail`` 1 is about 1300 triangles, 0.3 about 350; ``stem`` is the branchless share."""
    p = np.asarray(position, float)
    lean = np.array([*rng.normal(0, 0.03, 2), 1.0])
    high = 0.5 * (1 - stem) * height
    stem = stem * height * rng.uniform(0.95, 1.1)
    middle = p + lean * (stem + high)
    crown = np.array([0.8, 0.8, 1.0]) * high * rng.uniform(0.9, 1.1, 3)
    tint = np.array([rng.uniform(0.85, 1.15), 1.0, 0.9]) * rng.uniform(0.75, 1.0)
    radius, leaf = 0.022 * height, 0.035 * height / max(detail, 0.3) ** 0.4
    parts = [_limb(p - _UP * 0.1, p + lean * (stem + 0.6 * high), radius, 0.5 * radius)]
    blobs = 6 if detail > 0.4 else 3
    for k in range(blobs):
        a = 2 * np.pi * k / blobs + rng.uniform(0, 0.6)
        out = np.array([np.cos(a), np.sin(a), rng.uniform(-0.6, 0.6)]) * crown * 0.5
        if detail > 0.4:
            fork = p + lean * stem * rng.uniform(0.85, 1.1)
            parts.append(_limb(fork, middle + out * 0.8, 0.4 * radius, 0.1 * radius, 4))
        blob = crown * rng.uniform(0.46, 0.60)
        parts.append(_foliage(middle + out, blob, detail, leaf, tint * rng.uniform(0.88, 1.1), rng))
    parts.append(_foliage(middle + _UP * 0.42 * crown[2], crown * [0.62, 0.62, 0.58], detail, leaf, tint, rng))
    return merged(parts)


def conifer(position: tuple[float, float, float], height: float, detail: float, rng: np.random.Generator) -> Part:
    """A spruce: whorls of clusters that narrow toward the top."""
    p = np.asarray(position, float)
    tint = np.array([0.55, 0.72, 0.62]) * rng.uniform(0.7, 1.0)
    parts = [_limb(p - _UP * 0.1, p + _UP * 0.97 * height, 0.018 * height, 0.003 * height, 5)]
    parts.append(_lump(p + _UP * 0.42 * height, np.array([0.13, 0.13, 0.36]) * height, 4, 7, 0.5 * tint, rng))
    whorls = 11
    for k in range(whorls):
        share = (k + 0.5) / whorls
        wide = 0.19 * height * (1 - share) * rng.uniform(0.8, 1.2) + 0.02 * height
        count = max(int(45 * detail * (1.2 - share)), 8)
        leaf = 0.045 * height / detail**0.4 * (1.15 - 0.6 * share)
        at = p + _UP * height * (0.12 + 0.84 * share)
        parts.append(_clusters(at, np.array([wide, wide, 0.05 * height]), count, leaf, tint, rng))
    return merged(parts)


def bush(position: tuple[float, float, float], size: float, detail: float, rng: np.random.Generator) -> Part:
    """A bush or a piece of hedge."""
    p = np.asarray(position, float) + _UP * 0.42 * size
    radius = np.array([0.6, 0.6, 0.5]) * size * rng.uniform(0.85, 1.2, 3)
    tint = np.array([0.9, 0.95, 0.8]) * rng.uniform(0.65, 1.0)
    return _foliage(p, radius, detail, 0.10 * size / detail**0.4, tint, rng)


def wood_edge(
    line: Float[Array, "n 2"], toward: Float[Array, "n 2"], ground_m: float, rng: np.random.Generator
) -> Part:
    """The edge of a wood or a high hedge along a line in steps of 2.5 m, seen from the side it is turned ``toward``."""
    n, rows = len(line), 7
    t = np.arange(n) * 2.5
    waves = sum(rng.uniform(0.3, 1) * np.sin(2 * np.pi * t / w + rng.uniform(0, 6.3)) for w in (97.0, 41.0, 19.0, 11.0))
    height = np.clip(7.0 + 2.6 * waves, 2.5, 13.0)[:, None]
    level = np.linspace(0, 1, rows)
    back = -3.2 * level**2 + 0.9 * np.sin(np.pi * level) + rng.normal(0, 0.45, (n, rows)) * (level > 0)
    xy = line[:, None] + toward[:, None] * back[..., None]
    z = ground_m - 0.2 + height * np.sin(level * np.pi / 2) + rng.normal(0, 0.3, (n, rows)) * (level > 0)
    vertices = np.concatenate([xy, z[..., None]], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(n - 1), np.arange(rows - 1), indexing="ij")
    a, b = (i * rows + j).ravel(), ((i + 1) * rows + j).ravel()
    faces = np.concatenate([np.stack([a, b, b + 1], -1), np.stack([a, b + 1, a + 1], -1)])
    normals, _ = face_normals(vertices[faces])
    if np.sum(normals[:, :2] * np.repeat(toward, rows, axis=0)[faces[:, 0]]) < 0:
        faces = faces[:, ::-1]
    along, up = np.repeat(t, rows), np.tile(level, n) * height.repeat(rows)
    light = rng.uniform(0.5, 0.9, (len(faces), 1)) * (0.45 + 0.5 * np.tile(level, n)[faces].mean(axis=1, keepdims=True))
    uv = np.stack([along, up], axis=-1)[faces] / 1.6
    wall = Part(vertices, faces, uv, light * np.array([0.9, 1.0, 0.85]), np.zeros(len(faces)))
    chosen = rng.integers(0, n * rows, 4 * n)
    tint = np.array([0.85, 0.95, 0.8])
    tufts = [_clusters(vertices[k], np.full(3, 0.9), 3, 0.45, tint * rng.uniform(0.5, 1), rng) for k in chosen]
    return merged([wall, *tufts])


def wooded_hills(center: tuple[float, float], radius: float, rng: np.random.Generator) -> Part:
    """A ring of wooded hills on the horizon, seen from inside."""
    n, rows = 150, 7
    a = np.arange(n) * 2 * np.pi / n
    skyline = 13 + sum(rng.uniform(1, 6) / k**0.5 * np.sin(k * a + rng.uniform(0, 6.3)) for k in (2, 3, 5, 7, 11))
    level = np.linspace(0, 1, rows)[:, None]
    jag = np.where(level > 0, rng.normal(0, 1.0, (rows, n)), 0)
    r = radius + 60 * level + 4 * jag
    z = -1.0 + np.maximum(skyline, 5) * np.sqrt(level) + 1.3 * jag * level
    rings = np.stack([center[0] + r * np.cos(a), center[1] + r * np.sin(a), z], axis=-1)
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(n), indexing="ij")
    p, q = i * n + j, i * n + (j + 1) % n
    faces = np.concatenate([np.stack([p, p + n, q + n], -1).reshape(-1, 3), np.stack([p, q + n, q], -1).reshape(-1, 3)])
    vertices = rings.reshape(-1, 3)
    corners = vertices[faces]
    around = np.arctan2(corners[..., 1] - center[1], corners[..., 0] - center[0])
    around = np.where(around - around.max(axis=1, keepdims=True) < -np.pi, around + 2 * np.pi, around)
    uv = np.stack([around * radius, corners[..., 2]], axis=-1) / 11.0
    light = 0.55 + 0.25 * rng.random((len(faces), 1))
    return Part(vertices, faces, uv, light * np.array([0.85, 1.0, 0.85]), np.zeros(len(faces)))
