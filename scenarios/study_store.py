"""The folder of a study: results as they come, each part whole or not at all, and what is done already.

A part is one Parquet file with the rows of all tables of a few consecutive runs of one point, named by the point's
resolved scenario and the runs. At the end the parts become one sorted file per table, the same bytes whoever made the
parts and in whatever order.
"""

from __future__ import annotations

import fcntl
import hashlib
import io
import json
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from scenarios.store import ROOT, code_digest, config_hash, digest, git_commit, versions
from scenarios.study_points import Point
from scenarios.trial import COLUMNS, TABLES, TrialResult
from sim.archive import write_atomically, write_text
from sim.scenario import ScenarioError

_ARROW = {"int64": pa.int64(), "float64": pa.float64(), "bool": pa.bool_(), "str": pa.string()}
_SCHEMAS = {name: pa.schema([(c, _ARROW[t]) for c, t in columns.items()]) for name, columns in COLUMNS.items()}
_PART = pa.unify_schemas([pa.schema([("table", pa.string())]), *_SCHEMAS.values()])
_GROUP = 100  # runs of a point in one row group of the sorted files: what is in memory at a time
# Beside sim and estimators, what turns an estimate into rows.
_EVALUATION = (
    *("reports/errors.py", "reports/windows.py", "reports/consistency.py", "reports/evaluation.py"),
    *("scenarios/trial.py", "scenarios/study_subject.py"),
    *(f"scenarios/experiments/{p.name}" for p in sorted((ROOT / "scenarios" / "experiments").glob("*.py"))),
)
_MADE = ("results", "runtimes.parquet", "metrics.csv", "report.html", "figures", "examples", "study.json")


@cache
def trial_digest() -> str:
    """SHA-256 of the code that the rows of a trial depend on, as it was when first asked."""
    h = hashlib.sha256(code_digest("estimate").encode())
    for name in _EVALUATION:
        h.update((ROOT / name).read_bytes())
    return h.hexdigest()


def encode(result: TrialResult) -> bytes:
    """The tables of some trials as one Parquet file."""
    parts = []
    for name in TABLES:
        rows = pa.Table.from_pandas(getattr(result, name), schema=_SCHEMAS[name], preserve_index=False)
        parts.append(rows.append_column("table", pa.array([name] * len(rows), pa.string())))
    table = pa.concat_tables(parts, promote_options="default").select(_PART.names).replace_schema_metadata()
    target = io.BytesIO()
    pq.write_table(table, target, compression="zstd")
    return target.getvalue()


@dataclass(frozen=True)
class StudyStore:
    """A study's folder with its points; ``keys`` are the points' names in files."""

    folder: Path
    points: tuple[Point, ...]
    keys: tuple[str, ...]

    @staticmethod
    @contextmanager
    def open(folder: Path, points: Sequence[Point], keep: Sequence[str], overwrite: bool) -> Iterator[StudyStore]:
        """Opens or creates a study's folder for one process at a time.

        Raises
            ScenarioError: it holds results of another configuration or code, or something else, or another process
                works in it, or it cannot be written.
        """
        keys = tuple(config_hash(p.scenario)[:16] for p in points)
        wanted = {"hash": digest(keys, [p.name for p in points], sorted(keep)), "code": trial_digest()}
        with ExitStack() as stack:
            known = _known(folder)
            try:
                folder.mkdir(parents=True, exist_ok=True)
                lock = stack.enter_context(open(folder / ".lock", "w"))
            except OSError as error:
                reason = (error.strerror or str(error)).lower()
                raise ScenarioError(f"--out {folder}: cannot be written: {reason}") from error
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise ScenarioError(f"--out {folder}: another process works in it") from error
            store = StudyStore(folder, tuple(points), keys)
            store._claim(known, wanted, overwrite)
            yield store

    def _claim(self, known: dict[str, Any], wanted: dict[str, str], overwrite: bool) -> None:
        different = [what for what in ("hash", "code") if known and known.get(what) != wanted[what]]
        if different and not overwrite:
            whose = "another configuration" if "hash" in different else "another version of the code"
            raise ScenarioError(f"--out {self.folder}: holds results of {whose}; give another --out or --overwrite")
        if different:
            for path in [self.folder / "parts", *(self.folder / name for name in _MADE)]:
                shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
        (self.folder / "parts").mkdir(exist_ok=True)
        for stale in (self.folder / "parts").glob(".*"):
            stale.unlink()
        provenance = wanted | {"git_commit": git_commit(), "versions": versions()}
        write_text(self.folder / "provenance.json", json.dumps(provenance, indent=1) + "\n")

    def write(self, point: int, runs: range, part: bytes) -> None:
        """Stores the rows of consecutive runs of a point."""
        path = self.folder / "parts" / f"{self.keys[point]}-{runs[0]:07d}-{runs[-1]:07d}.parquet"
        write_atomically(path, lambda p: p.write_bytes(part))

    def parts(self, point: int) -> list[tuple[range, Path]]:
        """The stored runs of a point and their files, in order."""
        found = []
        for path in (self.folder / "parts").glob(f"{self.keys[point]}-*.parquet"):
            _, first, last = path.stem.split("-")
            found.append((range(int(first), int(last) + 1), path))
        return sorted(found, key=lambda item: item[0].start)

    def missing(self, point: int, runs: int) -> list[range]:
        """What is not done of runs 0 to runs - 1."""
        gaps, begin = [], 0
        for done, _ in self.parts(point):
            gaps.append(range(begin, min(done.start, runs)))
            begin = done.stop
        gaps.append(range(begin, runs))
        return [g for g in gaps if len(g)]

    def finish(self, runs: int) -> None:
        """Writes the sorted tables of all points; the run times, which are never the same twice, beside them."""
        for name in TABLES:
            path = self.folder / ("runtimes.parquet" if name == "runtimes" else f"results/{name}.parquet")
            write_atomically(path, lambda p, n=name: self._merge(n, runs, p))

    def _merge(self, name: str, runs: int, path: Path) -> None:
        schema = _SCHEMAS[name].insert(0, pa.field("point", pa.string()))
        with pq.ParquetWriter(path, schema, compression="zstd") as writer:
            for i, point in enumerate(self.points):
                parts = self.parts(i)
                for first in range(0, runs, _GROUP):
                    wanted = range(first, min(first + _GROUP, runs))
                    rows = _rows(name, [p for r, p in parts if r.start < wanted.stop and r.stop > wanted.start], wanted)
                    label = pa.array([point.name] * len(rows), pa.string())
                    writer.write_table(rows.add_column(0, "point", label))


def _rows(name: str, paths: Sequence[Path], runs: range) -> pa.Table:
    """Rows of one table and some runs from the parts that hold them."""
    chosen = [("table", "=", name), ("run", ">=", runs.start), ("run", "<", runs.stop)]
    columns = _SCHEMAS[name].names
    tables = [pq.read_table(path, columns=columns, filters=chosen, use_threads=False) for path in paths]
    return pa.concat_tables([_SCHEMAS[name].empty_table(), *tables]).combine_chunks()


def _known(folder: Path) -> dict[str, Any]:
    """What made the results in a folder; nothing for one that is empty or not there."""
    file = folder / "provenance.json"
    if file.is_file():
        try:
            known = json.loads(file.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ScenarioError(f"--out {folder}: its provenance.json cannot be read") from error
        return known if isinstance(known, dict) else {}
    if folder.exists() and (not folder.is_dir() or any(p.name != ".lock" for p in folder.iterdir())):
        raise ScenarioError(f"--out {folder}: exists and is not a study folder")
    return {}
