"""Ground control points clicked in images, in the file that OpenDroneMap reads: ``gcp_list.txt``.

    EPSG:32632                                          the projection: a code, a PROJ string or "WGS84 UTM 32N"
    691234.51 5334567.12 532.40 512.3 498.7 image.jpg [name]

one click a line: x (east or longitude), y, height, column and row in the image, image, and the name of the point. Pixel
(0, 0) is the centre of the top-left pixel, here as in OpenSfM, the engine behind ODM. Heights are ellipsoidal
(`sim.geodesy`). Lines that start with # are comments.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from pyproj import CRS
from pyproj.exceptions import CRSError

from estimators.aerial.resection import ImagePoints
from sim.archive import freeze_fields
from sim.camera import Camera
from sim.geodesy import Georeference

Array = np.ndarray
_UTM = re.compile(r"^WGS84 UTM (\d{1,2})\s?([NS])$", re.IGNORECASE)
# A point further than this from the middle of the others [m] was given in another system.
_FAR_M = 200e3
_DEGREE_M = 111e3


class GcpFileError(ValueError):
    """A list of control points that cannot be used; the message names file, line and what was found."""


@dataclass(frozen=True, eq=False)
class GcpList:
    """Clicks as the file has them: geo (k, 3) in the system ``crs``, uv (k, 2) [px], image and name (k) of each.

    A click without a name is named by its coordinates: those with the same coordinates are the same point.
    """

    crs: str
    geo: Float[Array, "k 3"]
    uv: Float[Array, "k 2"]
    image: tuple[str, ...]
    name: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_fields(self)

    def __len__(self) -> int:
        return len(self.image)


@dataclass(frozen=True, eq=False)
class Clicks:
    """Clicks ready for adjustment: points of the images asked for, names (n,) and X_w (n, 3) [m] of the control points.

    excluded lists, one line each, what was left out and why.
    """

    points: ImagePoints
    names: tuple[str, ...]
    X_w: Float[Array, "n 3"]
    excluded: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_fields(self)


def read(path: Path) -> GcpList:
    """Clicks of a file in ODM's form.

    Raises
        GcpFileError: no projection or one PROJ does not know, a second projection, a line that is not a click, one
            point with two coordinates, points that lie in another system, one point twice in an image, no clicks.
        OSError: the file cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise GcpFileError(f"{path}: not a text file in UTF-8") from error
    lines = [(i, line.strip()) for i, line in enumerate(text.splitlines(), 1)]
    lines = [(i, line) for i, line in lines if line and not line.startswith("#")]
    if not lines:
        raise GcpFileError(f"{path}: empty; expected the projection in the first line and clicks below")
    number, crs = lines[0]
    if _projection(crs) is None:
        raise GcpFileError(
            f"{path}, line {number}: expected a projection such as EPSG:32632, 'WGS84 UTM 32N' or a PROJ string, got "
            f"{crs[:60]!r}"
        )
    rows = [_click(path, i, line) for i, line in lines[1:]]
    if not rows:
        raise GcpFileError(f"{path}: no clicks below the projection")
    values = np.array([row[0] for row in rows])
    _check_system(path, crs, values[:, :2], [i for i, _ in lines[1:]])
    clicks = GcpList(crs, values[:, :3], values[:, 3:], tuple(row[1] for row in rows), tuple(row[2] for row in rows))
    _check_points(path, clicks, [i for i, _ in lines[1:]])
    return clicks


