"""bayes-aero identify."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayes_aero.cli.terminal import (
    RECORDS,
    Coefficients,
    FrequencyOption,
    JsonOption,
    ModelOption,
    NoiseModel,
    ResampleOption,
    SeedOption,
    Split,
    SplitOption,
    bar,
    card_and_records,
    exit_if_failed,
    exit_in_doubt,
    interruptible,
    kept_stages,
    loading,
    print_doubts,
    print_failures,
    teller,
)


def identify(
    records: Annotated[
        list[Path] | None,
        typer.Argument(help=f"{RECORDS}; none: two simulated manoeuvres."),
    ] = None,
    model: ModelOption = "attas",
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("results"),
    seed: SeedOption = 0,
    noise: Annotated[NoiseModel, typer.Option(help="Noise model of the posterior.")] = NoiseModel.BUFFET_AR1,
    coefficients: Annotated[
        Coefficients,
        typer.Option(help="Same filter for all signals (matched), or as the published results."),
    ] = Coefficients.MATCHED,
    gp_split: Annotated[
        Split, typer.Option(help="Split whose Gaussian-process hyperparameters are sampled.")
    ] = Split.RANDOM,
    frequency: FrequencyOption = None,
    resample: ResampleOption = None,
    split: SplitOption = False,
    sample: Annotated[
        bool, typer.Option(help="Sample the posterior; otherwise maximum likelihood with its bounds only.")
    ] = True,
    gp: Annotated[bool, typer.Option(help="Train the Gaussian processes.")] = True,
    next_flight: Annotated[
        bool,
        typer.Option(
            "--next-flight",
            help="Pool the manoeuvres: scatter of parameters between them, and a flight not yet flown.",
        ),
    ] = False,
    figures: Annotated[bool, typer.Option(help="Draw the figures.")] = True,
    json: JsonOption = False,
) -> None:
    """Identify the parameters of a card's model: maximum likelihood, posteriors and Gaussian processes.

    Example: bayes-aero identify qst01.asc qst02.asc --model attas --out results
    """
    card, flights = card_and_records(model, records or [], resample, split)
    # Imported here: --help, a mistyped option and a file that is not there need not wait for the numerical libraries.
    with loading():
        from bayes_aero.flight.card.card import read_card
        from bayes_aero.jobs import identify as job
        from bayes_aero.jobs.options import IdentifyOptions
        from bayes_aero.model.noise import Colour
        from bayes_aero.report.pooled import next_flight_table
        from bayes_aero.report.tables.run_tables import parameter_table
        from bayes_aero.report.text.identification import verdict
        from bayes_aero.simulate.demo import TRUTH, demo_records

    console, truth = teller(quiet=json, highlight=True), None
    if not records:
        console.print("No record given: two simulated stall manoeuvres are identified.")
        same = card.sha256 == read_card("attas").sha256  # with another card's constants the parameters are others
        flights, truth = demo_records(), TRUTH if same else None
    with interruptible(kept_stages(out)), bar("reading") as tell:
        options = IdentifyOptions(
            noise=Colour(noise.value),
            coefficients=coefficients.value,
            split=gp_split.value,
            seed=seed,
            sample=sample,
            gp=gp,
            next_flight=next_flight,
            figures=figures,
            frequency=frequency,
        )
        found = job.identify(flights, card, options, out=out, truth=truth, progress=tell)
    if json:
        typer.echo((out / "results.json").read_text(encoding="utf-8"), nl=False)
        exit_if_failed(found.failures)
        exit_in_doubt(found.consistency, found.health, corrects=False)
        return
    print_failures(console, found.failures)
    print_doubts(console, found.consistency, found.health, corrects=False)
    console.print(parameter_table(found).terminal())
    if found.next_flight is not None:
        console.print(next_flight_table(found).terminal())
    for sentence in verdict(found):
        console.print(f"• {sentence}", highlight=False)
    for note in found.notes:
        console.print(f"! {note}", highlight=False)
    console.print(f"Results are in {out}", highlight=False, soft_wrap=True)
    exit_if_failed(found.failures)
    exit_in_doubt(found.consistency, found.health, corrects=False)
