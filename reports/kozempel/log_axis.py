"""Logarithmic axes with plain numbers."""

from __future__ import annotations

from matplotlib.axis import Axis
from matplotlib.ticker import LogLocator, NullLocator


def plain_log(axis: Axis) -> None:
    """Ticks at 1, 2 and 5 of every decade, written out, and none between them."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())
