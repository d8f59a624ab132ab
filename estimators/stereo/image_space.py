"""Bundle adjustment in image space, the yardstick of the object-space variants.

    uv_it + v_it = pi(R_t X_i + T_t),   linearised   dl + v = J ([-S(R X)  I] [dr_t; dT_t] + R_t dX_i)

pi projects into both images, J is its Jacobian (4 x 3). All four coordinates enter with their covariance; no
triangulation stands between, so nothing of its bias and of the weights' question (Siegemund 2008, 4.1.2-4.1.3) either.

Gauss-Newton creeps where short tracks hold many frames together: their weak directions have less curvature than the
residuals. So the steps are Newton's, with the second derivatives of rotation and projection; and the points follow the
poses of every step beyond the linear, else it leaves the valleys of far objects, which are bent.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from estimators.gauss_markov import (
    Blocks,
    SingularSystem,
    Spectrum,
    inverse_spd,
    normal_blocks,
    reduce_points,
    spectrum,
    sum_by,
)
from estimators.stereo.conditions import Conditions
from estimators.stereo.object_motion import Solution, Stop, design, null_space
from estimators.stereo.triangulation import information
from sim.camera import Camera, StereoRig
from sim.pose import exp_so3, hat

Array = np.ndarray
_TRIES = 14
# At rough start values Newton's curvature belongs to residuals that one linear step takes away.
_GAUSS_NEWTON_STEPS = 1


@dataclass(frozen=True, eq=False)
class ImageProblem:
    """Image coordinates uv (k, 4) [px] of one window with weights W_uv (k, 4, 4); frame (k,) in 0..m-1, point (k,) in
    0..n-1."""

    rig: StereoRig
    frame: Int[Array, "k"]
    point: Int[Array, "k"]
    uv: Float[Array, "k 4"]
    W_uv: Float[Array, "k 4 4"]
    m: int
    n: int

    @property
    def redundancy(self) -> int:
        """4k - (6m + 3n) + 6: the datum conditions count (2.1.28)."""
        return 4 * len(self.frame) - 6 * self.m - 3 * self.n + 6

    def camera_points(self, R: Array, T: Array, X: Array) -> Float[Array, "k 3"]:
        return np.asarray((R[self.frame] @ X[self.point][:, :, None])[:, :, 0] + T[self.frame])

    def residuals(self, R: Array, T: Array, X: Array) -> Float[Array, "k 4"]:
        """Observed minus projected coordinates; NaN behind the cameras."""
        return np.asarray(self.uv - self.rig.project(self.camera_points(R, T, X)))

    def cost(self, R: Array, T: Array, X: Array) -> float:
        v = self.residuals(R, T, X)
        return float(np.einsum("ka,kab,kb->", v, self.W_uv, v))

    def improved_points(self, R: Array, T: Array, X: Array) -> Float[Array, "n 3"]:
        """One Gauss-Newton step of every point for fixed poses.

        Raises
            SingularSystem: a point is not determined by its observations.
        """
        J = self.rig.project_jacobian(self.camera_points(R, T, X)) @ R[self.frame]
        JW = np.swapaxes(J, 1, 2) @ self.W_uv
        N_inv = inverse_spd(sum_by(self.point, JW @ J, self.n), "a point is not determined by its observations")
        b = sum_by(self.point, (JW @ self.residuals(R, T, X)[:, :, None])[:, :, 0], self.n)
        return np.asarray(X + (N_inv @ b[:, :, None])[:, :, 0])

    def blocks(self, R: Array, T: Array, X: Array, newton: bool = True) -> Blocks:
        """Normal equations, Newton's or Gauss-Newton's: half the cost's negative gradient and second derivatives."""
        R_k, X_k, Y = R[self.frame], X[self.point], self.camera_points(R, T, X)
        Wr = (self.W_uv @ self.residuals(R, T, X)[:, :, None])[:, :, 0]
        J = self.rig.project_jacobian(Y)
        pull = (np.swapaxes(J, 1, 2) @ Wr[:, :, None])[:, :, 0]
        A, W = design(R_k, X_k), information(self.rig, Y, self.W_uv)
        b_p, b_X = np.einsum("kap,ka->kp", A, pull), np.einsum("kab,ka->kb", R_k, pull)
        if not newton:
            return replace(normal_blocks(A, R_k, W, np.zeros_like(pull)), b_p=b_p, b_X=b_X)
        blocks = normal_blocks(A, R_k, W - projection_curvature(self.rig, Y, Wr), np.zeros_like(pull))
        a = (R_k @ X_k[:, :, None])[:, :, 0]
        ga = -pull[:, :, None] * a[:, None, :]
        N_pp, N_pX = blocks.N_pp.copy(), blocks.N_pX.copy()
        N_pp[:, :3, :3] += (ga + np.swapaxes(ga, 1, 2)) / 2 + np.sum(pull * a, axis=1)[:, None, None] * np.eye(3)
        N_pX[:, :3] += hat(pull) @ R_k
        return Blocks(N_pp, N_pX, blocks.N_XX, b_p, b_X)


