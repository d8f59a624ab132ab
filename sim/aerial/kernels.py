"""Compiled inner loops of the aerial renderer: vertices to pixels, bins, shadow map, visibility and shading.

A view is what `sim.camera_kernels` makes of a camera at a pose; only points behind the camera have no pixel.

A vertex is a row of `VERTEX` numbers: u, v, 1/depth, texture s, t, share of sunlight, of skylight, mirrored light.
Everything between vertices is linear in 1/depth; models are cut so finely that a lens does not bend their edges.
"""

from __future__ import annotations

from typing import Any, no_type_check

import numba
import numpy as np

from sim.camera_kernels import compiled, pixel_of, threaded

Array = np.ndarray
VERTEX = 8


@threaded
@no_type_check
def place_vertices(
    view: Array,
    sun: Array,
    model: Array,
    place: Array,
    first: Array,
    model_first: Array,
    vertices: Array,
    normals: Array,
    look: Array,
    out: Array,
) -> None:
    """Vertices of instances (n,) as rows of `VERTEX` numbers; place (n, 12): R by rows times scale, then t.

    look (vertices, 4): texture s, t, openness to light, gloss. The mirrored light is a bright sky and the sun's lobe.
    """
    for k in numba.prange(len(model)):
        m, P = model[k], place[k]
        scale = np.sqrt(P[0] * P[0] + P[3] * P[3] + P[6] * P[6])
        o = first[k]
        for i in range(model_first[m], model_first[m + 1]):
            a, b, c = vertices[i, 0], vertices[i, 1], vertices[i, 2]
            x = P[0] * a + P[1] * b + P[2] * c + P[9]
            y = P[3] * a + P[4] * b + P[5] * c + P[10]
            z = P[6] * a + P[7] * b + P[8] * c + P[11]
            u, v, inverse = pixel_of(view, x, y, z)
            a, b, c = normals[i, 0] / scale, normals[i, 1] / scale, normals[i, 2] / scale
            nx = P[0] * a + P[1] * b + P[2] * c
            ny = P[3] * a + P[4] * b + P[5] * c
            nz = P[6] * a + P[7] * b + P[8] * c
            facing = nx * sun[0] + ny * sun[1] + nz * sun[2]
            mirrored = 0.0
            gloss = look[i, 3]
            if gloss > 0:
                ex, ey, ez = view[9] - x, view[10] - y, view[11] - z
                e = 1 / np.sqrt(ex * ex + ey * ey + ez * ez)
                ne = (nx * ex + ny * ey + nz * ez) * e
                rz = 2 * ne * nz - ez * e
                rs = 2 * ne * facing - (ex * sun[0] + ey * sun[1] + ez * sun[2]) * e
                fresnel = gloss + (1 - gloss) * (1 - min(max(ne, 0.0), 1.0)) ** 5
                mirrored = fresnel * (0.55 - 0.25 * max(rz, 0.0) + 9.0 * max(rs, 0.0) ** 24)
            out[o, 0], out[o, 1], out[o, 2] = u, v, inverse
            out[o, 3], out[o, 4] = look[i, 0], look[i, 1]
            out[o, 5] = max(facing, 0.0) * min(1.0, 0.25 + look[i, 2])
            out[o, 6] = (0.58 + 0.42 * nz) * look[i, 2]
            out[o, 7] = mirrored
            o += 1


@compiled
@no_type_check
def front_faces(
    model: Array,
    first: Array,
    model_first: Array,
    face_first: Array,
    faces: Array,
    texture: Array,
    out: Array,
    width: int,
    height: int,
) -> Any:
    """Triangles (k, 5) that face the camera inside the image: three rows of ``out``, texture, instance."""
    total = 0
    for m in model:
        total += face_first[m + 1] - face_first[m]
    found = np.empty((total, 5), np.int32)
    n = 0
    for k in range(len(model)):
        m = model[k]
        shift = first[k] - model_first[m]
        for f in range(face_first[m], face_first[m + 1]):
            a, b, c = faces[f, 0] + shift, faces[f, 1] + shift, faces[f, 2] + shift
            ua, va, ub, vb, uc, vc = out[a, 0], out[a, 1], out[b, 0], out[b, 1], out[c, 0], out[c, 1]
            if not (ub - ua) * (vc - va) - (uc - ua) * (vb - va) < 0:
                continue
            if max(ua, ub, uc) < -0.5 or min(ua, ub, uc) > width - 0.5:
                continue
            if max(va, vb, vc) < -0.5 or min(va, vb, vc) > height - 0.5:
                continue
            found[n, 0], found[n, 1], found[n, 2], found[n, 3], found[n, 4] = a, b, c, texture[f], k
            n += 1
    return found[:n]


