"""Ortho images as they were written, against what they should show: nothing of the geometry is taken on trust.

Patches of the GeoTIFF are matched with the same ground taken from the image by the *true* orientation. The displacement
found must be the one that the errors of the orientation foretell.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from jaxtyping import Float

from estimators.aerial.geotiff import read_geotiff
from estimators.aerial.images import read_image
from estimators.aerial.orthorectification import ORTHOS, OrthoImages
from estimators.aerial.orthorectify import MapGrid, ground_points, orthorectify, placed
from reports.flights.errors import check_pixels
from reports.flights.run import FlightRun

Array = np.ndarray
_PATCH_PX = 160
_IMAGES = 6
# A patch without texture matches anywhere.
_LEAST_RESPONSE = 0.15


def matched_displacements(run: FlightRun, label: str, orthos: OrthoImages) -> pd.DataFrame:
    """Displacements of patches: columns image, x, y [m], dx, dy measured and foretold_x, foretold_y [px]."""
    rows = []
    chosen = np.unique(np.linspace(0, len(orthos.image) - 1, _IMAGES).round().astype(int))
    for row in chosen.tolist():
        image = int(orthos.image[row])
        record = run.observations.records[image]
        folder = run.folder / "estimates" / label / ORTHOS
        product = read_geotiff(folder / Path(record.file).with_suffix(".tif").name, run.observations.georeference)
        picture = read_image(run.folder / "observations", record)
        true, known = run.true_camera(image), run.observations.camera(image)
        T_wc, gsd = run.truth.T_wc[image], product.grid.gsd_m
        uv = check_pixels(true.camera.size_px)
        ground = ground_points(true.camera, T_wc, run.truth.terrain, uv)[:, :2]
        terrain = run.observations.terrain
        foretold = placed(known.camera, orthos.T_wc[row], terrain, uv, orthos.method, product.grid) - ground
        for at, d in zip(ground, foretold / gsd, strict=True):
            patch = _patch_grid(product.grid, at)
            if patch is None or not np.isfinite(d).all():
                continue
            should = orthorectify(picture, true.camera, T_wc, run.truth.terrain, method="exact", grid=patch)
            shift = _shift(should.image, _cut(product.image, product.grid, patch))
            if shift is not None:
                # Columns grow to the east, rows to the south.
                rows.append((image, *at, shift[0], -shift[1], *d))
    return pd.DataFrame(rows, columns=["image", "x", "y", "dx", "dy", "foretold_x", "foretold_y"])


def _patch_grid(grid: MapGrid, at: Float[Array, "2"]) -> MapGrid | None:
    """Pixels of the ortho image about a place; None where these are not all in it."""
    column, row = (int(n) for n in np.rint(grid.pixels(at)) - _PATCH_PX // 2)
    if min(column, row) < 0 or column + _PATCH_PX > grid.columns or row + _PATCH_PX > grid.rows:
        return None
    return MapGrid(grid.x_m + column * grid.gsd_m, grid.y_m - row * grid.gsd_m, grid.gsd_m, _PATCH_PX, _PATCH_PX)


def _cut(image: Array, grid: MapGrid, patch: MapGrid) -> Array:
    column, row = (int(n) for n in np.rint(grid.pixels(np.array([patch.x_m, patch.y_m]))))
    return image[row : row + patch.rows, column : column + patch.columns]


def _shift(should: Array, is_: Array) -> tuple[float, float] | None:
    """How far the content of a patch is moved to the right and down [px]; None where this cannot be told."""
    if not (should.any(axis=2).all() and is_.any(axis=2).all()):
        return None  # a part lies beyond the image
    a, b = (p.astype(np.float32).mean(axis=2) for p in (should, is_))
    window = cv2.createHanningWindow((_PATCH_PX, _PATCH_PX), cv2.CV_32F)
    (dx, dy), response = cv2.phaseCorrelate(a - a.mean(), b - b.mean(), window)
    return (dx, dy) if response > _LEAST_RESPONSE else None
