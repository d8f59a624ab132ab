"""WGS84 <-> UTM grid <-> world frame: coordinates, meridian convergence, point scale, heights.

The world frame w of a flight is the grid of one UTM zone, reduced by a stated origin: x grid east, y grid north, z up,
in metres; heights are ellipsoidal (WGS84). It is treated as Cartesian, as in the source (Kozempel 2012, 3.1: the map
system m): the curvature of the Earth (8 cm over 1 km) and the point scale (0.9996 on the central meridian) are not
corrected.

Geoid models need grids that an installation need not have; without them PROJ returns the heights unchanged and says
nothing. So heights over a geoid enter by a *stated* constant undulation only (`ellipsoidal_height`), and a coordinate
reference system with a vertical part is refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from pyproj import CRS, Proj, Transformer
from pyproj.exceptions import CRSError, ProjError

Array = np.ndarray
AnyCRS = CRS | int | str

WGS84 = 4326
# UTM ends at 80° S and 84° N; beyond twice the half width of a zone its grid serves nobody.
_LATITUDES_DEG = (-80.0, 84.0)
_GREATEST_DISTANCE_DEG = 6.0
_GREATEST_UNDULATION_M = 110.0


@dataclass(frozen=True)
class Georeference:
    """Where the world frame w lies: the EPSG code of a WGS84 / UTM zone and the origin (east, north, height) [m] in it.

    Heights of the origin are ellipsoidal. Points of w are (..., 3), or (..., 2) where the height plays no part.

    Raises
        ValueError: a code other than 32601-32660 (north) or 32701-32760 (south), an origin that is not finite.
    """

    epsg: int
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.epsg // 100 not in (326, 327) or not 1 <= self.epsg % 100 <= 60:
            raise ValueError(
                f"Georeference.epsg: expected a WGS84 / UTM zone, 32601-32660 or 32701-32760, got {self.epsg}"
            )
        origin = tuple(float(v) for v in self.origin_m)
        if len(origin) != 3 or not np.isfinite(origin).all():
            raise ValueError(f"Georeference.origin_m: expected three finite numbers, got {self.origin_m}")
        object.__setattr__(self, "origin_m", origin)

    @staticmethod
    def around(points: Float[Array, "*b d"], crs: AnyCRS = WGS84, height_m: float = 0.0) -> Georeference:
        """Zone and origin chosen from the data: both at the mean of the points (x or longitude first).

        The origin is in full metres; the zones are the regular ones, without the exceptions of Norway and Svalbard.
        """
        geographic = _transform(points, crs, WGS84)[..., :2].reshape(-1, 2)
        if not len(geographic):
            raise ValueError("Georeference.around: no points")
        lon = np.deg2rad(geographic[:, 0])
        centre = np.array([np.rad2deg(np.angle(np.mean(np.exp(1j * lon)))), geographic[:, 1].mean()])
        zone = min(int((centre[0] + 180) // 6) + 1, 60)
        epsg = (32600 if centre[1] >= 0 else 32700) + zone
        east, north = np.round(_transform(centre, WGS84, epsg))
        return Georeference(epsg, (float(east), float(north), height_m))

    @property
    def zone(self) -> int:
        return self.epsg % 100

    @property
    def is_north(self) -> bool:
        return self.epsg // 100 == 326

    @property
    def central_meridian_deg(self) -> float:
        return self.zone * 6.0 - 183.0

    def from_grid(self, grid: Float[Array, "*b d"]) -> Float[Array, "*b d"]:
        """World coordinates of (east, north[, ellipsoidal height]) [m] in this zone."""
        grid = np.asarray(grid, float)
        return np.asarray(grid - np.array(self.origin_m)[: grid.shape[-1]])

    def to_grid(self, p_w: Float[Array, "*b d"]) -> Float[Array, "*b d"]:
        """(east, north[, ellipsoidal height]) [m] of world points."""
        p_w = np.asarray(p_w, float)
        return np.asarray(p_w + np.array(self.origin_m)[: p_w.shape[-1]])

    def from_crs(self, points: Float[Array, "*b d"], crs: AnyCRS = WGS84) -> Float[Array, "*b d"]:
        """World coordinates of points of any horizontal system, by default (longitude, latitude) [deg].

        x or longitude comes first, whatever order the authority states. A third coordinate is the ellipsoidal WGS84
        height [m] and is only reduced by the origin's.

        Raises
            ValueError: a system with heights over a geoid, points without coordinates or outside this zone's reach.
        """
        source = _horizontal(crs)
        lon_lat = _transform(points, source, WGS84)[..., :2]
        self._check_reach(lon_lat)
        return self.from_grid(_transform(points, source, self.epsg))

    def to_crs(self, p_w: Float[Array, "*b d"], crs: AnyCRS = WGS84) -> Float[Array, "*b d"]:
        """Inverse of `from_crs`."""
        return _transform(self.to_grid(p_w), self.epsg, crs)

    def _check_reach(self, lon_lat: Array) -> None:
        distance = np.abs((lon_lat[..., 0] - self.central_meridian_deg + 180) % 360 - 180)
        low, high = _LATITUDES_DEG
        bad = (distance > _GREATEST_DISTANCE_DEG) | (lon_lat[..., 1] < low) | (lon_lat[..., 1] > high)
        if np.any(bad):
            lon, lat = lon_lat[bad][0]
            raise ValueError(
                f"Georeference: {np.count_nonzero(bad)} of {bad.size} points lie outside the reach of UTM zone "
                f"{self.zone} ({_GREATEST_DISTANCE_DEG:g} degrees about longitude {self.central_meridian_deg:g}, "
                f"latitude {low:g} to {high:g}), the first at longitude {lon:.4f}, latitude {lat:.4f}"
            )

    def convergence(self, p_w: Float[Array, "*b d"]) -> Float[Array, "*b"]:
        """Meridian convergence [rad]: direction of grid north, clockwise from true north; to 1e-9 rad.

        ``grid bearing = true heading - convergence``. Positive east of the central meridian on the northern hemisphere:
        1.86 degrees at 11.5 E, 48.1 N (Munich, the source's flights) in zone 32.
        """
        return np.asarray(np.deg2rad(self._factors(p_w, "meridian_convergence")))

    def point_scale(self, p_w: Float[Array, "*b d"]) -> Float[Array, "*b"]:
        """Grid length over ellipsoidal length at each point, the same in all directions (UTM is conformal)."""
        return self._factors(p_w, "meridional_scale")

    def _factors(self, p_w: Array, name: str) -> Array:
        lon_lat = self.to_crs(p_w)[..., :2]
        factors = _projection(self.epsg).get_factors(lon_lat[..., 0].ravel(), lon_lat[..., 1].ravel())
        return np.asarray(getattr(factors, name), float).reshape(lon_lat.shape[:-1])


def ellipsoidal_height(orthometric_m: ArrayLike, undulation_m: float) -> Float[Array, "*b"]:
    """Height over the ellipsoid from the height over the geoid (SRTM, maps) and the geoid's stated undulation [m].

    Raises
        ValueError: an undulation outside ±110 m, the range of the Earth's geoid.
    """
    if not abs(undulation_m) <= _GREATEST_UNDULATION_M:
        raise ValueError(f"undulation_m: expected within ±{_GREATEST_UNDULATION_M:g} m, got {undulation_m}")
    return np.asarray(orthometric_m, float) + undulation_m


def _horizontal(crs: AnyCRS) -> CRS:
    """The system, if PROJ knows it and it has no heights over a geoid."""
    try:
        system = CRS.from_user_input(crs)
    except CRSError as error:
        raise ValueError(f"coordinate reference system {str(crs)[:80]!r}: not known to PROJ") from error
    if system.is_compound or system.is_vertical:
        raise ValueError(
            f"coordinate reference system {system.name!r} has heights over a geoid, whose model is not at hand: give "
            "the horizontal system, and ellipsoidal heights by a stated undulation"
        )
    return system


@lru_cache(maxsize=64)
def _transformer(source: CRS, target: CRS) -> Transformer:
    try:
        return Transformer.from_crs(source, target, always_xy=True, allow_ballpark=False)
    except ProjError as error:
        raise ValueError(f"no transformation of known accuracy from {source.name!r} to {target.name!r}") from error


@lru_cache(maxsize=64)
def _projection(epsg: int) -> Proj:
    return Proj(epsg)


def _transform(points: ArrayLike, source: AnyCRS, target: AnyCRS) -> Array:
    """Points (..., 2) or (..., 3) of another system; the third coordinate is passed on."""
    p = np.asarray(points, float)
    if p.ndim < 1 or p.shape[-1] not in (2, 3):
        raise ValueError(f"expected points (..., 2) or (..., 3), got shape {p.shape}")
    transformer = _transformer(_horizontal(source).to_2d(), _horizontal(target).to_2d())
    x, y = transformer.transform(p[..., 0].ravel(), p[..., 1].ravel())
    out = p.copy()
    out[..., 0], out[..., 1] = np.reshape(x, p.shape[:-1]), np.reshape(y, p.shape[:-1])
    bad = ~np.isfinite(out).all(axis=-1)
    if np.any(bad):
        names = [CRS.from_user_input(system).name for system in (source, target)]
        raise ValueError(
            f"{np.count_nonzero(bad)} of {bad.size} points have no coordinates in {names[1]!r}, the first is "
            f"{p[bad][0].tolist()} in {names[0]!r}"
        )
    return out
