"""Points on a body's visible skin, and whether two placed bodies share a volume."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from sim.meshes.solid import face_normals
from sim.model import Model, VehicleModel
from sim.pose import Pose

Array = np.ndarray

# Directions from which a camera at road height may look: around the vehicle, slightly from above.
_AZIMUTHS, _ELEVATION = 8, 0.12
_UNDERSIDE = -0.5
# Pairs of point and triangle tested at a time: bounds the memory, whatever the number of points.
_PAIRS = 1_000_000


def sample_surface(
    model: Model, count: int, rng: np.random.Generator
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Points and unit normals in the model's frame, even in area over the skin a camera beside it can see.

    The underside and what no such camera sees (wheel houses, inner faces) are left out. A grid without faces gives
    points of the grid, each at most once while they last, with normals of zero.

    Raises
        ValueError: ``count`` is negative, or nothing of the model can be seen.
    """
    if count < 0:
        raise ValueError(f"count: expected >= 0, got {count}")
    if len(model.solid_faces) == 0:
        n = len(model.solid_vertices)
        chosen = np.concatenate([rng.permutation(n) for _ in range(-(-count // n))] or [np.zeros(0, int)])[:count]
        return model.solid_vertices[chosen], np.zeros((count, 3))
    corners = model.solid_vertices[model.solid_faces]
    normals, areas = face_normals(corners)
    weights = np.where(normals[:, 2] > _UNDERSIDE, areas, 0)
    if weights.sum() <= 0:
        raise ValueError(f"model {model.name}: no face looks sideways or up")
    points, faces = np.zeros((0, 3)), np.zeros(0, int)
    for _ in range(20):
        if len(points) >= count:
            return points[:count], normals[faces[:count]]
        p, f = _scatter(corners, weights, count - len(points) + 40, rng)
        seen = _seen_from_beside(p, normals[f], corners)
        points, faces = np.concatenate([points, p[seen]]), np.concatenate([faces, f[seen]])
    raise ValueError(f"model {model.name}: almost nothing of it can be seen from beside")


def _scatter(corners: Array, weights: Array, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Points (n, 3) and their faces, faces drawn by weight."""
    faces = rng.choice(len(corners), count, p=weights / weights.sum())
    a, b = rng.random((2, count, 1))
    a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
    c = corners[faces]
    return c[:, 0] + a * (c[:, 1] - c[:, 0]) + b * (c[:, 2] - c[:, 0]), faces


def _seen_from_beside(points: Array, normals: Array, corners: Array) -> Bool[Array, "n"]:
    """Whether at least one direction around the body looks at a point's front with nothing in between."""
    azimuth = np.arange(_AZIMUTHS) * 2 * np.pi / _AZIMUTHS + 0.13
    directions = np.stack([np.cos(azimuth), np.sin(azimuth), np.full(_AZIMUTHS, np.tan(_ELEVATION))], axis=-1)
    seen = np.zeros(len(points), bool)
    for d in np.concatenate([directions, [[0.3, 0.2, 1.0]]]):
        todo = np.flatnonzero(~seen & (normals @ d > 0.05))
        if len(todo):
            seen[todo] = ~_blocked(points[todo] + 1e-4 * normals[todo], d, corners)
    return seen


def _blocked(points: Array, direction: Array, corners: Array) -> Bool[Array, "n"]:
    """Whether rays from points (n, 3) along one direction hit any triangle, tested in the plane across it."""
    d = direction / np.linalg.norm(direction)
    u = np.cross(d, [0.0, 0, 1] if abs(d[2]) < 0.9 else [1.0, 0, 0])
    u /= np.linalg.norm(u)
    across = np.stack([u, np.cross(d, u), d])
    p, t = points @ across.T, corners @ across.T
    a, ab, ac = t[:, 0], t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    keep = np.abs(area) > 1e-14
    a, ab, ac, area = a[keep], ab[keep], ac[keep], area[keep]

    def covered(p: Array) -> Array:
        q = p[:, None, :2] - a[None, :, :2]
        v = (q[..., 0] * ac[:, 1] - q[..., 1] * ac[:, 0]) / area
        w = (ab[:, 0] * q[..., 1] - ab[:, 1] * q[..., 0]) / area
        height = a[:, 2] + v * ab[:, 2] + w * ac[:, 2]
        return np.asarray(np.any((v >= 0) & (w >= 0) & (v + w <= 1) & (height > p[:, 2:]), axis=1))

    step = max(1, _PAIRS // max(1, len(area)))
    return np.concatenate([covered(p[i : i + step]) for i in range(0, len(p), step)])


def bounding_box(model: VehicleModel) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Centre and half extents of the body's box in the vehicle frame, from its ``size_m``."""
    L, W, H = model.size_m
    return np.array([L / 2 - model.rear_overhang_m, 0, H / 2]), np.array([L, W, H]) / 2


def volumes_intersect(a: VehicleModel, T_wa: Pose, b: VehicleModel, T_wb: Pose) -> Bool[Array, "*b"]:
    """Whether the oriented boxes of two bodies overlap (touching does not count), for every pose of a batch.

    Separating axes (Gottschalk et al. 1996): the six face normals and the nine cross products of edges.
    """
    (ca, ha), (cb, hb) = bounding_box(a), bounding_box(b)
    D = T_wa.inv() @ T_wb
    C, t = D.R, D.apply(cb) - ca
    Q = np.abs(C) + 1e-12
    overlap = np.all(np.abs(t) < ha + Q @ hb, axis=-1)
    t_b = np.einsum("...ij,...i->...j", C, t)
    overlap &= np.all(np.abs(t_b) < hb + np.einsum("...ij,i->...j", Q, ha), axis=-1)
    for i in range(3):
        i1, i2 = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            j1, j2 = (j + 1) % 3, (j + 2) % 3
            reach = ha[i1] * Q[..., i2, j] + ha[i2] * Q[..., i1, j] + hb[j1] * Q[..., i, j2] + hb[j2] * Q[..., i, j1]
            apart = np.abs(t[..., i2] * C[..., i1, j] - t[..., i1] * C[..., i2, j])
            overlap &= (apart < reach + 1e-12) | (np.linalg.norm(np.cross(np.eye(3)[i], C[..., :, j]), axis=-1) < 1e-6)
    return np.asarray(overlap)
