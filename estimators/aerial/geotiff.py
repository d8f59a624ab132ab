"""Ortho images as GeoTIFF: colours and alpha with the grid of their UTM zone (Kozempel 2012, 4.1.1)."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import numpy as np
import rasterio
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.transform import Affine

from estimators.aerial.orthorectify import MapGrid, Ortho, OrthoError
from sim.geodesy import Georeference

_SQUARE = 1e-9
_TILE_PX = 256


def write_geotiff(path: Path, ortho: Ortho, georeference: Georeference, cloud_optimised: bool = False) -> None:
    """Writes the bands of an ortho image and its alpha, compressed without loss; all of the file or nothing.

    cloud_optimised: tiles and overviews in the order that lets a part be read over a network.
    """
    east, north = georeference.to_grid(np.array([ortho.grid.x_m, ortho.grid.y_m]))
    half, gsd = ortho.grid.gsd_m / 2, ortho.grid.gsd_m
    bands = np.concatenate([ortho.image, ortho.alpha[:, :, None]], axis=2)
    colours = [ColorInterp.gray] if bands.shape[2] == 2 else [ColorInterp.red, ColorInterp.green, ColorInterp.blue]
    layout = {"compress": "deflate", "predictor": "yes" if cloud_optimised else 2, "num_threads": 2}
    if not cloud_optimised:
        layout |= {"tiled": True, "blockxsize": _TILE_PX, "blockysize": _TILE_PX, "photometric": "rgb"}
        if len(colours) == 1:
            layout["photometric"] = "minisblack"
    scratch = path.with_name(f".{path.name}.part")
    try:
        with rasterio.open(
            scratch,
            "w",
            driver="COG" if cloud_optimised else "GTiff",
            width=ortho.grid.columns,
            height=ortho.grid.rows,
            count=bands.shape[2],
            dtype="uint8",
            crs=f"EPSG:{georeference.epsg}",
            transform=Affine(gsd, 0, east - half, 0, -gsd, north + half),
            **layout,
        ) as raster:
            raster.colorinterp = [*colours, ColorInterp.alpha]
            raster.write(np.moveaxis(bands, 2, 0))
        os.replace(scratch, path)
    finally:
        scratch.unlink(missing_ok=True)


def read_geotiff(path: Path, georeference: Georeference) -> Ortho:
    """An ortho image in the world frame; all of it counts as seen where there is no alpha.

    Raises
        OrthoError: no readable GeoTIFF, another zone, not north-up with square pixels, not 8 bits.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as raster:
                crs, transform, colours = raster.crs, raster.transform, raster.colorinterp
                kinds, bands = set(raster.dtypes), raster.read()
    except (RasterioError, OSError) as error:
        raise OrthoError(f"{path}: no readable GeoTIFF ({str(error).splitlines()[0]})") from error
    if crs is None or crs.to_epsg() != georeference.epsg:
        found = "no coordinate reference system" if crs is None else crs.to_string()
        raise OrthoError(f"{path}: expected EPSG:{georeference.epsg}, found {found}")
    gsd = transform.a
    if not gsd > 0 or max(abs(transform.e + gsd), abs(transform.b), abs(transform.d)) > _SQUARE * gsd:
        raise OrthoError(f"{path}: expected north-up square pixels, found the transformation {tuple(transform)[:6]}")
    if kinds != {"uint8"}:
        raise OrthoError(f"{path}: expected bands of 8 bits, found {', '.join(sorted(kinds))}")
    is_alpha = [c == ColorInterp.alpha for c in colours]
    colour = np.moveaxis(bands[~np.array(is_alpha)], 0, 2)
    alpha = bands[is_alpha.index(True)] if any(is_alpha) else np.full(colour.shape[:2], 255, np.uint8)
    corner = georeference.from_grid(np.array([transform.c + gsd / 2, transform.f - gsd / 2]))
    rows, columns = alpha.shape
    return Ortho(np.ascontiguousarray(colour), alpha, MapGrid(float(corner[0]), float(corner[1]), gsd, columns, rows))
