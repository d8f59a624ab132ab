"""The adjustment of one window against GTSAM, Ceres and SciPy, alternating in one process, all on one thread.

A car of 1.8 x 1.5 x 4.5 m at 30 m; tracks of 5 to 10 frames. Every solver starts unrotated from the centroid, carried
from frame to frame by the tracks they share: the centroids of each frame's own tracks jump where many come and go, and
lead into other minima. The start poses are given to all alike. Ours is timed from the triangulated points on:
observation model, packing, start points and all iterations to a Newton decrement of 1e-6, in a block of calls that
lasts about as long as a peer's; the peers their own solve alone. The first call of a block, which finds the caches full
of the peer's data, is stated as well. Ceres and SciPy minimise the same cost in object space with the weights of the
observed points; GTSAM's stereo factors the reprojection error. Each is compared with our optimum of the same cost.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/adjustment_speed.py [--repeats N] [--no-scipy]

GTSAM, Ceres and SciPy come with the extra `peers`; those not installed are left out.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from estimators.gauss_markov import SingularSystem, sum_by
from estimators.stereo.batch import adjust_batch
from estimators.stereo.depth_bias import Weights, observation_model
from estimators.stereo.image_space import ImageProblem, adjust_images
from estimators.stereo.initial_values import extrapolate, points_by_mean
from estimators.stereo.object_motion import Problem, Solution, adjust, design
from estimators.stereo.triangulation import triangulate
from sim.camera import Camera, StereoRig
from sim.pose import exp_so3, left_jacobian, log_so3

Array = np.ndarray
FOCAL_PX, BASE_M, SIGMA_PX, RATE_HZ = 1000.0, 0.3, 0.2, 25.0
RIG = StereoRig.normal_case(Camera.simple((1024, 768), FOCAL_PX), BASE_M)


@dataclass(frozen=True, eq=False)
class Window:
    """Observations of m frames and n tracks, triangulated."""

    frame: Array
    point: Array
    uv: Array
    l: Array
    C: Array
    W_uv: Array
    m: int
    n: int

    def problem(self, weights: Weights, second_order: bool) -> Problem:
        model = observation_model(RIG, self.l, self.C, self.W_uv, weights, second_order)
        return Problem(self.frame, self.point, self.l, model, self.m, self.n)

    def poses(self) -> tuple[Array, Array]:
        """Unrotated; the first centroid, moved on by the mean step of the tracks common to a frame and the next."""
        at = np.full((self.m + 1) * self.n, -1)
        at[self.frame * self.n + self.point] = np.arange(len(self.frame))
        following = at[(self.frame + 1) * self.n + self.point]
        common = np.flatnonzero(following >= 0)
        following = following[common]
        steps = sum_by(self.frame[following], self.l[following] - self.l[common], self.m)
        steps /= np.maximum(np.bincount(self.frame[following], minlength=self.m), 1)[:, None]
        T = self.l[self.frame == 0].mean(axis=0) + np.cumsum(steps, axis=0)
        return np.tile(np.eye(3), (self.m, 1, 1)), T

    def start(self) -> tuple[Array, Array, Array]:
        R, T = self.poses()
        return R, T, points_by_mean(self.problem("observed", False), R, T)

    def frames(self, first: int, count: int) -> Window:
        """Part of the frames, with the tracks seen at least twice there."""
        rows = (self.frame >= first) & (self.frame < first + count)
        rows &= (np.bincount(self.point[rows], minlength=self.n) >= 2)[self.point]
        seen, point = np.unique(self.point[rows], return_inverse=True)
        part = (self.uv[rows], self.l[rows], self.C[rows], self.W_uv[rows])
        return Window(self.frame[rows] - first, point, *part, count, len(seen))


def simulate(m: int, n: int, seed: int = 2) -> Window:
    rng = np.random.default_rng(seed)
    X = rng.uniform([-0.9, -0.75, -2.25], [0.9, 0.75, 2.25], (n, 3))
    t = np.arange(m) / RATE_HZ
    R = exp_so3(np.multiply.outer(0.1 + 0.2 * t, [0.0, 1.0, 0.0]))
    T = np.array([1.5, 0.8, 30.0]) + np.multiply.outer(t[::-1], [0.5, 0.0, 20.0])
    length = rng.integers(min(5, m), min(10, m) + 1, n)
    first = rng.integers(0, m - length + 1)
    frames = np.arange(m)[:, None]
    frame, point = np.nonzero((frames >= first) & (frames < first + length))
    p = np.einsum("kab,kb->ka", R[frame], X[point]) + T[frame]
    uv = RIG.project(p) + SIGMA_PX * rng.standard_normal((len(frame), 4))
    cov = np.broadcast_to(np.eye(4) * SIGMA_PX**2, (len(frame), 4, 4))
    l, C = triangulate(RIG, uv, cov)
    return Window(frame, point, uv, l, C, np.linalg.inv(cov), m, n)


def ours(
    w: Window, weights: Weights = "estimated", second_order: bool = True, start: tuple[Array, Array] | None = None
) -> Solution:
    """Cold start: everything after the triangulation."""
    return adjust(w.problem(weights, second_order), *(w.poses() if start is None else start))


def unfinished(w: Window, s: Solution) -> str:
    """How far a solution is from one iterated on until nothing moves."""
    end = adjust(w.problem("estimated", True), s.R, s.T, tolerance=1e-16)
    return deviation(w, s, end.R, end.T, end.X)


def timed(call: Callable[[], Any], clock: Callable[[], float] = time.process_time) -> tuple[float, Any]:
    start = clock()
    result = call()
    return (clock() - start) * 1e3, result


def deviation(w: Window, s: Solution, R: Array, T: Array, X: Array) -> str:
    """Largest difference of the gauge-free motion: points in the camera frame, rotation from the first frame on."""
    points = [np.einsum("kab,kb->ka", q[w.frame], x[w.point]) + t[w.frame] for q, t, x in ((s.R, s.T, s.X), (R, T, X))]
    turn = log_so3((s.R @ s.R[0].T) @ np.swapaxes(R @ R[0].T, 1, 2))
    return f"{np.abs(points[0] - points[1]).max() * 1e3:.4f} mm, {np.abs(turn).max() * 1e3:.5f} mrad"


class Scipy:
    """least_squares, trust region with a sparse Jacobian; object space, weights of the observed points."""

    name, packages = "SciPy", ("scipy",)

    def __init__(self, w: Window) -> None:
        self.w, self.ours = w, ours(w, "observed", False)
        self.R0, self.T0, self.X0 = w.start()
        self.root = np.swapaxes(np.linalg.cholesky(np.linalg.inv(w.C)), 1, 2)
        k = np.arange(3 * len(w.frame)).reshape(-1, 3, 1)
        columns = np.concatenate(
            [6 * w.frame[:, None] + np.arange(6), 6 * w.m + 3 * w.point[:, None] + np.arange(3)], axis=1
        )
        self.rows = np.broadcast_to(k, (*k.shape[:2], 9)).ravel()
        self.columns = np.broadcast_to(columns[:, None], (*k.shape[:2], 9)).ravel()

    def unpack(self, x: Array) -> tuple[Array, Array, Array]:
        d = x[: 6 * self.w.m].reshape(-1, 6)
        return exp_so3(d[:, :3]) @ self.R0, self.T0 + d[:, 3:], self.X0 + x[6 * self.w.m :].reshape(-1, 3)

    def residuals(self, x: Array) -> Array:
        R, T, X = self.unpack(x)
        v = np.einsum("kab,kb->ka", R[self.w.frame], X[self.w.point]) + T[self.w.frame] - self.w.l
        return np.asarray((self.root @ v[:, :, None]).ravel())

    def jacobian(self, x: Array) -> Any:
        R, _, X = self.unpack(x)
        A = design(R[self.w.frame], X[self.w.point])
        A[:, :, :3] = A[:, :, :3] @ left_jacobian(x[: 6 * self.w.m].reshape(-1, 6)[:, :3])[self.w.frame]
        J = self.root @ np.concatenate([A, R[self.w.frame]], axis=2)
        return scipy.sparse.csr_matrix((J.ravel(), (self.rows, self.columns)))

    def solve(self) -> tuple[float, Any]:
        x = np.zeros(6 * self.w.m + 3 * self.w.n)
        options: dict[str, Any] = {"x_scale": "jac", "tr_solver": "lsmr", "ftol": 1e-10, "xtol": 1e-10, "gtol": 1e-10}
        return timed(lambda: least_squares(self.residuals, x, self.jacobian, max_nfev=100, **options))

    def compare(self, result: Any) -> tuple[float, float, str]:
        return 2 * result.cost, self.ours.cost, deviation(self.w, self.ours, *self.unpack(result.x))


class Gtsam:
    """Levenberg-Marquardt on GenericStereoFactor3D: the reprojection error of u_left, u_right and the mean row."""

    name, packages = "GTSAM", ("gtsam",)

    def __init__(self, w: Window) -> None:
        import gtsam

        self.gtsam, self.w = gtsam, w
        pose, point = gtsam.symbol_shorthand.P, gtsam.symbol_shorthand.L
        R, T, X = w.start()
        T_oc = [gtsam.Pose3(gtsam.Rot3(R_t.T), -R_t.T @ T_t) for R_t, T_t in zip(R, T, strict=True)]
        sigmas = np.array([SIGMA_PX, SIGMA_PX, SIGMA_PX / np.sqrt(2)])
        noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
        K = gtsam.Cal3_S2Stereo(FOCAL_PX, FOCAL_PX, 0, RIG.left.K[0, 2], RIG.left.K[1, 2], BASE_M)
        self.graph, self.values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self.graph.add(gtsam.PriorFactorPose3(pose(0), T_oc[0], gtsam.noiseModel.Isotropic.Sigma(6, 1e-3)))
        for t, i, (u, v, u_r, v_r) in zip(w.frame.tolist(), w.point.tolist(), w.uv.tolist(), strict=True):
            seen = gtsam.StereoPoint2(u, u_r, (v + v_r) / 2)
            self.graph.add(gtsam.GenericStereoFactor3D(seen, noise, pose(t), point(i), K))
        for t in range(w.m):
            self.values.insert(pose(t), T_oc[t])
        for i in range(w.n):
            self.values.insert(point(i), X[i])
        images = ImageProblem(RIG, w.frame, w.point, w.uv, w.W_uv, w.m, w.n)
        self.ours = adjust_images(images, ours(w))
        # The rows' difference says nothing of the point: a constant of the cost.
        self.constant = float(np.sum((w.uv[:, 1] - w.uv[:, 3]) ** 2) / (2 * SIGMA_PX**2))

    def solve(self) -> tuple[float, Any]:
        parameters = self.gtsam.LevenbergMarquardtParams()
        parameters.setRelativeErrorTol(1e-9)
        parameters.setAbsoluteErrorTol(1e-9)
        optimizer = self.gtsam.LevenbergMarquardtOptimizer(self.graph, self.values, parameters)
        return timed(optimizer.optimize)

    def compare(self, result: Any) -> tuple[float, float, str]:
        pose, point = self.gtsam.symbol_shorthand.P, self.gtsam.symbol_shorthand.L
        T_oc = [result.atPose3(pose(t)) for t in range(self.w.m)]
        R = np.array([p.rotation().matrix().T for p in T_oc])
        T = np.array([-R_t @ p.translation() for R_t, p in zip(R, T_oc, strict=True)])
        X = np.array([result.atPoint3(point(i)) for i in range(self.w.n)])
        return 2 * self.graph.error(result), self.ours.cost - self.constant, deviation(self.w, self.ours, R, T, X)


class Ceres:
    """pycolmap's Point3DAlignmentCost; object space, weights of the observed points, similarity held to scale one."""

    name, packages = "Ceres", ("pyceres", "pycolmap")

    def __init__(self, w: Window) -> None:
        import pyceres

        self.ceres, self.w, self.ours = pyceres, w, ours(w, "observed", False)

    def _build(self) -> tuple[Any, list[Array], list[Array], list[Any]]:
        from pycolmap.cost_functions import Point3DAlignmentCost

        R, T, X = self.w.start()
        poses = [np.concatenate([Rotation.from_matrix(q).as_quat(), t, [1.0]]) for q, t in zip(R, T, strict=True)]
        points, problem, alive = list(X.copy()), self.ceres.Problem(), []
        for k, (t, i) in enumerate(zip(self.w.frame, self.w.point, strict=True)):
            cost = Point3DAlignmentCost(self.w.C[k], self.w.l[k], False)
            problem.add_residual_block(cost, None, [points[i], poses[t]])
        for block in poses[1:]:
            alive += [self.ceres.SubsetManifold(8, [7]), _unit_quaternion(self.ceres)]
            problem.set_manifold(block, alive[-2])
            problem.add_residual_block(alive[-1], None, [block])
        problem.set_parameter_block_constant(poses[0])
        return problem, poses, points, alive

    def solve(self) -> tuple[float, Any]:
        problem, poses, points, alive = self._build()
        options, summary = self.ceres.SolverOptions(), self.ceres.SolverSummary()
        options.linear_solver_type = self.ceres.LinearSolverType.SPARSE_SCHUR
        options.max_num_iterations, options.num_threads = 100, 1
        options.function_tolerance, options.gradient_tolerance, options.parameter_tolerance = 1e-10, 1e-14, 1e-10
        options.logging_type = self.ceres.LoggingType.SILENT
        ms, _ = timed(lambda: self.ceres.solve(options, problem, summary))
        del alive
        return ms, (summary, poses, points)

    def compare(self, result: Any) -> tuple[float, float, str]:
        summary, poses, points = result
        R = Rotation.from_quat(np.array([p[:4] for p in poses])).as_matrix()
        T, X = np.array([p[4:7] for p in poses]), np.array(points)
        return 2 * summary.final_cost, self.ours.cost, deviation(self.w, self.ours, R, T, X)


