"""The command line: parse, call, print. No science here."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from bayes_aero import __version__
from bayes_aero.errors import InputError
from bayes_aero.model.noise import Colour

if TYPE_CHECKING:  # the real imports wait until a command needs them
    from bayes_aero.criticism.finding import Diagnosis
    from bayes_aero.criticism.trajectory import Trajectories

BAD_INPUT = 2
INTERRUPTED = 130

app = typer.Typer(
    name="bayes-aero",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    help="Bayesian identification of non-linear aircraft aerodynamics from flight data.",
)


class SplitChoice(StrEnum):
    """How data are held back to test the Gaussian process."""

    RANDOM = "random"
    BLOCK = "block"
    MANOEUVRE = "manoeuvre"


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"bayes-aero {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")] = False,
) -> None:
    """Bayesian identification of non-linear aircraft aerodynamics from flight data."""


@app.command()
def identify(
    records: Annotated[
        list[Path] | None,
        typer.Argument(help="Flight records (.asc .csv .mat .parquet .nc); none: two simulated manoeuvres."),
    ] = None,
    model: Annotated[str, typer.Option(help="Card: a .toml file, or a shipped one by name.")] = "attas",
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("results"),
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same command, same machine: same numbers.")] = 0,
    noise: Annotated[Colour, typer.Option(help="Noise model of the posterior.")] = Colour.AR1,
    split: Annotated[
        SplitChoice, typer.Option(help="Split whose Gaussian-process hyperparameters are sampled.")
    ] = SplitChoice.RANDOM,
    resample: Annotated[
        float | None, typer.Option(help="Resample unevenly sampled records to this time step in s.")
    ] = None,
    gp: Annotated[bool, typer.Option(help="Train the Gaussian processes.")] = True,
    figures: Annotated[bool, typer.Option(help="Draw the figures.")] = True,
) -> None:
    """Identify a stall model: maximum likelihood, posterior and Gaussian process side by side.

    Example: bayes-aero identify qst01.asc qst02.asc --model attas --out results
    """
    # Imported here: --help and a mistyped option need not wait for the numerical libraries.
    from bayes_aero.flight.card import read_card
    from bayes_aero.report.tables import terminal_table
    from bayes_aero.report.words import verdict
    from bayes_aero.studies.demo import demo_records
    from bayes_aero.studies.identify import identify as run
    from bayes_aero.studies.identify import read_records

    card = read_card(model)
    console = Console()
    if records:
        flights = read_records(records, card, resample=resample)
    else:
        console.print("No record given: two simulated stall manoeuvres are identified.")
        flights = demo_records()
    with _progress() as bar:
        task = bar.add_task("reading", total=1.0)
        found = run(
            flights,
            card,
            noise=noise,
            split=split.value,
            seed=seed,
            out=out,
            gp=gp,
            figures=figures,
            progress=lambda text, share: bar.update(task, description=text, completed=share),
        )
    console.print(terminal_table(found))
    for sentence in verdict(found):
        console.print(f"• {sentence}", highlight=False)
    for note in found.notes:
        console.print(f"! {note}", highlight=False)
    console.print(f"Results are in {out}", highlight=False, soft_wrap=True)


@app.command()
def diagnose(
    records: Annotated[
        list[Path] | None,
        typer.Argument(help="Flight records (.asc .csv .mat .parquet .nc); none: an effect is hidden and sought."),
    ] = None,
    model: Annotated[str, typer.Option(help="Card: a .toml file, or a shipped one by name.")] = "attas",
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("diagnosis"),
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same command, same machine: same numbers.")] = 0,
    max_effects: Annotated[int, typer.Option(min=1, help="Effects that each stage may add to the model.")] = 8,
    resample: Annotated[
        float | None, typer.Option(help="Resample unevenly sampled records to this time step in s.")
    ] = None,
    predictors: Annotated[
        bool, typer.Option(help="Compare predictors on unseen data; fly manoeuvres that would separate rival causes.")
    ] = True,
    trajectories: Annotated[
        bool, typer.Option(help="Fly the model through the recorded inputs, before and after the extension.")
    ] = True,
    figures: Annotated[bool, typer.Option(help="Draw the figures.")] = True,
) -> None:
    """Find what a model gets wrong: which cause, how large, what else it could be, what it gains on unseen data.

    Example: bayes-aero diagnose qst01.asc qst02.asc --model attas --out diagnosis
    """
    from bayes_aero.flight.card import read_card
    from bayes_aero.report.words_diagnosis import cause_table, ranking_table, revealed, sentences
    from bayes_aero.report.words_trajectory import trajectory_table
    from bayes_aero.studies.diagnose import hide_one, run
    from bayes_aero.studies.diagnose_flown import lacking, run_flown
    from bayes_aero.studies.identify import read_records
    from bayes_aero.studies.outlook import predictors as compared
    from bayes_aero.studies.outlook import simulations

    card = read_card(model)
    console = Console()
    flights, hidden = (read_records(records, card, resample=resample), None) if records else ([], None)
    with _progress() as bar:
        task = bar.add_task("reading" if records else "simulating", total=1.0)

        def tell(text: str, share: float) -> None:
            bar.update(task, description=text, completed=share)

        if not records:
            console.print("No record given: an effect is hidden in two simulated manoeuvres, to be found.")
            hidden, flights = hide_one(card, seed)
        if lacking(flights, card):
            flown = run_flown(flights, card, out=out, seed=seed, most=max_effects, fly=trajectories, progress=tell)
            bar.stop()
            _tell_flown(console, *flown, out)
            return
        found = run(
            flights,
            card,
            out=out,
            seed=seed,
            most=max_effects,
            hidden=hidden,
            predict=(lambda found, _: compared(found, card)) if predictors else None,
            fly=(lambda found, flown: simulations(found, card, flown, seed, tell)) if trajectories else None,
            figures=figures,
            progress=tell,
        )
    verdict, *rest = sentences(found.view)
    console.print(verdict, highlight=False, style="bold")
    table = cause_table(found.view) or ranking_table(found.view)
    if table is not None:
        console.print(table)
    if found.view.trajectories is not None:
        console.print(trajectory_table(found.view.trajectories))
    for sentence in rest:
        console.print(f"• {sentence}", highlight=False)
    for note in found.notes:
        console.print(f"! {note}", highlight=False)
    if hidden is not None:
        for sentence in revealed(hidden, found.named):
            console.print(sentence, highlight=False, style="bold")
    console.print(f"Results are in {out}", highlight=False, soft_wrap=True)


def _tell_flown(console: Console, found: Diagnosis, flown: Trajectories | None, said: Sequence[str], out: Path) -> None:
    """What trajectories alone have shown."""
    from bayes_aero.report.words_diagnosis import flown_table
    from bayes_aero.report.words_trajectory import trajectory_table

    verdict, *rest = said
    console.print(verdict, highlight=False, style="bold")
    for table in (flown_table(found), None if flown is None else trajectory_table(flown)):
        if table is not None:
            console.print(table)
    for sentence in rest:
        console.print(f"• {sentence}", highlight=False)
    console.print(f"Results are in {out}", highlight=False, soft_wrap=True)


def _progress() -> Progress:
    """A bar on the terminal, silence elsewhere."""
    console = Console(stderr=True)
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


def main() -> None:
    """Entry point: bad input is one sentence and exit status 2, Ctrl-C is 130."""
    try:
        app()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(BAD_INPUT)
    except KeyboardInterrupt:
        print("interrupted; the stages that had finished are in the output folder", file=sys.stderr)
        sys.exit(INTERRUPTED)
