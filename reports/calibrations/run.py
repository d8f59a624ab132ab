"""A calibration's run folder: products of its stages."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from estimators.aerial.boresight_observations import BoresightObservations
from estimators.aerial.boresight_result import BoresightResult
from estimators.estimate import EstimationFailed

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class CalibrationRun:
    """What the stages before the report left."""

    folder: Path
    name: str
    scenario: Mapping[str, Any]
    provenance: Mapping[str, Any]
    observations: BoresightObservations
    estimates: Mapping[str, BoresightResult | EstimationFailed]

    @property
    def results(self) -> dict[str, BoresightResult]:
        """Of the estimators that gave any."""
        return {label: e for label, e in self.estimates.items() if isinstance(e, BoresightResult)}

    @property
    def reference_deg(self) -> Float[Array, "3"] | None:
        """The boresight angles that the results are held against."""
        reference = self.scenario["reference"]
        return None if reference is None else np.array(reference["boresight_deg"], float)

    @property
    def reference_source(self) -> str:
        reference = self.scenario["reference"]
        return "" if reference is None else str(reference["source"])


def load_calibration(folder: Path, name: str) -> CalibrationRun:
    """Reads a calibration's run folder."""
    scenario, provenance = (json.loads((folder / f).read_text("utf-8")) for f in ("scenario.json", "provenance.json"))
    labels = [e.get("label") or e["name"] for e in scenario["estimator"]]
    found = {label: folder / "estimates" / label for label in labels}
    return CalibrationRun(
        folder,
        name,
        scenario,
        provenance,
        BoresightObservations.load(folder / "observations"),
        {label: _estimate(path) for label, path in found.items() if path.is_dir()},
    )


def _estimate(folder: Path) -> BoresightResult | EstimationFailed:
    failure = folder / "failure.json"
    if failure.is_file():
        f = json.loads(failure.read_text(encoding="utf-8"))
        return EstimationFailed(f["reason"], tuple(f["hints"]))
    return BoresightResult.load(folder)
