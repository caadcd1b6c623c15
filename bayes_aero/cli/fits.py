"""bayes-aero identify, diagnose, fly and path, what is done with their results, and run, which does many of them."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from bayes_aero.cli import terminal
from bayes_aero.errors import InputError
from bayes_aero.jobs import options as asked
from bayes_aero.progress import Progress

if TYPE_CHECKING:
    from bayes_aero.flight.card import Card
    from bayes_aero.flight.record import FlightRecord
    from bayes_aero.jobs.results import Flight, Outcome
    from bayes_aero.study.run import Planned, Study, Unit, UnitRunner

CHANGES = 8  # lines for what trajectories change of the first answer of diagnose


@terminal.with_options
def identify(
    reading: asked.ReadingOptions,
    options: asked.IdentifyOptions,
    records: Annotated[list[Path] | None, typer.Argument(help=f"{terminal.RECORDS}; none: two simulated.")] = None,
    out: terminal.OutOption = Path("results"),
    verbose: terminal.VerboseOption = False,
    timings: terminal.TimingsOption = False,
    json: terminal.JsonOption = False,
) -> None:
    """Identify the parameters of a card's model: maximum likelihood, posteriors and Gaussian processes.

    Example: bayes-aero identify qst01.asc qst02.asc --model attas --out results
    """
    card, flights = terminal.card_and_records(records or [], reading)
    # Imported here: --help, a mistyped option and a file that is not there need not wait for the numerical libraries.
    with terminal.loading():
        from bayes_aero.flight.card import read_card
        from bayes_aero.jobs import identify as job
        from bayes_aero.report.pages.identification import identification_screen
        from bayes_aero.simulate.demo import TRUTH, demo_records

    truth = None
    if not records:
        terminal.teller(quiet=json).print("No record given: two simulated stall manoeuvres are identified.")
        same = card.sha256 == read_card("attas").sha256  # with another card's constants the parameters are others
        flights, truth = demo_records(), TRUTH if same else None
    with terminal.working(out, timings) as tell:
        identification = job.identify(flights, card, options, out=out, truth=truth, progress=tell)

    screen = identification_screen(identification, card, flights)
    terminal.conclude(screen, identification, out / "results.json", verbose=verbose, json=json)


@terminal.with_options
def diagnose(
    reading: asked.ReadingOptions,
    options: asked.DiagnoseOptions,
    records: Annotated[
        list[Path] | None, typer.Argument(help=f"{terminal.RECORDS}; none: two simulated, with a hidden effect.")
    ] = None,
    out: terminal.OutOption = Path("diagnosis"),
    write_effect: Annotated[
        Path | None, typer.Option(help="Effect file (.py) to write, of the terms found.", metavar="FILE")
    ] = None,
    verbose: terminal.VerboseOption = False,
    timings: terminal.TimingsOption = False,
    json: terminal.JsonOption = False,
) -> None:
    """Find the effects that a model lacks: size, uncertainty, rivals, and the gain on hold-out data.

    Example: bayes-aero diagnose qst01.asc qst02.asc --model attas --out diagnosis
    """
    (card, flights), hidden = terminal.card_and_records(records or [], reading), None
    with terminal.loading():
        from bayes_aero.jobs.check import RecordChecks
        from bayes_aero.jobs.diagnose import diagnose_records, hide_one
        from bayes_aero.jobs.preparing import refuse_existing, write_effects
        from bayes_aero.report.pages.diagnosis import diagnosis_screen
        from bayes_aero.report.pages.parts import record_block
        from bayes_aero.report.screen import LINES, Screen

    if write_effect is not None:
        refuse_existing(write_effect)
    with terminal.working(out, timings, "reading" if records else "simulating") as tell:
        if not records:
            terminal.teller(quiet=json).print(
                "No record given: an effect is hidden in two simulated manoeuvres, then searched for."
            )
            hidden, flights = hide_one(card, options.seed)
        shown, taken = [Screen([], [], [], [], whole=False)], 0

        def answer(known: RecordChecks | Outcome) -> None:
            nonlocal taken
            if isinstance(known, RecordChecks):
                record, _ = record_block(flights, known.health, known.consistency, corrects=True)
                shown.append(replace(shown[0], record=record))
                taken = terminal.print_screen(shown[-1], quiet=json)
                return
            shown.append(diagnosis_screen(known, card, flights))
            new = replace(shown[-1], record=[]) if shown[-1].record == shown[-2].record else shown[-1]
            terminal.print_screen(new, max(LINES - CHANGES - taken, 1), quiet=json)

        outcome = diagnose_records(flights, card, options, out=out, hidden=hidden, progress=tell, answer=answer)
    terms, names = outcome.diagnosis.terms, [record.name for record in flights]
    written = [] if write_effect is None else [write_effects(terms, names, write_effect)]
    changed = diagnosis_screen(outcome, card, flights).changes(shown[-1])
    if changed.result or changed.doubts or changed.next:
        terminal.print_screen(changed, CHANGES, quiet=json)
    # Trajectories alone are fitted to the record as it is.
    corrects = outcome.diagnosis.by_coefficients
    terminal.conclude(None, outcome, out / "diagnosis.json", written, verbose=verbose, json=json, corrects=corrects)


@terminal.with_options
def fly(
    records: terminal.RecordsArgument,
    reading: asked.ReadingOptions,
    options: asked.FlyOptions,
    out: terminal.OutOption = Path("trajectories"),
    verbose: terminal.VerboseOption = False,
    timings: terminal.TimingsOption = False,
    json: terminal.JsonOption = False,
) -> None:
    """Fit a card's model and the initial states to trajectories (output error), with the recorded inputs.

    For cards with a model of effects and for linear ones. Exit code 0: converged; 1: not, or the model cannot fly.

    Published output-error programs fit with --no-priors, most of them with --initial-state fixed.

    Example: bayes-aero fly run1.csv run2.csv --model short_period.toml --out trajectories
    """
    card, flights = terminal.card_and_records(records, reading)
    with terminal.loading():
        from bayes_aero.jobs.fly import fly as job

    with terminal.working(out, timings) as tell:
        flight = job(flights, card, options, out=out, progress=tell)
    conclude_fit(flight, card, flights, out, verbose=verbose, json=json)


@terminal.with_options
def path(
    records: terminal.RecordsArgument,
    reading: asked.ReadingOptions,
    options: asked.PathOptions,
    out: terminal.OutOption = Path("path"),
    verbose: terminal.VerboseOption = False,
    timings: terminal.TimingsOption = False,
    json: terminal.JsonOption = False,
) -> None:
    """Reconstruct the flight path: errors of sensors from accelerations and rates, without aerodynamics.

    Recorded accelerations and rates are integrated. Their biases, scale and bias of flow angles and airspeed, the
    position and delay of the vane and the wind are fitted to airspeed, flow angles, attitude and altitude by output
    error. corrected/ has the records without these errors. Exit code 0: converged; 1: not; 3: a
    channel is faulty.

    With --process-noise gusts.csv has the gusts that vane and pitot tube met.

    Example: bayes-aero path run1.csv run2.csv --model aircraft.toml --out path
    """
    card, flights = terminal.card_and_records(records, reading)
    with terminal.loading():
        from bayes_aero.jobs.fly import flight_path

    with terminal.working(out, timings) as tell:
        flight = flight_path(flights, card, options, out=out, progress=tell)
    worse = bool(flight.flown.worse)
    conclude_fit(flight, card, flights, out, verbose=verbose, json=json, compared=False, doubtful=worse)


def conclude_fit(
    flight: Flight, card: Card, records: list[FlightRecord], out: Path, *,
    verbose: bool, json: bool, compared: bool = True, doubtful: bool = False,
) -> None:  # fmt: skip
    from bayes_aero.jobs.results import RESULTS
    from bayes_aero.report.pages.fly import fly_screen

    terminal.conclude(
        fly_screen(flight, card, records), flight, out / RESULTS, verbose=verbose, json=json,
        compared=compared, failed=not flight.flown.converged, doubtful=doubtful,
    )  # fmt: skip


# --- bayes-aero export, open and qualify: what is done with a finished result.


def export(
    result: Annotated[
        str, typer.Argument(help="Folder (or JSON) of a result, or a card with all values.", metavar="MODEL")
    ],
    to: Annotated[asked.ExportForm, typer.Option(help="jsbsim: an aircraft; fmu: FMI 2.0; tables: NetCDF and CSV.")],
    out: Annotated[Path | None, typer.Option(help="Folder to make; default: NAME_FORM, here.")] = None,
    model: terminal.ResultCardOption = None,
    draws: Annotated[int, typer.Option(min=0, help="Draws of the parameters to write, of their posterior.")] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the draws.")] = 0,
    json: terminal.JsonOption = False,
) -> None:
    """Write the identified aerodynamic model for another simulator.

    All effects of the aircraft are exported, sensor errors and gusts are not; the terminal and README.txt say which.

    Example: bayes-aero export results --to jsbsim
    """
    terminal.check_result(result)
    with terminal.loading():
        from bayes_aero.jobs.finished import export as run

        folder, facts = run(result, to, out=out, card=model, draws=draws, seed=seed)
    if json:
        terminal.print_json(facts | {"folder": str(folder)})
    sentences = [*facts["sources"], *facts["validity"], *facts["left_out"]]
    if facts["draws"] is not None:
        sentences.append(f"{facts['draws']['count']} draws: {facts['draws']['origin']}.")
    sentences.append(f"The model is in {folder}: {', '.join(facts['files'])}. README.txt says how to use it.")
    for sentence in sentences:
        terminal.teller(quiet=json).print(sentence, soft_wrap=True)


def open(
    result: terminal.ResultArgument,
    records: Annotated[list[Path] | None, typer.Option(help="Folder of records that have moved; repeatable.")] = None,
    model: terminal.ResultCardOption = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port on this machine; 0: any free one.")] = 0,
    browser: Annotated[bool, typer.Option(help="--no-browser: print the address only.")] = True,
) -> None:
    """Look at a finished result on a local page: sliders fly the manoeuvres again at once.

    The page is served to this machine alone (127.0.0.1) and asks nothing of a network. Ctrl-C ends it.

    Example: bayes-aero open results
    """
    terminal.check_result(result)
    with terminal.loading():
        from bayes_aero.explore.opened import Simulator, open_result
        from bayes_aero.explore.page import ExplorePage, PageServer

    with terminal.bar("reading") as tell:
        simulator = Simulator(open_result(result, model, records or ()))
        server = PageServer(partial(ExplorePage, simulator), port)
        tell("compiling", 0.5)
        simulator.result(0)
    for sentence in simulator.opened.doubts:
        terminal.teller().print(f"! {sentence}", soft_wrap=True)
    terminal.teller().print(f"{simulator.opened.title} is open at {server.url} - Ctrl-C ends it.", soft_wrap=True)
    server.serve(browser=browser)


@terminal.with_options
def qualify(
    result: terminal.ResultArgument,
    options: asked.QualifyOptions,
    records: Annotated[list[Path] | None, typer.Argument(help=f"Further tests: {terminal.RECORDS}.")] = None,
    out: terminal.OutOption = Path("qualification"),
    verbose: terminal.VerboseOption = False,
    timings: terminal.TimingsOption = False,
    json: terminal.JsonOption = False,
) -> None:
    """How probably the simulation passes each tolerance of the card: in the manoeuvres flown, and in the next flight.

    Parameters, errors of the model's structure and gusts are counted. Writes a page for an evaluator to sign. Exit code
    0, whatever the verdict; 3: the records are in doubt.

    Example: bayes-aero qualify trajectories --out qualification
    """
    from bayes_aero.flight.reading import present

    for path in (*(records or ()), *options.fitted):
        present(path)
    terminal.check_result(result)
    with terminal.loading():
        from bayes_aero.jobs.qualify import RESULTS, qualify_result
        from bayes_aero.report.pages.qualification import qualification_screen

    with terminal.working(out, timings) as tell:
        qualification, failures = qualify_result(result, tuple(records or ()), options, out=out, progress=tell)

    screen = qualification_screen(qualification, result, failures)
    to_do = ["qualification.html is to be signed or refused."]
    terminal.conclude(screen, qualification, out / RESULTS, to_do, verbose=verbose, json=json, failures=failures)


# --- bayes-aero run.

SILENCE = 15.0  # seconds without workers after which that is reported also where there is no terminal


def run(
    study: Annotated[Path, typer.Argument(help="A study (.toml).")],
    out: Annotated[Path | None, typer.Option(help="Folder for the results; default: STUDY_results, here.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="List the units and their state; do nothing.")] = False,
    trust_effects: Annotated[
        bool, typer.Option("--trust-effects", help="Run its effect files (Python); read them first.")
    ] = False,
    workers: Annotated[int | None, typer.Option(min=1, help="Number of processes on this machine.")] = None,
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
    if dry_run and (workers or scheduler):
        raise InputError("--dry-run is done in this process; leave --workers and --scheduler out")
    from bayes_aero.study.run import plan, read_study

    batch = read_study(study, trust_effects=trust_effects)  # a mistake is reported before the libraries are loaded
    folder = out or Path(f"{study.stem}_results")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file; give another folder with --out")
    planned = plan(batch, folder)
    console, states = terminal.teller(quiet=json), [(p.unit, p.state) for p in planned]
    rows = {u.name: {"name": u.name, **asdict(s), "seconds": None, "error": s.why} for u, s in states}
    code = 0
    if dry_run:
        print_plan(console, list(rows.values()))
    else:
        results, verdict, unwritten = run_planned(batch, folder, planned, (workers, scheduler))
        for name, result in results.items():
            rows[name] |= result
        code = print_outcome(console, folder, rows, len(results), (batch, verdict, unwritten))
    if json:
        counts = dict(Counter(row["state"] for row in rows.values()))
        about = {"file": batch.path.name, "title": batch.title, "task": batch.task, "sha256": batch.sha256}
        summary = {"study": about, "out": str(folder), "counts": counts, "units": list(rows.values())}
        terminal.print_json({"schema": "bayes_aero/study/1"} | summary)
    raise typer.Exit(code)


def print_plan(console: Console, rows: list[dict[str, Any]]) -> None:
    from bayes_aero.report.table import TextTable

    states = tuple((row["name"], row["state"], row["why"]) for row in rows)
    console.print(TextTable("", ("unit", "state", "why"), states, words=(1, 2)).terminal())
    counts = Counter(row["state"] for row in rows)
    console.print(f"{len(rows)} units: {', '.join(f'{n} {word}' for word, n in counts.items())}")


def run_planned(
    study: Study, folder: Path, planned: list[Planned], cluster: tuple[int | None, str | None]
) -> tuple[Mapping[str, Mapping[str, Any]], str, tuple[str, ...]]:
    """What every unit that was due said, the study's verdict, and what could not be written."""
    with terminal.loading():
        from bayes_aero.study.run import UNITS, StoppedError, plan, put_report, run_study

    def resume() -> str:
        done = sum(p.state.state == "done" for p in plan(study, folder))
        return f"{done} of {len(planned)} units are done and kept in {folder}; the same command does the rest"

    due = any(p.state.state != "done" for p in planned)
    try:
        with (
            terminal.interruptible(resume),
            terminal.bar("reading", over=3600.0) as show,
            unit_runner(*cluster if due else (None, None), folder / UNITS, show) as runner,
        ):

            def report(number: int, of: int, unit: Unit, stage: str) -> None:
                show(f"{number + 1}/{of} {unit.name}: {stage}", number / max(of, 1))

            results = run_study(study, folder, planned, report=report, runner=runner)
            show("report", 1.0)
            return results, *put_report(study, folder)
    except StoppedError as reason:
        print(f"error: {reason}; {resume()}", file=sys.stderr)
        raise typer.Exit(terminal.FAILED) from None


