"""Real traffic: cars of KITTI tracking labels driven again, estimated where they are seen, near their bound."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from tests.end_to_end.conftest import run


@pytest.mark.shared_data
@pytest.mark.parametrize(
    ("sequence", "track", "moving"), [("0004", 2, False), ("0000", 0, True), ("0003", 0, True), ("0010", 0, False)]
)
def test_replay_of_a_real_label(sequence: str, track: int, moving: bool, shared_data: Path, tmp_path: Path) -> None:
    labels = shared_data / "kitti_tracking"
    settings = [f"vehicle.0.motion.labels={labels / sequence}.txt", f"vehicle.0.motion.track={track}"]
    settings += ["render.enabled=false", "world.roadside=false"]
    if moving:
        settings.append(f"ego.poses={labels / sequence}.camera.txt")
    out = tmp_path / "run"
    result = run("replay", out, *settings)
    assert result.returncode == 0, result
    m = pd.read_csv(out / "metrics.csv", keep_default_na=False)
    assert float(m[m["statistic"] == "converged"]["value"].iloc[0]) >= 0.9
    z = m[(m["quantity"] == "position") & (m["axis"] == "z") & (m["bin"] == "") & (m["entity"] == "target")]
    value = dict(zip(z["statistic"], z["value"].astype(float), strict=True))
    assert value["crb"] / 2 < value["rms"] < 3 * value["crb"]
