"""Compiled loops that draw an image tile by tile: ground and models, sun, sky, shadow, haze, code values; and truth."""

from __future__ import annotations

from typing import no_type_check

import numba
import numpy as np

from sim.aerial.kernels import draw
from sim.aerial.shadow_kernels import lit
from sim.camera_kernels import compiled, threaded

Array = np.ndarray
STEP = 8
"""Pixels between the nodes of ground and rays; linear between."""
TILE = 64
# Depth of shadow-map texels on slanted faces [m].
BIAS_M = 0.35
GROUND_BIAS_M = 0.05


@compiled
@no_type_check
def between(nodes: Array, u: float, v: float, out: Array) -> None:
    """Nodes (rows, columns, k), the first at pixel (-STEP, -STEP), linear at a pixel."""
    x, y = u / STEP + 1, v / STEP + 1
    j, i = int(x), int(y)
    a, b = x - j, y - i
    for k in range(len(out)):
        upper = nodes[i, j, k] + a * (nodes[i, j + 1, k] - nodes[i, j, k])
        lower = nodes[i + 1, j, k] + a * (nodes[i + 1, j + 1, k] - nodes[i + 1, j, k])
        out[k] = upper + b * (lower - upper)


@compiled
@no_type_check
def _inverse_depth(ground: Array, u: float, v: float) -> float:
    """1/depth of the ground at a pixel, as `between`."""
    x, y = u / STEP + 1, v / STEP + 1
    j, i = int(x), int(y)
    a, b = x - j, y - i
    upper = ground[i, j, 3] + a * (ground[i, j + 1, 3] - ground[i, j, 3])
    lower = ground[i + 1, j, 3] + a * (ground[i + 1, j + 1, 3] - ground[i + 1, j, 3])
    return upper + b * (lower - upper)


@compiled
@no_type_check
def tile_texel(pool: Array, slots: Array, grid: Array, decode: Array, x: float, y: float, rgb: Array) -> None:
    """Albedo of the painted ground; grid: x, y of the tiles' corner, pixel [m], pixels per tile, border."""
    n, border = int(grid[3]), int(grid[4])
    gx, gy = (x - grid[0]) / grid[2] - 0.5, (y - grid[1]) / grid[2] - 0.5
    j, i = int(np.floor(gx)), int(np.floor(gy))
    a, b = np.float32(gx - j), np.float32(gy - i)
    column, row = j // n, i // n
    if row < 0 or column < 0 or row >= slots.shape[0] or column >= slots.shape[1] or slots[row, column] < 0:
        rgb[0], rgb[1], rgb[2] = 0.06, 0.07, 0.04
        return
    tile = pool[slots[row, column]]
    i += border - row * n
    j += border - column * n
    for k in range(3):
        upper = decode[tile[i, j, k]] * (1 - a) + decode[tile[i, j + 1, k]] * a
        lower = decode[tile[i + 1, j, k]] * (1 - a) + decode[tile[i + 1, j + 1, k]] * a
        rgb[k] = upper * (1 - b) + lower * b


@compiled
@no_type_check
def texel(texels: Array, place: Array, s: float, t: float, paint: Array, rgb: Array) -> None:
    """Albedo of a texture (first texel, rows, columns, repeat) at (s, t): its colour and its share of the paint."""
    first, rows, columns = place[0], place[1], place[2]
    x, y = s * columns - 0.5, t * rows - 0.5
    j, i = int(np.floor(x)), int(np.floor(y))
    a, b = np.float32(x - j), np.float32(y - i)
    if place[3]:
        j0, j1, i0, i1 = j % columns, (j + 1) % columns, i % rows, (i + 1) % rows
    else:
        j0, j1 = min(max(j, 0), columns - 1), min(max(j + 1, 0), columns - 1)
        i0, i1 = min(max(i, 0), rows - 1), min(max(i + 1, 0), rows - 1)
    p, q = texels[first + i0 * columns + j0], texels[first + i0 * columns + j1]
    r, o = texels[first + i1 * columns + j0], texels[first + i1 * columns + j1]
    wp, wq, wr, wo = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
    share = wp * p[3] + wq * q[3] + wr * r[3] + wo * o[3]
    for k in range(3):
        rgb[k] = wp * p[k] + wq * q[k] + wr * r[k] + wo * o[k] + share * paint[k]


