"""How every disturbance looks at three levels, what it does to corners and tracks on the car, and what a frame costs.

    python -m benchmarks.disturbances [--pictures DIR] [--only KEY ...]

The scene is four frames of the scenario "oncoming", the car 20 m away, with a low sun ahead for glare; for reflections
and shadow edges, which wander over a flank, four of "crossing". Per key and level: Shi-Tomasi corners on the car above
a fixed strength; the local standard deviation on it (windows of 15 px) against the undisturbed; the share of those
corners that Lucas-Kanade, started at the truth, follows into the next frame and into the right image to within half a
pixel of the truth; and the processor time of a stereo frame from drawing to grey values, least of three, also against
the undisturbed.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from scenarios import spec
from scenarios.footage import exposed, item_poses, items, shows_target, views
from sim.render import PRODUCTS, View, optical_flow
from sim.scenario import Scenario
from sim.world import World, build_world

Array = np.ndarray
FRAMES = 4
LEVELS: dict[str, tuple[float, ...]] = {
    "contrast": (0.3, 0.6, 1.0),
    "glare": (0.1, 0.33, 1.0),
    "reflections": (0.3, 0.6, 1.0),
    "shadows": (0.3, 0.6, 1.0),
    "dirt": (0.3, 0.6, 1.0),
    "rain": (0.1, 0.4, 1.0),
    "wiper_s": (0.8, 1.0, 1.5),
    "exposure_ms": (5.0, 15.0, 40.0),
    "exposure_step_ev": (0.5, 1.5, 3.0),
    "occluders": (1, 2, 4),
}
NEARER = "vehicle.0.motion.start_m=[-3.5, 58.0]"
# Scenario, first frame, settings.
ONCOMING = ("oncoming", 48, (NEARER,))
SCENES: dict[str, tuple[str, int, tuple[str, ...]]] = {
    "glare": ("oncoming", 48, (NEARER, "world.sun_azimuth_deg=-1", "world.sun_elevation_deg=14")),
    "reflections": ("crossing", 23, ()),
    "shadows": ("crossing", 23, ()),
    "wiper_s": ("oncoming", 49, (NEARER, "realism.rain=0.4")),
    "exposure_step_ev": ("oncoming", 45, (NEARER,)),
}
CLOSE = ("reflections", "shadows", "exposure_ms")  # to be seen on the car alone
WINDOW = 15


@dataclass(frozen=True, eq=False)
class Sequence:
    """Images (h, w, 3) per frame of both cameras, their truth, and the least processor time of a frame."""

    scenario: Scenario
    world: World
    pairs: list[tuple[View, View]]
    images: list[tuple[Array, Array]]
    seconds: float

    @staticmethod
    def of(name: str, start: int, *settings: str) -> Sequence:
        scenario = spec.read(name, settings)
        world = build_world(scenario)
        world = replace(world, t_s=world.t_s[start : start + FRAMES])
        pairs, images, seconds = [], [], []
        started = time.process_time()
        for k, pair in enumerate(views(scenario, world, PRODUCTS)):
            pairs.append(pair)
            images.append(exposed(scenario, world, k, pair))
            seconds.append(time.process_time() - started)
            started = time.process_time()
        return Sequence(scenario, world, pairs, images, min(seconds[1:]))

    def grey(self, k: int, side: int) -> Array:
        return np.asarray(cv2.cvtColor(self.images[k][side], cv2.COLOR_RGB2GRAY))

    def target(self, k: int) -> Array:
        return shows_target(self.scenario, self.pairs[k][0])


def corners(sequence: Sequence, k: int) -> Array:
    """Corners (n, 2) on the target."""
    grey, mask = sequence.grey(k, 0), sequence.target(k)
    strength = cv2.cornerMinEigenVal(grey.astype(np.float32) / 255, 3)
    peak = (strength == cv2.dilate(strength, np.ones((5, 5)))) & (strength > 3e-3) & mask
    v, u = np.nonzero(peak)
    return np.stack([u, v], axis=-1).astype(np.float32)


def contrast(sequence: Sequence, k: int) -> float:
    """Median local standard deviation on the target."""
    grey = sequence.grey(k, 0).astype(np.float32)
    mean, square = (cv2.blur(g, (WINDOW, WINDOW)) for g in (grey, grey * grey))
    deviation = np.sqrt(np.maximum(square - mean * mean, 0))[sequence.target(k)]
    return float(np.median(deviation)) if deviation.size else float("nan")


def followed(sequence: Sequence, k: int, other: Array, truth: Array, points: Array) -> list[float]:
    """Errors [px] of Lucas-Kanade from the true place, inf where lost."""
    if not len(points):
        return []
    found, ok, _ = cv2.calcOpticalFlowPyrLK(
        sequence.grey(k, 0),
        other,
        points,
        truth.astype(np.float32).copy(),
        winSize=(11, 11),
        maxLevel=1,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return list(np.where(ok.ravel() == 1, np.linalg.norm(found - truth, axis=1), np.inf))


def track_errors(sequence: Sequence) -> tuple[list[float], list[float]]:
    """Errors of all corners from frame to frame, and from left to right."""
    world, over_time, across = sequence.world, [], []
    ids = [i.instance for i in items(world)]
    for k in range(FRAMES - 1):
        points, (left, _) = corners(sequence, k), sequence.pairs[k]
        assert left.depth is not None
        assert left.instance is not None
        t0, t1 = world.t_s[k], world.t_s[k + 1]
        moved = optical_flow(
            left.depth,
            left.instance,
            world.rig.left,
            world.T_wc(t0),
            world.T_wc(t1),
            item_poses(world, t0),
            item_poses(world, t1),
            ids,
        )
        u, v = points.astype(int).T
        over_time += followed(sequence, k, sequence.grey(k + 1, 0), points + moved[v, u], points)
        p_c = world.rig.left.unproject(points.astype(float), left.depth[v, u].astype(float))
        across += followed(sequence, k, sequence.grey(k, 1), world.rig.project(p_c)[:, 2:], points)
    return over_time, across


def good(errors: list[float]) -> float:
    return float(np.mean(np.array(errors) < 0.5)) if errors else float("nan")


def close_up(sequence: Sequence, side: int, k: int) -> Array:
    """What surrounds the car, (216, 288, 3)."""
    image = sequence.images[k][side]
    h, w, _ = image.shape
    v, u = np.nonzero(sequence.target(1)) if sequence.target(1).any() else (np.array([400]), np.array([300]))
    column, row = int(np.clip(u.mean(), 144, w - 144)), int(np.clip(v.mean(), 108, h - 108))
    return image[row - 108 : row + 108, column - 144 : column + 144]


def sheet(key: str, sequences: dict[float, Sequence]) -> Array:
    """A row per level: left camera and its car; right camera and its car; left camera two frames later; BGR."""
    rows = []
    for level, s in sequences.items():
        cells = []
        for side, k in ((0, 1), (1, 1), (0, 3)):
            cells.append(cv2.resize(s.images[k][side], (512, 384), interpolation=cv2.INTER_AREA))
            cells.append(cv2.resize(close_up(s, side, k), (512, 384), interpolation=cv2.INTER_NEAREST))
        rows.append(labelled(np.hstack(cells), f"{key} = {level:g}", 0.8))
    return np.vstack(rows)


def strip(key: str, sequences: dict[float, Sequence]) -> Array:
    """One small picture of the left camera per level; BGR."""
    cells = []
    for level, s in sequences.items():
        image = close_up(s, 0, 1) if key in CLOSE else s.images[1][0]
        small = cv2.resize(image, (288, 216), interpolation=cv2.INTER_AREA)
        cells.append(labelled(small, f"{key} {level:g}", 0.5))
    return np.hstack(cells)


def labelled(image: Array, text: str, size: float) -> Array:
    """A copy of an RGB image as BGR with a line of text."""
    bgr = np.ascontiguousarray(image[:, :, ::-1])
    bgr[:26] = bgr[:26] // 4
    cv2.putText(bgr, text, (6, 19), cv2.FONT_HERSHEY_SIMPLEX, size, (0, 255, 255), 1, cv2.LINE_AA)
    return bgr


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=Path, help="folder for a sheet per key and an overview")
    parser.add_argument("--only", nargs="*", choices=list(LEVELS), default=list(LEVELS))
    args = parser.parse_args()
    print(
        f"{'key':18s}{'level':>6s}{'corners':>9s}{'contrast':>10s}{'in time':>9s}{'across':>8s}{'cpu s':>9s}{'x':>6s}"
    )
    strips = []
    for key in args.only:
        name, start, settings = SCENES.get(key, ONCOMING)
        plain = Sequence.of(name, start, *(x for x in settings if not x.startswith("realism")))
        sequences = {0.0: plain}
        sequences |= {x: Sequence.of(name, start, *settings, f"realism.{key}={x:g}") for x in LEVELS[key]}
        for level, s in sequences.items():
            n = np.mean([len(corners(s, k)) for k in range(FRAMES)])
            share = np.mean([contrast(s, k) / contrast(plain, k) for k in range(FRAMES)])
            in_time, across = (good(e) for e in track_errors(s))
            seen = f"{key:18s}{level:6g}{n:9.1f}{share:10.2f}{in_time:9.2f}{across:8.2f}"
            print(f"{seen}{s.seconds:9.2f}{s.seconds / plain.seconds:6.2f}", flush=True)
        if args.pictures:
            args.pictures.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(args.pictures / f"{key}.png"), sheet(key, sequences))
            strips.append(strip(key, sequences))
            cv2.imwrite(str(args.pictures / "overview.jpg"), np.vstack(strips), [cv2.IMWRITE_JPEG_QUALITY, 80])


if __name__ == "__main__":
    main()
