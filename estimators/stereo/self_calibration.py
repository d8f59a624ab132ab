"""How far a rectified rig's images are off, seen in a recording itself: no poses, no truth.

A camera that moves past a rigid scene sees a point of direction r and disparity D along R r + t D / (f B). A wrong
scale of all disparities is a wrong length of t, but a wrong offset of them makes near and far points contradict each
other: a smooth error of the disparity can be told from the images of a moving camera, and one of the rows from the
stereo pairs alone. Not part of Siegemund 2008; Krešo and Šegvić 2015, "Improving the egomotion estimation by correcting
the calibration bias", find such an error in recordings with the help of true poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from estimators.estimate import EstimationFailed
from sim.archive import freeze_fields
from sim.camera import StereoRig
from sim.observations import Tracks
from sim.pose import exp_so3, hat

Array = np.ndarray
_ENOUGH = 30  # points a pair of frames needs
_FEWEST_PAIRS = 6
_OUTLIER_PX, _SOFT_PX = 1.5, 0.3
_STEPS, _SMALL = 30, 1e-6
_LEAST_PX = 2.0  # a median point moves so far in the image as the camera goes on, its rotation apart
_UNCERTAIN_PX = 0.25
_ROUNDS = 3  # RANSAC keeps what fits the rig as it is taken to be, so it is asked again
_FARTHEST_PX = 0.5  # a smaller disparity may be that of no point at all
TERMS = ("1", "x", "x²", "y", "xy")


@dataclass(frozen=True, eq=False)
class RectificationError:
    """What measured disparities and rows lack, as polynomials of the left direction x, y: coefficients of `TERMS`.

    disparity (5,) is to be added to u_left - u_right [px], row (5,) to v_right [px]; sigma (5,) of the disparity's
    coefficients by a jackknife over groups of frames, so that points seen twice do not count twice.
    """

    disparity: Float[Array, "5"]
    row: Float[Array, "5"]
    sigma: Float[Array, "5"]

    def __post_init__(self) -> None:
        freeze_fields(self)

    def missing_disparity(self, rig: StereoRig, uv: Float[Array, "n 2"]) -> Float[Array, "n"]:
        """What a disparity measured at left pixels uv lacks [px]."""
        return np.asarray(_terms(rig.left.normalise(uv)) @ self.disparity)

    def corrected(self, rig: StereoRig, tracks: Tracks) -> Tracks:
        """The same tracks, right points moved to where an ideal rig sees them."""
        B = _terms(rig.left.normalise(tracks.uv_left))
        right = tracks.uv_right + np.stack([-B @ self.disparity, B @ self.row], axis=1)
        return Tracks(tracks.frame, tracks.track, tracks.uv_left, right, tracks.cov)


@dataclass(frozen=True, eq=False)
class _Pair:
    """Points of one frame seen again in the next: directions (n, 2), disparities (n,) [px], next left (n, 2) [px], the
    motion R, t that RANSAC finds."""

    direction: Float[Array, "n 2"]
    disparity: Float[Array, "n"]
    after: Float[Array, "n 2"]
    R: Float[Array, "3 3"]
    t: Float[Array, "3"]


def calibrate(rig: StereoRig, tracks: Tracks) -> RectificationError | EstimationFailed:
    """The error of a rectified rig from tracks of a static scene, by least squares over all motions and the error.

    Raises
        ValueError: the rig is not rectified.
    """
    if not rig.is_normal_case:
        raise ValueError("rig: expected parallel, equal cameras")
    whole, pairs = np.zeros(len(TERMS)), list[_Pair]()
    for _ in range(_ROUNDS):
        pairs = [p for k in np.unique(tracks.frame).tolist() if (p := _pair(rig, tracks, int(k), whole)) is not None]
        if len(pairs) < _FEWEST_PAIRS:
            return EstimationFailed(
                f"{len(pairs)} pairs of frames show enough of a scene the camera passes, {_FEWEST_PAIRS} are needed",
                ("more points", "a longer way"),
            )
        whole = _adjusted(rig, pairs, whole)
    groups = np.array_split(np.arange(len(pairs)), _FEWEST_PAIRS)
    without = np.array([_adjusted(rig, [p for i, p in enumerate(pairs) if i not in g], whole) for g in groups])
    variance = (len(groups) - 1) * without.var(axis=0)
    if np.sqrt(variance[0]) > _UNCERTAIN_PX:
        return EstimationFailed(
            f"the disparity's error is known to {np.sqrt(variance[0]):.2f} px only", ("near and far points",)
        )
    return RectificationError(whole, _rows(rig, tracks), np.sqrt(variance))


def _terms(xy: Float[Array, "n 2"]) -> Float[Array, "n 5"]:
    x, y = xy.T
    return np.stack([np.ones_like(x), x, x * x, y, x * y], axis=1)


def _base_px_m(rig: StereoRig) -> float:
    return float(-rig.T_rl.t[0] * rig.left.K[0, 0])


def _disparity(rig: StereoRig, tracks: Tracks) -> Float[Array, "n"]:
    shift = rig.left.K[0, 2] - rig.right.K[0, 2]
    return np.asarray(tracks.uv_left[:, 0] - tracks.uv_right[:, 0] - shift)


def _pair(rig: StereoRig, tracks: Tracks, k: int, error: Float[Array, "5"]) -> _Pair | None:
    """The points of frame k that are there in the next one, less what does not move with most of them."""
    a, b = tracks.select(tracks.frame == k), tracks.select(tracks.frame == k + 1)
    _, i, j = np.intersect1d(a.track, b.track, assume_unique=True, return_indices=True)
    a, after = a.select(i), b.uv_left[j]
    disparity = _disparity(rig, a)
    near = disparity > _FARTHEST_PX
    if near.sum() < _ENOUGH:
        return None
    direction, disparity, after = rig.left.normalise(a.uv_left)[near], disparity[near], after[near]
    depth = _base_px_m(rig) / np.maximum(disparity + _terms(direction) @ error, _FARTHEST_PX)
    points = np.column_stack([direction, np.ones(len(direction))]) * depth[:, None]
    cv2.setRNGSeed(0)
    found, r, t, inlier = cv2.solvePnPRansac(
        points, after, rig.left.K, None, iterationsCount=1000, reprojectionError=_OUTLIER_PX
    )
    if not found or inlier is None or len(inlier) < _ENOUGH:
        return None
    kept = inlier[:, 0]
    base_m = _base_px_m(rig) / rig.left.K[0, 0]
    if np.linalg.norm(t) * np.median(disparity[kept]) / base_m < _LEAST_PX:
        return None
    return _Pair(direction[kept], disparity[kept], after[kept], exp_so3(r[:, 0]), t[:, 0])


def _adjusted(rig: StereoRig, pairs: Sequence[_Pair], error: Float[Array, "5"]) -> Float[Array, "5"]:
    """Coefficients of the disparity's error: Gauss-Newton with a soft L1 loss, motions eliminated pair by pair."""
    motions = [(p.R, p.t) for p in pairs]
    for _ in range(_STEPS):
        blocks = [_normal_equations(rig, p, *m, error) for p, m in zip(pairs, motions, strict=True)]
        step = np.linalg.solve(np.sum([b[0] for b in blocks], axis=0), np.sum([b[1] for b in blocks], axis=0))
        error = error + step
        motions = [_moved(m, b[2] - b[3] @ step) for m, b in zip(motions, blocks, strict=True)]
        if np.abs(step).max() < _SMALL:
            break
    return error


