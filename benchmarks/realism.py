"""How close the rendered pictures come to real ones: texture statistics of a car and of the road, real beside rendered.

    python -m benchmarks.realism PATH_TO_LEAD_CAR [--pictures DIR]

PATH_TO_LEAD_CAR holds KITTI's frames 0-12 of a dark car that crosses ahead (``left/000000.png`` ..., ``poses.txt``).
The bench renders a comparable sequence: the same camera, the same ego motion, a dark car of the same size on the path
measured from the real stereo pairs. Measures per region: slope of the radially averaged power spectrum, Shi-Tomasi
corners per 1000 px, mean life of KLT tracks in frames. Must hold: slope within 0.3, the others within a factor of 1.5.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cache, partial
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from sim.camera import Camera
from sim.meshes import make_vehicle
from sim.pose import R_WORLD_FROM_LEVEL_CAMERA, Pose, exp_so3, rot_z, vehicle_rotation
from sim.render import Item, Light, Renderer
from sim.roadside import build_roadside
from sim.sensor import Sensor, expose
from sim.streams import stream

Array = np.ndarray
Carry = Callable[[Array, int, int], Array]

FRAMES = 13
CAMERA = Camera(np.array([[718.856, 0, 607.1928], [0, 718.856, 185.2157], [0, 0, 1.0]]), (1241, 376))
# The road in the camera frame, ``DOWN . p = HEIGHT_M``: the plane that best carries one real frame into the next.
DOWN, HEIGHT_M = np.array([0.0, 0.9992, 0.040]), 1.76
CAR_INSTANCE = 100
# The car in the real frames 0-12, boxed by hand: left, top, right, bottom [px].
CAR_BOXES = np.array(
    [[712, 150, 839, 197], [746, 152, 876, 199], [779, 153, 914, 202], [813, 155, 951, 204], [847, 157, 986, 206],
     [880, 158, 1022, 208], [914, 160, 1057, 210], [944, 161, 1083, 210], [973, 161, 1109, 211], [1003, 162, 1135, 211],
     [1021, 162, 1146, 210], [1039, 162, 1158, 209], [1049, 162, 1162, 209]]
)  # fmt: skip
# Its middle on the ground in the first camera's frame (right, forward) [m], from the disparity of the boxes, smoothed.
CAR_PATH = np.stack([7.0 + 2.54 * np.arange(FRAMES), 30.0 - 0.02 * np.arange(FRAMES) ** 2], axis=-1)
CAR_SIZE_M = (4.63, 1.81, 1.72)
# The blur of the real images: the tenth percentile of their step edges is as wide as ours at this value.
SENSOR = Sensor(grey=True, blur_px=0.7)
ROAD_BOX = (800, 255, 980, 325)
STARTS, LIFE = 7, 6


@dataclass(frozen=True)
class Measures:
    """Texture statistics of one region over the sequence."""

    slope: float
    corners: float
    life: float
    mean: float
    contrast: float


def spectrum_slope(crops: list[Array]) -> float:
    """Slope of log power over log frequency, 0.04-0.35 cycles/px, mean over the frames."""
    edges = np.geomspace(0.04, 0.35, 9)
    power = []
    for crop in crops:
        h, w = crop.shape
        window = np.hanning(h)[:, None] * np.hanning(w)
        field = (crop - crop.mean()) * window
        P = np.abs(np.fft.fft2(field)) ** 2 / (window**2).sum()
        f = np.hypot(np.fft.fftfreq(h)[:, None], np.fft.fftfreq(w))
        power.append([P[(f >= a) & (f < b)].mean() for a, b in pairwise(edges)])
    middle = np.sqrt(edges[:-1] * edges[1:])
    return float(np.polyfit(np.log(middle), np.log(np.mean(power, axis=0)), 1)[0])


def find_corners(image: Array, box: Array) -> Array:
    """Shi-Tomasi corners (n, 2) in a box, the quality relative to the box's best."""
    x0, y0, x1, y1 = box
    found = cv2.goodFeaturesToTrack(image[y0:y1, x0:x1], 0, 0.03, 3, blockSize=3)
    if found is None:
        return np.zeros((0, 2), np.float32)
    return np.asarray(found.reshape(-1, 2) + np.array([x0, y0]), np.float32)


def carried_by_box(boxes: Array) -> Carry:
    """Prediction of image points by the motion and scale of their region's box."""

    def carry(points: Array, k: int, to: int) -> Array:
        a, b = boxes[k].astype(float), boxes[to].astype(float)
        return np.asarray((points - a[:2]) * (b[2:] - b[:2]) / (a[2:] - a[:2]) + b[:2])

    return carry


def carried_by_road(T_wc: Pose) -> Carry:
    """Prediction of image points of the road plane by the ego motion."""

    def carry(points: Array, k: int, to: int) -> Array:
        ray = np.concatenate([CAMERA.normalise(points), np.ones((len(points), 1))], axis=1)
        p = ray * (HEIGHT_M / (ray @ DOWN))[:, None]
        return CAMERA.project((T_wc[to].inv() @ T_wc[k]).apply(p))

    return carry


