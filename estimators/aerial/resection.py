"""Resection: the pose of each image from points whose world coordinates are known (Kozempel 2012, 3.3; [70]).

A linearised adjustment of all images at once; the points of every image are tested against their stated sigma. The
source holds the position that GNSS gives and adjusts three angles; both ways are here. Camera poses are perturbed as
``R_wc exp(d[:3])``, ``t_wc + d[3:]``: rotation in camera axes [rad], translation in world axes [m].
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import chi2

from estimators.estimate import EstimationFailed
from estimators.gauss_markov import sum_by
from sim.archive import freeze_fields
from sim.camera import Camera
from sim.pose import Pose, exp_so3, hat

Array = np.ndarray
# Chance that the test calls a good point an outlier.
_SIGNIFICANCE = 0.001
# A residual whose variance is less than this share of its observation's says nothing about it.
_UNCONTROLLED = 1e-4
# Points whose spread across their line is less than this many sigmas of a click lie on a line.
_LINE_SIGMAS = 3.0
_ITERATIONS = 30
# A step of less than a millionth of its sigma is none.
_CONVERGED = 1e-6
# Least eigenvalue of normal equations with unit diagonal.
_SINGULAR = 1e-12


@dataclass(frozen=True, eq=False)
class ImagePoints:
    """Points measured in images: image (k,) and point (k,) indices, uv (k, 2) [px], stated sigma_px of each coordinate.

    Raises
        ValueError: lengths that differ, coordinates that are not finite, a point twice in one image, sigma_px <= 0.
    """

    image: Int[Array, "k"]
    point: Int[Array, "k"]
    uv: Float[Array, "k 2"]
    sigma_px: float

    def __post_init__(self) -> None:
        freeze_fields(self)
        if not len(self.image) == len(self.point) == len(self.uv):
            raise ValueError(
                f"ImagePoints: expected as many images, points and uv, got {len(self.image)}, {len(self.point)} and "
                f"{len(self.uv)}"
            )
        if not np.isfinite(self.uv).all():
            raise ValueError(f"ImagePoints.uv: {np.count_nonzero(~np.isfinite(self.uv).all(axis=1))} are not finite")
        pairs, count = np.unique(np.stack([self.image, self.point]), axis=1, return_counts=True)
        if np.any(count > 1):
            image, point = pairs[:, count > 1][:, 0]
            raise ValueError(f"ImagePoints: point {point} is measured twice in image {image}")
        if not self.sigma_px > 0:
            raise ValueError(f"ImagePoints.sigma_px: expected > 0, got {self.sigma_px}")

    def __len__(self) -> int:
        return len(self.image)

    def select(self, keep: Bool[Array, "k"]) -> ImagePoints:
        """The measurements where ``keep`` is true."""
        return ImagePoints(self.image[keep], self.point[keep], self.uv[keep], self.sigma_px)


@dataclass(frozen=True, eq=False)
class Resection:
    """Pose T_wc of one image; cov (6, 6) of the stated sigma: rotation in camera axes [rad], position in w [m].

    rejected (q,) are the points taken for outliers, residuals (n, 2) [px] (adjusted minus measured) those of the
    others, in the order of the measurements; sigma_0 is NaN without redundancy. A position held fixed has covariance 0.
    """

    T_wc: Pose
    cov: Float[Array, "6 6"]
    residuals: Float[Array, "n 2"]
    rejected: Int[Array, "q"]
    sigma_0: float
    redundancy: int
    iterations: int

    def __post_init__(self) -> None:
        freeze_fields(self)


@dataclass(frozen=True, eq=False)
class Projection:
    """uv (k, 2) [px], its derivatives A (k, 2, 6) by the camera poses and B (k, 2, 3) by the points."""

    uv: Float[Array, "k 2"]
    A: Float[Array, "k 2 6"]
    B: Float[Array, "k 2 3"]


def linearise(camera: Camera, T_wc: Pose, X_w: Float[Array, "k 3"]) -> Projection:
    """Projections of points into the camera of the same row, with derivatives; NaN where the camera sees no point.

    With ``p_c = R' (X - t)``: ``dp_c = hat(p_c) d[:3] - R' d[3:] + R' dX``.
    """
    p_c = T_wc.inv().apply(X_w)
    J = camera.project_jacobian(p_c)
    B = J @ np.swapaxes(T_wc.R, -1, -2)
    return Projection(camera.project(p_c), np.concatenate([J @ hat(p_c), -B], axis=-1), B)


def moved(T_wc: Pose, d: Float[Array, "m 6"]) -> Pose:
    """Poses perturbed by d."""
    return Pose(T_wc.R @ exp_so3(d[:, :3]), T_wc.t + d[:, 3:])


def initial_pose(camera: Camera, X_w: Float[Array, "n 3"], uv: Float[Array, "n 2"]) -> Pose | EstimationFailed:
    """Pose of one image from its points alone, n >= 4, by OpenCV's SQPNP: where the navigation gives no start."""
    if len(X_w) < 4:
        return EstimationFailed(f"{len(X_w)} points: a start without navigation needs 4", ("Give a start pose.",))
    centre = np.mean(X_w, axis=0)
    xy = camera.normalise(uv)
    if not np.isfinite(xy).all():
        return EstimationFailed("a point lies where the lens model has no ray")
    ok, r, t = cv2.solvePnP(X_w - centre, xy[:, None], np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_SQPNP)
    if not ok or not np.isfinite(t).all():
        return EstimationFailed("no pose projects the points to where they were measured")
    T_wc = Pose(exp_so3(r[:, 0]), t[:, 0]).inv()
    return Pose(T_wc.R, T_wc.t + centre)


