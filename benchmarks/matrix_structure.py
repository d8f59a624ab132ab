"""The matrices of Siegemund 2008, Appendix C, of two adjustments with smoothing and a known axis of rotation.

Left 6 points in 3 frames; right 10 frames with 120 points in each on average, of tracks that come and go. A car turns
20 m away. Its motion is smoothed within the window and tied to the last one in the first frames (4.2.3), its axis of
rotation a condition (3.6). Unknowns are the source's: points first, rotations about the camera. The datum has one
column: the turn that axis and ties leave open, where the source puts all six beside them.

    python -m benchmarks.matrix_structure --out DIR
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from estimators.bordered import BorderedSystem
from estimators.stereo.conditions import RotationAxis, Smoothing, of_window
from estimators.stereo.depth_bias import observation_model
from estimators.stereo.full_system import about_camera, linearise, weighted
from estimators.stereo.initial_values import points_by_mean
from estimators.stereo.object_motion import Problem
from estimators.stereo.triangulation import triangulate
from reports.figures.structure import MATRICES, structure
from sim.camera import Camera, StereoRig
from sim.pose import exp_so3

RIG = StereoRig.normal_case(Camera.simple((1024, 768), 1000.0), 0.3)
SIGMA_PX, RATE_HZ = 0.2, 25.0
AXIS_C = (0.02, 1.0, -0.05)  # of the ground before a camera that is not quite level


def system(m: int, n: int, tied: int, life: int | None = None, seed: int = 0) -> BorderedSystem:
    """The linearised window of n points in m frames; life: frames a track lives, None for all."""
    rng = np.random.default_rng(seed)
    X, t = rng.uniform([-0.9, -0.7, -2.2], [0.9, 0.7, 2.2], (n, 3)), np.arange(m) / RATE_HZ
    R = exp_so3(np.multiply.outer(0.3 + 0.3 * t, np.array(AXIS_C) / np.linalg.norm(AXIS_C)))
    T = np.array([1.0, 0.5, 20.0]) - np.multiply.outer(10 * t, [0.1, 0.0, 1.0])
    born = np.zeros(n) if life is None else np.sort(rng.integers(2 - life, m - 1, n))
    frames = np.arange(m)[:, None]
    frame, point = np.nonzero((frames >= born) & (frames < born + (life or m)))
    uv = RIG.project(np.einsum("kab,kb->ka", R[frame], X[point]) + T[frame])
    uv = uv + SIGMA_PX * rng.standard_normal(uv.shape)
    cov = np.broadcast_to(np.eye(4) * SIGMA_PX**2, (len(frame), 4, 4))
    l, C = triangulate(RIG, uv, cov)
    problem = Problem(frame, point, l, observation_model(RIG, l, C, np.linalg.inv(cov), "estimated", True), m, n)
    (R, T), conditions = of_window(Smoothing("velocity"), RotationAxis("fixed", axis_c=AXIS_C), t, None, (R, T), tied)
    X = points_by_mean(problem, R, T)
    return about_camera(linearise(weighted(problem, R, T, X, conditions), R, T, X), T)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    small, large = system(3, 6, 1), system(10, 232, 3, 8)
    for name in MATRICES:
        rows, columns = getattr(large, name).shape
        print(f"{name:<5} {rows:>5} x {columns:<5} nz = {getattr(large, name).nnz}")
    figure = structure(small, large)
    for kind in ("png", "svg"):
        figure.savefig(out / f"structure.{kind}", dpi=300)


if __name__ == "__main__":
    main()
