"""Painting a vehicle's texture: body colour, glass, seams, lamps, grille, number plate and dirt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from sim.meshes.atlas import Atlas
from sim.meshes.body import half_width, roof_line
from sim.meshes.shapes import Shape
from sim.meshes.wheels import paint_wheel
from sim.textures import Board, Color, noise, to_texture

Array = np.ndarray

PAINTS: dict[str, Color] = {
    "white": (0.80, 0.80, 0.79),
    "silver": (0.50, 0.51, 0.52),
    "grey": (0.30, 0.31, 0.33),
    "black": (0.085, 0.085, 0.095),
    "red": (0.56, 0.07, 0.07),
    "blue": (0.10, 0.18, 0.40),
    "green": (0.11, 0.25, 0.18),
}
_RUBBER: Color = (0.07, 0.07, 0.075)
_GLASS: Color = (0.12, 0.135, 0.14)
_SEEN_THROUGH: Color = (0.33, 0.36, 0.38)
_PLASTIC: Color = (0.14, 0.14, 0.15)
_CHROME: Color = (0.78, 0.79, 0.80)


@dataclass(frozen=True, eq=False)
class Painter:
    """One vehicle's texture in the making; coordinates are the shape's own (typical size, x from the rear bumper)."""

    shape: Shape
    atlas: Atlas
    image: Float[Array, "h w 3"]
    paint: Color
    rng: np.random.Generator

    def board(self, chart: str) -> Board:
        """Board in the typical size's metres, scaled to the vehicle's own."""
        b = self.atlas.board(chart, self.image)
        kx, ky, kz = (a / t for a, t in zip(self.atlas.size_m, self.shape.size_m, strict=True))
        factor = {"side": (kx, kz), "top": (kx, ky), "front": (ky, kz), "rear": (ky, kz)}[chart]
        return Board(b.image, b.origin, (b.scale[0] * factor[0], b.scale[1] * factor[1]))

    @property
    def seam(self) -> Color:
        r, g, b = self.paint
        return (0.30 * r, 0.30 * g, 0.30 * b)

    def tone(self, factor: float) -> Color:
        r, g, b = self.paint
        return (min(r * factor, 1), min(g * factor, 1), min(b * factor, 1))


def paint_vehicle(
    shape: Shape, atlas: Atlas, paint: Color, wheel_m: float, rng: np.random.Generator
) -> UInt8[Array, "h w 3"]:
    """The whole texture of a vehicle."""
    image = np.empty((*atlas.shape, 3), np.float32)
    image[:] = paint
    p = Painter(shape, atlas, image, paint, rng)
    heavy = shape.wheel_radius_m > 0.4
    _flank(p, heavy)
    _glass_side(p)
    _front(p, heavy)
    _rear(p, heavy)
    _top(p)
    _dirt(p)
    paint_wheel(atlas.board("wheel", image), wheel_m, rng, heavy)
    atlas.board("white", image).rect(-0.1, -0.1, 0.2, 0.2, (1, 1, 1))
    return to_texture(image)


def _arch(shape: Shape, z: Array, grow: float) -> Array:
    """Distance along x from a wheel's centre to a circle around its arch at height z."""
    r = 1.17 * shape.wheel_radius_m * grow
    return np.sqrt(np.maximum(r**2 - (z - shape.wheel_radius_m) ** 2, 0))


