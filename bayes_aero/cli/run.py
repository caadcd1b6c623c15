"""bayes-aero run."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from bayes_aero.cli import terminal
from bayes_aero.errors import InputError
from bayes_aero.progress import Progress

if TYPE_CHECKING:
    from bayes_aero.study.run import Planned, UnitRunner
    from bayes_aero.study.study import Study

SILENCE = 15.0  # seconds without workers after which that is told also where there is no terminal
SCHEMA = "bayes_aero/study/1"


def run(
    study: Annotated[Path, typer.Argument(help="A study (.toml).")],
    out: Annotated[Path | None, typer.Option(help="Folder for the results; default: STUDY_results, here.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="List the units and their state; do nothing.")] = False,
    trust_effects: Annotated[
        bool, typer.Option("--trust-effects", help="Run the effect files (Python) of its cards; read them first.")
    ] = False,
    workers: Annotated[int | None, typer.Option(min=1, help="Number of processes on this machine.")] = None,
    memory: Annotated[str | None, typer.Option(help="For each worker, e.g. 4GiB; default: an equal share.")] = None,
    scheduler: Annotated[str | None, typer.Option(help="A Dask cluster, e.g. tcp://node1:8786.")] = None,
    json: terminal.JsonOption = False,
) -> None:
    """Run a study: every combination of its records, cards, effects, noise models, splits and seeds.

    Each unit gets a folder with its results and provenance.
    Doing it again does what is missing, failed, or whose inputs have changed.
    A unit that fails leaves error.txt, and the study goes on. A study file:

    records = ["flights/*.csv"]

    cards = ["attas"]

    seeds = [0, 1]

    options.gp = false

    With --workers the units are shared out among processes; with --scheduler among the workers of a Dask cluster.

    Example: bayes-aero run study.toml --out results --workers 4
    """
    if workers and scheduler:
        raise InputError("--workers and --scheduler exclude each other; give one of them")
    if memory and not workers:
        raise InputError("--memory is for the processes of --workers; give how many")
    if dry_run and (workers or scheduler):
        raise InputError("--dry-run is done in this process; leave --workers and --scheduler out")
    from bayes_aero.study.study import read_study

    asked = read_study(study, trust_effects=trust_effects)  # a mistake is told before the libraries are loaded
    with terminal.loading():
        from bayes_aero.study.run import leftovers, plan

    folder = out or Path(f"{study.stem}_results")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file; give another folder with --out")
    planned = plan(asked, folder)
    console = terminal.teller(quiet=json)
    rest = leftovers(asked, folder)
    if rest:
        console.print(f"! not of this study, left as they are: {', '.join(rest)}", soft_wrap=True)
    told: Mapping[str, Mapping[str, Any]] = {}
    code = 0
    if dry_run:
        print_plan(console, planned)
    else:
        told, verdict, unwritten = run_planned(asked, folder, planned, (workers, memory, scheduler))
        code = print_outcome(console, folder, planned, told, verdict, unwritten)
    if json:
        terminal.print_json(study_results(asked, folder, [_row(p) | dict(told.get(p.unit.name, {})) for p in planned]))
    raise typer.Exit(code)


def study_results(asked: Study, folder: Path, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The study and its units as plain data."""
    about = {"file": asked.path.name, "title": asked.title, "task": asked.task, "sha256": asked.sha256}
    counts = dict(Counter(row["state"] for row in rows))
    return {"schema": SCHEMA, "study": about, "out": str(folder), "counts": counts, "units": rows}


