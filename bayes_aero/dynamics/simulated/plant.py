"""The simulated aircraft: what a pilot does to it, the turn that it is made to fly, and what disturbs its coefficients.

Bank angle and sideslip are prescribed with their rates; the aircraft yaws as they require (see `Plant.turn`). Flat
earth, no wind. The equations of motion are those of `physics.equations_of_motion`.
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


def flies(effect: Effect, signals: frozenset[str] = SIGNALS) -> bool:
    """Whether the simulated aircraft has what an effect acts through."""
    return effect.stage <= Stage.AIRCRAFT or set(effect.channels) <= signals


def refuse_unflown(effect: Effect, signals: frozenset[str] = SIGNALS) -> None:
    """`InputError` for an effect that the simulated aircraft cannot fly."""
    if not flies(effect, signals):
        lacks = ", ".join(channel for channel in effect.channels if channel not in signals)
        raise InputError(f"the simulated aircraft cannot fly effect {effect.name}: it has no {lacks}; ask for another")


class FlightState(NamedTuple):
    """Airspeed m/s, alpha, theta rad, q rad/s, altitude m, the separation point that lags if it does, and the command
    that the pilot has trimmed to, rad."""

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
"""Of `Plant`, SI: the stabilizer beside the pilot's command; bank and sideslip with their derivatives; the alpha that
the pilot is to lead along, and his command beside feedback and trim; the disturbances of the coefficients."""


class Plant(System):
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
        now = now._replace(turning=(turning["p"], now.q_dot, turning["r"]))
        felt = accelerometers(now, s, self.aircraft)
        outputs = s | felt | {"alpha_dot": rates["alpha"], "q_dot": now.q_dot}
        return jnp.stack(derivative), outputs | {name: now.flow[name] for name in ("X", "CL", "CD", "Cm")}

    def turn(self, s: Mapping[str, Any]) -> dict[str, Any]:
        """Roll, yaw (body axes) and turn rate of a flight with this bank and sideslip: Euler's and the side force's.

        The latter is V (r cos alpha - p sin alpha + beta-dot) = g cos theta sin phi + Y/m with Y that of the sideslip:
        without sideslip a coordinated turn. It leaves out V-dot tan beta; the side force recorded by `ay` does not.
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
        """What effects may depend on but alpha-dot, by the names of the recorded channels, and all of `u`."""
        density, sound = air(state.altitude)
        s = dict(u) | {name: getattr(state, name) for name in ("airspeed", "alpha", "theta", "q", "altitude")}
        feedback = self.gains[0] * (state.alpha - u["alpha_led"]) + self.gains[1] * state.q
        command = u["command"] + feedback + state.trim
        controls = {"elevator": self.shares[0] * command, "stabilizer": u["stabilizer"] + self.shares[1] * command}
        return s | controls | {"density": density, "mach": state.airspeed / sound} | self.turn(s)

    def _flow(self, state: FlightState, s: Mapping[str, Any], alpha_dot: Any) -> dict[str, Any]:
        """What the effects build at this alpha-dot, disturbed, and the separation point that steady flow would have."""
        s = dict(s) | {"alpha_dot": alpha_dot}
        static = self.model.static_separation(self.values, s, self.aircraft)
        X = jnp.where(self.model.lag(self.values) > 0.0, state.lagged_X, static)
        known = self.model.flow(self.values, s, self.aircraft, X=X)
        growth = 1.0 + self.buffet * (1.0 - X)
        return known | {"static_X": static} | {n: known[n] + growth * s[f"d{n}"] for n in ("CL", "CD", "Cm")}
