"""KITTI's text formats: tracking labels and camera poses, read strictly (file and line in every error)."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from sim.archive import freeze_fields
from sim.pose import Pose
from sim.scenario import ScenarioError

Row = tuple[int, int, str, list[float]]  # frame, track, type, numbers
LEAST_FRAMES = 5  # a track with fewer cannot be smoothed
_COLUMNS = 17  # frame id type truncated occluded alpha, box 4, size 3, location 3, ry; an 18th column is a score


@dataclass(frozen=True, eq=False)
class LabelTrack:
    """One object of a label file: frame (k,), size_m (length, width, height), location_c (k, 3) bottom-face centre in
    the left camera [m], ry (k,) [rad], occluded (k,) 0..3 and its KITTI type."""

    kind: str
    frame: Int[np.ndarray, "k"]
    size_m: tuple[float, float, float]
    location_c: Float[np.ndarray, "k 3"]
    ry: Float[np.ndarray, "k"]
    occluded: Int[np.ndarray, "k"]

    def __post_init__(self) -> None:
        freeze_fields(self)


def _lines(path: Path, key: str) -> list[str]:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else "not a text file"
        raise ScenarioError(f"{key}: cannot read {path}: {reason.lower()}") from error
    return text.splitlines()


def _row(path: Path, number: int, line: str) -> Row:
    parts = line.split()
    if len(parts) not in (_COLUMNS, _COLUMNS + 1):
        raise ScenarioError(f"{path}, line {number}: expected {_COLUMNS} columns, found {len(parts)}")
    try:
        values = [float(x) for x in parts[3:_COLUMNS]]
        frame, track = int(parts[0]), int(parts[1])
    except ValueError as error:
        raise ScenarioError(f"{path}, line {number}: not a number: {str(error).rsplit(':', 1)[-1].strip()}") from error
    if frame < 0 or not np.isfinite(values).all():
        raise ScenarioError(f"{path}, line {number}: frame must be >= 0 and all numbers finite")
    return frame, track, parts[2], values


def read_track(path: Path, track: int, key: str = "motion") -> LabelTrack:
    """The rows of one track of a KITTI tracking label file (DontCare rows are passed over); ``key`` of both in errors.

    Raises
        ScenarioError: the file cannot be read, a line is broken, or the track is not there.
    """
    rows = _rows(path, key)
    mine = [r for r in rows if r[1] == track]
    if not mine:
        raise ScenarioError(f"{key}.track: track {track} is not in {path}, which has {_spans(rows)}")
    if len(mine) < LEAST_FRAMES:
        raise ScenarioError(f"{path}: track {track} has {len(mine)} frames; a replay needs at least {LEAST_FRAMES}")
    return _label_track(path, mine)


def read_tracks(path: Path, least: int = LEAST_FRAMES, key: str = "motion") -> dict[int, LabelTrack]:
    """All tracks of a label file with at least so many rows (and `LEAST_FRAMES`), by their numbers; errors as above."""
    rows = _rows(path, key)
    numbers = Counter(r[1] for r in rows)
    enough = sorted(n for n, count in numbers.items() if count >= max(least, LEAST_FRAMES))
    return {n: _label_track(path, [r for r in rows if r[1] == n]) for n in enough}


def _rows(path: Path, key: str) -> list[Row]:
    rows = [_row(path, i, line) for i, line in enumerate(_lines(path, f"{key}.labels"), 1) if line.strip()]
    return [r for r in rows if r[2] != "DontCare"]


def _label_track(path: Path, rows: list[Row]) -> LabelTrack:
    mine = sorted(rows, key=lambda r: r[0])
    track = mine[0][1]
    frames = np.array([r[0] for r in mine])
    if len(np.unique(frames)) < len(frames):
        twice = frames[:-1][np.diff(frames) == 0][0]
        raise ScenarioError(f"{path}: track {track} stands twice in frame {twice}")
    v = np.array([r[3] for r in mine])
    h, w, length = np.median(v[:, 7:10], axis=0)
    if min(h, w, length) <= 0:
        raise ScenarioError(f"{path}: track {track} has no size ({length} x {w} x {h} m)")
    return LabelTrack(mine[0][2], frames, (length, w, h), v[:, 10:13], v[:, 13], v[:, 1].astype(int))


def _spans(rows: list[Row]) -> str:
    ids = sorted({r[1] for r in rows})
    if not ids:
        return "no tracks"
    if len(ids) > 12:
        return f"{len(ids)} tracks between {ids[0]} and {ids[-1]}"
    return "tracks " + ", ".join(map(str, ids))


def read_poses(path: Path, key: str = "ego.poses") -> Pose:
    """Camera poses T_0c (n,), a row-major 3x4 matrix a line: camera at frame i to camera at frame 0.

    Raises
        ScenarioError: the file cannot be read, a line has not 12 finite numbers, or no rotation.
    """
    rows = []
    for number, line in enumerate(_lines(path, key), 1):
        if not line.strip():
            continue
        try:
            values = np.array([float(x) for x in line.split()])
        except ValueError as error:
            raise ScenarioError(f"{path}, line {number}: not a number") from error
        if values.shape != (12,) or not np.isfinite(values).all():
            raise ScenarioError(f"{path}, line {number}: expected 12 finite numbers, found {len(values)}")
        M = values.reshape(3, 4)
        if np.abs(M[:, :3] @ M[:, :3].T - np.eye(3)).max() > 1e-3 or np.linalg.det(M[:, :3]) < 0:
            raise ScenarioError(f"{path}, line {number}: the 3x3 part is not a rotation")
        rows.append(M)
    if not rows:
        raise ScenarioError(f"{key}: {path} has no poses")
    M = np.array(rows)
    U, _, Vt = np.linalg.svd(M[:, :, :3])
    return Pose(U @ Vt, M[:, :, 3])