@compiled
@no_type_check
def weights(vertex: Array, triangle: Array, u: float, v: float, w: Array) -> None:
    """Barycentric coordinates in space of an image point inside a triangle."""
    a, b, c = vertex[triangle[0]], vertex[triangle[1]], vertex[triangle[2]]
    area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
    wb = ((u - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (v - a[1])) / area
    wc = ((b[0] - a[0]) * (v - a[1]) - (u - a[0]) * (b[1] - a[1])) / area
    w[0], w[1], w[2] = (1 - wb - wc) * a[2], wb * b[2], wc * c[2]
    total = w[0] + w[1] + w[2]
    for k in range(3):
        w[k] /= total


@compiled
@no_type_check
def nearest_of(
    tile: int,
    columns: int,
    ground: Array,
    triangles: Array,
    start: Array,
    entries: Array,
    vertex: Array,
    samples: int,
    nearest: Array,
    owner: Array,
) -> None:
    """Nearest surface of every sample of a tile; owner -1 is the ground, -2 nothing."""
    u0, v0 = (tile % columns) * TILE, (tile // columns) * TILE
    offset, step = (1 / samples - 1) / 2, 1 / samples
    for i in range(nearest.shape[0]):
        for j in range(nearest.shape[1]):
            inverse = _inverse_depth(ground, u0 + offset + j * step, v0 + offset + i * step)
            seen = inverse > 0
            nearest[i, j] = inverse if seen else 0.0
            owner[i, j] = -1 if seen else -2
    draw(triangles, entries[start[tile] : start[tile + 1]], vertex, u0 + offset, v0 + offset, step, nearest, owner)


@threaded
@no_type_check
def shade(
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
    texels: Array,
    textures: Array,
    frame: Array,
    shadow: Array,
    light: Array,
    decode: Array,
    encode: Array,
    samples: int,
    image: Array,
) -> None:
    """The image (h, w, 3) as 8-bit code values.

    ground (rows, columns, 7): x, y, z, 1/depth, sheared x, y, share of sunlight at every node. light (15,): sun,
    sky and air light (each RGB), extinction [1/m], then gains RGB; ``encode`` turns light in 0..1 to code values.
    """
    height, width, _ = image.shape
    columns = (width + TILE - 1) // TILE
    levels = len(encode) - 1
    for tile in numba.prange(len(start) - 1):
        row, column = (tile // columns) * TILE, (tile % columns) * TILE
        rows_px, columns_px = min(TILE, height - row), min(TILE, width - column)
        nearest = np.empty((rows_px * samples, columns_px * samples), np.float32)
        owner = np.empty((rows_px * samples, columns_px * samples), np.int32)
        nearest_of(tile, columns, ground, triangles, start, entries, vertex, samples, nearest, owner)
        g, d, rgb, w = np.empty(7), np.empty(3), np.empty(3, np.float32), np.empty(3)
        total = np.empty(3)
        for i in range(rows_px):
            for j in range(columns_px):
                total[:] = 0
                for a in range(samples):
                    for b in range(samples):
                        t = owner[i * samples + a, j * samples + b]
                        u = column + j + (b + 0.5) / samples - 0.5
                        v = row + i + (a + 0.5) / samples - 0.5
                        mirrored, depth = 0.0, 0.0
                        if t == -1:
                            between(ground, u, v, g)
                            tile_texel(pool, slots, grid, decode, g[0], g[1], rgb)
                            sun, sky, depth = g[6], 1.0, 1 / g[3]
                            sun *= lit(frame, shadow, g[4], g[5], g[2] + GROUND_BIAS_M)
                        elif t >= 0:
                            triangle = triangles[t]
                            weights(vertex, triangle, u, v, w)
                            p, q, r = vertex[triangle[0]], vertex[triangle[1]], vertex[triangle[2]]
                            s = w[0] * p[3] + w[1] * q[3] + w[2] * r[3]
                            o = w[0] * p[4] + w[1] * q[4] + w[2] * r[4]
                            texel(texels, textures[triangle[3]], s, o, paint[triangle[4]], rgb)
                            sun = w[0] * p[5] + w[1] * q[5] + w[2] * r[5]
                            sky = w[0] * p[6] + w[1] * q[6] + w[2] * r[6]
                            mirrored = w[0] * p[7] + w[1] * q[7] + w[2] * r[7]
                            depth = 1 / nearest[i * samples + a, j * samples + b]
                            between(rays, u, v, d)
                            z = centre[2] + depth * d[2]
                            x = centre[0] + depth * d[0] - (z - frame[3]) * frame[4]
                            y = centre[1] + depth * d[1] - (z - frame[3]) * frame[5]
                            if sun > 0:
                                sun *= lit(frame, shadow, x, y, z + BIAS_M)
                        clear = np.exp(-light[9] * depth) if t >= -1 else 0.0
                        for k in range(3):
                            shone = 0.0
                            if t >= -1:
                                shone = rgb[k] * (sun * light[k] + sky * light[3 + k]) + mirrored * light[3 + k]
                            total[k] += clear * shone + (1 - clear) * light[6 + k]
                for k in range(3):
                    value = total[k] / (samples * samples) * light[10 + k]
                    image[row + i, column + j, k] = encode[int(min(max(value, 0.0), 1.0) * levels + 0.5)]


@threaded
@no_type_check
def measure(
    ground: Array,
    triangles: Array,
    start: Array,
    entries: Array,
    vertex: Array,
    depth: Array,
    instance: Array,
) -> None:
    """Depth [m] and number of the instance at every pixel's centre; -1 is ground, -2 nothing (depth NaN)."""
    height, width = depth.shape
    columns = (width + TILE - 1) // TILE
    for tile in numba.prange(len(start) - 1):
        row, column = (tile // columns) * TILE, (tile % columns) * TILE
        rows_px, columns_px = min(TILE, height - row), min(TILE, width - column)
        nearest = np.empty((rows_px, columns_px), np.float32)
        owner = np.empty((rows_px, columns_px), np.int32)
        nearest_of(tile, columns, ground, triangles, start, entries, vertex, 1, nearest, owner)
        for i in range(rows_px):
            for j in range(columns_px):
                t = owner[i, j]
                instance[row + i, column + j] = triangles[t, 4] if t >= 0 else t
                depth[row + i, column + j] = 1 / nearest[i, j] if t != -2 else np.nan
