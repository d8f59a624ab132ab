"""The painted flank of a vehicle, shared by both sides: (x, z) in the kind's own metres."""

from __future__ import annotations

import numpy as np

from sim.meshes.body import roof_line
from sim.meshes.painter import CHROME, GLASS, PLASTIC, RUBBER, SEEN_THROUGH, Painter
from sim.meshes.shapes import Shape
from sim.textures import Board

Array = np.ndarray


def _arch(shape: Shape, z: Array, grow: float) -> Array:
    """Distance along x from a wheel's centre to a circle around its arch at height z."""
    r = 1.17 * shape.wheel_radius_m * grow
    return np.sqrt(np.maximum(r**2 - (z - shape.wheel_radius_m) ** 2, 0))


def paint_flank(p: Painter) -> None:
    """Doors, seams, creases, wheel arches, side glass; lamps that reach round the corner."""
    s, b = p.shape, p.board("side")
    L, _, H = s.size_m
    sill = s.hulls[0].sill_m
    rear, front = s.rear_overhang_m, s.rear_overhang_m + s.wheelbase_m
    for a, e in zip(s.doors[:-1], s.doors[1:], strict=True):
        b.rect(a, 0, e - a, H, p.tone(1 + p.rng.normal(0, 0.03)))
    b.rect(0, 0, L, sill + 0.07, PLASTIC, 0.9)
    b.rect(0, 0, rear, sill + 0.16, p.tone(0.75), 0.6)
    b.rect(front, 0, L, sill + 0.16, p.tone(0.75), 0.6)
    for c in (rear, front):
        b.disc((c, s.wheel_radius_m), 1.24 * s.wheel_radius_m, p.tone(0.6))
    crease = 0.70 * s.belt_m[1]
    b.line([(0.15, crease + 0.03), (L - 0.3, crease - 0.02)], 0.012, p.tone(1.25), 0.55)
    b.line([(0.15, crease + 0.015), (L - 0.3, crease - 0.035)], 0.016, p.tone(0.6), 0.55)
    if p.rng.random() < 0.4 and not p.heavy:
        b.rect(rear + 0.45, 0.5, s.wheelbase_m - 0.9, 0.05, PLASTIC)
    _doors(p, b)
    for x0, z0, dx in ((0.0, 0.56, rear - 0.36), (front + 0.38, 0.55, L - front)):
        if not p.heavy:
            b.line([(x0, z0), (x0 + dx, z0 - 0.02)], 0.009, p.seam)
    z0, z1 = s.headlight_m
    b.poly([(L, z0), (L - 0.22, z0 + 0.05), (L - 0.34, z1 + 0.015), (L, z1)], (0.62, 0.64, 0.66))
    b.poly([(L - 0.2, z0 + 0.05), (L - 0.3, z1), (L - 0.24, z1), (L - 0.15, z0 + 0.05)], (0.75, 0.38, 0.10))
    t0, t1, depth = s.tail_light_m
    b.poly([(0, t0), (depth * 0.55, t0 + 0.02), (depth * 0.8, t1), (0, t1)], (0.45, 0.03, 0.03))
    if p.heavy:
        _livery(p, b)
    _glass(p, b)


def _doors(p: Painter, b: Board) -> None:
    s = p.shape
    rear, front = s.rear_overhang_m, s.rear_overhang_m + s.wheelbase_m
    bottom = s.hulls[0].sill_m + 0.075
    z = np.linspace(np.interp(s.doors[0], [0, s.size_m[0]], s.belt_m) + 0.02, bottom, 14) if s.doors else np.zeros(0)
    for x in s.doors:
        xs = np.maximum(x - 0.02 * (z[0] - z), rear + np.where(x > rear, _arch(s, z, 1.13), -9))
        xs = np.minimum(xs, front - np.where(x < front, _arch(s, z, 1.13), -9))
        b.line(np.stack([xs, z], -1), 0.011, p.seam)
        b.line(np.stack([xs + 0.012, z], -1), 0.006, p.tone(1.3), 0.4)
    if len(s.doors) > 1:
        b.line([(s.doors[0], bottom), (s.doors[-1], bottom)], 0.012, p.seam)
    for x in s.doors[:-1]:
        handle = s.belt_m[1] - 0.10
        b.rect(x + 0.08, handle - 0.03, 0.20, 0.055, p.tone(0.5), 0.7)
        b.rect(x + 0.09, handle, 0.17, 0.025, CHROME if p.rng.random() < 0.3 else p.tone(1.1))
    if s.doors:
        x = s.rear_overhang_m + 0.05
        ring = np.linspace(0, 2 * np.pi, 25)
        b.line(np.stack([x + 0.085 * np.cos(ring), s.belt_m[0] - 0.15 + 0.075 * np.sin(ring)], -1), 0.007, p.seam)


