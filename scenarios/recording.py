"""Real images through the front end and the estimators: read -> track -> estimate -> report as cached stages."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from estimators.estimate import EstimationFailed
from estimators.stereo.features import FrontEnd, ImageError, StereoFrame, read_frames
from estimators.stereo.features.box import BoxedFrame, follow_box
from estimators.stereo.self_calibration import calibrate
from estimators.stereo.triangulation import triangulate
from reports.recordings.html import write_recording
from reports.recordings.run import Calibrated, Followed, Reference
from scenarios.engine import Outcome, Progress, asked_for, estimate
from scenarios.store import Store, code_digest, config_hash, digest
from sim.camera import StereoRig
from sim.observations import Observations, Tracks
from sim.recording import Recording, read_recording
from sim.scenario import ScenarioError

Array = np.ndarray
_READ = ("observations/observations.npz", "reference")
_TRACKED = ("tracks/observations.npz", "tracks/followed.npz", "tracks/rectification.npz")
_NEAREST_M = 3.0


def run(
    name: str,
    spec: Any,
    out: Path,
    progress: Progress,
    until: str = "report",
    only: Sequence[str] = (),
    overwrite: bool = False,
) -> Outcome:
    """Takes one recording through its stages up to ``until``.

    Raises
        ScenarioError: the input is wrong, an image cannot be used; nothing half-written stays behind.
    """
    chosen = asked_for(spec.estimator, only)
    recording = read_recording(spec.recording)
    store = Store.open(out, spec, overwrite)
    key = digest(config_hash(spec.without_estimators), _content(recording), code_digest("simulate"))
    observations = _read(store, spec, recording, key)
    failed: dict[str, str] = {}
    if until != "simulate":
        key = _track(store, spec, recording, observations, key, progress)
    if until in ("estimate", "report"):
        for estimator in chosen:
            reason = estimate(store, estimator, "tracks", key, progress)
            if reason is not None:
                failed[estimator.title] = reason
    if until == "report":
        with progress.stage("report", 1):
            write_recording(store.folder, name)
    return Outcome(out, failed, len(failed) < len(chosen))


def _content(recording: Recording) -> str:
    """Hash of all images."""
    h = hashlib.sha256()
    for path in (p for pair in recording.images for p in pair):
        h.update(hashlib.sha256(path.read_bytes()).digest())
    return h.hexdigest()


def _read(store: Store, spec: Any, recording: Recording, key: str) -> Observations:
    """Observations without tracks; the ego poses are part of them only where a vehicle is observed from the ego car."""
    about_vehicle = spec.recording.target == "box"
    none = Tracks(np.empty(0, int), np.empty(0, int), np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 4, 4)))
    observations = Observations(
        np.arange(len(recording.images)) / spec.recording.rate_hz,
        recording.rig,
        none,
        "vehicle" if about_vehicle else "background",
        recording.T_wc if about_vehicle else None,
        tuple((str(left.resolve()), str(right.resolve())) for left, right in recording.images),
    )
    store.prepare()
    if store.is_done("read", key, _READ):
        return observations
    store.clear()

    def write(scratch: Path) -> None:
        observations.save(scratch / "observations")
        (scratch / "reference").mkdir()
        Reference(recording.T_wc).save(scratch / "reference")

    store.run("read", key, _READ, write)
    return observations


def _track(
    store: Store, spec: Any, recording: Recording, observations: Observations, key: str, progress: Progress
) -> str:
    """Runs the front end; the key of what depends on its tracks."""
    key = digest(key, code_digest("track"))
    if store.is_done("track", key, _TRACKED):
        progress.say("track  from cache")
        return key
    calibrates = spec.recording.self_calibrate
    with progress.stage("track", len(recording.images)) as advance:
        followed: list[BoxedFrame] = []

        def frames() -> Iterator[StereoFrame]:
            for frame in _masked(spec, recording, read_frames(observations, store.folder), followed):
                yield frame
                advance()

        def work(scratch: Path) -> None:
            tracks, rig = spec.front_end.build_for(spec.recording.target)(recording.rig, frames()), recording.rig
            boxes, calibrated = Followed.of(followed), Calibrated(None, "not asked for")
            if calibrates:
                scene = tracks if not followed else _scene(spec, recording, observations, store, boxes)
                calibrated = _calibrated(rig, scene)
            if calibrated.error is not None:
                tracks, boxes = calibrated.error.corrected(rig, tracks), boxes.corrected(rig, calibrated.error)
            replace(observations, tracks=_near(tracks, rig, spec.recording.farthest_m)).save(scratch / "tracks")
            boxes.save(scratch / "tracks")
            calibrated.save(scratch / "tracks")

        try:
            store.run("track", key, _TRACKED, work)
        except ImageError as error:
            raise ScenarioError(str(error)) from error
    return key


def _scene(spec: Any, recording: Recording, observations: Observations, store: Store, boxes: Followed) -> Tracks:
    """Tracks of all but the followed vehicle."""
    known = {k: box for k, box in enumerate(boxes.box) if np.isfinite(box).all()}
    frames = _without(read_frames(observations, store.folder), known)
    front_end: FrontEnd = spec.front_end.build_for("background")
    return front_end(recording.rig, frames)


def _calibrated(rig: StereoRig, scene: Tracks) -> Calibrated:
    found = calibrate(rig, scene)
    return Calibrated(None, found.reason) if isinstance(found, EstimationFailed) else Calibrated(found)


def _masked(
    spec: Any, recording: Recording, frames: Iterator[StereoFrame], followed: list[BoxedFrame]
) -> Iterator[StereoFrame]:
    """Frames with the mask of what is to be tracked: the vehicle in the box, or all but the boxes."""
    f_b = recording.rig.left.K[0, 0] * -recording.rig.T_rl.t[0]
    if spec.recording.target == "box":
        for boxed in follow_box(frames, recording.boxes, f_b / _NEAREST_M):
            followed.append(replace(boxed, frame=_NOTHING))
            yield boxed.frame
        return
    yield from _without(frames, recording.boxes)


def _without(frames: Iterator[StereoFrame], boxes: Mapping[int, Array]) -> Iterator[StereoFrame]:
    """Frames with a mask of all but the boxes."""
    for k, frame in enumerate(frames):
        mask = np.ones(frame.left.shape, bool)
        if k in boxes:
            left, top, right, bottom = np.maximum(boxes[k], 0).astype(int)
            mask[top : bottom + 1, left : right + 1] = False
        yield replace(frame, mask=mask)


_NOTHING = StereoFrame(np.zeros((1, 1), np.uint8), np.zeros((1, 1), np.uint8))


def _near(tracks: Tracks, rig: StereoRig, farthest_m: float) -> Tracks:
    points, _ = triangulate(rig, tracks.uv, tracks.cov)
    return tracks.select(np.isfinite(points).all(axis=1) & (points[:, 2] < farthest_m))