@compiled
@no_type_check
def bins(triangles: Array, vertex: Array, tile: int, columns: int, rows: int) -> Any:
    """Which triangles touch which tile: start (tiles + 1,) and list."""
    start = np.zeros(columns * rows + 1, np.int64)
    box = np.empty((len(triangles), 4), np.int32)
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        u0 = min(vertex[a, 0], vertex[b, 0], vertex[c, 0])
        u1 = max(vertex[a, 0], vertex[b, 0], vertex[c, 0])
        v0 = min(vertex[a, 1], vertex[b, 1], vertex[c, 1])
        v1 = max(vertex[a, 1], vertex[b, 1], vertex[c, 1])
        box[t, 0] = max(int(np.floor((u0 + 0.5) / tile)), 0)
        box[t, 1] = min(int(np.floor((u1 + 0.5) / tile)), columns - 1)
        box[t, 2] = max(int(np.floor((v0 + 0.5) / tile)), 0)
        box[t, 3] = min(int(np.floor((v1 + 0.5) / tile)), rows - 1)
        for i in range(box[t, 2], box[t, 3] + 1):
            for j in range(box[t, 0], box[t, 1] + 1):
                start[i * columns + j + 1] += 1
    start = np.cumsum(start)
    fill = start[:-1].copy()
    entries = np.empty(start[-1], np.int32)
    for t in range(len(triangles)):
        for i in range(box[t, 2], box[t, 3] + 1):
            for j in range(box[t, 0], box[t, 1] + 1):
                k = i * columns + j
                entries[fill[k]] = t
                fill[k] += 1
    return start, entries


@compiled
@no_type_check
def draw(
    triangles: Array, entries: Array, vertex: Array, u0: float, v0: float, step: float, nearest: Array, owner: Array
) -> None:
    """Visibility of a tile: sample (i, j) lies at (u0 + j step, v0 + i step); the greatest 1/depth wins."""
    rows, columns = nearest.shape
    for t in entries:
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ua, va = (vertex[a, 0] - u0) / step, (vertex[a, 1] - v0) / step
        ub, vb = (vertex[b, 0] - u0) / step, (vertex[b, 1] - v0) / step
        uc, vc = (vertex[c, 0] - u0) / step, (vertex[c, 1] - v0) / step
        j0, j1 = max(int(np.ceil(min(ua, ub, uc))), 0), min(int(np.floor(max(ua, ub, uc))), columns - 1)
        i0, i1 = max(int(np.ceil(min(va, vb, vc))), 0), min(int(np.floor(max(va, vb, vc))), rows - 1)
        if j1 < j0 or i1 < i0:
            continue
        area = (ub - ua) * (vc - va) - (uc - ua) * (vb - va)
        za, zb, zc = vertex[a, 2], vertex[b, 2], vertex[c, 2]
        # Weights of b and c, linear over the image.
        bu, bv = (vc - va) / area, -(uc - ua) / area
        cu, cv = -(vb - va) / area, (ub - ua) / area
        for i in range(i0, i1 + 1):
            wb = bu * (j0 - ua) + bv * (i - va)
            wc = cu * (j0 - ua) + cv * (i - va)
            for j in range(j0, j1 + 1):
                if wb >= 0 and wc >= 0 and wb + wc <= 1:
                    z = za + wb * (zb - za) + wc * (zc - za)
                    if z > nearest[i, j]:
                        nearest[i, j] = z
                        owner[i, j] = t
                wb += bu
                wc += cu
