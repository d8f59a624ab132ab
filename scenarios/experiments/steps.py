"""What the constructors of numeric experiments refuse."""

from __future__ import annotations

import itertools

_MOST = 10_000


def check_range(name: str, value: float, low: float, high: float) -> None:
    """Raises ValueError where a parameter is not within its bounds."""
    if not low <= value <= high:
        raise ValueError(f"{name}: should be {low:g} to {high:g}, found {value!r}")


def check_steps(steps: tuple[int, ...]) -> None:
    """Raises ValueError where numbers of steps do not increase from 1 on."""
    rising = all(a < b for a, b in itertools.pairwise(steps))
    if not steps or steps[0] < 1 or steps[-1] > _MOST or not rising:
        raise ValueError(f"steps: should increase, from 1 to {_MOST} at most, found {list(steps)!r}")
