"""Figures over the parameters of a study show every number they are given."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from reports.figures.sweep import sweep_lines, sweep_map

X, Y = (10.0, 20.0, 40.0), (0.1, 0.2)


@pytest.fixture
def table() -> pd.DataFrame:
    rows = [(e, x, y, sign * x * y) for e, sign in (("a", 1), ("b", -0.1)) for x in X for y in Y]
    table = pd.DataFrame(rows, columns=["estimator", "x", "y", "value"])
    return table.assign(ci_low=table["value"] - 0.1, ci_high=table["value"] + 0.3)


def test_a_map_has_a_panel_per_estimator_and_a_number_per_cell(table: pd.DataFrame) -> None:
    figure = sweep_map(table.iloc[1:], "x", "y", ("distance", "noise", "bias [m]"), ["a", "b"])
    a, b, _bar = figure.axes
    assert [a.get_title(loc="left"), b.get_title(loc="left")] == ["a", "b"]
    cells = {t.get_position(): t.get_text() for t in a.texts}
    assert cells[(2, 1)] == "8.00"
    assert (0, 0) not in cells  # the row that is missing
    assert {t.get_text() for t in b.texts} == {"−0.10", "−0.20", "−0.40", "−0.80"}
    low, high = a.images[0].get_clim()
    assert (low, high) == (-8, 8) == b.images[0].get_clim()


def test_lines_have_bars_where_there_are_intervals(table: pd.DataFrame) -> None:
    rows = table[table["y"] == 0.1].rename(columns={"estimator": "line"})
    rows.loc[rows.index[0], ["ci_low", "ci_high"]] = np.nan
    bound = pd.DataFrame({"line": "", "x": X, "value": (1.0, 2.0, 3.0)})
    figure = sweep_lines(rows, "x", ("distance", "rms [m]"), bound=bound)
    ax = figure.axes[0]
    drawn = {line.get_label(): line for line in ax.lines}
    np.testing.assert_allclose(drawn["a"].get_ydata(), [1, 2, 4])
    np.testing.assert_allclose(drawn["Cramér-Rao bound"].get_ydata(), [1, 2, 3])
    bars = [c.get_segments() for c in ax.collections]
    assert [len(b) for b in bars] == [2, 3]
    np.testing.assert_allclose(bars[0][0], [[20, 1.9], [20, 2.3]])