def _moved(motion: tuple[Array, Array], step: Float[Array, "6"]) -> tuple[Array, Array]:
    R, t = motion
    return exp_so3(step[:3]) @ R, t + step[3:]


def _normal_equations(
    rig: StereoRig, pair: _Pair, R: Array, t: Array, error: Float[Array, "5"]
) -> tuple[Array, Array, Array, Array]:
    """Of one pair, its motion eliminated: N (5, 5) and n (5,) of the error; the motion's step is g - G step."""
    B = _terms(pair.direction)
    inverse_depth = (pair.disparity + B @ error) / _base_px_m(rig)
    turned = np.column_stack([pair.direction, np.ones(len(B))]) @ R.T
    Y = turned + inverse_depth[:, None] * t
    v = pair.after - rig.left.project(Y)
    J = rig.left.project_jacobian(Y)
    A_motion = np.concatenate([-J @ hat(turned), J * inverse_depth[:, None, None]], axis=2)
    A_error = (J @ t)[:, :, None] * (B / _base_px_m(rig))[:, None]
    w = 1 / np.sqrt(1 + np.sum(v * v, axis=1) / _SOFT_PX**2)
    N_mm = np.einsum("n,nia,nib->ab", w, A_motion, A_motion)
    N_me = np.einsum("n,nia,nib->ab", w, A_motion, A_error)
    N_ee = np.einsum("n,nia,nib->ab", w, A_error, A_error)
    n_m, n_e = np.einsum("n,nia,ni->a", w, A_motion, v), np.einsum("n,nia,ni->a", w, A_error, v)
    G, g = np.linalg.solve(N_mm, N_me), np.linalg.solve(N_mm, n_m)
    return N_ee - N_me.T @ G, n_e - N_me.T @ g, g, G


def _rows(rig: StereoRig, tracks: Tracks) -> Float[Array, "5"]:
    """Coefficients of what right rows lack to be the left ones, with the same loss."""
    B, off = _terms(rig.left.normalise(tracks.uv_left)), tracks.uv_left[:, 1] - tracks.uv_right[:, 1]
    off = off - (rig.left.K[1, 2] - rig.right.K[1, 2])
    row = np.zeros(B.shape[1])
    for _ in range(_STEPS):
        w = 1 / np.sqrt(1 + ((off - B @ row) / _SOFT_PX) ** 2)
        row = np.linalg.solve((B.T * w) @ B, (B.T * w) @ off)
    return row
