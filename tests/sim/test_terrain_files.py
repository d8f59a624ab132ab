"""Elevation files: SRTM tiles and GeoTIFFs onto the grid of the world, voids, every wrong file in one clear line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from pyproj import CRS, Transformer
from rasterio import Affine

from sim.geodesy import Georeference
from sim.terrain_files import TerrainError, read_elevation

UTM32 = CRS.from_epsg(32632)
TO_UTM = Transformer.from_crs(4326, UTM32, always_xy=True)
# In the tile N48E011, near Munich.
EAST, NORTH = TO_UTM.transform(11.5, 48.2)
WORLD = Georeference(32632, (EAST, NORTH, 500.0))
BOUNDS = (-1000.0, -500.0, 1000.0, 700.0)


def plane_deg(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
    """Whole metres at every third arc second: a plane in degrees, so that bilinear interpolation keeps it."""
    return 3600 * (lon - 11) / 3 - 3600 * (lat - 48) / 3 * 2 + 3000


def hgt(folder: Path, n: int = 1201, name: str = "N48E011.hgt") -> Path:
    lon = 11 + np.arange(n) / (n - 1)
    lat = 49 - np.arange(n) / (n - 1)
    heights = plane_deg(lon, lat[:, None])
    path = folder / name
    np.round(heights).astype(">i2").tofile(path)
    return path


def tif(path: Path, heights: np.ndarray, crs: object = UTM32.to_wkt(), **profile: object) -> Path:
    """Heights over BOUNDS and a margin, pixels of 25 m, north up."""
    transform = Affine(25, 0, EAST - 1200, 0, -25, NORTH + 900)
    settings = {"driver": "GTiff", "dtype": "float32", "count": 1, "crs": crs, "transform": transform, **profile}
    with rasterio.open(path, "w", height=heights.shape[-2], width=heights.shape[-1], **settings) as f:
        f.write(heights.astype(settings["dtype"]).reshape(settings["count"], *heights.shape[-2:]))
    return path


def tilted() -> np.ndarray:
    column, row = np.meshgrid(np.arange(100), np.arange(70))
    return 520 + 0.05 * (25 * (column + 0.5) - 1200) + 0.02 * (900 - 25 * (row + 0.5))


@pytest.mark.parametrize("n", [1201, 3601])
def test_srtm_heights_land_where_pyproj_says(tmp_path: Path, n: int) -> None:
    reading = read_elevation([hgt(tmp_path, n)], WORLD, BOUNDS, 20.0, undulation_m=46.0)
    grid = reading.grid
    assert (reading.voids, reading.filled.any()) == (0, False)
    assert grid.bounds_m == BOUNDS
    x, y = np.meshgrid(BOUNDS[0] + 20 * np.arange(101), BOUNDS[1] + 20 * np.arange(61))
    lon, lat = TO_UTM.transform(x + EAST, y + NORTH, direction="INVERSE")
    # At one arc second the heights of the file are rounded to whole metres.
    np.testing.assert_allclose(grid.heights_m, plane_deg(lon, lat) + 46 - 500, atol=1e-6 if n == 1201 else 0.6)


def test_geotiff_heights_land_where_they_were(tmp_path: Path) -> None:
    grid = read_elevation([tif(tmp_path / "a.tif", tilted())], WORLD, BOUNDS, 30.0, undulation_m=0.0).grid
    xy = np.array([[0.0, 0.0], [-1000, -500], [990, 690], [123, -321]])
    # Heights are stored with 24 bits.
    np.testing.assert_allclose(grid.height(xy), 20 + xy @ [0.05, 0.02], atol=1e-4)


def test_a_compound_system_counts_without_its_heights(tmp_path: Path) -> None:
    path = tif(tmp_path / "a.tif", np.full((70, 100), 500.0), crs="EPSG:32632+5773")
    grid = read_elevation([path], WORLD, BOUNDS, 100.0, undulation_m=46.0).grid
    np.testing.assert_allclose(grid.heights_m, 46.0, atol=1e-9)


def test_scale_and_offset_of_a_band_count(tmp_path: Path) -> None:
    path = tif(tmp_path / "a.tif", np.full((70, 100), 7.0))
    with rasterio.open(path, "r+") as f:
        f.scales, f.offsets = (10.0,), (430.0,)
    grid = read_elevation([path], WORLD, BOUNDS, 100.0, undulation_m=0.0).grid
    np.testing.assert_allclose(grid.heights_m, 0.0, atol=1e-9)


def test_tiles_side_by_side_fill_each_other(tmp_path: Path) -> None:
    west, east = tif(tmp_path / "w.tif", tilted()[:, :50]), tmp_path / "e.tif"
    tif(east, tilted()[:, 50:], transform=Affine(25, 0, EAST - 1200 + 50 * 25, 0, -25, NORTH + 900))
    whole = read_elevation([tif(tmp_path / "a.tif", tilted())], WORLD, BOUNDS, 30.0, undulation_m=0.0).grid
    parts = read_elevation([west, east], WORLD, BOUNDS, 30.0, undulation_m=0.0).grid
    # Within half a pixel of the seam a tile's outer height holds: 12.5 m of slope 0.05.
    np.testing.assert_allclose(parts.heights_m, whole.heights_m, atol=0.63)
    with pytest.raises(TerrainError, match=r"w\.tif: covers \d+ of the \d+ nodes of the terrain.*east 68\d{4}"):
        read_elevation([west], WORLD, BOUNDS, 30.0, undulation_m=0.0)


@pytest.mark.parametrize("void", [-32768, np.nan])
def test_voids_are_filled_from_their_surroundings_and_counted(tmp_path: Path, void: float) -> None:
    heights = tilted()
    heights[30:34, 40:45] = void
    heights[0, 0] = void
    path = tif(tmp_path / "a.tif", heights, nodata=void)
    reading = read_elevation([path], WORLD, BOUNDS, 25.0, undulation_m=0.0)
    assert reading.voids == 20  # the void in the corner is not used
    touched = reading.filled
    assert 20 <= touched.sum() <= 42
    clean = read_elevation([tif(tmp_path / "b.tif", tilted())], WORLD, BOUNDS, 25.0, undulation_m=0.0).grid
    np.testing.assert_array_equal(reading.grid.heights_m[~touched], clean.heights_m[~touched])
    # Between the heights around the void: 5 x 4 pixels of slopes 0.05 and 0.02.
    assert np.abs(reading.grid.heights_m - clean.heights_m).max() < 3 * 25 * 0.05 + 2.5 * 25 * 0.02
    with pytest.raises(TerrainError, match=r'a\.tif: 20 pixels of the terrain hold no height.*voids = "refuse"'):
        read_elevation([path], WORLD, BOUNDS, 25.0, undulation_m=0.0, voids="refuse")


def test_srtm_void_value_is_known(tmp_path: Path) -> None:
    path = hgt(tmp_path)
    heights = np.fromfile(path, ">i2").reshape(1201, 1201)
    heights[955:965, 595:605] = -32768
    heights.tofile(path)
    reading = read_elevation([path], WORLD, BOUNDS, 20.0, undulation_m=0.0)
    assert 0 < reading.voids <= 100
    assert reading.grid.lowest_m > 500 - 500


def test_files_that_cannot_be_used_are_named_in_one_line(tmp_path: Path) -> None:
    def fails(path: Path, match: str) -> None:
        with pytest.raises(TerrainError, match=match) as info:
            read_elevation([path], WORLD, BOUNDS, 25.0, undulation_m=0.0)
        assert "\n" not in str(info.value)
        assert str(path) in str(info.value)

    fails(tmp_path / "none.tif", "no such file")
    for name, content in {"empty.tif": b"", "text.tif": b"hello", "empty.hgt": b"", "short.hgt": b"\0" * 1000}.items():
        (tmp_path / name).write_bytes(content)
        fails(tmp_path / name, "an SRTM tile has 2884802" if name.endswith("hgt") else "not a readable elevation file")
    fails(hgt(tmp_path, name="munich.hgt"), "must begin with the south-western corner")
    good = tif(tmp_path / "good.tif", tilted())
    (tmp_path / "cut.tif").write_bytes(good.read_bytes()[:15000])
    fails(tmp_path / "cut.tif", "broken")
    fails(tif(tmp_path / "rgb.tif", np.zeros((3, 70, 100)), count=3), "3 bands; one band")
    fails(tif(tmp_path / "crs.tif", tilted(), crs=None), "no coordinate system")
    fails(tif(tmp_path / "void.tif", np.full((70, 100), -9999.0), nodata=-9999), "no pixel of the terrain holds")
    half = tilted()
    half[:, 30:] = -9999
    fails(tif(tmp_path / "half.tif", half, nodata=-9999), "voids lie farther than 50 pixels")
    fails(hgt(tmp_path, name="N10E011.hgt"), "covers 0 of the")


def test_no_file_is_no_terrain() -> None:
    with pytest.raises(TerrainError, match="no file given: covers 0"):
        read_elevation([], WORLD, BOUNDS, 25.0, undulation_m=0.0)