def _flank(p: Painter, heavy: bool) -> None:
    s, b = p.shape, p.board("side")
    L, _, H = s.size_m
    sill = s.hulls[0].sill_m
    rear, front = s.rear_overhang_m, s.rear_overhang_m + s.wheelbase_m
    for a, e in zip(s.doors[:-1], s.doors[1:], strict=True):
        b.rect(a, 0, e - a, H, p.tone(1 + p.rng.normal(0, 0.03)))
    b.rect(0, 0, L, sill + 0.07, _PLASTIC, 0.9)
    b.rect(0, 0, rear, sill + 0.16, p.tone(0.75), 0.6)
    b.rect(front, 0, L, sill + 0.16, p.tone(0.75), 0.6)
    for c in (rear, front):
        b.disc((c, s.wheel_radius_m), 1.24 * s.wheel_radius_m, p.tone(0.6))
    crease = 0.70 * s.belt_m[1]
    b.line([(0.15, crease + 0.03), (L - 0.3, crease - 0.02)], 0.012, p.tone(1.25), 0.55)
    b.line([(0.15, crease + 0.015), (L - 0.3, crease - 0.035)], 0.016, p.tone(0.6), 0.55)
    if p.rng.random() < 0.4 and not heavy:
        b.rect(rear + 0.45, 0.5, s.wheelbase_m - 0.9, 0.05, _PLASTIC)
    _doors(p, b)
    for x0, z0, dx in ((0.0, 0.56, rear - 0.36), (front + 0.38, 0.55, L - front)):
        if not heavy:
            b.line([(x0, z0), (x0 + dx, z0 - 0.02)], 0.009, p.seam)
    z0, z1 = s.headlight_m
    b.poly([(L, z0), (L - 0.22, z0 + 0.05), (L - 0.34, z1 + 0.015), (L, z1)], (0.62, 0.64, 0.66))
    b.poly([(L - 0.2, z0 + 0.05), (L - 0.3, z1), (L - 0.24, z1), (L - 0.15, z0 + 0.05)], (0.75, 0.38, 0.10))
    t0, t1, depth = s.tail_light_m
    b.poly([(0, t0), (depth * 0.55, t0 + 0.02), (depth * 0.8, t1), (0, t1)], (0.45, 0.03, 0.03))
    if heavy:
        _heavy_flank(p, b)


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
        b.rect(x + 0.09, handle, 0.17, 0.025, _CHROME if p.rng.random() < 0.3 else p.tone(1.1))
    if s.doors:
        x = s.rear_overhang_m + 0.05
        ring = np.linspace(0, 2 * np.pi, 25)
        b.line(np.stack([x + 0.085 * np.cos(ring), s.belt_m[0] - 0.15 + 0.075 * np.sin(ring)], -1), 0.007, p.seam)


def _heavy_flank(p: Painter, b: Board) -> None:
    """Box, stripe and lettering of a lorry; doors and stripe of a bus."""
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


def _glass_side(p: Painter) -> None:
    s, b = p.shape, p.board("side")
    outlines = [_pane(p, a, e, 0.035) for a, e in s.panes]
    for outline in outlines:
        if len(outline):
            b.poly(outline, _RUBBER)
    for a, e in s.panes:
        outline = _pane(p, a, e, 0.0)
        if not len(outline):
            continue
        b.poly(outline, _GLASS)
        center = outline.mean(axis=0)
        through = (outline - center) * [0.80, 0.72] + center + [0.04, 0.03]
        b.poly(through, _SEEN_THROUGH, p.rng.uniform(0.5, 0.9))
        low = outline[:, 1].min()
        seat = a + 0.62 * (e - a) if e - a > 0.5 else center[0]
        b.poly([(seat - 0.13, low), (seat + 0.14, low), (seat + 0.06, low + 0.22), (seat + 0.04, low + 0.33),
                (seat - 0.12, low + 0.33), (seat - 0.14, low + 0.2)], (0.06, 0.06, 0.065))  # fmt: skip
    strip = _CHROME if p.rng.random() < 0.4 else (0.34, 0.34, 0.35)
    if s.doors and s.panes:
        x = np.array([s.panes[0][0], s.panes[-1][1]])
        b.line(np.stack([x, np.interp(x, [0, s.size_m[0]], s.belt_m) - 0.015], -1), 0.018, strip)


