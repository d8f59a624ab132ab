"""The rigid object seen from a stereo camera: motion and shape by one adjustment, Siegemund 2008, 3.1.

    l_it + v_it = R_t X_i + T_t                                                               (3.1.4)

The update is multiplicative, R <- exp(dr) R, and turns about the object's origin (T <- T + dT): the same step as the
source's T <- exp(dr) T + dT (3.1.33), far better conditioned. Linearised (the text lacks (3.1.17)-(3.1.31)):

    dl_it + v_it = [ -S(R_t X_i)  I ] [dr_t; dT_t] + R_t dX_i
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import lapack

from estimators.gauss_markov import SingularSystem
from estimators.stereo.conditions import Conditions, no_terms
from estimators.stereo.depth_bias import ObservationModel
from estimators.stereo.kernel import (
    CONVERGED,
    EXHAUSTED,
    STUCK,
    UNDETERMINED_TRACK,
    UNOBSERVED_POSE,
    best_points,
    descend,
    eliminated,
    fill_fixed,
    in_lanes,
    layout,
    mean_points,
    points_of,
    reduced_system,
    weights_of,
    without_datum,
)
from sim.pose import hat, left_jacobian, log_so3

Array = np.ndarray
Stop = Literal["decrement", "update", "relative_update"]
_STOPS: tuple[Stop, ...] = ("decrement", "update", "relative_update")
_FAILURES = {
    UNDETERMINED_TRACK: "a track is not determined",
    UNOBSERVED_POSE: "a pose is not observed",
    STUCK: "no step decreases the cost",
    EXHAUSTED: "no convergence within {} iterations",
}
# Of the poses' normal equations in units of their diagonal: nearer to singular they do not determine the motion.
_RECIPROCAL_CONDITION = 1e-12


@dataclass(frozen=True, eq=False)
class Problem:
    """Observations of one window: frame (k,) in 0..m-1, point (k,) in 0..n-1, triangulated points l (k, 3).

    ``model`` says what they weigh; ``model(Y)`` gives for points Y (k, 3) in the camera frame the corrected
    observations (k, 3) and the weights W (k, 3, 3) that hold there.
    """

    frame: Int[Array, "k"]
    point: Int[Array, "k"]
    l: Float[Array, "k 3"]
    model: ObservationModel
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


def pose_covariance(S: Float[Array, "p p"], F: Float[Array, "f p"], G: Float[Array, "p g"]) -> Float[Array, "f f"]:
    """Covariance of functions of the poses with the derivatives F, reduced normal matrix S and its null space G.

    That in the datum without null-space share, (2.1.21).

    Raises
        SingularSystem: S has further null directions, or is not positive: the motion is not determined.
    """
    scale = np.sqrt(np.clip(np.diag(S), 0, None))
    if not np.all(scale > 0):
        raise SingularSystem("a pose is not observed")
    Q, _ = np.linalg.qr(G * scale[:, None])
    M = without_datum(S, scale, Q)
    L, failed = lapack.dpotrf(M, lower=1)
    if failed or lapack.dpocon(L, np.abs(M).sum(axis=0).max(), uplo="L")[0] < _RECIPROCAL_CONDITION:
        raise SingularSystem("the motion is not determined by the tracks")
    F = F / scale
    H, _ = lapack.dtrtrs(L, (F - (F @ Q) @ Q.T).T, lower=1)
    return np.asarray(H.T @ H)


def adjust(
    problem: Problem,
    R: Float[Array, "m 3 3"],
    T: Float[Array, "m 3"],
    stop: Stop = "decrement",
    tolerance: float = 1e-6,
    max_iterations: int = 50,
    conditions: Conditions | None = None,
    X: Float[Array, "n 3"] | None = None,
) -> Solution:
    """Gauss-Newton with the points solved anew for the poses of every iteration, carried on to Newton's method.

    Far objects need the second derivatives that Gauss-Newton drops: their residuals are large against the curvature,
    and plain Gauss-Newton creeps. Near the optimum a matrix serves further steps. Where the matrix is not positive its
    eigenvalues enter by magnitude; where a step does not lower the cost it is damped (Levenberg-Marquardt, (2.2.6)).
    The loop is `kernel.descend`.

    stop: "decrement" squared Newton decrement below the tolerance; "update" largest parameter change (2.1.19);
    "relative_update" largest change in units of its standard deviation (2.1.20). Start poses must meet the fixed
    ``conditions``, as `conditions.of_window` makes them. X: start values of the points, by default their means.

    Raises
        SingularSystem: the tracks do not determine the motion, or the iterations did not converge.
    """
    model, R, T = problem.model, np.array(R, float), np.array(T, float)
    tiles = layout(problem.frame, problem.point, problem.m, problem.n)
    model.fill(tiles)
    cloud = problem.frame, problem.point, problem.l
    X_lanes = mean_points(tiles, *cloud, R, T) if X is None else in_lanes(tiles, X)
    T_rl = model.rig.T_rl
    terms = no_terms(problem.m) if conditions is None else conditions.terms
    arguments = (tiles, terms, model.W is None, model.second_order, T_rl.R, T_rl.t, R, T, X_lanes)
    try:
        status, iterations, cost = descend(*arguments, _STOPS.index(stop), tolerance, max_iterations)
    except np.linalg.LinAlgError as error:
        raise SingularSystem("the motion is not determined by the tracks") from error
    if status != CONVERGED:
        raise SingularSystem(_FAILURES[status].format(max_iterations))
    return Solution(R, T, points_of(tiles, X_lanes), weights_of(tiles), cost, iterations)


def motion_covariance(
    frame: Int[Array, "k"],
    point: Int[Array, "k"],
    R: Float[Array, "m 3 3"],
    X: Float[Array, "n 3"],
    W: Float[Array, "k 3 3"],
    dt_s: float,
    T: Float[Array, "m 3"] | None = None,
    conditions: Conditions | None = None,
) -> Float[Array, "12 12"]:
    """Joint covariance of the gauge-free functionals of `WindowEstimate.cov` at the last frame.

    frame (k,) in 0..m-1 and point (k,) in 0..n-1 of each observation, weights W (k, 3, 3) [1/m²] in the camera frame.
    With the weights of the true geometry and the true noise it is the Cramer-Rao bound; with ``conditions`` (and T) it
    is that of an estimator that knows them.

    Raises
        SingularSystem: the tracks do not determine the motion (fewer than three, collinear, no overlap).
    """
    F_p, F_X = functionals(R[-2:], X, dt_s)
    m, n = len(R), len(X)
    tiles, at_rest = layout(frame, point, m, n), np.zeros((m, 3))
    fill_fixed(tiles, np.einsum("kab,kb->ka", R[frame], X[point]), W)
    in_tiles, factor = in_lanes(tiles, X), np.empty(6 * len(tiles.unused))
    if np.isnan(best_points(tiles, R, at_rest, in_tiles, factor)):
        raise SingularSystem("a point is not determined by its observations")
    S, _, _ = reduced_system(tiles, R, at_rest, in_tiles, factor, False)
    U, UZ = eliminated(tiles, frame, point, R, X, W, factor, F_X)
    F = -UZ.T
    F[:, 6 * (m - 2) :] += F_p
    G, free = null_space(R), None
    if conditions is not None and T is not None:
        known = conditions.pseudo_observations(R, T)
        S, G, free = S + known.J.T @ known.P @ known.J, conditions.null_space(R), conditions.free
    if free is not None:
        S, F, G = free.T @ S @ free, F @ free, free.T @ G
    U = U.reshape(3 * n, -1)
    return np.asarray(pose_covariance(S, F, G) + U.T @ U)


def functionals(R: Array, X: Array, dt_s: float) -> tuple[Array, Array]:
    """Derivatives of the 12 functionals by the last two poses (12, 12) and by the points (n, 12, 3)."""
    n = len(X)
    centre = X.mean(axis=0)
    x = X - centre
    inertia = np.eye(3) * np.sum(x * x) - x.T @ x
    if np.linalg.eigvalsh(inertia)[0] < 1e-9 * max(np.trace(inertia), 1e-30):
        raise SingularSystem("the points are collinear")
    turn = np.linalg.inv(inertia) @ hat(x)  # rotation of the shape per dX_i, (n, 3, 3)
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


def redundancy(problem: Problem, conditions: Conditions | None = None, poses: tuple[Array, Array] | None = None) -> int:
    """3k - (6m + 3n) + 6: the datum conditions count, as do further ones at the poses (R, T) (2.1.28)."""
    return 3 * len(problem.frame) - 3 * problem.n - unknown_poses(problem.m, conditions, poses)


def unknown_poses(m: int, conditions: Conditions | None, poses: tuple[Array, Array] | None) -> int:
    """Unknowns of m poses without datum and what is known of them: 6m - 6 where there are no conditions."""
    if conditions is None or poses is None:
        return 6 * m - 6
    f = 6 * m if conditions.free is None else conditions.free.shape[1]
    return int(f - conditions.null_space(poses[0]).shape[1] - conditions.pseudo_observations(*poses).count)
