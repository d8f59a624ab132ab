"""Images of a run straight from the renderer to the front end, for runs that leave nothing on disk."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Bool, UInt8

from estimators.stereo.features import StereoFrame, to_grey
from reports.labelling import Seen, label
from scenarios.footage import coded_depth, exposed, shows_target, views
from scenarios.tracking import track
from sim.masks import given_mask
from sim.observations import Observations
from sim.render import View
from sim.scenario import Measure, Scenario
from sim.truth import DEPTH_SCALE, Truth
from sim.world import World

Array = np.ndarray
# Of what is drawn before the sensor, per process: 54 stereo frames of 1024 x 768. Drawing is ten times as slow as all
# the rest of a trial; longer sequences are drawn again in every run.
_KEPT_BYTES = 256 * 2**20
_BYTES_PER_PIXEL = 6.2


def track_in_memory(
    spec: Any, run: int, world: World, observations: Observations, truth: Truth
) -> tuple[Observations, Truth]:
    """Products of `sim.simulate` with the tracks and labels of a run; those of run 0 are the engine's, bit by bit.

    What is drawn is kept for further runs in the same world object.
    """
    seen: list[Seen] = []
    tracks = track(spec, observations.rig, _frames(spec, run, world, seen))
    return replace(observations, tracks=tracks), label(truth, tracks, seen)


@dataclass(frozen=True, eq=False)
class Picture:
    """One moment before the sensor: both views' colours, and where the target is in the left one (packed bits)."""

    views: tuple[View, View]
    shows_target: UInt8[Array, "b"]
    seen: Seen

    @property
    def mask(self) -> Bool[Array, "h w"]:
        assert self.views[0].color is not None
        h, w, _ = self.views[0].color.shape
        return np.unpackbits(self.shows_target, count=h * w).reshape(h, w).astype(bool)


def _frames(spec: Any, run: int, world: World, seen: list[Seen]) -> Iterator[StereoFrame]:
    """What the front end gets, frame by frame; truth for the labels goes to ``seen``."""
    for k, picture in enumerate(_pictures(_drawn(spec), world)):
        left, right = exposed(spec, world, k, picture.views, run)
        seen.append(picture.seen)
        yield StereoFrame(to_grey(left), to_grey(right), given_mask(spec, picture.mask, k, run))


def _drawn(spec: Scenario) -> Scenario:
    """What decides what is drawn: neither points nor estimators."""
    other = ("title", "source", "measure", "outliers")
    parts = {k: getattr(spec, k) for k in Scenario.model_fields if k not in other}
    return Scenario(title="", measure=Measure(target=spec.measure.target), **parts)


def _pictures(drawn: Scenario, world: World) -> Iterable[Picture]:
    w, h = world.rig.left.size_px
    if len(world.t_s) * w * h * _BYTES_PER_PIXEL > _KEPT_BYTES:
        return _draw(drawn, world)
    return _kept(drawn.model_dump_json(by_alias=True), world)


@lru_cache(maxsize=1)
def _kept(drawn: str, world: World) -> tuple[Picture, ...]:
    return tuple(_draw(Scenario.model_validate_json(drawn), world))


def _draw(drawn: Scenario, world: World) -> Iterator[Picture]:
    for left, right in views(drawn, world, frozenset({"color", "depth", "instance"})):
        assert left.depth is not None
        shows = shows_target(drawn, left)
        seen = Seen.of(coded_depth(left.depth) / DEPTH_SCALE, shows)
        yield Picture((View(left.color, None, None), View(right.color, None, None)), np.packbits(shows), seen)
