"""The painted ground: tiles of a map in metres, painted when they are first seen and kept."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import shapely
from jaxtyping import Float, Int, Shaped, UInt8, UInt16

from sim.aerial import paint_kernels as kernels
from sim.aerial.materials import Material
from sim.aerial.sunlight import light_values
from sim.aerial.surfaces import ASPHALT, SNOW
from sim.textures import noise

Array = np.ndarray
Bounds = tuple[float, float, float, float]
PIXEL_M = 0.10
TILE_PX = 1024
_BORDER_PX = 4
# Coverage of roads and paint is drawn on pixels this much finer than those of level 0.
_FINE = 4
# OpenCV fills every pixel that a polygon touches: half a fine pixel more on every side.
DRAWN_WIDER_M = PIXEL_M / _FINE / 2
_LEVELS = 3
_NEUTRAL = 128
# Edges of wheel tracks are soft over so many pixels.
_SOFT_PX = 7


@dataclass(frozen=True, eq=False)
class Strip:
    """A road's surface: polygon, tone (sRGB code value), and strokes on it: (line, width [m], change of tone)."""

    shape: Any
    tone: int
    strokes: tuple[tuple[Float[Array, "_ 2"], float, int], ...] = ()


@dataclass(frozen=True, eq=False)
class GroundPlan:
    """Everything that is painted on the ground, later items over earlier ones.

    covers: polygons and their materials; ``base`` covers what no polygon does. strips: asphalt. wear: polygons and
    polylines of other tone (patches, joints) on the asphalt: (points, width or 0 for an area, tone). paint: white
    polygons (markings), fresh (``worn_paint`` 0) or some years old (1). snow: the share of the asphalt that it hides
    where nobody drives.
    """

    base: Material
    covers: tuple[tuple[Any, Material], ...]
    strips: tuple[Strip, ...]
    wear: tuple[tuple[Float[Array, "_ 2"], float, int], ...]
    paint: tuple[Any, ...]
    snow: float = 0.0
    worn_paint: float = 1.0


@dataclass(frozen=True, eq=False)
class _Layers:
    """What is drawn on a tile (h, w): rows of materials, coverage by road and by paint, code values and tracks."""

    cover: Int[Array, "h w"]
    road: UInt8[Array, "h w"]
    tone: UInt8[Array, "h w"]
    track: UInt8[Array, "h w"]
    paint: UInt8[Array, "h w"]


