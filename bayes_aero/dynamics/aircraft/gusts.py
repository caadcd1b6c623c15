"""Systems in gusts: states over ground, and the flow at vane, pitot tube and wing."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bayes_aero.dynamics.system import Row, System
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model.model import Model

FLOW = ("airspeed", "alpha", "beta")  # changed by gusts; as states they are over ground


class InGusts(System):
    """Gusts of `model` are among the states, as first-order processes; parameter values are `values`."""

    model: eqx.AbstractVar[Model]
    values: eqx.AbstractVar[dict[str, Any]]
    aircraft: eqx.AbstractVar[Aircraft]

    @abstractmethod
    def flow_signals(self, x: Float[Array, " s"], u: Row) -> dict[str, Any]:
        """States and inputs by name; `FLOW` of the flow, not over ground."""

    @property
    def state_outputs(self) -> tuple[str, ...]:
        """All states; in gusts all but `FLOW`, because vane and pitot tube measure the flow."""
        return tuple(name for name in self.states if not (self.model.disturbances and name in FLOW))

    def noise_density(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        """Of the gusts: twice their variance over their correlation time."""
        power = {d.state: 2.0 * jnp.square(self.values[d.intensity]) for d in self.model.disturbances}
        return self.decay(x, u) * jnp.stack([jnp.asarray(power.get(name, 0.0)) for name in self.states])

    def decay(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        """Of the gusts: one over their correlation time."""
        s = self.flow_signals(x, u)
        rate = {d.state: d.rate(self.values, s, self.aircraft) for d in self.model.disturbances}
        return jnp.stack([rate.get(name, jnp.zeros_like(x[0])) for name in self.states])

    def start_covariance(self, x: Float[Array, " s"], u: Row, deviation: Float[Array, " s"]) -> Float[Array, "s s"]:
        """Gusts start in their stationary distribution; the flow was measured, the motion over ground was not."""
        intensity = {d.state: self.values[d.intensity] for d in self.model.disturbances}
        spread = jnp.stack([intensity.get(name, y) for name, y in zip(self.states, deviation, strict=True)])
        own = tuple(name for name in FLOW if name in self.states)
        places = jnp.array([self.states.index(name) for name in own])

        def flow(x):
            s = self.flow_signals(x, u)
            return x.at[places].set(jnp.stack([s[name] for name in own]))

        factor = jnp.linalg.solve(jax.jacfwd(flow)(x), jnp.diag(spread))
        return factor @ factor.T

    def mean_gust_rates(self, state: Mapping[str, Any], s: Mapping[str, Any]) -> tuple[list[Any], Any]:
        """Mean rates of the gust states, and the rate of alpha due to them, without their white noise.

        `state` is over ground, `s` contains the flow.
        """
        gusts = {d.state: state[d.state] for d in self.model.disturbances}
        decay = {d.state: -d.rate(self.values, s, self.aircraft) * state[d.state] for d in self.model.disturbances}
        over_ground = dict(s) | {name: state[name] for name in FLOW if name in state}
        alpha = lambda g: self.model.inflow(self.values, over_ground | g, self.aircraft)["alpha"]  # noqa: E731
        return list(decay.values()), jax.jvp(alpha, (gusts,), (decay,))[1] if gusts else jnp.zeros_like(s["alpha"])