def _plate(p: Painter, b: Board, z: float, left: float) -> None:
    """EU number plate 0.52 x 0.11 m; ``left`` is +1 where the image's left side has positive y."""
    letters = "ABCDEFGHKLMNPRSTUVWXZ"
    pick = "".join(p.rng.choice(list(letters), 4))
    text = f"{pick[:2]} {pick[2:]} {p.rng.integers(100, 9999)}"
    b.rect(-0.275, z - 0.012, 0.55, 0.134, _RUBBER)
    b.rect(-0.26, z, 0.52, 0.11, (0.90, 0.90, 0.88))
    b.rect(0.215 if left > 0 else -0.26, z, 0.045, 0.11, (0.05, 0.15, 0.55))
    b.text(0.20 * left, z + 0.098, 0.086, 0.44, text, (0.03, 0.03, 0.03))


def _front(p: Painter, heavy: bool) -> None:
    s, b = p.shape, p.board("front")
    _, W, H = s.size_m
    w = W / 2
    sill = s.hulls[0].sill_m
    g0, g1 = s.grille_m
    if s.front_glass_m:
        z0, z1 = s.front_glass_m
        b.rect(-0.92 * w, z0 - 0.04, 1.84 * w, z1 - z0 + 0.08, _RUBBER)
        b.rect(-0.88 * w, z0, 1.76 * w, z1 - z0, _GLASS)
        b.rect(-0.80 * w, z0 + 0.3 * (z1 - z0), 1.6 * w, 0.55 * (z1 - z0), _SEEN_THROUGH, 0.25)
        for y in (-0.5 * w, 0.35 * w):
            b.line([(y, z0 - 0.02), (y + 0.3 * w, z0 + 0.16)], 0.02, _RUBBER)
    b.rect(-w, 0, 2 * w, sill + 0.03, _PLASTIC)
    b.line([(-w, g0 - 0.03), (w, g0 - 0.03)], 0.008, p.seam)
    b.line([(-w, g1 + 0.05), (w, g1 + 0.05)], 0.010, p.seam)
    grille = 0.48 * w
    b.poly([(-grille * 0.85, g0), (grille * 0.85, g0), (grille, g1), (-grille, g1)], (0.05, 0.05, 0.055))
    for z in np.arange(g0 + 0.03, g1 - 0.01, 0.045):
        b.rect(-grille * 0.92, z, 1.84 * grille, 0.012, _CHROME if p.rng.random() < 0.5 else (0.2, 0.2, 0.21))
    b.disc((0, (g0 + g1) / 2), 0.05, _CHROME)
    b.disc((0, (g0 + g1) / 2), 0.035, (0.15, 0.2, 0.35))
    z0, z1 = s.headlight_m
    for side in (-1, 1):
        outline = [(0.54 * w, z0 + 0.02), (0.98 * w, z0), (0.99 * w, z1), (0.60 * w, z1 - 0.02)]
        b.poly([(side * y, z) for y, z in outline], _RUBBER)
        c = np.mean(outline, axis=0)
        b.poly([(side * ((y - c[0]) * 0.93 + c[0]), (z - c[1]) * 0.86 + c[1]) for y, z in outline], (0.66, 0.68, 0.70))
        for y in (0.68 * w, 0.85 * w):
            b.disc((side * y, c[1]), 0.36 * (z1 - z0), (0.25, 0.26, 0.28))
            b.disc((side * y, c[1]), 0.24 * (z1 - z0), (0.93, 0.94, 0.95))
        if not heavy:
            b.rect(side * 0.74 * w - 0.11, sill + 0.08, 0.22, 0.10, _RUBBER)
            b.disc((side * 0.74 * w, sill + 0.13), 0.04, (0.7, 0.71, 0.72))
    b.poly([(-0.55 * w, sill + 0.03), (0.55 * w, sill + 0.03), (0.45 * w, s.plate_m[0] - 0.03),
            (-0.45 * w, s.plate_m[0] - 0.03)], (0.05, 0.05, 0.055))  # fmt: skip
    _plate(p, b, s.plate_m[0], -1)
    if heavy and len(s.hulls) == 1:
        b.rect(-0.7 * w, H - 0.42, 1.4 * w, 0.28, (0.04, 0.04, 0.04))
        b.text(-0.6 * w, H - 0.18, 0.2, 1.1 * w, f"{p.rng.integers(10, 99)} Hauptbahnhof", (0.95, 0.65, 0.1))


