"""The painted front, rear and top of a vehicle: (y, z) and (x, |y|) in the kind's own metres."""

from __future__ import annotations

import numpy as np

from sim.meshes.body import half_width, roof_line
from sim.meshes.painter import CHROME, GLASS, PLASTIC, RUBBER, SEEN_THROUGH, Painter
from sim.textures import Board, Color


def _plate(p: Painter, b: Board, z: float, left: float) -> None:
    """EU number plate 0.52 x 0.11 m; ``left`` is +1 where the image's left side has positive y."""
    letters = "ABCDEFGHKLMNPRSTUVWXZ"
    pick = "".join(p.rng.choice(list(letters), 4))
    text = f"{pick[:2]} {pick[2:]} {p.rng.integers(100, 9999)}"
    b.rect(-0.275, z - 0.012, 0.55, 0.134, RUBBER)
    b.rect(-0.26, z, 0.52, 0.11, (0.90, 0.90, 0.88))
    b.rect(0.215 if left > 0 else -0.26, z, 0.045, 0.11, (0.05, 0.15, 0.55))
    b.text(0.20 * left, z + 0.098, 0.086, 0.44, text, (0.03, 0.03, 0.03))


def paint_front(p: Painter) -> None:
    """Windscreen of upright fronts, grille, lamps, bumper, plate, destination sign."""
    s, b = p.shape, p.board("front")
    _, W, H = s.size_m
    w = W / 2
    sill = s.hulls[0].sill_m
    g0, g1 = s.grille_m
    if s.front_glass_m:
        z0, z1 = s.front_glass_m
        b.rect(-0.92 * w, z0 - 0.04, 1.84 * w, z1 - z0 + 0.08, RUBBER)
        b.rect(-0.88 * w, z0, 1.76 * w, z1 - z0, GLASS)
        b.rect(-0.80 * w, z0 + 0.3 * (z1 - z0), 1.6 * w, 0.55 * (z1 - z0), SEEN_THROUGH, 0.25)
        for y in (-0.5 * w, 0.35 * w):
            b.line([(y, z0 - 0.02), (y + 0.3 * w, z0 + 0.16)], 0.02, RUBBER)
    b.rect(-w, 0, 2 * w, sill + 0.03, PLASTIC)
    b.line([(-w, g0 - 0.03), (w, g0 - 0.03)], 0.008, p.seam)
    b.line([(-w, g1 + 0.05), (w, g1 + 0.05)], 0.010, p.seam)
    grille = 0.48 * w
    b.poly([(-grille * 0.85, g0), (grille * 0.85, g0), (grille, g1), (-grille, g1)], (0.05, 0.05, 0.055))
    for z in np.arange(g0 + 0.03, g1 - 0.01, 0.045):
        b.rect(-grille * 0.92, z, 1.84 * grille, 0.012, CHROME if p.rng.random() < 0.5 else (0.2, 0.2, 0.21))
    b.disc((0, (g0 + g1) / 2), 0.05, CHROME)
    b.disc((0, (g0 + g1) / 2), 0.035, (0.15, 0.2, 0.35))
    _headlights(p, b)
    b.poly([(-0.55 * w, sill + 0.03), (0.55 * w, sill + 0.03), (0.45 * w, s.plate_m[0] - 0.03),
            (-0.45 * w, s.plate_m[0] - 0.03)], (0.05, 0.05, 0.055))  # fmt: skip
    _plate(p, b, s.plate_m[0], -1)
    if p.heavy and len(s.hulls) == 1:
        b.rect(-0.7 * w, H - 0.42, 1.4 * w, 0.28, (0.04, 0.04, 0.04))
        b.text(-0.6 * w, H - 0.18, 0.2, 1.1 * w, f"{p.rng.integers(10, 99)} Hauptbahnhof", (0.95, 0.65, 0.1))


def _headlights(p: Painter, b: Board) -> None:
    s = p.shape
    w, sill = s.size_m[1] / 2, s.hulls[0].sill_m
    z0, z1 = s.headlight_m
    for side in (-1, 1):
        outline = [(0.54 * w, z0 + 0.02), (0.98 * w, z0), (0.99 * w, z1), (0.60 * w, z1 - 0.02)]
        b.poly([(side * y, z) for y, z in outline], RUBBER)
        c = np.mean(outline, axis=0)
        b.poly([(side * ((y - c[0]) * 0.93 + c[0]), (z - c[1]) * 0.86 + c[1]) for y, z in outline], (0.66, 0.68, 0.70))
        for y in (0.68 * w, 0.85 * w):
            b.disc((side * y, c[1]), 0.36 * (z1 - z0), (0.25, 0.26, 0.28))
            b.disc((side * y, c[1]), 0.24 * (z1 - z0), (0.93, 0.94, 0.95))
        if not p.heavy:
            b.rect(side * 0.74 * w - 0.11, sill + 0.08, 0.22, 0.10, RUBBER)
            b.disc((side * 0.74 * w, sill + 0.13), 0.04, (0.7, 0.71, 0.72))


def paint_rear(p: Painter) -> None:
    """Doors or boot lid, rear window, lamps, plate, badges."""
    s, b = p.shape, p.board("rear")
    if len(s.hulls) > 1:
        _box_doors(b, s.size_m[1] / 2, s.size_m[2])
    else:
        _tailgate(p, b)
    if s.rear_glass_m:
        _rear_window(b, s.size_m[1] / 2, *s.rear_glass_m)
    _tail_lights(p, b)
    w, sill = s.size_m[1] / 2, s.hulls[0].sill_m
    z = s.plate_m[1]
    b.rect(-0.34, z - 0.03, 0.68, 0.17, p.tone(0.55))
    _plate(p, b, z, 1)
    if not p.heavy:
        b.disc((0, z + 0.19), 0.04, CHROME)
        b.text(0.62 * w, z + 0.05, 0.03, 0.16, f"{p.rng.choice(list('ACGPS'))}{p.rng.integers(100, 500)}", CHROME)
        b.disc((0.55 * w, sill + 0.04), 0.035, (0.03, 0.03, 0.03))


