"""Run folders: every stage is written once, whole or not at all, and known by the hash of its inputs."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from scenarios.spec import input_files
from sim.archive import write_text
from sim.scenario import Scenario, ScenarioError

ROOT = Path(__file__).resolve().parent.parent
_PACKAGES = (
    *("pruefstand", "numpy", "scipy", "opencv-python-headless", "pandas", "matplotlib", "pyrender", "trimesh"),
    *("numba", "PyOpenGL", "pydantic"),
)
# The code each stage depends on, by package folder.
_SCENE = ("sim", "scenarios/footage.py", "scenarios/shots.py", "scenarios/flight_footage.py")
_CODE = {
    "simulate": _SCENE,
    "read": ("sim", "estimators", "scenarios/calibration_images.py", "scenarios/calibration_observations.py"),
    "track": (*_SCENE, "estimators"),
    "estimate": (*_SCENE, "estimators"),
    "label": (*_SCENE, "estimators", "reports"),
}

_REPORTED = (
    *("report.html", "metrics.csv", "errors.parquet", "figures"),
    *("boresight.csv", "residuals.csv", "excluded.csv"),
)


def digest(*parts: Any) -> str:
    """SHA-256 of JSON-serialisable parts."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


@cache
def code_digest(stage: str) -> str:
    """SHA-256 of the sources a stage depends on: "simulate", which draws as well, "track", "estimate" or "label"; of a
    calibration "read"."""
    h = hashlib.sha256()
    for source in (ROOT / name for name in _CODE[stage]):
        for path in [source] if source.is_file() else sorted(source.rglob("*")):
            if path.suffix in (".py", ".glsl", ".vert", ".frag", ".geom", ".html", ".j2", ".css"):
                h.update(path.relative_to(ROOT).as_posix().encode())
                h.update(path.read_bytes())
    return h.hexdigest()


def config_hash(spec: Scenario) -> str:
    """Hash of the resolved scenario and the content of its input files; where the files lie does not matter."""
    text = json.dumps(spec.model_dump(mode="json", by_alias=True), sort_keys=True)
    files = []
    for path in input_files(spec):
        text = text.replace(json.dumps(str(path))[1:-1], path.name)
        files.append(hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "missing")
    return digest(text, files)


def git_commit() -> str:
    """Commit of the checkout, with a plus sign where it has changes; "unknown" outside git."""
    try:
        show = ["git", "-C", str(ROOT), "describe", "--always", "--dirty=+", "--abbrev=12", "--exclude=*"]
        return subprocess.run(show, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"


def versions() -> dict[str, str]:
    """Versions of the packages that shape a result."""
    found = {}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


@dataclass
class Store:
    """One run folder. ``stages`` maps each finished stage to its key and seconds, kept in provenance.json."""

    folder: Path
    spec: Scenario
    provenance: dict[str, Any]

    @staticmethod
    def open(folder: Path, spec: Scenario, overwrite: bool) -> Store:
        """Opens or creates a run folder for a scenario.

        Raises
            ScenarioError: it holds results of another configuration, or something that is no run, or cannot be written.
        """
        provenance: dict[str, Any] = {}
        file = folder / "provenance.json"
        wanted = config_hash(spec)
        if file.is_file():
            try:
                provenance = json.loads(file.read_text(encoding="utf-8"))
            except (OSError, ValueError) as error:
                raise ScenarioError(f"--out {folder}: its provenance.json cannot be read") from error
            if provenance.get("hash") != wanted and not overwrite:
                raise ScenarioError(
                    f"--out {folder}: holds results of another configuration; give another --out or --overwrite"
                )
        elif folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise ScenarioError(f"--out {folder}: exists and is not a run folder")
        stages = provenance.get("stages", {})
        return Store(folder, spec, {"hash": wanted, "stages": stages})

    def prepare(self) -> None:
        """Creates the folder and writes what is known before the first stage."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.folder):
                pass
        except OSError as error:
            raise ScenarioError(
                f"--out {self.folder}: cannot be written: {(error.strerror or str(error)).lower()}"
            ) from error
        for stale in self.folder.glob(".stage-*"):
            shutil.rmtree(stale, ignore_errors=True)
        resolved = self.spec.model_dump(mode="json", by_alias=True)
        self._forget_all_but({e["label"] or e["name"] for e in resolved["estimator"]})
        write_text(self.folder / "scenario.json", json.dumps(resolved, indent=1) + "\n")
        self.provenance |= {"git_commit": git_commit(), "versions": versions()}
        self._write()

    def _forget_all_but(self, labels: set[str]) -> None:
        """Removes the estimates of estimators that are no longer part of the scenario."""
        for stage in list(self.provenance["stages"]):
            kind, _, label = stage.partition(" ")
            if kind == "estimate" and label not in labels:
                del self.provenance["stages"][stage]
                self._discard(f"estimates/{label}")

    def clear(self) -> None:
        """Removes all results: they follow from a simulation that is about to be replaced."""
        self._discard("observations", "truth", "tracks", "labels", "estimates", *_REPORTED)
        self.provenance["stages"].clear()
        self._write()

    def _discard(self, *names: str) -> None:
        for path in (self.folder / name for name in names):
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)

    def _write(self) -> None:
        write_text(self.folder / "provenance.json", json.dumps(self.provenance, indent=1) + "\n")

    def is_done(self, stage: str, key: str, outputs: tuple[str, ...]) -> bool:
        """Whether the stage was finished with these inputs and its outputs are still there."""
        known = self.provenance["stages"].get(stage, {}).get("key") == key
        return known and all((self.folder / o).exists() for o in outputs)

    def run(
        self,
        stage: str,
        key: str,
        outputs: tuple[str, ...],
        work: Callable[[Path], None],
        started: float | None = None,
    ) -> bool:
        """Runs ``work(temporary_folder)`` unless the stage is cached, and moves its outputs into place.

        Returns whether it ran. Where work raises, nothing of it stays. ``started`` (perf_counter) counts earlier work.
        """
        if self.is_done(stage, key, outputs):
            return False
        self.provenance["stages"].pop(stage, None)
        self._write()
        started = time.perf_counter() if started is None else started
        with self._scratch() as scratch:
            work(scratch)
            for output in outputs:
                target = self.folder / output
                if target.is_dir():
                    shutil.rmtree(target)
                target.parent.mkdir(parents=True, exist_ok=True)
                (scratch / output).replace(target)
        self.provenance["stages"][stage] = {"key": key, "seconds": round(time.perf_counter() - started, 3)}
        self._write()
        return True

    @contextmanager
    def _scratch(self) -> Iterator[Path]:
        scratch = Path(tempfile.mkdtemp(prefix=".stage-", dir=self.folder))
        try:
            yield scratch
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
