"""Lists of control points: what is read is what was written; what cannot be used is said in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from estimators.aerial.gcp_file import GcpFileError, GcpList, in_world, read, write
from sim.camera import Camera
from sim.geodesy import Georeference

CAMERA = Camera.simple((1024, 768), 2500.0)
REFERENCE = Georeference(32632, (691000.0, 5334000.0, 500.0))
GEO = np.array([[691234.5, 5334567.1, 532.4], [691100.0, 5334200.0, 520.0], [691234.5, 5334567.1, 532.4]])
LIST = GcpList(
    "EPSG:32632",
    GEO,
    np.array([[10.0, 20.5], [-0.5, 767.4], [700.25, 1.0]]),
    ("a.jpg", "a.jpg", "b.jpg"),
    ("P", "Q", "P"),
)
LINE = "691234.5 5334567.1 532.4 512.5 384.5 a.jpg"


def written(path: Path, text: str) -> Path:
    file = path / "gcp_list.txt"
    file.write_text(text)
    return file


@pytest.mark.parametrize("crs", ["EPSG:32632", "WGS84 UTM 32N", "+proj=utm +zone=32 +datum=WGS84 +units=m +no_defs"])
def test_what_is_written_is_read(tmp_path: Path, crs: str) -> None:
    clicks = GcpList(crs, LIST.geo, LIST.uv, LIST.image, LIST.name)
    write(tmp_path / "gcp_list.txt", clicks)
    again = read(tmp_path / "gcp_list.txt")
    np.testing.assert_allclose(again.geo, clicks.geo, atol=1e-4)
    np.testing.assert_allclose(again.uv, clicks.uv, atol=1e-4)
    assert (again.crs, again.image, again.name) == (crs, clicks.image, clicks.name)


def test_comments_blank_lines_and_points_without_names(tmp_path: Path) -> None:
    clicks = read(written(tmp_path, f"# by hand\nEPSG:32632\n\n{LINE}\n"))
    np.testing.assert_array_equal(clicks.uv, [[512.5, 384.5]])
    assert clicks.name == ("691234.5,5334567.1,532.4",)


def test_points_in_the_world_frame() -> None:
    ready = in_world(LIST, ["b.jpg", "a.jpg"], CAMERA, REFERENCE, 0.5)
    assert ready.names == ("P", "Q")
    np.testing.assert_allclose(ready.X_w, np.array([[234.5, 567.1, 32.4], [100, 200, 20]]), atol=1e-6)
    assert ready.points.image.tolist() == [1, 1, 0]
    assert ready.points.point.tolist() == [0, 1, 0]
    assert ready.excluded == ()


def test_degrees_and_metres_are_the_same_points(tmp_path: Path) -> None:
    geographic = GcpList("EPSG:4326", REFERENCE.to_crs(REFERENCE.from_grid(GEO)), LIST.uv, LIST.image, LIST.name)
    write(tmp_path / "gcp_list.txt", geographic)
    ready = in_world(read(tmp_path / "gcp_list.txt"), ["a.jpg", "b.jpg"], CAMERA, REFERENCE, 0.5)
    np.testing.assert_allclose(ready.X_w, REFERENCE.from_grid(GEO[:2]), atol=2e-4)  # 1e-9 degrees are 0.1 mm


def test_clicks_outside_and_foreign_images_are_left_out_and_said() -> None:
    uv = np.array([[10.0, 20.5], [1023.6, 5], [700.25, 1.0]])
    clicks = GcpList(LIST.crs, LIST.geo, uv, ("a.jpg", "a.jpg", "c.jpg"), LIST.name)
    ready = in_world(clicks, ["a.jpg", "b.jpg"], {"a.jpg": CAMERA, "b.jpg": CAMERA}, REFERENCE, 0.5)
    assert ready.names == ("P",)
    assert ready.excluded == (
        "Q in a.jpg: (1023.6, 5.0) px lies outside 1024x768",
        "P in c.jpg: not among the images",
    )
    none = in_world(clicks, [], CAMERA, REFERENCE, 0.5)
    assert len(none.points) == 0
    assert len(none.excluded) == 3


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "empty"),
        ("EPSG:32632\n", "no clicks"),
        (f"{LINE}\n", "line 1: expected a projection"),
        (f"EPSG:99999\n{LINE}\n", "line 1: expected a projection"),
        (f"EPSG:32632\n{LINE}\nEPSG:32633\n{LINE}\n", "line 3: a second projection, 'EPSG:32633'"),
        ("EPSG:32632\n1 2 3 4 a.jpg\n", "line 2: expected 'x y z column row image .name.', got 5 fields"),
        ("EPSG:32632\n1 2 3 4 five a.jpg P\n", "line 2: expected five numbers"),
        ("EPSG:32632\n1 2 nan 4 5 a.jpg P\n", "line 2: expected five finite numbers"),
        (
            f"EPSG:32632\n{LINE} P\n691234.5 5334567.2 532.4 5 5 b.jpg P\n",
            "line 3: point 'P' has other coordinates than",
        ),
        (f"EPSG:32632\n{LINE} P\n{LINE} R\n11.5 48.1 532.4 5 5 b.jpg Q\n", "line 4: .11.5, 48.1. lies 53.. km from"),
        (f"EPSG:32632\n{LINE} P\n{LINE} P\n", "line 3: point 'P' is clicked in a.jpg in line 2 too"),
    ],
)
def test_files_that_cannot_be_used(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(GcpFileError, match=said) as caught:
        read(written(tmp_path, text))
    assert "gcp_list.txt" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_binary_files_and_wrong_systems(tmp_path: Path) -> None:
    file = tmp_path / "gcp_list.txt"
    file.write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(GcpFileError, match="not a text file"):
        read(file)
    far = read(written(tmp_path, f"EPSG:32655\n{LINE}\n"))
    with pytest.raises(ValueError, match="outside the reach of UTM zone 32"):
        in_world(far, ["a.jpg"], CAMERA, REFERENCE, 0.5)
    with pytest.raises(GcpFileError, match="not known to PROJ"):
        write(file, GcpList("nowhere", LIST.geo, LIST.uv, LIST.image, LIST.name))
    with pytest.raises(GcpFileError, match="without blanks, got 'a b"):
        write(file, GcpList("EPSG:32632", LIST.geo, LIST.uv, ("a b.jpg", "a", "b"), LIST.name))
