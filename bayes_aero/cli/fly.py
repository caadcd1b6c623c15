"""bayes-aero fly and bayes-aero path: fits to trajectories."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
from bayes_aero.jobs.options import FlyOptions, PathOptions, ReadingOptions

if TYPE_CHECKING:
    from rich.console import Console

    from bayes_aero.jobs.io.fly_json import Flight


@with_options
def fly(
    records: Annotated[list[Path], typer.Argument(help=f"{RECORDS}.")],
    reading: ReadingOptions,
    options: FlyOptions,
    out: OutOption = Path("trajectories"),
    json: JsonOption = False,
) -> None:
    """Fit a card's model and the initial states to trajectories (output error), with the recorded inputs.

    For cards with a model of effects and for linear ones. Exit code 0: converged; 1: not, or the model cannot fly.

    Published output-error programs fit with --no-priors, most of them with --initial-state fixed.

    Example: bayes-aero fly run1.csv run2.csv --model short_period.toml --out trajectories
    """
    card, flights = card_and_records(records, reading)
    with loading():
        from bayes_aero.jobs.fly import fly as job
        from bayes_aero.jobs.io.fly_json import RESULTS

    console = teller(quiet=json, highlight=True)
    with interruptible(kept_stages(out)), bar("reading") as tell:
        found = job(flights, card, options, out=out, progress=tell)
    file, failed = out / RESULTS if json else None, not found.flown.converged
    conclude(console, found, lambda: print_fit(console, found, out), json=file, failed=failed)


@with_options
def path(
    records: Annotated[list[Path], typer.Argument(help=f"{RECORDS}.")],
    reading: ReadingOptions,
    options: PathOptions,
    out: OutOption = Path("path"),
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
    card, flights = card_and_records(records, reading)
    with loading():
        from bayes_aero.jobs.io.fly_json import RESULTS
        from bayes_aero.jobs.path import flight_path

    console = teller(quiet=json, highlight=True)
    with interruptible(kept_stages(out)), bar("reading") as tell:
        found = flight_path(flights, card, options, out=out, progress=tell)
    conclude(
        console,
        found,
        lambda: print_fit(console, found, out),
        json=out / RESULTS if json else None,
        compared=False,
        failed=not found.flown.converged,
        doubtful=found.flown.worse,
    )


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

    flown, beside = found.flown, found.process_noise
    tables = [parameter_table(flown), *([beside_table(flown)] if flown.frequency else [])]
    if beside is not None and beside.converged:
        tables.append(process_noise_table(beside, flown, found.posteriors))
        tables += [] if beside.one_step is None else [one_step_table(beside.one_step, flown.units)]
    tables += [posterior_table(found.posteriors)] if found.posteriors else []
    tables.append(error_table(flown))
    tables += [mode_table(found.motion)] if found.motion is not None and found.motion.modes else []
    for table in tables:
        console.print(table.terminal())
    print_lines(console, found.sentences, found.notes)
    console.print(f"Results are in {out}", highlight=False, soft_wrap=True)
