"""The rigid object seen from a stereo camera: motion and shape by one adjustment, Siegemund 2008, 3.1.

    l_it + v_it = R_t X_i + T_t                                                               (3.1.4)

The update is multiplicative, R <- exp(dr) R, and turns about the object's origin (T <- T + dT): the same step as the
source's T <- exp(dr) T + dT (3.1.33), far better conditioned. Linearised (the text lacks (3.1.17)-(3.1.31)):

    dl_it + v_it = [ -S(R_t X_i)  I ] [dr_t; dT_t] + R_t dX_i
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from estimators.gauss_markov import (
    Blocks,
    Reduced,
    SingularSystem,
    Spectrum,
    inverse_spd,
    normal_blocks,
    reduce_points,
    spectrum,
    sum_by,
)
from sim.pose import exp_so3, hat, left_jacobian, log_so3

Array = np.ndarray
Stop = Literal["decrement", "update", "relative_update"]
_TRIES = 14
# Weights that follow the points need not lead to a fixed point where outliers rule; after so many iterations they stay.
_REWEIGHTED = 20
# At rough start values Newton's curvature belongs to residuals that one linear step takes away: it misleads.
_GAUSS_NEWTON_STEPS = 3


@dataclass(frozen=True, eq=False)
class Problem:
    """Observations of one window: frame (k,) in 0..m-1, point (k,) in 0..n-1, triangulated points l (k, 3).

    ``model(Y)`` gives for the current points Y (k, 3) in the camera frame the corrected observations (k, 3) and the
    weights W (k, 3, 3) that hold there.
    """

    frame: Int[Array, "k"]
    point: Int[Array, "k"]
    l: Float[Array, "k 3"]
    model: Callable[[Array], tuple[Array, Array]]
    m: int
    n: int


@dataclass(frozen=True, eq=False)
class Solution:
    """R (m, 3, 3), T (m, 3) object to camera, X (n, 3), weights W (k, 3, 3) at the solution, cost v'Wv."""

    R: Float[Array, "m 3 3"]
    T: Float[Array, "m 3"]
    X: Float[Array, "n 3"]
    W: Float[Array, "k 3 3"]
    cost: float
    iterations: int


def solve_points(problem: Problem, R: Array, T: Array, observed: Array, W: Array) -> Array:
    """Best points for given poses: X_i = (sum R'WR)^-1 sum R'W (l - T)."""
    R_k = R[problem.frame]
    WR = W @ R_k
    N_inv = inverse_spd(sum_by(problem.point, np.swapaxes(R_k, 1, 2) @ WR, problem.n), "a track is not determined")
    b = sum_by(problem.point, np.einsum("kab,ka->kb", WR, observed - T[problem.frame]), problem.n)
    return np.asarray((N_inv @ b[:, :, None])[:, :, 0])


def points_by_mean(problem: Problem, R: Array, T: Array) -> Array:
    """Start values of the points: mean over the frames of the points in the object frame, (3.7.13)."""
    X_k = np.einsum("kba,kb->ka", R[problem.frame], problem.l - T[problem.frame])
    return np.asarray(sum_by(problem.point, X_k, problem.n) / np.bincount(problem.point, minlength=problem.n)[:, None])


def _camera_points(problem: Problem, R: Array, T: Array, X: Array) -> Array:
    return np.asarray((R[problem.frame] @ X[problem.point][:, :, None])[:, :, 0] + T[problem.frame])


def design(R_k: Float[Array, "k 3 3"], X_k: Float[Array, "k 3"]) -> Float[Array, "k 3 6"]:
    """[-S(R X), I]: derivative of R X + T by the pose of each observation."""
    A = np.zeros((len(X_k), 3, 6))
    A[:, :, :3] = -hat((R_k @ X_k[:, :, None])[:, :, 0])
    A[:, [0, 1, 2], [3, 4, 5]] = 1
    return A


def null_space(R: Float[Array, "m 3 3"]) -> Float[Array, "p 6"]:
    """Pose changes (6m, 6) that only move the object frame: dr_t = R_t a, dT_t = R_t b."""
    G = np.zeros((len(R), 6, 6))
    G[:, :3, :3] = G[:, 3:, 3:] = R
    return G.reshape(-1, 6)


