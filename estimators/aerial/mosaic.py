"""A mosaic of the ortho images of a strip: every ground pixel from the image that sees it most steeply."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from estimators.aerial.orthorectify import MapGrid, Ortho, OrthoError

Array = np.ndarray
_FITS = 1e-3  # part of a pixel


class Mosaic:
    """Takes ortho images one by one, each with the place of its camera, and holds no more than their union.

    All images have the ground sampling of the mosaic and pixel centres at multiples of it, as `MapGrid.around` makes
    them.
    """

    def __init__(self, grid: MapGrid, channels: int = 3) -> None:
        self._grid = grid
        self._image = np.zeros((grid.rows, grid.columns, channels), np.uint8)
        self._squared = np.full((grid.rows, grid.columns), np.inf, np.float32)

    def add(self, ortho: Ortho, camera_xy: Float[Array, "2"]) -> None:
        """Puts in what this image sees from nearer above than those before, camera_xy (2,) [m] in the world.

        Raises
            OrthoError: its pixels do not lie on the mosaic's.
        """
        corner = self._grid.pixels(np.array([ortho.grid.x_m, ortho.grid.y_m]))
        column, row = (int(n) for n in np.rint(corner))
        off = float(np.abs(corner - [column, row]).max())
        if abs(ortho.grid.gsd_m - self._grid.gsd_m) > _FITS * self._grid.gsd_m / max(ortho.alpha.shape) or off > _FITS:
            raise OrthoError(
                f"mosaic: expected pixels of {self._grid.gsd_m} m on its grid, found {ortho.grid.gsd_m} m, "
                f"{off:.2f} px off"
            )
        rows = slice(max(row, 0), min(row + ortho.grid.rows, self._grid.rows))
        columns = slice(max(column, 0), min(column + ortho.grid.columns, self._grid.columns))
        if rows.start >= rows.stop or columns.start >= columns.stop:
            return
        part = slice(rows.start - row, rows.stop - row), slice(columns.start - column, columns.stop - column)
        x, y = (self._grid.x[columns] - camera_xy[0]) ** 2, (self._grid.y[rows] - camera_xy[1]) ** 2
        squared = (y[:, None] + x[None, :]).astype(np.float32)
        better = (ortho.alpha[part] > 0) & (squared < self._squared[rows, columns])
        self._image[rows, columns][better] = ortho.image[part][better]
        self._squared[rows, columns][better] = squared[better]

    def ortho(self) -> Ortho:
        """What was put in so far."""
        return Ortho(self._image.copy(), np.where(np.isfinite(self._squared), np.uint8(255), np.uint8(0)), self._grid)


def union(grids: Iterable[MapGrid]) -> MapGrid:
    """The smallest grid that holds all, which have the same ground sampling.

    Raises
        OrthoError: there is none, or they differ in their ground sampling.
    """
    known = list(grids)
    samplings = {g.gsd_m for g in known}
    if len(samplings) != 1:
        raise OrthoError(f"mosaic: expected images of one ground sampling, found {sorted(samplings)}")
    gsd = samplings.pop()
    left, top = min(g.x_m for g in known), max(g.y_m for g in known)
    columns = max(round((g.x_m - left) / gsd) + g.columns for g in known)
    rows = max(round((top - g.y_m) / gsd) + g.rows for g in known)
    return MapGrid(left, top, gsd, columns, rows)
