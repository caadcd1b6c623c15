"""bayes-aero diagnose."""

from __future__ import annotations

from dataclasses import replace
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
from bayes_aero.jobs.options import DiagnoseOptions, ReadingOptions

MOST = 5  # candidates of each stage on a terminal, where there is no cause


@with_options
def diagnose(
    reading: ReadingOptions,
    options: DiagnoseOptions,
    records: Annotated[
        list[Path] | None,
        typer.Argument(help=f"{RECORDS}; none: an effect is hidden in two simulated manoeuvres, then searched for."),
    ] = None,
    out: OutOption = Path("diagnosis"),
    write_effect: Annotated[
        Path | None,
        typer.Option(
            help="Effect file (.py) for the terms by which unexplained structure is described.", metavar="FILE"
        ),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Find the effects that a model lacks: size, uncertainty, rivals, and the gain on hold-out data.

    Example: bayes-aero diagnose qst01.asc qst02.asc --model attas --out diagnosis
    """
    (card, flights), hidden = card_and_records(records or [], reading), None
    with loading():
        from bayes_aero.jobs.diagnose import diagnose_records, hide_one
        from bayes_aero.jobs.io.effect_file import refuse_existing, write_effects
        from bayes_aero.report.design import in_band_sentences, points_sentences
        from bayes_aero.report.tables.diagnosis_tables import causes_table, screen_table
        from bayes_aero.report.tables.fly import hold_out_error_table
        from bayes_aero.report.text.diagnosis import revealed, sentences

    if write_effect is not None:
        refuse_existing(write_effect)
    console = teller(quiet=json, highlight=True)
    with interruptible(kept_stages(out)), bar("reading" if records else "simulating") as tell:
        if not records:
            console.print("No record given: an effect is hidden in two simulated manoeuvres, then searched for.")
            hidden, flights = hide_one(card, options.seed)
        found = diagnose_records(flights, card, options, out=out, hidden=hidden, progress=tell)
    d, rankings = found.diagnosis, found.view.rankings
    last = [f"Results are in {out}"]
    if write_effect is not None:
        last.insert(0, write_effects(d.terms, [record.name for record in flights], write_effect))

    def show() -> None:
        verdict, *rest = sentences(found.view)
        console.print(verdict, highlight=False, style="bold")
        if d.causes or rankings:
            first = [replace(ranking, candidate_scores=ranking.candidate_scores[:MOST]) for ranking in rankings]
            console.print((causes_table(d) if d.causes else screen_table(first, d)).terminal())
        if found.view.trajectories is not None:
            console.print(hold_out_error_table(found.view.trajectories).terminal())
        more = (*in_band_sentences(found.in_band), *points_sentences(found.test_points))
        print_lines(console, (*rest, *more), found.notes)
        for sentence in revealed(found.hidden, found.named) if found.hidden is not None else ():
            console.print(sentence, highlight=False, style="bold")
        for line in last:
            console.print(line, highlight=False, soft_wrap=True)

    # Trajectories alone are fitted to the record as it is.
    file = out / "diagnosis.json" if json else None
    conclude(console, found, show, json=file, corrects=d.by_coefficients)