def run_planned(
    asked: Study, folder: Path, planned: list[Planned], cluster: tuple[int | None, str | None, str | None]
) -> tuple[Mapping[str, Mapping[str, Any]], str, tuple[str, ...]]:
    """What every unit that was due said, the study's verdict, and what could not be written."""
    from bayes_aero.study.run import UNITS, StoppedError, plan, run_study
    from bayes_aero.study.summary import put_report

    def resume() -> str:
        done = sum(p.state.word == "done" for p in plan(asked, folder))
        return f"{done} of {len(planned)} units are done and kept in {folder}; the same command does the rest"

    due = any(p.state.word != "done" for p in planned)
    try:
        with (
            terminal.interruptible(resume),
            terminal.bar("reading", over=3600.0) as show,
            unit_runner(*cluster if due else (None, None, None), folder / UNITS, show) as runner,
        ):
            told = run_study(
                asked,
                folder,
                planned,
                report=lambda n, of, unit, stage: show(f"{n + 1}/{of} {unit.name}: {stage}", n / max(of, 1)),
                runner=runner,
            )
            show("report", 1.0)
            return told, *put_report(asked, folder)
    except StoppedError as reason:
        print(f"error: {reason}; {resume()}", file=sys.stderr)
        raise typer.Exit(terminal.FAILED) from None


def print_outcome(
    console: Console,
    folder: Path,
    planned: list[Planned],
    told: Mapping[str, Mapping[str, Any]],
    verdict: str,
    unwritten: tuple[str, ...],
) -> int:
    """Doubts, failures, how many units were done now, the verdict, where the results are; returns the exit code."""
    from bayes_aero.study.run import UNITS
    from bayes_aero.study.summary import doubts_of

    doubts = [(p.unit.name, said) for p in planned for said in doubts_of(p.unit, folder / UNITS)]
    for name, sentence in doubts:
        console.print(f"! {name}: {sentence}", soft_wrap=True)
    failed = [row for row in (_row(p) | dict(told.get(p.unit.name, {})) for p in planned) if row["state"] != "done"]
    for row in failed:
        console.print(f"✗ {row['name']}: {row['error']}", style="red", soft_wrap=True)
    terminal.print_failures(console, unwritten)
    now, every = len(told), len(planned)
    console.print(f"{every} units: {now - len(failed)} done now, {every - now} were done, {len(failed)} failed.")
    console.print(verdict, soft_wrap=True)
    console.print(f"Results are in {folder}: report.html, units/, units.csv, summary.csv, environment/", soft_wrap=True)
    return terminal.FAILED if failed or unwritten else terminal.DOUBT if doubts else 0


def _row(p: Planned) -> dict[str, Any]:
    return {"name": p.unit.name, "state": p.state.word, "why": p.state.why, "seconds": None, "error": p.state.why}


def print_plan(console: Console, planned: list[Planned]) -> None:
    """The units with their state."""
    from bayes_aero.report.table import Table, columns_of

    of = columns_of(planned)
    unit, state = of(lambda p: p.unit.name, terminal="unit", words=True), of(lambda p: p.state.word, terminal="state")
    console.print(Table([unit, state, of(lambda p: p.state.why, terminal="why", words=True)]).terminal())
    counts = Counter(p.state.word for p in planned)
    console.print(f"{len(planned)} units: {', '.join(f'{n} {word}' for word, n in counts.items())}")


@contextmanager
def unit_runner(
    workers: int | None, memory: str | None, scheduler: str | None, units: Path, show: Progress
) -> Iterator[UnitRunner | None]:
    """What does the units: a Dask cluster where one is asked for."""
    if not workers and not scheduler:
        yield None
        return
    try:
        from bayes_aero.study import cluster
    except ModuleNotFoundError as reason:
        raise InputError(
            f'--workers and --scheduler need {reason.name}; install it with: pip install "bayes-aero[cluster]"'
        ) from None
    speak = time.monotonic() + SILENCE

    def tell(done: int, of: int, what: str) -> None:
        nonlocal speak
        if what.startswith("waiting") and time.monotonic() > speak:
            speak = float("inf")  # once; a terminal shows it all the time
            print(f"{what}; Ctrl-C stops", file=sys.stderr)
        show(f"{done}/{of} done, {what}", done / max(of, 1))

    if workers:
        show(f"starting {workers} workers", 0.0)
        runners = cluster.local(workers, cluster.memory_of(memory, workers), units, tell)
    else:
        runners = cluster.remote(str(scheduler), units, tell)
    with runners as runner:
        yield runner
