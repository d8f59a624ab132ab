"""GeoTIFFs open elsewhere at the right place, and mosaics take every pixel from the steepest image."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

from estimators.aerial.geotiff import read_geotiff, write_geotiff
from estimators.aerial.mosaic import Mosaic, union
from estimators.aerial.orthorectify import MapGrid, Ortho, OrthoError
from sim.geodesy import Georeference

MUNICH = Georeference(32632, (690_000.0, 5_330_000.0, 500.0))
GRID = MapGrid(10.0, 250.0, 0.2, 300, 200)


def coloured(grid: MapGrid, channels: int = 3, value: int | None = None) -> Ortho:
    rng = np.random.default_rng(1)
    image = rng.integers(1, 255, (grid.rows, grid.columns, channels), dtype=np.uint8)
    if value is not None:
        image[:] = value
    alpha = np.full((grid.rows, grid.columns), 255, np.uint8)
    alpha[:5] = 0
    return Ortho(image, alpha, grid)


@pytest.mark.parametrize("cloud_optimised", [False, True])
@pytest.mark.parametrize("channels", [1, 3])
def test_what_is_written_is_read_again(tmp_path: Path, channels: int, cloud_optimised: bool) -> None:
    ortho = coloured(GRID, channels)
    write_geotiff(tmp_path / "a.tif", ortho, MUNICH, cloud_optimised)
    again = read_geotiff(tmp_path / "a.tif", MUNICH)
    np.testing.assert_array_equal(again.image, ortho.image)
    np.testing.assert_array_equal(again.alpha, ortho.alpha)
    assert (again.grid.columns, again.grid.rows) == (300, 200)
    np.testing.assert_allclose([again.grid.x_m, again.grid.y_m, again.grid.gsd_m], [10, 250, 0.2], atol=1e-6)
    assert [p.name for p in tmp_path.iterdir()] == ["a.tif"]


def test_pixels_lie_where_the_map_says(tmp_path: Path) -> None:
    write_geotiff(tmp_path / "a.tif", coloured(GRID), MUNICH)
    with rasterio.open(tmp_path / "a.tif") as raster:
        assert raster.crs.to_epsg() == 32632
        row, column = raster.index(690_010.0 + 17 * 0.2, 5_330_250.0 - 33 * 0.2)
        assert (row, column) == (33, 17)
        assert [c.name for c in raster.colorinterp] == ["red", "green", "blue", "alpha"]


def test_what_is_no_geotiff_of_this_map_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    path.write_bytes(b"II*\0broken")
    with pytest.raises(OrthoError, match="no readable GeoTIFF"):
        read_geotiff(path, MUNICH)
    with pytest.raises(OrthoError, match="no readable GeoTIFF"):
        read_geotiff(tmp_path / "missing.tif", MUNICH)
    write_geotiff(path, coloured(GRID), MUNICH)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(OrthoError, match="no readable GeoTIFF"):
        read_geotiff(path, MUNICH)
    write_geotiff(path, coloured(GRID), Georeference(32633))
    with pytest.raises(OrthoError, match="expected EPSG:32632, found EPSG:32633"):
        read_geotiff(path, MUNICH)


def test_a_mosaic_takes_every_pixel_from_the_nearest_camera() -> None:
    west, east = MapGrid(0.0, 40.0, 0.2, 300, 200), MapGrid(30.0, 44.0, 0.2, 300, 200)
    whole = union([west, east])
    assert (whole.columns, whole.rows) == (450, 220)
    mosaic = Mosaic(whole)
    mosaic.add(coloured(west, value=50), np.array([30.0, 20.0]))
    mosaic.add(coloured(east, value=150), np.array([60.0, 20.0]))
    made = mosaic.ortho()
    column, row = np.rint(whole.pixels(np.array([[44.0, 20.0], [46.0, 20.0]]))).astype(int).T
    np.testing.assert_array_equal(made.image[row, column, 0], [50, 150])
    assert made.alpha[0, 0] == 0
    assert (made.image[made.alpha == 0] == 0).all()
    np.testing.assert_array_equal(np.unique(made.image[made.alpha > 0]), [50, 150])


def test_images_that_do_not_fit_are_refused() -> None:
    mosaic = Mosaic(GRID)
    with pytest.raises(OrthoError, match="px off"):
        mosaic.add(coloured(MapGrid(10.07, 250.0, 0.2, 300, 200)), np.zeros(2))
    with pytest.raises(OrthoError, match="on its grid"):
        mosaic.add(coloured(MapGrid(10.0, 250.0, 0.21, 300, 200)), np.zeros(2))
    with pytest.raises(OrthoError, match="one ground sampling"):
        union([GRID, MapGrid(0.0, 0.0, 0.3, 5, 5)])
