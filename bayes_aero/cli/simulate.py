"""bayes-aero simulate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayes_aero.cli.terminal import (
    JsonOption,
    SeedOption,
    bar,
    exit_if_failed,
    interruptible,
    loading,
    print_failures,
    print_json,
    teller,
)
from bayes_aero.errors import InputError
from bayes_aero.jobs.options import Manoeuvre, SimulatedNoise


def simulate(
    out: Annotated[Path, typer.Option(help="File to write: .csv .parquet .nc .mat or .asc.")],
    effect: Annotated[
        list[str] | None,
        typer.Option(help="NAME=VALUE, or NAME.PARAMETER=VALUE; in SI or with a unit."),
    ] = None,
    manoeuvre: Annotated[Manoeuvre, typer.Option(help="The manoeuvre.")] = "random_stall",
    noise: Annotated[
        SimulatedNoise,
        typer.Option(help="white: sensors; ar1: also coloured disturbances; buffet: these grow with separation."),
    ] = "ar1",
    noise_scale: Annotated[float, typer.Option(min=0.0, help="Factor on all noise.")] = 1.0,
    seed: SeedOption = 0,
    duration: Annotated[float | None, typer.Option(help="Seconds; default 90 (random_stall) or 60.")] = None,
    dt: Annotated[float, typer.Option(help="Sampling interval in s.")] = 0.04,
    airspeed: Annotated[float | None, typer.Option(help="At the start, m/s; default: level flight at 6 deg.")] = None,
    altitude: Annotated[float, typer.Option(help="At the start, m.")] = 5200.0,
    amplitude: Annotated[float, typer.Option(help="Factor on the inputs of a standard manoeuvre.")] = 1.0,
    model: Annotated[str, typer.Option(help="Card: a .toml file, or a shipped one by name.", metavar="CARD")] = "attas",
    page: Annotated[bool, typer.Option("--page/--no-page", help="Write FILE.report.html, too.")] = True,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file that is there.")] = False,
    json: JsonOption = False,
) -> None:
    """Write a synthetic record and its true parameters (FILE.truth.json).

    Geometry, sensors with the errors that it fixes, and channels are the card's, the aerodynamics those of the demo
    aircraft and --effect.

    Example: bayes-aero simulate --effect "pitch_rate_bias=0.3 deg/s" --effect thrust_lag=1 --seed 4 --out flight.csv
    """
    if out.exists() and not force:
        raise InputError(f"{out} exists; give --force to overwrite it, or another name with --out")
    with loading():
        from bayes_aero.flight.card.card import read_card
        from bayes_aero.jobs.catalogue import known_effects
        from bayes_aero.jobs.simulate import parsed_effects, simulate_file
        from bayes_aero.simulate.demo import Request

    card = read_card(model)
    known = known_effects(card)
    asked = (manoeuvre, noise, noise_scale, seed, duration, dt, airspeed, altitude, amplitude)
    request = Request(parsed_effects(effect or [], known), *asked)
    with interruptible(lambda: "nothing was written; give the same command again"), bar("simulating"):
        found, truth, failures = simulate_file(request, card, known, out, page=page)
    if json:
        print_json(truth)
        exit_if_failed(failures)
        return
    console, record = teller(), found.record
    console.print(
        f"{manoeuvre}: {record.n} samples, {record.time[-1]:g} s, {len(record.channels)} channels → {out}",
        soft_wrap=True,
    )
    for name, values in request.effects.items():
        console.print(f"hidden effect: {name}, {', '.join(f'{p} = {x:g}' for p, x in values.items())} (SI)")
    for note in found.notes:
        console.print(f"! {note}")
    console.print(f"The truth is in {out}.truth.json", soft_wrap=True)
    if page:
        console.print(f"The report is in {out}.report.html", soft_wrap=True)
    print_failures(console, failures)
    exit_if_failed(failures)