def write(path: Path, clicks: GcpList) -> None:
    """A file in ODM's form; heights and projected coordinates to 0.1 mm, degrees to 1e-9, pixels to 1e-4.

    Raises
        GcpFileError: a projection PROJ does not know, blanks in a name.
    """
    crs = _projection(clicks.crs)
    if crs is None:
        raise GcpFileError(f"{path}: projection {clicks.crs[:60]!r} is not known to PROJ")
    bad = [name for name in (*clicks.image, *clicks.name) if not name or re.search(r"\s", name)]
    if bad:
        raise GcpFileError(f"{path}: names of images and points are words without blanks, got {bad[0]!r}")
    digits = 9 if crs.is_geographic else 4
    lines = [clicks.crs]
    for (x, y, z), (u, v), image, name in zip(clicks.geo, clicks.uv, clicks.image, clicks.name, strict=True):
        lines.append(f"{x:.{digits}f} {y:.{digits}f} {z:.4f} {u:.4f} {v:.4f} {image} {name}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def in_world(
    clicks: GcpList,
    images: Sequence[str],
    cameras: Mapping[str, Camera] | Camera,
    reference: Georeference,
    sigma_px: float,
) -> Clicks:
    """Clicks in the order of ``images``, control points in the world frame.

    Left out, and said so: clicks in images that are not asked for, and clicks outside their image.

    Raises
        ValueError: coordinates that the world frame's zone does not reach.
    """
    crs = _projection(clicks.crs)
    if crs is None:
        raise GcpFileError(f"projection {clicks.crs[:60]!r} is not known to PROJ")
    index = {image: i for i, image in enumerate(images)}
    excluded, rows = [], []
    for k, (image, name) in enumerate(zip(clicks.image, clicks.name, strict=True)):
        u, v = clicks.uv[k]
        camera = cameras if isinstance(cameras, Camera) else cameras.get(image)
        if image not in index or camera is None:
            excluded.append(f"{name} in {image}: not among the images")
        elif not camera.contains(clicks.uv[k]):
            excluded.append(
                f"{name} in {image}: ({u:.1f}, {v:.1f}) px lies outside {camera.size_px[0]}x{camera.size_px[1]}"
            )
        else:
            rows.append(k)
    names = tuple(dict.fromkeys(clicks.name[k] for k in rows))
    first = [clicks.name.index(name) for name in names]
    X_w = reference.from_crs(clicks.geo[first], crs) if rows else np.zeros((0, 3))
    image_index = np.array([index[clicks.image[k]] for k in rows], int)
    point_index = np.array([names.index(clicks.name[k]) for k in rows], int)
    return Clicks(ImagePoints(image_index, point_index, clicks.uv[rows], sigma_px), names, X_w, tuple(excluded))


def _projection(text: str) -> CRS | None:
    utm = _UTM.match(text)
    if utm:
        text = f"EPSG:{326 if utm[2].upper() == 'N' else 327}{int(utm[1]):02d}"
    try:
        return CRS.from_user_input(text)
    except CRSError:
        return None


def _click(path: Path, number: int, line: str) -> tuple[list[float], str, str]:
    fields = line.split()
    where = f"{path}, line {number}"
    if len(fields) < 6 and _projection(line) is not None:
        raise GcpFileError(f"{where}: a second projection, {line[:60]!r}; all points of a file have the first line's")
    if len(fields) not in (6, 7):
        raise GcpFileError(
            f"{where}: expected 'x y z column row image [name]', got {len(fields)} fields: {line[:80]!r}"
        )
    try:
        values = [float(f) for f in fields[:5]]
    except ValueError as error:
        raise GcpFileError(f"{where}: expected five numbers, got {' '.join(fields[:5])[:80]!r}") from error
    if not all(math.isfinite(v) for v in values):
        raise GcpFileError(f"{where}: expected five finite numbers, got {' '.join(fields[:5])[:80]!r}")
    name = fields[6] if len(fields) == 7 else ",".join(fields[:3])
    return values, fields[5], name


def _check_system(path: Path, crs: str, xy: Array, lines: list[int]) -> None:
    """All points near each other: degrees among metres, or another zone's grid, are hundreds of kilometres away."""
    projection = _projection(crs)
    unit = _DEGREE_M if projection is not None and projection.is_geographic else 1.0
    away = unit * np.linalg.norm(xy - np.median(xy, axis=0), axis=1)
    k = int(np.argmax(away))
    if away[k] > _FAR_M:
        raise GcpFileError(
            f"{path}, line {lines[k]}: ({xy[k, 0]:g}, {xy[k, 1]:g}) lies {away[k] / 1e3:.0f} km from the other points; "
            f"all have the projection of the first line, {crs[:60]!r}"
        )


def _check_points(path: Path, clicks: GcpList, lines: list[int]) -> None:
    """One name, one place; one point, one click an image."""
    place: dict[str, int] = {}
    seen: dict[tuple[str, str], int] = {}
    for k, (image, name) in enumerate(zip(clicks.image, clicks.name, strict=True)):
        first = place.setdefault(name, k)
        if not np.array_equal(clicks.geo[first], clicks.geo[k]):
            raise GcpFileError(
                f"{path}, line {lines[k]}: point {name!r} has other coordinates than in line {lines[first]}: all lines "
                f"have the projection {clicks.crs[:60]!r}"
            )
        before = seen.setdefault((image, name), k)
        if before != k:
            raise GcpFileError(
                f"{path}, line {lines[k]}: point {name!r} is clicked in {image} in line {lines[before]} too"
            )
