"""Vector maps from files: GeoJSON, GeoPackage, OpenStreetMap extracts (PBF or XML), whatever GDAL's drivers read."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyogrio
import shapely
from pyogrio.errors import DataLayerError, DataSourceError
from pyproj import CRS
from pyproj.exceptions import CRSError

from sim.geodesy import Georeference

Array = np.ndarray
Shape = Literal["lines", "polygons"]

# GDAL's layers of an OpenStreetMap extract, and the key that its features of interest have.
_OSM = {"lines": ("lines", "highway"), "polygons": ("multipolygons", "building")}
_TYPES = {"lines": ("LineString", "MultiLineString"), "polygons": ("Polygon", "MultiPolygon")}
_HSTORE = re.compile(r'"((?:[^"\\]|\\.)*)"=>"((?:[^"\\]|\\.)*)"')
_NUMBER = re.compile(r"\s*(\d+(?:[.,]\d+)?)\s*(?:m|meters?|metres?)?\s*")


class MapError(ValueError):
    """A map file that cannot be used; the message names the file, what was found and what is allowed."""


@dataclass(frozen=True, eq=False)
class Features:
    """Features of one layer: shapely geometries in the file's system, and their tags where they are set."""

    path: Path
    crs: CRS
    geometries: Array
    tags: tuple[dict[str, Any], ...]

    def georeference(self, given: Georeference | None, height_m: float = 0.0) -> Georeference:
        """The one given, or zone and origin chosen from the data."""
        if given is not None:
            return given
        try:
            return Georeference.around(shapely.get_coordinates(self.geometries), self.crs, height_m)
        except ValueError as e:
            raise MapError(f"{self.path}: {e}") from None

    def in_world(self, georeference: Georeference) -> Array:
        """The geometries in the world frame.

        Raises
            MapError: coordinates that cannot be transformed, or far from the zone of the world.
        """
        try:
            return np.asarray(shapely.transform(self.geometries, lambda xy: georeference.from_crs(xy, self.crs)))
        except ValueError as e:
            raise MapError(f"{self.path}: {e}") from None


def read_features(path: Path, shape: Shape, layer: str | None = None) -> Features:
    """Lines or polygons of a map file, the only layer that has them unless one is named.

    Features of other types and without geometry are left out.

    Raises
        MapError: file missing, broken or empty; no layer or several with such features; no coordinate system;
            coordinates that its system does not have (metres in a file that says degrees, systems mixed).
    """
    path = Path(path)
    if not path.is_file():
        raise MapError(f"{path}: no such file")
    osm = path.name.lower().endswith((".osm.pbf", ".pbf", ".osm"))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # GDAL's remarks on files that it reads nevertheless
            name = _layer(path, shape, layer, osm)
            where = f"{_OSM[shape][1]} IS NOT NULL" if osm and layer is None else None
            meta, _, wkb, columns = pyogrio.raw.read(path, layer=name, where=where)
    except (DataSourceError, DataLayerError) as e:
        raise MapError(f"{path}: not a readable map, {_one_line(e, path)}") from None
    geometries = shapely.from_wkb(wkb)
    kept = np.flatnonzero([g is not None and not g.is_empty and g.geom_type in _TYPES[shape] for g in geometries])
    if not len(kept):
        raise MapError(f"{path}: layer {name!r} is empty: no {shape} among its {len(geometries)} features")
    tags = tuple(_tags({f: c[i] for f, c in zip(meta["fields"], columns, strict=True)}) for i in kept)
    features = Features(path, _crs(path, meta["crs"]), np.asarray(geometries)[kept], tags)
    _check_coordinates(features)
    return features


def _layer(path: Path, shape: Shape, layer: str | None, osm: bool) -> str:
    layers = pyogrio.list_layers(path)
    names = [str(n) for n in layers[:, 0]]
    if layer is not None:
        if layer not in names:
            raise MapError(f"{path}: no layer {layer!r}; it has {', '.join(map(repr, names)) or 'none'}")
        return layer
    if osm:
        return _OSM[shape][0]
    # A type may be followed by Z or M, and be unknown where a layer mixes several.
    fitting = [str(n) for n, t in layers if t is None or str(t).split()[0] in (*_TYPES[shape], "Unknown")]
    if len(fitting) != 1:
        found = f"{len(fitting)} layers with {shape}" if fitting else f"no layer with {shape}"
        raise MapError(f"{path}: {found} among {', '.join(map(repr, names)) or 'none'}; expected one, or name it")
    return fitting[0]


def _crs(path: Path, crs: str | None) -> CRS:
    if crs is None:
        raise MapError(f"{path}: no coordinate system; any that PROJ knows is allowed")
    try:
        return CRS.from_user_input(crs)
    except CRSError:
        raise MapError(f"{path}: the coordinate system {crs[:80]!r} is not known to PROJ") from None


def _check_coordinates(features: Features) -> None:
    xy = shapely.get_coordinates(features.geometries)
    bad = ~np.isfinite(xy).all(axis=1)
    if features.crs.is_geographic:
        bad |= (np.abs(xy) > (180, 90)).any(axis=1)
    if bad.any():
        x, y = xy[bad][0]
        raise MapError(
            f"{features.path}: {np.count_nonzero(bad)} of {len(xy)} points, as ({x:g}, {y:g}), do not exist in "
            f"{features.crs.name}, the file's coordinate system; systems must be stated and not be mixed"
        )


def _tags(fields: dict[str, Any]) -> dict[str, Any]:
    """Tags that are set; those GDAL packs into ``other_tags`` (an hstore) beside the others."""
    packed = fields.pop("other_tags", None)
    extra = {k: re.sub(r"\\(.)", r"\1", v) for k, v in _HSTORE.findall(packed)} if isinstance(packed, str) else {}
    return {k: v for k, v in {**extra, **fields}.items() if v is not None and v != "" and v == v}


def number(tag: Any) -> float | None:
    """A tag's number, with or without "m"; None where it is not set or says something else."""
    if isinstance(tag, bool) or tag is None:
        return None
    if isinstance(tag, (int, float, np.number)):
        return float(tag) if np.isfinite(tag) else None
    match = _NUMBER.fullmatch(str(tag))
    return float(match[1].replace(",", ".")) if match else None


def _one_line(e: Exception, path: Path) -> str:
    """GDAL's words without its advice and without the path, which stands before."""
    return " ".join(str(e).split("; It might help")[0].replace(f"'{path}'", "").split()).rstrip(".")
