"""A page: several studies run one after the other on the same workers, and one report that shows them all."""

from __future__ import annotations

import dataclasses
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from reports.study_page import write_page
from scenarios import spec, study, study_spec
from scenarios.study_cluster import connected
from scenarios.study_console import Progress
from sim.scenario import ScenarioError, Spec, explain

FOLDER = Path(__file__).parent / "pages"


class Page(Spec):
    """The file of a page."""

    title: str
    source: str = ""
    kind: Literal["page"]
    intro: str = ""
    studies: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names of studies, in the order of the page."""


def names() -> dict[str, Path]:
    """The pages that ship with the project, by name."""
    return {p.stem: p for p in sorted(FOLDER.glob("*.toml"))}


def is_page(name_or_file: str) -> bool:
    """Whether this is the name of a page, or a file that says it is one."""
    path = names().get(name_or_file, Path(name_or_file))
    return path.is_file() and spec.load(path).get("kind") == "page"


def read(name_or_file: str) -> Page:
    """The validated page of a name or file.

    Raises
        ScenarioError: one line that names file and key.
    """
    path = names().get(name_or_file, Path(name_or_file))
    try:
        page = Page.model_validate(spec.load(path))
    except ValidationError as error:
        raise ScenarioError(f"{path.name}: {explain(error, Page)}") from error
    for i, name in enumerate(page.studies):
        try:
            study_spec.find(name)
        except ScenarioError as error:
            raise ScenarioError(f"{path.name}: studies.{i}: {error}") from error
    return page


def run(asked: study.Asked, progress: Progress) -> study.Outcome:
    """Runs what is missing of every study, each into its own folder, then writes report.html into the page's.

    Raises
        ScenarioError, StudyStopped: as `study.run`.
    """
    page = read(asked.study)
    folder = asked.out or Path("runs") / Path(asked.study).stem
    failed: Counter[str] = Counter()
    members = []
    with ExitStack() as stack:
        address = asked.scheduler
        if address is None:
            address = str(stack.enter_context(connected(asked.workers, None)).scheduler.address)
        for name in page.studies:
            progress.say(name)
            out = None if asked.out is None else asked.out / name
            outcome = study.run(dataclasses.replace(asked, study=name, out=out, scheduler=address), progress)
            members.append(outcome.folder)
            failed.update(outcome.failed)
    folder.mkdir(parents=True, exist_ok=True)
    write_page(folder, page.title, page.source, page.intro, members)
    return study.Outcome(folder, dict(failed))