def _unit_quaternion(ceres: Any) -> Any:
    """Cost that keeps the first four parameters a unit quaternion: the binding offers no such manifold in a product."""

    class UnitQuaternion(ceres.CostFunction):  # type: ignore[misc]  # the binding is untyped
        def __init__(self) -> None:
            super().__init__()
            self.set_num_residuals(1)
            self.set_parameter_block_sizes([8])

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
            q = parameters[0][:4]
            residuals[0] = 1e3 * (q @ q - 1)
            if jacobians is not None and jacobians[0] is not None:
                jacobians[0][:] = 0
                jacobians[0][:4] = 2e3 * q
            return True

    return UnitQuaternion()


def installed(peer: Any) -> bool:
    return all(importlib.util.find_spec(package) is not None for package in peer.packages)


# Calls of ours that last about as long as one of a peer.
BLOCK = 20


def against_peers(repeats: int, peers: list[Any]) -> None:
    for m, n in ((10, 120), (10, 500), (30, 500)):
        w = simulate(m, n)
        solvers, start = [peer(w) for peer in peers], w.poses()
        call = partial(ours, w, start=start)
        mine: list[float] = []
        first: list[float] = []
        theirs: list[list[float]] = [[] for _ in solvers]
        results: list[Any] = [None] * len(solvers)
        for _ in range(repeats):
            block = [timed(call)[0] for _ in range(BLOCK)]
            mine.append(float(np.median(block)))
            first.append(block[0])
            for j, solver in enumerate(solvers):
                ms, results[j] = solver.solve()
                theirs[j].append(ms)
        s = call()
        poses_ms = np.median([timed(w.poses)[0] for _ in range(BLOCK)])
        print(f"\n{m} frames x {n} tracks, {len(w.frame)} observations")
        print(f"  ours, cold start  {np.median(mine):9.2f} ms   {s.iterations} iterations")
        print(f"      first call after a peer {np.median(first):.2f} ms; start poses, not counted, {poses_ms:.2f} ms")
        print(f"      from the end of iterating {unfinished(w, s)}")
        for solver, ms, result in zip(solvers, theirs, results, strict=True):
            cost, own, motion = solver.compare(result)
            ratio = np.median(np.array(ms) / np.array(mine))
            print(f"  {solver.name:<16}  {np.median(ms):9.2f} ms   ratio {ratio:6.1f}")
            print(f"      its cost {cost:.6f}, ours {own:.6f}; motion differs by {motion}")


