"""bayes-aero fly."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayes_aero.cli.terminal import (
    FAILED,
    RECORDS,
    FrequencyOption,
    InitialState,
    Inputs,
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

if TYPE_CHECKING:
    from rich.console import Console

    from bayes_aero.jobs.io.fly_json import Flight


def fly(
    records: Annotated[
        list[Path],
        typer.Argument(help=f"{RECORDS}."),
    ],
    model: ModelOption = "attas",
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("trajectories"),
    windows: Annotated[
        float, typer.Option(help="Length of the windows that are fitted before whole manoeuvres, in s.")
    ] = 12.0,
    initial_state: Annotated[
        InitialState,
        typer.Option(
            help="free: fitted for each manoeuvre; fixed: initial_state of the card's section fly, or the first sample."
        ),
    ] = InitialState.FREE,
    priors: Annotated[
        bool, typer.Option(help="--no-priors: a fit without priors of parameters and initial states.")
    ] = True,
    outputs: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,NAME", help="Outputs to compare, e.g. alpha,q,q_dot; default: the card's, or all but q_dot."
        ),
    ] = None,
    inputs: Annotated[
        Inputs,
        typer.Option(
            help="Inputs between samples: linear, for recorded positions; held, for commands held until the next "
            "sample."
        ),
    ] = Inputs.LINEAR,
    process_noise: Annotated[
        bool | None,
        typer.Option(
            help="Fit the same model with process noise, too (extended Kalman filter); default: if there are gusts, or "
            "if output error and the coefficients disagree."
        ),
    ] = None,
    posterior: Annotated[
        bool,
        typer.Option("--posterior", help="With --process-noise: sample the posterior, too (NUTS and emcee)."),
    ] = False,
    frequency: FrequencyOption = None,
    seed: SeedOption = 0,
    resample: ResampleOption = None,
    split: SplitOption = False,
    figures: Annotated[bool, typer.Option(help="Draw the figures.")] = True,
    json: JsonOption = False,
) -> None:
    """Fit a card's model and the initial states to trajectories (output error), with the recorded inputs.

    For cards with a model of effects and for linear ones. Exit code 0: converged; 1: not, or the model cannot fly.

    Published output-error programs fit with --no-priors, most of them with --initial-state fixed.

    Example: bayes-aero fly run1.csv run2.csv --model short_period.toml --out trajectories
    """
    card, flights = card_and_records(model, records, resample, split)
    with loading():
        from bayes_aero.jobs.fly import fly_records
        from bayes_aero.jobs.io.fly_json import RESULTS
        from bayes_aero.jobs.options import FlyOptions

    console = teller(quiet=json, highlight=True)
    with interruptible(kept_stages(out)), bar("reading") as tell:
        chosen = (windows, initial_state.value, priors, outputs, inputs.value, seed, figures, process_noise, posterior)
        options = FlyOptions(*chosen, frequency=frequency)
        found = fly_records(flights, card, options, out=out, progress=tell)
    if json:
        typer.echo((out / RESULTS).read_text(encoding="utf-8"), nl=False)
    print_failures(console, found.failures)
    print_doubts(console, found.consistency, found.health, corrects=False)
    print_fit(console, found, out)
    if not found.flown.converged:
        raise typer.Exit(FAILED)
    exit_if_failed(found.failures)
    exit_in_doubt(found.consistency, found.health, corrects=False)


def print_fit(console: Console, found: Flight, out: Path) -> None:
    """Tables, findings and notes of a fit to trajectories."""
    from bayes_aero.report.motion import mode_table
    from bayes_aero.report.tables.fly import (
        beside_table,
        error_table,
        one_step_table,
        parameter_table,
        posterior_table,
        process_noise_table,
    )

    console.print(parameter_table(found.flown).terminal())
    if found.flown.frequency:
        console.print(beside_table(found.flown).terminal())
    if found.process_noise is not None and found.process_noise.converged:
        console.print(process_noise_table(found.process_noise, found.flown, found.posteriors).terminal())
        if found.process_noise.one_step is not None:
            console.print(one_step_table(found.process_noise.one_step, found.flown.units).terminal())
    if found.posteriors:
        console.print(posterior_table(found.posteriors).terminal())
    console.print(error_table(found.flown).terminal())
    if found.motion is not None and found.motion.modes:
        console.print(mode_table(found.motion).terminal())
    for sentence in found.sentences:
        console.print(f"• {sentence}", highlight=False)
    for note in found.notes:
        console.print(f"! {note}", highlight=False)
    console.print(f"Results are in {out}", highlight=False, soft_wrap=True)
