"""The command line: list, run, study, check, schema, test; README holds its contract of names, files, exit statuses.

Exit status 0 done; 1 a check failed, or no estimator gave anything; 2 the user's input is wrong (one line on standard
error); 3 an exception: a bug or a broken renderer.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tomllib
import traceback
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from rich.console import Console
from rich.table import Table

from sim.scenario import ScenarioError, nearest

# Bit-identical results need one order of summation, and two threads of BLAS only fight over small matrices.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

_COMMANDS = ("list", "run", "study", "check", "schema", "test")


class _Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        raise ScenarioError(f"{message} (see {self.prog} --help)")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="pruefstand", description="Simulation and evaluation test bench for motion from images.")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=_Parser)
    commands.add_parser("list", help="scenarios, studies and estimators, each with one line and its source")
    run = commands.add_parser("run", help="simulate, estimate and report one scenario")
    run.add_argument("scenario", metavar="NAME|FILE.toml")
    run.add_argument(
        "--set", dest="settings", action="append", default=[], metavar="KEY=VALUE", help="e.g. rig.frames=20"
    )
    run.add_argument("--seed", type=int)
    run.add_argument("--out", type=Path, metavar="DIR", help="default: runs/NAME-SEED")
    run.add_argument("--estimator", action="append", default=[], metavar="LABEL", help="only this one; may be repeated")
    run.add_argument(
        "--stage", choices=("simulate", "track", "estimate", "report"), default="report", help="stop after it"
    )
    run.add_argument("--overwrite", action="store_true", help="replace results of another configuration")
    _add_study(commands.add_parser("study", help="simulate, estimate and report many runs of what a study file varies"))
    _add_check(commands.add_parser("check", help="regression: every baseline against this code, a verdict per metric"))
    schema = commands.add_parser("schema", help="JSON Schema of scenario or study files")
    schema.add_argument("kind", nargs="?", choices=("scenario", "study"), default="scenario")
    commands.add_parser("test", help="the whole test suite with lint, types and house order")
    return parser


def _add_study(study: argparse.ArgumentParser) -> None:
    study.add_argument("study", metavar="NAME|FILE.toml")
    study.add_argument("--runs", type=int, help="of every point; by default the file's")
    where = study.add_mutually_exclusive_group()
    where.add_argument(
        "--workers", type=_positive, metavar="N", help="processes on this machine; default: one per core"
    )
    where.add_argument("--scheduler", metavar="tcp://...", help="a running Dask scheduler")
    study.add_argument("--set", dest="settings", action="append", default=[], metavar="KEY=VALUE", help="at all points")
    study.add_argument("--seed", type=int)
    study.add_argument(
        "--estimator", action="append", default=[], metavar="LABEL", help="only this one; may be repeated"
    )
    study.add_argument("--out", type=Path, metavar="DIR", help="default: runs/NAME-SEED")
    study.add_argument("--overwrite", action="store_true", help="replace results of another configuration")


def _positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"should be 1 or more, found {number}")
    return number


def _add_check(check: argparse.ArgumentParser) -> None:
    check.add_argument("battery", nargs="?", type=Path, metavar="FILE.toml", help="default: the project's own battery")
    check.add_argument("--update", action="store_true", help="make this code's results the baselines")
    check.add_argument("--workers", type=int, metavar="N", help="processes; default: one per processor")
    check.add_argument("--out", type=Path, metavar="DIR", help="for verdicts.json and junit.xml; default: runs/check")


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    errors = Console(stderr=True, soft_wrap=True)
    try:
        status = _obey(arguments, errors)
        sys.stdout.flush()
        return status
    except BrokenPipeError:  # the reader has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _obey(arguments: Sequence[str], errors: Console) -> int:
    """Runs one command; every way it can end is an exit status."""
    try:
        if arguments and not arguments[0].startswith("-") and arguments[0] not in _COMMANDS:
            raise ScenarioError(f"no command {arguments[0]!r}, {nearest(arguments[0], list(_COMMANDS))}")
        try:
            parsed = _parser().parse_args(arguments or ["--help"])
        except SystemExit:  # argparse has printed its help
            return 0
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_: errors.print(f"pruefstand: warning: {message}", markup=False)
            return _dispatch(parsed)
    except ScenarioError as error:
        errors.print(f"pruefstand: {error}", markup=False, highlight=False)
        return 2
    except KeyboardInterrupt:
        errors.print("pruefstand: interrupted", markup=False, highlight=False)
        return 3
    except BrokenPipeError:
        raise
    except Exception as error:  # the last resort of the process: status 3 and everything a bug report needs
        from sim.render import RendererUnavailable

        if isinstance(error, RendererUnavailable):
            errors.print(f"pruefstand: {error}; or --set render.enabled=false", markup=False, highlight=False)
        else:
            traceback.print_exc()
        return 3


def _dispatch(parsed: argparse.Namespace) -> int:
    if parsed.command == "run":
        return _run(parsed)
    if parsed.command == "list":
        return _list()
    if parsed.command == "schema":
        from scenarios import spec, study_spec

        print(json.dumps({"scenario": spec, "study": study_spec}[parsed.kind].json_schema(), indent=2))
        return 0
    if parsed.command == "study":
        return _study(parsed)
    if parsed.command == "check":
        return _check(parsed)
    return _test()


def _run(parsed: argparse.Namespace) -> int:
    from scenarios import spec, summary
    from scenarios.console import Reporter

    console = Console()
    scenario = spec.read(parsed.scenario, parsed.settings, parsed.seed)
    name = spec.find(parsed.scenario).stem
    out = parsed.out or Path("runs") / f"{name}-{scenario.seed}"
    progress = Reporter(console)
    outcome = _engine(scenario.kind)(name, scenario, out, progress, parsed.stage, parsed.estimator, parsed.overwrite)
    for label, reason in outcome.failed.items():
        progress.say(f"estimator {label!r} gave nothing: {reason}")
    if parsed.stage == "report":
        summary.show(console, outcome.folder)
        progress.say(f"report  {outcome.folder / 'report.html'}")
    return 0 if outcome.any_estimate or parsed.stage in ("simulate", "track") else 1


def _engine(kind: str) -> Callable[..., Any]:
    """What runs a scenario of a kind."""
    if kind == "flight":
        from scenarios import flight

        return flight.run
    if kind == "calibration":
        from scenarios import calibration

        return calibration.run
    if kind == "recording":
        from scenarios import recording

        return recording.run
    from scenarios import engine

    return engine.run


def _study(parsed: argparse.Namespace) -> int:
    from scenarios import study, study_page
    from scenarios.study_console import Progress
    from scenarios.study_work import StudyStopped

    progress = Progress(Console())
    asked = study.Asked(**{f: getattr(parsed, f) for f in study.Asked.__dataclass_fields__})
    try:
        outcome = (study_page if study_page.is_page(asked.study) else study).run(asked, progress)
    except StudyStopped as error:
        Console(stderr=True, soft_wrap=True).print(
            f"pruefstand: {error}; what is done is stored, the same command goes on", markup=False, highlight=False
        )
        return 3
    for reason, count in outcome.failed.items():
        progress.say(f"{count} failed {'run' if count == 1 else 'runs'}: {reason}")
    progress.say(f"report  {outcome.folder / 'report.html'}")
    return 1 if outcome.failed else 0


def _check(parsed: argparse.Namespace) -> int:
    from scenarios import check, check_console
    from scenarios.console import Reporter

    console = Console()
    progress = Reporter(console, unit="runs")
    out = parsed.out or Path("runs") / "check"
    outcome = check.check(parsed.battery or check.BATTERY, out, progress, parsed.workers, parsed.update)
    check_console.show(console, outcome.verdicts)
    if parsed.update:
        progress.say(f"baselines  {outcome.baselines}")
    elif outcome.unknown:
        progress.say("new metrics have no baseline yet: pruefstand check --update makes it")
    progress.say(f"verdicts  {out / 'verdicts.json'}  {out / 'junit.xml'}")
    return 1 if outcome.worse and not parsed.update else 0


def _list() -> int:
    from estimators import registry
    from estimators.aerial.boresight_estimators import CALIBRATION_ESTIMATORS
    from estimators.aerial.registry import FLIGHT_ESTIMATORS
    from estimators.estimate import describe
    from scenarios import spec, study_page, study_spec

    console = Console()
    table = Table(box=None, pad_edge=False, show_edge=False, title_justify="left")
    for column in ("name", "what", "source"):
        table.add_column(column, overflow="fold")
    for name, path in (spec.names() | study_spec.names() | study_page.names()).items():
        data = tomllib.loads(path.read_text(encoding="utf-8"))
        table.add_row(name, data["title"], data.get("source", ""))
    for name, cls in {**registry(), **FLIGHT_ESTIMATORS, **CALIBRATION_ESTIMATORS}.items():
        what, _, source = describe(cls).partition(" (")
        table.add_row(name, what, source.rstrip(").") if source else "")
    console.print(table, highlight=False)
    return 0


def _test() -> int:
    """Lint, types, house order and tests, in this order; the first failure ends it."""
    root = Path(__file__).resolve().parent.parent
    if not (root / "tests").is_dir():
        raise ScenarioError(f"test: there is no checkout with tests at {root}")
    python = Path(sys.executable)
    steps = (
        [str(python), "-m", "ruff", "check", "."],
        [str(python), "-m", "ruff", "format", "--check", "."],
        [str(python), "-m", "mypy"],
        [str(python.parent / "lint-imports")],
        [str(python), "-m", "pytest", "-q", "-n", "2", "--dist=loadfile", "--durations=8"],
    )
    for step in steps:
        print("$", " ".join([Path(step[0]).name, *step[1:]]), flush=True)
        if subprocess.run(step, cwd=root, check=False).returncode:
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