def _livery(p: Painter, b: Board) -> None:
    """Box and emblem of a lorry, stripes of a bus."""
    s = p.shape
    L, _, H = s.size_m
    if len(s.hulls) > 1:
        x1 = s.hulls[1].top[-1][0]
        b.rect(0, 1.0, x1, H, (0.82, 0.82, 0.80))
        b.rect(0, 1.05, x1, 0.16, p.paint)
        for x in np.arange(0.02, x1, 0.61):
            b.line([(x, 1.05), (x, H)], 0.012, (0.60, 0.60, 0.60))
        wave = np.linspace(0, x1, 40)
        crest = 1.7 + p.rng.uniform(0.2, 0.5) * np.sin(wave * p.rng.uniform(0.6, 1.2) + p.rng.uniform(0, 6))
        b.poly([(0, 1.05), *zip(wave, crest, strict=True), (x1, 1.05)], p.paint)
        b.disc((x1 / 2, 2.55), 0.55, p.tone(0.8))
        b.disc((x1 / 2, 2.55), 0.42, (0.82, 0.82, 0.80))
        b.disc((x1 / 2, 2.55), 0.30, p.tone(1.2))
        for x in np.arange(0.1, x1, 0.75):
            b.rect(x, 1.06, 0.10, 0.05, (0.80, 0.45, 0.08))
        return
    b.rect(0, 1.35, L, 0.10, p.tone(0.6))
    b.rect(0, 0.62, L, 0.22, (0.85, 0.85, 0.83) if sum(p.paint) < 1.8 else (0.12, 0.22, 0.45))
    for x in np.arange(0.6, L - 0.6, 1.5):
        b.line([(x, 0.36), (x, 1.05)], 0.01, p.seam)


def _pane(p: Painter, a: float, e: float, grow: float) -> Array:
    """Outline of side glass between a and e, between the belt and the roof line."""
    s = p.shape
    hull = s.hulls[0]
    x = np.linspace(a - grow, e + grow, 40)
    below = np.interp(x, [0, s.size_m[0]], s.belt_m) - grow
    above = roof_line(hull, x) - hull.crown_m - 0.75 * hull.corner_m - 0.02 + grow
    if len(s.doors) == 0:
        above = np.minimum(above, s.size_m[2] - 0.62 + grow)
    lean = 0.10 * np.clip((above - below) / 0.4, 0, 1.0)
    keep = above > below + 0.015
    if not keep.any():
        return np.zeros((0, 2))
    x, below, above, lean = x[keep], below[keep], above[keep], lean[keep]
    upper = np.clip(x - lean * 0.3, a - grow - 0.05, e + grow)
    return np.concatenate([np.stack([x, below], -1), np.stack([upper, above], -1)[::-1]])


def _glass(p: Painter, b: Board) -> None:
    s = p.shape
    outlines = [_pane(p, a, e, 0.035) for a, e in s.panes]
    for outline in outlines:
        if len(outline):
            b.poly(outline, RUBBER)
    for a, e in s.panes:
        outline = _pane(p, a, e, 0.0)
        if not len(outline):
            continue
        b.poly(outline, GLASS)
        center = outline.mean(axis=0)
        through = (outline - center) * [0.80, 0.72] + center + [0.04, 0.03]
        b.poly(through, SEEN_THROUGH, p.rng.uniform(0.5, 0.9))
        low = outline[:, 1].min()
        seat = a + 0.62 * (e - a) if e - a > 0.5 else center[0]
        b.poly([(seat - 0.13, low), (seat + 0.14, low), (seat + 0.06, low + 0.22), (seat + 0.04, low + 0.33),
                (seat - 0.12, low + 0.33), (seat - 0.14, low + 0.2)], (0.06, 0.06, 0.065))  # fmt: skip
    strip = CHROME if p.rng.random() < 0.4 else (0.62, 0.62, 0.63)
    if s.doors and s.panes:
        x = np.array([s.panes[0][0], s.panes[-1][1]])
        b.line(np.stack([x, np.interp(x, [0, s.size_m[0]], s.belt_m) - 0.015], -1), 0.018, strip)