def _box_doors(b: Board, w: float, H: float) -> None:
    b.rect(-w, 1.0, 2 * w, H, (0.80, 0.80, 0.78))
    for y in (-0.55 * w, -0.3 * w, 0.3 * w, 0.55 * w):
        b.line([(y, 1.1), (y, H - 0.1)], 0.03, (0.55, 0.55, 0.56))
    b.line([(0, 1.05), (0, H)], 0.02, (0.2, 0.2, 0.2))
    for y in (-0.96 * w, 0.90 * w):
        for z in np.arange(1.2, H - 0.1, 0.3):
            b.rect(y, z, 0.08, 0.1, (0.62, 0.08, 0.06))


def _tailgate(p: Painter, b: Board) -> None:
    s = p.shape
    w, H, sill = s.size_m[1] / 2, s.size_m[2], s.hulls[0].sill_m
    b.rect(-w, 0, 2 * w, sill + 0.10, PLASTIC, 0.9)
    b.line([(-w, 0.60), (w, 0.60)], 0.010, p.seam)
    b.line([(-w, 0.42), (w, 0.42)], 0.008, p.tone(0.6))
    for y in (-0.72 * w, 0.72 * w):
        b.line([(y, 0.60), (y * 1.08, 0.60 + 0.5 * (s.belt_m[0] - 0.6)), (y * 1.02, H)], 0.009, p.seam)
        b.rect(y - 0.08, 0.44, 0.16, 0.03, (0.5, 0.05, 0.05))


def _rear_window(b: Board, w: float, z0: float, z1: float) -> None:
    b.poly([(-0.80 * w, z0 - 0.03), (0.80 * w, z0 - 0.03), (0.72 * w, z1 + 0.03), (-0.72 * w, z1 + 0.03)], RUBBER)
    b.poly([(-0.76 * w, z0), (0.76 * w, z0), (0.68 * w, z1), (-0.68 * w, z1)], GLASS)
    b.poly([(-0.6 * w, z0 + 0.08), (0.6 * w, z0 + 0.08), (0.55 * w, z1 - 0.04), (-0.55 * w, z1 - 0.04)],
           SEEN_THROUGH, 0.55)  # fmt: skip
    for y in (-0.36 * w, 0.36 * w):
        b.poly([(y - 0.13, z0), (y + 0.13, z0), (y + 0.10, z0 + 0.17), (y - 0.10, z0 + 0.17)], RUBBER)
    b.line([(0.0, z0), (-0.35 * w, z0 + 0.07)], 0.018, RUBBER)


def _tail_lights(p: Painter, b: Board) -> None:
    s = p.shape
    w = s.size_m[1] / 2
    t0, t1, depth = s.tail_light_m
    inner = (0.55 if depth > 0.3 else 0.74) * w if not p.heavy else 0.72 * w
    for side in (-1, 1):

        def lamp(y0: float, y1: float, z0: float, z1: float, color: Color, side: int = side) -> None:
            b.poly([(side * y0, z0), (side * y1, z0), (side * y1, z1), (side * y0, z1)], color)

        lamp(inner - 0.012, w, t0 - 0.012, t1 + 0.012, p.seam)
        lamp(inner, w, t0, t1, (0.52, 0.03, 0.03))
        third = (t1 - t0) / 3
        lamp(inner + 0.02, 0.96 * w, t0 + third, t0 + 1.7 * third, (0.78, 0.72, 0.70))
        lamp(inner + 0.02, 0.96 * w, t0 + 1.85 * third, t0 + 2.3 * third, (0.80, 0.42, 0.10))
        lamp(inner + 0.02, 0.96 * w, t0 + 0.12 * third, t0 + 0.9 * third, (0.70, 0.06, 0.05))


def paint_top(p: Painter) -> None:
    """Windscreen and rear window where they are flat enough to be seen from above, bonnet and roof seams."""
    s, b = p.shape, p.board("top")
    hull, w = s.hulls[0], s.size_m[1] / 2
    for span, wiper in ((s.windscreen, True), (s.rear_window, False)):
        if span is None:
            continue
        x = np.linspace(*span, 24)
        edge = half_width(hull, x, roof_line(hull, x) - hull.crown_m, w) - hull.corner_m
        for inset, color in ((-0.01, RUBBER), (0.04, GLASS)):
            y = edge - inset
            b.poly([(x[0] + inset, -0.1), *zip(x, y, strict=True), (x[-1] - inset, -0.1)], color)
        mid = (x > span[0] + 0.12) & (x < span[1] - 0.12)
        if mid.any():
            b.poly([(x[mid][0], -0.1), *zip(x[mid], edge[mid] - 0.16, strict=True), (x[mid][-1], -0.1)],
                   SEEN_THROUGH, 0.35)  # fmt: skip
        if wiper:
            b.line([(span[1] + 0.02, 0.55 * w), (span[1] - 0.08, 0.02)], 0.018, RUBBER)
    front = s.windscreen[1] if s.windscreen else None
    if front is not None:
        nose = s.size_m[0] - 0.16
        b.line([(front + 0.10, 0), (front + 0.08, 0.80 * w), (nose, 0.66 * w)], 0.010, p.seam)
        b.line([(front + 0.3, 0.45 * w), (nose, 0.35 * w)], 0.02, p.tone(1.2), 0.35)
        b.line([(s.windscreen[0] if s.windscreen else 0, 0.60 * w), (0.5, 0.62 * w)], 0.010, p.tone(0.6))
