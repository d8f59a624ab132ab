"""Lofted vehicle bodies: sections across the vehicle between the side silhouette and the sill, with wheel arches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sim.meshes.shapes import Hull
from sim.meshes.solid import closed_tube

Array = np.ndarray


@dataclass(frozen=True)
class Detail:
    """How finely a body is cut: largest gap between stations [m], points on the flank, corner and roof, cap rings."""

    gap_m: float
    arch: int
    flank: tuple[int, int]
    corner: int
    crown: int
    cap: int
    wheel_segments: int
    accessories: bool


DETAILS = (
    Detail(0.45, 6, (5, 3), 2, 3, 4, 22, True),
    Detail(1.0, 3, (2, 1), 1, 1, 1, 12, True),
    Detail(1.6, 0, (1, 1), 0, 1, 0, 8, False),
)


@dataclass(frozen=True, eq=False)
class Chassis:
    """What a hull must leave free: wheel centres along x, arch radius and centre height, inner half width [m]."""

    wheels_x: tuple[float, float]
    arch_m: float
    center_m: float
    half_width_m: float
    inner_m: float


def roof_line(hull: Hull, x: Array) -> Array:
    """Height of the side silhouette, its corners rounded over ``smooth_m``."""
    p = np.asarray(hull.top)
    offsets = np.linspace(-1, 1, 9) * hull.smooth_m
    wide = np.clip(np.asarray(x, float)[..., None] + offsets, p[0, 0], p[-1, 0])
    rounded = np.interp(wide, p[:, 0], p[:, 1]).mean(axis=-1)
    blend = np.clip(np.minimum(x - p[0, 0], p[-1, 0] - x) / max(hull.smooth_m, 1e-9), 0, 1)
    return np.asarray(blend * rounded + (1 - blend) * np.interp(x, p[:, 0], p[:, 1]))


def plan_factor(hull: Hull, x: Array, half_width: float) -> Array:
    """Share of the half width left by the rounded corners seen from above."""
    x0, x1 = hull.top[0][0] + hull.tail_bulge_m, hull.top[-1][0] - hull.nose_bulge_m
    factor = np.ones_like(np.asarray(x, float))
    for distance, (depth, inset) in ((x - x0, hull.tail_round), (x1 - x, hull.nose_round)):
        q = np.clip(1 - distance / depth, 0, 1)
        factor = factor - inset / half_width * (1 - np.sqrt(np.maximum(1 - q**2.2, 0)))
    return np.asarray(factor)


def half_width(hull: Hull, x: Array, z: Array, widest: float) -> Array:
    """Half width y of the outer skin at (x, z)."""
    p = np.asarray(hull.flank)
    return np.asarray(widest * np.interp(z, p[:, 0], p[:, 1]) * plan_factor(hull, x, widest))


def _stations(hull: Hull, chassis: Chassis, detail: Detail) -> Array:
    """x of the sections, dense where the outline turns."""
    x0, x1 = hull.top[0][0] + hull.tail_bulge_m, hull.top[-1][0] - hull.nose_bulge_m
    ends = 1 - np.cos(np.linspace(0, np.pi / 2, 2 + detail.cap))
    xs: list[Array] = [x0 + hull.tail_round[0] * ends, x1 - hull.nose_round[0] * ends]
    breaks = np.array([p[0] for p in hull.top])
    if detail.arch:
        xs.append(np.concatenate([breaks - hull.smooth_m / 2, breaks + hull.smooth_m / 2]))
        if hull.arches:
            angle = np.linspace(0, np.pi, 2 * detail.arch + 1)
            for c in chassis.wheels_x:
                arch = c + chassis.arch_m * np.cos(angle)
                xs += [arch, c + (chassis.arch_m + 0.012) * np.array([-1, 1])]
    else:
        xs.append(breaks)
    x = np.unique(np.clip(np.concatenate(xs), x0, x1))
    keep = [0]
    least = 0.011 if detail.arch else 0.3
    for i in range(1, len(x) - 1):
        if x[i] - x[keep[-1]] >= least and x[-1] - x[i] >= least:
            keep.append(i)
    x = np.append(x[keep], x[-1])
    gaps = np.ceil(np.diff(x) / detail.gap_m).astype(int)
    filled = [np.linspace(a, b, n + 1)[:-1] for a, b, n in zip(x[:-1], x[1:], gaps, strict=True)]
    return np.concatenate([*filled, x[-1:]])


def _sill(hull: Hull, chassis: Chassis, x: Array, arches: bool) -> Array:
    """Lower edge of the flank with the wheel arches cut out, raised a little toward both ends."""
    ends = np.minimum(x - hull.top[0][0], hull.top[-1][0] - x)
    z = hull.sill_m + 0.06 * np.clip(1 - ends / 0.5, 0, 1)
    if hull.arches and arches:
        for c in chassis.wheels_x:
            square = chassis.arch_m**2 - (x - c) ** 2
            z = np.where(square >= -1e-9, np.maximum(z, chassis.center_m + np.sqrt(np.maximum(square, 0))), z)
    return np.asarray(z)


def loft(hull: Hull, chassis: Chassis, detail: Detail) -> tuple[Array, Array, Array]:
    """Vertices, faces and per-face flags "hidden" (floor and wheel houses) of one closed hull."""
    x = _stations(hull, chassis, detail)
    low, top = _sill(hull, chassis, x, detail.arch > 0), roof_line(hull, x)
    half = _half_sections(hull, chassis, detail, x, low, top)
    rings = np.concatenate([half, half[:, -2:0:-1] * [1, -1, 1]], axis=1)
    tail, nose = _cap(rings[0], -hull.tail_bulge_m, detail), _cap(rings[-1], hull.nose_bulge_m, detail)
    rings = np.concatenate([tail[::-1], rings, nose])
    vertices, faces = closed_tube(rings)
    vertices[-2, 0], vertices[-1, 0] = hull.top[0][0], hull.top[-1][0]
    n, m, _ = rings.shape
    # Points 0..3 of the half section are the floor's centre and edge, the sill's inner and outer edge.
    from_floor = np.minimum(np.arange(m), m - np.arange(m)) <= 3
    low_point = np.zeros((n, m), bool)
    low_point[detail.cap : n - detail.cap] = from_floor
    return vertices, faces, np.append(low_point.ravel(), [False, False])[faces].all(axis=1)


def _half_sections(hull: Hull, chassis: Chassis, detail: Detail, x: Array, low: Array, top: Array) -> Array:
    """Half sections (n, k, 3) from the floor's centre round the left side to the roof's centre."""
    W = chassis.half_width_m
    crown = np.full_like(x, hull.crown_m)
    corner = np.minimum(hull.corner_m, 0.4 * (top - crown - low))
    z_side = top - crown - corner
    belt = np.minimum(hull.belt_m, low + 0.75 * (z_side - low))
    lower = np.linspace(0, 1, detail.flank[0] + 1)
    upper = np.linspace(0, 1, detail.flank[1] + 1)[1:]
    z = np.concatenate(
        [low[:, None] + (belt - low)[:, None] * lower, belt[:, None] + (z_side - belt)[:, None] * upper], axis=1
    )
    y = half_width(hull, x[:, None], z, W)
    y_low, y_side = y[:, :1], y[:, -1:]
    floor = hull.sill_m - 0.03 + np.minimum(low - hull.sill_m, 0.06)
    inner = np.minimum(chassis.inner_m, 0.8 * y_low[:, 0])
    under = [(0 * x, floor), (inner, floor), (inner, low)]
    a = np.linspace(0, np.pi / 2, detail.corner + 2)[1:]
    y_corner = y_side - corner[:, None] * (1 - np.cos(a))
    z_corner = z_side[:, None] + corner[:, None] * np.sin(a)
    t = np.linspace(1, 0, detail.crown + 1)[1:]
    y_crown = y_corner[:, -1:] * t
    z_crown = top[:, None] - crown[:, None] * t**2
    Y = np.concatenate([*[u[0][:, None] for u in under], y, y_corner, y_crown], axis=1)
    Z = np.concatenate([*[u[1][:, None] for u in under], z, z_corner, z_crown], axis=1)
    return np.stack([np.broadcast_to(x[:, None], Y.shape), Y, Z], axis=-1)


def _cap(ring: Float[Array, "m 3"], bulge: float, detail: Detail) -> Float[Array, "c m 3"]:
    """Shrinking rings that close an end with a slightly bulging face, outermost first."""
    s = np.linspace(1, 0, detail.cap + 2)[1:-1, None, None]
    center = np.array([ring[0, 0], 0.0, (ring[:, 2].min() + ring[:, 2].max()) / 2])
    rings = center + s * (ring - center)
    rings[..., 0] += bulge * (1 - s[..., 0] ** 3)
    return np.asarray(rings)