@dataclass(frozen=True, eq=False)
class _Task:
    """What is adjusted: the first ``columns`` of the six parameters of every image."""

    camera: Camera
    points: ImagePoints
    X_w: Array
    columns: int

    def linearised(self, T_wc: Pose, used: Array) -> tuple[Array, Array]:
        """A (k, 2, c) and measured minus computed (k, 2), both in sigmas and zero where not used."""
        p = linearise(self.camera, T_wc[self.points.image], self.X_w[self.points.point])
        A = np.where(used[:, None, None], p.A[:, :, : self.columns], 0.0) / self.points.sigma_px
        return A, np.where(used[:, None], self.points.uv - p.uv, 0.0) / self.points.sigma_px


@dataclass(frozen=True, eq=False)
class _State:
    """Poses, the points that still take part, images that failed and those that (with outliers) do not converge yet."""

    T_wc: Pose
    used: Array
    failed: dict[int, EstimationFailed]
    slow: frozenset[int]
    iterations: int


def resect(
    camera: Camera,
    points: ImagePoints,
    X_w: Float[Array, "n 3"],
    start: Pose,
    fixed_position: bool = False,
) -> tuple[Resection | EstimationFailed, ...]:
    """Pose of every image of ``start`` (m,) from the points measured in it; ``point`` indexes X_w.

    ``fixed_position`` holds the positions of ``start`` and adjusts the rotations alone (the source's way, with GNSS).
    In each image the worst point is left out and the image adjusted anew, as long as one fails its test at 0.1 % and
    redundancy remains (data snooping with the stated sigma).
    """
    if not len(points):
        return (EstimationFailed("no points", ("Measure points.",)),) * len(start)
    task = _Task(camera, points, X_w, 3 if fixed_position else 6)
    state = _State(start, np.ones(len(points), bool), {}, frozenset(), 0)
    limit = chi2.isf(_SIGNIFICANCE, 2)
    while True:
        state = _adjusted(task, state)
        tests = _tests(task, state)
        worst = np.full(len(start), -1)
        order = np.argsort(tests, kind="stable")
        worst[points.image[order]] = order
        spare = 2 * np.bincount(points.image[state.used], minlength=len(start)) - task.columns
        out = [i for i in range(len(start)) if i not in state.failed and spare[i] > 2 and tests[worst[i]] > limit]
        if not out:
            return tuple(_result(task, state, i) for i in range(len(start)))
        state.used[worst[out]] = False


