"""The points of a study: every sweep expanded, every point a validated scenario or experiment."""

from __future__ import annotations

import copy
import itertools
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scipy.stats import qmc

from scenarios.study_spec import StudySpec, concerns, lay_all
from scenarios.study_subject import validated
from scenarios.study_sweeps import Grid, LabelTracks, PointList, Settings, Sweep, swept_keys
from sim.kitti import read_tracks
from sim.scenario import ScenarioError
from sim.streams import stream

_DIGITS = 6


@dataclass(frozen=True)
class Point:
    """A point of a study: what is set there, its name (a key=value list), and the resolved scenario or experiment."""

    settings: Settings
    name: str
    scenario: Any


def expand(study: StudySpec, base: Settings, folder: Path) -> list[Point]:
    """All points of a study, the first sweep outermost; a study without sweeps has one, without a name.

    base: the content of its scenario or experiment; folder: what paths in the sweeps are relative to. Quasi-random
    points follow from its seed alone.

    Raises
        ScenarioError: a point is no valid scenario, or stands there twice.
    """
    seed = int(base.get("seed", 1))
    axes = [_settings(sweep, i, seed, base) for i, sweep in enumerate(study.sweep)]
    points: dict[str, Point] = {}
    for combination in itertools.product(*axes):
        settings = {k: v for part in combination for k, v in part.items()}
        name = "; ".join(f"{k}={_text(v)}" for k, v in settings.items())
        if name in points:
            raise ScenarioError(f"sweep: the point {name} is there twice")
        data = copy.deepcopy(base)
        try:
            lay_all(data, settings, folder)
            points[name] = Point(settings, name, validated(data))
        except ScenarioError as error:
            where = next((w for w, key in swept_keys(study.sweep) if concerns(error, key)), "sweep")
            raise ScenarioError(f"{where}: {error} (at {name})") from error
    return list(points.values())


def _settings(sweep: Sweep, i: int, seed: int, base: Settings) -> list[Settings]:
    if isinstance(sweep, LabelTracks):
        return [{sweep.key: number} for number in _tracks(sweep, i, base)]
    if isinstance(sweep, Grid):
        return [{sweep.key: value} for value in sweep.values]
    if isinstance(sweep, PointList):
        return list(sweep.points)
    rng = stream(seed, 0, f"study/sweep/{i}")
    kinds = {"latin_hypercube": qmc.LatinHypercube, "sobol": qmc.Sobol}
    unit = kinds[sweep.kind](len(sweep.ranges), rng=rng).random(sweep.points)
    keys = list(sweep.ranges)
    return [
        {key: _between(sweep.ranges[key], u, key in sweep.log) for key, u in zip(keys, row, strict=True)}
        for row in unit.tolist()
    ]


def _tracks(sweep: LabelTracks, i: int, base: Settings) -> list[int]:
    """The tracks of a label file that are of the wanted types and long enough."""
    vehicles = base.get("vehicle", [])
    motion = vehicles[sweep.vehicle]["motion"] if sweep.vehicle < len(vehicles) else {}
    if "labels" not in motion:
        raise ScenarioError(f"sweep.{i}.vehicle: vehicle {sweep.vehicle} replays no label file")
    found = read_tracks(Path(motion["labels"]), sweep.frames, f"vehicle.{sweep.vehicle}.motion")
    chosen = [number for number, track in found.items() if track.kind in sweep.types]
    if not chosen:
        kinds = ", ".join(sweep.types)
        raise ScenarioError(f"sweep.{i}: {motion['labels']} has no {kinds} in {sweep.frames} frames or more")
    return chosen


def _between(ends: Sequence[float], u: float, log: bool) -> float | int:
    """The value at a share u in [0, 1) of a range; whole numbers where both ends are, both ends as likely as the rest.

    Rounded to six digits, so that a point's name says exactly where it is.
    """
    low, high = ends
    whole = isinstance(low, int) and isinstance(high, int)
    top = high + 1 if whole else high
    value = math.exp(math.log(low) + u * math.log(top / low)) if log else low + u * (top - low)
    return math.floor(value) if whole else float(f"{value:.{_DIGITS}g}")


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, default=str)
