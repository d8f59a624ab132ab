"""Time and accuracy of orthorectification: an ARGOS frame from 1400 m, an ANTAR frame from 500 m, over hills.

The fast map beside the exact one: time of a whole ortho image, and how far the map is off inside the image.

    python -m benchmarks.ortho [--rounds N]
"""

from __future__ import annotations

import argparse
import time

import cv2
import numpy as np

from estimators.aerial.orthorectify import METHODS, ground_sampling, image_map, orthorectify
from sim.camera import Camera
from sim.pose import Pose, exp_so3
from sim.terrain import ElevationGrid

Array = np.ndarray
LENS = np.array([-0.08, 0.05, 2e-4, -1e-4, 0.01])
SYSTEMS = {
    "ARGOS": (Camera(np.array([[6933, 0.5, 2495], [0, 6930, 1663], [0, 0, 1.0]]), (4992, 3328), LENS), 1400.0, 3),
    "ANTAR": (Camera(np.array([[1800, 0.1, 510], [0, 1799, 512], [0, 0, 1.0]]), (1024, 1024), LENS), 500.0, 1),
}
SPACING_M = 90.0


def hills(rms_m: float) -> ElevationGrid:
    """Relief with the spacing of SRTM and a standard deviation [m], some 300 m from hill to hill."""
    rng = np.random.default_rng(1)
    relief = cv2.GaussianBlur(rng.standard_normal((61, 61)), (0, 0), 1.5)
    half = 30 * SPACING_M
    return ElevationGrid(rms_m * relief / relief.std(), (-half, -half), SPACING_M)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    terrain = hills(10.0)
    R = np.diag([1.0, -1, -1]) @ exp_so3(np.array([0.03, -0.02, 0.0]))
    for name, (camera, height_m, channels) in SYSTEMS.items():
        T_wc = Pose(R, np.array([0.0, 0.0, height_m]))
        image = np.random.default_rng(2).integers(0, 255, (*camera.size_px[::-1], channels), dtype=np.uint8)
        gsd_m = ground_sampling(height_m, camera)
        seconds: dict[str, list[float]] = {m: [] for m in METHODS}
        for _ in range(rounds + 1):
            for method in METHODS:
                started = time.perf_counter()
                grid = orthorectify(image, camera, T_wc, terrain, gsd_m, method).grid
                seconds[method].append(time.perf_counter() - started)
        fast, exact = (image_map(camera, T_wc, terrain, grid, m) for m in ("map", "exact"))
        error = np.linalg.norm(fast - exact, axis=-1)[camera.contains(exact)]
        print(f"{name}: {grid.columns} x {grid.rows} at {gsd_m:.3f} m")
        for method in METHODS:
            print(f"  {method:8s}{np.median(seconds[method][1:]):8.3f} s")
        print(f"  map against exact: p99 {np.percentile(error, 99):.4f} px, max {error.max():.4f} px")


if __name__ == "__main__":
    main()