def aligned(carry: Carry, images: list[Array], boxes: Array) -> Carry:
    """The prediction with the whole-pixel shift added that fits the region's texture best.

    Boxes and road plane are good to a pixel or two only, and what is compared is texture, not their accuracy.
    """
    reach = 6

    def texture(image: Array) -> Array:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.7) - cv2.GaussianBlur(image, (0, 0), 4), np.float32)

    @cache
    def shift(k: int, to: int) -> Array:
        x0, y0, x1, y1 = boxes[k]
        u, v = np.meshgrid(np.arange(x0 - reach, x1 + reach), np.arange(y0 - reach, y1 + reach))
        at = (
            carry(np.stack([u.ravel(), v.ravel()], axis=-1).astype(float), k, to)
            .reshape(*u.shape, 2)
            .astype(np.float32)
        )
        there = texture(cv2.remap(images[to].astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_CUBIC))
        score = cv2.matchTemplate(there, texture(images[k][y0:y1, x0:x1].astype(np.float32)), cv2.TM_CCOEFF_NORMED)
        row, column = np.unravel_index(int(np.argmax(score)), score.shape)
        return np.array([column - reach, row - reach], float)

    return lambda points, k, to: carry(points + shift(k, to), k, to)


_KLT = partial(
    cv2.calcOpticalFlowPyrLK,
    winSize=(15, 15),
    maxLevel=0,
    criteria=(3, 30, 0.01),
    flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
)


def track_life(images: list[Array], boxes: Array, carry: Carry) -> float:
    """Mean number of frames, at most LIFE, that KLT follows a corner: forward and back within half a pixel.

    The local mean is taken off first: in the real frames it drifts by a tenth per frame with the sun's glare.
    """
    flat = [im.astype(np.float32) for im in images]
    images = [np.clip(im - cv2.GaussianBlur(im, (0, 0), 8) + 128, 0, 255).astype(np.uint8) for im in flat]
    lives = []
    for start in range(STARTS):
        points = find_corners(images[start], boxes[start])
        life = np.zeros(len(points))
        alive = np.arange(len(points))
        for k in range(start, min(start + LIFE, len(images) - 1)):
            if not len(points):
                break
            guess = carry(points, k, k + 1).astype(np.float32)
            there, ok, _ = _KLT(images[k], images[k + 1], points, guess)
            guess = carry(there, k + 1, k).astype(np.float32)
            back, ok_back, _ = _KLT(images[k + 1], images[k], there, guess)
            h, w = images[k].shape
            good = (ok.ravel() == 1) & (ok_back.ravel() == 1) & (np.linalg.norm(back - points, axis=1) < 0.5)
            good &= np.all((there > 2) & (there < [w - 3, h - 3]), axis=1)
            alive, points = alive[good], there[good]
            life[alive] += 1
        lives.append(life)
    return float(np.concatenate(lives).mean())


def measure(images: list[Array], boxes: Array, carry: Carry) -> Measures:
    """All measures of the region ``boxes`` (frames, 4) of grey images."""
    crops = [im[y0:y1, x0:x1].astype(float) for im, (x0, y0, x1, y1) in zip(images, boxes, strict=True)]
    counts = [len(find_corners(im, box)) / crop.size * 1000 for im, box, crop in zip(images, boxes, crops, strict=True)]
    return Measures(
        spectrum_slope(crops),
        float(np.mean(counts)),
        track_life(images, boxes, carry),
        float(np.mean([c.mean() for c in crops])),
        float(np.mean([c.std() for c in crops])),
    )


def ego_poses(path: Path) -> Pose:
    """The real ego motion over a level road: camera poses in the world frame."""
    P = np.loadtxt(path).reshape(-1, 3, 4)[:FRAMES]
    yaw = np.arctan2(P[:, 0, 2], P[:, 2, 2])
    t = np.stack([P[:, 0, 3], P[:, 2, 3], np.full(FRAMES, HEIGHT_M)], axis=-1)
    pitch = exp_so3(np.array([-np.arctan2(DOWN[2], DOWN[1]), 0, 0]))
    return Pose(rot_z(-yaw) @ R_WORLD_FROM_LEVEL_CAMERA @ pitch, t)


