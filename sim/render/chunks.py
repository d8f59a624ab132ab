"""Large surfaces in pieces, so that what is outside the view need not be drawn, and near pieces come first."""

from __future__ import annotations

import numpy as np

from sim.model import Surface

_CELL_M = 30.0
_FACES = 400  # about as many in a chunk: fewer would not repay the draw call


def chunks(surface: Surface) -> list[Surface]:
    """The surface itself, or, if it has many faces and is large, its parts by cells of a square grid."""
    extent = np.ptp(surface.vertices[:, :2], axis=0)
    size = max(_CELL_M, float(np.sqrt(extent[0] * extent[1] * _FACES / len(surface.faces))))
    if extent.max() < 1.5 * size:
        return [surface]
    cell = np.floor(surface.vertices[surface.faces].mean(axis=1)[:, :2] / size)
    _, which = np.unique(cell, axis=0, return_inverse=True)
    return [_part(surface, surface.faces[which == k]) for k in range(which.max() + 1)]


def _part(surface: Surface, faces: np.ndarray) -> Surface:
    used, renumbered = np.unique(faces, return_inverse=True)
    return Surface(
        vertices=surface.vertices[used],
        faces=renumbered.reshape(-1, 3),
        normals=surface.normals[used],
        color=surface.color[used],
        gloss=surface.gloss[used],
        uv=None if surface.uv is None else surface.uv[used],
        texture=surface.texture,
        repeat=surface.repeat,
        cast_shadow=surface.cast_shadow,
    )
