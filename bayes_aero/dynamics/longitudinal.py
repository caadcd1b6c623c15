"""The aircraft flown through recorded inputs: longitudinal equations of motion with the effects of any model.

States airspeed, alpha, theta, q, altitude, the gusts of the model and, where the separation point lags, X. What the
aircraft does laterally is prescribed as recorded: p, r, beta, phi and the lateral specific force, which follows from
the others where no accelerometer gives it. Flat earth. In gusts airspeed and alpha are states over ground; vane, pitot
tube and aerodynamics have those of the flow. A gust is the same over the whole aircraft, and does not turn it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from bayes_aero.dynamics.gusts import InGusts
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.system import Row
from bayes_aero.effect import Stage
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model.model import Model
from bayes_aero.physics.atmosphere import air
from bayes_aero.physics.equations_of_motion import accelerometers, motion_of_aircraft

ENVELOPE = {"airspeed": (5.0, 1500.0), "alpha": (-1.0, 1.2), "theta": (-1.5, 1.5), "q": (-4.0, 4.0), "X": (-0.5, 1.5)}
LATERAL = ("p", "r", "p_dot", "r_dot", "beta", "phi", "ay")  # at rest where they were not recorded
LEAST_LAG = 0.2  # chords: some hundredth of a second, and slow enough for the finest step; less is no lag


class Longitudinal(InGusts):
    """One aircraft with its model at given parameter values; `aircraft` is the actual one.

    `altitude` says whether the altitude is a state. Without a recorded density it must be: density is then ISA's.
    """

    model: Model = eqx.field(static=True)
    values: dict[str, Any]
    aircraft: Aircraft
    altitude: bool = eqx.field(static=True, default=True)

    @property
    def lagged(self) -> bool:
        """Whether the separation point is a state."""
        return any(e.stage is Stage.LAG for e in self.model.acting)

    @property
    def states(self) -> tuple[str, ...]:
        """Flight states, gusts, and X where it lags."""
        gusts = tuple(d.state for d in self.model.disturbances)
        return (*FLIGHT, *(("altitude",) if self.altitude else ()), *gusts, *(("X",) if self.lagged else ()))

    @property
    def envelope(self) -> Mapping[str, tuple[float, float]]:
        """Far beyond any flight: where the equations lose their meaning."""
        return ENVELOPE

    @property
    def implicit(self) -> bool:
        """Whether lift depends on alpha-dot at the same instant: directly, or through a separation without lag."""
        before = (Stage.INCIDENCE, Stage.SEPARATION)
        asking = [e.stage for e in self.model.acting if "alpha_dot" in e.channels]
        return any(not self.lagged if stage in before else True for stage in asking)

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        """Derivative of the state, and everything that can be measured."""
        state, s = self._signals(x, u)
        decay, gust_rate = self.mean_gust_rates(state, s)
        path = dict.fromkeys((name for name in LATERAL if name != "ay"), jnp.zeros_like(s["alpha"])) | s
        path |= {name: state[name] for name in ("airspeed", "alpha")}
        now = motion_of_aircraft(
            lambda rate: self._flow(state, s | {"alpha_dot": rate + gust_rate}),
            s,
            path,
            self.aircraft,
            implicit=self.implicit,
        )
        known, rates, rate = now.flow, now.rates, now.rates["alpha"] + gust_rate
        derivative = [rates["airspeed"], rates["alpha"], rates["theta"], now.q_dot]
        if self.altitude:
            derivative.append(rates["altitude"])
        derivative += decay
        if self.lagged:
            static = self.model.static_separation(self.values, s | {"alpha_dot": rate}, self.aircraft)
            lag = jnp.maximum(self.model.lag(self.values), LEAST_LAG) * self.aircraft.chord / s["airspeed"]
            derivative.append((static - state["X"]) / lag)
        outputs = state | {name: s[name] for name in ("airspeed", "alpha")}
        felt = accelerometers(now, path, self.aircraft)
        outputs |= {"ax": felt["ax"], "az": felt["az"], "q_dot": now.q_dot, "alpha_dot": rate}
        return jnp.stack(derivative), outputs | {name: known[name] for name in ("X", "CL", "CD", "Cm")}

    def settled(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        """Begins with the separation point at its static value."""
        if not self.lagged:
            return x
        _, s = self._signals(x, u)
        static = self.model.static_separation(self.values, s | {"alpha_dot": jnp.zeros_like(s["alpha"])}, self.aircraft)
        return x.at[-1].set(static)

    def flow_signals(self, x: Float[Array, " s"], u: Row) -> dict[str, Any]:
        """What effects may depend on."""
        return self._signals(x, u)[1]

    def _signals(self, x: Float[Array, " s"], u: Row) -> tuple[dict[str, Any], dict[str, Any]]:
        """The state by name, and what effects may depend on, of the flow, by the names of the recorded channels."""
        state = dict(zip(self.states, x, strict=True))
        s = dict(u) | {name: value for name, value in state.items() if name != "X"}
        s |= self.model.inflow(self.values, s, self.aircraft)
        if "density" not in s:
            s["density"] = air(s["altitude"])[0]
        if "sound" in u or "altitude" in s:
            s["mach"] = s["airspeed"] / (u["sound"] if "sound" in u else air(s["altitude"])[1])
        s.setdefault("thrust", jnp.zeros_like(s["alpha"]))
        return state, s

    def _flow(self, state: Mapping[str, Any], s: Mapping[str, Any]) -> dict[str, Any]:
        if self.lagged:
            return self.model.flow(self.values, s, self.aircraft, X=state["X"])
        return self.model.flow(self.values, s, self.aircraft)
