"""True hills, and the elevation models that an orthorectification has of them."""

from __future__ import annotations

from typing import Literal

import numpy as np

from sim.streams import stream
from sim.terrain import Bounds, ElevationGrid, plane, relief

Array = np.ndarray
Dem = Literal["exact", "srtm", "flat"]
HALF_M = 1300.0
"""Half a side of the terrain."""
_BOUNDS: Bounds = (-HALF_M, -HALF_M, HALF_M, HALF_M)
_NODE_M, _WAVES_M = 20.0, (200.0, 1800.0)
# Three arc seconds; 6.2 m (90 %) in Eurasia (Rodriguez et al. 2006), of which we take 3.0 m (1 sigma) as the nodes' own
# error and 2.3 m as common to all.
_SRTM_M, _NODE_SIGMA_M, _COMMON_SIGMA_M = 90.0, 3.0, 2.3


def hills(relief_m: float, seed: int, run: int) -> ElevationGrid:
    """Hills of a standard deviation [m], waves of 200 to 1800 m."""
    rng = stream(seed, run, "ortho/hills")
    return relief(_BOUNDS, _NODE_M, rng, rms_m=relief_m, wavelengths_m=_WAVES_M)


def elevation_model(true: ElevationGrid, dem: Dem, seed: int, run: int) -> ElevationGrid:
    """Heights as known: exact; as SRTM has them, means over cells of 90 m with errors; or one mean height."""
    if dem == "exact":
        return true
    if dem == "flat":
        return plane(true.bounds_m, float(true.heights_m.mean()))
    x0, y0, x1, y1 = true.bounds_m
    count = int(np.ceil((x1 - x0) / _SRTM_M)) + 1
    node = _SRTM_M * np.arange(count)
    part = _SRTM_M * (np.arange(5) - 2) / 5
    x, y = (np.clip(np.add.outer(start + node, part), start, end) for start, end in ((x0, x1), (y0, y1)))
    at = np.stack(np.broadcast_arrays(x[None, :, None, :], y[:, None, :, None]), axis=-1)
    rng = stream(seed, run, "ortho/srtm")
    error = _NODE_SIGMA_M * rng.standard_normal((count, count)) + _COMMON_SIGMA_M * rng.standard_normal()
    return ElevationGrid(true.height(at).mean(axis=(2, 3)) + error, (x0, y0), _SRTM_M)