def print_outcome(
    console: Console,
    folder: Path,
    rows: Mapping[str, Mapping[str, Any]],
    now: int,
    outcome: tuple[Study, str, tuple[str, ...]],
) -> int:
    """Doubts, failures, how many units were done now, the verdict, where the results are; returns the exit code."""
    from bayes_aero.study.run import UNITS, doubts_of

    study, verdict, unwritten = outcome
    doubts = [f"! {unit.name}: {doubt}" for unit in study.units for doubt in doubts_of(unit, folder / UNITS)]
    for sentence in doubts:
        console.print(sentence, soft_wrap=True)
    failed = [row for row in rows.values() if row["state"] != "done"]
    terminal.print_failures(console, [*(f"{row['name']}: {row['error']}" for row in failed), *unwritten])
    before = len(rows) - now
    console.print(f"{len(rows)} units: {now - len(failed)} done now, {before} were done, {len(failed)} failed.")
    console.print(verdict, soft_wrap=True)
    console.print(f"Results are in {folder}: report.html, units/, units.csv, summary.csv, environment/", soft_wrap=True)
    return terminal.FAILED if failed or unwritten else terminal.DOUBT if doubts else 0


@contextmanager
def unit_runner(workers: int | None, scheduler: str | None, units: Path, show: Progress) -> Iterator[UnitRunner | None]:
    if not workers and not scheduler:
        yield None
        return
    try:
        from bayes_aero.study import cluster
    except ModuleNotFoundError as reason:
        raise InputError(f'--workers and --scheduler need {reason.name}: pip install "bayes-aero[cluster]"') from None
    speak = time.monotonic() + SILENCE

    def tell(done: int, of: int, what: str, waiting: bool) -> None:
        nonlocal speak
        if waiting and time.monotonic() > speak:
            speak = float("inf")  # once; a terminal shows it all the time
            print(f"{what}; Ctrl-C stops", file=sys.stderr)
        show(f"{done}/{of} done, {what}", done / max(of, 1))

    if workers:
        show(f"starting {workers} workers", 0.0)
        runners = cluster.local(workers, units, tell)
    else:
        runners = cluster.remote(str(scheduler), units, tell)
    with runners as runner:
        yield runner
