"""JSBSim over a flat earth that does not turn, in the package's air, beside the package's own simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from bayes_aero.dynamics.system import System, integrate
from bayes_aero.export.identified import Identified
from bayes_aero.export.simulators import jsbsim_files
from bayes_aero.physics.aircraft import air

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
