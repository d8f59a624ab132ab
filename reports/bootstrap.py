"""Percentile bootstrap of correlated errors: circular blocks in place of single values."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from sim.streams import stream

Array = np.ndarray
REPLICATES = 999
_CHUNK = 2_000_000


def block_indices(n: int, block: int, replicates: int, rng: np.random.Generator) -> Int[Array, "r n"]:
    """Rows drawn in circular blocks of the given length, so that neighbours stay together (Politis and Romano 1992)."""
    starts = rng.integers(0, n, (replicates, -(-n // block)))
    rows = (starts[:, :, None] + np.arange(block)) % n
    return np.asarray(rows.reshape(replicates, -1)[:, :n])


def interval(
    pool: Callable[[Float[Array, "*b n k"]], Float[Array, "*b"]],
    values: Float[Array, "n k"],
    block: int,
    rng: np.random.Generator,
    level: float = 0.95,
) -> tuple[float, float]:
    """Confidence interval of a pooled statistic; NaN where fewer than two blocks of data exist.

    Overlapping windows share observations: their errors are correlated over a window's length, which is the block to
    use; resampling them one by one would state intervals several times too narrow.
    """
    n, k = values.shape
    if n < 2 * block:
        return np.nan, np.nan
    rows = block_indices(n, block, REPLICATES, rng)
    step = max(1, _CHUNK // (n * k))
    pooled = np.concatenate([pool(values[rows[i : i + step]]) for i in range(0, REPLICATES, step)])
    low, high = np.quantile(pooled, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def interval_of_sums(
    finish: Callable[[Float[Array, "*b q"]], Float[Array, "*b"]], sums: Float[Array, "r q"], level: float = 0.95
) -> tuple[float, float]:
    """Confidence interval of a statistic that ``finish`` makes of sums over independent runs; NaN for one run.

    Whole runs are drawn, so all correlation within a run stays, at a cost that does not depend on the runs' length.
    """
    drawn = finish(_draws(len(sums)) @ sums) if len(sums) > 1 else np.empty(0)
    drawn = drawn[np.isfinite(drawn)]
    if not len(drawn):
        return np.nan, np.nan
    low, high = np.quantile(drawn, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


@lru_cache(maxsize=2)
def _draws(runs: int) -> Float[Array, "replicates r"]:
    """How often each of so many runs is drawn, with replacement; the same draws for every statistic."""
    rng = stream(0, 0, "bootstrap/runs")
    counts = [np.bincount(rng.integers(0, runs, runs), minlength=runs) for _ in range(REPLICATES)]
    return np.array(counts, float)
