"""The aircraft in flight: forces, moments and the time derivative of its longitudinal state at one instant.

Bank angle and sideslip are prescribed with their rates; the aircraft yaws as they require (see `Plant.turn`). Flat
earth, no wind. Sources: Etkin and Reid, *Dynamics of Flight*, 3rd ed. 1996, ch. 4; Klein and Morelli, *Aircraft System
Identification*, 2006, ch. 3.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bayes_aero.effect import Effect, Stage
from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model import pytrees as pytrees
from bayes_aero.model.model import Model
from bayes_aero.physics.atmosphere import GRAVITY, air
from bayes_aero.physics.forces import pitch_acceleration, specific_force
from bayes_aero.physics.kinematics import Rotation, lever_arm

RATE_LIMIT = 2.0  # rad/s, half-width of the bracket for alpha-dot
BISECTIONS = 45  # 4 rad/s / 2^45 is rounding
SIDE_FORCE = -0.7  # 1/rad, CY per sideslip of a transport; our choice, it only sets how much yaw goes with sideslip

CONTROLS = ("elevator", "stabilizer")  # with which the pilot may pitch, the first that does
SIGNALS = frozenset(
    [
        "time",
        "alpha",
        "alpha_dot",
        "airspeed",
        "altitude",
        "p",
        "q",
        "r",
        "phi",
        "theta",
        "beta",
        "elevator",
        "stabilizer",
        "rudder",
        "spoiler_left",
        "spoiler_right",
        "dlc_left",
        "dlc_right",
        "flap",
        "mach",
        "density",
        "thrust",
    ]
)
"""What the effects of the simulated aircraft may read while it flies; it has no canard."""


def flies(effect: Effect) -> bool:
    """Whether the simulated aircraft has what an effect acts through."""
    return effect.stage < Stage.INCIDENCE or set(effect.channels) <= SIGNALS


def refuse_unflown(effect: Effect) -> None:
    """`InputError` for an effect that the simulated aircraft cannot fly."""
    if not flies(effect):
        lacks = ", ".join(channel for channel in effect.channels if channel not in SIGNALS)
        raise InputError(f"the simulated aircraft cannot fly effect {effect.name}: it has no {lacks}; ask for another")


class FlightState(NamedTuple):
    """V m/s, alpha rad, theta rad, q rad/s, h m, X, and the command that the pilot has trimmed to, rad."""

    V: Float[Array, "*n"]
    alpha: Float[Array, "*n"]
    theta: Float[Array, "*n"]
    q: Float[Array, "*n"]
    h: Float[Array, "*n"]
    X: Float[Array, "*n"]
    trim: Float[Array, "*n"] | float = 0.0


class Inputs(NamedTuple):
    """What is asked for and what disturbs at one instant: alpha rad, thrust N, pitch command rad, CL CD Cm."""

    alpha: Float[Array, ""]
    thrust: Float[Array, ""]
    command: Float[Array, ""]
    disturbance: Float[Array, " 3"]


class Prescribed(NamedTuple):
    """What the aircraft does or carries whatever the forces are: time s, angles rad, their rates and accelerations."""

    time: Float[Array, "*n"]
    phi: Float[Array, "*n"]
    phi_rate: Float[Array, "*n"]
    phi_acceleration: Float[Array, "*n"]
    beta: Float[Array, "*n"]
    beta_rate: Float[Array, "*n"]
    beta_acceleration: Float[Array, "*n"]
    stabilizer: Float[Array, "*n"]
    rudder: Float[Array, "*n"]
    spoiler: Float[Array, "*n"]
    dlc: Float[Array, "*n"]
    flap: Float[Array, "*n"]


class Turn(NamedTuple):
    """Roll and yaw rate (body axes) and the rates of pitch attitude and heading, rad/s."""

    p: Float[Array, "*n"]
    r: Float[Array, "*n"]
    theta_dot: Float[Array, "*n"]
    psi_dot: Float[Array, "*n"]


class Plant(eqx.Module):
    """The aircraft with its model, ready to be evaluated at one instant.

    `gains` are those of the feedback on alpha, q and the integral of alpha; the disturbance grows by `buffet` times
    1 - X. `shares` are those of the pilot's command in each of `CONTROLS`.
    """

    model: Model = eqx.field(static=True)
    values: dict[str, Any]
    aircraft: Aircraft
    gains: tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]
    buffet: Float[Array, ""]
    shares: Any = (1.0, 0.0)

    @property
    def lag(self) -> Any:
        """Lag of the separation point, chords travelled."""
        return self.model.lag(self.values)

    def controls(self, state: FlightState, inputs: Inputs, prescribed: Prescribed) -> dict[str, Float[Array, ""]]:
        """Deflections of `CONTROLS`: the command, and feedback that leads alpha along the one asked for."""
        feedback = self.gains[0] * (state.alpha - inputs.alpha) + self.gains[1] * state.q
        command = inputs.command + feedback + state.trim
        return {
            "elevator": self.shares[0] * command,
            "stabilizer": prescribed.stabilizer + self.shares[1] * command,
        }

    def turn(self, state: FlightState, prescribed: Prescribed) -> Turn:
        """Rates of a flight with this bank angle and sideslip: Euler's equations and the side-force equation.

        The latter is V (r cos alpha - p sin alpha + beta-dot) = g cos theta sin phi + Y/m with Y that of the sideslip:
        without sideslip a coordinated turn. It leaves out V-dot tan beta; the side force recorded by `ay` does not.
        """
        V, phi, q = state.V, prescribed.phi, state.q
        side = 0.5 * air(state.h)[0] * V * self.aircraft.wing_area * SIDE_FORCE * prescribed.beta / self.aircraft.mass
        needed = GRAVITY * jnp.cos(state.theta) * jnp.sin(phi) / V + side - prescribed.beta_rate
        sin, cos = jnp.sin(state.alpha), jnp.cos(state.alpha)
        lean = jnp.cos(state.theta) / jnp.cos(phi)
        rolling = q * jnp.tan(phi) * cos + prescribed.phi_rate * sin
        psi_dot = (needed + rolling) / (lean * cos + jnp.sin(state.theta) * sin)
        theta_dot = (q - psi_dot * jnp.cos(state.theta) * jnp.sin(phi)) / jnp.cos(phi)
        p = prescribed.phi_rate - psi_dot * jnp.sin(state.theta)
        return Turn(p, psi_dot * lean - q * jnp.tan(phi), theta_dot, psi_dot)

    def signals(
        self, state: FlightState, inputs: Inputs, prescribed: Prescribed, alpha_dot: Float[Array, ""]
    ) -> dict[str, Float[Array, ""]]:
        """What effects may depend on, by the names of the recorded channels (`SIGNALS`)."""
        density, sound = air(state.h)
        turn = self.turn(state, prescribed)
        return {
            "time": prescribed.time,
            "alpha": state.alpha,
            "alpha_dot": alpha_dot,
            "airspeed": state.V,
            "altitude": state.h,
            "p": turn.p,
            "q": state.q,
            "r": turn.r,
            "phi": prescribed.phi,
            "theta": state.theta,
            "beta": prescribed.beta,
            **self.controls(state, inputs, prescribed),
            "rudder": prescribed.rudder,
            "spoiler_left": prescribed.spoiler,
            "spoiler_right": prescribed.spoiler,
            "dlc_left": prescribed.dlc,
            "dlc_right": prescribed.dlc,
            "flap": prescribed.flap,
            "mach": state.V / sound,
            "density": density,
            "thrust": inputs.thrust,
        }

    def forces(self, state: FlightState, inputs: Inputs, prescribed: Prescribed, alpha_dot: Float[Array, ""]):
        """CL, CD, Cm about the reference point, and the static separation point."""
        signals = self.signals(state, inputs, prescribed, alpha_dot)
        static = self.model.static_separation(self.values, signals, self.aircraft)
        X = jnp.where(self.lag > 0.0, state.X, static)
        known = self.model.flow(self.values, signals, self.aircraft, X=X)
        noise_growth = 1.0 + self.buffet * (1.0 - X)
        return jnp.stack([known["CL"], known["CD"], known["Cm"]]) + noise_growth * inputs.disturbance, static

    def specific_force(self, state: FlightState, inputs: Inputs, CL: Float[Array, ""], CD: Float[Array, ""]):
        """Aerodynamics and thrust along body x and z over the mass, m/s2."""
        return specific_force(CL, CD, state.alpha, _pressure(state), inputs.thrust, self.aircraft)

    def pitch_acceleration(
        self, state: FlightState, inputs: Inputs, p: Float[Array, ""], r: Float[Array, ""], total: Float[Array, " 3"]
    ) -> Float[Array, ""]:
        """q-dot from the moments of `total` (CL, CD, Cm) and thrust about the CG and from the terms of p and r."""
        CL, CD, Cm = total
        return pitch_acceleration(CL, CD, Cm, state.alpha, _pressure(state), inputs.thrust, p, r, self.aircraft)

    def alpha_dot(self, state: FlightState, inputs: Inputs, prescribed: Prescribed) -> Float[Array, ""]:
        """Solve the equation of alpha-dot, in which lift depends on alpha-dot itself through tau2.

        The right side falls as alpha-dot rises (more separation costs lift while alpha falls), so the root is unique
        and bisection is safe where a fixed-point iteration, of gain 0.9 to 2.7, is not.
        """
        alpha, beta = state.alpha, prescribed.beta
        p, r, *_ = self.turn(state, prescribed)
        sin, cos = jnp.sin(alpha), jnp.cos(alpha)
        weight = GRAVITY * (jnp.cos(state.theta) * jnp.cos(prescribed.phi) * cos + jnp.sin(state.theta) * sin)
        rotation = state.q - jnp.tan(beta) * (p * cos + r * sin)

        def excess(rate):
            (CL, CD, _), _ = self.forces(state, inputs, prescribed, rate)
            fx, fz = self.specific_force(state, inputs, CL, CD)
            return rate - (rotation + (fz * cos - fx * sin + weight) / (state.V * jnp.cos(beta)))

        def halve(_, bracket):
            low, high = bracket
            middle = 0.5 * (low + high)
            above = excess(middle) > 0.0
            return jnp.where(above, low, middle), jnp.where(above, middle, high)

        limit = jnp.full_like(state.V, RATE_LIMIT)
        low, high = jax.lax.fori_loop(0, BISECTIONS, halve, (-limit, limit))
        return 0.5 * (low + high)

    def motion(self, state: FlightState, inputs: Inputs, prescribed: Prescribed) -> tuple[FlightState, dict[str, Any]]:
        """Time derivatives of the state, and the outputs at this instant."""
        a, V, theta, q = self.aircraft, state.V, state.theta, state.q
        phi, beta = prescribed.phi, prescribed.beta
        sin, cos = jnp.sin(state.alpha), jnp.cos(state.alpha)
        rate = self.alpha_dot(state, inputs, prescribed)
        total, static = self.forces(state, inputs, prescribed, rate)
        fx, fz = self.specific_force(state, inputs, total[0], total[1])
        p, r, theta_dot, psi_dot = self.turn(state, prescribed)
        q_dot = self.pitch_acceleration(state, inputs, p, r, total)
        u, v, w = V * cos * jnp.cos(beta), V * jnp.sin(beta), V * sin * jnp.cos(beta)
        down = GRAVITY * jnp.cos(theta) * jnp.cos(phi)
        in_plane = v * (r * cos - p * sin) + fx * cos + fz * sin - GRAVITY * jnp.sin(theta) * cos + down * sin
        V_dot = in_plane / jnp.cos(beta) + V * jnp.tan(beta) * prescribed.beta_rate
        climb = u * jnp.sin(theta) - (v * jnp.sin(phi) + w * jnp.cos(phi)) * jnp.cos(theta)
        time_constant = jnp.where(self.lag > 0.0, self.lag * a.chord / V, 1.0)
        X_dot = jnp.where(self.lag > 0.0, (static - state.X) / time_constant, 0.0)

        derivative = FlightState(
            V_dot, rate, theta_dot, q_dot, climb, X_dot, self.gains[2] * (state.alpha - inputs.alpha)
        )
        none = Prescribed(*(jnp.zeros_like(x) for x in prescribed))
        changes = none._replace(
            phi=prescribed.phi_rate,
            phi_rate=prescribed.phi_acceleration,
            beta=prescribed.beta_rate,
            beta_rate=prescribed.beta_acceleration,
        )
        _, change = jax.jvp(self.turn, (state, prescribed), (derivative, changes))
        rotation = Rotation(p, q, r, change.p, q_dot, change.r)
        arm_x, arm_y, arm_z = lever_arm(rotation, a.accelerometer)
        v_dot = V_dot * jnp.sin(beta) + V * jnp.cos(beta) * prescribed.beta_rate
        side = v_dot - p * w + r * u - GRAVITY * jnp.cos(theta) * jnp.sin(phi)
        outputs = {
            "ax": fx + arm_x,
            "ay": side + arm_y,
            "az": fz + arm_z,
            "p": p,
            "r": r,
            "psi_dot": psi_dot,
            **self.controls(state, inputs, prescribed),
            "alpha_dot": rate,
            "q_dot": q_dot,
            "X": jnp.where(self.lag > 0.0, state.X, static),
            "CL": total[0],
            "CD": total[1],
            "Cm": total[2],
        }
        return derivative, outputs


def _pressure(state: FlightState) -> Float[Array, "*n"]:
    """Dynamic pressure, Pa."""
    return 0.5 * air(state.h)[0] * state.V**2