def projection_curvature(rig: StereoRig, p: Float[Array, "k 3"], s: Float[Array, "k 4"]) -> Float[Array, "k 3 3"]:
    """sum_c s_c H_c over the image coordinates, H_c the Hessian of the ideal projection at p (left camera frame)."""
    R = rig.T_rl.R
    right = _camera_curvature(rig.right, rig.T_rl.apply(p), s[:, 2:])
    return np.asarray(_camera_curvature(rig.left, p, s[:, :2]) + R.T @ right @ R)


def _camera_curvature(camera: Camera, p: Array, s: Array) -> Array:
    q, z = s @ camera.K[:2, :2], p[:, 2:]
    H = np.zeros((len(p), 3, 3))
    H[:, :2, 2] = H[:, 2, :2] = -q / z**2
    H[:, 2, 2] = 2 * np.sum(q * p[:, :2], axis=1) / z[:, 0] ** 3
    return H


@dataclass(frozen=True, eq=False)
class _System:
    """The reduced normal equations of the poses with what is known of them: rhs (6m,), free (6m, f) or None, and the
    pseudo-observations with the weights they have in this step."""

    spectrum: Spectrum
    rhs: Float[Array, "p"]
    free: Float[Array, "p f"] | None
    conditions: Conditions | None
    P: Float[Array, "q q"]

    @staticmethod
    def of(S: Array, rhs: Array, scale: Array, R: Array, T: Array, conditions: Conditions | None) -> _System:
        if conditions is None:
            return _System(spectrum(S, scale, null_space(R)), rhs, None, None, np.zeros((0, 0)))
        known, G, free = conditions.pseudo_observations(R, T), conditions.null_space(R), conditions.free
        N = known.J.T @ known.P @ known.J
        S, rhs, scale = S + N, rhs - known.J.T @ known.P @ known.e, np.sqrt(scale**2 + np.diag(N))
        if free is None:
            return _System(spectrum(S, scale, G), rhs, None, conditions, known.P)
        scale = np.sqrt((free * free).T @ scale**2)
        return _System(spectrum(free.T @ S @ free, scale, free.T @ G), rhs, free, conditions, known.P)

    def cost(self, R: Array, T: Array) -> float:
        """Share of the pseudo-observations."""
        if self.conditions is None:
            return 0.0
        e = self.conditions.pseudo_observations(R, T).e
        return float(e @ self.P @ e)

    def step(self, damping: float) -> Float[Array, "p"]:
        if self.free is None:
            return self.spectrum.solve(self.rhs, damping)
        return np.asarray(self.free @ self.spectrum.solve(self.free.T @ self.rhs, damping))

    def covariance(self) -> Float[Array, "p p"]:
        """Of the poses; zero rows where fixed conditions leave no freedom."""
        C = self.spectrum.inverse()
        return C if self.free is None else np.asarray(self.free @ C @ self.free.T)


def adjust_images(
    problem: ImageProblem,
    start: Solution,
    stop: Stop = "decrement",
    tolerance: float = 1e-6,
    max_iterations: int = 50,
    conditions: Conditions | None = None,
) -> Solution:
    """Newton's method over poses and points at once, damped where a step does not lower the cost (2.2.6).

    start: an object-space solution under the same conditions, near enough for the residuals to be noise. The weights of
    the result are those of the points, J' W_uv J, as `motion_covariance` takes them; stop as in `adjust`.

    Raises
        SingularSystem: the tracks do not determine the motion, or the iterations did not converge.
    """
    R, T, X, damping = start.R, start.T, start.X, 0.0
    for iteration in range(1, max_iterations + 1):
        blocks = problem.blocks(R, T, X, iteration > _GAUSS_NEWTON_STEPS)
        reduced = reduce_points(problem.frame, problem.point, blocks, problem.m, problem.n)
        scale = np.sqrt(np.abs(np.einsum("tpp->tp", sum_by(problem.frame, blocks.N_pp, problem.m)))).ravel()
        system = _System.of(reduced.S, reduced.rhs, scale, R, T, conditions)
        cost = problem.cost(R, T, X) + system.cost(R, T)
        for _ in range(_TRIES):
            dp = system.step(damping)
            d = dp.reshape(-1, 6)
            R_new, T_new = exp_so3(d[:, :3]) @ R, T + d[:, 3:]
            X_new = problem.improved_points(R_new, T_new, X + reduced.points(dp))
            cost_new = problem.cost(R_new, T_new, X_new) + system.cost(R_new, T_new)
            if cost_new <= cost * (1 + 1e-12) + 1e-12:
                break
            damping = max(10 * damping, 1e-6)
        else:
            raise SingularSystem("no step decreases the cost")
        R, T, X, cost = R_new, T_new, X_new, cost_new
        if damping > 1e-7:
            damping /= 10
            continue
        damping = 0.0
        if stop == "decrement":
            change = float(system.rhs @ system.step(0.0) + np.sum(reduced.b_X * reduced.points(0 * dp)))
        elif stop == "update":
            change = float(np.abs(dp).max())
        elif system.spectrum.values[0] <= 0:
            continue
        else:
            sigma = np.sqrt(np.diag(system.covariance()))
            change = float(np.max(np.abs(dp[sigma > 0]) / sigma[sigma > 0]))
        if change < tolerance:
            W = information(problem.rig, problem.camera_points(R, T, X), problem.W_uv)
            return Solution(R, T, X, W, cost, start.iterations + iteration)
    raise SingularSystem(f"no convergence within {max_iterations} iterations")