def render_sequence(T_wc: Pose, seed: int) -> tuple[list[Array], Array]:
    """Grey images and the car's boxes (frames, 4) of a comparable rendered sequence."""
    world = build_roadside(stream(seed, 0, "world"), lanes=1, lane_m=22.0, crossing_y=31.0, houses=False)
    car = make_vehicle("estate", stream(seed, 0, "car"), CAR_SIZE_M, "black")
    light = Light.daylight(azimuth_deg=15.0, elevation_deg=30.0, strength=2.2, ambient=0.3)  # low sun ahead, dark woods
    items = [Item(model, k + 1) for k, (_, model, _) in enumerate(world)] + [Item(car, CAR_INSTANCE)]
    velocity = np.gradient(CAR_PATH, axis=0)
    heading = np.arctan2(velocity[:, 0], velocity[:, 1])
    rng = stream(seed, 0, "sensor")
    images, boxes = [], []
    with Renderer(items, light) as renderer:
        for k in range(FRAMES):
            R = vehicle_rotation(heading[k])
            middle = R @ [car.size_m[0] / 2 - car.rear_overhang_m, 0, 0]
            T_wv = Pose(R, np.array([*CAR_PATH[k], 0.0]) - middle)
            view = renderer.render(CAMERA, T_wc[k], [*(pose for *_, pose in world), T_wv])
            assert view.color is not None
            assert view.instance is not None
            images.append(expose(view.color, SENSOR, rng))
            v, u = np.nonzero(view.instance == CAR_INSTANCE)
            boxes.append([u.min(), v.min(), u.max() + 1, v.max() + 1])
    return images, np.array(boxes)


def measure_regions(images: list[Array], car_boxes: Array, T_wc: Pose) -> dict[str, Measures]:
    """Measures of the car and of the road in one sequence."""
    road = np.tile(ROAD_BOX, (FRAMES, 1))
    return {
        "car": measure(images, car_boxes, aligned(carried_by_box(car_boxes), images, car_boxes)),
        "road": measure(images, road, aligned(carried_by_road(T_wc), images, road)),
    }


def compare(data: Path, seeds: int, pictures: Path | None = None) -> list[tuple[str, str, float, float, bool | None]]:
    """(region, measure, real, mean over the rendered seeds, whether it holds) for every measure."""
    real = [np.asarray(cv2.imread(str(data / f"left/{k:06d}.png"), cv2.IMREAD_GRAYSCALE)) for k in range(FRAMES)]
    T_wc = ego_poses(data / "poses.txt")
    found = measure_regions(real, CAR_BOXES, T_wc)
    ours = []
    for seed in range(1, seeds + 1):
        rendered, boxes = render_sequence(T_wc, seed)
        ours.append(measure_regions(rendered, boxes, T_wc))
        if pictures and seed == 1:
            save_pictures(pictures, real, rendered, boxes)
    rows: list[tuple[str, str, float, float, bool | None]] = []
    for region, a in found.items():
        mean = {f.name: float(np.mean([getattr(o[region], f.name) for o in ours])) for f in fields(Measures)}
        rows += [
            (region, "spectrum slope", a.slope, mean["slope"], abs(a.slope - mean["slope"]) <= 0.3),
            (region, "corners per 1000 px", a.corners, mean["corners"], within_factor(a.corners, mean["corners"])),
            (region, "mean KLT life [frames]", a.life, mean["life"], within_factor(a.life, mean["life"])),
            (region, "mean grey (not judged)", a.mean, mean["mean"], None),
            (region, "grey deviation (not judged)", a.contrast, mean["contrast"], None),
        ]
    return rows


def within_factor(a: float, b: float, factor: float = 1.5) -> bool:
    return max(a, b) <= factor * min(a, b)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of the real sequence")
    parser.add_argument("--pictures", type=Path, help="folder for rendered frames and crops beside the real ones")
    parser.add_argument("--seeds", type=int, default=3, help="how many rendered streets and cars are averaged")
    args = parser.parse_args()
    print(f"{'region':8s}{'measure':28s}{'real':>8s}{'rendered':>10s}")
    for region, name, real, rendered, good in compare(args.data, args.seeds, args.pictures):
        verdict = "" if good is None else "  ok" if good else "  NO"
        print(f"{region:8s}{name:28s}{real:8.2f}{rendered:10.2f}{verdict}")


def save_pictures(folder: Path, real: list[Array], rendered: list[Array], boxes: Array) -> None:
    """Every third frame, real above rendered, and the car's crops enlarged."""
    folder.mkdir(parents=True, exist_ok=True)
    for k in range(0, FRAMES, 3):
        pair = [cv2.cvtColor(im, cv2.COLOR_GRAY2BGR) for im in (real[k], rendered[k])]
        for im, (x0, y0, x1, y1) in zip(pair, (CAR_BOXES[k], boxes[k]), strict=True):
            cv2.rectangle(im, (int(x0), int(y0)), (int(x1), int(y1)), (0, 200, 0), 1)
            cv2.rectangle(im, ROAD_BOX[:2], ROAD_BOX[2:], (0, 200, 200), 1)
        cv2.imwrite(str(folder / f"frames_{k:02d}.png"), np.vstack(pair))
        crops = [
            im[y0 - 20 : y0 + 80, x0 - 20 : x0 + 180]
            for im, (x0, y0, *_) in ((real[k], CAR_BOXES[k]), (rendered[k], boxes[k]))
        ]
        cv2.imwrite(str(folder / f"car_{k:02d}.png"), cv2.resize(np.hstack(crops), None, fx=4, fy=4))


if __name__ == "__main__":
    main()
