"""Bundle adjustment in image space, the yardstick of the object-space variants.

    uv_it + v_it = pi(R_t X_i + T_t),   linearised  dl + v = J [-S(R X)  I] [dr_t; dT_t] + J R_t dX_i

pi projects into both images, J is its Jacobian (4 x 3). All four coordinates enter with their covariance; no
triangulation stands between, so nothing of its bias and of the weights' question (Siegemund 2008, 4.1.2-4.1.3) either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from estimators.gauss_markov import SingularSystem, normal_blocks, reduce_points, spectrum, sum_by
from estimators.stereo.object_motion import Solution, Stop, design, null_space
from estimators.stereo.triangulation import information
from sim.camera import StereoRig
from sim.pose import exp_so3

Array = np.ndarray
_TRIES = 14


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

    def jacobians(self, R: Array, T: Array, X: Array) -> tuple[Float[Array, "k 4 6"], Float[Array, "k 4 3"]]:
        """Derivatives of the projections by the pose of their frame and by their point."""
        R_k = R[self.frame]
        J = self.rig.project_jacobian(self.camera_points(R, T, X))
        return J @ design(R_k, X[self.point]), J @ R_k

    def residuals(self, R: Array, T: Array, X: Array) -> Float[Array, "k 4"]:
        """Observed minus projected coordinates; NaN behind the cameras."""
        return np.asarray(self.uv - self.rig.project(self.camera_points(R, T, X)))

    def cost(self, R: Array, T: Array, X: Array) -> float:
        v = self.residuals(R, T, X)
        return float(np.einsum("ka,kab,kb->", v, self.W_uv, v))


def adjust_images(
    problem: ImageProblem,
    start: Solution,
    stop: Stop = "decrement",
    tolerance: float = 1e-6,
    max_iterations: int = 50,
) -> Solution:
    """Gauss-Newton over poses and points at once, damped where a step does not lower the cost (2.2.6).

    start: an object-space solution, near enough for the residuals to be noise. The weights of the result are those of
    the points, J' W_uv J, as `motion_covariance` takes them. Stop criteria as in `object_motion.adjust`.

    Raises
        SingularSystem: the tracks do not determine the motion, or the iterations did not converge.
    """
    R, T, X, damping = start.R, start.T, start.X, 0.0
    cost = problem.cost(R, T, X)
    for iteration in range(1, max_iterations + 1):
        A, B = problem.jacobians(R, T, X)
        blocks = normal_blocks(A, B, problem.W_uv, problem.residuals(R, T, X))
        reduced = reduce_points(problem.frame, problem.point, blocks, problem.m, problem.n)
        scale = np.sqrt(np.einsum("tpp->tp", sum_by(problem.frame, blocks.N_pp, problem.m))).ravel()
        system = spectrum(reduced.S, scale, null_space(R))
        for _ in range(_TRIES):
            dp = system.solve(reduced.rhs, damping)
            d = dp.reshape(-1, 6)
            R_new, T_new, X_new = exp_so3(d[:, :3]) @ R, T + d[:, 3:], X + reduced.points(dp)
            cost_new = problem.cost(R_new, T_new, X_new)
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
            change = float(reduced.rhs @ system.solve(reduced.rhs) + np.sum(reduced.b_X * reduced.points(0 * dp)))
        elif stop == "update":
            change = float(np.abs(dp).max())
        else:
            change = float(np.max(np.abs(dp) / np.sqrt(np.diag(system.inverse()))))
        if change < tolerance:
            W = information(problem.rig, problem.camera_points(R, T, X), problem.W_uv)
            return Solution(R, T, X, W, cost, start.iterations + iteration)
    raise SingularSystem(f"no convergence within {max_iterations} iterations")
