"""bayes-aero qualify."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayes_aero.cli.terminal import (
    RECORDS,
    JsonOption,
    SeedOption,
    bar,
    exit_if_failed,
    exit_in_doubt,
    interruptible,
    kept_stages,
    loading,
    print_doubts,
    print_failures,
    teller,
)


def qualify(
    result: Annotated[
        str,
        typer.Argument(help="Folder (or JSON file) that fly, diagnose or identify wrote.", metavar="RESULT"),
    ],
    records: Annotated[
        list[Path] | None, typer.Argument(help=f"Further tests: records that were not fitted. {RECORDS}.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("qualification"),
    model: Annotated[
        str | None, typer.Option(help="The card of the result, where it is not found by itself.", metavar="CARD")
    ] = None,
    fitted: Annotated[
        list[Path] | None,
        typer.Option(help="A record of the result, where they are not found by themselves; once for each."),
    ] = None,
    draws: Annotated[int, typer.Option(help="Flights drawn for every test.")] = 400,
    gusts: Annotated[
        float | None,
        typer.Option(help="Intensity of gusts in m/s (standard deviation); default: those that fly has estimated."),
    ] = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """How probably the simulation passes each tolerance of the card: in the manoeuvres flown, and in the next flight.

    Parameters, errors of the model's structure and gusts are counted. Writes a page for an evaluator to sign. Exit code
    0, whatever the verdict; 3: the records are in doubt.

    Example: bayes-aero qualify trajectories --out qualification
    """
    from bayes_aero.flight.reading.read_record import present
    from bayes_aero.jobs.handover.result_file import read_result, result_file

    for path in (*(records or ()), *(fitted or ())):
        present(path)
    file = result_file(result)
    if file is not None:
        read_result(file)
    with loading():
        from bayes_aero.jobs.handover.qualification_json import RESULTS
        from bayes_aero.jobs.handover.qualify import QualifyOptions, qualify_result
        from bayes_aero.report.qualification.further import further_sentences
        from bayes_aero.report.qualification.tables import verdict_table
        from bayes_aero.report.qualification.text import sentences, verdict_sentence

    console = teller(quiet=json)
    options = QualifyOptions(model, tuple(fitted or ()), draws, seed, gusts)
    with interruptible(kept_stages(out)), bar("reading") as tell:
        found, failures = qualify_result(result, tuple(records or ()), options, out=out, progress=tell)
    if json:
        typer.echo((out / RESULTS).read_text(encoding="utf-8"), nl=False)
    print_failures(console, failures)
    print_doubts(console, found.consistency, found.health, corrects=False)
    console.print(verdict_sentence(found), soft_wrap=True)
    console.print(verdict_table(found).terminal())
    for sentence in (
        *sentences(found),
        *further_sentences(found.further),
        *(f"{name}: {text}" for name, text in found.origins.items()),
    ):
        console.print(f"• {sentence}", highlight=False)
    console.print(f"Results are in {out}; qualification.html is to be signed or refused", soft_wrap=True)
    exit_if_failed(failures)
    exit_in_doubt(found.consistency, found.health, corrects=False)
