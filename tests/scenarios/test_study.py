"""A study gives the same bytes whoever ran it, however often it was killed; nothing is lost and nothing made twice."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import psutil
import pytest
from distributed import KilledWorker

from reports.metrics import METRIC_COLUMNS
from reports.studies import load_study
from scenarios import study_cluster
from scenarios.study_work import Block, Blocks, StudyStopped, _outcome
from tests.scenarios.conftest import Command, Result

STUDY = """
title = "Grid of points, twice"
source = "test"
kind = "study"
scenario = "oncoming"
runs = 100
keep = ["position"]
[set]
rig.frames = 4
world.roadside = false
measure.points = 100
[[set.vehicle]]
name = "target"
mesh = "point_grid"
motion = { kind = "straight", start_m = [0, 20], heading_deg = 180 }
[[sweep]]
kind = "grid"
key = "measure.sigma_px"
values = [0.1, 0.3]
[[estimator]]
name = "sliding_window_adjustment"
label = "a"
start_window = 4
[[estimator]]
name = "sliding_window_adjustment"
label = "b"
start_window = 4
weights = "observed"
[[figure]]
name = "lines"
over = "measure.sigma_px"
bound = true
"""
TABLES = ("comparison", "nees", "outliers", "failures", "support")


def results(folder: Path) -> dict[str, bytes]:
    """What must not depend on who ran a study."""
    names = [*(f"results/{t}.parquet" for t in TABLES), "metrics.csv", "table.csv", "figures/lines.svg", "study.json"]
    return {name: (folder / name).read_bytes() for name in names}


def start(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """The command line in a process group of its own."""
    command = [sys.executable, "-m", "scenarios.cli", "study", "study.toml", *arguments]
    streams: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    return subprocess.Popen(command, cwd=folder, env=environment(), start_new_session=True, **streams)


def environment() -> dict[str, str]:
    root = str(Path(__file__).resolve().parents[2])
    return os.environ | {"PYTHONPATH": root, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def wait_for(condition: Callable[[], bool], process: subprocess.Popen[str], seconds: float = 120) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert process.poll() is None, process.communicate()[0]
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    (folder / "study.toml").write_text(STUDY)
    return folder


@pytest.fixture(scope="module")
def uninterrupted(home: Path) -> Path:
    """The study by one worker, never disturbed."""
    process = start(home, "--workers", "1")
    printed = process.communicate()[0]
    assert process.returncode == 0, printed
    assert "200/200 runs" in printed
    return home / "runs" / "study-1"


def test_a_study_writes_what_the_contract_says(uninterrupted: Path) -> None:
    result = load_study(uninterrupted)
    assert len(result.comparison) == 2 * 2 * 100 * (3 + 4 * 3)  # the newest frame, and all four smoothed
    assert not result.comparison.duplicated(["point", "run", "estimator", "entity", "t_s", "axis"]).any()
    metrics = pd.read_csv(uninterrupted / "metrics.csv")
    assert list(metrics.columns) == METRIC_COLUMNS
    assert set(metrics["point"]) == {"measure.sigma_px=0.1", "measure.sigma_px=0.3"}
    assert (metrics["runs"] == 100).all()
    rms = metrics[(metrics["statistic"] == "rms") & (metrics["axis"] == "z") & (metrics["entity"] == "target")]
    for point in set(rms["point"]):
        rows = result.comparison[(result.comparison["point"] == point) & (result.comparison["estimator"] == "a")]
        z = rows.loc[(rows["axis"] == "z") & (rows["entity"] == "target"), "error"]
        row = rms[(rms["point"] == point) & (rms["estimator"] == "a")].iloc[0]
        assert row["value"] == pytest.approx(np.sqrt(np.mean(z**2)), rel=1e-12)
        assert row["ci_low"] < row["value"] < row["ci_high"]
    table = pd.read_csv(uninterrupted / "table.csv")
    assert list(table["measure.sigma_px"]) == [0.1, 0.1, 0.3, 0.3]
    assert table["crb"].tolist() == pytest.approx(3 * table["crb"].tolist()[0] / np.array([3, 3, 1, 1]))
    assert {p.suffix for p in (uninterrupted / "figures").iterdir()} == {".png", ".svg", ".pdf"}
    page = (uninterrupted / "report.html").read_text()
    assert "http://" not in page.replace("http://www.w3.org", "")
    for word in ("Grid of points, twice", "measure.sigma_px", "100 runs each", "data:image/png"):
        assert word in page


def test_points_share_their_noise(uninterrupted: Path) -> None:
    """Common random numbers: the same run at three times the noise errs three times as much, nearly."""
    c = load_study(uninterrupted).comparison
    z = c[(c["axis"] == "z") & (c["entity"] == "target") & (c["estimator"] == "a")]
    errors = z.pivot_table(index="run", columns="point", values="error", observed=True).to_numpy()
    assert np.corrcoef(errors.T)[0, 1] > 0.99


def test_killed_and_resumed_equals_the_uninterrupted(home: Path, uninterrupted: Path) -> None:
    folder = home / "killed"
    arguments = ("--workers", "2", "--out", str(folder))
    parts = folder / "parts"

    def stored() -> set[str]:
        return {p.name for p in parts.glob("[!.]*.parquet")} if parts.is_dir() else set()

    process = start(home, *arguments)
    wait_for(lambda: len(stored()) >= 2, process)
    before = stored()
    children = psutil.Process(process.pid).children(recursive=True)
    workers = [p for p in children if "spawn_main" in " ".join(p.cmdline())]
    assert len(workers) == 2
    workers[0].send_signal(signal.SIGKILL)
    wait_for(lambda: len(stored()) >= len(before) + 2, process)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    done = stored()
    assert before < done
    assert not (folder / "results").exists()
    times = {name: (parts / name).stat().st_mtime_ns for name in done}

    again = start(home, *arguments)
    printed = again.communicate()[0]
    assert again.returncode == 0, printed
    assert "going on" in printed
    assert times == {name: (parts / name).stat().st_mtime_ns for name in done}
    assert results(folder) == results(uninterrupted)


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A scheduler and a worker started by hand on another loopback address."""
    folder = tmp_path_factory.mktemp("dask")
    file = folder / "scheduler.json"
    dask = [sys.executable, "-m", "dask"]
    there = ["--host", "127.0.0.2", "--no-dashboard"]
    quiet: dict[str, Any] = {"cwd": folder, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    first = subprocess.Popen(
        [*dask, "scheduler", *there, "--port", "0", "--scheduler-file", str(file)], env=environment(), **quiet
    )
    deadline = time.monotonic() + 60
    while not file.is_file() or not file.read_text():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    address = json.loads(file.read_text())["address"]
    worker = [*dask, "worker", address, "--host", "127.0.0.2", "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    second = subprocess.Popen(worker, env=environment(), **quiet)
    yield str(address)
    for process in (second, first):
        process.terminate()
        process.wait(30)


def test_a_scheduler_started_by_hand_goes_on(home: Path, uninterrupted: Path, scheduler: str) -> None:
    """With what fewer runs on this machine have left."""
    assert scheduler.startswith("tcp://127.0.0.2:")
    folder = home / "by-hand"
    for arguments in (("--workers", "2", "--runs", "20"), ("--scheduler", scheduler)):
        process = start(home, *arguments, "--out", str(folder))
        printed = process.communicate()[0]
        assert process.returncode == 0, printed
    assert "going on: 40 of 200 runs" in printed
    assert results(folder) == results(uninterrupted)


def refused(result: Result, *words: str) -> None:
    assert result.status == 2, result
    lines = result.err.strip().splitlines()
    assert len(lines) == 1, lines
    for word in words:
        assert word in lines[0], (word, lines[0])


def test_a_scheduler_that_is_not_there(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study_cluster, "_CONNECT_S", 0.5)
    for address in ("tcp://127.0.0.2:9", "nonsense://x", "127.0.0.2"):
        refused(
            command("study", "depth-bias-map", "--scheduler", address), f"--scheduler {address}", "no Dask scheduler"
        )
        assert not Path("runs").exists()


@pytest.mark.parametrize(
    ("name", "words"),
    [("distributed", ("the scheduler has", "1.2.3")), ("numba", ("the worker", "has numba", "1.2.3"))],
)
def test_a_scheduler_with_other_versions(
    command: Command, scheduler: str, monkeypatch: pytest.MonkeyPatch, name: str, words: tuple[str, ...]
) -> None:
    real = study_cluster.version
    monkeypatch.setattr(study_cluster, "version", lambda package: "1.2.3" if package == name else real(package))
    refused(command("study", "depth-bias-map", "--scheduler", scheduler), f"--scheduler {scheduler}", *words)


def test_failed_runs_are_kept_and_make_the_exit_status(home: Path) -> None:
    text = STUDY.replace("measure.sigma_px", "vehicle.0.motion.start_m.1").replace("[0.1, 0.3]", "[20, -20]")
    (home / "failing.toml").write_text(text)
    process = subprocess.run(
        [sys.executable, "-m", "scenarios.cli", "study", "failing.toml", "--runs", "3", "--workers", "1"],
        cwd=home,
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 1, process.stdout + process.stderr
    assert "3 failed runs: ScenarioError" in process.stdout
    result = load_study(home / "runs" / "failing-1")
    crashed = result.failures[result.failures["kind"] == "exception"]
    assert crashed["run"].tolist() == [0, 1, 2]
    assert set(crashed["point"]) == {"vehicle.0.motion.start_m.1=-20"}
    assert "Traceback" in crashed["traceback"].iloc[0]
    assert len(result.support) == 2 * 3  # the other point is whole
    assert "never visible" in (home / "runs" / "failing-1" / "report.html").read_text()


def test_results_of_another_study_are_refused(uninterrupted: Path, home: Path, command: Command) -> None:
    (home / "other.toml").write_text(STUDY.replace("[0.1, 0.3]", "[0.1, 0.2]"))
    arguments = ("study", str(home / "other.toml"), "--out", str(uninterrupted))
    refused(command(*arguments), "another configuration", "--overwrite")
    file = uninterrupted / "provenance.json"
    known = file.read_text()
    file.write_text(json.dumps(json.loads(known) | {"code": "other"}))
    refused(command("study", str(home / "study.toml"), "--out", str(uninterrupted)), "another version of the code")
    file.write_text(known)
    occupied = home / "occupied"
    occupied.mkdir()
    (occupied / "thesis.txt").write_text("x")
    refused(command("study", str(home / "study.toml"), "--out", str(occupied)), "not a study folder")
    refused(
        command("study", str(home / "study.toml"), "--out", str(occupied / "thesis.txt" / "x")), "cannot be written"
    )


def test_a_finished_study_only_makes_its_report_anew(uninterrupted: Path, home: Path, command: Command) -> None:
    before = results(uninterrupted)
    (uninterrupted / "table.csv").unlink()
    result = command("study", str(home / "study.toml"), "--out", str(uninterrupted))
    assert result.status == 0
    assert "are there already" in result.out
    assert results(uninterrupted) == before


def test_only_a_single_run_is_blamed_for_the_death_of_its_workers() -> None:
    class Dead:
        def result(self) -> None:
            raise KilledWorker("task", None, 3)

    assert _outcome(Dead(), Block(0, range(3, 5))) is None
    done = _outcome(Dead(), Block(0, range(4, 5)))
    assert done is not None
    assert done.failed == 1
    row = pd.read_parquet(io.BytesIO(done.part)).iloc[0]
    assert (row["table"], row["run"], row["kind"]) == ("failures", 4, "exception")
    assert "died, 4 times" in row["reason"]


def test_whatever_else_goes_wrong_stops_the_study_and_blames_no_run() -> None:
    class Lost:
        def result(self) -> None:
            raise OSError("connection lost\nand more")

    with pytest.raises(StudyStopped, match=r"^connection lost$"):
        _outcome(Lost(), Block(0, range(1)))


def test_blocks_hold_every_run_once() -> None:
    gaps = [Block(0, range(3, 50)), Block(1, range(200)), Block(2, range(7, 8))]
    blocks = Blocks(iter(gaps), workers=2)
    taken: list[tuple[int, int]] = []
    sizes = []
    split = False
    while (block := blocks.take()) is not None:
        if len(block.runs) == 5 and not split:
            split = True
            blocks.split(block)
            continue
        sizes.append(len(block.runs))
        taken += [(block.point, run) for run in block.runs]
        blocks.took(block, 0.2 * len(block.runs))
    assert split
    assert sorted(taken) == sorted((b.point, run) for b in gaps for run in b.runs)
    assert len(taken) == len(set(taken))
    assert max(sizes) == 5  # a fifth of a second each
    assert sizes[0] == sizes[-1] == 1
