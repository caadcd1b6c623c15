"""The simulated aircraft in three degrees of freedom: pilot, prescribed turn, and disturbances of the coefficients.

Bank angle and sideslip are prescribed with their rates; the yaw rate follows from them (see `Plant.turn`). Flat earth,
no wind. The equations of motion are those of `physics.equations_of_motion`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bayes_aero.dynamics.system import Row, System
from bayes_aero.effect import Effect, Stage
from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model import pytrees as pytrees
from bayes_aero.model.model import Model
from bayes_aero.physics.atmosphere import GRAVITY, air
from bayes_aero.physics.equations_of_motion import accelerometers, motion_of_aircraft
from bayes_aero.physics.kinematics import euler_rates

SIDE_FORCE = -0.7  # 1/rad, CY per sideslip of a transport; our choice, it sets only the yaw rate in sideslip

CONTROLS = ("elevator", "stabilizer")  # of the pitching moment; the pilot uses the first one with an effect
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
"""Signals that effects may read in the simulation; there is no canard."""


def can_simulate(effect: Effect, signals: frozenset[str] = SIGNALS) -> bool:
    """Whether the simulation has all channels of an effect."""
    return effect.stage <= Stage.AIRCRAFT or set(effect.channels) <= signals


def refuse_unsimulated(effect: Effect, signals: frozenset[str] = SIGNALS) -> None:
    """Raise `InputError` for an effect with channels that the simulation lacks."""
    if not can_simulate(effect, signals):
        lacks = ", ".join(channel for channel in effect.channels if channel not in signals)
        raise InputError(f"the simulated aircraft cannot fly effect {effect.name}: it has no {lacks}; ask for another")


class FlightState(NamedTuple):
    """Airspeed m/s, alpha, theta rad, q rad/s, altitude m, the lagged separation point, and the pilot's trim command,
    rad."""

    airspeed: Any
    alpha: Any
    theta: Any
    q: Any
    altitude: Any
    lagged_X: Any = 1.0
    trim: Any = 0.0


PRESCRIBED = ("thrust", "stabilizer", "rudder", "spoiler_left", "spoiler_right", "dlc_left", "dlc_right", "flap")
TURNING = {"phi": "phi_rate", "phi_rate": "phi_acceleration", "beta": "beta_dot", "beta_dot": "beta_acceleration"}
INPUTS = (
    "time", *PRESCRIBED, *dict.fromkeys((*TURNING, *TURNING.values())), "alpha_led", "command", "dCL", "dCD", "dCm",
)  # fmt: skip
"""Inputs of `Plant`, SI: the stabilizer in addition to the pilot's command; bank and sideslip with their derivatives;
the commanded alpha `alpha_led`, and the pilot's command in addition to feedback and trim; disturbances of the
coefficients.
"""


class Plant(System):
    """The aircraft with its model.

    `gains`: of the feedback on alpha, q and the integral of alpha. The disturbance is multiplied by 1 + `buffet`
    (1 - X). `shares`: of the pilot's command in each of `CONTROLS`.
    """

    model: Model = eqx.field(static=True)
    values: dict[str, Any]
    aircraft: Aircraft
    gains: tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]
    buffet: Float[Array, ""]
    shares: Any = (1.0, 0.0)

    @property
    def states(self) -> tuple[str, ...]:
        """Those of `FlightState`."""
        return FlightState._fields

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        """Derivative of the state, and every signal, from the state and `INPUTS`."""
        state = FlightState(*x)
        s = self._signals(state, u)
        implicit = any("alpha_dot" in effect.channels for effect in self.model.acting)
        now = motion_of_aircraft(lambda rate: self._flow(state, s, rate), s, s, self.aircraft, implicit=implicit)
        rates = {name: now.rates[name] for name in ("airspeed", "alpha", "altitude")} | {"q": now.q_dot}
        rates["theta"] = euler_rates((s["p"], s["q"], s["r"]), s["phi"], s["theta"])[1]
        lag = self.model.lag(self.values) * self.aircraft.chord / state.airspeed
        X_dot = jnp.where(lag > 0.0, (now.flow["static_X"] - state.lagged_X) / jnp.where(lag > 0.0, lag, 1.0), 0.0)
        derivative = FlightState(**rates, lagged_X=X_dot, trim=self.gains[2] * (state.alpha - u["alpha_led"]))
        change = rates | {name: u[rate] for name, rate in TURNING.items()}
        turning = jax.jvp(self.turn, ({name: s[name] for name in change},), (change,))[1]
        now = now._replace(rotation=(turning["p"], now.q_dot, turning["r"]))
        accelerations = accelerometers(now, s, self.aircraft)
        outputs = s | accelerations | {"alpha_dot": rates["alpha"], "q_dot": now.q_dot}
        return jnp.stack(derivative), outputs | {name: now.flow[name] for name in ("X", "CL", "CD", "Cm")}

    def turn(self, s: Mapping[str, Any]) -> dict[str, Any]:
        """Roll, yaw (body axes) and turn rate of a flight with this bank and sideslip, from the kinematic equations and
        the equation of side force.

        The latter is V (r cos alpha - p sin alpha + beta-dot) = g cos theta sin phi + Y/m with Y due to sideslip:
        without sideslip a coordinated turn. It neglects V-dot tan beta; the side force recorded by `ay` does not.
        """
        V, phi, theta, q = s["airspeed"], s["phi"], s["theta"], s["q"]
        side = 0.5 * air(s["altitude"])[0] * V * self.aircraft.wing_area * SIDE_FORCE * s["beta"] / self.aircraft.mass
        needed = GRAVITY * jnp.cos(theta) * jnp.sin(phi) / V + side - s["beta_dot"]
        sin, cos = jnp.sin(s["alpha"]), jnp.cos(s["alpha"])
        lean = jnp.cos(theta) / jnp.cos(phi)
        rolling = q * jnp.tan(phi) * cos + s["phi_rate"] * sin
        psi_dot = (needed + rolling) / (lean * cos + jnp.sin(theta) * sin)
        p, r = s["phi_rate"] - psi_dot * jnp.sin(theta), psi_dot * lean - q * jnp.tan(phi)
        return {"p": p, "r": r, "psi_dot": psi_dot}

    def _signals(self, state: FlightState, u: Row) -> dict[str, Any]:
        """Signals that effects may read, without alpha-dot, by the names of recorded channels; and all of `u`."""
        density, sound = air(state.altitude)
        s = dict(u) | {name: getattr(state, name) for name in ("airspeed", "alpha", "theta", "q", "altitude")}
        feedback = self.gains[0] * (state.alpha - u["alpha_led"]) + self.gains[1] * state.q
        command = u["command"] + feedback + state.trim
        controls = {"elevator": self.shares[0] * command, "stabilizer": u["stabilizer"] + self.shares[1] * command}
        return s | controls | {"density": density, "mach": state.airspeed / sound} | self.turn(s)

    def _flow(self, state: FlightState, s: Mapping[str, Any], alpha_dot: Any) -> dict[str, Any]:
        """Flow by the effects at this alpha-dot with disturbances, and the separation point of steady flow."""
        s = dict(s) | {"alpha_dot": alpha_dot}
        static = self.model.static_separation(self.values, s, self.aircraft)
        X = jnp.where(self.model.lag(self.values) > 0.0, state.lagged_X, static)
        known = self.model.flow(self.values, s, self.aircraft, X=X)
        growth = 1.0 + self.buffet * (1.0 - X)
        return known | {"static_X": static} | {n: known[n] + growth * s[f"d{n}"] for n in ("CL", "CD", "Cm")}
