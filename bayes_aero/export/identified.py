"""What is exported: a model of effects with its values, and its coefficients as one program."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayes_aero.dynamics.aircraft.effect_system import MIN_LAG, POINTS
from bayes_aero.effect import Effect, Stage
from bayes_aero.errors import InputError
from bayes_aero.export.program import Program
from bayes_aero.export.translate import translated
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.model.model import Model

LEAST = {"airspeed": 1.0, "density": 1e-3}
"""Signals that models divide by (q c/V, thrust over dynamic pressure), and what stands for them below it: m/s, kg/m3.

A simulator may be at rest; forces vanish there with the dynamic pressure.
"""


@dataclass(frozen=True)
class Draws:
    """Values (m, k) of the parameters `names` that are uncertain; `origin` says what they were drawn from."""

    names: tuple[str, ...]
    values: Float[np.ndarray, "m k"]
    origin: str


@dataclass(frozen=True)
class Identified:
    """A model of effects with values of its parameters, SI and radians.

    `aircraft` is the card's, which the effects of stage AIRCRAFT change. `flown` has the lowest and the highest value
    of each channel in the records. `sources` say where the values come from.
    """

    name: str
    title: str
    model: Model
    aircraft: Aircraft
    values: Mapping[str, float]
    sources: tuple[str, ...]
    flown: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    draws: Draws | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """All parameters of the model."""
        return self.model.names

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """By parameter."""
        return {p.name: p.bounds for p in self.model.parameters}

    @cached_property
    def exported(self) -> Model:
        """The model without effects of sensors, of the record and of disturbed air."""
        kept = tuple(_scoped(e) for e in self.model.effects if _is_of_aircraft(e))
        owned = {p.name for e in kept for p in e.parameters}
        parameters = tuple(p for p in self.model.parameters if p.name in owned)
        fixed = tuple((name, x) for name, x in self.model.fixed if name in owned)
        return replace(self.model, effects=kept, parameters=parameters, fixed=fixed)

    @property
    def left_out(self) -> tuple[str, ...]:
        """A sentence on each effect of the model that is not exported."""
        return tuple(_why_not(e, self.values) for e in self.model.acting if not _is_of_aircraft(e))

    @cached_property
    def actual_aircraft(self) -> Aircraft:
        """The aircraft with the effects that act on it."""
        changed = self.exported.actual_aircraft(self.values, self.aircraft)
        return Aircraft(**{f.name: _plain(getattr(changed, f.name)) for f in fields(changed)})

    @property
    def separates(self) -> bool:
        """Whether the model has a separation point."""
        return any(e.stage in (Stage.SEPARATION, Stage.LAG) for e in self.exported.acting)

    @property
    def lagged(self) -> bool:
        """Whether the separation point is a state."""
        return any(e.stage is Stage.LAG for e in self.exported.acting)

    @property
    def points(self) -> tuple[str, ...]:
        """Separation points: of the whole wing, or of the right and the left one."""
        if not self.separates:
            return ()
        return POINTS[1:] if self.exported.two_wings else POINTS[:1]

    @cached_property
    def signals(self) -> tuple[str, ...]:
        """Channels that the effects read."""
        asked = (c for e in self.exported.acting for c in e.channels)
        return tuple(dict.fromkeys(("alpha", *(("airspeed",) if self.lagged else ()), *asked)))

    @cached_property
    def program(self) -> Program:
        """Coefficients and separation points from signals, states, parameters and constants of the aircraft.

        A lagged point X is an input `state.X`; the outputs then are its static value `X_static` and `lag`, the time
        constant in s with which it follows.
        """
        return self.traced(self._outputs, self.points if self.lagged else ())

    @property
    def inputs(self) -> dict[str, float]:
        """Values of the parameters and of the aircraft's constants, as inputs of a program."""
        found = {f"parameter.{name}": float(x) for name, x in self.values.items()}
        for f in fields(self.aircraft):
            value = getattr(self.aircraft, f.name)
            if isinstance(value, tuple):
                found |= {f"aircraft.{f.name}.{i}": float(x) for i, x in enumerate(value)}
            elif value is not None:
                found[f"aircraft.{f.name}"] = float(value)
        return found

    def traced(self, function: Callable[..., Mapping[str, Any]], states: Sequence[str]) -> Program:
        """A function of values, signals, aircraft and states, each by name, as a program."""
        first = {f"signal.{name}": _example(name) for name in self.signals} | {f"state.{name}": 0.5 for name in states}

        def outputs(given: Mapping[str, Any]) -> Mapping[str, Any]:
            values = {name: given[f"parameter.{name}"] for name in self.values}
            signals = {name: _floored(name, given[f"signal.{name}"]) for name in self.signals}
            aircraft = self.exported.actual_aircraft(values, _aircraft(self.aircraft, given))
            return function(values, signals, aircraft, {name: given[f"state.{name}"] for name in states})

        program = translated(outputs, self.inputs | first)
        order = sorted(program.outputs, key=lambda name: (*self.model.coefficients, name).index(name))
        return replace(program, outputs={name: program.outputs[name] for name in order})

    def coefficients(
        self, values: Mapping[str, Any], signals: Mapping[str, Any], aircraft: Aircraft, points: Sequence[Any]
    ) -> dict[str, Any]:
        """Coefficients at given separation points, of one wing or of the right and the left one."""
        X = tuple(points) if len(points) > 1 else next(iter(points), jnp.ones_like(signals["alpha"]))
        flow = self.exported.flow(values, signals, aircraft, X=X)
        return {name: flow[name] for name in self.exported.coefficients}

    @property
    def lift_slope(self) -> Program:
        """The derivative of CL by alpha-dot, s, as the output `slope`: how strongly the two depend on each other."""

        def outputs(values: Any, signals: Any, aircraft: Any, states: Any) -> dict[str, Any]:
            if "CL" not in self.exported.coefficients or "alpha_dot" not in signals:
                return {"slope": jnp.zeros_like(signals["alpha"])}
            rate = signals["alpha_dot"]
            lift = lambda rate: self._outputs(values, dict(signals) | {"alpha_dot": rate}, aircraft, states)["CL"]  # noqa: E731
            return {"slope": jax.jvp(lift, (rate,), (jnp.ones_like(rate),))[1]}

        return self.traced(outputs, self.points if self.lagged else ())

    def lag(self, values: Mapping[str, Any], signals: Mapping[str, Any], aircraft: Aircraft) -> dict[str, Any]:
        """The time constant of the separation point, s, where there is one."""
        if not self.lagged:
            return {}
        return {"lag": jnp.maximum(self.exported.lag(values), MIN_LAG) * aircraft.chord / signals["airspeed"]}

    def _outputs(
        self, values: Mapping[str, Any], signals: Mapping[str, Any], aircraft: Aircraft, states: Mapping[str, Any]
    ) -> dict[str, Any]:
        """The traced function."""
        static = self.exported.static_points(values, signals, aircraft) if self.separates else ()
        found = self.coefficients(values, signals, aircraft, [*states.values()] or static)
        found |= {f"{n}_static" if states else n: x for n, x in zip(self.points, static, strict=True)}
        return found | self.lag(values, signals, aircraft)


