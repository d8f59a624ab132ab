"""Time of aerial frames, and how their road and car regions compare with a real aerial image.

Slope of the radial power spectrum in windows over roads, and gradients at cars and at markings, at 0.13 m.

    python -m benchmarks.aerial_render [--real ../shared/design/pictures/real_aerial_13cm.png] [--seed N] [--save DIR]
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path

import cv2
import numpy as np

from sim.aerial import AerialScene, build, measure, render
from sim.aerial.exposure import CAMERA, expose
from sim.aerial.presets import PRESETS
from sim.camera import Camera
from sim.pose import Pose, exp_so3
from sim.roads import markings

Array = np.ndarray
REAL = Path(__file__).resolve().parent.parent.parent / "shared" / "design" / "pictures" / "real_aerial_13cm.png"
LENS = np.array([-0.08, 0.05, 2e-4, -1e-4, 0.01])
ARGOS = Camera(np.array([[6933, 0, 2495.5], [0, 6933, 1663.5], [0, 0, 1.0]]), (4992, 3328), LENS)
ANTAR = Camera.simple((1024, 1024), 2500.0)
# Where roads with cars, single cars and painted strokes are in the real image (column, row).
WINDOWS = ((160, 180), (240, 170), (330, 180), (60, 260), (160, 260), (330, 290), (420, 120), (470, 90), (100, 300))
CARS = (
    (381, 47), (452, 44), (515, 168), (274, 224), (265, 314), (480, 241), (128, 349), (94, 389), (180, 148), (151, 93),
    (604, 313), (612, 250), (644, 343), (373, 452), (599, 360), (583, 458),
)  # fmt: skip
STROKES = (
    (340, 239), (296, 262), (365, 228), (340, 294), (368, 281), (428, 212), (563, 133), (597, 147), (217, 100),
    (190, 60), (68, 417), (20, 432), (205, 352), (160, 380), (522, 191), (450, 430),
)  # fmt: skip
WINDOW_PX, CAR_PX, STROKE_PX = 128, 21, 9


def slope(grey: Array) -> float:
    """Exponent of the radial power spectrum between 1/32 and 0.4 cycles per pixel."""
    n = len(grey)
    window = np.outer(np.hanning(n), np.hanning(n))
    power = np.abs(np.fft.fft2((grey - grey.mean()) * window)) ** 2
    f = np.hypot(np.fft.fftfreq(n)[:, None], np.fft.fftfreq(n))
    edges = np.geomspace(1 / 32, 0.4, 15)
    k = np.digitize(f.ravel(), edges) - 1
    inside = (k >= 0) & (k < len(edges) - 1)
    mean = np.bincount(k[inside], power.ravel()[inside]) / np.bincount(k[inside])
    middle = np.bincount(k[inside], f.ravel()[inside]) / np.bincount(k[inside])
    return float(np.polyfit(np.log(middle), np.log(mean), 1)[0])


def gradients(grey: Array, at: Array, radius: int) -> Array:
    """The steepest gradients (95th percentile) [grey levels / px] around points (n, 2)."""
    gx, gy = (cv2.Sobel(grey, cv2.CV_32F, *d, ksize=3) / 8 for d in ((1, 0), (0, 1)))
    g = np.hypot(gx, gy)
    return np.array([np.quantile(g[v - radius : v + radius + 1, u - radius : u + radius + 1], 0.95) for u, v in at])


def windows(grey: Array, corners: Array) -> Array:
    return np.array([slope(grey[v : v + WINDOW_PX, u : u + WINDOW_PX]) for u, v in corners])


def inside(uv: Array, size: tuple[int, int], margin: int) -> Array:
    return np.asarray(((uv >= margin) & (uv < np.array(size) - margin - 1)).all(axis=1))


def figures(scene: AerialScene, rng: np.random.Generator, save: Path | None) -> dict[str, Array]:
    """Slopes and gradients of rendered images of junctions at 0.13 m."""
    roads, terrain = scene.world.roads, scene.world.terrain
    camera = Camera.simple((684, 547), 6933.0)
    strokes = np.array([m.line_m.mean(axis=0) for m in markings(roads)])
    out: dict[str, list[Array]] = {"slope": [], "cars": [], "markings": []}
    wide = [k for k in np.flatnonzero(roads.degree >= 4) if _class(scene, k) <= 3]
    for k in wide[:6]:
        ground = terrain.on_ground(roads.nodes_m[k])
        T_wc = Pose(np.diag([1.0, -1, -1]) @ exp_so3(rng.uniform(-0.04, 0.04, 3)), ground + np.array([0, 0, 901.0]))
        image = expose(render(scene, camera, T_wc, samples=2), CAMERA, rng)
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        truth = measure(scene, camera, T_wc)
        T_cw = T_wc.inv()
        cars = truth.vehicles.states.of(truth.vehicles.hidden < 0.1)
        at = np.round(camera.project(T_cw.apply(terrain.on_ground(cars.xy_m)))).astype(int)
        out["cars"].append(gradients(grey, at[inside(at, camera.size_px, CAR_PX)], CAR_PX))
        uv = camera.project(T_cw.apply(terrain.on_ground(strokes)))
        at = np.round(uv[inside(uv, camera.size_px, STROKE_PX)]).astype(int)
        at = at[truth.instance[at[:, 1], at[:, 0]] == -1]
        out["markings"].append(gradients(grey, at, STROKE_PX))
        middle = np.array(camera.size_px) // 2 - WINDOW_PX // 2
        out["slope"].append(windows(grey, middle + np.array([[0, 0], [-60, 0], [60, 0], [0, 60], [0, -60]])))
        if save is not None:
            cv2.imwrite(str(save / f"junction-{k}.png"), image[..., ::-1])
    return {name: np.concatenate(parts) for name, parts in out.items()}


def _class(scene: AerialScene, node: int) -> int:
    ends = scene.world.roads.ends
    return min(scene.world.roads.edges[e].road_class for e in np.flatnonzero((ends == node).any(axis=1)))


def times(scene: AerialScene, rng: np.random.Generator) -> None:
    centre = scene.world.roads.nodes_m.mean(axis=0)
    ground = scene.world.terrain.on_ground(centre)
    R = np.diag([1.0, -1, -1]) @ exp_so3(np.array([0.03, -0.02, 0.1]))
    for name, camera, height_m in (("ARGOS", ARGOS, 1400.0), ("ANTAR", ANTAR, 500.0)):
        T_wc = Pose(R, ground + np.array([0, 0, height_m]))
        for samples in (1, 2):
            seconds = []
            for _ in range(3):
                begun = time.perf_counter()
                image = render(scene, camera, T_wc, samples=samples)
                seconds.append(time.perf_counter() - begun)
            begun = time.perf_counter()
            expose(image, CAMERA, rng)
            exposed = time.perf_counter() - begun
            print(
                f"{name} {samples}x: first {seconds[0]:.2f} s (paints its ground), then {min(seconds[1:]):.2f} s; "
                f"sensor {exposed:.2f} s"
            )
        begun = time.perf_counter()
        measure(scene, camera, T_wc)
        print(f"{name} truth: {time.perf_counter() - begun:.2f} s")
    print(f"memory at most {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--real", type=Path, default=REAL)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--save", type=Path)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    begun = time.perf_counter()
    scene = build(PRESETS["inner-city-1"](arguments.seed))
    print(f"world {time.perf_counter() - begun:.1f} s, {len(scene.standing)} trees and buildings")
    times(scene, rng)
    real = cv2.imread(str(arguments.real), cv2.IMREAD_GRAYSCALE)
    if real is None:
        print(f"{arguments.real}: no picture to compare with")
        return
    ours = figures(scene, rng, arguments.save)
    theirs = {
        "slope": windows(real, np.array(WINDOWS)),
        "cars": gradients(real, np.array(CARS), CAR_PX),
        "markings": gradients(real, np.array(STROKES), STROKE_PX),
    }
    a, b = (float(np.mean(x["slope"])) for x in (ours, theirs))
    print(f"slope of the power spectrum: {a:.2f}, real {b:.2f}, difference {a - b:+.2f}")
    for name in ("cars", "markings"):
        a, b = (float(np.median(x[name])) for x in (ours, theirs))
        print(f"edges of {name}: {a:.1f} levels/px, real {b:.1f}, factor {a / b:.2f} ({len(ours[name])} places)")


if __name__ == "__main__":
    main()
