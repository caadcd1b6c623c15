"""bayes-aero check, card, effects and simulate: what comes before a fit."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from bayes_aero.atomic_write import write_whole
from bayes_aero.cli import terminal
from bayes_aero.errors import InputError
from bayes_aero.jobs.options import ReadingOptions
from bayes_aero.processes import cache_folder
from bayes_aero.simulate import Manoeuvre, SimulatedNoise


@terminal.with_options
def check(
    records: terminal.RecordsArgument,
    reading: ReadingOptions,
    sensors: Annotated[bool, typer.Option(help="Check the sensors against each other along the flight path.")] = True,
    seed: terminal.SeedOption = 0,
    out: Annotated[Path | None, typer.Option(help="Folder for report.html and check.json.")] = None,
    verbose: terminal.VerboseOption = False,
    json: terminal.JsonOption = False,
) -> None:
    """Check records against a card: channels, units, gaps, what they can test, agreement of the sensors.

    Nothing aerodynamic is fitted. Exit code 0: usable; 1: not, with the reasons; 3: usable, but in doubt.

    Example: bayes-aero check qst01.asc qst02.asc --model attas
    """
    with terminal.loading():
        from bayes_aero.flight.card import read_card
        from bayes_aero.jobs.check import check_records, check_results, page_of_check, write_check
        from bayes_aero.report.pages.check import check_screen

    card, how = read_card(reading.model), {"resample": reading.resample, "split": reading.split}
    with (
        terminal.interruptible(lambda: "nothing was written; give the same command again"),
        terminal.bar("reading") as tell,
    ):
        report = check_records(records, card, sensors=sensors, seed=seed, progress=tell, **how)
        failures = report.failures + (() if out is None else write_check(report, out, seed))
    if json:
        terminal.print_json(check_results(report))
    console = terminal.teller(quiet=json)
    terminal.print_screen(check_screen(report, failures), quiet=json)
    if out is not None:
        console.print(f"The report is in {out / 'report.html'}", soft_wrap=True)
    if verbose:
        from bayes_aero.report.page import as_text

        console.print(f"{terminal.ALL}{as_text(page_of_check(report, seed))}", end="", soft_wrap=True)
    if failures or not report.usable:
        raise typer.Exit(terminal.FAILED)
    terminal.exit_in_doubt(report.consistency, report.health, corrects=False)


def card(
    record: Annotated[Path, typer.Argument(help=f"A flight record whose columns have names ({terminal.SUFFIXES}).")],
    out: Annotated[Path | None, typer.Option(help="File to write; default: the record's name with .toml.")] = None,
    page: Annotated[bool, typer.Option("--page/--no-page", help="Write CARD.report.html, too.")] = True,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a card that is there.")] = False,
    json: terminal.JsonOption = False,
) -> None:
    """Write a commented starter card for a new aircraft from a record's columns.

    Names, units and signs are guessed, each with its evidence.
    What only you know is marked TODO; using the card before names the first.

    Example: bayes-aero card flight7.csv --out mine.toml
    """
    from bayes_aero.flight.record import segment_of

    record = segment_of(record).file
    target = out or Path(f"{record.stem}.toml")
    if target.exists() and not force:
        raise InputError(f"{target} exists; give --force to overwrite it, or another name with --out")
    with terminal.loading():
        from bayes_aero.jobs.preparing import put_starter_page, starter_card

    starter = starter_card(record)
    try:
        write_whole(starter.text, target)
    except OSError as reason:
        raise InputError(f"{target} cannot be written ({reason.strerror}); give another name with --out") from None
    report, failures = put_starter_page(starter, record, target) if page else (None, ())
    if json:
        terminal.print_json(starter.facts | {"card": str(target), "report": None if report is None else str(report)})
    console = terminal.teller(quiet=json)
    console.print(f"The card is in {target}. Read its proposals.", soft_wrap=True)
    if starter.todo:
        console.print(f"To be filled in ({len(starter.todo)}): {', '.join(name for name, _ in starter.todo)}.")
    if starter.blind:
        which = "it" if len(starter.blind) == 1 else "them"
        console.print(f"Not found: {', '.join(starter.blind)}. identify needs {which}; diagnose works without {which}.")
    if report is not None:
        console.print(f"The report is in {report}", soft_wrap=True)
    console.print(f"Then: bayes-aero check {record} --model {target}", soft_wrap=True)
    terminal.print_failures(console, failures)
    if failures:
        raise typer.Exit(terminal.FAILED)


def effects(
    name: Annotated[
        str | None,
        typer.Argument(
            help="One effect to explain; none: all as a table.",
            # The names are loaded only where one is completed.
            autocompletion=lambda incomplete: [
                n for n in import_module("bayes_aero.effects").CATALOGUE if n.startswith(incomplete)
            ],
        ),
    ] = None,
    model: Annotated[str | None, typer.Option(help="A card, for its effect files and model.", metavar="CARD")] = None,
    json: terminal.JsonOption = False,
) -> None:
    """List the catalogue of effects, or explain one: claim, formula, parameters, priors, worked example, source.

    Example: bayes-aero effects pitch_rate_bias
    """
    from bayes_aero.flight.card import read_card
    from bayes_aero.jobs.preparing import effect_facts, known_effects
    from bayes_aero.model.model import effect_named

    card = None if model is None else read_card(model)
    catalogue = known_effects(card)
    chosen = catalogue.values() if name is None else [effect_named(name, catalogue)]
    facts = [effect_facts(effect, card) for effect in chosen]
    if json:
        terminal.print_json({"schema": "bayes_aero/effects/1", "effects": facts})
        return
    from bayes_aero.report.page import print_blocks
    from bayes_aero.report.pages.check import effect_blocks, effects_table

    print_blocks(terminal.teller(), [effects_table(facts)] if name is None else effect_blocks(facts[0]))


def warm(timings: terminal.TimingsOption = False) -> None:
    """Compile the programs of identify, diagnose and fly for the simulated stalls, and keep them for later commands.

    Records of the card attas of about this length then compile little; other cards compile theirs the first time.

    Example: bayes-aero warm
    """
    with terminal.loading():
        from bayes_aero.flight.card import read_card
        from bayes_aero.jobs import diagnose, fly, identify
        from bayes_aero.jobs.options import IdentifyOptions
        from bayes_aero.simulate.demo import demo_records

    card, records = read_card("attas"), demo_records()
    with TemporaryDirectory() as folder, terminal.working(Path(folder), timings, "simulating") as tell:
        identify.identify(records, card, IdentifyOptions(gp=False), out=Path(folder) / "1", progress=tell)
        diagnose.diagnose_records(records, card, out=Path(folder) / "2", progress=tell)
        fly.fly(records, card, out=Path(folder) / "3", progress=tell)
    terminal.teller().print(f"Compiled programs are kept in {cache_folder()}.", soft_wrap=True)


def simulate(
    out: Annotated[Path, typer.Option(help="File to write: .csv .parquet .nc .mat or .asc.")],
    effect: Annotated[list[str] | None, typer.Option(help="NAME=VALUE, or NAME.PARAMETER=VALUE; SI or a unit.")] = None,
    manoeuvre: Annotated[Manoeuvre, typer.Option(help="The manoeuvre.")] = "random_stall",
    noise: Annotated[
        SimulatedNoise,
        typer.Option(help="white: sensors; ar1: also coloured disturbances; buffet: these grow with separation."),
    ] = "ar1",
    noise_scale: Annotated[float, typer.Option(min=0.0, help="Factor on all noise.")] = 1.0,
    seed: terminal.SeedOption = 0,
    duration: Annotated[float | None, typer.Option(help="Seconds; default 90 (random_stall) or 60.")] = None,
    dt: Annotated[float, typer.Option(help="Sampling interval in s.")] = 0.04,
    airspeed: Annotated[float | None, typer.Option(help="At the start, m/s; default: level flight at 6 deg.")] = None,
    altitude: Annotated[float, typer.Option(help="At the start, m.")] = 5200.0,
    amplitude: Annotated[float, typer.Option(help="Factor on the inputs of a standard manoeuvre.")] = 1.0,
    model: Annotated[str, typer.Option(help="Card: a .toml file, or a shipped one by name.", metavar="CARD")] = "attas",
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file that is there.")] = False,
    json: terminal.JsonOption = False,
) -> None:
    """Write a synthetic record and its true parameters (FILE.truth.json).

    Geometry, sensors with the errors that it fixes, and channels are the card's, the aerodynamics those of the demo
    aircraft and --effect.

    Example: bayes-aero simulate --effect "pitch_rate_bias=0.3 deg/s" --effect thrust_lag=1 --seed 4 --out flight.csv
    """
    if out.exists() and not force:
        raise InputError(f"{out} exists; give --force to overwrite it, or another name with --out")
    with terminal.loading():
        from bayes_aero.flight.card import read_card
        from bayes_aero.jobs.preparing import known_effects, parsed_effects, simulate_file
        from bayes_aero.simulate.demo import Request

    card = read_card(model)
    catalogue = known_effects(card)
    settings = (manoeuvre, noise, noise_scale, seed, duration, dt, airspeed, altitude, amplitude)
    request = Request(parsed_effects(effect or [], catalogue), *settings)
    with terminal.interruptible(lambda: "nothing was written; give the same command again"), terminal.bar("simulating"):
        simulated, truth = simulate_file(request, card, catalogue, out)
    if json:
        terminal.print_json(truth)
    console, record = terminal.teller(quiet=json), simulated.record
    console.print(
        f"{manoeuvre}: {record.n} samples, {record.time[-1]:g} s, {len(record.channels)} channels → {out}",
        soft_wrap=True,
    )
    for name, values in request.effects.items():
        console.print(f"hidden effect: {name}, {', '.join(f'{p} = {x:g}' for p, x in values.items())} (SI)")
    for note in simulated.notes:
        console.print(f"! {note}")
    console.print(f"The truth is in {out}.truth.json", soft_wrap=True)