def _floored(name: str, x: Any) -> Any:
    """A signal, or the least value that a model may divide by."""
    return jnp.maximum(x, LEAST[name]) if name in LEAST else x


def _is_of_aircraft(effect: Effect) -> bool:
    """Whether a simulator needs it: it is part of the aircraft, and no random process."""
    return effect.stage not in (Stage.CHANNEL, Stage.INFLOW) and effect.disturbance is None


def _why_not(effect: Effect, values: Mapping[str, float]) -> str:
    """What it is, and how large."""
    size = ", ".join(f"{p.name} = {values[p.name]:.4g} {p.unit}" for p in effect.parameters if p.name in values)
    what = "the record, not the aircraft" if effect.stage is Stage.CHANNEL else "a random process of the air"
    return f"{effect.name} ({size}) is not exported: it is {what}. {effect.claim}"


def _scoped(effect: Effect) -> Effect:
    """The effect under its name in a trace, so that an operation without counterpart can be traced back to it."""

    def increments(*given: Any) -> Any:
        try:
            with jax.named_scope(effect.name):
                return effect.increments(*given)
        except InputError:
            raise
        except Exception as reason:  # whatever a user's own effect may raise on single numbers
            raise InputError(
                f"effect {effect.name} cannot be exported: for single numbers it fails with "
                f"{type(reason).__name__}: {reason}"
            ) from None

    return replace(effect, increments=increments)


def _example(name: str) -> float:
    """A value at which to trace."""
    if name in STANDARD_CHANNELS:
        low, high = STANDARD_CHANNELS[name].plausible
        return 0.5 * (low + high) + 0.01 * (high - low)
    return 0.5


def _aircraft(aircraft: Aircraft, given: Mapping[str, Any]) -> Aircraft:
    """The aircraft with constants of a trace."""
    found = {}
    for f in fields(aircraft):
        value = getattr(aircraft, f.name)
        if isinstance(value, tuple):
            found[f.name] = tuple(given[f"aircraft.{f.name}.{i}"] for i in range(len(value)))
        else:
            found[f.name] = None if value is None else given[f"aircraft.{f.name}"]
    return Aircraft(**found)


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(float(x) for x in value)
    return None if value is None else float(value)
