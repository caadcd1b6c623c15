"""Common part of the aircraft models in three and six degrees of freedom: signals, flow, separation."""

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
from bayes_aero.errors import InputError
from bayes_aero.model.model import Model
from bayes_aero.parameter import Role
from bayes_aero.physics.atmosphere import air

POINTS = ("X", "X_right", "X_left")  # states of separation points: of the whole wing, or of either one
MIN_LAG = 0.2  # chords: some hundredth of a second, still resolved by the finest step


class EffectSystem(InGusts):
    """An aircraft with its model at given parameter values; lagged separation points are the last states.

    `altitude`: whether the altitude is a state. It must be one where density was not recorded; density is then that of
    the standard atmosphere.
    """

    altitude: eqx.AbstractVar[bool]

    @property
    def lagged(self) -> bool:
        """Whether the separation point is a state."""
        return any(e.stage is Stage.LAG for e in self.model.acting)

    @property
    def points(self) -> tuple[str, ...]:
        """States of the lagged separation points: one, or one for the right and one for the left wing."""
        if not self.lagged:
            return ()
        return POINTS[1:] if self.model.two_wings else POINTS[:1]

    @property
    def implicit(self) -> bool:
        """Whether lift depends on alpha-dot at the same instant: directly, or through a separation without lag."""
        before = (Stage.INCIDENCE, Stage.SEPARATION)
        stages = [e.stage for e in self.model.acting if "alpha_dot" in e.channels]
        return any(not self.lagged if stage in before else True for stage in stages)

    @property
    def after(self) -> tuple[str, ...]:
        """States after the flight states: altitude, gusts, and lagged separation points."""
        gusts = tuple(d.state for d in self.model.disturbances)
        return (*(("altitude",) if self.altitude else ()), *gusts, *self.points)

    @abstractmethod
    def named(self, x: Float[Array, " s"]) -> dict[str, Any]:
        """The state by name, with the motion that it represents."""

    def complete_start(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        """The initial state with the separation points at their static values."""
        if not self.lagged:
            return x
        s = self.flow_signals(self.state_at_start(x), u)
        static = self.model.static_points(self.values, s | {"alpha_dot": jnp.zeros_like(s["alpha"])}, self.aircraft)
        return x.at[-len(static) :].set(jnp.stack(static))

    def flow_signals(self, x: Float[Array, " s"], u: Row) -> dict[str, Any]:
        """Signals of the flow that effects may read, by the names of the recorded channels."""
        s = dict(u) | {name: value for name, value in self.named(x).items() if name not in POINTS}
        s |= self.model.inflow(self.values, s, self.aircraft)
        if "density" not in s:
            s["density"] = air(s["altitude"])[0]
        if "sound" in u or "altitude" in s:
            s["mach"] = s["airspeed"] / (u["sound"] if "sound" in u else air(s["altitude"])[1])
        s.setdefault("thrust", jnp.zeros_like(s["alpha"]))
        return s

    def flow(self, state: Mapping[str, Any], s: Mapping[str, Any]) -> dict[str, Any]:
        """Flow and coefficients by the effects from these signals, with the lagged separation points."""
        lagging = tuple(state[name] for name in self.points)
        X = lagging if len(lagging) > 1 else next(iter(lagging), None)
        return self.model.flow(self.values, s, self.aircraft, X=X)

    def separation_rates(self, state: Mapping[str, Any], s: Mapping[str, Any]) -> list[Any]:
        """Rates of the lagged separation points, 1/s; `s` contains alpha-dot."""
        if not self.lagged:
            return []
        static = self.model.static_points(self.values, s, self.aircraft)
        lag = jnp.maximum(self.model.lag(self.values), MIN_LAG) * self.aircraft.chord / s["airspeed"]
        return [(value - state[name]) / lag for name, value in zip(self.points, static, strict=True)]


def refuse_lags(model: Model) -> None:
    """Refuse a lag without a time constant.

    Raises:
        InputError: the model has such a lag.
    """
    for effect in model.acting:
        if effect.stage is Stage.LAG and not any(p.role is Role.LAG for p in effect.parameters):
            raise InputError(
                f"effect {effect.name} is a lag of the separation point that cannot be flown: none of its parameters "
                "has the role lag"
            )
