"""Footprints and heights of buildings from a map file: GeoJSON, GeoPackage or an OpenStreetMap extract."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from sim.archive import freeze
from sim.geodesy import Georeference
from sim.map_files import number, read_features

Array = np.ndarray

STOREY_M = 3.0
# Where neither height nor storeys are stated: a house of four storeys in the inner city.
DEFAULT_HEIGHT_M = 12.0
# Smaller ones are kiosks and errors of drawing.
SMALLEST_M2 = 4.0
_HIGHEST_M = 900.0


@dataclass(frozen=True, eq=False)
class Footprint:
    """One building: outline (n, 2) [m] in w, counter-clockwise and open (the first point is not repeated); courtyards.

    ``holes_m`` are clockwise. ``height_m`` is above the ground; ``stated`` tells whether the file says it.
    """

    outline_m: Float[Array, "n 2"]
    holes_m: tuple[Float[Array, "_ 2"], ...]
    height_m: float
    stated: bool

    def __post_init__(self) -> None:
        object.__setattr__(self, "outline_m", freeze(self.outline_m))
        object.__setattr__(self, "holes_m", tuple(freeze(h) for h in self.holes_m))

    @property
    def polygon(self) -> Any:
        """The shapely polygon."""
        return shapely.Polygon(self.outline_m, self.holes_m)


@dataclass(frozen=True, eq=False)
class BuildingReading:
    """Buildings of a file in the world frame, and how many of its polygons were mended or left out."""

    footprints: tuple[Footprint, ...]
    georeference: Georeference
    mended: int
    left_out: int

    @property
    def without_height(self) -> int:
        """Footprints of the default height."""
        return sum(not f.stated for f in self.footprints)


def read_buildings(
    path: Path,
    georeference: Georeference | None = None,
    *,
    layer: str | None = None,
    default_height_m: float = DEFAULT_HEIGHT_M,
) -> BuildingReading:
    """Buildings of a map file of any coordinate system; without ``georeference`` the UTM zone is chosen from the data.

    The height is that of the tag ``height`` [m], or ``building:levels`` times STOREY_M, or ``default_height_m``.
    Polygons that cross themselves are mended, parts smaller than SMALLEST_M2 left out.

    Raises
        MapError: see `read_features`.
    """
    features = read_features(path, "polygons", layer)
    world = features.georeference(georeference)
    footprints: list[Footprint] = []
    mended = left_out = 0
    for geometry, tags in zip(features.in_world(world), features.tags, strict=True):
        valid = shapely.is_valid(geometry)
        mended += not valid
        parts = shapely.get_parts(geometry if valid else shapely.make_valid(geometry))
        usable = [p for p in parts if p.geom_type == "Polygon" and p.area >= SMALLEST_M2]
        left_out += not usable
        stated = _height(tags)
        height = default_height_m if stated is None else stated
        for part in shapely.orient_polygons(usable):
            rings = [shapely.get_coordinates(r)[:-1] for r in (part.exterior, *part.interiors)]
            footprints.append(Footprint(rings[0], tuple(rings[1:]), height, stated is not None))
    return BuildingReading(tuple(footprints), world, mended, left_out)


def _height(tags: dict[str, Any]) -> float | None:
    height, levels = number(tags.get("height")), number(tags.get("building:levels", tags.get("building_levels")))
    if height is None and levels is not None:
        height = levels * STOREY_M
    return height if height is not None and 0 < height <= _HIGHEST_M else None
