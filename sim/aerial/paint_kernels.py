"""Compiled loops that colour the ground (what covers it, road surface, paint, noise of many scales) and warm it."""

from __future__ import annotations

from typing import no_type_check

import numba
import numpy as np

from sim.camera_kernels import compiled, threaded

Array = np.ndarray
# Metres per texel of the noise fields: grain as the map's pixels, then these.
MID_M, COARSE_M = 0.45, 5.3
_TRAMLINES_M = 21.0
# Warmth of a tile as 16-bit codes: this many steps per kelvin, from minus this many kelvin.
STEPS_PER_K, ZERO_K = 256, 128


@compiled
@no_type_check
def _noise(field: Array, x: float, y: float) -> float:
    """Seamless field (n, n), n a power of two, linear between texels."""
    n = field.shape[0] - 1
    j, i = int(np.floor(x)), int(np.floor(y))
    a, b = x - j, y - i
    upper = field[i & n, j & n] * (1 - a) + field[i & n, (j + 1) & n] * a
    lower = field[(i + 1) & n, j & n] * (1 - a) + field[(i + 1) & n, (j + 1) & n] * a
    return upper * (1 - b) + lower * b


@threaded
@no_type_check
def colour(
    column: int,
    row: int,
    pixel_m: float,
    cover: Array,
    rows: Array,
    road: Array,
    tone: Array,
    track: Array,
    paint: Array,
    grain: Array,
    mid: Array,
    coarse: Array,
    snow: float,
    worn_paint: float,
    out: Array,
) -> None:
    """Tile (h, w, 3) of sRGB values whose first pixel is (column, row) of the world's map.

    cover: rows of materials; road, paint: coverage 0..255; tone: code value of the asphalt; track: 128 + what wheels
    and oil change; snow: share of the road that it hides where nobody drives; worn_paint: 0 fresh, 1 some years old.
    """
    n = grain.shape[0] - 1
    rgb = (np.float32(1.0), np.float32(0.985), np.float32(0.955))
    for i in numba.prange(out.shape[0]):
        for j in range(out.shape[1]):
            x, y = (column + j + 0.5) * pixel_m, (row + i + 0.5) * pixel_m
            fine = grain[(row + i) & n, (column + j) & n]
            middle = _noise(mid, x / MID_M, y / MID_M)
            wide = _noise(coarse, x / COARSE_M, y / COARSE_M)
            other = _noise(coarse, 0.61 * y / COARSE_M + 91.3, 0.61 * x / COARSE_M + 17.7)
            m = rows[cover[i, j]]
            light = 1 + m[3] * fine + m[4] * middle + m[5] * wide
            if m[7] > 0:
                phase = (x * m[9] - y * m[8]) / m[10] + 0.12 * middle
                light += m[7] * max(1 - 2.5 * pixel_m / m[10], 0.0) * np.sin(6.2831853 * phase)
                # Tramlines: two wheel tracks every so many rows.
                lane = (phase * m[10]) % _TRAMLINES_M
                if lane < 0.45 or 1.8 < lane < 2.25:
                    light -= 1.2 * m[7]
            r = m[0] * light * (1 + m[6] * other)
            g = m[1] * light
            b = m[2] * light * (1 - m[6] * other)
            if m[11] > 0:
                bare = min(max((other + 0.7 * middle + 0.3 * fine - 2.4 + 3.0 * m[11]) * 1.2, 0.0), 1.0) * 0.65
                soil = 0.46 + 0.03 * fine
                r, g, b = r + bare * (soil - r), g + bare * (0.88 * soil - g), b + bare * (0.72 * soil - b)
            white = paint[i, j] / 255.0 * min(max(1.15 - 0.25 * worn_paint * (middle + 0.6 * fine), 0.35), 1.0)
            if white > 0 and snow == 0:
                r, g, b = r + white * (0.80 - r), g + white * (0.80 - g), b + white * (0.80 - b)
            share = road[i, j] / 255.0
            if share > 0:
                worn = (track[i, j] - 128.0) / 255.0
                grey = tone[i, j] / 255.0 * (1 + 0.034 * fine + 0.030 * middle + 0.035 * wide) + worn * 0.25
                for k in range(3):
                    surface = grey * rgb[k]
                    surface += white * (0.84 + 0.02 * fine - surface)
                    if snow > 0:
                        drift = min(max(snow * (1.0 - 8.0 * max(worn, 0.0)) + 0.15 * middle, 0.0), 1.0)
                        surface += drift * (0.80 + 0.02 * fine - surface)
                    if k == 0:
                        r += share * (surface - r)
                    elif k == 1:
                        g += share * (surface - g)
                    else:
                        b += share * (surface - b)
            out[i, j, 0] = np.uint8(min(max(r, 0.0), 1.0) * 255 + 0.5)
            out[i, j, 1] = np.uint8(min(max(g, 0.0), 1.0) * 255 + 0.5)
            out[i, j, 2] = np.uint8(min(max(b, 0.0), 1.0) * 255 + 0.5)


@threaded
@no_type_check
def warm(
    column: int,
    row: int,
    pixel_m: float,
    colours: Array,
    decode: Array,
    cover: Array,
    surfaces: Array,
    road: Array,
    track: Array,
    mid: Array,
    coarse: Array,
    snow: float,
    out: Array,
) -> None:
    """Warmth (h, w, 3) of a tile that `colour` painted: shade_K, what 1 kW/m2 of light adds [K], reflectivity.

    surfaces: rows of `surfaces.Surface` for every cover, then the road's, then snow's. Values are codes.
    """
    asphalt, white = surfaces[-2], surfaces[-1]
    for i in numba.prange(out.shape[0]):
        for j in range(out.shape[1]):
            x, y = (column + j + 0.5) * pixel_m, (row + i + 0.5) * pixel_m
            middle = _noise(mid, x / MID_M, y / MID_M)
            wide = _noise(coarse, x / COARSE_M, y / COARSE_M)
            m = surfaces[cover[i, j]]
            share = road[i, j] / 255.0
            drift = 0.0
            if snow > 0:
                worn = max((track[i, j] - 128.0) / 255.0, 0.0)
                drift = min(max(snow * (1.0 - 8.0 * worn) + 0.15 * middle, 0.0), 1.0)
            vary = 1 + (1 - 0.85 * share) * (0.13 * middle + 0.16 * wide)
            rgb = colours[i, j]
            absorbed = 1 - (0.3 * decode[rgb[0]] + 0.6 * decode[rgb[1]] + 0.1 * decode[rgb[2]])
            for k in range(3):
                value = m[k] + share * (asphalt[k] + drift * (white[k] - asphalt[k]) - m[k])
                if k == 1:
                    value *= absorbed * vary
                elif k == 2:
                    value = 1 - value
                out[i, j, k] = np.uint16((value + ZERO_K) * STEPS_PER_K + 0.5)
