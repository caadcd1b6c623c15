"""Fly a model: symmetric equations of motion, with the same effects that the coefficient fit uses.

States V, alpha, theta, q, h and, with a lag tau1 > 0, the separation point X. Flat earth, no wind, wings level.
Source: Etkin and Reid, *Dynamics of Flight*, 3rd ed. 1996, ch. 4, with lift and drag in stability axes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model.model import Model
from bayes_aero.physics.atmosphere import GRAVITY, air
from bayes_aero.physics.frames import body_from_lift_drag
from bayes_aero.physics.kinematics import Rotation, lever_arm

RATE_LIMIT = 2.0  # rad/s, half-width of the bracket for alpha-dot
BISECTIONS = 45  # 4 rad/s / 2^45 is rounding


class State(NamedTuple):
    """V m/s, alpha rad, theta rad, q rad/s, h m, X."""

    V: Float[Array, "*n"]
    alpha: Float[Array, "*n"]
    theta: Float[Array, "*n"]
    q: Float[Array, "*n"]
    h: Float[Array, "*n"]
    X: Float[Array, "*n"]


class Pilot(NamedTuple):
    """What is flown: alpha is led along `alpha` (rad) by elevator = trim + gains x errors, plus `excitation` (rad).

    `thrust` in N; `disturbance` is added to CL, CD, Cm. Arrays have one row per sample.
    """

    alpha: Float[Array, " n"]
    thrust: Float[Array, " n"]
    excitation: Float[Array, " n"]
    disturbance: Float[Array, "n 3"]
    alpha_gain: Float[Array, ""]
    rate_gain: Float[Array, ""]


class _Inputs(NamedTuple):
    alpha: Float[Array, ""]
    thrust: Float[Array, ""]
    excitation: Float[Array, ""]
    disturbance: Float[Array, " 3"]


class _Plant(eqx.Module):
    """The aircraft with its model, ready to be evaluated at one instant."""

    model: Model = eqx.field(static=True)
    values: dict[str, Float[Array, ""]]
    aircraft: Aircraft
    gains: tuple[Float[Array, ""], Float[Array, ""]]

    @property
    def lag(self):
        return self.values.get("tau1", 0.0)

    def elevator(self, state: State, inputs: _Inputs):
        """Trim for the commanded alpha in attached flow, and feedback that leads alpha along it."""
        v = self.values
        trim = -(v.get("Cm0", 0.0) + v.get("Cma", 0.0) * inputs.alpha) / v["Cmde"]
        return trim + self.gains[0] * (state.alpha - inputs.alpha) + self.gains[1] * state.q + inputs.excitation

    def signals(self, state: State, inputs: _Inputs, alpha_dot):
        density, sound = air(state.h)
        return {
            "alpha": state.alpha,
            "alpha_dot": alpha_dot,
            "airspeed": state.V,
            "q": state.q,
            "elevator": self.elevator(state, inputs),
            "mach": state.V / sound,
            "density": density,
            "thrust": inputs.thrust,
            "beta": jnp.zeros_like(state.V),
        }

    def forces(self, state: State, inputs: _Inputs, alpha_dot):
        """CL, CD, Cm about the reference point, and the static separation point."""
        signals = self.signals(state, inputs, alpha_dot)
        static = self.model.static_separation(self.values, signals, self.aircraft)
        X = jnp.where(self.lag > 0.0, state.X, static)
        known = self.model.flow(self.values, signals, self.aircraft, X=X)
        return jnp.stack([known["CL"], known["CD"], known["Cm"]]) + inputs.disturbance, static

    def alpha_dot(self, state: State, inputs: _Inputs):
        """Solve alpha_dot = q - (L + T sin)/(m V) + g cos(gamma)/V, in which lift depends on alpha_dot through tau2.

        The right side falls as alpha_dot rises (more separation costs lift while alpha falls), so the root is unique
        and bisection is safe where a fixed-point iteration, of gain 0.9 to 2.7, is not.
        """

        def excess(rate):
            (CL, _, _), _ = self.forces(state, inputs, rate)
            qbar_S = 0.5 * air(state.h)[0] * state.V**2 * self.aircraft.wing_area
            push = inputs.thrust * jnp.sin(state.alpha + self.aircraft.engine_inclination)
            turn = GRAVITY * jnp.cos(state.theta - state.alpha) / state.V
            return rate - (state.q - (qbar_S * CL + push) / (self.aircraft.mass * state.V) + turn)

        def halve(_, bracket):
            low, high = bracket
            middle = 0.5 * (low + high)
            above = excess(middle) > 0.0
            return jnp.where(above, low, middle), jnp.where(above, middle, high)

        limit = jnp.full_like(state.V, RATE_LIMIT)
        low, high = jax.lax.fori_loop(0, BISECTIONS, halve, (-limit, limit))
        return 0.5 * (low + high)

    def motion(self, state: State, inputs: _Inputs):
        """Time derivatives of the state, and the outputs at this instant."""
        a = self.aircraft
        rate = self.alpha_dot(state, inputs)
        (CL, CD, Cm), static = self.forces(state, inputs, rate)
        CX, CZ = body_from_lift_drag(CL, CD, state.alpha)
        qbar_S = 0.5 * air(state.h)[0] * state.V**2 * a.wing_area
        thrust_x = inputs.thrust * jnp.cos(a.engine_inclination)
        thrust_z = -inputs.thrust * jnp.sin(a.engine_inclination)
        Cm_cg = Cm + CX * a.reference_point[2] / a.chord - CZ * a.reference_point[0] / a.chord
        q_dot = (qbar_S * a.chord * Cm_cg + thrust_x * a.engine[2] - thrust_z * a.engine[0]) / a.Iy
        climb = state.theta - state.alpha
        along = inputs.thrust * jnp.cos(state.alpha + a.engine_inclination) - qbar_S * CD
        time_constant = jnp.where(self.lag > 0.0, self.lag * a.chord / state.V, 1.0)
        X_dot = jnp.where(self.lag > 0.0, (static - state.X) / time_constant, 0.0)
        zero = jnp.zeros_like(state.V)
        rotation = Rotation(zero, state.q, zero, zero, q_dot, zero)
        arm_x, _, arm_z = lever_arm(rotation, a.accelerometer)
        outputs = {
            "ax": (qbar_S * CX + thrust_x) / a.mass + arm_x,
            "az": (qbar_S * CZ + thrust_z) / a.mass + arm_z,
            "elevator": self.elevator(state, inputs),
            "alpha_dot": rate,
            "X": jnp.where(self.lag > 0.0, state.X, static),
            "CL": CL,
            "CD": CD,
            "Cm": Cm,
        }
        derivative = State(
            along / a.mass - GRAVITY * jnp.sin(climb), rate, state.q, q_dot, state.V * jnp.sin(climb), X_dot
        )
        return derivative, outputs


@eqx.filter_jit
def fly(
    model: Model,
    values: Mapping[str, Float[Array, ""]],
    aircraft: Aircraft,
    pilot: Pilot,
    start: State,
    dt: float | Float[Array, ""],
) -> tuple[State, dict[str, Float[Array, " n"]]]:
    """States and outputs at every sample; fourth-order Runge-Kutta at the sample time, inputs held over a step."""
    plant = _Plant(model, dict(values), aircraft, (pilot.alpha_gain, pilot.rate_gain))

    def step(state: State, row):
        inputs = _Inputs(*row)

        def move(rate: State, h) -> State:
            return State(*(x + h * r for x, r in zip(state, rate, strict=True)))

        k1, outputs = plant.motion(state, inputs)
        k2, _ = plant.motion(move(k1, dt / 2), inputs)
        k3, _ = plant.motion(move(k2, dt / 2), inputs)
        k4, _ = plant.motion(move(k3, dt), inputs)
        mean = State(*((a + 2 * b + 2 * c + d) / 6 for a, b, c, d in zip(k1, k2, k3, k4, strict=True)))
        return move(mean, dt), (state, outputs)

    rows = (pilot.alpha, pilot.thrust, pilot.excitation, pilot.disturbance)
    _, (states, outputs) = jax.lax.scan(step, start, rows)
    return states, outputs
