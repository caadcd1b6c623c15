"""bayes-aero card."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayes_aero.atomic_write import write_whole
from bayes_aero.cli.terminal import SUFFIXES, JsonOption, exit_if_failed, loading, print_failures, print_json, teller
from bayes_aero.errors import InputError


def card(
    record: Annotated[Path, typer.Argument(help=f"A flight record whose columns have names ({SUFFIXES}).")],
    out: Annotated[
        Path | None, typer.Option(help="File to write; default: the record's name with .toml, here.")
    ] = None,
    page: Annotated[bool, typer.Option("--page/--no-page", help="Write CARD.report.html, too.")] = True,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a card that is there.")] = False,
    json: JsonOption = False,
) -> None:
    """Write a commented starter card for a new aircraft from a record's columns.

    Names, units and signs are guessed, each with its evidence.
    What only you know is marked TODO; using the card before names the first.

    Example: bayes-aero card flight7.csv --out mine.toml
    """
    from bayes_aero.flight.reading.segments import segment_of

    record = segment_of(record).file
    target = out or Path(f"{record.stem}.toml")
    if target.exists() and not force:
        raise InputError(f"{target} exists; give --force to overwrite it, or another name with --out")
    with loading():
        from bayes_aero.jobs.card_template import starter_card

    starter = starter_card(record)
    try:
        write_whole(starter.text, target)
    except OSError as reason:
        raise InputError(f"{target} cannot be written ({reason.strerror}); give another name with --out") from None
    report = None
    failures: tuple[str, ...] = ()
    if page:
        from bayes_aero.jobs.card_template import put_starter_page

        report, failures = put_starter_page(starter, record, target)
    if json:
        print_json(starter.told | {"card": str(target), "report": None if report is None else str(report)})
        exit_if_failed(failures)
        return
    console = teller()
    console.print(f"The card is in {target}. Read its proposals.", soft_wrap=True)
    if starter.todo:
        console.print(f"To be filled in ({len(starter.todo)}): {', '.join(name for name, _ in starter.todo)}.")
    if starter.blind:
        which = "it" if len(starter.blind) == 1 else "them"
        console.print(
            f"Not found: {', '.join(starter.blind)}. identify needs {which}; diagnose works without {which}, with "
            f"less information."
        )
    if report is not None:
        console.print(f"The report is in {report}", soft_wrap=True)
    split = " --split" if starter.parts > 1 else ""
    if split:
        console.print(f"Gaps in time divide the file into {starter.parts} parts: --split reads each as a manoeuvre.")
    console.print(f"Then: bayes-aero check {record} --model {target}{split}", soft_wrap=True)
    print_failures(console, failures)
    exit_if_failed(failures)
