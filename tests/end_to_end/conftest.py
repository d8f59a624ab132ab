"""The command line as users run it: a process of its own, without the runtime checks of the other tests."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def pruefstand(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Exit status and output of one command line."""
    return subprocess.run(
        [sys.executable, "-m", "scenarios.cli", *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )


def run(name: str, out: Path, *settings: str) -> subprocess.CompletedProcess[str]:
    """``run NAME --out OUT`` with settings."""
    return pruefstand("run", name, "--out", str(out), *[w for s in settings for w in ("--set", s)])