def warm_steps(repeats: int) -> None:
    """The window moved on by a frame, started from the last one's poses, against its cold start."""
    print("\nwarm step: Problem, extrapolation, adjustment; cold: Problem, start poses, adjustment")
    for m, n in ((10, 120), (10, 500), (30, 500)):
        sequence = simulate(m + 1, n)
        last, w = ours(sequence.frames(0, m)), sequence.frames(1, m)
        step, cold = partial(warm, w, last), partial(ours, w)
        ms = np.array([[timed(step)[0], timed(cold)[0]] for _ in range(BLOCK * repeats)])
        (t_warm, t_cold), ratio = np.median(ms, axis=0), np.median(ms[:, 0] / ms[:, 1])
        iterations = f"{step().iterations} and {cold().iterations} iterations"
        print(f"  {m:3d} x {n}: {t_warm:6.2f} ms, cold {t_cold:6.2f} ms, ratio {ratio:.2f}; {iterations}")


def warm(w: Window, last: Solution) -> Solution:
    t = np.arange(3) / RATE_HZ
    R, T = extrapolate(last.R[-2:], last.T[-2:], t[:2], t[2])
    start = np.concatenate([last.R[1:], R[None]]), np.concatenate([last.T[1:], T[None]])
    return ours(w, start=start)


