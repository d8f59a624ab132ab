"""Tables of a study that hold no rows."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from reports.studies import _read


def test_an_empty_table_knows_more_points_than_a_byte_counts(tmp_path: Path) -> None:
    points = [f"point {i}" for i in range(200)]
    file = tmp_path / "nees.parquet"
    pd.DataFrame({"point": pd.Series([], dtype="str"), "estimator": pd.Series([], dtype="str")}).to_parquet(file)
    table = _read(file, {"point": points, "estimator": ["one"]})
    assert table[table["point"] == points[-1]].empty
    assert list(table["point"].cat.categories) == points
