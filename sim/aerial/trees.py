"""Trees seen from above: crowns as unions of round puffs of foliage, in some shapes and two levels of detail."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from sim.aerial.library import Mesh, Texture
from sim.aerial.surfaces import LEAVES
from sim.textures import noise

Array = np.ndarray
SHAPES = 8
"""Different crowns; each once fine and once coarse."""
_TEXTURE_M = 6.0
_DETAIL = ((44, 20), (28, 13))


def foliage(rng: np.random.Generator, size: int = 256) -> Texture:
    """Leaves in light and gaps, all of it paint."""
    fine, mid = noise((size, size), 0.9, rng), noise((size, size), 1.9, rng)
    light = np.exp(0.42 * fine + 0.22 * mid)
    texels = np.zeros((size, size, 4), np.float32)
    texels[..., 3] = np.clip(light, 0.2, 3.0)
    texels[..., 0] = 0.006 * np.clip(mid, 0, 2)
    return Texture(texels, repeat=True, coat=LEAVES, bare=LEAVES)


def crowns(rng: np.random.Generator, texture: int) -> list[Mesh]:
    """`SHAPES` crowns of radius 1 and height about 2 above their trunk's foot at (0, 0, 0), fine then coarse."""
    seeds = rng.integers(0, 2**32, SHAPES)
    return [_crown(np.random.default_rng(s), *detail, texture) for detail in _DETAIL for s in seeds]


def _crown(rng: np.random.Generator, around: int, rings: int, texture: int) -> Mesh:
    """Star-shaped surface of a union of balls around the crown's middle, with the balls' own normals."""
    count = int(rng.integers(22, 38))
    angle = rng.uniform(0, 2 * np.pi, count)
    up = rng.uniform(-0.45, 1.0, count)
    reach = np.sqrt(np.clip(1 - (0.75 * up) ** 2, 0.1, 1)) * rng.uniform(0.50, 0.82, count)
    ball = np.stack([reach * np.cos(angle), reach * np.sin(angle), 0.55 * up], axis=-1)
    radius = rng.uniform(0.16, 0.36, count)
    ball = np.concatenate([ball, [[0.0, 0.0, 0.0]]])
    radius = np.concatenate([radius, [0.55]])
    theta = np.linspace(0.0, 0.86 * np.pi, rings)
    phi = np.arange(around) * 2 * np.pi / around
    phi = phi + rng.uniform(-0.3, 0.3, around) * 2 * np.pi / around
    d = np.stack(
        [
            np.sin(theta)[:, None] * np.cos(phi),
            np.sin(theta)[:, None] * np.sin(phi),
            np.broadcast_to(np.cos(theta)[:, None], (rings, around)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    # Exit of the ray from the middle along d out of every ball.
    along = d @ ball.T
    root = along**2 - np.sum(ball**2, axis=1) + radius**2
    exit_ = np.where(root > 0, along + np.sqrt(np.maximum(root, 0)), 0.0)
    owner = np.argmax(exit_, axis=1)
    r = np.take_along_axis(exit_, owner[:, None], axis=1)
    r *= rng.uniform(1 - 0.003 * around, 1 + 0.002 * around, r.shape)
    p = d * r
    n = p - ball[owner]
    n = n / np.linalg.norm(n, axis=1, keepdims=True) + 0.45 * d + 0.25 * rng.standard_normal(d.shape)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    # Light reaches the outer parts; between the puffs it is dark.
    open_ = np.clip(1.25 * (r[:, 0] - 0.35) + 0.25 * (p[:, 2] + 0.4), 0.18, 1.0)
    st = (p[:, :2] + 0.4 * p[:, 2:]) * 5.0 / _TEXTURE_M + rng.random(2)
    p = p * [1, 1, 1.15] + [0, 0, 1.3]
    return Mesh(p, n, np.column_stack([st, open_, np.zeros(len(p))]), *_sphere_faces(rings, around, texture))


def _sphere_faces(rings: int, around: int, texture: int) -> tuple[Array, Array]:
    """Triangles of a grid of rings from the top down, counter-clockwise seen from outside."""
    i, j = np.meshgrid(np.arange(rings - 1), np.arange(around), indexing="ij")
    a, b = i * around + j, i * around + (j + 1) % around
    c, e = a + around, b + around
    upper, lower = np.stack([a, c, e], -1), np.stack([a, e, b], -1)
    faces = np.concatenate([upper.reshape(-1, 3), lower[1:].reshape(-1, 3)])
    return faces, np.full(len(faces), texture)


def paints(count: int, rng: np.random.Generator, season: str) -> Float[Array, "n 3"]:
    """Foliage in linear light: broad-leaved greens with some dark, yellow and copper ones; grey-brown in winter."""
    if season == "winter":
        base = np.array([0.075, 0.066, 0.055])
        return np.asarray(base * rng.uniform(0.7, 1.5, (count, 1)) * rng.uniform(0.95, 1.05, (count, 3)), np.float32)
    kinds = np.array([[0.058, 0.082, 0.032], [0.042, 0.064, 0.028], [0.078, 0.098, 0.036], [0.060, 0.038, 0.034]])
    drawn = kinds[rng.choice(4, count, p=[0.5, 0.32, 0.15, 0.03])]
    return np.asarray(drawn * rng.uniform(0.75, 1.25, (count, 1)) * rng.uniform(0.94, 1.06, (count, 3)), np.float32)
