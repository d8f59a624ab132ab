"""Elevation grids from files: SRTM ``.hgt`` tiles (1 and 3 arc seconds) and GeoTIFFs of any coordinate system.

GDAL reads them; the heights are taken bilinearly, through exact coordinates, at the nodes of a grid of the world.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import rasterio
import rasterio.fill
from jaxtyping import Bool, Float, Int
from pyproj import CRS
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window

from sim.geodesy import Georeference, ellipsoidal_height
from sim.terrain import Bounds, ElevationGrid, grid_shape

Array = np.ndarray

# Bytes of an SRTM tile: 3 or 1 arc seconds, one degree a side with both edges, two bytes a height.
_HGT_BYTES = {1201 * 1201 * 2: 3, 3601 * 3601 * 2: 1}
# A void farther from any height is refused: what would be filled in is invented. In pixels of the file.
VOID_REACH_PX = 50


class TerrainError(ValueError):
    """An elevation file that cannot be used; the message names the file, what was found and what is allowed."""


@dataclass(frozen=True, eq=False)
class TerrainReading:
    """A grid read from files, and how much of it is not theirs.

    ``voids`` counts the pixels of the files (the part used) that held no height and were filled from their
    surroundings; ``filled`` marks the nodes that such a pixel has a share in.
    """

    grid: ElevationGrid
    voids: int
    filled: Bool[Array, "rows columns"]


def read_elevation(
    paths: Sequence[Path],
    georeference: Georeference,
    bounds_m: Bounds,
    spacing_m: float,
    *,
    undulation_m: float,
    voids: Literal["fill", "refuse"] = "fill",
) -> TerrainReading:
    """The ground of ``bounds_m`` of frame w out of one file or several that lie side by side.

    Files hold heights over the geoid; ``undulation_m`` is that of the geoid over the ellipsoid, a constant (no geoid
    model is used; 0 where the file's heights are ellipsoidal). A node takes its height from the first file that covers
    it. Voids (-32768 in .hgt, a GeoTIFF's nodata or mask, NaN) are filled by inverse distances from heights within
    VOID_REACH_PX pixels, or refused.

    Raises
        TerrainError: a file missing, broken, without coordinate system or with several bands; nodes no file covers;
            voids that are refused or too large to be filled.
    """
    rows, columns = grid_shape(bounds_m, spacing_m)
    x, y = bounds_m[0] + spacing_m * np.arange(columns), bounds_m[1] + spacing_m * np.arange(rows)
    xy = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    z, filled, count = np.full(rows * columns, np.nan), np.zeros(rows * columns, bool), 0
    for path in map(Path, paths):
        todo = np.flatnonzero(np.isnan(z))
        nodes, heights, touched, n = _sample(path, georeference, xy[todo], voids)
        z[todo[nodes]], filled[todo[nodes]] = heights, touched
        count += n
    missing = np.isnan(z)
    if missing.any():
        names = ", ".join(str(p) for p in paths) or "no file given"
        (e0, n0), (e1, n1) = (georeference.to_grid(f(xy[missing], axis=0)) for f in (np.min, np.max))
        raise TerrainError(
            f"{names}: covers {z.size - missing.sum()} of the {z.size} nodes of the terrain; without height are "
            f"east {e0:.0f}..{e1:.0f} m, north {n0:.0f}..{n1:.0f} m of UTM zone {georeference.zone}"
        )
    heights_m = ellipsoidal_height(z.reshape(rows, columns), undulation_m) - georeference.origin_m[2]
    return TerrainReading(
        ElevationGrid(heights_m, bounds_m[:2], spacing_m), count, np.asarray(filled.reshape(rows, columns))
    )


def _sample(
    path: Path, georeference: Georeference, xy: Float[Array, "n 2"], voids: str
) -> tuple[Int[Array, "m"], Float[Array, "m"], Bool[Array, "m"], int]:
    """(which nodes the file covers, their heights, whether a filled pixel has a share, count of filled pixels)."""
    with _open(path) as raster:
        try:
            x, y = georeference.to_crs(xy, _horizontal(CRS.from_wkt(raster.crs.to_wkt()))).T
        except ValueError as e:
            raise TerrainError(f"{path}: {e}") from None
        back = ~raster.transform
        column, row = back.a * x + back.b * y + back.c, back.d * x + back.e * y + back.f
        height, width = raster.shape
        # Half a pixel beyond the outer centres still lies in the file.
        inside = np.flatnonzero((column >= 0) & (column <= width) & (row >= 0) & (row <= height))
        if not len(inside):
            return inside, np.empty(0), np.empty(0, bool), 0
        c = np.clip(column[inside] - 0.5, 0, width - 1)
        r = np.clip(row[inside] - 0.5, 0, height - 1)
        c0, r0 = max(int(c.min()) - VOID_REACH_PX, 0), max(int(r.min()) - VOID_REACH_PX, 0)
        c1, r1 = min(int(c.max()) + 2 + VOID_REACH_PX, width), min(int(r.max()) + 2 + VOID_REACH_PX, height)
        values, void = _read(path, raster, Window(c0, r0, c1 - c0, r1 - r0))
    corners, weights = _corners(r - r0, c - c0, void.shape)
    used = np.zeros(void.shape, bool)
    used.ravel()[corners[weights > 0]] = True
    used &= void
    count = int(np.count_nonzero(used))
    if count:
        _fill(path, values, void, used, voids)
    touched = ((weights > 0) & void.ravel()[corners]).any(axis=0)
    return inside, np.sum(weights * values.ravel()[corners], axis=0), touched, count


def _corners(r: Array, c: Array, shape: tuple[int, int]) -> tuple[Int[Array, "4 n"], Float[Array, "4 n"]]:
    """Flat indices of the four pixels around positions and their bilinear weights."""
    i, j = np.minimum(r.astype(int), max(shape[0] - 2, 0)), np.minimum(c.astype(int), max(shape[1] - 2, 0))
    b, a = r - i, c - j
    i1, j1 = np.minimum(i + 1, shape[0] - 1), np.minimum(j + 1, shape[1] - 1)
    n = shape[1]
    index = np.stack([i * n + j, i * n + j1, i1 * n + j, i1 * n + j1])
    return index, np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b])


def _fill(path: Path, values: Array, void: Array, used: Array, voids: str) -> None:
    """Fills ``values`` where void, in place."""
    n = np.count_nonzero(used)
    if voids == "refuse":
        raise TerrainError(f'{path}: {n} pixels of the terrain hold no height; allowed are none (voids = "refuse")')
    if void.all():
        raise TerrainError(f"{path}: no pixel of the terrain holds a height")
    values[void] = np.nan
    mask = np.where(void, 0, 1).astype(np.uint8)
    filled = rasterio.fill.fillnodata(values.astype(np.float32), mask=mask, max_search_distance=VOID_REACH_PX)
    values[void] = filled[void]
    left = int(np.count_nonzero(np.isnan(values) & used))
    if left:
        raise TerrainError(
            f"{path}: {left} of {n} voids lie farther than {VOID_REACH_PX} pixels from any height and are not filled"
        )
    values[np.isnan(values)] = 0.0


def _open(path: Path) -> Any:
    """The open raster of one georeferenced band."""
    if not path.is_file():
        raise TerrainError(f"{path}: no such file")
    if path.suffix.lower() == ".hgt":
        _check_hgt(path)
    try:
        with warnings.catch_warnings():
            # Said in our own line below.
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            raster = rasterio.open(path)
    except (RasterioError, ValueError) as e:
        raise TerrainError(f"{path}: not a readable elevation file, {_one_line(e)}") from None
    found = None
    if raster.count != 1:
        found = f"{raster.count} bands; one band of heights is allowed"
    elif raster.crs is None or raster.transform.is_identity:
        found = "no coordinate system and position; a GeoTIFF with both or an SRTM .hgt is allowed"
    if found:
        raster.close()
        raise TerrainError(f"{path}: {found}")
    return raster


def _horizontal(crs: CRS) -> CRS:
    """A system without its heights: what they refer to is stated by the caller."""
    return crs.sub_crs_list[0] if crs.is_compound else crs.to_2d()


def _check_hgt(path: Path) -> None:
    size = path.stat().st_size
    if size not in _HGT_BYTES:
        allowed = " or ".join(f"{n} ({s} arc seconds)" for n, s in _HGT_BYTES.items())
        raise TerrainError(f"{path}: {size} bytes; an SRTM tile has {allowed}")
    if not re.match(r"[NS]\d{2}[EW]\d{3}", path.name, re.IGNORECASE):
        raise TerrainError(f"{path}: the name must begin with the south-western corner, as N48E011.hgt does")


def _read(path: Path, raster: Any, window: Window) -> tuple[Float[Array, "h w"], Bool[Array, "h w"]]:
    """Heights of a window and where they are void (0 there)."""
    try:
        band = raster.read(1, window=window, masked=True)
    except RasterioError as e:
        raise TerrainError(f"{path}: broken, {_one_line(e)}") from None
    values = np.asarray(band.data, float) * raster.scales[0] + raster.offsets[0]
    void = np.ma.getmaskarray(band) | ~np.isfinite(values)
    return np.where(void, 0.0, values), void


def _one_line(e: BaseException) -> str:
    return " ".join(str(e.__cause__ or e).split())
