"""Simulation of a model: longitudinal equations of motion, with the effects of the coefficient fit.

Bank angle and sideslip are prescribed (see `plant`). Flat earth, no wind.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.simulated.plant import FlightState, Plant
from bayes_aero.dynamics.simulated.trim import lead
from bayes_aero.dynamics.system import step
from bayes_aero.dynamics.tangent import later
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model.model import Model
from bayes_aero.physics.filters import differentiate
from bayes_aero.units import number

__all__ = ["FlightState", "Pilot", "fly", "fly_together", "outside"]


class Pilot(NamedTuple):
    """Commands of a simulated flight: alpha follows `alpha` (rad) by trim + gains x errors + `excitation` (rad).

    `thrust` in N; `disturbance` (n, 3) times 1 + `buffet` (1 - X) is added to CL, CD, Cm. Bank `phi` and sideslip
    `beta` (rad) are prescribed and must be smooth, because they are differentiated. `stabilizer`, `rudder`, `aileron`,
    `spoiler`, `dlc`, `flap` (rad) act only through effects. `trim_gain` (1/s): feedback on the integral of alpha, as by
    trimming. `uneven`: the left engine's thrust less the right one's over their sum; it acts only on a rigid body.
    Arrays have one row per sample.
    """

    alpha: Float[Any, " n"]
    thrust: Float[Any, " n"]
    excitation: Float[Any, " n"] | float = 0.0
    disturbance: Float[Any, "n 3"] | float = 0.0
    alpha_gain: Float[Any, ""] | float = 0.7
    rate_gain: Float[Any, ""] | float = 0.2
    phi: Float[Any, " n"] | float = 0.0
    beta: Float[Any, " n"] | float = 0.0
    stabilizer: Float[Any, " n"] | float = 0.0
    rudder: Float[Any, " n"] | float = 0.0
    spoiler: Float[Any, " n"] | float = 0.0
    dlc: Float[Any, " n"] | float = 0.0
    flap: Float[Any, " n"] | float = 0.0
    buffet: Float[Any, ""] | float = 0.0
    trim_gain: Float[Any, ""] | float = 0.0
    aileron: Float[Any, " n"] | float = 0.0
    uneven: Float[Any, " n"] | float = 0.0


def fly(
    model: Model, values: Mapping[str, Any], aircraft: Aircraft, pilot: Pilot, start: FlightState, dt: float
) -> dict[str, Float[Array, " n"]]:
    """All signals of the flight by the names of recorded channels, and CL, CD, Cm, X; (n,), SI.

    Inputs are linear between samples. Held inputs would lag their record by half a sample, which a diagnosis finds as a
    delay of the elevator.
    """
    numbers, pilot, start = jax.tree.map(lambda x: jnp.asarray(x, float), (dict(values), pilot, start))
    return _fly_one(model, numbers, aircraft, pilot, start, jnp.asarray(dt))


def fly_together(
    model: Model,
    values: Mapping[str, Any],
    aircraft: Aircraft,
    pilots: Sequence[Pilot],
    starts: Sequence[FlightState],
    dt: float,
) -> list[dict[str, np.ndarray]]:
    """As `fly`, for several flights of one length."""
    numbers = {name: jnp.asarray(x, float) for name, x in values.items()}
    rows = [jax.tree.map(lambda *x: np.stack([np.asarray(y, float) for y in x]), *row) for row in (pilots, starts)]
    flights = {
        name: np.asarray(x) for name, x in _fly_several(model, numbers, aircraft, *rows, jnp.asarray(dt)).items()
    }
    return [{name: x[k] for name, x in flights.items()} for k in range(len(pilots))]


def _fly(model: Model, values: dict[str, Any], aircraft: Aircraft, pilot: Pilot, start: FlightState, dt: Any):
    shares, command = lead(model, values, aircraft, pilot.alpha, start.airspeed, start.altitude)
    gains = (pilot.alpha_gain, pilot.rate_gain, pilot.trim_gain)
    plant = Plant(model, values, aircraft, gains, pilot.buffet, shares)  # type: ignore[arg-type]
    inputs = _inputs(pilot, command, dt)
    _, found = jax.lax.scan(lambda x, row: step(plant, x, *row, dt), jnp.stack(start), (inputs, later(inputs)))
    turn = found["psi_dot"]
    return found | {"psi": jnp.cumsum(jnp.pad(0.5 * dt * (turn[1:] + turn[:-1]), (1, 0)))}


_fly_one = eqx.filter_jit(_fly)
_fly_several = eqx.filter_jit(eqx.filter_vmap(_fly, in_axes=(None, None, None, 0, 0, None)))


def outside(flight: Mapping[str, np.ndarray], envelope: Mapping[str, tuple[float, float]]) -> str | None:
    """The first channel outside its range, in words; None where all are inside."""
    for name, (lower, upper) in envelope.items():
        x = flight[name]
        if not (np.all(np.isfinite(x)) and x.min() >= lower and x.max() <= upper):
            return f"{name} {number(x.min())} to {number(x.max())} (allowed {number(lower)} to {number(upper)})"
    return None


def _inputs(pilot: Pilot, command: Float[Array, " n"], dt: Any) -> dict[str, Float[Array, " n"]]:
    """Inputs of `Plant`."""
    n = pilot.alpha.shape[0]
    disturbance = jnp.broadcast_to(pilot.disturbance, (n, 3)).T
    pilot = Pilot(*(jnp.broadcast_to(x, n) if jnp.ndim(x) == 0 else x for x in pilot))
    phi_rate, beta_dot = differentiate(pilot.phi, dt), differentiate(pilot.beta, dt)
    angles = {"phi": pilot.phi, "phi_rate": phi_rate, "phi_acceleration": differentiate(phi_rate, dt)}
    angles |= {"beta": pilot.beta, "beta_dot": beta_dot, "beta_acceleration": differentiate(beta_dot, dt)}
    surfaces = {name: getattr(pilot, name) for name in ("stabilizer", "rudder", "flap")}
    surfaces |= {f"{name}_{side}": getattr(pilot, name) for name in ("spoiler", "dlc") for side in ("left", "right")}
    disturbed = dict(zip(("dCL", "dCD", "dCm"), disturbance, strict=True))
    led = {"alpha_led": pilot.alpha, "command": command + pilot.excitation, "thrust": pilot.thrust}
    return {"time": jnp.arange(n) * dt} | angles | surfaces | disturbed | led
