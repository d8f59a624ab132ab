"""Several studies that have run on one self-contained page: what the source says, then figures and tables of each."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from reports.html import embedded, template
from reports.study_html import cells
from sim.archive import write_text

CLAIMS = "_claims"  # how the names of tables of statements end


@dataclass(frozen=True)
class Section:
    """One study: its described file, statements of the source as rows, and what the page shows of it."""

    study: dict[str, Any]
    link: str
    claims: list[list[str]]
    figures: list[tuple[str, str, str]]
    tables: list[tuple[str, str, list[tuple[str, str]], list[list[str]]]]
    failed: int


def write_page(folder: Path, title: str, source: str, intro: str, studies: Sequence[Path]) -> None:
    """Writes report.html of the studies in these folders, which have tables, figures and reports of their own."""
    sections = [_section(folder, path) for path in studies]
    provenance = json.loads((studies[0] / "provenance.json").read_text("utf-8"))
    page = template("page.html.j2").render(
        title=title, source=source, intro=intro, sections=sections, provenance=provenance
    )
    write_text(folder / "report.html", page)


def _section(page: Path, folder: Path) -> Section:
    """A study from what its own report has left in its folder."""
    study = json.loads((folder / "study.json").read_text("utf-8"))
    claims: list[list[str]] = []
    tables = []
    for i, spec in enumerate(study["table"]):
        table = pd.read_csv(folder / (f"table-{spec['label']}.csv" if i else "table.csv"), keep_default_na=True)
        heads, rows, _ = cells(table)
        if spec["name"].endswith(CLAIMS):
            claims = rows
        else:
            tables.append((spec["label"], spec["caption"], heads, rows))
    figures = [
        (spec["label"], spec["caption"], embedded(folder / "figures" / f"{spec['label']}.png"))
        for spec in study["figure"]
    ]
    failed = pd.read_parquet(folder / "results" / "failures.parquet", columns=["kind"])
    return Section(study, os.path.relpath(folder, page), claims, figures, tables, len(failed))
