"""Sudden changes of exposure, as under a bridge or where a bright lorry fills the metering window, and recovery."""

from __future__ import annotations

import numpy as np

from sim.streams import stream

_RECOVERY_S = 0.3


def exposure_gain(size_ev: float, seed: int, run: int, t_s: float) -> float:
    """Factor on the light at a time: one step in every second, half to all of ``size_ev`` stops up or down.

    Each dies away with a time constant of 0.3 s. Both cameras are exposed alike.
    """
    ev = 0.0
    for second in range(max(0, int(np.floor(t_s)) - 4), int(np.floor(t_s)) + 1):
        rng = stream(seed, run, f"camera/exposure/step/{second}")
        since = t_s - second - rng.uniform(0.1, 0.9)
        step = size_ev * rng.uniform(0.5, 1.0) * rng.choice((-1.0, 1.0))
        ev += step * np.exp(-since / _RECOVERY_S) if since >= 0 else 0.0
    return float(2.0**ev)
