"""Which oriented boxes on the ground overlap."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

Array = np.ndarray


def overlapping(
    centre_m: Float[Array, "n 2"],
    direction: Float[Array, "n 2"],
    size_m: Float[Array, "n 2"],
    moving: Bool[Array, "n"] | None = None,
) -> Int[Array, "m 2"]:
    """Pairs (i < j) of rectangles that overlap: centre, unit direction of the length, (length, width) [m].

    Separating axes: two convex shapes are apart where one of their sides' directions shows a gap. Boxes without a
    position (NaN) overlap none. With ``moving``, pairs without a moving box are left out.
    """
    present = np.flatnonzero(np.isfinite(centre_m).all(axis=1))
    p, d, half = centre_m[present], direction[present], size_m[present] / 2
    moves = np.ones(len(present), bool) if moving is None else moving[present]
    i, j = _near(p, np.hypot(half[:, 0], half[:, 1]), moves)
    left = np.stack([-d[:, 1], d[:, 0]], axis=-1)
    axes = np.stack([d[i], left[i], d[j], left[j]], axis=1)
    gap = np.abs(np.einsum("nak,nk->na", axes, p[j] - p[i]))
    for k in (i, j):
        gap -= half[k, :1] * np.abs(np.einsum("nak,nk->na", axes, d[k]))
        gap -= half[k, 1:] * np.abs(np.einsum("nak,nk->na", axes, left[k]))
    hit = (gap < 0).all(axis=1)
    found = present[np.sort(np.stack([i[hit], j[hit]], axis=1), axis=1)]
    return np.asarray(found[np.lexsort(found.T[::-1])], int)


def _near(p: Array, radius: Array, moves: Array) -> tuple[Array, Array]:
    """Pairs, each once and one of them moving, whose circles can touch."""
    movers = np.flatnonzero(moves)
    if not len(movers):
        return movers, movers
    farthest = float(radius[movers].max() + radius.max())
    near = cKDTree(p[movers]).sparse_distance_matrix(cKDTree(p), farthest, output_type="ndarray")
    i, j = movers[near["i"]], near["j"]
    once = ((i < j) | ~moves[j]) & (near["v"] < radius[i] + radius[j])
    return i[once], j[once]
