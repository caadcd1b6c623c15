"""What aircraft under a model of effects share, whatever their degrees of freedom: signals, flow, separation."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from bayes_aero.dynamics.aircraft.gusts import InGusts
from bayes_aero.dynamics.system import Row
from bayes_aero.effect import Stage
from bayes_aero.physics.atmosphere import air

POINTS = ("X", "X_right", "X_left")  # states of separation points: of the whole wing, or of either one
LEAST_LAG = 0.2  # chords: some hundredth of a second, and slow enough for the finest step; less is no lag


class EffectSystem(InGusts):
    """An aircraft with its model at given parameter values; separation points are the last states where they lag.

    `altitude` says whether the altitude is a state. Without a recorded density it must be: density is then ISA's.
    """

    altitude: eqx.AbstractVar[bool]

    @property
    def lagged(self) -> bool:
        """Whether the separation point is a state."""
        return any(e.stage is Stage.LAG for e in self.model.acting)

    @property
    def points(self) -> tuple[str, ...]:
        """States of the separation points that lag: one, or that of the right and that of the left wing."""
        if not self.lagged:
            return ()
        return POINTS[1:] if self.model.two_wings else POINTS[:1]

    @property
    def implicit(self) -> bool:
        """Whether lift depends on alpha-dot at the same instant: directly, or through a separation without lag."""
        before = (Stage.INCIDENCE, Stage.SEPARATION)
        asking = [e.stage for e in self.model.acting if "alpha_dot" in e.channels]
        return any(not self.lagged if stage in before else True for stage in asking)

    @property
    def after(self) -> tuple[str, ...]:
        """States after those of the flight itself: altitude, gusts, and separation points that lag."""
        gusts = tuple(d.state for d in self.model.disturbances)
        return (*(("altitude",) if self.altitude else ()), *gusts, *self.points)

    @abstractmethod
    def named(self, x: Float[Array, " s"]) -> dict[str, Any]:
        """The state by name, with what of the motion it stands for."""

    def settled(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        """Begins with the separation points at their static values."""
        if not self.lagged:
            return x
        s = self.flow_signals(self.begun(x), u)
        static = self.model.static_points(self.values, s | {"alpha_dot": jnp.zeros_like(s["alpha"])}, self.aircraft)
        return x.at[-len(static) :].set(jnp.stack(static))

    def flow_signals(self, x: Float[Array, " s"], u: Row) -> dict[str, Any]:
        """What effects may depend on, of the flow, by the names of the recorded channels."""
        s = dict(u) | {name: value for name, value in self.named(x).items() if name not in POINTS}
        s |= self.model.inflow(self.values, s, self.aircraft)
        if "density" not in s:
            s["density"] = air(s["altitude"])[0]
        if "sound" in u or "altitude" in s:
            s["mach"] = s["airspeed"] / (u["sound"] if "sound" in u else air(s["altitude"])[1])
        s.setdefault("thrust", jnp.zeros_like(s["alpha"]))
        return s

    def flow(self, state: Mapping[str, Any], s: Mapping[str, Any]) -> dict[str, Any]:
        """What the effects build of these signals, with the separation points that lag."""
        lagging = tuple(state[name] for name in self.points)
        X = lagging if len(lagging) > 1 else next(iter(lagging), None)
        return self.model.flow(self.values, s, self.aircraft, X=X)

    def separation_rates(self, state: Mapping[str, Any], s: Mapping[str, Any]) -> list[Any]:
        """Of the separation points that lag, 1/s; `s` has alpha-dot."""
        if not self.lagged:
            return []
        static = self.model.static_points(self.values, s, self.aircraft)
        lag = jnp.maximum(self.model.lag(self.values), LEAST_LAG) * self.aircraft.chord / s["airspeed"]
        return [(there - state[name]) / lag for name, there in zip(self.points, static, strict=True)]