def _rear(p: Painter, heavy: bool) -> None:
    s, b = p.shape, p.board("rear")
    _, W, H = s.size_m
    w = W / 2
    sill = s.hulls[0].sill_m
    box = len(s.hulls) > 1
    if box:
        b.rect(-w, 1.0, W, H, (0.80, 0.80, 0.78))
        for y in (-0.55 * w, -0.3 * w, 0.3 * w, 0.55 * w):
            b.line([(y, 1.1), (y, H - 0.1)], 0.03, (0.55, 0.55, 0.56))
        b.line([(0, 1.05), (0, H)], 0.02, (0.2, 0.2, 0.2))
        for y in (-0.96 * w, 0.90 * w):
            for z in np.arange(1.2, H - 0.1, 0.3):
                b.rect(y, z, 0.08, 0.1, (0.62, 0.08, 0.06))
    else:
        b.rect(-w, 0, 2 * w, sill + 0.10, _PLASTIC, 0.9)
        b.line([(-w, 0.60), (w, 0.60)], 0.010, p.seam)
        b.line([(-w, 0.42), (w, 0.42)], 0.008, p.tone(0.6))
        for y in (-0.72 * w, 0.72 * w):
            b.line([(y, 0.60), (y * 1.08, 0.60 + 0.5 * (s.belt_m[0] - 0.6)), (y * 1.02, H)], 0.009, p.seam)
            b.rect(y - 0.08, 0.44, 0.16, 0.03, (0.5, 0.05, 0.05))
    if s.rear_glass_m:
        z0, z1 = s.rear_glass_m
        b.poly([(-0.80 * w, z0 - 0.03), (0.80 * w, z0 - 0.03), (0.72 * w, z1 + 0.03), (-0.72 * w, z1 + 0.03)], _RUBBER)
        b.poly([(-0.76 * w, z0), (0.76 * w, z0), (0.68 * w, z1), (-0.68 * w, z1)], _GLASS)
        b.poly([(-0.6 * w, z0 + 0.08), (0.6 * w, z0 + 0.08), (0.55 * w, z1 - 0.04), (-0.55 * w, z1 - 0.04)],
               _SEEN_THROUGH, 0.55)  # fmt: skip
        for y in (-0.36 * w, 0.36 * w):
            b.poly([(y - 0.13, z0), (y + 0.13, z0), (y + 0.10, z0 + 0.17), (y - 0.10, z0 + 0.17)], _RUBBER)
        b.line([(0.0, z0), (-0.35 * w, z0 + 0.07)], 0.018, _RUBBER)
    t0, t1, depth = s.tail_light_m
    inner = (0.55 if depth > 0.3 else 0.74) * w if not heavy else 0.72 * w
    for side in (-1, 1):

        def lamp(y0: float, y1: float, z0: float, z1: float, color: Color, side: int = side) -> None:
            b.poly([(side * y0, z0), (side * y1, z0), (side * y1, z1), (side * y0, z1)], color)

        lamp(inner - 0.012, w, t0 - 0.012, t1 + 0.012, p.seam)
        lamp(inner, w, t0, t1, (0.52, 0.03, 0.03))
        third = (t1 - t0) / 3
        lamp(inner + 0.02, 0.96 * w, t0 + third, t0 + 1.7 * third, (0.78, 0.72, 0.70))
        lamp(inner + 0.02, 0.96 * w, t0 + 1.85 * third, t0 + 2.3 * third, (0.80, 0.42, 0.10))
        lamp(inner + 0.02, 0.96 * w, t0 + 0.12 * third, t0 + 0.9 * third, (0.70, 0.06, 0.05))
    z = s.plate_m[1]
    b.rect(-0.34, z - 0.03, 0.68, 0.17, p.tone(0.55))
    _plate(p, b, z, 1)
    if not heavy:
        b.disc((0, z + 0.19), 0.04, _CHROME)
        b.text(0.62 * w, z + 0.05, 0.03, 0.16, f"{p.rng.choice(list('ACGPS'))}{p.rng.integers(100, 500)}", _CHROME)
        b.disc((0.55 * w, sill + 0.04), 0.035, (0.03, 0.03, 0.03))


