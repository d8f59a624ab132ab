"""Road masks against the roads as they are, pixel by pixel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from estimators.aerial.road_mask import mask_of_image
from estimators.aerial.road_masks import RoadMasks, read_mask
from reports.bootstrap import interval
from reports.flights.run import FlightRun
from reports.metrics import metric_row
from sim.streams import stream

Array = np.ndarray


def mask_counts(run: FlightRun, label: str, masks: RoadMasks) -> pd.DataFrame:
    """Pixels per image: columns image, both, masked, road; a road as it is has no margins."""
    rows = []
    for image in masks.image.tolist():
        mask = read_mask(run.folder / "estimates" / label, run.observations.records[image].file) > 0
        camera, T_wc = run.true_camera(image).camera, run.truth.T_wc[image]
        road = mask_of_image(run.roads, camera, T_wc, run.truth.terrain, pavement=True).mask > 0
        rows.append((image, np.count_nonzero(mask & road), np.count_nonzero(mask), np.count_nonzero(road)))
    return pd.DataFrame(rows, columns=["image", "both", "masked", "road"])


def mask_rows(run: FlightRun) -> Iterator[dict[str, Any]]:
    """Completeness: share of the pavement that is masked; correctness: share of the mask that is pavement."""
    for label, masks in run.masks.items():
        counts = mask_counts(run, label, masks)
        for name, column in (("completeness", "road"), ("correctness", "masked")):
            values = counts[["both", column]].to_numpy(float)
            if not values[:, 1].sum():
                continue
            share = float(values[:, 0].sum() / values[:, 1].sum())
            row = metric_row("road_mask", "all", name, share, "1", "higher", len(values))
            rng = stream(0, 0, f"bootstrap/flight/mask/{name}")
            low, high = interval(_ratio, values, 1, rng)
            yield row | {"estimator": label, "ci_low": low, "ci_high": high}
        failed = metric_row("road_mask", "all", "failed", len(masks.failures), "1", "lower", len(run.observations))
        yield failed | {"estimator": label}


def _ratio(values: Array) -> Array:
    with np.errstate(invalid="ignore"):
        return np.asarray(values[..., 0].sum(axis=-1) / values[..., 1].sum(axis=-1))