class PaintedGround:
    """Tiles of the map that `GroundPlan` describes, of 0.1 m pixels and coarser ones; the last used are kept.

    Rows count from south to north. ``level`` k has pixels of 0.1 m times 2^k.
    """

    def __init__(self, plan: GroundPlan, bounds_m: Bounds, rng: np.random.Generator) -> None:
        self._plan = plan
        self._side = TILE_PX * PIXEL_M
        x0, y0, x1, y1 = bounds_m
        self._corner = (math.floor(x0 / self._side), math.floor(y0 / self._side))
        self.columns = math.ceil(x1 / self._side) - self._corner[0]
        self.rows = math.ceil(y1 / self._side) - self._corner[1]
        self._trees = {
            "covers": shapely.STRtree([p for p, _ in plan.covers]),
            "strips": shapely.STRtree([s.shape for s in plan.strips]),
            "wear": shapely.STRtree([shapely.LineString(p) for p, _, _ in plan.wear]),
            "paint": shapely.STRtree(list(plan.paint)),
        }
        materials = [plan.base, *(m for _, m in plan.covers)]
        self._rows = np.stack([m.row() for m in materials])
        self._surfaces = np.stack([*(m.surface.row() for m in materials), ASPHALT.row(), SNOW.row()])
        grain = noise((512, 512), 0.5, rng)
        # Coarser pixels average the grain.
        self._grain = [
            cv2.resize(grain, None, fx=2.0**-k, fy=2.0**-k, interpolation=cv2.INTER_AREA) for k in range(_LEVELS)
        ]
        self._mid = noise((1024, 1024), 1.7, rng)
        self._coarse = noise((512, 512), 2.2, rng)
        self._pools: dict[tuple[int, bool], Array] = {}
        self._slots: dict[tuple[int, bool], OrderedDict[tuple[int, int], int]] = {}

    def level(self, sampling_m: float) -> int:
        """The level for samples so far apart."""
        return int(np.clip(round(math.log2(max(sampling_m, 1e-3) / PIXEL_M)), 0, _LEVELS - 1))

    def grid(self, level: int) -> Float[Array, "5"]:
        """x, y of the tiles' corner [m], pixel [m], pixels per tile, border: as `shade_kernels.shade` wants them."""
        c, r = self._corner
        return np.array(
            [c * self._side, r * self._side, PIXEL_M * 2**level, TILE_PX >> level, _BORDER_PX >> level], float
        )

    def tiles(
        self, bounds_m: Bounds, level: int, warmth: bool = False
    ) -> tuple[Shaped[Array, "slots h w 3"], Int[Array, "rows columns"]]:
        """The pool of tiles and which of it lies where (-1: nowhere), for all tiles that meet the bounds.

        Tiles are `paint`'s, or with ``warmth`` those of `warmth`.
        """
        x0, y0, x1, y1 = bounds_m
        c0, r0 = (
            max(math.floor(x0 / self._side) - self._corner[0], 0),
            max(math.floor(y0 / self._side) - self._corner[1], 0),
        )
        c1 = min(math.floor(x1 / self._side) - self._corner[0], self.columns - 1)
        r1 = min(math.floor(y1 / self._side) - self._corner[1], self.rows - 1)
        wanted = [(r, c) for r in range(r0, r1 + 1) for c in range(c0, c1 + 1)]
        slots = self._slots.setdefault((level, warmth), OrderedDict())
        for key in wanted:
            if key in slots:
                slots.move_to_end(key)
        missing = [key for key in wanted if key not in slots]
        table = np.full((self.rows, self.columns), -1, np.int64)
        pool = self._room(level, warmth, len(wanted))
        for key in missing:
            slot = len(slots) if len(slots) < len(pool) else slots.popitem(last=False)[1]
            pool[slot] = self.warmth(*key, level) if warmth else self.paint(*key, level)
            slots[key] = slot
        for key in wanted:
            table[key] = slots[key]
        return pool, table

    def _room(self, level: int, warmth: bool, count: int) -> Shaped[Array, "slots h w 3"]:
        """The pool of a level, with room for so many tiles at once."""
        side = (TILE_PX + 2 * _BORDER_PX) >> level
        pool: Array = self._pools.get((level, warmth), np.empty((0, side, side, 3), np.uint16 if warmth else np.uint8))
        if len(pool) < count:
            larger = np.empty((count + 16, side, side, 3), pool.dtype)
            larger[: len(pool)] = pool
            self._pools[level, warmth] = pool = larger
        return pool

    def paint(self, row: int, column: int, level: int = 0) -> UInt8[Array, "h w 3"]:
        """One tile with its border."""
        return self._coloured(row, column, level, self._layers(row, column, level))

    def warmth(self, row: int, column: int, level: int = 0) -> UInt16[Array, "h w 3"]:
        """One tile as `paint_kernels.warm` makes it: how warm the ground is, in codes."""
        layers = self._layers(row, column, level)
        x, y = self._first(row, column, level)
        colours = self._coloured(row, column, level, layers)
        out = np.empty(colours.shape, np.uint16)
        kernels.warm(
            x, y, PIXEL_M * 2**level, colours, light_values(), layers.cover, self._surfaces, layers.road, layers.track,
            self._mid, self._coarse, self._plan.snow, out,
        )  # fmt: skip
        return out

    def _first(self, row: int, column: int, level: int) -> tuple[int, int]:
        """Column and row of a tile's first pixel, border included, on the map of a level."""
        side, border = TILE_PX >> level, _BORDER_PX >> level
        return (self._corner[0] + column) * side - border, (self._corner[1] + row) * side - border

    def _coloured(self, row: int, column: int, level: int, layers: _Layers) -> UInt8[Array, "h w 3"]:
        out = np.empty((*layers.cover.shape, 3), np.uint8)
        kernels.colour(
            *self._first(row, column, level), PIXEL_M * 2**level, layers.cover, self._rows, layers.road, layers.tone,
            layers.track, layers.paint, self._grain[level], self._mid, self._coarse, self._plan.snow,
            self._plan.worn_paint, out,
        )  # fmt: skip
        return out

    def _layers(self, row: int, column: int, level: int) -> _Layers:
        """What is drawn on a tile."""
        side, pixel_m = (TILE_PX + 2 * _BORDER_PX) >> level, PIXEL_M * 2**level
        low = np.array(self._first(row, column, level)) * pixel_m
        box = shapely.box(*low, *(low + side * pixel_m))
        board = _Board(low, box, pixel_m)
        cover = np.zeros((side, side), np.int32)
        for k in self._inside("covers", box):
            board.fill(cover, self._plan.covers[k][0], int(k) + 1)
        tone = np.full((side, side), 110, np.uint8)
        track = np.full((side, side), _NEUTRAL, np.uint8)
        strips = [self._plan.strips[k] for k in self._inside("strips", box)]
        road = board.coverage([s.shape for s in strips], side)
        for strip in strips:
            board.fill(tone, strip.shape.buffer(pixel_m), strip.tone)
        for strip in strips:
            for line, width, change in strip.strokes:
                board.stroke(track, line, width, _NEUTRAL + change)
        for k in self._inside("wear", box):
            points, width, value = self._plan.wear[k]
            if width:
                board.stroke(tone, points, width, value)
            else:
                board.fill(tone, shapely.Polygon(points), value)
        paint = board.coverage([self._plan.paint[k] for k in self._inside("paint", box)], side)
        soft = (_SOFT_PX >> level) | 1
        return _Layers(cover, road, tone, cv2.blur(track, (soft, soft)), paint)

    def _inside(self, layer: str, box: Any) -> Int[Array, "k"]:
        """Numbers of the items that meet a box, in their order."""
        return np.asarray(np.sort(self._trees[layer].query(box, predicate="intersects")))


