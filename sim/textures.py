"""Procedural textures, deterministic in the generator: 1/f^beta noise, grass, slabs, leaves and the drawing board.

Textures are sRGB uint8 images whose row 0 is at the top, sides powers of two; those meant to be repeated are seamless.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
import scipy.fft
from jaxtyping import Float, UInt8
from numpy.typing import ArrayLike

Array = np.ndarray
Color = tuple[float, float, float]


def linear_from_srgb(x: ArrayLike) -> Array:
    """Linear light in 0..1 of an sRGB code value in 0..1."""
    v = np.asarray(x, float)
    return np.asarray(np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4))


def noise(shape: tuple[int, int], beta: float, rng: np.random.Generator, stretch: float = 1.0) -> Float[Array, "h w"]:
    """Seamless noise of zero mean and unit deviation with the power spectrum 1/f^beta.

    ``stretch`` > 1 draws the pattern out along the columns (down the image).
    """
    fy = np.float32(stretch) * np.fft.fftfreq(shape[0]).astype(np.float32)[:, None]
    f2 = fy**2 + np.fft.rfftfreq(shape[1]).astype(np.float32) ** 2
    f2[0, 0] = np.inf
    white = rng.standard_normal(shape, np.float32)
    field = scipy.fft.irfft2(scipy.fft.rfft2(white) * f2 ** np.float32(-beta / 4), s=shape)
    return np.asarray(field / field.std(), np.float32)


def to_texture(srgb: Float[Array, "h w 3"]) -> UInt8[Array, "h w 3"]:
    """8-bit texture of sRGB code values in 0..1."""
    return np.asarray(cv2.convertScaleAbs(np.maximum(srgb, 0), alpha=255.0))


@dataclass(frozen=True, eq=False)
class Board:
    """A drawing board in metres on part of an image (h, w, 3) of sRGB values in 0..1, drawn on in place.

    A point (a, b) [m] lands at column ``origin[0] + scale[0] a`` and row ``origin[1] + scale[1] b``.
    """

    image: Float[Array, "h w 3"]
    origin: tuple[float, float]
    scale: tuple[float, float]

    _SHIFT = 6

    def pixels(self, points: ArrayLike) -> Array:
        """Pixel coordinates (n, 2) of points (n, 2) [m]."""
        return np.asarray(points, float) * self.scale + self.origin

    def _fixed(self, points: ArrayLike) -> Array:
        return np.asarray(np.round((self.pixels(points) - 0.5) * 2**self._SHIFT), np.int32)

    def poly(self, points: ArrayLike, color: Color, opacity: float = 1.0) -> None:
        """Filled polygon (n, 2) [m] with smooth edges."""
        px = self.pixels(points)
        lo = np.maximum(np.floor(px.min(axis=0)).astype(int) - 2, 0)
        hi = np.minimum(np.ceil(px.max(axis=0)).astype(int) + 2, (self.image.shape[1], self.image.shape[0]))
        if np.any(hi <= lo):
            return
        mask = np.zeros((hi[1] - lo[1], hi[0] - lo[0]), np.uint8)
        corners = self._fixed(points) - (lo * 2**self._SHIFT).astype(np.int32)
        cv2.fillPoly(mask, [corners], 255, cv2.LINE_AA, self._SHIFT)
        part = self.image[lo[1] : hi[1], lo[0] : hi[0]]
        part += (np.asarray(color, np.float32) - part) * (mask * np.float32(opacity / 255))[..., None]

    def rect(self, a: float, b: float, da: float, db: float, color: Color, opacity: float = 1.0) -> None:
        """Filled rectangle with the corner (a, b) and the extent (da, db) [m]."""
        self.poly([(a, b), (a + da, b), (a + da, b + db), (a, b + db)], color, opacity)

    def line(self, points: ArrayLike, width: float, color: Color, opacity: float = 1.0) -> None:
        """Polyline (n, 2) of the given width [m], segment by segment."""
        p = np.asarray(points, float)
        for a, b in pairwise(p):
            d = (b - a) / max(float(np.hypot(*(b - a))), 1e-9) * width / 2
            n = np.array([-d[1], d[0]])
            self.poly([a - d / 2 + n, b + d / 2 + n, b + d / 2 - n, a - d / 2 - n], color, opacity)

    def disc(self, center: tuple[float, float], radius: float, color: Color, opacity: float = 1.0) -> None:
        t = np.linspace(0, 2 * np.pi, 33)[:-1]
        self.poly(np.stack([center[0] + radius * np.cos(t), center[1] + radius * np.sin(t)], axis=1), color, opacity)

    def text(self, a: float, b: float, height: float, width: float, text: str, color: Color) -> None:
        """One line of text in a box whose top-left image corner is (a, b) [m]; it reads left to right on the image."""
        (w, h), base = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 2.0, 6)
        glyphs = np.zeros((h + base, w + 8), np.uint8)
        cv2.putText(glyphs, text, (4, h), cv2.FONT_HERSHEY_SIMPLEX, 2.0, 255, 6, cv2.LINE_AA)
        glyphs = glyphs[: h + 2]
        x0, y0 = np.round(self.pixels([(a, b)])[0]).astype(int)
        size = max(int(abs(width * self.scale[0])), 4), max(int(abs(height * self.scale[1])), 4)
        mask = cv2.resize(glyphs, size, interpolation=cv2.INTER_AREA).astype(np.float32)[..., None] / 255
        part = self.image[y0 : y0 + size[1], x0 : x0 + size[0]]
        part += (np.asarray(color, np.float32) - part) * mask[: part.shape[0], : part.shape[1]]


def grass(rng: np.random.Generator, size: int = 1024) -> UInt8[Array, "h w 3"]:
    """Verge: blades (beta 0.8), tufts (beta 2.4), some dry patches; seamless."""
    blades, tufts, dry = (noise((size, size), b, rng) for b in (0.8, 2.4, 2.0))
    light = np.clip(0.36 + 0.075 * blades + 0.05 * tufts, 0.04, 0.9)
    mix = np.clip(0.35 + 0.25 * dry, 0, 1)[..., None]
    tint = np.array([0.82, 1.0, 0.55]) * (1 - mix) + np.array([1.08, 1.0, 0.70]) * mix
    return to_texture(light[..., None] * tint)


def asphalt(shape: tuple[int, int], rng: np.random.Generator) -> Float[Array, "h w 3"]:
    """Bare asphalt, sRGB in 0..1: grain (beta 0.35), gravel (0.8), wear (2.2), single stones; seamless."""
    grain, stones, wear = noise(shape, 0.35, rng), noise(shape, 0.8, rng), noise(shape, 2.2, rng, stretch=0.5)
    light = 0.40 + 0.11 * grain + 0.05 * stones + 0.010 * wear
    light += 0.05 * np.clip(np.abs(grain) - 2.2, 0, 2) * np.sign(grain)
    return np.asarray(light[..., None] * np.array([1.0, 0.99, 0.97], np.float32), np.float32)


def crack(board: Board, start: tuple[float, float], end: tuple[float, float], rng: np.random.Generator) -> None:
    """A wandering crack between two points [m], sometimes sealed with bitumen."""
    n = max(int(np.hypot(end[0] - start[0], end[1] - start[1]) / 0.15), 3)
    p = np.linspace(start, end, n)
    p[1:-1] += np.cumsum(rng.normal(0, 0.035, (n - 2, 2)), axis=0) * np.linspace(1, 0, n - 2)[:, None]
    sealed = rng.random() < 0.3
    board.line(p, 0.06 if sealed else rng.uniform(0.008, 0.02), (0.16, 0.16, 0.17), 0.8)


def slabs(rng: np.random.Generator, size: int = 512, rows: int = 8) -> UInt8[Array, "h w 3"]:
    """Paving slabs in running bond with dark joints; seamless."""
    light = 0.56 + 0.02 * noise((size, size), 0.6, rng) + 0.02 * noise((size, size), 2.0, rng)
    step = size // rows
    tone = rng.normal(0, 0.03, (rows, rows))
    for i in range(rows):
        shift = (i % 2) * step // 2
        for j in range(rows):
            columns = (np.arange(j * step, (j + 1) * step) + shift) % size
            light[i * step : (i + 1) * step, columns] += tone[i, j]
            light[i * step : (i + 1) * step, columns[:2]] = 0.33
        light[i * step : i * step + 2] = 0.33
    return to_texture(light[..., None] * np.array([1.0, 0.97, 0.93]))


def leaves(rng: np.random.Generator, size: int = 256) -> UInt8[Array, "h w 3"]:
    """Foliage: many small overlapping leaves over dark gaps; seamless."""
    image = np.full((size, size, 3), (0.10, 0.13, 0.06), np.float32)
    for k in range(900):
        center, angle = rng.uniform(0, size, 2), rng.uniform(0, np.pi)
        a, b = rng.uniform(6, 11), rng.uniform(3, 5)
        shade = 0.25 + 0.75 * k / 900 * rng.uniform(0.6, 1.1)
        color = tuple(shade * np.array([0.42, 0.52, 0.20]) * rng.uniform(0.85, 1.15, 3))
        t = np.linspace(0, 2 * np.pi, 9)[:-1]
        leaf = np.stack([a * np.cos(t), b * np.sin(t)], axis=1)
        leaf = leaf @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) + center
        for shift in ((0, 0), (size, 0), (0, size), (-size, 0), (0, -size)):
            Board(image, (0, 0), (1, 1)).poly(leaf + shift, color)
    return to_texture(image)


def asphalt_texture(rng: np.random.Generator, size: int = 2048, span_m: float = 12.0) -> UInt8[Array, "h w 3"]:
    """Old road surface: asphalt with cracks, sealed joints, patches and oil stains; seamless over ``span_m``."""
    image = asphalt((size, size), rng)
    board = Board(image, (0, 0), (size / span_m, size / span_m))
    for _ in range(3):
        a, b, w, h = *rng.uniform(0.1, 0.6, 2) * span_m, *rng.uniform(0.06, 0.2, 2) * span_m
        gray = float(rng.choice([0.30, 0.47]))
        board.rect(a, b, w, h, (gray, gray, gray), 0.35)
        board.line([(a, b), (a + w, b), (a + w, b + h), (a, b + h), (a, b)], 0.03, (0.17, 0.17, 0.18), 0.7)
    for _ in range(9):
        a, b = rng.uniform(0.1, 0.9, 2) * span_m
        angle, length = rng.uniform(0, 2 * np.pi), rng.uniform(0.6, 4.0)
        end = np.clip([a + length * np.cos(angle), b + length * np.sin(angle)], 0.3, span_m - 0.3)
        crack(board, (a, b), (float(end[0]), float(end[1])), rng)
    for _ in range(12):
        board.disc(
            tuple(rng.uniform(0.3, span_m - 0.3, 2)), rng.uniform(0.03, 0.18), (0.2, 0.2, 0.2), rng.uniform(0.1, 0.4)
        )
    return to_texture(image)


def paint_texture(rng: np.random.Generator, size: int = 512) -> UInt8[Array, "h w 3"]:
    """Road marking paint, worn down to the asphalt in places; seamless."""
    fine, coarse = noise((size, size), 0.6, rng), noise((size, size), 1.8, rng)
    light = 0.80 + 0.03 * fine + 0.03 * coarse
    worn = np.clip((coarse + 0.5 * fine - 1.7) * 2, 0, 1)
    light = light * (1 - 0.5 * worn)
    return to_texture(light[..., None] * np.array([1.0, 1.0, 0.97]))
