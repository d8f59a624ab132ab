"""What the regression check shows on the terminal: counts first, then every metric that is better or worse."""

from __future__ import annotations

import pandas as pd
from rich.console import Console
from rich.table import Table

from reports.regression.files import counts, name

_SHOWN = {"worse": "red", "better": "green"}


def show(console: Console, verdicts: pd.DataFrame) -> None:
    """Prints the verdicts; those that are the same, new or missing as numbers only."""
    found = counts(verdicts)
    console.print(", ".join(f"{n} {v}" for v, n in found.items() if n) or "nothing measured", highlight=False)
    changed = verdicts[verdicts["verdict"].isin(list(_SHOWN))]
    if changed.empty:
        return
    table = Table(box=None, pad_edge=False, show_edge=False, padding=(0, 1, 0, 0))
    for column in ("", "scene", "estimator", "metric", "was", "is", "", "why"):
        table.add_column(column, justify="right" if column in ("was", "is") else "left", overflow="fold")
    order = changed.assign(rank=changed["verdict"] != "worse", size=-(changed["change"].abs() / changed["smallest"]))
    for row in order.sort_values(["rank", "size"], kind="stable").to_dict("records"):
        why = row["reason"] or f"p {row['p']:.2g}"
        numbers = [f"{row[k]:.3g}" for k in ("old", "new")]
        unit = "" if row["unit"] == "1" else row["unit"]
        table.add_row(
            row["verdict"], row["scene"], row["estimator"], name(row), *numbers, unit, why, style=_SHOWN[row["verdict"]]
        )
    console.print(table, highlight=False)
