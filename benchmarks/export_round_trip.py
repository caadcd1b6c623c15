"""How far JSBSim with an exported model flies from the package's own simulation, by frame.

    python benchmarks/export_round_trip.py

The largest difference of each output over its range, through recorded elevator and thrust, lateral motion at rest. The
simulated stall is the demo's. The ATTAS record is flown with the parameters that maximum likelihood finds in it.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jsbsim_flights import STATES, flown, loaded, simulated

from bayes_aero.dynamics.aircraft.longitudinal import Longitudinal
from bayes_aero.export.identified import Identified
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.simulate.demo import TRUTH, simulate_stall

ATTAS = Path(__file__).resolve().parents[2] / "shared" / "attas" / "fAttas_qst01.asc"
FRAMES = (4, 8, 20, 40)  # a sample of 40 ms
OUTPUTS = ("airspeed", "alpha", "theta", "q", "altitude")


def flights() -> list[tuple[str, Identified, FlightRecord]]:
    """Records with the model that flies them."""
    card = read_card("attas")
    model = Model.from_card(card)
    record = simulate_stall(0, sensor_noise=0.0, disturbance=0.0)
    found = Identified("stall", card.title, model, card.aircraft, TRUTH, ())
    lagged = replace(found, model=replace(model, fixed=()), values=TRUTH | {"tau1": 5.0})
    every = [("simulated stall", found, record), ("the same, tau1 = 5 chords", lagged, record)]
    if ATTAS.is_file():
        real = read_record(ATTAS, card.channels)
        fit = fit_mle(model, observe([real], card, model))
        values = dict(zip(fit.names, map(float, fit.estimate), strict=True)) | dict(model.fixed)
        every.append(("ATTAS qst01", replace(found, values=values), real))
    return every


def differences(found: Identified, record: FlightRecord, frames: int) -> dict[str, float]:
    """By output."""
    c = record.channels
    inputs = {"elevator": c["elevator"], "thrust": c["thrust_left"] + c["thrust_right"]}
    start = {name: float(c[name][0]) for name in OUTPUTS}
    X = {"X": (f"bayes-aero/{'state' if found.lagged else 'separation'}/X", 1.0)}
    with tempfile.TemporaryDirectory() as folder:
        sim = loaded(found, Path(folder))
        told = flown(sim, start, inputs, record.dt, frames, {n: STATES[n] for n in OUTPUTS} | X)
    system = Longitudinal(found.model, {n: jnp.asarray(x) for n, x in found.values.items()}, found.aircraft)
    begin = start | {"X": 1.0}
    expected = simulated(system, begin, inputs, record.dt, X=told["X"][0] if found.lagged else None)
    return {n: float(np.abs(told[n] - expected[n]).max() / np.ptp(expected[n])) for n in OUTPUTS}


def main() -> None:
    """Print the table."""
    print(f"| flight | frame | {' | '.join(OUTPUTS)} |\n|---|---|{'---|' * len(OUTPUTS)}")
    for name, found, record in flights():
        for frames in FRAMES:
            sizes = differences(found, record, frames)
            cells = " | ".join(f"{1e3 * sizes[n]:.2g}" for n in OUTPUTS)
            print(f"| {name} | {1e3 * record.dt / frames:.3g} ms | {cells} |")
    print("\nThousandths of the range of each output.")


if __name__ == "__main__":
    main()
