"""The points that are tracked at a time, each with the patch of grey values it is known by."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from estimators.stereo.features import registration

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Live:
    """n live tracks, one row each.

    track (n,) identifiers; uv (n, 2) place in the left image; step (n, 2) its last change, NaN where there is none;
    match (n, 2) right minus left place, NaN where not known; A (n, 2, 2) warp from the template to the image; patch
    (n, s + 2, s + 2) template, weight (n, s, s) its grey values' weights; cov (n, 2, 2) [px²] of uv in time, zero in
    the template's own frame; anchored (n, 2, 2) [px²] sum of those before the template was renewed; missed (n,) frames
    in a row without a right point.
    """

    track: Int[Array, "n"]
    uv: Float[Array, "n 2"]
    step: Float[Array, "n 2"]
    match: Float[Array, "n 2"]
    A: Float[Array, "n 2 2"]
    patch: Float[Array, "n p p"]
    weight: Float[Array, "n s s"]
    cov: Float[Array, "n 2 2"]
    anchored: Float[Array, "n 2 2"]
    missed: Int[Array, "n"]

    def __len__(self) -> int:
        return len(self.track)

    def select(self, rows: Any) -> Live:
        return Live(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def joined(self, other: Live) -> Live:
        return Live(**{f.name: np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)})

    @staticmethod
    def none(patch_px: int) -> Live:
        return Live.born(np.zeros((8, 8), np.uint8), np.empty((0, 0), bool), np.empty((0, 2)), 0, patch_px)

    @staticmethod
    def born(
        image: UInt8[Array, "h w"], mask: Bool[Array, "a b"], uv: Float[Array, "n 2"], first: int, px: int
    ) -> Live:
        """New tracks at places uv, numbered from ``first``."""
        n = len(uv)
        eye, zero = np.tile(np.eye(2), (n, 1, 1)), np.zeros((n, 2, 2))
        patch, weight, good = cut(image, mask, uv, eye, px)
        track, missed = np.arange(first, first + n), np.zeros(n, int)
        unknown = np.full((n, 2), np.nan)
        return Live(track, uv.copy(), unknown, unknown.copy(), eye, patch, weight, zero, zero.copy(), missed).select(
            good
        )

    def renewed(self, image: UInt8[Array, "h w"], mask: Bool[Array, "a b"], rows: Bool[Array, "n"]) -> Live:
        """The templates of some tracks taken anew where they are now; their error so far stays with them."""
        if not rows.any():
            return self
        eye = np.tile(np.eye(2), (int(rows.sum()), 1, 1))
        patch, weight, good = cut(image, mask, self.uv[rows], eye, self.weight.shape[1])
        done = np.flatnonzero(rows)[good]
        changed = {name: getattr(self, name).copy() for name in ("patch", "weight", "A", "cov", "anchored")}
        changed["patch"][done], changed["weight"][done], changed["A"][done] = patch[good], weight[good], eye[good]
        changed["anchored"][done] += self.cov[done]
        changed["cov"][done] = 0
        return replace(self, **changed)


def cut(
    image: UInt8[Array, "h w"], mask: Bool[Array, "a b"], uv: Float[Array, "n 2"], A: Float[Array, "n 2 2"], px: int
) -> tuple[Float[Array, "n p p"], Float[Array, "n s s"], Bool[Array, "n"]]:
    """Patches of px grey values a side and a margin of one, their weights, and which lie in the image."""
    patch, weight = np.zeros((len(uv), px + 2, px + 2)), np.zeros((len(uv), px, px))
    good = registration.cut(image, np.ascontiguousarray(uv), np.ascontiguousarray(A), mask, patch, weight)
    return patch, weight, good


@dataclass(frozen=True, eq=False)
class Registered:
    """Places t (n, 2), warps A (n, 2, 2), correlation (n,), covariance [px²] of t (n, 2, 2), whether found."""

    t: Float[Array, "n 2"]
    A: Float[Array, "n 2 2"]
    ncc: Float[Array, "n"]
    cov: Float[Array, "n 2 2"]
    good: Bool[Array, "n"]


def register(
    image: UInt8[Array, "h w"],
    patch: Float[Array, "n p p"],
    weight: Float[Array, "n s s"],
    t: Float[Array, "n 2"],
    A: Float[Array, "n 2 2"],
    free: Int[Array, "q"],
    spread: float = np.inf,
    iterations: int = 20,
) -> Registered:
    """Finds patches in an image, beginning at t and A; see `registration`."""
    n = len(t)
    t, A = np.array(t, float), np.array(A, float)
    ncc, sigma, cov, state = np.zeros(n), np.zeros(n), np.zeros((n, 2, 2)), np.zeros(n, int)
    registration.register(image, patch, weight, free, spread, iterations, t, A, ncc, sigma, cov, state)
    return Registered(t, A, ncc, cov, state == registration.GOOD)