def scaling(repeats: int) -> None:
    print("\ncold start over the number of tracks, 10 frames, start poses given")
    tracks = (120, 250, 500, 1000, 2000)
    windows = [simulate(10, n) for n in tracks]
    calls = [partial(ours, w, start=w.poses()) for w in windows]
    # Each in a block of its own: between others' its data would have left the caches.
    ms = np.array([[np.median([timed(call)[0] for _ in range(BLOCK)]) for call in calls] for _ in range(repeats)])
    k = np.array([len(w.frame) for w in windows])
    times, iterations = np.median(ms, axis=0), np.array([call().iterations for call in calls])
    for n, k_n, t, i in zip(tracks, k, times, iterations, strict=True):
        print(f"  {n:5d} tracks, {k_n:6d} observations: {t:7.2f} ms, {i} iterations")
    for what, few in (("120 to 2000", 0), ("500 to 2000", 2)):
        slope = np.polyfit(np.log(k[few:]), np.log(times[few:]), 1)[0]
        print(f"  slope of time over observations, {what} tracks: {slope:.2f}")
    per_observation, fixed = np.polyfit(k, times, 1, w=1 / times)
    worst = np.abs((fixed + per_observation * k) / times - 1).max()
    print(f"  {fixed * 1e3:.0f} us + {per_observation * 1e3:.3f} us an observation, off by {worst:.0%} at most")


