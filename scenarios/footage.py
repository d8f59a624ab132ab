"""Rendered images of a run: one state of the world per frame gives colour, depth, mask and flow, left and right."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from scenarios.shots import daylight, shot
from sim.masks import given_mask
from sim.pose import Pose
from sim.realism import disturbed
from sim.render import Item, Renderer, View, mean_light, moments, motion_px, optical_flow
from sim.scenario import Scenario
from sim.sensor import Sensor, expose
from sim.streams import stream
from sim.truth import DEPTH_SCALE, FIRST_VEHICLE, STATIC_INSTANCE
from sim.world import World

Array = np.ndarray
SIDES = ("left", "right")
_PNG_FAST = [cv2.IMWRITE_PNG_COMPRESSION, 1]


def image_name(side: str, frame: int) -> str:
    """File of a rendered image, relative to the observations folder."""
    return f"images/{side}/{frame:06d}.png"


def mask_name(frame: int) -> str:
    """File of the target's supposed mask in the left image, relative to the observations folder."""
    return f"masks/{frame:06d}.png"


def items(world: World) -> list[Item]:
    """What is drawn: the street is instance 1, vehicle i instance i + 2; grids without a body are left out."""
    street = [Item(p.model, STATIC_INSTANCE) for p in world.props]
    cars = [Item(a.model, i + FIRST_VEHICLE) for i, a in enumerate(world.actors) if len(a.model.solid_faces)]
    return street + cars


def item_poses(world: World, t: float) -> list[Pose]:
    """Poses of the `items` at a time."""
    return [p.T_wb for p in world.props] + [a.trajectory.pose(t) for a in world.actors if len(a.model.solid_faces)]


def views(scenario: Scenario, world: World, products: frozenset[str]) -> Iterator[tuple[View, View]]:
    """Both views of every frame, before the sensor."""
    with Renderer(items(world), daylight(scenario), scenario.render.supersample) as renderer:
        for t in world.t_s:
            yield _gathered(renderer, scenario, world, float(t), products)


def _gathered(
    renderer: Renderer, scenario: Scenario, world: World, t: float, products: frozenset[str]
) -> tuple[View, View]:
    """Both views of the middle of an exposure, their colour the mean light of the whole of it."""
    exposure_s = scenario.realism.exposure_ms / 1000

    def at(moment: float, wanted: frozenset[str]) -> tuple[View, View]:
        return renderer.render_stereo(world.rig, world.T_wc(moment), item_poses(world, moment), wanted)

    if exposure_s == 0:
        return at(t, products)
    middle = at(t, products | {"depth", "instance"})
    ends = t - exposure_s / 2, t + exposure_s / 2
    T_wc = world.T_wc(ends[0]), world.T_wc(ends[1])
    poses = item_poses(world, ends[0]), item_poses(world, ends[1])
    ids = [i.instance for i in items(world)]
    offsets = moments(motion_px(middle[0], world.rig.left, T_wc, poses, ids)) * exposure_s
    others = [at(t + o, frozenset({"color"})) for o in offsets if o]
    left, right = (
        mean_light([v.color for v in views if v.color is not None]) for views in zip(middle, *others, strict=True)
    )
    return replace(middle[0], color=left), replace(middle[1], color=right)


def write_footage(scenario: Scenario, world: World, folder: Path, advance: Callable[[], None]) -> None:
    """Renders all frames into ``folder``: the sensor's images and, as asked for, true depth, instance and flow.

    Frames are written by a second thread while the next one is drawn; at most a few wait, so memory does not grow.
    """
    spec = scenario.render
    products = {"color"} | ({"depth", "instance"} if spec.truth_images or spec.flow else set())
    if scenario.measure.gives_masks:
        (folder / "masks").mkdir(parents=True, exist_ok=True)
    for kind in ("images", *(("depth", "instance") if spec.truth_images else ()), *(("flow",) if spec.flow else ())):
        for side in SIDES:
            (folder / kind / side).mkdir(parents=True, exist_ok=True)
    waiting: list[Future[None]] = []
    with ThreadPoolExecutor(max_workers=1) as pool:
        for k, pair in enumerate(views(scenario, world, frozenset(products))):
            waiting.append(pool.submit(_write_frame, scenario, world, folder, k, pair))
            while len(waiting) > 2:
                waiting.pop(0).result()
            advance()
        for job in waiting:
            job.result()


