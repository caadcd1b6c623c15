"""bayes-aero check."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from bayes_aero.cli.terminal import (
    FAILED,
    RECORDS,
    JsonOption,
    SeedOption,
    bar,
    exit_if_failed,
    exit_in_doubt,
    interruptible,
    loading,
    print_failures,
    print_json,
    teller,
    with_options,
)
from bayes_aero.jobs.options import ReadingOptions

if TYPE_CHECKING:
    from bayes_aero.diagnosis.result import CheckReport


@with_options
def check(
    records: Annotated[list[Path], typer.Argument(help=f"{RECORDS}.")],
    reading: ReadingOptions,
    sensors: Annotated[bool, typer.Option(help="Check the sensors against each other along the flight path.")] = True,
    seed: SeedOption = 0,
    out: Annotated[
        Path | None, typer.Option(help="Folder for report.html and check.json; none: nothing is written.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Check records against a card: channels, units, gaps, what they can test, agreement of the sensors.

    Nothing aerodynamic is fitted. Exit code 0: usable; 1: not, with the reasons; 3: usable, but in doubt.

    Example: bayes-aero check qst01.asc qst02.asc --model attas
    """
    with loading():
        from bayes_aero.flight.card.card import read_card
        from bayes_aero.jobs.check import check_records, check_results, write_check

    card, how = read_card(reading.model), {"resample": reading.resample, "split": reading.split}
    with interruptible(lambda: "nothing was written; give the same command again"), bar("reading") as tell:
        report = check_records(records, card, sensors=sensors, seed=seed, progress=tell, **how)
        failures = report.failures + (() if out is None else write_check(report, out, seed))
    if json:
        print_json(check_results(report))
    else:
        print_report(teller(), report)
        print_failures(teller(), failures)
        if out is not None:
            teller().print(f"The report is in {out / 'report.html'}", soft_wrap=True)
    if not report.usable:
        raise typer.Exit(FAILED)
    exit_if_failed(failures)
    exit_in_doubt(report.consistency, report.health, corrects=False)


def print_report(console: Console, report: CheckReport) -> None:
    """Cautions, each record, what the records can be used for, whether the sensors agree."""
    from bayes_aero.report.tables.table import channel_table, sampling
    from bayes_aero.report.text.check import (
        card_sentences,
        headline,
        left_over,
        part_sentences,
        sensor_sentences,
        sizes,
        unused_columns,
        use_sentences,
    )

    doubt, told = report.consistency.disagrees, sensor_sentences(report)
    for caution in (*report.cautions, *told[:doubt]):
        console.print(f"! {caution}", style="yellow")
    for r, unused in zip(report.records, unused_columns(report), strict=True):
        console.print(r.path, style="bold", end="", soft_wrap=True)
        console.print(f": {sampling(r)}", soft_wrap=True)
        if r.gaps or r.uneven:
            console.print(f"{r.gaps} gaps, {r.uneven} uneven steps")
        console.print(channel_table(r).terminal())
        if r.missing:
            console.print(f"on the card, not in the file (not required): {', '.join(r.missing)}")
        if unused:
            console.print(f"in the file, not on the card: {', '.join(unused)}")
        for sentence in (*r.remarks, *part_sentences(r)):
            console.print(sentence, soft_wrap=True)
        for problem in r.problems:
            console.print(f"✗ {problem}", style="red")
    for sentence in (*card_sentences(report), *use_sentences(report), *told[doubt:]):
        console.print(sentence)
    for name, error in report.sensors.errors.items():
        faint = " (too small to be named)" if error["minor"] else ""
        console.print(f"  {name}: {error['claim']} {sizes(error)}{faint}")
    if not report.sensors.note:
        console.print(f"  {left_over(report)}")
    colour = "red" if not report.usable else "yellow" if report.cautions or doubt else "green"
    console.print(headline(report), style=f"bold {colour}")