def _top(p: Painter) -> None:
    s, b = p.shape, p.board("top")
    hull, w = s.hulls[0], s.size_m[1] / 2
    for span, wiper in ((s.windscreen, True), (s.rear_window, False)):
        if span is None:
            continue
        x = np.linspace(*span, 24)
        edge = half_width(hull, x, roof_line(hull, x) - hull.crown_m, w) - hull.corner_m
        for inset, color in ((-0.01, _RUBBER), (0.04, _GLASS)):
            y = edge - inset
            b.poly([(x[0] + inset, -0.1), *zip(x, y, strict=True), (x[-1] - inset, -0.1)], color)
        mid = (x > span[0] + 0.12) & (x < span[1] - 0.12)
        if mid.any():
            b.poly([(x[mid][0], -0.1), *zip(x[mid], edge[mid] - 0.16, strict=True), (x[mid][-1], -0.1)],
                   _SEEN_THROUGH, 0.35)  # fmt: skip
        if wiper:
            b.line([(span[1] + 0.02, 0.55 * w), (span[1] - 0.08, 0.02)], 0.018, _RUBBER)
    front = s.windscreen[1] if s.windscreen else None
    if front is not None:
        nose = s.size_m[0] - 0.16
        b.line([(front + 0.10, 0), (front + 0.08, 0.80 * w), (nose, 0.66 * w)], 0.010, p.seam)
        b.line([(front + 0.3, 0.45 * w), (nose, 0.35 * w)], 0.02, p.tone(1.2), 0.35)
        b.line([(s.windscreen[0] if s.windscreen else 0, 0.60 * w), (0.5, 0.62 * w)], 0.010, p.tone(0.6))


def _dirt(p: Painter) -> None:
    """Uneven paint, road dust that gathers low down, splashes and specks: what a corner tracker finds on a real car."""
    rows, columns = p.image.shape[:2]
    coarse, fine = noise((512, 512), 2.0, p.rng), noise((1024, 1024), 0.9, p.rng)
    coarse = np.tile(np.kron(coarse, np.ones((2, 2), np.float32)), (rows // 1024, columns // 1024))
    fine = np.tile(fine, (rows // 1024, columns // 1024))
    image = p.image
    image *= (1 + 0.030 * coarse + 0.035 * fine)[..., None]
    dust = np.zeros((rows, columns), np.float32)
    scale = p.atlas.scale
    height = (np.arange(rows) + 0.5) / scale
    H = p.atlas.size_m[2]
    for ground in (p.atlas.origins()["side"][1], p.atlas.origins()["front"][1]):
        z = np.where((ground - height > -0.03) & (ground - height < H), ground - height, np.inf)
        dust += (0.55 * np.exp(-np.maximum(z, 0) / 0.28)).astype(np.float32)[:, None]
    dust = np.clip((dust + 0.04) * (1 + 0.45 * coarse + 0.25 * fine), 0, 0.8)
    specks = np.clip(fine - 2.0, 0, 1) * (0.08 + 0.5 * dust)
    image += (np.array([0.46, 0.43, 0.38], np.float32) - image) * np.clip(dust + specks, 0, 0.9)[..., None]