class _Board:
    """Draws shapes in metres on images whose pixel (0, 0) begins at ``low``."""

    _SHIFT = 8
    # Lines are not clipped: so many bits hold some 10 km.
    _COARSE_SHIFT = 4

    def __init__(self, low: Float[Array, "2"], box: Any, pixel_m: float) -> None:
        self._low, self._pixel_m = low, pixel_m
        self._fine = _FINE * round(pixel_m / PIXEL_M)
        # Fixed-point coordinates overflow far away, and clipping is cheap.
        self._box = box.buffer(8.0)

    def coverage(self, shapes: Sequence[Any], side: int) -> UInt8[Array, "side side"]:
        """How much of each pixel some shapes cover, 0 to 255."""
        if not shapes:
            return np.zeros((side, side), np.uint8)
        fine = np.zeros((side * self._fine, side * self._fine), np.uint8)
        for shape in shapes:
            self.fill(fine, shape, 255, self._fine)
        return np.asarray(cv2.resize(fine, (side, side), interpolation=cv2.INTER_AREA))

    def fill(self, image: Array, shape: Any, value: int, fine: int = 1) -> None:
        clipped = shape if self._box.contains(shape) else shapely.intersection(shape, self._box)
        for part in shapely.get_parts(clipped):
            if part.geom_type == "Polygon" and not part.is_empty:
                rings = [self._fixed(shapely.get_coordinates(r), fine) for r in (part.exterior, *part.interiors)]
                cv2.fillPoly(image, rings, value, cv2.LINE_8, self._SHIFT)

    def stroke(self, image: Array, line: Float[Array, "n 2"], width_m: float, value: int) -> None:
        """A polyline of a width in whole pixels, with smooth edges where it is one pixel wide."""
        points = (line - self._low) / self._pixel_m - 0.5
        fixed = np.round(points * 2**self._COARSE_SHIFT).astype(np.int32)
        wide = max(round(width_m / self._pixel_m), 1)
        kind = cv2.LINE_AA if wide == 1 else cv2.LINE_8
        cv2.polylines(image, [fixed], False, value, wide, kind, self._COARSE_SHIFT)

    def _fixed(self, xy: Array, fine: int) -> Int[Array, "n 2"]:
        pixels = (xy - self._low) / (self._pixel_m / fine) - 0.5
        return np.asarray(np.round(pixels * 2**self._SHIFT), np.int32)
