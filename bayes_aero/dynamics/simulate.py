"""Fly a model: longitudinal equations of motion, with the same effects that the coefficient fit uses.

States V, alpha, theta, q, h and, with a lag, the separation point X; bank angle and sideslip are prescribed
(see `plant`). Flat earth, no wind.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.plant import FlightState, Inputs, Plant, Prescribed
from bayes_aero.dynamics.trim import lead
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model.model import Model
from bayes_aero.physics.filters import differentiate

__all__ = ["FlightState", "Pilot", "fly"]

RUNGE_KUTTA = np.array([[0.0, 1.0], [0.5, 2.0], [0.5, 2.0], [1.0, 1.0]])  # share of the step, weight x 6
"""The classical fourth-order method: each stage starts from the one before it."""


class Pilot(NamedTuple):
    """What is flown: alpha is led along `alpha` (rad) by a command of trim + gains x errors + `excitation` (rad).

    `thrust` in N; `disturbance` is added to CL, CD, Cm, 1 + `buffet` (1 - X) times. Bank angle `phi` and sideslip
    `beta` (rad) are flown exactly, so they must be smooth: they are differentiated. `stabilizer`, `rudder`, `spoiler`,
    `dlc`, `flap` (rad) only reach the effects. `trim_gain` (1/s) leads alpha by its integral too, as a pilot who trims.
    Arrays have one row per sample.
    """

    alpha: Float[Array, " n"]
    thrust: Float[Array, " n"]
    excitation: Float[Array, " n"]
    disturbance: Float[Array, "n 3"]
    alpha_gain: Float[Array, ""]
    rate_gain: Float[Array, ""]
    phi: Float[Array, " n"] | float = 0.0
    beta: Float[Array, " n"] | float = 0.0
    stabilizer: Float[Array, " n"] | float = 0.0
    rudder: Float[Array, " n"] | float = 0.0
    spoiler: Float[Array, " n"] | float = 0.0
    dlc: Float[Array, " n"] | float = 0.0
    flap: Float[Array, " n"] | float = 0.0
    buffet: Float[Array, ""] | float = 0.0
    trim_gain: Float[Array, ""] | float = 0.0


@eqx.filter_jit
def fly(
    model: Model,
    values: Mapping[str, Float[Array, ""]],
    aircraft: Aircraft,
    pilot: Pilot,
    start: FlightState,
    dt: float | Float[Array, ""],
) -> tuple[FlightState, dict[str, Float[Array, " n"]]]:
    """States and outputs at every sample; fourth-order Runge-Kutta at the sample time.

    Whatever comes from outside is linear between samples. Held over a step it would lag its own record by half a step,
    which a critic of the flight finds as a delay of the elevator.
    """
    gains = (pilot.alpha_gain, pilot.rate_gain, jnp.asarray(pilot.trim_gain))
    start = jax.tree.map(jnp.asarray, start)
    shares, command = lead(model, values, aircraft, pilot.alpha, start.V, start.h)
    plant = Plant(model, dict(values), aircraft, gains, jnp.asarray(pilot.buffet), shares)

    def stage(carry, tableau, state: FlightState, now: tuple[Inputs, Prescribed], then: tuple[Inputs, Prescribed]):
        slope, total = carry
        share, weight = tableau
        here = jax.tree.map(lambda x, k: x + share * dt * k, state, slope)
        slope, outputs = plant.motion(here, *jax.tree.map(lambda a, b: (1.0 - share) * a + share * b, now, then))
        return (slope, jax.tree.map(lambda s, k: s + weight * k, total, slope)), outputs

    def step(state: FlightState, row):
        rest = jax.tree.map(jnp.zeros_like, state)
        (_, total), outputs = jax.lax.scan(lambda c, t: stage(c, t, state, *row), (rest, rest), RUNGE_KUTTA)
        following = jax.tree.map(lambda x, k: x + dt * k / 6.0, state, total)
        return following, (state, {key: value[0] for key, value in outputs.items()})

    now = (Inputs(pilot.alpha, pilot.thrust, command + pilot.excitation, pilot.disturbance), _prescribed(pilot, dt))
    then = jax.tree.map(lambda x: jnp.concatenate([x[1:], x[-1:]]), now)
    _, (states, outputs) = jax.lax.scan(step, start, (now, then))
    return states, outputs


def _prescribed(pilot: Pilot, dt: Any) -> Prescribed:
    def row(x: Any) -> Float[Array, " n"]:
        return jnp.broadcast_to(jnp.asarray(x, dtype=pilot.alpha.dtype), pilot.alpha.shape)

    phi, beta, time = row(pilot.phi), row(pilot.beta), jnp.arange(pilot.alpha.shape[0]) * dt
    phi_rate, beta_rate = differentiate(phi, dt), differentiate(beta, dt)
    motion = (phi, phi_rate, differentiate(phi_rate, dt), beta, beta_rate, differentiate(beta_rate, dt))
    surfaces = (row(x) for x in (pilot.stabilizer, pilot.rudder, pilot.spoiler, pilot.dlc, pilot.flap))
    return Prescribed(time, *motion, *surfaces)
