"""How far JSBSim with an exported model flies from the package's own simulation, by frame.

    python benchmarks/export_round_trip.py

The largest difference of each output over its range. Recorded elevator and thrust fly in the plane of symmetry; the
card stall_six flies in six degrees of freedom through all recorded controls. The simulated stall is the demo's. The
ATTAS record is flown with the parameters that maximum likelihood finds in it.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jsbsim_flights import STATES, flown, loaded, simulated

from bayes_aero.dynamics.aircraft import Longitudinal, RigidBody
from bayes_aero.export.identified import Identified
from bayes_aero.flight.card import read_card
from bayes_aero.flight.reading import read_record
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.mle import fit_mle
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.model.records import with_sums
from bayes_aero.physics.aircraft import Axis
from bayes_aero.simulate.demo import TRUTH, simulate_stall

ATTAS = Path(__file__).resolve().parents[2] / "shared" / "attas" / "fAttas_qst01.asc"
FRAMES = (4, 8, 20, 40)  # a sample of 40 ms
OUTPUTS, LATERAL = ("airspeed", "alpha", "theta", "q", "altitude"), ("beta", "p", "r", "phi")
LONG, SHORT = 120.0, 30.0  # s: without a pilot the aircraft rolls off in six degrees of freedom


def flights() -> list[tuple[str, Identified, FlightRecord]]:
    """Records with the model that flies them."""
    card = read_card("attas")
    model = Model.from_card(card)
    record = simulate_stall(0, sensor_noise=0.0, disturbance=0.0)
    found = Identified("stall", card.title, model, card.aircraft, TRUTH, ())
    lagged = replace(found, model=replace(model, fixed=()), values=TRUTH | {"tau1": 5.0})
    every = [("simulated stall", found, record), ("the same, tau1 = 5 chords", lagged, record)]
    if ATTAS.is_file():
        every += [
            ("ATTAS qst01, plane of symmetry", *fitted("attas", LONG)),
            ("six degrees", *fitted("stall_six", SHORT)),
        ]
    return every


def fitted(name: str, seconds: float) -> tuple[Identified, FlightRecord]:
    """A card's model with its maximum-likelihood estimates on ATTAS, and the begin of that record."""
    card = read_card(name)
    model, record = Model.from_card(card), read_record(ATTAS, card.channels)
    fit = fit_mle(model, observe([record], card, model))
    values = dict(zip(fit.names, map(float, fit.estimate), strict=True)) | dict(model.fixed)
    whole = replace(record, channels=with_sums(record, card))
    begin = float(record.time[0])
    return Identified("attas", card.title, model, card.aircraft, values, ()), whole.window(begin, begin + seconds)


def differences(found: Identified, record: FlightRecord, frames: int) -> dict[str, float]:
    """By output."""
    c, values = record.channels, {n: jnp.asarray(x) for n, x in found.values.items()}
    rigid = Axis.LATERAL in found.model.axes
    system = (RigidBody if rigid else Longitudinal)(found.model, values, found.aircraft)
    names = OUTPUTS + (LATERAL if rigid else ())
    thrust = c["thrust"] if "thrust" in c else c["thrust_left"] + c["thrust_right"]
    inputs = {"elevator": c["elevator"], "thrust": thrust}
    inputs |= {name: c[name] for name in ("aileron", "rudder") if rigid}
    start = {name: float(c[name][0]) for name in names}
    X = {"X": ("bayes-aero/state/X", 1.0)} if found.lagged else {}
    with tempfile.TemporaryDirectory() as folder:
        sim = loaded(found, Path(folder))
        told = flown(sim, start, inputs, record.dt, frames, {n: STATES[n] for n in names} | X)
    begin = start | ({"X": 1.0} if found.lagged else {})
    expected = simulated(system, begin, inputs, record.dt, X=told["X"][0] if found.lagged else None)
    return {n: float(np.abs(told[n] - expected[n]).max() / np.ptp(expected[n])) for n in names}


def main() -> None:
    """Print the table."""
    names = OUTPUTS + LATERAL
    print(f"| flight | frame | {' | '.join(names)} |\n|---|---|{'---|' * len(names)}")
    for name, found, record in flights():
        for frames in FRAMES:
            sizes = differences(found, record, frames)
            cells = " | ".join(f"{1e3 * sizes[n]:.2g}" if n in sizes else "-" for n in names)
            print(f"| {name} | {1e3 * record.dt / frames:.3g} ms | {cells} |")
    print("\nThousandths of the range of each output.")


if __name__ == "__main__":
    main()