def batch(repeats: int, runs: int = 200) -> None:
    """Independent windows from start values on; wall clock, for the threads share the process's time."""
    print(f"\n{runs} windows of 10 x 120 at once, start values given")
    windows = [simulate(10, 120, seed) for seed in range(runs)]
    problems, starts = [w.problem("estimated", True) for w in windows], [w.poses() for w in windows]
    rates: list[list[float]] = []
    results: list[list[Solution | SingularSystem]] = []
    for _ in range(repeats):
        rates.append([])
        results = []
        for threads in (1, 2):
            ms, solutions = timed(partial(adjust_batch, problems, starts, threads=threads), time.perf_counter)
            rates[-1].append(runs / ms * 1e3)
            results.append(solutions)
    one, two = np.median(rates, axis=0)
    pairs = [(a, b) for a, b in zip(*results, strict=True) if isinstance(a, Solution) and isinstance(b, Solution)]
    same = sum(np.array_equal(a.R, b.R) and np.array_equal(a.X, b.X) and a.cost == b.cost for a, b in pairs)
    print(f"  one thread {one:.0f} a second, two threads {two:.0f}, gain {two / one:.2f}")
    print(f"  {len(pairs)} converged, {same} of them bit for bit the same with both")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--no-scipy", action="store_true", help="leave out the slowest")
    arguments = parser.parse_args()
    peers = [peer for peer in (Gtsam, Ceres, Scipy) if installed(peer) and not (peer is Scipy and arguments.no_scipy)]
    packages = ["numpy", "numba", *(p for peer in peers for p in peer.packages)]
    versions = ", ".join(f"{p} {importlib.metadata.version(p)}" for p in packages)
    print(f"{platform.machine()}, Python {platform.python_version()}, {versions}")
    ours(simulate(10, 120))
    against_peers(arguments.repeats, peers)
    warm_steps(arguments.repeats)
    scaling(arguments.repeats)
    batch(arguments.repeats)


if __name__ == "__main__":
    main()
