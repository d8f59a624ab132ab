"""The list of a calibration's images: time, position, attitude of each, and its motion where known; read strictly.

A CSV with a head line, or the JSON of a simulated flight's image records, with the keys

    file t_s longitude_deg latitude_deg height_m roll_deg pitch_deg heading_deg      of every image
    velocity_north_mps velocity_east_mps velocity_down_mps                           all six, or none
    rate_forward_dps rate_right_dps rate_down_dps

Others are ignored but for ``head``, ``width_px`` and ``height_px``. Heights are ellipsoidal.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from sim.archive import freeze_fields
from sim.scenario import ScenarioError, nearest

Array = np.ndarray
KEY = "calibration.images"
_NUMBERS = ("t_s", "longitude_deg", "latitude_deg", "height_m", "roll_deg", "pitch_deg", "heading_deg")
MOTION = (
    *("velocity_north_mps", "velocity_east_mps", "velocity_down_mps"),
    *("rate_forward_dps", "rate_right_dps", "rate_down_dps"),
)
_RANGE = {
    "longitude_deg": (-180.0, 180.0),
    "latitude_deg": (-80.0, 84.0),
    "height_m": (-500.0, 20_000.0),
    "roll_deg": (-180.0, 180.0),
    "pitch_deg": (-90.0, 90.0),
    "heading_deg": (-360.0, 360.0),
}
Row = tuple[str, Mapping[str, Any]]


@dataclass(frozen=True, eq=False)
class ImageList:
    """Images (m,) in the order of time: t_s [s], geographic longitude, latitude [deg], height [m], rph [rad].

    velocity_ned [m/s] and rate_b [rad/s] (m, 3), or None where the list does not have them.
    """

    file: tuple[str, ...]
    t_s: Float[Array, "m"]
    geographic: Float[Array, "m 3"]
    rph: Float[Array, "m 3"]
    velocity_ned: Float[Array, "m 3"] | None
    rate_b: Float[Array, "m 3"] | None

    def __post_init__(self) -> None:
        freeze_fields(self)


def read_images(path: Path, head: str | None, size_px: tuple[int, int]) -> ImageList:
    """The images of a list, of one camera.

    Raises
        ScenarioError: the file cannot be read, lacks a key, has a value that cannot be; a name or time twice; images of
            several cameras and none is chosen; images of another size.
    """
    rows = _of_head(path, _rows(path), head)
    _check_sizes(path, rows, size_px)
    moves = _has_motion(path, rows[0])
    names = (*_NUMBERS, *(MOTION if moves else ()))
    values = np.array([[_number(path, row, name) for name in names] for row in rows])
    order = np.argsort(values[:, 0], kind="stable")
    files = [_file(path, row) for row in rows]
    _check_unique(path, rows, files, values[:, 0])
    v = values[order]
    motion = (v[:, 7:10], np.deg2rad(v[:, 10:13])) if moves else (None, None)
    return ImageList(tuple(files[i] for i in order), v[:, 0], v[:, 1:4], np.deg2rad(v[:, 4:7]), *motion)


def _rows(path: Path) -> list[Row]:
    """Where each row stands, and its content."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else "not a text file"
        raise ScenarioError(f"{KEY}: cannot read {path}: {reason.lower()}") from error
    rows = _from_json(path, text) if path.suffix.lower() == ".json" else _from_csv(path, text)
    if not rows:
        raise ScenarioError(f"{KEY}: {path} has no images")
    return rows


def _from_json(path: Path, text: str) -> list[Row]:
    try:
        found = json.loads(text)
    except ValueError as error:
        raise ScenarioError(f"{KEY}: {path}: not valid JSON: {error}") from error
    if not isinstance(found, list) or not all(isinstance(row, dict) for row in found):
        raise ScenarioError(f"{KEY}: {path}: expected a list of image records")
    return [(f"record {i}", row) for i, row in enumerate(found)]


def _from_csv(path: Path, text: str) -> list[Row]:
    reader = csv.reader(text.splitlines())
    lines = [(reader.line_num, [cell.strip() for cell in cells]) for cells in reader if any(c.strip() for c in cells)]
    lines = [(number, cells) for number, cells in lines if not cells[0].startswith("#")]
    if not lines:
        raise ScenarioError(f"{KEY}: {path} is empty; expected a head line: {','.join(('file', *_NUMBERS))}")
    columns = lines[0][1]
    for number, cells in lines[1:]:
        if len(cells) != len(columns):
            raise ScenarioError(
                f"{KEY}: {path}, line {number}: expected {len(columns)} values as in the head line, got {len(cells)}"
            )
    return [(f"line {number}", dict(zip(columns, cells, strict=True))) for number, cells in lines[1:]]


def _of_head(path: Path, rows: list[Row], head: str | None) -> list[Row]:
    heads = sorted({str(row["head"]) for _, row in rows if "head" in row})
    if head is None:
        if len(heads) > 1:
            raise ScenarioError(
                f"calibration.head: {path} has images of {len(heads)} cameras, choose one: {', '.join(heads)}"
            )
        return rows
    chosen = [(where, row) for where, row in rows if row.get("head") == head]
    if not chosen:
        said = nearest(head, heads) if heads else "it names no cameras"
        raise ScenarioError(f"calibration.head: {path} has no image of {head!r}, {said}")
    return chosen


def _check_sizes(path: Path, rows: list[Row], size_px: tuple[int, int]) -> None:
    for where, row in rows:
        if "width_px" in row and "height_px" in row:
            size = tuple(str(row[name]) for name in ("width_px", "height_px"))
            if size != tuple(str(n) for n in size_px):
                raise ScenarioError(
                    f"{KEY}: {path}, {where}: the image has {' x '.join(size)} px, camera.size_px "
                    f"{size_px[0]} x {size_px[1]}"
                )


def _has_motion(path: Path, first: Row) -> bool:
    """Whether the list has velocities and rates; half of them is a mistake."""
    missing = [name for name in MOTION if name not in first[1]]
    if missing and len(missing) < len(MOTION):
        raise ScenarioError(f"{KEY}: {path}: has no {missing[0]!r}; velocities and rates go together, all six or none")
    return not missing


def _number(path: Path, row: Row, name: str) -> float:
    where, content = row
    if name not in content:
        raise ScenarioError(f"{KEY}: {path}, {where}: has no {name!r}, {nearest(name, sorted(content))}")
    try:
        value = float(content[name])
    except (TypeError, ValueError):
        value = math.nan
    low, high = _RANGE.get(name, (-1e10, 1e10))
    if not low <= value <= high:
        raise ScenarioError(
            f"{KEY}: {path}, {where}: {name} should be a number from {low:g} to {high:g}, found {content[name]!r}"
        )
    return value


def _file(path: Path, row: Row) -> str:
    where, content = row
    name = content.get("file")
    if not isinstance(name, str) or not name:
        raise ScenarioError(f"{KEY}: {path}, {where}: has no name of an image under 'file'")
    return name


def _check_unique(path: Path, rows: Sequence[Row], files: list[str], t_s: Array) -> None:
    """One name and one time, one image."""
    for what, values in (("image", files), ("t_s", t_s.tolist())):
        first: dict[Any, str] = {}
        for (where, _), value in zip(rows, values, strict=True):
            if value in first:
                raise ScenarioError(f"{KEY}: {path}, {where}: {what} {value} is that of {first[value]} too")
            first[value] = where