def _adjusted(task: _Task, state: _State) -> _State:
    """Gauss-Newton for all images at once; those that cannot be solved or do not converge are marked."""
    image, m = task.points.image, len(state.T_wc)
    failed = state.failed | _undetermined(task, state)
    T_wc = state.T_wc
    for iteration in range(1, _ITERATIONS + 1):
        A, dl = task.linearised(T_wc, state.used)
        lost = np.unique(image[~np.isfinite(dl).all(axis=1)])
        failed |= {int(i): EstimationFailed("points fall behind the camera", ("Give a better start.",)) for i in lost}
        good = np.array([i for i in range(m) if i not in failed], int)
        N = sum_by(image, np.swapaxes(A, 1, 2) @ A, m)[good]
        b = sum_by(image, np.einsum("kij,ki->kj", A, dl), m)[good]
        scale = np.sqrt(np.einsum("mii->mi", N))
        N /= scale[:, :, None] * scale[:, None, :]
        solvable = np.linalg.eigvalsh(N)[:, 0] > _SINGULAR
        failed |= {int(i): EstimationFailed("the points do not determine the pose") for i in good[~solvable]}
        good, scale = good[solvable], scale[solvable]
        step = np.linalg.solve(N[solvable], (b[solvable] / scale)[:, :, None])[:, :, 0]
        d = np.zeros((m, 6))
        d[good, : task.columns] = step / scale
        T_wc = moved(T_wc, d)
        moving = np.linalg.norm(step, axis=1) > _CONVERGED
        if not np.any(moving):
            return _State(T_wc, state.used, failed, frozenset(), iteration)
    return _State(T_wc, state.used, failed, frozenset(good[moving].tolist()), _ITERATIONS)


def _undetermined(task: _Task, state: _State) -> dict[int, EstimationFailed]:
    """Images with too few points, or points on a line."""
    failed = {}
    least = (task.columns + 1) // 2
    for i in range(len(state.T_wc)):
        uv = task.points.uv[state.used & (task.points.image == i)]
        if len(uv) < least:
            failed[i] = EstimationFailed(f"{len(uv)} points: a resection needs {least}", ("Measure more points.",))
        elif task.columns == 6 and _on_a_line(uv, task.points.sigma_px):
            failed[i] = EstimationFailed("the points lie on a line", ("Measure points beside it.",))
    return failed


def _on_a_line(uv: Array, sigma_px: float) -> bool:
    across = np.linalg.svd(uv - uv.mean(axis=0), compute_uv=False)[1]
    return bool(across < _LINE_SIGMAS * sigma_px * np.sqrt(len(uv)))


def _tests(task: _Task, state: _State) -> Array:
    """v' C_vv^-1 v of every point, chi-square with two degrees of freedom; 0 where it is not used or not controlled."""
    image = task.points.image
    used = state.used & ~np.isin(image, list(state.failed))
    A, v = task.linearised(state.T_wc, used)
    N = sum_by(image, np.swapaxes(A, 1, 2) @ A, len(state.T_wc))
    C, good = np.zeros_like(N), np.unique(image[used])
    C[good] = np.linalg.inv(N[good])
    values, vectors = np.linalg.eigh(np.eye(2) - A @ C[image] @ np.swapaxes(A, 1, 2))
    v = np.einsum("kij,ki->kj", vectors, v)
    return np.asarray(np.sum(np.where(values > _UNCONTROLLED, v * v / np.maximum(values, _UNCONTROLLED), 0.0), axis=1))


def _result(task: _Task, state: _State, i: int) -> Resection | EstimationFailed:
    if i in state.failed:
        return state.failed[i]
    if i in state.slow:
        return EstimationFailed("the adjustment does not converge", ("Give a better start.",))
    mine, c = task.points.image == i, task.columns
    A, v = task.linearised(state.T_wc, state.used & mine)
    A, v = A[state.used & mine].reshape(-1, c), -v[state.used & mine]
    cov = np.zeros((6, 6))
    cov[:c, :c] = np.linalg.inv(A.T @ A)
    redundancy = v.size - c
    sigma_0 = float(np.sqrt(np.sum(v * v) / redundancy)) if redundancy else float("nan")
    rejected = task.points.point[mine & ~state.used]
    return Resection(state.T_wc[i], cov, v * task.points.sigma_px, rejected, sigma_0, redundancy, state.iterations)
