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
from typing import Any

import jax.numpy as jnp
import numpy as np

from bayes_aero.dynamics.aircraft import Longitudinal, RigidBody
from bayes_aero.dynamics.system import System, integrate
from bayes_aero.export.identified import Identified
from bayes_aero.export.simulators import jsbsim_files
from bayes_aero.flight.card import read_card
from bayes_aero.flight.reading import read_record
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.mle import fit_mle
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.model.records import with_sums
from bayes_aero.physics.aircraft import Axis, air
from bayes_aero.simulate.demo import TRUTH, simulate_stall

# --- JSBSim over a flat earth that does not turn, in the package's air, and the package's own simulation.

FOOT, POUND = 0.3048, 0.45359237 * 9.80665  # m, N: international foot, standard pound-force
SLUG = POUND / FOOT  # kg
RADIUS = 6.371e9  # m: a thousand earths, on which 10 km are flat to a metre
FLAT = f"""<?xml version="1.0"?>
<planet name="flat"><semimajor_axis unit="M">{RADIUS}</semimajor_axis><semiminor_axis unit="M">{RADIUS}</semiminor_axis>
<rotation_rate unit="RAD/SEC">0</rotation_rate><GM unit="M3/SEC2">{9.80665 * RADIUS**2}</GM><J2>0</J2></planet>"""
SECOND_ORDER = 3  # of JSBSim's integrators: Adams-Bashforth
STATES = {
    "airspeed": ("velocities/vt-fps", FOOT), "alpha": ("aero/alpha-rad", 1.0), "beta": ("aero/beta-rad", 1.0),
    "p": ("velocities/p-rad_sec", 1.0), "q": ("velocities/q-rad_sec", 1.0), "r": ("velocities/r-rad_sec", 1.0),
    "phi": ("attitude/phi-rad", 1.0), "theta": ("attitude/theta-rad", 1.0), "altitude": ("position/h-sl-ft", FOOT),
}  # fmt: skip
CONTROLS = {
    "elevator": "fcs/elevator-pos-rad", "aileron": "fcs/right-aileron-pos-rad", "rudder": "fcs/rudder-pos-rad",
    "thrust": "bayes-aero/input/thrust-N",
}  # fmt: skip


def loaded(found: Identified, folder: Path) -> Any:
    """JSBSim with the exported aircraft over a flat earth that does not turn."""
    import jsbsim

    for name, text in jsbsim_files(found).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    (folder / "flat.xml").write_text(FLAT)
    sim = jsbsim.FGFDMExec(str(folder))
    sim.set_debug_level(0)
    assert sim.load_planet(str(folder / "flat.xml"), False)
    assert sim.load_model(found.name)
    sim["simulation/gravity-model"] = 0
    for motion in ("rate/rotational", "rate/translational", "position/rotational", "position/translational"):
        sim[f"simulation/integrator/{motion}"] = SECOND_ORDER
    return sim


def started(sim: Any, start: dict[str, float]) -> None:
    """Initial state from SI values by name."""
    sim["ic/h-sl-ft"] = start["altitude"] / FOOT
    sim["ic/vt-fps"] = start["airspeed"] / FOOT
    for name in ("alpha", "beta", "theta", "phi"):
        sim[f"ic/{name}-rad"] = start.get(name, 0.0)
    for name in "pqr":
        sim[f"ic/{name}-rad_sec"] = start.get(name, 0.0)
    for _ in range(2):  # the first leaves forces of no flow in the history of the integrators
        sim.run_ic()


def in_standard_air(sim: Any) -> None:
    """Air at JSBSim's geometric altitude as the package has it at this geopotential one: over a flat earth both are
    the same, but JSBSim's atmosphere keeps the earth's radius."""
    altitude = sim["position/h-sl-ft"] * FOOT
    density, sound = air(np.asarray(altitude))
    sim["atmosphere/override/temperature"] = float(sound) ** 2 / (1.4 * 287.05287) * 1.8
    sim["atmosphere/override/density"] = float(density) / (SLUG / FOOT**3)


def flown(sim: Any, start: dict, inputs: dict, dt: float, frames: int, outputs: dict) -> dict[str, np.ndarray]:
    """JSBSim's flight through `inputs` (SI, linear between samples), with `frames` a sample."""
    sim.set_dt(dt / frames)
    in_standard_air(sim)
    for name, x in inputs.items():
        sim[CONTROLS[name]] = x[0]
    started(sim, start)
    in_standard_air(sim)
    found = {name: [] for name in outputs}
    count = len(next(iter(inputs.values())))
    for k in range(count):
        for name, (known, factor) in outputs.items():
            found[name].append(sim[known] * factor)
        for j in range(frames if k < count - 1 else 0):
            share = (j + 1) / frames
            for name, x in inputs.items():
                sim[CONTROLS[name]] = (1.0 - share) * x[k] + share * x[k + 1]
            in_standard_air(sim)
            sim.run()
    return {name: np.array(x) for name, x in found.items()}


def simulated(
    system: System, start: dict, inputs: dict, dt: float, substeps: int = 8, X: float | None = None
) -> dict[str, np.ndarray]:
    """The package's own flight; `X` is where the separation point begins, which depends on alpha-dot there."""
    u = {name: jnp.asarray(x) for name, x in inputs.items()}
    begin = jnp.array([float(start.get(name, 0.0)) for name in system.start])
    begin = system.complete_start(begin, {name: x[0] for name, x in u.items()})
    if X is not None:
        begin = begin.at[system.start.index("X")].set(X)
    found = integrate(system, system.state_at_start(begin), u, dt, substeps)
    assert bool(found.inside.all())
    return {name: np.asarray(x) for name, x in found.outputs.items()}


# --- The flights of the table.

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
