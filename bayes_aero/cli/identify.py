"""bayes-aero identify."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayes_aero.cli.terminal import (
    RECORDS,
    JsonOption,
    OutOption,
    bar,
    card_and_records,
    conclude,
    interruptible,
    kept_stages,
    loading,
    print_lines,
    teller,
    with_options,
)
from bayes_aero.jobs.options import IdentifyOptions, ReadingOptions


@with_options
def identify(
    reading: ReadingOptions,
    options: IdentifyOptions,
    records: Annotated[list[Path] | None, typer.Argument(help=f"{RECORDS}; none: two simulated manoeuvres.")] = None,
    out: OutOption = Path("results"),
    json: JsonOption = False,
) -> None:
    """Identify the parameters of a card's model: maximum likelihood, posteriors and Gaussian processes.

    Example: bayes-aero identify qst01.asc qst02.asc --model attas --out results
    """
    card, flights = card_and_records(records or [], reading)
    # Imported here: --help, a mistyped option and a file that is not there need not wait for the numerical libraries.
    with loading():
        from bayes_aero.flight.card.card import read_card
        from bayes_aero.jobs import identify as job
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
        found = job.identify(flights, card, options, out=out, truth=truth, progress=tell)

    def show() -> None:
        console.print(parameter_table(found).terminal())
        if found.next_flight is not None:
            console.print(next_flight_table(found).terminal())
        print_lines(console, verdict(found), found.notes)
        console.print(f"Results are in {out}", highlight=False, soft_wrap=True)

    conclude(console, found, show, json=out / "results.json" if json else None)
