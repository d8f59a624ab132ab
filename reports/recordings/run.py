"""A recording's run folder: products of its stages, and what they are held against."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from estimators.estimate import EstimationFailed, TrajectoryEstimate
from estimators.stereo.features.box import BoxedFrame
from estimators.stereo.self_calibration import RectificationError
from reports.run import load_estimate
from sim import archive
from sim.archive import freeze_fields
from sim.camera import StereoRig
from sim.observations import Observations
from sim.pose import Pose

Array = np.ndarray
_REFERENCE, _FOLLOWED, _CALIBRATED = "reference.npz", "followed.npz", "rectification.npz"


@dataclass(frozen=True, eq=False)
class Reference:
    """Measured poses of the left camera (m,), or None."""

    T_wc: Pose | None

    def save(self, folder: Path) -> None:
        archive.save(folder / _REFERENCE, self)

    @staticmethod
    def load(folder: Path) -> Reference:
        poses = archive.load(folder / _REFERENCE)["T_wc"]
        return Reference(None if poses is None else Pose(**poses))


@dataclass(frozen=True, eq=False)
class Followed:
    """A followed box per frame: box (m, 4) left, top, right, bottom [px] and disparity (m,) [px] of block matching in
    it, NaN where not known; no frames where there is no box."""

    box: Float[Array, "m 4"]
    disparity: Float[Array, "m"]

    def __post_init__(self) -> None:
        freeze_fields(self)

    @staticmethod
    def of(frames: Sequence[BoxedFrame]) -> Followed:
        boxes = [np.full(4, np.nan) if f.box is None else f.box for f in frames]
        return Followed(np.array(boxes).reshape(-1, 4), np.array([f.disparity for f in frames]))

    def corrected(self, rig: StereoRig, error: RectificationError) -> Followed:
        """The disparities as an ideal rig has them, by the error in the middle of the box."""
        middle = (self.box[:, :2] + self.box[:, 2:]) / 2
        return Followed(self.box, self.disparity + error.missing_disparity(rig, middle))

    def save(self, folder: Path) -> None:
        archive.save(folder / _FOLLOWED, self)

    @staticmethod
    def load(folder: Path) -> Followed:
        return Followed(**archive.load(folder / _FOLLOWED))


@dataclass(frozen=True, eq=False)
class Calibrated:
    """The error of the rectification that was found in the recording and removed, or why there is none."""

    error: RectificationError | None
    reason: str = ""

    def save(self, folder: Path) -> None:
        archive.save(folder / _CALIBRATED, self)

    @staticmethod
    def load(folder: Path) -> Calibrated:
        f = archive.load(folder / _CALIBRATED)
        return Calibrated(None if f["error"] is None else RectificationError(**f["error"]), f["reason"])


@dataclass(frozen=True, eq=False)
class RecordingRun:
    """What the stages before the report left."""

    folder: Path
    name: str
    scenario: Mapping[str, Any]
    provenance: Mapping[str, Any]
    observations: Observations
    reference: Reference
    followed: Followed
    calibrated: Calibrated
    estimates: Mapping[str, TrajectoryEstimate | EstimationFailed]

    @property
    def of_vehicle(self) -> bool:
        """Whether a vehicle was observed, or else the scene."""
        return bool(self.scenario["recording"]["target"] == "box")

    @property
    def windows(self) -> dict[str, TrajectoryEstimate]:
        """The estimates of those that gave any."""
        return {k: e for k, e in self.estimates.items() if isinstance(e, TrajectoryEstimate) and e.windows}


def load_recording(folder: Path, name: str) -> RecordingRun:
    """Reads a recording's run folder."""
    scenario, provenance = (json.loads((folder / f).read_text("utf-8")) for f in ("scenario.json", "provenance.json"))
    labels = [e.get("label") or e["name"] for e in scenario["estimator"]]
    found = {label: folder / "estimates" / label for label in labels}
    return RecordingRun(
        folder,
        name,
        scenario,
        provenance,
        Observations.load(folder / "tracks"),
        Reference.load(folder / "reference"),
        Followed.load(folder / "tracks"),
        Calibrated.load(folder / "tracks"),
        {label: load_estimate(path) for label, path in found.items() if path.is_dir()},
    )
