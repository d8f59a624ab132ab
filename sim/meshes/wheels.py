"""Wheels: a closed tyre and rim turned about the axle, its outer face painted with spokes."""

from __future__ import annotations

import numpy as np

from sim.meshes.solid import Part, face_normals, lathe
from sim.textures import Board

Array = np.ndarray

# (radius / wheel radius, share of the half width toward the outside), from the outer hub over the tread to the inside.
_FINE = ((0, 0.55), (0.16, 0.55), (0.60, 0.66), (0.66, 0.98), (0.72, 1.0), (0.93, 0.97), (1.0, 0.72), (1.0, -0.72),
         (0.93, -0.97), (0.66, -1.0), (0, -0.8))  # fmt: skip
_COARSE = ((0, 0.9), (0.93, 0.97), (1.0, 0.75), (1.0, -0.75), (0.66, -1.0), (0, -0.9))
_ROUGH = ((0, 1.0), (1.0, 1.0), (1.0, -1.0), (0, -1.0))
_TYRE = (0.012, 0.012, 0.013)


def wheel(
    radius: float, width: float, segments: int, chart: tuple[float, float, float], rubber_uv: tuple[float, float]
) -> Part:
    """A wheel of the left side about the origin; ``chart`` is (u, v, du per metre) of the painted face's centre."""
    shape = _FINE if segments > 20 else _COARSE if segments > 10 else _ROUGH
    profile = np.asarray(shape, float) * [radius, width / 2]
    vertices, faces = lathe(profile, segments)
    corners = vertices[faces]
    normals, _ = face_normals(corners)
    face = normals[:, 1] > 0.2
    u, v, scale = chart
    uv = np.where(face[:, None, None], corners[..., [0, 2]] * scale + [u, v], np.asarray(rubber_uv, float))
    rim = np.linalg.norm(corners[..., [0, 2]], axis=-1).mean(axis=1) < 0.68 * radius
    color = np.where(face[:, None], 1.0, np.asarray(_TYRE))
    return Part(vertices, faces, uv, color, np.where(face & rim, 0.12, 0.0))


def paint_wheel(board: Board, radius: float, rng: np.random.Generator, heavy: bool) -> None:
    """Tyre, rim, spokes or holes, hub and bolts around the board's origin [m]."""
    board.disc((0, 0), radius * 1.12, (0.13, 0.13, 0.135))
    for ring in (0.90, 0.80, 0.74):
        board.disc((0, 0), radius * ring, (0.15, 0.15, 0.155) if ring != 0.80 else (0.11, 0.11, 0.115))
    silver = rng.uniform(0.40, 0.60)
    metal = (silver, silver, silver * 1.02)
    dark = (0.09, 0.09, 0.10)
    board.disc((0, 0), radius * 0.69, metal)
    spokes = 10 if heavy else int(rng.choice([5, 5, 6, 7]))
    gap = rng.uniform(0.45, 0.65)
    for k in range(spokes):
        a = 2 * np.pi * (k + 0.25) / spokes
        if heavy:
            board.disc((0.5 * radius * np.cos(a), 0.5 * radius * np.sin(a)), 0.06 * radius, dark)
            continue
        half = np.pi / spokes * gap
        arc = np.linspace(-half, half, 7)
        outer = np.stack([np.cos(a + arc), np.sin(a + arc)], -1) * radius * 0.62
        inner = np.stack([np.cos(a + arc[::-1] * 0.7), np.sin(a + arc[::-1] * 0.7)], -1) * radius * 0.24
        board.poly(np.concatenate([outer, inner]), dark)
    board.disc((0, 0), radius * 0.17, tuple(np.multiply(metal, 0.8)))
    for k in range(5):
        a = 2 * np.pi * k / 5 + 0.3
        board.disc((0.12 * radius * np.cos(a), 0.12 * radius * np.sin(a)), 0.02 * radius, dark)
    board.disc((0, 0), radius * 0.06, (0.85, 0.85, 0.87))
