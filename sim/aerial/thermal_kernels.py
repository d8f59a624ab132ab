"""The compiled loop of the thermal band: how warm every pixel seems, from the same ground, models and shadows."""

from __future__ import annotations

from typing import no_type_check

import numba
import numpy as np

from sim.aerial.shade_kernels import BIAS_M, GROUND_BIAS_M, TILE, between, nearest_of, texel, tile_texel, weights
from sim.aerial.shadow_kernels import lit
from sim.camera_kernels import threaded

Array = np.ndarray


@threaded
@no_type_check
def warm(
    centre: Array,
    ground: Array,
    rays: Array,
    pool: Array,
    slots: Array,
    grid: Array,
    triangles: Array,
    start: Array,
    entries: Array,
    vertex: Array,
    paint: Array,
    engine: Array,
    texels: Array,
    warmth: Array,
    textures: Array,
    frame: Array,
    shadow: Array,
    weather: Array,
    decode: Array,
    samples: int,
    image: Array,
) -> None:
    """The image (h, w) of apparent temperatures above the air's [K].

    As `shade_kernels.shade`, but: pool, tiles of codes of `paint_kernels.warm`, which ``decode`` turns to numbers;
    warmth, texels (shade_K, gain_K, reflectivity, share of the engine's warmth); engine (n, 4), its warmth [K], 0, 0
    and the share of the sun's warmth that the wind leaves. weather (4,): direct and diffuse light [kW/m2], the sky's
    apparent temperature above the air's [K], extinction [1/m].

    A surface of the temperature T and the reflectivity r seems (1 - r) T + r T_sky, and the air before it has its own.
    """
    height, width = image.shape
    columns = (width + TILE - 1) // TILE
    for tile in numba.prange(len(start) - 1):
        row, column = (tile // columns) * TILE, (tile % columns) * TILE
        rows_px, columns_px = min(TILE, height - row), min(TILE, width - column)
        nearest = np.empty((rows_px * samples, columns_px * samples), np.float32)
        owner = np.empty((rows_px * samples, columns_px * samples), np.int32)
        nearest_of(tile, columns, ground, triangles, start, entries, vertex, samples, nearest, owner)
        g, d, w = np.empty(7), np.empty(3), np.empty(3)
        rgb, warm = np.empty(3, np.float32), np.empty(3, np.float32)
        for i in range(rows_px):
            for j in range(columns_px):
                total = 0.0
                for a in range(samples):
                    for b in range(samples):
                        t = owner[i * samples + a, j * samples + b]
                        if t == -2:
                            total += weather[2]
                            continue
                        u = column + j + (b + 0.5) / samples - 0.5
                        v = row + i + (a + 0.5) / samples - 0.5
                        if t == -1:
                            between(ground, u, v, g)
                            tile_texel(pool, slots, grid, decode, g[0], g[1], warm)
                            sun, sky, depth = g[6], 1.0, 1 / g[3]
                            sun *= lit(frame, shadow, g[4], g[5], g[2] + GROUND_BIAS_M)
                        else:
                            triangle = triangles[t]
                            weights(vertex, triangle, u, v, w)
                            p, q, r = vertex[triangle[0]], vertex[triangle[1]], vertex[triangle[2]]
                            s = w[0] * p[3] + w[1] * q[3] + w[2] * r[3]
                            o = w[0] * p[4] + w[1] * q[4] + w[2] * r[4]
                            texel(texels, textures[triangle[3]], s, o, paint[triangle[4]], rgb)
                            texel(warmth, textures[triangle[3]], s, o, engine[triangle[4]], warm)
                            sun = w[0] * p[5] + w[1] * q[5] + w[2] * r[5]
                            sky = w[0] * p[6] + w[1] * q[6] + w[2] * r[6]
                            depth = 1 / nearest[i * samples + a, j * samples + b]
                            between(rays, u, v, d)
                            z = centre[2] + depth * d[2]
                            x = centre[0] + depth * d[0] - (z - frame[3]) * frame[4]
                            y = centre[1] + depth * d[1] - (z - frame[3]) * frame[5]
                            if sun > 0:
                                sun *= lit(frame, shadow, x, y, z + BIAS_M)
                            albedo = 0.3 * rgb[0] + 0.6 * rgb[1] + 0.1 * rgb[2]
                            warm[1] *= max(1 - albedo, 0.0) * engine[triangle[4], 3]
                        kelvin = warm[0] + warm[1] * (sun * weather[0] + sky * weather[1])
                        kelvin = (1 - warm[2]) * kelvin + warm[2] * sky * weather[2]
                        total += np.exp(-weather[3] * depth) * kelvin
                image[row + i, column + j] = total / (samples * samples)
