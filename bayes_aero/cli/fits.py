"""bayes-aero identify, diagnose, fly and path: the commands that fit records."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayes_aero.cli import terminal
from bayes_aero.jobs.options import DiagnoseOptions, FlyOptions, IdentifyOptions, PathOptions, ReadingOptions

if TYPE_CHECKING:
    from rich.console import Console

    from bayes_aero.jobs.io.fly_json import Flight

MOST = 5  # candidates of each stage on a terminal, where there is no cause


@terminal.with_options
def identify(
    reading: ReadingOptions,
    options: IdentifyOptions,
    records: Annotated[
        list[Path] | None, typer.Argument(help=f"{terminal.RECORDS}; none: two simulated manoeuvres.")
    ] = None,
    out: terminal.OutOption = Path("results"),
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
        from bayes_aero.report.pages.estimates import verdict
        from bayes_aero.report.pages.identification import next_flight_table, parameter_table
        from bayes_aero.simulate.demo import TRUTH, demo_records

    console, truth = terminal.teller(quiet=json, highlight=True), None
    if not records:
        console.print("No record given: two simulated stall manoeuvres are identified.")
        same = card.sha256 == read_card("attas").sha256  # with another card's constants the parameters are others
        flights, truth = demo_records(), TRUTH if same else None
    with terminal.working(out) as tell:
        found = job.identify(flights, card, options, out=out, truth=truth, progress=tell)

    def show() -> None:
        console.print(parameter_table(found).terminal())
        if found.next_flight is not None:
            console.print(next_flight_table(found).terminal())
        terminal.print_lines(console, verdict(found), found.notes)
        console.print(f"Results are in {out}", highlight=False, soft_wrap=True)

    terminal.conclude(console, found, show, json=out / "results.json" if json else None)


@terminal.with_options
def diagnose(
    reading: ReadingOptions,
    options: DiagnoseOptions,
    records: Annotated[
        list[Path] | None,
        typer.Argument(
            help=f"{terminal.RECORDS}; none: an effect is hidden in two simulated manoeuvres, then searched for."
        ),
    ] = None,
    out: terminal.OutOption = Path("diagnosis"),
    write_effect: Annotated[
        Path | None,
        typer.Option(
            help="Effect file (.py) for the terms by which unexplained structure is described.", metavar="FILE"
        ),
    ] = None,
    json: terminal.JsonOption = False,
) -> None:
    """Find the effects that a model lacks: size, uncertainty, rivals, and the gain on hold-out data.

    Example: bayes-aero diagnose qst01.asc qst02.asc --model attas --out diagnosis
    """
    (card, flights), hidden = terminal.card_and_records(records or [], reading), None
    with terminal.loading():
        from bayes_aero.jobs.diagnose import diagnose_records, hide_one
        from bayes_aero.jobs.io.effect_file import refuse_existing, write_effects
        from bayes_aero.report.pages.diagnosis import causes_table, screen_table
        from bayes_aero.report.pages.findings import in_band_sentences, revealed, sentences
        from bayes_aero.report.pages.qualification import points_sentences
        from bayes_aero.report.pages.trajectories import hold_out_error_table

    if write_effect is not None:
        refuse_existing(write_effect)
    console = terminal.teller(quiet=json, highlight=True)
    with terminal.working(out, "reading" if records else "simulating") as tell:
        if not records:
            console.print("No record given: an effect is hidden in two simulated manoeuvres, then searched for.")
            hidden, flights = hide_one(card, options.seed)
        found = diagnose_records(flights, card, options, out=out, hidden=hidden, progress=tell)
    d, rankings = found.diagnosis, found.view.rankings
    names = [record.name for record in flights]
    written = [] if write_effect is None else [write_effects(d.terms, names, write_effect)]

    def show() -> None:
        verdict, *rest = sentences(found.view)
        console.print(verdict, highlight=False, style="bold")
        if d.causes or rankings:
            first = [replace(ranking, candidate_scores=ranking.candidate_scores[:MOST]) for ranking in rankings]
            console.print((causes_table(d) if d.causes else screen_table(first, d)).terminal())
        if found.view.trajectories is not None:
            console.print(hold_out_error_table(found.view.trajectories).terminal())
        more = (*in_band_sentences(found.in_band), *points_sentences(found.test_points))
        terminal.print_lines(console, (*rest, *more), found.notes)
        for sentence in revealed(found.hidden, found.named) if found.hidden is not None else ():
            console.print(sentence, highlight=False, style="bold")
        for line in (*written, f"Results are in {out}"):
            console.print(line, highlight=False, soft_wrap=True)

    # Trajectories alone are fitted to the record as it is.
    terminal.conclude(console, found, show, json=out / "diagnosis.json" if json else None, corrects=d.by_coefficients)


@terminal.with_options
def fly(
    records: Annotated[list[Path], typer.Argument(help=f"{terminal.RECORDS}.")],
    reading: ReadingOptions,
    options: FlyOptions,
    out: terminal.OutOption = Path("trajectories"),
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
        from bayes_aero.jobs.io.fly_json import RESULTS

    console = terminal.teller(quiet=json, highlight=True)
    with terminal.working(out) as tell:
        found = job(flights, card, options, out=out, progress=tell)
    file, failed = out / RESULTS if json else None, not found.flown.converged
    terminal.conclude(console, found, lambda: print_fit(console, found, out), json=file, failed=failed)


@terminal.with_options
def path(
    records: Annotated[list[Path], typer.Argument(help=f"{terminal.RECORDS}.")],
    reading: ReadingOptions,
    options: PathOptions,
    out: terminal.OutOption = Path("path"),
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
        from bayes_aero.jobs.io.fly_json import RESULTS

    console = terminal.teller(quiet=json, highlight=True)
    with terminal.working(out) as tell:
        found = flight_path(flights, card, options, out=out, progress=tell)
    terminal.conclude(
        console,
        found,
        lambda: print_fit(console, found, out),
        json=out / RESULTS if json else None,
        compared=False,
        failed=not found.flown.converged,
        doubtful=bool(found.flown.worse),
    )


def print_fit(console: Console, found: Flight, out: Path) -> None:
    """Tables, findings and notes of a fit to trajectories."""
    from bayes_aero.report.pages import fly as of_fit
    from bayes_aero.report.pages import trajectories

    flown, beside = found.flown, found.process_noise
    tables = [of_fit.parameter_table(flown), *([of_fit.beside_table(flown)] if flown.frequency else [])]
    if beside is not None and beside.converged:
        tables.append(trajectories.process_noise_table(beside, flown, found.posteriors))
        tables += [] if beside.one_step is None else [trajectories.one_step_table(beside.one_step, flown.units)]
    tables += [trajectories.posterior_table(found.posteriors)] if found.posteriors else []
    tables.append(of_fit.error_table(flown))
    tables += [of_fit.mode_table(found.motion)] if found.motion is not None and found.motion.modes else []
    for table in tables:
        console.print(table.terminal())
    terminal.print_lines(console, found.sentences, found.notes)
    console.print(f"Results are in {out}", highlight=False, soft_wrap=True)
