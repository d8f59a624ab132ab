"""simulate -> track -> estimate -> report as cached stages of one run folder."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from estimators.estimate import EstimationFailed
from estimators.stereo.features import ImageError, StereoFrame, read_frames
from reports.html import write_report
from reports.labelling import label, read_seen
from scenarios.store import Store, code_digest, config_hash, digest
from scenarios.tracking import track
from sim.observations import Observations
from sim.scenario import Scenario, ScenarioError, nearest
from sim.simulate import simulate
from sim.truth import Truth
from sim.world import World, build_world

_MEASURED = ("observations/observations.npz", "truth/truth.npz")
_TRACKED, _LABELLED = ("tracks/observations.npz",), ("labels/truth.npz",)


class Progress(Protocol):
    """Tells the user how far a stage is."""

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[Callable[[], None]]: ...

    def say(self, line: str) -> None: ...


@dataclass(frozen=True)
class Outcome:
    """Run folder, the estimators that gave nothing (label to reason), and whether any gave something."""

    folder: Path
    failed: dict[str, str]
    any_estimate: bool


def run(
    name: str,
    spec: Any,
    out: Path,
    progress: Progress,
    until: str = "report",
    only: Sequence[str] = (),
    overwrite: bool = False,
) -> Outcome:
    """Takes one scenario through its stages up to ``until``.

    Raises
        ScenarioError: the input is wrong; nothing half-written stays behind.
    """
    chosen = asked_for(spec.estimator, only)
    store = Store.open(out, spec, overwrite)
    key = digest(config_hash(_without_estimators(spec)), code_digest("simulate"))
    _simulate(store, spec, key, progress)
    observed = "observations"
    if spec.measure.from_images and until != "simulate":
        observed, key = "tracks", _track(store, spec, key, progress)
    failed: dict[str, str] = {}
    if until in ("estimate", "label", "report"):
        for estimator in chosen:
            reason = estimate(store, estimator, observed, key, progress)
            if reason is not None:
                failed[estimator.title] = reason
    if spec.measure.from_images and until in ("label", "report"):
        _label(store, key)
    if until == "report":
        with progress.stage("report", 1):
            write_report(store.folder, name)
    return Outcome(out, failed, len(failed) < len(chosen))


def asked_for(estimators: Sequence[Any], only: Sequence[str]) -> list[Any]:
    """The estimators with these labels, all where none is named.

    Raises
        ScenarioError: there is none of a label.
    """
    labels = [e.title for e in estimators]
    for wanted in only:
        if wanted not in labels:
            raise ScenarioError(f"--estimator: found {wanted!r}, {nearest(wanted, labels)}")
    return [e for e in estimators if not only or e.title in only]


def _without_estimators(spec: Scenario) -> Scenario:
    """What simulation depends on; the estimators are none of its business."""
    return Scenario(**{k: getattr(spec, k) for k in Scenario.model_fields if k != "measure"}, measure=spec.measure)


def _simulate(store: Store, spec: Scenario, key: str, progress: Progress) -> None:
    rendered = not spec.rendered or store.is_done("render", key, _pictures(spec))
    if rendered and store.is_done("simulate", key, _MEASURED):
        progress.say("simulate  from cache")
        store.prepare()
        return
    started = time.perf_counter()
    with progress.stage("simulate", 1):
        world = build_world(spec)
        observations, truth = simulate(spec, world=world)
    if spec.rendered:
        from scenarios.footage import SIDES, image_name, mask_name  # needs OpenGL, which points alone do not

        frames = range(len(world.t_s))
        images = tuple((image_name(SIDES[0], k), image_name(SIDES[1], k)) for k in frames)
        masks = tuple(mask_name(k) for k in frames) if spec.measure.gives_masks else None
        observations = dataclasses.replace(observations, images=images, masks=masks)
    store.prepare()
    store.clear()

    def write(scratch: Path) -> None:
        observations.save(scratch / "observations")
        truth.save(scratch / "truth")

    store.run("simulate", key, _MEASURED, write, started)
    if spec.rendered:
        _render(store, spec, world, key, progress)


def _pictures(spec: Scenario) -> tuple[str, ...]:
    """Folders of images that rendering leaves in a run folder."""
    wanted = {"observations/images": True, "observations/masks": spec.measure.gives_masks}
    wanted |= {"truth/depth": spec.render.truth_images}
    wanted |= {"truth/instance": spec.render.truth_images, "truth/flow": spec.render.flow}
    return tuple(folder for folder, yes in wanted.items() if yes)


def _render(store: Store, spec: Scenario, world: World, key: str, progress: Progress) -> None:
    from scenarios.footage import write_footage

    outputs = _pictures(spec)
    with progress.stage("render", len(world.t_s)) as advance:

        def draw(scratch: Path) -> None:
            write_footage(spec, world, scratch, advance)
            for output in outputs:
                (scratch / output).parent.mkdir(exist_ok=True)
                (scratch / Path(output).name).rename(scratch / output)

        store.run("render", key, outputs, draw)


def _track(store: Store, spec: Any, key: str, progress: Progress) -> str:
    """Runs the image front end on the observations folder alone; the key of what depends on its tracks."""
    key = digest(key, spec.front_end.model_dump(mode="json"), code_digest("track"))
    if store.is_done("track", key, _TRACKED):
        progress.say("track  from cache")
        return key
    folder = store.folder / "observations"
    observations = Observations.load(folder)
    with progress.stage("track", len(observations.t_s)) as advance:

        def frames() -> Iterator[StereoFrame]:
            for frame in read_frames(observations, folder):
                yield frame
                advance()

        def work(scratch: Path) -> None:
            tracks = track(spec, observations.rig, frames())
            _beside(dataclasses.replace(observations, tracks=tracks)).save(scratch / "tracks")

        try:
            store.run("track", key, _TRACKED, work)
        except ImageError as error:
            raise ScenarioError(str(error)) from error
    return key


def _beside(observations: Observations) -> Observations:
    """The same for a folder beside that of the observations."""
    assert observations.images is not None
    images = tuple((f"../observations/{left}", f"../observations/{right}") for left, right in observations.images)
    masks = observations.masks and tuple(f"../observations/{name}" for name in observations.masks)
    return dataclasses.replace(observations, images=images, masks=masks)


def _label(store: Store, key: str) -> None:
    """Labels the tracks by the truth, for the report alone."""

    def work(scratch: Path) -> None:
        truth = Truth.load(store.folder / "truth")
        tracks = Observations.load(store.folder / "tracks").tracks
        label(truth, tracks, read_seen(store.folder / "truth", truth)).save(scratch / "labels")

    store.run("label", digest(key, code_digest("label")), _LABELLED, work)


def estimate(store: Store, estimator: Any, observed: str, key: str, progress: Progress) -> str | None:
    """Runs one estimator on the folder of its observations alone; the reason where it gave nothing."""
    label = estimator.title
    folder = f"estimates/{label}"
    key = digest(key, estimator.model_dump(mode="json"), code_digest("estimate"))
    with progress.stage(f"estimate {label}", 1):

        def work(scratch: Path) -> None:
            observations = Observations.load(store.folder / observed)
            result = estimator.build()(observations)
            target = scratch / folder
            target.mkdir(parents=True)
            if isinstance(result, EstimationFailed):
                (target / "failure.json").write_text(json.dumps({"reason": result.reason, "hints": result.hints}))
            else:
                result.save(target)

        store.run(f"estimate {label}", key, (folder,), work)
    failure = store.folder / folder / "failure.json"
    return str(json.loads(failure.read_text())["reason"]) if failure.is_file() else None
