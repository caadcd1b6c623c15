"""bayes-aero path."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayes_aero.cli.fly import print_fit
from bayes_aero.cli.terminal import (
    DOUBT,
    FAILED,
    RECORDS,
    InitialState,
    JsonOption,
    ModelOption,
    ResampleOption,
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


def path(
    records: Annotated[list[Path], typer.Argument(help=f"{RECORDS}.")],
    model: ModelOption = "attas",
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("path"),
    initial_state: Annotated[
        InitialState, typer.Option(help="free: fitted for each manoeuvre; fixed: the first sample.")
    ] = InitialState.FREE,
    priors: Annotated[bool, typer.Option(help="--no-priors: a fit without priors.")] = True,
    outputs: Annotated[
        str | None,
        typer.Option(metavar="NAME,NAME", help="Outputs to compare, e.g. airspeed,alpha,theta; default: all recorded."),
    ] = None,
    process_noise: Annotated[
        bool,
        typer.Option(
            "--process-noise",
            help="Fit again with gusts and the noise of accelerometers and gyros, by an extended Kalman filter.",
        ),
    ] = False,
    resample: ResampleOption = None,
    split: SplitOption = False,
    figures: Annotated[bool, typer.Option(help="Draw the figures.")] = True,
    json: JsonOption = False,
) -> None:
    """Reconstruct the flight path: errors of sensors from accelerations and rates, without aerodynamics.

    Recorded accelerations and rates are integrated. Their biases, scale and bias of flow angles and airspeed, the
    position and delay of the vane and the wind are fitted to airspeed, flow angles, attitude and altitude by output
    error. corrected/ has the records without these errors. Exit code 0: converged; 1: not; 3: a
    channel is faulty.

    With --process-noise gusts.csv has the gusts that vane and pitot tube met.

    Example: bayes-aero path run1.csv run2.csv --model aircraft.toml --out path
    """
    card, flights = card_and_records(model, records, resample, split)
    with loading():
        from bayes_aero.jobs.io.fly_json import RESULTS
        from bayes_aero.jobs.options import FlyOptions
        from bayes_aero.jobs.path import WHOLE, path_records

    console = teller(quiet=json, highlight=True)
    with interruptible(kept_stages(out)), bar("reading") as tell:
        options = FlyOptions(
            WHOLE, initial_state.value, priors, outputs, figures=figures, process_noise=process_noise, flight_path=True
        )
        found = path_records(flights, card, options, out=out, progress=tell)
    if json:
        typer.echo((out / RESULTS).read_text(encoding="utf-8"), nl=False)
    print_failures(console, found.failures)
    print_doubts(console, None, found.health, corrects=False)  # whether sensors agree is what the fit answers
    print_fit(console, found, out)
    if not found.flown.converged:
        raise typer.Exit(FAILED)
    exit_if_failed(found.failures)
    if found.flown.worse:
        raise typer.Exit(DOUBT)
    exit_in_doubt(None, found.health, corrects=False)
