"""The image front end against plain OpenCV: time of a stereo frame, and what both are worth against the truth.

Plain OpenCV is what is usually written: corners in the mask, pyramidal Lucas-Kanade forth and back from frame to frame
and from left to right, on whole images. Both get the same frames of a shipped scenario, 1024 x 768, in turns, in one
process. Noise and disparity bias are of the rows that are no outliers by the bench's own labels.

    OPENBLAS_NUM_THREADS=1 python benchmarks/front_end.py [--scenario crossing] [--frames N] [--repeats N]
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from estimators.stereo.features import FrontEnd, StereoFrame, to_grey
from reports.labelling import Seen, label, noise_px
from scenarios import footage, spec
from sim.camera import StereoRig
from sim.observations import Tracks
from sim.simulate import simulate
from sim.truth import DEPTH_SCALE, INLIER, Truth
from sim.world import build_world

Array = np.ndarray
POINTS, DISTANCE_PX, QUALITY = 150, 3.0, 0.005
WINDOW, LEVELS, ROUND_TRIP_PX = (13, 13), 3, 0.5


@dataclass(frozen=True, eq=False)
class Scene:
    """Frames of a rendered scenario with true masks, and the truth to label tracks by."""

    rig: StereoRig
    frames: list[StereoFrame]
    seen: list[Seen]
    truth: Truth

    @staticmethod
    def of(name: str, frames: int) -> Scene:
        scenario = spec.read(name, [f"rig.frames={frames}"])
        world = build_world(scenario)
        _, truth = simulate(scenario)
        pairs, seen = [], []
        for k, views in enumerate(footage.views(scenario, world, frozenset({"color", "depth", "instance"}))):
            left, right = footage.exposed(scenario, world, k, views)
            shows = footage.shows_target(scenario, views[0])
            assert views[0].depth is not None
            seen.append(Seen.of(footage.coded_depth(views[0].depth) / DEPTH_SCALE, shows))
            pairs.append(StereoFrame(to_grey(left), to_grey(right), shows))
        return Scene(world.rig, pairs, seen, truth)


class PlainOpenCV:
    """Frame to frame and left to right by pyramidal Lucas-Kanade; a track ends where it does not find back."""

    def __call__(self, rig: StereoRig, frames: Sequence[StereoFrame]) -> Tracks:
        uv, track, born, rows = np.empty((0, 2), np.float32), np.empty(0, int), 0, []
        for k, frame in enumerate(frames):
            assert frame.mask is not None
            if len(uv):
                uv, found = self._flow(frames[k - 1].left, frame.left, uv)
                uv, track = uv[found], track[found]
                at = np.rint(uv).astype(int).clip(0, np.array(rig.left.size_px) - 1)
                inside = frame.mask[at[:, 1], at[:, 0]]
                uv, track = uv[inside], track[inside]
            fresh = self._corners(frame, uv)
            uv, track = np.concatenate([uv, fresh]), np.concatenate([track, np.arange(born, born + len(fresh))])
            born += len(fresh)
            right, found = self._flow(frame.left, frame.right, uv)
            found &= np.abs(right[:, 1] - uv[:, 1]) < 1
            uv, track = uv[found], track[found]
            rows.append((np.full(len(uv), k), track, uv.astype(float), right[found].astype(float)))
        frame_of, track, left, right = (np.concatenate(c) for c in zip(*rows, strict=True))
        return Tracks(frame_of, track, left, right, np.tile(np.eye(4), (len(left), 1, 1)))

    @staticmethod
    def _flow(a: Array, b: Array, uv: Array) -> tuple[Array, Array]:
        if not len(uv):
            return uv, np.zeros(0, bool)
        there, seen, _ = cv2.calcOpticalFlowPyrLK(a, b, uv, None, winSize=WINDOW, maxLevel=LEVELS)
        back, seen_back, _ = cv2.calcOpticalFlowPyrLK(b, a, there, None, winSize=WINDOW, maxLevel=LEVELS)
        home = np.linalg.norm(back - uv, axis=1) < ROUND_TRIP_PX
        return there, (seen[:, 0] > 0) & (seen_back[:, 0] > 0) & home

    @staticmethod
    def _corners(frame: StereoFrame, known: Array) -> Array:
        assert frame.mask is not None
        free = np.where(frame.mask, 255, 0).astype(np.uint8)
        for u, v in np.rint(known).astype(int):
            cv2.circle(free, (int(u), int(v)), int(DISTANCE_PX), 0, -1)
        wanted = POINTS - len(known)
        found = cv2.goodFeaturesToTrack(frame.left, wanted, QUALITY, DISTANCE_PX, mask=free) if wanted > 0 else None
        return np.empty((0, 2), np.float32) if found is None else found.reshape(-1, 2)


def verdict(scene: Scene, tracks: Tracks) -> str:
    truth = label(scene.truth, tracks, scene.seen)
    good = truth.labels.kind == INLIER
    error = (tracks.uv - truth.labels.uv_true)[good]
    disparity = error[:, 0] - error[:, 2]
    _, which = np.unique(tracks.track[good], return_inverse=True)
    of_track, life = np.bincount(which, disparity), np.bincount(which)
    rng = np.random.default_rng(0)
    draws = rng.integers(0, len(life), (1000, len(life)))
    low, high = np.quantile(of_track[draws].sum(axis=1) / life[draws].sum(axis=1), [0.025, 0.975])
    return (
        f"{len(tracks) / len(scene.frames):5.0f} rows a frame, mean life {np.bincount(tracks.track).mean():4.1f}, "
        f"outliers {1 - good.mean():5.1%}, noise {noise_px(error, tracks.track[good]):.3f} px, "
        f"disparity bias {disparity.mean():+.4f} px [{low:+.4f}, {high:+.4f}]"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="crossing")
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--repeats", type=int, default=7)
    options = parser.parse_args()
    scene = Scene.of(options.scenario, options.frames)
    ways: dict[str, Callable[[StereoRig, list[StereoFrame]], Tracks]] = {
        "ours": FrontEnd(points=POINTS),
        "plain OpenCV": PlainOpenCV(),
    }
    found = {name: way(scene.rig, scene.frames) for name, way in ways.items()}
    t = np.empty((options.repeats, len(ways)))
    for row in t:
        for i, way in enumerate(ways.values()):
            start = time.perf_counter()
            way(scene.rig, scene.frames)
            row[i] = (time.perf_counter() - start) / len(scene.frames) * 1000
    print(
        f"{platform.machine()}, OpenCV {cv2.__version__} with {cv2.getNumThreads()} threads, {options.scenario}, "
        f"{len(scene.frames)} stereo frames of {scene.rig.left.size_px}, {options.repeats} alternating runs"
    )
    for name, column in zip(ways, t.T, strict=True):
        print(f"{name:13s} {np.median(column):6.1f} ms a frame; {verdict(scene, found[name])}")
    print(f"median ratio  {np.median(t[:, 0] / t[:, 1]):6.2f}")


if __name__ == "__main__":
    main()
