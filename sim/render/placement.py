"""What of the scene is drawn in a view: level of detail, frustum culling, order. Pure geometry without OpenGL."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from sim.archive import freeze_fields
from sim.model import Model, Surface
from sim.pose import Pose
from sim.render.chunks import chunks

Array = np.ndarray
_CORNERS = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(8, 3)


@dataclass(frozen=True)
class Item:
    """One thing in the scene; its instance id 1..65535 goes into the mask, and several items may share one."""

    model: Model
    instance: int

    def __post_init__(self) -> None:
        if not 1 <= self.instance <= 65535:
            raise ValueError(f"Item.instance: expected 1..65535 (0 is the sky), got {self.instance}")


@dataclass(frozen=True, eq=False)
class Inventory:
    """Every surface of every level of every item, one row each: item, level, index into ``surfaces``, its box.

    corners (n, 8, 3) of the box in the item's frame; casts (n,); instance (n,); center (items, 3) and radius (items,)
    of the items' finest level; switch_m (items, levels - 1), inf where a model has fewer levels.
    """

    surfaces: tuple[Surface, ...]
    item: Int[Array, "n"]
    level: Int[Array, "n"]
    surface: Int[Array, "n"]
    corners: Float[Array, "n 8 3"]
    casts: Bool[Array, "n"]
    instance: Int[Array, "n"]
    center: Float[Array, "i 3"]
    radius: Float[Array, "i"]
    switch_m: Float[Array, "i l"]

    def __post_init__(self) -> None:
        freeze_fields(self)


def _box(vertices: Array) -> Array:
    lo, hi = vertices.min(axis=0), vertices.max(axis=0)
    return np.asarray(lo + _CORNERS * (hi - lo))


def inventory(items: Sequence[Item]) -> Inventory:
    """Lists what the items consist of, large surfaces in pieces; what items share is listed once."""
    if not items:
        raise ValueError("items: expected at least one, got none")
    parts: dict[int, list[int]] = {}
    surfaces: list[Surface] = []
    rows, corners, centers, radii = [], [], [], []
    for i, item in enumerate(items):
        finest = np.concatenate([_box(s.vertices) for s in item.model.levels[0]])
        centers.append((finest.min(axis=0) + finest.max(axis=0)) / 2)
        radii.append(np.linalg.norm(finest - centers[-1], axis=-1).max())
        for level, whole in ((level, s) for level, surfaces_of in enumerate(item.model.levels) for s in surfaces_of):
            if id(whole) not in parts:
                _check(whole, item.model.name)
                pieces = chunks(whole)
                parts[id(whole)] = list(range(len(surfaces), len(surfaces) + len(pieces)))
                surfaces += pieces
            for k in parts[id(whole)]:
                rows.append((i, level, k, whole.cast_shadow, item.instance))
                corners.append(_box(surfaces[k].vertices))
    switch = np.full((len(items), max(len(i.model.levels) for i in items) - 1), np.inf)
    for row, item in zip(switch, items, strict=True):
        row[: len(item.model.switch_m)] = item.model.switch_m
    table = np.array(rows)
    return Inventory(
        surfaces=tuple(surfaces),
        item=table[:, 0],
        level=table[:, 1],
        surface=table[:, 2],
        corners=np.array(corners),
        casts=table[:, 3].astype(bool),
        instance=table[:, 4],
        center=np.array(centers),
        radius=np.array(radii),
        switch_m=switch,
    )


def _check(surface: Surface, name: str) -> None:
    """Refuses what graphics hardware would draw as black blotches or not at all without a word."""
    if not np.isfinite(surface.vertices).all():
        raise ValueError(f"Model {name}: vertices are not finite")
    if surface.faces.min() < 0 or surface.faces.max() >= len(surface.vertices):
        raise ValueError(f"Model {name}: faces name vertices outside 0..{len(surface.vertices) - 1}")
    length = np.linalg.norm(surface.normals, axis=-1)
    if not np.allclose(length, 1.0, atol=1e-3):
        raise ValueError(f"Model {name}: normals are not unit vectors, lengths {length.min():.3g}..{length.max():.3g}")
    if surface.texture is not None and surface.uv is None:
        raise ValueError(f"Model {name}: a texture needs uv")


@dataclass(frozen=True, eq=False)
class Placement:
    """The inventory in place at one moment, in a frame with world axes and its origin (the anchor) near the camera.

    The anchor keeps single precision on the graphics side exact to micrometres anywhere in the world.
    T_anchor_items (items, 4, 4); rows: the inventory's rows in the chosen levels; corners (rows, 8, 3).
    """

    anchor: Float[Array, "3"]
    T_anchor_items: Float[Array, "i 4 4"]
    rows: Int[Array, "r"]
    corners: Float[Array, "r 8 3"]

    def __post_init__(self) -> None:
        freeze_fields(self)


def place(inv: Inventory, T_w_items: Sequence[Pose], eye: Float[Array, "3"]) -> Placement:
    """Poses of all items and the level of detail of each, by its distance from ``eye`` (world)."""
    if len(T_w_items) != len(inv.center):
        raise ValueError(f"T_w_items: expected {len(inv.center)} poses, one per item, got {len(T_w_items)}")
    T = np.stack([p.matrix() for p in T_w_items])
    anchor = 8.0 * np.round(eye / 8.0)
    T[:, :3, 3] -= anchor
    center = np.einsum("nij,nj->ni", T[:, :3, :3], inv.center) + T[:, :3, 3]
    distance = np.linalg.norm(center + anchor - eye, axis=-1) - inv.radius
    level = np.sum(distance[:, None] > inv.switch_m, axis=-1)
    rows = np.flatnonzero(inv.level == level[inv.item])
    T_rows = T[inv.item[rows]]
    corners = np.einsum("nij,nkj->nki", T_rows[:, :3, :3], inv.corners[rows]) + T_rows[:, None, :3, 3]
    return Placement(anchor, T, rows, corners)


@dataclass(frozen=True, eq=False)
class Batch:
    """One draw call: a surface, where it stands, and whose it is."""

    surface: int
    T_anchor_items: Float[Array, "n 4 4"]
    instance: Int[Array, "n"]


def batches(inv: Inventory, placement: Placement, selected: Bool[Array, "r"], key: Float[Array, "r"]) -> list[Batch]:
    """The selected rows as draw calls, in ascending order of the key of their first row."""
    rows, key = placement.rows[selected], key[selected]
    order = np.argsort(key, kind="stable")
    groups: dict[int, list[int]] = {}
    for r in rows[order]:
        groups.setdefault(int(inv.surface[r]), []).append(int(r))
    return [Batch(s, placement.T_anchor_items[inv.item[r]], inv.instance[r]) for s, r in groups.items()]


def outside(clip: Float[Array, "r 8 4"]) -> Bool[Array, "r"]:
    """Whether boxes with corners in clip coordinates lie wholly beyond one plane of the view (the far one apart)."""
    x, y, z, w = np.moveaxis(clip, -1, 0)
    beyond = [x > w, x < -w, y > w, y < -w, z < -w]
    return np.asarray(np.any([b.all(axis=-1) for b in beyond], axis=0))
