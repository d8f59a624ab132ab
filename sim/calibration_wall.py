"""A calibration wall of boards with coded markers, and photographs of it that are exact to the camera model.

Kozempel 2012, 3.2 and Fig. 3.3: the source calibrates with a wall of coded points. Wall frame w: x right, y down, z
into the wall [m]; a board lies in its plane or before it, facing the camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import no_type_check

import cv2
import numba
import numpy as np
from jaxtyping import Float, UInt8

from sim.camera import Camera
from sim.camera_kernels import ray_of, threaded, view_of
from sim.pose import Pose, exp_so3, rot_z
from sim.sensor import Sensor, expose

Array = np.ndarray
LENS = Sensor(blur_px=0.7, vignetting=0.10, read_noise=1.5, shot_noise=2.0, grey=True)
"""A sharp lens at a small aperture, and some two grey levels of noise."""
_MARKER = 0.6  # of a square's side
_SQUARES, _SQUARE_M = 7, 0.14
_GAP_M = 0.2
_SQUARE_PX, _MARGIN_PX = 140, 35
_BLACK, _WHITE, _WALL = 22.0, 215.0, 150.0
_MARKERS = _SQUARES**2 // 2


@dataclass(frozen=True)
class Board:
    """A ChArUco board of 7 x 7 squares: its first corner in w [m] and the number of its first marker."""

    at_m: tuple[float, float, float]
    first_marker: int

    @cached_property
    def pattern(self) -> cv2.aruco.CharucoBoard:
        """The board as OpenCV detects it; its points are counted from its first corner."""
        ids = np.arange(self.first_marker, self.first_marker + _MARKERS, dtype=np.int32)
        codes = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
        return cv2.aruco.CharucoBoard((_SQUARES, _SQUARES), _SQUARE_M, _MARKER * _SQUARE_M, codes, ids)

    @property
    def corners_m(self) -> Float[Array, "n 3"]:
        """Its inner corners in w, in the order of their numbers."""
        return np.asarray(self.pattern.getChessboardCorners(), float) + self.at_m


@dataclass(frozen=True)
class Wall:
    """Four boards in a square around the origin; two of them, diagonally, stand ``depth_m`` before the wall.

    Raises
        ValueError: a depth below 0 or beyond 2 m.
    """

    depth_m: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.depth_m <= 2:
            raise ValueError(f"Wall.depth_m: expected 0 to 2, got {self.depth_m}")

    @cached_property
    def boards(self) -> tuple[Board, ...]:
        low, high = -_SQUARES * _SQUARE_M - _GAP_M / 2, _GAP_M / 2
        before = -self.depth_m
        at = ((low, low, 0.0), (high, low, before), (low, high, before), (high, high, 0.0))
        return tuple(Board(p, k * _MARKERS) for k, p in enumerate(at))

    @property
    def corners_m(self) -> Float[Array, "n 3"]:
        """Inner corners of all boards in w, board by board."""
        return np.concatenate([b.corners_m for b in self.boards])


def viewpoints(
    count: int, tilt_rad: float, distance_m: tuple[float, float], rng: np.random.Generator, aside_m: float = 0.3
) -> Pose:
    """Poses T_wc (count,) of a camera that looks at the wall's middle, give or take ``aside_m``.

    Tilted against the wall's normal by ``tilt_rad`` into directions that go round evenly, turned about its axis by a
    quarter more from image to image and some 10 degrees at random, at distances within the bounds.
    """
    k = np.arange(count)
    around = 2 * np.pi * (k + rng.random()) / count
    turn = k * np.pi / 2 + rng.normal(0, np.deg2rad(10.0), count)
    axis = np.column_stack([np.cos(around), np.sin(around), np.zeros(count)])
    R = exp_so3(tilt_rad * axis) @ rot_z(turn)
    aim = np.column_stack([rng.uniform(-aside_m, aside_m, (count, 2)), np.zeros(count)])
    return Pose(R, aim - rng.uniform(*distance_m, (count, 1)) * R[..., 2])


def photograph(
    wall: Wall, camera: Camera, T_wc: Pose, rng: np.random.Generator, sensor: Sensor = LENS, samples: int = 2
) -> UInt8[Array, "h w"]:
    """The image of the wall through lens and sensor; ``samples`` squared rays per pixel.

    Raises
        ValueError: fewer than one sample; a sensor that is not grey.
    """
    if samples < 1:
        raise ValueError(f"samples: expected at least 1, got {samples}")
    if not sensor.grey:
        raise ValueError("sensor: expected a grey one")
    prints = np.stack([_print(b) for b in wall.boards])
    w, h = camera.size_px
    image = np.empty((h, w), np.uint8)
    _draw(view_of(camera, T_wc), np.array([b.at_m for b in wall.boards]), prints, samples, image)
    return expose(np.repeat(image[..., None], 3, axis=2), sensor, rng)


@cache
def _print(board: Board) -> UInt8[Array, "n n"]:
    """The printed board with its margin: the first corner lies `_MARGIN_PX` from the edges of the first texel."""
    side = _SQUARES * _SQUARE_PX + 2 * _MARGIN_PX
    drawn = board.pattern.generateImage((side, side), marginSize=_MARGIN_PX)
    return np.asarray(np.where(drawn > 127, np.uint8(_WHITE), np.uint8(_BLACK)))


@threaded
@no_type_check
def _draw(view: Array, at: Array, prints: Array, samples: int, image: Array) -> None:
    """Rays of every sample to the nearest board they hit; boards face -z of w with their first corners at ``at``."""
    height, width = image.shape
    side = prints.shape[1]
    texel = _SQUARE_M / _SQUARE_PX
    for i in numba.prange(height):
        for j in range(width):
            total = 0.0
            for a in range(samples):
                for b in range(samples):
                    u = j + (b + 0.5) / samples - 0.5
                    v = i + (a + 0.5) / samples - 0.5
                    p, q = ray_of(view, u, v)
                    dx = view[0] * p + view[3] * q + view[6]
                    dy = view[1] * p + view[4] * q + view[7]
                    dz = view[2] * p + view[5] * q + view[8]
                    value, nearest = _WALL, np.inf
                    for k in range(len(at)):
                        depth = (at[k, 2] - view[11]) / dz
                        if not 0 < depth < nearest:
                            continue
                        s = (view[9] + depth * dx - at[k, 0]) / texel + _MARGIN_PX - 0.5
                        t = (view[10] + depth * dy - at[k, 1]) / texel + _MARGIN_PX - 0.5
                        if s < 0 or t < 0 or s >= side - 1 or t >= side - 1:
                            continue
                        nearest = depth
                        c, r = int(s), int(t)
                        x, y = s - c, t - r
                        upper = prints[k, r, c] * (1 - x) + prints[k, r, c + 1] * x
                        lower = prints[k, r + 1, c] * (1 - x) + prints[k, r + 1, c + 1] * x
                        value = upper * (1 - y) + lower * y
                    total += value
            image[i, j] = np.uint8(total / (samples * samples) + 0.5)