def align(X: Float[Array, "n 3"], to: Float[Array, "n 3"]) -> tuple[Float[Array, "3 3"], Float[Array, "3"]]:
    """Rotation Q and shift s that bring Q X + s nearest to ``to`` (least squares).

    At the optimum sum dX_i = 0 and sum X_i x dX_i = 0: the inner constraints (3.1.35)-(3.1.36) in finite form.
    """
    a, b = X.mean(axis=0), to.mean(axis=0)
    U, _, Vt = np.linalg.svd((to - b).T @ (X - a))
    Q = U @ np.diag([1, 1, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return Q, b - Q @ a


def _curved(blocks: Blocks, R_k: Array, X_k: Array, g: Array) -> Blocks:
    """Adds the second derivatives of the model, which Gauss-Newton drops, so that the step is Newton's.

    With g = W v, a = R X: g'(dr x (dr x a))/2 + g'(dr x R dX) is the term of second order of the cost.
    """
    a = (R_k @ X_k[:, :, None])[:, :, 0]
    ga = g[:, :, None] * a[:, None, :]
    N_pp, N_pX = blocks.N_pp.copy(), blocks.N_pX.copy()
    N_pp[:, :3, :3] += (ga + np.swapaxes(ga, 1, 2)) / 2 - np.sum(g * a, axis=1)[:, None, None] * np.eye(3)
    N_pX[:, :3] -= hat(g) @ R_k
    return replace(blocks, N_pp=N_pp, N_pX=N_pX)


def _system(problem: Problem, R: Array, X: Array, residual: Array, W: Array, newton: bool) -> tuple[Spectrum, Array]:
    """Spectrum and right side of the reduced system, Newton's or Gauss-Newton's, at poses and their best points."""
    R_k, X_k = R[problem.frame], X[problem.point]
    blocks = normal_blocks(design(R_k, X_k), R_k, W, residual)
    scale = np.sqrt(np.einsum("tpp->tp", sum_by(problem.frame, blocks.N_pp, problem.m))).ravel()
    if newton:
        blocks = _curved(blocks, R_k, X_k, -(W @ residual[:, :, None])[:, :, 0])
    reduced = reduce_points(problem.frame, problem.point, blocks, problem.m, problem.n)
    return spectrum(reduced.S, scale, null_space(R)), reduced.rhs


def pose_covariance(frame: Array, point: Array, R: Array, X: Array, W: Array) -> tuple[Float[Array, "p p"], Reduced]:
    """Covariance (6m, 6m) of the poses in the datum without null-space share, (2.1.21), and the reduced system."""
    R_k = R[frame]
    blocks = normal_blocks(design(R_k, X[point]), R_k, W, np.zeros((len(frame), 3)))
    reduced = reduce_points(frame, point, blocks, len(R), len(X))
    scale = np.sqrt(np.clip(np.diag(reduced.S), 0, None))
    return spectrum(reduced.S, scale, null_space(R)).inverse(), reduced


def _cost(problem: Problem, R: Array, T: Array, observed: Array, W: Array) -> tuple[float, Array]:
    X = solve_points(problem, R, T, observed, W)
    v = _camera_points(problem, R, T, X) - observed
    return float(np.einsum("ka,kab,kb->", v, W, v)), X


def adjust(
    problem: Problem,
    R: Float[Array, "m 3 3"],
    T: Float[Array, "m 3"],
    stop: Stop = "decrement",
    tolerance: float = 1e-6,
    max_iterations: int = 50,
) -> Solution:
    """Gauss-Newton with the points solved anew for the poses of every iteration, carried on to Newton's method.

    Far objects need the second derivatives that Gauss-Newton drops: their residuals are large against the curvature,
    and plain Gauss-Newton creeps. Where the matrix is not positive its eigenvalues enter by magnitude; where a step
    does not lower the cost it is damped (Levenberg-Marquardt, (2.2.6)).

    stop: "decrement" squared Newton decrement below the tolerance; "update" largest change of a pose
    [rad, m] (2.1.19); "relative_update" the same in units of its standard deviation (2.1.20). The points follow.

    Raises
        SingularSystem: the tracks do not determine the motion, or the iterations did not converge.
    """
    X = points_by_mean(problem, R, T)
    observed, W = problem.model(_camera_points(problem, R, T, X))
    damping = 0.0
    for iteration in range(1, max_iterations + 1):
        if iteration <= _REWEIGHTED:
            observed, W = problem.model(_camera_points(problem, R, T, X))
        cost, X = _cost(problem, R, T, observed, W)
        residual = observed - _camera_points(problem, R, T, X)
        system, rhs = _system(problem, R, X, residual, W, iteration > _GAUSS_NEWTON_STEPS)
        for _ in range(_TRIES):
            dp = system.solve(rhs, damping).reshape(problem.m, 6)
            R_new, T_new = exp_so3(dp[:, :3]) @ R, T + dp[:, 3:]
            cost_new, X_new = _cost(problem, R_new, T_new, observed, W)
            if cost_new <= cost * (1 + 1e-12) + 1e-12:
                damping = damping / 10 if damping > 1e-7 else 0.0
                break
            damping = max(10 * damping, 1e-6)
        else:
            raise SingularSystem("no step decreases the cost")
        R, T, X, cost = R_new, T_new, X_new, cost_new
        if damping == 0.0 and _measure(stop, problem, R, X, W, dp, float(rhs @ system.solve(rhs))) < tolerance:
            return Solution(R, T, X, W, cost, iteration)
    raise SingularSystem(f"no convergence within {max_iterations} iterations")


def _measure(stop: Stop, problem: Problem, R: Array, X: Array, W: Array, dp: Array, decrement: float) -> float:
    """What the chosen stop criterion compares with its tolerance."""
    if stop == "decrement":
        return decrement
    change = np.abs(dp.ravel())
    if stop == "relative_update":
        Sigma, _ = pose_covariance(problem.frame, problem.point, R, X, W)
        change = change / np.sqrt(np.diag(Sigma))
    return float(change.max())


def motion_covariance(
    frame: Int[Array, "k"],
    point: Int[Array, "k"],
    R: Float[Array, "m 3 3"],
    X: Float[Array, "n 3"],
    W: Float[Array, "k 3 3"],
    dt_s: float,
) -> Float[Array, "12 12"]:
    """Joint covariance of the gauge-free functionals of `WindowEstimate.cov` at the last frame.

    frame (k,) in 0..m-1 and point (k,) in 0..n-1 of each observation, weights W (k, 3, 3) [1/m²] in the camera frame.
    With the weights of the true geometry and the true noise it is the Cramer-Rao bound.

    Raises
        SingularSystem: the tracks do not determine the motion (fewer than three, collinear, no overlap).
    """
    m = len(R)
    Sigma, reduced = pose_covariance(frame, point, R, X, W)
    F_p, F_X = _functionals(R[-2:], X, dt_s)
    F = np.zeros((12, 6 * m))
    F[:, 6 * (m - 2) :] = F_p
    F -= np.einsum("nfa,nap->fp", F_X, reduced.h)
    cov = F @ Sigma @ F.T + np.einsum("nfa,nab,ngb->fg", F_X, reduced.N_inv, F_X)
    return np.asarray((cov + cov.T) / 2)


def _functionals(R: Array, X: Array, dt_s: float) -> tuple[Array, Array]:
    """Derivatives of the 12 functionals by the last two poses (12, 12) and by the points (n, 12, 3)."""
    n = len(X)
    centre = X.mean(axis=0)
    x = X - centre
    inertia = np.eye(3) * np.sum(x * x) - x.T @ x
    if np.linalg.eigvalsh(inertia)[0] < 1e-9 * max(np.trace(inertia), 1e-30):
        raise SingularSystem("the points are collinear")
    turn = np.linalg.solve(inertia, hat(x))  # rotation of the shape per dX_i, (n, 3, 3)
    pose = np.zeros((2, 6, 6))  # centroid and rotation of one frame by its own pose
    pose[:, :3, :3] = -hat(R @ centre)
    pose[:, :3, 3:] = pose[:, 3:, :3] = np.eye(3)
    points = np.concatenate(
        [np.broadcast_to(R[:, None] / n, (2, n, 3, 3)), np.einsum("fab,nbc->fnac", R, turn)], axis=2
    )
    E = R[1] @ R[0].T
    J_inv = np.linalg.inv(left_jacobian(log_so3(E)))
    rate_new, rate_old = np.eye(6) / dt_s, np.eye(6) / dt_s
    rate_new[3:, 3:], rate_old[3:, 3:] = J_inv / dt_s, J_inv @ E / dt_s
    F_p = np.zeros((12, 12))
    F_p[:6, 6:], F_p[6:, 6:], F_p[6:, :6] = pose[1], rate_new @ pose[1], -rate_old @ pose[0]
    F_X = np.concatenate([points[1], rate_new @ points[1] - rate_old @ points[0]], axis=1)
    return F_p, F_X


def redundancy(problem: Problem) -> int:
    """3k - (6m + 3n) + 6: the datum conditions count (2.1.28)."""
    return 3 * len(problem.frame) - 6 * problem.m - 3 * problem.n + 6
