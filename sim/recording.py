"""Real rectified stereo sequences: folders of images, calibration, measured ego poses, boxes; read strictly."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from sim.camera import Camera, StereoRig
from sim.kitti import read_poses
from sim.pose import Pose
from sim.scenario import Focal, Point2, Positive, Rate, ScenarioError, Spec

_SUFFIXES = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".ppm"}
Box = Float[np.ndarray, "4"]


class Recorded(Spec):
    """A rectified stereo sequence on disk, and what is to be estimated in it."""

    left: Path
    right: Path
    """Folders of images, in the order of their names; the same names in both."""
    calib: Path | None = None
    """Projection matrices of both cameras in KITTI's form, 12 numbers a line; or give the three keys that follow."""
    focal_px: Focal | None = None
    principal_px: Point2 | None = None
    baseline_m: Positive | None = None
    cameras: tuple[Annotated[int, Field(ge=0, le=9)], Annotated[int, Field(ge=0, le=9)]] = (0, 1)
    """Which of the calibration's matrices are the left and the right camera's, counted from 0."""
    poses: Path | None = None
    """Measured poses of the left camera, a row-major 3x4 matrix a line and frame."""
    boxes: Path | None = None
    """Boxes around a vehicle in some of the frames, a line each: frame left top right bottom [px]."""
    target: Literal["background", "box"] = "background"
    """The scene as one rigid object, whose motion is that of the camera turned round; or what is in the box."""
    rate_hz: Rate = 10.0
    self_calibrate: bool = True
    """Whether the error of the rectification is found from the moving camera's own tracks of the scene, and removed."""
    farthest_m: Positive = 80.0
    """Points beyond are left out: their disparity says little, and a small error of it much."""

    @model_validator(mode="after")
    def _known(self) -> Recorded:
        keys = ("focal_px", "principal_px", "baseline_m")
        missing = [k for k in keys if getattr(self, k) is None]
        if self.calib is None and missing:
            raise ValueError(f"calib: give a file, or {', '.join(missing)}")
        if self.calib is not None and len(missing) < len(keys):
            raise ValueError("calib: give either a file or focal_px, principal_px and baseline_m")
        if self.target == "box" and self.boxes is None:
            raise ValueError("boxes: target 'box' needs a file")
        return self


@dataclass(frozen=True, eq=False)
class Recording:
    """What was read: image files (left, right) per frame, rig, ego poses T_wc (m,) or None, boxes by frame."""

    images: tuple[tuple[Path, Path], ...]
    rig: StereoRig
    T_wc: Pose | None
    boxes: dict[int, Box]


def read_recording(spec: Recorded) -> Recording:
    """Reads everything but the images' content; their size is that of the first left one.

    Raises
        ScenarioError: a file or image is missing, or does not fit the others.
    """
    images = _pairs(spec)
    T_wc = None if spec.poses is None else read_poses(spec.poses, "recording.poses")
    if T_wc is not None and len(T_wc.t) != len(images):
        raise ScenarioError(f"recording.poses: {spec.poses} has {len(T_wc.t)} poses, there are {len(images)} frames")
    first = cv2.imread(str(images[0][0]), cv2.IMREAD_UNCHANGED)
    if first is None:
        raise ScenarioError(f"recording.left: {images[0][0]}: cannot be read as an image")
    size = (int(first.shape[1]), int(first.shape[0]))
    boxes = {} if spec.boxes is None else _read_boxes(spec.boxes, len(images), size)
    return Recording(images, _rig(spec, size), T_wc, boxes)


def _pairs(spec: Recorded) -> tuple[tuple[Path, Path], ...]:
    found = []
    for key, folder in (("left", spec.left), ("right", spec.right)):
        if not folder.is_dir():
            raise ScenarioError(f"recording.{key}: {folder} is not a folder")
        found.append({p.stem: p for p in sorted(folder.iterdir()) if p.suffix.lower() in _SUFFIXES})
    left, right = found
    if not left:
        raise ScenarioError(f"recording.left: {spec.left} has no images")
    for key, here, there in (("right", left, right), ("left", right, left)):
        missing = sorted(set(here) - set(there))
        if missing:
            raise ScenarioError(f"recording.{key}: has no image {missing[0]!r}, the other side has")
    if len(left) < 2:
        raise ScenarioError(f"recording.left: {spec.left} has one image, motion needs two or more")
    return tuple((left[name], right[name]) for name in left)


def _rig(spec: Recorded, size: tuple[int, int]) -> StereoRig:
    if spec.calib is None:
        assert spec.focal_px is not None
        assert spec.baseline_m is not None
        return StereoRig.normal_case(Camera.simple(size, spec.focal_px, spec.principal_px), spec.baseline_m)
    left, right = _matrices(spec.calib, spec.cameras)
    focal, principal = float(left[0, 0]), (float(left[0, 2]), float(left[1, 2]))
    same = np.abs(left[:, :3] - right[:, :3]).max() < 1e-6 * focal and abs(left[0, 0] - left[1, 1]) < 1e-6 * focal
    if not same:
        raise ScenarioError(f"recording.calib: {spec.calib}: expected two rectified cameras of one focal length")
    baseline = float(left[0, 3] - right[0, 3]) / focal
    if not baseline > 0:
        raise ScenarioError(f"recording.calib: {spec.calib}: base {baseline:.4g} m: left and right are swapped")
    return StereoRig.normal_case(Camera.simple(size, focal, principal), baseline)


def _matrices(path: Path, cameras: tuple[int, int]) -> list[Float[np.ndarray, "3 4"]]:
    """Projection matrices of a calibration file, lines of 12 numbers, with or without a name such as ``P0:``."""
    found = []
    for line in _text(path, "recording.calib").splitlines():
        numbers = line.rpartition(":")[2].split()
        try:
            values = [float(x) for x in numbers]
        except ValueError:
            continue
        if len(values) == 12:
            found.append(np.array(values).reshape(3, 4))
    for camera in cameras:
        if camera >= len(found):
            raise ScenarioError(
                f"recording.calib: {path} has {len(found)} matrices of 12 numbers, none number {camera}"
            )
    return [found[camera] for camera in cameras]


def _read_boxes(path: Path, frames: int, size: tuple[int, int]) -> dict[int, Box]:
    boxes = {}
    for number, line in enumerate(_text(path, "recording.boxes").splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        where = f"recording.boxes: {path}, line {number}"
        try:
            frame, *box = (float(x) for x in line.replace(",", " ").split())
        except ValueError as error:
            raise ScenarioError(f"{where}: not a number") from error
        if len(box) != 4 or frame != int(frame):
            raise ScenarioError(f"{where}: expected frame left top right bottom")
        left, top, right, bottom = box
        if not (0 <= left < right < size[0] and 0 <= top < bottom < size[1]):
            raise ScenarioError(f"{where}: box {left:g} {top:g} {right:g} {bottom:g} is not in the image {size}")
        if not 0 <= frame < frames:
            raise ScenarioError(f"{where}: frame {frame:g} is not one of 0..{frames - 1}")
        boxes[int(frame)] = np.array(box)
    if not boxes:
        raise ScenarioError(f"recording.boxes: {path} has no boxes")
    return boxes


def _text(path: Path, key: str) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else "not a text file"
        raise ScenarioError(f"{key}: cannot read {path}: {reason.lower()}") from error
