"""Deterministic random streams: one independent generator per (seed, run, component).

A component is named "entity/sensor/purpose", e.g. "target/left/noise"; adding a sensor, an estimator or a car therefore
never shifts another's numbers, and serial, parallel and resumed runs are identical.
"""

from __future__ import annotations

import hashlib

import numpy as np


def stream(seed: int, run: int, component: str) -> np.random.Generator:
    """Generator for one component of one run; the component enters by the first 64 bits of its SHA-256."""
    key = int.from_bytes(hashlib.sha256(component.encode()).digest()[:8], "big")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, run, key])))
