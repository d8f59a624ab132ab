"""Bends a straight street along a driven path, so that a replayed or turning ego car stays on its lane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from sim.model import Model, Surface
from sim.pose import Pose

Array = np.ndarray
Street = Sequence[tuple[str, Model, Pose]]

_STEP_M = 1.0
# The road bends with the path smoothed over so many metres; the country further than NEAR_M aside with less detail.
_SMOOTH_M, _FAR_SMOOTH_M, _NEAR_M = 4.0, 60.0, 30.0
# Nothing lower than this stands closer to a driven path than that.
_LOW_M, _CLEARANCE_M = 3.0, 1.9
_CROWN_M, _EAVES_M = 4.0, 0.6
# Things in the inside of a bend are left out where it squeezes them below this share of their length.
_SQUEEZE = 0.5


@dataclass(frozen=True, eq=False)
class Path:
    """A path by arc length s (n,) [m]: centre (n, 2) [m], heading and far_heading (n,) [rad], curvature (n,) [1/m]."""

    s: Float[Array, "n"]
    centre: Float[Array, "n 2"]
    heading: Float[Array, "n"]
    far_heading: Float[Array, "n"]
    curvature: Float[Array, "n"]

    @staticmethod
    def through(xy: Float[Array, "k 2"], behind_m: float, ahead_m: float) -> Path | None:
        """Smoothed path through the points, straight on beyond its ends; None where they hardly move.

        s = 0 at the first point. The street's ego lane lies on it.
        """
        step = np.linalg.norm(np.diff(xy, axis=0), axis=1)
        moved = np.concatenate([[True], step > 1e-6])
        xy = xy[moved]
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
        if s[-1] < 5.0:
            return None
        grid = np.arange(0.0, s[-1], _STEP_M)
        x, y = (np.interp(grid, s, c) for c in xy.T)
        heading = np.unwrap(np.arctan2(np.gradient(x), np.gradient(y)))
        n_behind, n_ahead = int(behind_m / _STEP_M), int(ahead_m / _STEP_M)
        heading = gaussian_filter1d(np.pad(heading, (n_behind, n_ahead), mode="edge"), _SMOOTH_M / _STEP_M)
        all_s = (np.arange(len(heading)) - n_behind) * _STEP_M
        tangent = _tangent(heading)
        steps = (tangent[1:] + tangent[:-1]) / 2 * _STEP_M
        centre = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        inside = slice(n_behind, n_behind + len(grid))
        # The integrated heading drifts away from the points; the drift, a smooth curve, is given back.
        drift = np.stack([x, y], axis=1) - centre[inside]
        drift = gaussian_filter1d(np.pad(drift, ((n_behind, n_ahead), (0, 0)), mode="edge"), 2 * _SMOOTH_M, axis=0)
        far = gaussian_filter1d(heading, _FAR_SMOOTH_M / _STEP_M, mode="nearest")
        return Path(all_s, centre + drift, heading, far, np.gradient(heading, _STEP_M))

    def place(self, points: Float[Array, "v 3"]) -> tuple[Float[Array, "v 3"], Float[Array, "v"]]:
        """Street coordinates (x aside, y along, z up) in the world, and the heading of the street there."""
        y = np.clip(points[:, 1], self.s[0], self.s[-1])
        heading = np.interp(y, self.s, self.heading)
        far = np.interp(y, self.s, self.far_heading)
        near_x = np.clip(points[:, 0], -_NEAR_M, _NEAR_M)
        beyond = points[:, 1] - y
        centre = np.stack([np.interp(y, self.s, c) for c in self.centre.T], axis=1)
        along, aside, far_aside = _tangent(heading), _tangent(heading + np.pi / 2), _tangent(far + np.pi / 2)
        xy = centre + beyond[:, None] * along + near_x[:, None] * aside + (points[:, :1] - near_x[:, None]) * far_aside
        return np.concatenate([xy, points[:, 2:]], axis=1), heading

    def squeeze(self, points: Float[Array, "v 3"]) -> Float[Array, "v"]:
        """Length along the bent street per length along the straight one."""
        return np.asarray(1 - np.interp(points[:, 1], self.s, self.curvature) * points[:, 0])


def _tangent(heading: Array) -> Array:
    """Unit vector (n, 2) of a heading, clockwise from +y."""
    return np.stack([np.sin(heading), np.cos(heading)], axis=1)


def follow(street: Street, path: Path | None, driven: Float[Array, "k 2"]) -> list[tuple[str, Model, Pose]]:
    """The street bent along the path, without what would stand in a driven path (k, 2) or be squeezed in a bend."""
    bent = [(name, _bent(model, path, driven, is_ground=name == "ground"), pose) for name, model, pose in street]
    return [thing for thing in bent if len(thing[1].solid_faces)]


def _bent(model: Model, path: Path | None, driven: Array, is_ground: bool) -> Model:
    surfaces = tuple(_bent_surface(s, path, driven, is_ground) for s in model.levels[0])
    surfaces = tuple(s for s in surfaces if len(s.faces))
    shift = np.cumsum([0] + [len(s.vertices) for s in surfaces])
    vertices = np.concatenate([s.vertices for s in surfaces]) if surfaces else np.zeros((0, 3))
    faces = [s.faces + k for s, k in zip(surfaces, shift, strict=False)]
    return replace(
        model,
        levels=(surfaces,),
        solid_vertices=vertices,
        solid_faces=np.concatenate(faces) if faces else np.zeros((0, 3), int),
    )


def _bent_surface(surface: Surface, path: Path | None, driven: Array, is_ground: bool) -> Surface:
    vertices, normals = surface.vertices, surface.normals
    kept = np.ones(len(surface.faces), bool)
    if path is not None:
        vertices, heading = path.place(surface.vertices)
        x, y, z = normals.T
        c, s = np.cos(heading), np.sin(heading)
        normals = np.stack([c * x + s * y, c * y - s * x, z], axis=1)
    if not is_ground:
        squeezed = np.zeros(len(vertices), bool) if path is None else path.squeeze(surface.vertices) < _SQUEEZE
        kept = _kept_faces(surface.faces, vertices, squeezed, driven)
    used, faces = np.unique(surface.faces[kept], return_inverse=True)
    uv = None if surface.uv is None else surface.uv[used]
    return replace(
        surface,
        vertices=vertices[used],
        faces=faces.reshape(-1, 3),
        normals=normals[used],
        color=surface.color[used],
        gloss=surface.gloss[used],
        uv=uv,
    )


def _kept_faces(faces: Array, vertices: Array, squeezed: Array, driven: Array) -> Bool[Array, "f"]:
    """Faces of the connected parts that stay; a crown goes with its trunk."""
    n = len(vertices)
    # Vertices are doubled along seams of the texture; equal places belong together.
    _, place = np.unique(np.round(vertices, 4), axis=0, return_inverse=True)
    place = place.ravel()
    pairs = place[faces[:, [0, 1, 1, 2]].reshape(-1, 2)]
    graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    part_of_place = connected_components(graph, directed=False)[1]
    part = part_of_place[place]
    count = part.max() + 1
    near = np.isfinite(cKDTree(driven).query(vertices[:, :2], distance_upper_bound=_CLEARANCE_M)[0])
    lowest = np.full(count, np.inf)
    np.minimum.at(lowest, part, vertices[:, 2])
    bad = np.zeros(count, bool)
    bad[part[squeezed]] = True
    in_the_way = np.zeros(count, bool)
    in_the_way[part[near]] = True
    bad |= in_the_way & (lowest < _LOW_M)
    if bad.any():
        size = np.bincount(part, minlength=count)
        middle = np.stack([np.bincount(part, vertices[:, i], count) / np.maximum(size, 1) for i in (0, 1)], axis=1)
        gone = cKDTree(middle[bad]).query(middle, distance_upper_bound=_CROWN_M)[0]
        bad |= (np.isfinite(gone) | _upon(middle, part, vertices, bad)) & (lowest >= 1.0)
    return np.asarray(~bad[part[faces[:, 0]]])


def _upon(middle: Array, part: Array, vertices: Array, bad: Array) -> Bool[Array, "n"]:
    """Parts whose middle is above one of the bad parts' boxes, as a roof's are above the house's."""
    low, high = np.full((len(middle), 2), np.inf), np.full((len(middle), 2), -np.inf)
    np.minimum.at(low, part, vertices[:, :2])
    np.maximum.at(high, part, vertices[:, :2])
    inside = (middle[:, None] > low[bad] - _EAVES_M) & (middle[:, None] < high[bad] + _EAVES_M)
    return np.asarray(inside.all(axis=2).any(axis=1))
