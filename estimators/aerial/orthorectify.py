"""Orthorectification: aerial images projected onto a map grid over a terrain (Kozempel 2012, 4.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from estimators.aerial import ortho_kernel as kernel
from sim.camera import Camera
from sim.camera_kernels import rays_of, view_of
from sim.pose import Pose
from sim.terrain import ElevationGrid

Array = np.ndarray
Method = Literal["map", "exact", "anchor", "forward"]
METHODS: tuple[Method, ...] = get_args(Method)
_STRIP = 512  # rows of an ortho image that are mapped at a time
_LONGEST = 32767  # of a side of an image, for OpenCV's remap
_CLOSE = np.ones((3, 3), np.uint8)


class OrthoError(ValueError):
    """An image that cannot be projected to the ground, and why."""


@dataclass(frozen=True)
class MapGrid:
    """Pixels of a map: (x_m, y_m) is the centre of the top-left one in the world, gsd_m the side of each."""

    x_m: float
    y_m: float
    gsd_m: float
    columns: int
    rows: int

    @property
    def x(self) -> Float[Array, "columns"]:
        """World x of the columns [m]."""
        return self.x_m + self.gsd_m * np.arange(self.columns)

    @property
    def y(self) -> Float[Array, "rows"]:
        """World y of the rows [m], from north to south."""
        return self.y_m - self.gsd_m * np.arange(self.rows)

    def pixels(self, xy: Float[Array, "*b 2"]) -> Float[Array, "*b 2"]:
        """(column, row) of world points, (0, 0) the centre of the top-left pixel."""
        return np.asarray((xy - [self.x_m, self.y_m]) / [self.gsd_m, -self.gsd_m])

    def points(self, pixels: Float[Array, "*b 2"]) -> Float[Array, "*b 2"]:
        """World points of (column, row): inverse of `pixels`."""
        return np.asarray([self.x_m, self.y_m] + pixels * [self.gsd_m, -self.gsd_m])

    @staticmethod
    def around(xy: Float[Array, "k 2"], gsd_m: float) -> MapGrid:
        """The smallest grid over some points whose pixel centres are at whole multiples of ``gsd_m``: grids of many
        images fit upon each other."""
        low, high = np.floor(xy.min(axis=0) / gsd_m), np.ceil(xy.max(axis=0) / gsd_m)
        columns, rows = (int(n) + 1 for n in high - low)
        return MapGrid(float(low[0] * gsd_m), float(high[1] * gsd_m), gsd_m, columns, rows)


@dataclass(frozen=True, eq=False)
class Ortho:
    """image (rows, columns, channels) on a grid, alpha (rows, columns) 255 where the source image says something."""

    image: UInt8[Array, "h w c"]
    alpha: UInt8[Array, "h w"]
    grid: MapGrid


def ground_sampling(height_m: float, camera: Camera) -> float:
    """Ground sampling distance s = h dx / c in the middle of a vertical image [m], (4.1)."""
    return float(height_m / np.sqrt(camera.K[0, 0] * camera.K[1, 1]))


def ground_points(camera: Camera, T_wc: Pose, terrain: ElevationGrid, uv: Float[Array, "*b 2"]) -> Float[Array, "*b 3"]:
    """Where the rays of pixels meet the terrain [m]; NaN where a ray points above the horizon or leaves the grid."""
    xy = camera.normalise(uv)
    ray = np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)
    return terrain.intersect(T_wc.t, ray @ T_wc.R.T)


def footprint(camera: Camera, T_wc: Pose, terrain: ElevationGrid) -> Float[Array, "k 3"]:
    """Ground points of the image's border, sixteen to a side.

    Raises
        OrthoError: a part of the border sees no ground.
    """
    w, h = camera.size_px
    s = np.linspace(0, 1, 17)[:-1, None]
    corners = np.array([[0, 0], [w - 1, 0], [w - 1, h - 1], [0, h - 1]], float)
    border = np.concatenate([a + s * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    ground = ground_points(camera, T_wc, terrain, border)
    lost = int(np.isnan(ground).any(axis=1).sum())
    if lost:
        raise OrthoError(
            f"no ground under {lost} of {len(border)} points of the image's border: the horizon is in the image, or "
            "the terrain ends"
        )
    return ground


def orthorectify(
    image: UInt8[Array, "h w *c"],
    camera: Camera,
    T_wc: Pose,
    terrain: ElevationGrid,
    gsd_m: float | None = None,
    method: Method = "map",
    grid: MapGrid | None = None,
) -> Ortho:
    """The image as seen from straight above, bilinearly interpolated.

    method: "exact" every ground pixel with its own height (4.1, pixel by pixel); "map" the same for every fourth
    one and between them linear; "anchor" heights of the four corners interpolated, without lens distortion ([61]);
    "forward" every image pixel to the ground, gaps filled from their neighbours ([96]). gsd_m: (4.1) where None.
    grid: by default the smallest around the footprint.

    Raises
        OrthoError: the image does not belong to the camera, or sees no ground.
    """
    if image.shape[1::-1] != camera.size_px:
        raise OrthoError(f"image: expected {camera.size_px}, the camera's size, found {image.shape[1::-1]}")
    if grid is None:
        ground = footprint(camera, T_wc, terrain)
        height_m = float(T_wc.t[2] - np.median(ground[:, 2]))
        grid = MapGrid.around(ground[:, :2], gsd_m or ground_sampling(height_m, camera))
    if max(camera.size_px) > _LONGEST:
        raise OrthoError(f"image: expected sides up to {_LONGEST} px, found {camera.size_px}")
    pixels = image if image.ndim == 3 else image[:, :, None]
    if method == "forward":
        return _forward(pixels, camera, T_wc, terrain, grid)
    if method == "anchor":
        terrain = _corner_heights(camera, T_wc, terrain, grid)
        camera = Camera(camera.K, camera.size_px)
    make = kernel.coarse_map if method == "map" else kernel.exact_map
    view, relief = view_of(camera, T_wc), _relief(terrain)
    result = np.empty((grid.rows, grid.columns, pixels.shape[2]), np.uint8)
    alpha = np.empty((grid.rows, grid.columns), np.uint8)
    for top in range(0, grid.rows, _STRIP):
        rows = slice(top, min(top + _STRIP, grid.rows))
        uv = make(view, *relief, grid.x, grid.y[rows])
        result[rows], alpha[rows] = _sampled(pixels, uv)
    return Ortho(result, alpha, grid)


def image_map(
    camera: Camera, T_wc: Pose, terrain: ElevationGrid, grid: MapGrid, method: Literal["map", "exact"] = "map"
) -> Float[Array, "rows columns 2"]:
    """Image pixel (u, v) of every pixel of a map, float32; NaN where there is none."""
    make = kernel.coarse_map if method == "map" else kernel.exact_map
    return np.asarray(make(view_of(camera, T_wc), *_relief(terrain), grid.x, grid.y))


def placed(
    camera: Camera,
    T_wc: Pose,
    terrain: ElevationGrid,
    uv: Float[Array, "*b 2"],
    method: Method,
    grid: MapGrid,
) -> Float[Array, "*b 2"]:
    """World (x, y) [m] at which `orthorectify` shows what lies at pixels of the image; NaN outside the grid.

    With all that is known of an image exact, it is the true place for "exact", to a few hundredths of a pixel of the
    map for "map". "forward" moves a pixel as a whole to the nearest one of the map.

    Raises
        OrthoError: "anchor" without ground under a corner of the image.
    """
    if method == "anchor":
        terrain, camera = _corner_heights(camera, T_wc, terrain, grid), Camera(camera.K, camera.size_px)
    xy = ground_points(camera, T_wc, terrain, uv)[..., :2]
    if method == "map":
        xy = _placed_by_map(camera, T_wc, terrain, xy, grid)
    place = grid.pixels(xy)
    inside = ((place >= -0.5) & (place < [grid.columns - 0.5, grid.rows - 0.5])).all(axis=-1, keepdims=True)
    if method == "forward":
        xy = grid.points(np.rint(place))
    return np.where(inside, xy, np.nan)


def _placed_by_map(camera: Camera, T_wc: Pose, terrain: ElevationGrid, true: Array, grid: MapGrid) -> Array:
    """Where the coarse map has the pixels of true ground points (..., 2): its small error is taken off by iteration."""
    xy = true
    for _ in range(2):
        place = grid.pixels(xy) / kernel.STEP
        node = np.floor(place)
        uv = np.zeros(xy.shape)
        for corner in np.array([[0, 0], [1, 0], [0, 1], [1, 1]]):
            weight = np.prod(1 - np.abs(place - node - corner), axis=-1, keepdims=True)
            ground = terrain.on_ground(grid.points(kernel.STEP * (node + corner)))
            uv += weight * camera.project(T_wc.inv().apply(ground))
        xy = xy + true - ground_points(camera, T_wc, terrain, uv)[..., :2]
    # At the end of the terrain a node may have no height: there the map is the exact one.
    return np.where(np.isfinite(xy), xy, true)


def _relief(terrain: ElevationGrid) -> tuple[Array, float, float, float]:
    return terrain.heights_m, *terrain.corner_m, terrain.spacing_m


def _sampled(image: Array, uv: Array) -> tuple[Array, Array]:
    """The image at a map, which is used up, and where the map points into it."""
    alpha = kernel.seen(uv, image.shape[1], image.shape[0])
    found = cv2.remap(image, uv, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return found.reshape(*uv.shape[:2], -1), alpha


def _corner_heights(camera: Camera, T_wc: Pose, terrain: ElevationGrid, grid: MapGrid) -> ElevationGrid:
    """The surface that is bilinear in x and y and has the terrain's heights where the image's corners lie."""
    w, h = camera.size_px
    corners = np.array([[0, 0], [w - 1, 0], [w - 1, h - 1], [0, h - 1]], float)
    ground = ground_points(camera, T_wc, terrain, corners)
    if np.isnan(ground).any():
        raise OrthoError("no ground under a corner of the image: the horizon is in the image, or the terrain ends")
    low = np.array([grid.x[0], grid.y[-1]])
    side = max(grid.x[-1] - low[0], grid.y[0] - low[1], grid.gsd_m)
    x, y = ((ground[:, :2] - low) / side).T
    surface = np.linalg.lstsq(np.stack([np.ones(4), x, y, x * y], axis=1), ground[:, 2], rcond=None)[0]
    at = np.array([[[1, 0, 0, 0], [1, 1, 0, 0]], [[1, 0, 1, 0], [1, 1, 1, 1]]], float)
    return ElevationGrid(at @ surface, (float(low[0]), float(low[1])), float(side))


def _forward(image: Array, camera: Camera, T_wc: Pose, terrain: ElevationGrid, grid: MapGrid) -> Ortho:
    result = np.zeros((grid.rows, grid.columns, image.shape[2]), np.uint8)
    hit = np.zeros((grid.rows, grid.columns), np.uint8)
    view, (w, h) = view_of(camera, T_wc), camera.size_px
    for top in range(0, h, _STRIP):
        v = np.arange(top, min(top + _STRIP, h), dtype=float)
        ground = terrain.intersect(T_wc.t, rays_of(view, np.arange(w, dtype=float), v))
        place = np.rint(grid.pixels(ground[..., :2]))
        inside = ((place >= 0) & (place <= [grid.columns - 1, grid.rows - 1])).all(axis=-1)
        column, row = place[inside].astype(int).T
        result[row, column] = image[top : top + len(v)][inside]
        hit[row, column] = 255
    return Ortho(*_without_gaps(result, hit), grid)


def _without_gaps(image: Array, hit: Array) -> tuple[Array, Array]:
    """Pixels that none was projected to, between others that were, as the mean of these."""
    alpha = cv2.morphologyEx(hit, cv2.MORPH_CLOSE, _CLOSE)
    gaps = (alpha > 0) & (hit == 0)
    share = cv2.blur((hit > 0).astype(np.float32), (3, 3))[gaps]
    for channel in range(image.shape[2]):
        mean = cv2.blur(image[:, :, channel].astype(np.float32), (3, 3))[gaps]
        image[:, :, channel][gaps] = np.rint(mean / share).astype(np.uint8)
    return image, alpha
