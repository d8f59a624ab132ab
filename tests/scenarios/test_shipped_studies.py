"""Every study and page that ships: valid, measurable, and one of them from its file to the page."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from rich.console import Console

from scenarios import study, study_page, study_spec
from scenarios.study_console import Progress
from scenarios.study_points import expand
from scenarios.study_subject import labels, measured
from scenarios.trial import NIS
from sim.scenario import ScenarioError

# A bare street and the first three windows of ten frames: rendering takes a second, not a minute.
_SHORT = ("rig.frames=12", "world.roadside=false", "realism={}")


@pytest.mark.parametrize("name", study_spec.names())
def test_every_study_is_valid_and_every_estimator_gives_something(name: str) -> None:
    spec, base = study_spec.read(name, runs=1)
    if base.get("measure", {}).get("from") == "images":
        spec, base = study_spec.read(name, _SHORT, runs=1)
    points = expand(spec, base, study_spec.FOLDER)
    assert spec.title
    assert spec.source
    assert spec.table or spec.figure
    found = measured(points[0].scenario, 0, spec.keep)
    rows = found.comparison if spec.experiment is None else found.measures
    assert set(rows["estimator"]) == set(labels(points[0].scenario))
    if spec.experiment is None:
        assert set(rows["quantity"]) == set(spec.keep) - {NIS}


@pytest.mark.parametrize("name", study_page.names())
def test_every_page_names_studies_that_are_there(name: str) -> None:
    page = study_page.read(name)
    assert len(set(page.studies)) == len(page.studies)
    assert study_page.is_page(name)
    assert not study_page.is_page(page.studies[0])


def test_a_page_of_a_study_that_is_not_there(tmp_path: Path) -> None:
    file = tmp_path / "page.toml"
    file.write_text('title = "x"\nkind = "page"\nstudies = ["siegemund-fig-4-1-77"]\n')
    with pytest.raises(ScenarioError, match=r"page.toml: studies.0: no study .* did you mean"):
        study_page.read(str(file))


def test_a_page_from_its_file_to_its_report(tmp_path: Path) -> None:
    file = tmp_path / "page.toml"
    file.write_text('title = "One figure"\nsource = "x"\nkind = "page"\nstudies = ["siegemund-fig-3-7-10"]\n')
    asked = study.Asked(str(file), runs=2, workers=1, out=tmp_path / "out")
    outcome = study_page.run(asked, Progress(Console(quiet=True)))
    assert not outcome.failed
    folder = outcome.folder / "siegemund-fig-3-7-10"
    moved = pd.read_csv(folder / "table.csv").set_index("start values")["origin moved by [m]"]
    # A fifth of the tracks leaps over the five layers of 1.25 m that stay; 6 sigma of the depth of the points.
    assert moved["from the cloud"] == pytest.approx(1.25, abs=0.1)
    assert moved["propagated"] < 0.1
    text = (outcome.folder / "report.html").read_text()
    assert text.count("data:image/png;base64,") == 1
    assert "origin moves by" in text
    assert 'href="siegemund-fig-3-7-10/report.html"' in text
    assert "http" not in text
