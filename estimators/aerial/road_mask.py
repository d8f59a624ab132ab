"""Roads of a map drawn into ortho images and into aerial images: where vehicles can be (Kozempel 2012, 4.2)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from jaxtyping import Float, Int32, UInt8

from estimators.aerial.orthorectify import MapGrid, footprint
from sim.archive import freeze_fields
from sim.camera import Camera
from sim.pose import Pose
from sim.roads import LONGEST_EDGE_M, Road, RoadNetwork
from sim.terrain import ElevationGrid

Array = np.ndarray
NEAR_M = 200.0
"""An edge may be seen if its middle is no farther from the image (4.2): half of the longest edge."""
_STEP_M = 10.0  # between vertices of an outline, so that it follows terrain and lens
_SHIFT = 4  # binary digits of a pixel in OpenCV's polygons
_FARTHEST_PX = 1e5


@dataclass(frozen=True, eq=False)
class RoadMask:
    """Roads in an image: mask (h, w) 255 where there is one, edge (h, w) its index in ``roads``, -1 where none is.

    Where roads overlap the more important one is meant.
    """

    mask: UInt8[Array, "h w"]
    edge: Int32[Array, "h w"]
    roads: tuple[Road, ...]

    def __post_init__(self) -> None:
        freeze_fields(self)


def roads_near(network: RoadNetwork, corners: Float[Array, "k 2"]) -> tuple[Road, ...]:
    """Edges, cut to 400 m, whose middle lies within 200 m of the convex region of some ground points (k, 2)."""
    region = shapely.MultiPoint(corners).convex_hull
    edges = network.cut(LONGEST_EDGE_M).edges
    middles = shapely.points([e.at(np.array(e.length_m / 2))[0] for e in edges]) if edges else np.empty(0, object)
    near = shapely.distance(middles, region) <= NEAR_M
    return tuple(e for e, is_near in zip(edges, near, strict=True) if is_near)


def mask_of_ortho(network: RoadNetwork, grid: MapGrid, widening_m: float = 0.0) -> RoadMask:
    """Roads by their RAS-Q width, both margins included, in the pixels of a map; on request wider."""
    corners = np.array([[x, y] for x in grid.x[[0, -1]] for y in grid.y[[0, -1]]])
    return _drawn(roads_near(network, corners), (grid.rows, grid.columns), grid.pixels, widening_m)


def mask_of_image(
    network: RoadNetwork,
    camera: Camera,
    T_wc: Pose,
    terrain: ElevationGrid,
    widening_m: float = 0.0,
    pavement: bool = False,
) -> RoadMask:
    """As `mask_of_ortho` in the pixels of an aerial image, through terrain, orientation and lens.

    pavement: each road from kerb to kerb by its own width in place of that of its class with margins.

    Raises
        OrthoError: a part of the image's border sees no ground.
    """

    def project(xy: Array) -> Array:
        return camera.project(T_wc.inv().apply(terrain.on_ground(xy)))

    roads = roads_near(network, footprint(camera, T_wc, terrain)[:, :2])
    return _drawn(roads, camera.size_px[::-1], project, widening_m, pavement)


def _drawn(
    roads: Iterable[Road],
    shape: tuple[int, int],
    project: Callable[[Array], Array],
    widening_m: float,
    pavement: bool = False,
) -> RoadMask:
    known = tuple(roads)
    edge = np.full(shape, -1, np.int32)
    for k in sorted(range(len(known)), key=lambda k: -known[k].road_class):
        width = known[k].width_m if pavement else known[k].map_width_m
        outline = shapely.LineString(known[k].line_m).buffer((width + widening_m) / 2)
        for ring in _rings(outline):
            _fill(edge, project(ring), k)
    return RoadMask(np.where(edge >= 0, np.uint8(255), np.uint8(0)), edge, known)


def _rings(outline: shapely.Polygon) -> list[Array]:
    """Closed lines (k, 2) around an area; a road round a square is cut in two to have no hole."""
    if outline.interiors:
        x0, y0, x1, y1 = outline.bounds
        middle = outline.interiors[0].centroid.x
        halves = [shapely.clip_by_rect(outline, *box) for box in ((x0, y0, middle, y1), (middle, y0, x1, y1))]
        return [ring for half in halves for part in shapely.get_parts(half) for ring in _rings(part)]
    return [shapely.get_coordinates(shapely.segmentize(outline, _STEP_M).exterior)]


def _fill(edge: Array, uv: Array, value: int) -> None:
    """Draws a polygon of pixels; of one that leaves the lens model what is left of it."""
    uv = uv[np.isfinite(uv).all(axis=1) & (np.abs(uv) < _FARTHEST_PX).all(axis=1)]
    h, w = edge.shape
    seen = len(uv) > 2 and (uv.max(axis=0) >= 0).all() and (uv.min(axis=0) <= [w, h]).all()
    if seen:
        cv2.fillPoly(edge, [np.rint(uv * 2**_SHIFT).astype(np.int32)], value, shift=_SHIFT)
