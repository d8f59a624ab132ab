"""What a replayed car does in every frame of its run: how far it is, how much of it its label says is hidden, and its
manoeuvre, from the motion that is replayed, the smoothed label."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float, Shaped

from sim.kitti import LabelTrack, read_poses, read_track
from sim.pose import heading_of
from sim.replay import Replay, plan
from sim.scenario import Labels
from sim.trajectory import Trajectory

Array = np.ndarray
MANOEUVRES = ("standing", "straight", "turning", "braking", "accelerating")
# A standing car's label wanders at up to 0.8 m/s. The others are means over a second, which label noise hardly reaches.
STANDING_MPS, TURNING_DPS, CHANGE_MPS2, SPAN_S = 1.0, 5.0, 1.0, 1.0


def manoeuvres(motion: Trajectory, t_s: Float[Array, "m"], end_s: float) -> Shaped[Array, "m"]:
    """One of `MANOEUVRES` at every time: standing below `STANDING_MPS`; else turning above `TURNING_DPS`; else
    braking or accelerating beyond `CHANGE_MPS2`; else straight. Yaw rate and acceleration are means over the second
    around the time, as far as the motion goes from 0 to ``end_s``.
    """
    before, after = np.clip(t_s - SPAN_S / 2, 0, end_s), np.clip(t_s + SPAN_S / 2, 0, end_s)
    turned = heading_of(motion.pose(after).R) - heading_of(motion.pose(before).R)
    turned = np.remainder(turned + np.pi, 2 * np.pi) - np.pi
    change = (_forwards(motion, after) - _forwards(motion, before)) / (after - before)
    conditions = [
        np.abs(_forwards(motion, t_s)) < STANDING_MPS,
        np.abs(np.rad2deg(turned)) > TURNING_DPS * (after - before),
        change < -CHANGE_MPS2,
        change > CHANGE_MPS2,
    ]
    return np.select(conditions, ["standing", "turning", "braking", "accelerating"], "straight")


def _forwards(motion: Trajectory, t_s: Array) -> Float[Array, "m"]:
    return np.asarray(np.einsum("ni,ni->n", motion.velocity(t_s), motion.pose(t_s).R[..., 0]))


def replayed(scenario: Mapping[str, Any]) -> tuple[LabelTrack, pd.DataFrame]:
    """The label that the target of a resolved scenario (JSON) replays, and its frames: frame, t_s, distance_m forwards
    from the camera to the car's middle, occlusion 0..3 (-1: not labelled), manoeuvre.

    Raises
        ValueError: the target replays no label, or a file is not there any more.
    """
    name = scenario["measure"].get("target") or scenario["vehicle"][0]["name"]
    motion = next(v["motion"] for v in scenario["vehicle"] if v["name"] == name)
    if motion["kind"] != "labels":
        raise ValueError(f"the motion of {name!r} is no replay of a label")
    spec = Labels.model_validate(motion)
    label = read_track(Path(spec.labels), spec.track)
    poses = scenario["ego"].get("poses")
    camera = None if poses is None else read_poses(Path(poses))
    replay = plan(label, camera, 0.0, spec.label_rate_hz, spec.smoothing_m, np.deg2rad(spec.smoothing_deg))
    return label, _frames(replay, scenario["rig"]["rate_hz"], scenario["rig"].get("frames"))


def _frames(replay: Replay, rate_hz: float, frames: int | None) -> pd.DataFrame:
    count = frames or int(np.floor(replay.end_s * rate_hz + 1e-6)) + 1
    t_s = np.arange(count) / rate_hz
    ego = replay.ego.pose(t_s)
    ahead = np.einsum("ni,ni->n", replay.target.pose(t_s).t - ego.t, ego.R[..., 0])
    columns = {"frame": np.arange(count), "t_s": t_s, "distance_m": ahead, "occlusion": replay.occlusion(t_s)}
    return pd.DataFrame(columns | {"manoeuvre": manoeuvres(replay.target, t_s, replay.end_s)})
