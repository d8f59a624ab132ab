"""Baselines as CSV, one file per scene; verdicts as JSON and JUnit."""

from __future__ import annotations

import json
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd

from reports.regression.verdicts import KEY, LABELS, VERDICTS
from sim.archive import write_atomically, write_text

_DIGITS = 5  # far finer than any difference that matters, coarser than what another processor changes


def read_baselines(folder: Path) -> pd.DataFrame:
    """The baselines of all scenes in a folder, as `verdicts.compare` takes them; empty where there are none.

    Raises
        ValueError: a file is not one of ours.
    """
    tables = [pd.DataFrame(columns=LABELS, dtype=str)]
    for path in sorted(folder.glob("*.csv")):
        try:
            table = pd.read_csv(path, dtype=dict.fromkeys(LABELS, str)).assign(scene=path.stem)
            runs = [c for c in table.columns if c not in LABELS]
            table[runs] = table[runs].astype(float)
            whole = set(LABELS) <= set(table.columns) and all(c.isdigit() for c in runs)
        except (OSError, ValueError) as error:
            raise ValueError(f"{path}: is no baseline: {error}") from error
        if not whole or table[LABELS].isna().to_numpy().any() or table.duplicated(KEY).any():
            raise ValueError(
                f"{path}: is no baseline: expected each metric once, with {', '.join(LABELS[1:])} and runs"
            )
        tables.append(table)
    return pd.concat(tables, ignore_index=True)


def write_baselines(folder: Path, table: pd.DataFrame) -> None:
    """Writes one file per scene and removes those of scenes that are no more."""
    for path in folder.glob("*.csv"):
        if path.stem not in set(table["scene"]):
            path.unlink()
    for scene, rows in table.groupby("scene", sort=False):
        text = rows.drop(columns="scene").to_csv(index=False, float_format=f"%.{_DIGITS}g", lineterminator="\n")
        write_text(folder / f"{scene}.csv", text)


def counts(verdicts: pd.DataFrame) -> dict[str, int]:
    """Number of metrics with each verdict."""
    return {v: int((verdicts["verdict"] == v).sum()) for v in VERDICTS}


def name(row: Mapping[Hashable, Any]) -> str:
    """A metric in words, e.g. "position z bias"."""
    parts = [row["quantity"], "" if row["axis"] == "all" else row["axis"], row["statistic"]]
    return " ".join(p for p in parts if p).replace("_", " ")


def explained(row: Mapping[Hashable, Any]) -> str:
    """A verdict in words."""
    text = f"{name(row)}: {row['old']:.4g} -> {row['new']:.4g} {row['unit']}"
    if np.isfinite(row["change"]):
        text += f", {abs(row['change']):.3g} {row['verdict']} ({row['smallest']:.3g} matters)"
    return text + (f", {row['reason']}" if row["reason"] else f", chance {row['p']:.2g}")


def write_json(path: Path, verdicts: pd.DataFrame, about: Mapping[str, Any]) -> None:
    """All verdicts with their numbers, after what is known ``about`` the check."""
    rows = verdicts.astype(object).where(verdicts.notna(), None).to_dict("records")
    write_text(path, json.dumps({**about, "counts": counts(verdicts), "verdicts": rows}, indent=1) + "\n")


def write_junit(path: Path, verdicts: pd.DataFrame) -> None:
    """One test case per metric, a suite per scene: worse fails; new and missing are skipped."""
    root = ElementTree.Element("testsuites", name="pruefstand check")
    for scene, rows in verdicts.groupby("scene", sort=False):
        n = counts(rows)
        totals = {"tests": len(rows), "failures": n["worse"], "errors": 0, "skipped": n["new"] + n["missing"]}
        suite = ElementTree.SubElement(root, "testsuite", {"name": str(scene)} | {k: str(v) for k, v in totals.items()})
        for row in rows.to_dict("records"):
            classname = f"{scene}.{row['estimator']}"
            case = ElementTree.SubElement(suite, "testcase", classname=classname, name=name(row), time="0")
            if row["verdict"] == "worse":
                ElementTree.SubElement(case, "failure", message=explained(row), type="worse")
            elif row["verdict"] in ("new", "missing"):
                ElementTree.SubElement(case, "skipped", message=row["verdict"])
    ElementTree.indent(root)
    document = ElementTree.ElementTree(root)
    write_atomically(path, lambda p: document.write(p, encoding="utf-8", xml_declaration=True))
