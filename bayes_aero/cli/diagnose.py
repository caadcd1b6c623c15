"""bayes-aero diagnose."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from bayes_aero.cli.terminal import (
    RECORDS,
    JsonOption,
    ModelOption,
    ResampleOption,
    SeedOption,
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

if TYPE_CHECKING:  # the real imports wait until the command needs them
    from bayes_aero.jobs.io.diagnosis_json import Outcome

MOST = 5  # candidates of each stage on a terminal, where there is no cause


def diagnose(
    records: Annotated[
        list[Path] | None,
        typer.Argument(help=f"{RECORDS}; none: an effect is hidden in two simulated manoeuvres, then searched for."),
    ] = None,
    model: ModelOption = "attas",
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("diagnosis"),
    seed: SeedOption = 0,
    max_effects: Annotated[int, typer.Option(min=1, help="Effects that each stage may add to the model.")] = 8,
    resample: ResampleOption = None,
    split: SplitOption = False,
    test_points: Annotated[
        bool, typer.Option(help="Propose manoeuvres that decide what is open; fit causes in a band of frequencies.")
    ] = True,
    trajectories: Annotated[
        bool, typer.Option(help="Simulate the card's and the extended model with the recorded inputs.")
    ] = True,
    figures: Annotated[bool, typer.Option(help="Draw the figures.")] = True,
    process_noise: Annotated[
        bool | None,
        typer.Option(help="Estimate gusts, and search in what a filter does not foresee; default: if there are gusts."),
    ] = None,
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
    (card, flights), hidden = card_and_records(model, records or [], resample, split), None
    with loading():
        from bayes_aero.jobs.diagnose import diagnose_records, hide_one
        from bayes_aero.jobs.io.effect_file import refuse_existing, write_effects
        from bayes_aero.jobs.options import DiagnoseOptions

    if write_effect is not None:
        refuse_existing(write_effect)
    console = teller(quiet=json, highlight=True)
    with interruptible(kept_stages(out)), bar("reading" if records else "simulating") as tell:
        if not records:
            console.print("No record given: an effect is hidden in two simulated manoeuvres, then searched for.")
            hidden, flights = hide_one(card, seed)
        options = DiagnoseOptions(seed, max_effects, test_points, trajectories, figures, process_noise)
        found = diagnose_records(flights, card, options, out=out, hidden=hidden, progress=tell)
    told = None
    if write_effect is not None:
        told = write_effects(found.diagnosis.terms, [record.name for record in flights], write_effect)
    corrects = found.diagnosis.by_coefficients  # trajectories alone are fitted to the record as it is
    if json:
        typer.echo((out / "diagnosis.json").read_text(encoding="utf-8"), nl=False)
        exit_if_failed(found.failures)
        exit_in_doubt(found.consistency, found.health, corrects=corrects)
        return
    print_failures(console, found.failures)
    print_doubts(console, found.consistency, found.health, corrects=corrects)
    _tell(console, found)
    for line in (told, f"Results are in {out}"):
        if line:
            console.print(line, highlight=False, soft_wrap=True)
    exit_if_failed(found.failures)
    exit_in_doubt(found.consistency, found.health, corrects=corrects)


def _tell(console: Console, found: Outcome) -> None:
    from bayes_aero.report.design import in_band_sentences, points_sentences
    from bayes_aero.report.tables.diagnosis_tables import causes_table, screen_table
    from bayes_aero.report.tables.fly import hold_out_error_table
    from bayes_aero.report.text.diagnosis import revealed, sentences

    verdict, *rest = sentences(found.view)
    d, rankings = found.diagnosis, found.view.rankings
    console.print(verdict, highlight=False, style="bold")
    if d.causes or rankings:
        first = [replace(ranking, candidate_scores=ranking.candidate_scores[:MOST]) for ranking in rankings]
        console.print((causes_table(d) if d.causes else screen_table(first, d)).terminal())
    if found.view.trajectories is not None:
        console.print(hold_out_error_table(found.view.trajectories).terminal())
    for sentence in (*rest, *in_band_sentences(found.in_band), *points_sentences(found.test_points)):
        console.print(f"• {sentence}", highlight=False)
    for note in found.notes:
        console.print(f"! {note}", highlight=False)
    if found.hidden is not None:
        for sentence in revealed(found.hidden, found.named):
            console.print(sentence, highlight=False, style="bold")
