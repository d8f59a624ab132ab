"""Wall time and memory of ``run oncoming``: stage cache cold, compiled kernels warm, in a process of its own.

Prints the seconds of the whole run and of its stages, the peak of the resident memory, and the memory over the
middle half of the rendering, which must not grow with the frames.

    python benchmarks/run_oncoming.py
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

COMMAND = [sys.executable, "-m", "scenarios.cli", "run", "oncoming", "--out"]
WARM_UP = ["--set", "rig.frames=4", "--set", "render.enabled=false"]


def resident_mb(pid: int) -> float:
    pages = Path(f"/proc/{pid}/statm").read_text().split()[1]
    return int(pages) * resource.getpagesize() / 1e6


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([*COMMAND, f"{folder}/warm", *WARM_UP], check=True, capture_output=True)
        out, memory = Path(folder) / "run", []
        started = time.perf_counter()
        with subprocess.Popen([*COMMAND, str(out)], stdout=subprocess.DEVNULL) as process:
            while process.poll() is None:
                memory.append((time.perf_counter() - started, resident_mb(process.pid)))
                time.sleep(0.2)
        seconds = time.perf_counter() - started
        stages = {k: v["seconds"] for k, v in json.loads((out / "provenance.json").read_text())["stages"].items()}
    print(f"exit status {process.returncode}, {seconds:.1f} s")
    for stage, duration in stages.items():
        print(f"  {stage:<30}{duration:6.1f} s")
    t, mb = np.array(memory).T
    middle = (t > stages["simulate"] + 0.25 * stages["render"]) & (t < stages["simulate"] + 0.75 * stages["render"])
    print(f"memory: peak {mb.max():.0f} MB; {mb[middle][0]:.0f} to {mb[middle][-1]:.0f} MB over half of the frames")


if __name__ == "__main__":
    main()
