"""What a flight makes of something added to a coefficient: to first order, for whatever is a function of the flight.

A term theta phi(x) of a coefficient changes the residuals, to first order in theta, as phi along the flight without it
does where it is prescribed: added to the coefficient as an input, linear between samples. So one compiled program has
the sensitivities to all terms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.aircraft.effect_system import EffectSystem
from bayes_aero.dynamics.flight import AircraftDynamics
from bayes_aero.dynamics.segments import prepare
from bayes_aero.dynamics.system import motion
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.residuals.base import DIRECTIONS_PER_CALL
from bayes_aero.residuals.output_error import OutputError

Signals = Mapping[str, np.ndarray]
Made = Callable[[Signals], Float[np.ndarray, "d n"]]
"""Functions of the flight: d series of one value for every sample, from its signals."""


@cache
def _adding(coefficient: str) -> Effect:
    """The effect that adds an input to a coefficient; always the same object, for models are hashed."""
    channel = channel_of(coefficient)
    return Effect(
        name=channel,
        kind=Kind.AERODYNAMICS,
        stage=Stage.TOTAL,
        claim=f"{coefficient} has an addition that is prescribed.",
        parameters=(),
        channels=(channel,),
        increments=lambda v, s, a, known: {coefficient: s[channel]},  # noqa: ARG005
        example=Example({}, {channel: 0.1}, {coefficient: 0.1}, "it adds what it is given"),
        source="definition",
    )


def channel_of(coefficient: str) -> str:
    """The input that is added to a coefficient."""
    return f"added_{coefficient}"


class AddedCoefficients:
    """Residuals of flights under inputs that are added to the coefficients, at fixed parameters `theta`."""

    def __init__(self, responses: OutputError, theta: Float[np.ndarray, " k"]) -> None:
        model = responses.model.extended(*map(_adding, responses.model.coefficients))
        nothing = jnp.zeros(responses.flights.n)
        self.zeros = {channel_of(name): nothing for name in model.coefficients}
        flights = replace(responses.flights, channels={**responses.flights.channels, **self.zeros})
        dynamics = responses.windows.dynamics
        assert isinstance(dynamics, AircraftDynamics)
        dynamics = replace(dynamics, model=model)
        windows = replace(responses.windows, dynamics=dynamics, flights=flights)
        self.responses = replace(responses, flights=flights, windows=windows, model=model).nameless
        self.theta = jnp.asarray(theta)

    def signals(self) -> dict[str, np.ndarray]:
        """Signals of the flow, X and the marks along the simulated flight, each (n,); samples of no window repeat."""
        return self.along(_states(self.responses, self.theta))

    def along(self, states: Float[Array, "w n s"]) -> dict[str, np.ndarray]:
        """The same along any path of the windows."""
        windows, flights = self.responses.windows, self.responses.flights
        found = _signals(self.responses, self.theta, states)
        real = np.asarray(windows.inside)
        place, n = np.asarray(windows.index)[real], flights.n
        latest = np.full(n, -1)
        latest[place] = np.arange(len(place))
        latest = np.maximum.accumulate(latest)
        laid = {name: np.asarray(x)[real][latest] for name, x in found.items()}
        marks = {name: np.asarray(flights.channels[name]) for name in ("dt", "elapsed", "first", "last")}
        return {name: x for name, x in laid.items() if name not in self.zeros} | marks

    def slopes(self, coefficient: str, made: Made) -> Float[np.ndarray, "d m c"]:
        """Minus the derivatives of the residuals by the factors of series that are added to a coefficient.

        Args:
            coefficient: to which they are added.
            made: the series from the signals of the flight.
        """
        series = made(self.signals())
        size, found = DIRECTIONS_PER_CALL, []
        for begin in range(0, len(series), size):
            part = series[begin : begin + size]
            wide = jnp.zeros((size, series.shape[1])).at[: len(part)].set(part)
            rest = jnp.zeros_like(wide)
            directions = {name: wide if name == channel_of(coefficient) else rest for name in self.zeros}
            found.append(-np.asarray(_slopes(self.responses, self.theta, self.zeros, directions))[: len(part)])
        return np.concatenate(found)


@eqx.filter_jit
def _slopes(responses: OutputError, theta: Any, zeros: Mapping[str, Array], directions: Mapping[str, Array]):
    still = jnp.zeros(len(responses.windows.dynamics.start))

    def residual(added):
        channels = {**responses.flights.channels, **added}
        return eqx.tree_at(lambda r: r.flights.channels, responses, channels).residual(theta, still)

    return jax.vmap(lambda d: jax.jvp(residual, (zeros,), (d,))[1])(dict(directions))


@eqx.filter_jit
def _states(responses: OutputError, theta: Any) -> Array:
    return responses.states(theta)


@eqx.filter_jit
def _signals(responses: OutputError, theta: Any, states: Array) -> dict[str, Array]:
    prepared = prepare(responses.flown, theta)

    def at_sample(x, u):
        assert isinstance(prepared.system, EffectSystem)
        signals = prepared.system.flow_signals(x, u) | {"X": motion(prepared.system, x, u)[1]["X"]}
        return {name: s for name, s in signals.items() if not isinstance(s, tuple) and jnp.ndim(s) == 0}

    return jax.vmap(jax.vmap(at_sample))(states, prepared.drives)
