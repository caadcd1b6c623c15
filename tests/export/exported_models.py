"""Models that are exported, and worlds in which the exports fly: a flat, still earth for JSBSim."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from bayes_aero.dynamics.system import integrate
from bayes_aero.effect import Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.export.identified import Identified
from bayes_aero.export.jsbsim_aircraft import jsbsim_files
from bayes_aero.flight.axes import Axis
from bayes_aero.flight.card.card import read_card
from bayes_aero.model.model import Model
from bayes_aero.physics.atmosphere import air
from bayes_aero.simulate.demo import LATERAL_EFFECTS, LATERAL_TRUTH, TRUTH

BOTH = (Axis.LONGITUDINAL, Axis.LATERAL)
FOOT, POUND = 0.3048, 0.45359237 * 9.80665  # m, N: international foot, standard pound-force
SLUG = POUND / FOOT  # kg
RADIUS = 6.371e9  # m: a thousand earths, on which 10 km are flat to a metre
FLAT = f"""<?xml version="1.0"?>
<planet name="flat"><semimajor_axis unit="M">{RADIUS}</semimajor_axis><semiminor_axis unit="M">{RADIUS}</semiminor_axis>
<rotation_rate unit="RAD/SEC">0</rotation_rate><GM unit="M3/SEC2">{9.80665 * RADIUS**2}</GM><J2>0</J2></planet>"""
SECOND_ORDER = 3  # of JSBSim's integrators: Adams-Bashforth


def stall(tau1: float = 0.0, **changes: object) -> Identified:
    """The demo's aircraft; with a lag of the separation point where `tau1` is not 0."""
    card = read_card("attas")
    model = Model.from_card(card)
    model = model if tau1 == 0.0 else replace(model, fixed=())
    return Identified("stall", card.title, model, card.aircraft, TRUTH | {"tau1": tau1}, ("A test.",), **changes)


def six() -> Identified:
    """The same with lateral motion, a lag, and products of inertia."""
    card = read_card("attas")
    model = Model.of((*card.effects, *LATERAL_EFFECTS), None, BOTH)
    aircraft = replace(card.aircraft, Ixy=1500.0, Iyz=-2000.0, reference_point=(-0.02, 0.0, -0.12))
    return Identified("six", card.title, model, aircraft, TRUTH | LATERAL_TRUTH | {"tau1": 4.0}, ())


def everything(lag: float = 3.0) -> Identified:
    """Every effect of the catalogue that is exported, each with a size of its own; without a `lag` at 0."""
    kept = [e for e in CATALOGUE.values() if e.stage not in (Stage.CHANNEL, Stage.INFLOW) and e.disturbance is None]
    model = Model.of(kept, None if lag else {"tau1": 0.0}, BOTH)
    values = {}
    for effect in kept:
        for k, p in enumerate(effect.parameters):
            size = effect.sizes.get(p.name, (0.1, 0.1))[0]
            values[p.name] = p.start if p.start != p.neutral else p.neutral + (1.0 + 0.1 * k) * size
    aircraft = replace(read_card("attas").aircraft, rate_length=1.6, lateral_length=11.0, lateral_rate_length=10.0)
    aircraft = replace(aircraft, Ixy=9e3, Iyz=-2e4, engine_inclination=0.05)
    assert not [e.name for e in kept if e.parameters and e.absent_in(values)]
    values |= {"tau1": lag}
    return Identified("everything", "all effects", model, aircraft, values, ())


def random_signals(found: Identified, n: int, seed: int = 1) -> dict[str, np.ndarray]:
    """Random flow and controls, SI."""
    rng = np.random.default_rng(seed)
    ranges = {"airspeed": (50.0, 150.0), "mach": (0.15, 0.5), "density": (0.4, 1.2), "thrust": (1e3, 6e4)}
    ranges |= {"alpha": (-0.1, 0.45)}
    return {name: rng.uniform(*ranges.get(name, (-0.2, 0.2)), n) for name in (*found.signals, "density")}


def modelled(found: Identified, signals: dict, points: dict | None = None) -> dict[str, np.ndarray]:
    """The coefficients by the model itself."""
    values = {name: jnp.asarray(x) for name, x in found.values.items()}
    s = {name: jnp.asarray(x) for name, x in signals.items()}
    X = None if points is None else tuple(jnp.asarray(x) for x in points.values())
    X = X if X is None or len(X) > 1 else X[0]
    aircraft = found.model.actual_aircraft(values, found.aircraft)
    flow = found.model.flow(values, s, aircraft, X=X)
    return {name: np.asarray(flow[name]) for name in found.model.coefficients}


def loaded(found: Identified, folder):
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


def started(sim, start) -> None:
    """Initial state from SI values by name."""
    sim["ic/h-sl-ft"] = start["altitude"] / FOOT
    sim["ic/vt-fps"] = start["airspeed"] / FOOT
    for name in ("alpha", "beta", "theta", "phi"):
        sim[f"ic/{name}-rad"] = start.get(name, 0.0)
    for name in "pqr":
        sim[f"ic/{name}-rad_sec"] = start.get(name, 0.0)
    for _ in range(2):  # the first leaves forces of no flow in the history of the integrators
        sim.run_ic()


STATES = {
    "airspeed": ("velocities/vt-fps", FOOT), "alpha": ("aero/alpha-rad", 1.0), "beta": ("aero/beta-rad", 1.0),
    "p": ("velocities/p-rad_sec", 1.0), "q": ("velocities/q-rad_sec", 1.0), "r": ("velocities/r-rad_sec", 1.0),
    "phi": ("attitude/phi-rad", 1.0), "theta": ("attitude/theta-rad", 1.0), "altitude": ("position/h-sl-ft", FOOT),
}  # fmt: skip
CONTROLS = {
    "elevator": "fcs/elevator-pos-rad", "aileron": "fcs/right-aileron-pos-rad", "rudder": "fcs/rudder-pos-rad",
    "thrust": "bayes-aero/input/thrust-N",
}  # fmt: skip


def in_standard_air(sim) -> None:
    """Air at JSBSim's geometric altitude as the package has it at this geopotential one: over a flat earth both are
    the same, but JSBSim's atmosphere keeps the earth's radius."""
    altitude = sim["position/h-sl-ft"] * FOOT
    density, sound = air(np.asarray(altitude))
    sim["atmosphere/override/temperature"] = float(sound) ** 2 / (1.4 * 287.05287) * 1.8
    sim["atmosphere/override/density"] = float(density) / (SLUG / FOOT**3)


def flown(sim, start, inputs, dt, frames, outputs) -> dict[str, np.ndarray]:
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


def simulated(system, start, inputs, dt, substeps=8, X=None):
    """The package's own flight; `X` is where the separation point begins, which depends on alpha-dot there."""
    u = {name: jnp.asarray(x) for name, x in inputs.items()}
    begin = jnp.array([float(start.get(name, 0.0)) for name in system.start])
    begin = system.complete_start(begin, {name: x[0] for name, x in u.items()})
    if X is not None:
        begin = begin.at[system.start.index("X")].set(X)
    found = integrate(system, system.state_at_start(begin), u, dt, substeps)
    assert bool(found.inside.all())
    return {name: np.asarray(x) for name, x in found.outputs.items()}
