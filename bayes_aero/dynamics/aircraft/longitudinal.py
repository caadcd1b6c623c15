"""Longitudinal equations of motion with the effects of any model.

States are airspeed, alpha, theta, q, altitude, the gusts of the model and, with a lag, the separation point X. The
lateral motion is prescribed as recorded: p, r, beta, phi and the lateral specific force, which follows from the others
where no accelerometer measures it. Flat earth. In gusts the states airspeed and alpha are over ground; vane, pitot tube
and aerodynamics use those of the flow. A gust is uniform over the aircraft and has no angular velocity.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from bayes_aero.dynamics.aircraft.effect_system import EffectSystem
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.system import Row
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model.model import Model
from bayes_aero.physics.equations_of_motion import accelerometers, motion_of_aircraft
from bayes_aero.physics.kinematics import RATES, euler_rates

ENVELOPE = {"airspeed": (5.0, 1500.0), "alpha": (-1.0, 1.2), "theta": (-1.5, 1.5), "q": (-4.0, 4.0), "X": (-0.5, 1.5)}
LATERAL = ("p", "r", "p_dot", "r_dot", "beta", "phi", "ay")  # zero where they were not recorded


class Longitudinal(EffectSystem):
    """An aircraft with its model at given parameter values; `aircraft` has the corrected constants."""

    model: Model = eqx.field(static=True)
    values: dict[str, Any]
    aircraft: Aircraft
    altitude: bool = eqx.field(static=True, default=True)

    @property
    def states(self) -> tuple[str, ...]:
        """Flight states, gusts, and the separation point with a lag."""
        return (*FLIGHT, *self.after)

    @property
    def envelope(self) -> Mapping[str, tuple[float, float]]:
        """Bounds far beyond any flight."""
        return ENVELOPE

    def named(self, x: Float[Array, " s"]) -> dict[str, Any]:
        """The state by name."""
        return dict(zip(self.states, x, strict=True))

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        """Derivative of the state, and all outputs."""
        state, s = self.named(x), self.flow_signals(x, u)
        decay, gust_rate = self.mean_gust_rates(state, s)
        path = dict.fromkeys((name for name in LATERAL if name != "ay"), jnp.zeros_like(s["alpha"])) | s
        path |= {name: state[name] for name in ("airspeed", "alpha")}
        now = motion_of_aircraft(
            lambda rate: self.flow(state, s | {"alpha_dot": rate + gust_rate}),
            s,
            path,
            self.aircraft,
            implicit=self.implicit,
        )
        known, rates, rate = now.flow, now.rates, now.rates["alpha"] + gust_rate
        pitching = euler_rates(tuple(path[n] for n in RATES), path["phi"], path["theta"])[1]  # type: ignore[arg-type]
        derivative = [rates["airspeed"], rates["alpha"], pitching, now.q_dot]
        if self.altitude:
            derivative.append(rates["altitude"])
        derivative += decay
        derivative += self.separation_rates(state, s | {"alpha_dot": rate})
        outputs = state | {name: s[name] for name in ("airspeed", "alpha")}
        force = accelerometers(now, path, self.aircraft)
        outputs |= {"ax": force["ax"], "az": force["az"], "q_dot": now.q_dot, "alpha_dot": rate}
        return jnp.stack(derivative), outputs | {name: known[name] for name in ("X", "CL", "CD", "Cm")}
