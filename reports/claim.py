"""A statement of the source, what was found, and whether the statement holds."""

from __future__ import annotations

Claim = tuple[str, str, str]
YES, PART, NO = "yes", "in part", "no"


def holds(yes: bool, part: bool = False) -> str:
    """Whether a statement holds, holds in part, or does not."""
    return YES if yes else PART if part else NO
