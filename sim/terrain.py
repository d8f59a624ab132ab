"""The ground as an elevation grid in the world frame: heights, normals, where rays meet it; procedural relief."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.fft
from jaxtyping import Bool, Float

from sim import terrain_kernels as kernels
from sim.archive import freeze

Array = np.ndarray
# (least x, least y, greatest x, greatest y) [m].
Bounds = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class ElevationGrid:
    """Heights [m] at the nodes of a regular grid of frame w, bilinear between them.

    ``heights_m[i, j]`` is the height z at (corner_m[0] + j spacing_m, corner_m[1] + i spacing_m): row 0 is the south.
    Outside the nodes there is no ground: heights and normals are NaN there and rays meet nothing.

    Raises
        ValueError: fewer than 2 x 2 nodes, a height that is not finite, a spacing that is not positive.
    """

    heights_m: Float[Array, "rows columns"]
    corner_m: tuple[float, float]
    spacing_m: float

    def __post_init__(self) -> None:
        h = np.asarray(self.heights_m, float)
        if h.ndim != 2 or min(h.shape) < 2:
            raise ValueError(f"ElevationGrid.heights_m: expected at least 2 x 2 nodes, got shape {h.shape}")
        if not np.isfinite(h).all():
            raise ValueError(f"ElevationGrid.heights_m: {np.count_nonzero(~np.isfinite(h))} heights are not finite")
        if not (self.spacing_m > 0 and math.isfinite(self.spacing_m)):
            raise ValueError(f"ElevationGrid.spacing_m: expected > 0, got {self.spacing_m}")
        object.__setattr__(self, "heights_m", freeze(h))

    @staticmethod
    def from_fields(fields: Mapping[str, Any]) -> ElevationGrid:
        x, y = fields["corner_m"]
        return ElevationGrid(fields["heights_m"], (float(x), float(y)), float(fields["spacing_m"]))

    @property
    def bounds_m(self) -> Bounds:
        """(least x, least y, greatest x, greatest y) of the nodes."""
        (x, y), (rows, columns) = self.corner_m, self.heights_m.shape
        return x, y, x + (columns - 1) * self.spacing_m, y + (rows - 1) * self.spacing_m

    @cached_property
    def lowest_m(self) -> float:
        return float(self.heights_m.min())

    @cached_property
    def highest_m(self) -> float:
        return float(self.heights_m.max())

    @cached_property
    def steepest(self) -> float:
        """An upper bound of the slope |grad h|, tight to the twist of one cell."""
        east = np.abs(np.diff(self.heights_m, axis=1))
        north = np.abs(np.diff(self.heights_m, axis=0))
        both = np.hypot(np.maximum(east[:-1], east[1:]), np.maximum(north[:, :-1], north[:, 1:]))
        return float(both.max()) / self.spacing_m

    def contains(self, xy: Float[Array, "*b 2"]) -> Bool[Array, "*b"]:
        """Whether there is ground under (or over) a point (x, y) [m]."""
        x0, y0, x1, y1 = self.bounds_m
        x, y = xy[..., 0], xy[..., 1]
        return np.asarray((x >= x0) & (x <= x1) & (y >= y0) & (y <= y1))

    def height(self, xy: Float[Array, "*b 2"]) -> Float[Array, "*b"]:
        """Heights z [m] at points (x, y) [m]; NaN outside."""
        xy = np.asarray(xy, float)
        out = np.empty(xy.shape[:-1])
        kernels.heights(self.heights_m, *self.corner_m, self.spacing_m, xy.reshape(-1, 2), out.reshape(-1))
        return out

    def on_ground(self, xy: Float[Array, "*b 2"]) -> Float[Array, "*b 3"]:
        """Points (x, y) [m] with the height of the ground; NaN height outside."""
        return np.concatenate([xy, self.height(xy)[..., None]], axis=-1)

    def normal(self, xy: Float[Array, "*b 2"]) -> Float[Array, "*b 3"]:
        """Upward unit normals of the bilinear patches, (-dh/dx, -dh/dy, 1) normalised; NaN outside."""
        xy = np.asarray(xy, float)
        slope = np.empty(xy.shape)
        kernels.slopes(self.heights_m, *self.corner_m, self.spacing_m, xy.reshape(-1, 2), slope.reshape(-1, 2))
        n = np.concatenate([-slope, np.ones((*xy.shape[:-1], 1))], axis=-1)
        return np.asarray(n / np.linalg.norm(n, axis=-1, keepdims=True))

    def intersect(self, origin_w: Float[Array, "*#b 3"], direction_w: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
        """First points where rays meet the ground from above [m]; NaN where they do not (horizon, edge of the grid).

        Steep rays by vertical iteration (Kozempel 2012, Fig. 4.1), settled to 1e-7 m; where the ground's slope times
        the tangent of the off-nadir angle exceeds 1/2, or the iteration leaves the grid, exactly, from cell to cell.
        Directions need no unit length. A ray that starts below the ground, or enters below it from outside the grid,
        meets nothing. ``origin_w`` is one per ray or one for all.
        """
        direction = np.asarray(direction_w, float)
        origin = np.asarray(origin_w, float)
        if origin.size > 3:
            origin = np.broadcast_to(origin, direction.shape)
        out = np.empty(direction.shape)
        kernels.rays(
            self.heights_m,
            *self.corner_m,
            self.spacing_m,
            self.lowest_m,
            self.highest_m,
            self.steepest,
            np.ascontiguousarray(origin).reshape(-1, 3),
            np.ascontiguousarray(direction).reshape(-1, 3),
            out.reshape(-1, 3),
        )
        return out


def grid_shape(bounds_m: Bounds, spacing_m: float) -> tuple[int, int]:
    """(rows, columns) of the nodes that cover bounds from their south-western corner on.

    Raises
        ValueError: empty bounds or a spacing that is not positive.
    """
    x0, y0, x1, y1 = bounds_m
    if not (x1 > x0 and y1 > y0 and spacing_m > 0):
        raise ValueError(
            f"terrain: expected bounds (x0 < x1, y0 < y1) and spacing_m > 0, got {bounds_m} and {spacing_m}"
        )
    # A hair less, so that rounding does not add a row to bounds that are a multiple of the spacing.
    return max(math.ceil((y1 - y0) / spacing_m - 1e-9), 1) + 1, max(math.ceil((x1 - x0) / spacing_m - 1e-9), 1) + 1


def plane(bounds_m: Bounds, height_m: float = 0.0, slope: tuple[float, float] = (0.0, 0.0)) -> ElevationGrid:
    """A plane of ``height_m`` in the middle of the bounds and slope (dh/dx, dh/dy): exact with cells of half a side."""
    x0, y0, x1, y1 = bounds_m
    spacing = max(x1 - x0, y1 - y0)
    rows, columns = grid_shape(bounds_m, spacing)
    x = x0 + spacing * np.arange(columns) - (x0 + x1) / 2
    y = y0 + spacing * np.arange(rows) - (y0 + y1) / 2
    return ElevationGrid(height_m + slope[0] * x + slope[1] * y[:, None], (x0, y0), spacing)


def relief(
    bounds_m: Bounds,
    spacing_m: float,
    rng: np.random.Generator,
    *,
    rms_m: float,
    wavelengths_m: tuple[float, float],
    exponent: float = 4.0,
    height_m: float = 0.0,
) -> ElevationGrid:
    """Band-limited hills: a Gaussian field with power spectrum 1/f^exponent between two wavelengths and nothing beyond.

    The heights of the grid have the mean ``height_m`` and the standard deviation ``rms_m`` exactly. Natural relief has
    exponents of 3 to 5.

    Raises
        ValueError: a band that is empty, shorter than two nodes or longer than the longer side of the bounds.
    """
    shape = grid_shape(bounds_m, spacing_m)
    short, long = wavelengths_m
    side = spacing_m * (max(shape) - 1)
    if not 2 * spacing_m <= short < long <= side:
        raise ValueError(
            f"terrain: wavelengths_m (shortest, longest) of relief must lie between {2 * spacing_m:g} (two nodes) and "
            f"{side:g} (the longer side), got {wavelengths_m}"
        )
    # The field repeats; on a field larger by one longest wave the part used does not show it.
    padded = tuple(scipy.fft.next_fast_len(n + math.ceil(long / spacing_m), real=True) for n in shape)
    f = np.hypot(np.fft.fftfreq(padded[0], spacing_m)[:, None], np.fft.rfftfreq(padded[1], spacing_m))
    band = (f >= 1 / long) & (f <= 1 / short)
    amplitude = np.where(band, np.where(band, f, 1.0) ** (-exponent / 2), 0.0)
    field = scipy.fft.irfft2(scipy.fft.rfft2(rng.standard_normal(padded)) * amplitude, s=padded)
    field = field[: shape[0], : shape[1]]
    return ElevationGrid(height_m + rms_m * (field - field.mean()) / field.std(), bounds_m[:2], spacing_m)