def exposed(scenario: Scenario, world: World, k: int, pair: tuple[View, View], run: int = 0) -> tuple[Array, Array]:
    """The RGB images (h, w, 3) that both sensors report of frame k; noise and disturbances are those of a run."""
    spec = scenario.render
    sensor = Sensor(
        spec.blur_px, spec.vignetting, spec.gain, spec.read_noise, spec.shot_noise, jpeg_quality=spec.jpeg_quality
    )
    images = []
    for side, view in zip(SIDES, pair, strict=True):
        assert view.color is not None
        color = disturbed(view.color, scenario.realism, shot(scenario, world, side, float(world.t_s[k]), run))
        images.append(expose(color, sensor, stream(scenario.seed, run, f"camera/{side}/sensor/{k}")))
    return images[0], images[1]


def shows_target(scenario: Scenario, view: View) -> Array:
    """Pixels (h, w) that truly show the target."""
    assert view.instance is not None
    return np.asarray(view.instance == scenario.target_index + FIRST_VEHICLE)


def coded_depth(depth: Array) -> Array:
    """Depth (h, w) [m] as it is stored: 16 bits of 1/256 m, 0 where unknown or too far."""
    coded = np.rint(depth * DEPTH_SCALE)
    return np.where(coded <= 65535, coded, 0).astype(np.uint16)


def _write_frame(scenario: Scenario, world: World, folder: Path, k: int, pair: tuple[View, View]) -> None:
    spec = scenario.render
    mask = given_mask(scenario, shows_target(scenario, pair[0]), k) if scenario.measure.gives_masks else None
    if mask is not None:
        _write(folder / mask_name(k), mask.astype(np.uint8) * 255)
    for side, view, image in zip(SIDES, pair, exposed(scenario, world, k, pair), strict=True):
        _write(folder / image_name(side, k), image[:, :, ::-1])
        if spec.truth_images and view.depth is not None and view.instance is not None:
            _write(folder / f"depth/{side}/{k:06d}.png", coded_depth(view.depth))
            _write(folder / f"instance/{side}/{k:06d}.png", view.instance)
        if spec.flow and k + 1 < len(world.t_s):
            _write(folder / f"flow/{side}/{k:06d}.png", _flow_png(world, k, side, view))


def _flow_png(world: World, k: int, side: str, view: View) -> Array:
    """Flow to the next frame in KITTI's form: (known, v, u) as OpenCV orders channels, 1/64 px around 2^15."""
    assert view.depth is not None
    assert view.instance is not None
    t0, t1 = world.t_s[k], world.t_s[k + 1]
    T_lc = Pose.identity() if side == "left" else world.rig.T_rl.inv()
    camera = world.rig.left if side == "left" else world.rig.right
    flow = optical_flow(
        view.depth,
        view.instance,
        camera,
        world.T_wc(t0) @ T_lc,
        world.T_wc(t1) @ T_lc,
        item_poses(world, t0),
        item_poses(world, t1),
        [i.instance for i in items(world)],
    )
    known = np.isfinite(flow).all(axis=2) & (np.abs(flow) < 511).all(axis=2)
    coded = np.where(known[..., None], flow * 64 + 2**15, 0)
    return np.dstack([known, coded[..., 1], coded[..., 0]]).astype(np.uint16)


def _write(path: Path, image: Array) -> None:
    if not cv2.imwrite(str(path), image, _PNG_FAST):
        raise OSError(f"{path} cannot be written")
