"""A short scenario without pictures, and the command line as a function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from scenarios.cli import main

QUICK = ("render.enabled=false", "world.roadside=false", "rig.frames=6", "vehicle.0.motion.start_m=[-3.5, 30.0]")


@dataclass(frozen=True)
class Result:
    """Exit status and what was printed."""

    status: int
    out: str
    err: str


Command = Callable[..., Result]


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Command:
    """Runs a command line inside an empty folder."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> Result:
        capsys.readouterr()
        status = main(arguments)
        printed = capsys.readouterr()
        return Result(status, printed.out, printed.err)

    return call


@pytest.fixture
def quick_run(command: Command) -> Command:
    """`run` of a short oncoming scene with further settings."""

    def call(*settings: str, name: str = "oncoming", quick: tuple[str, ...] = QUICK) -> Result:
        chosen = [
            w for s in (*quick, *settings) for w in (("--set", s) if "=" in s and not s.startswith("--") else (s,))
        ]
        return command("run", name, *chosen)

    return call
