"""What a flight makes of something added to a coefficient: to first order, for whatever is a function of the flight.

A term theta phi(x) of a coefficient changes the residuals, to first order in theta, as phi along the flight without it
does where it is prescribed: added to the coefficient as an input, linear between samples. So one compiled program has
the sensitivities to all terms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.aircraft import EffectSystem
from bayes_aero.dynamics.flight import AircraftDynamics
from bayes_aero.dynamics.innovations import InputDerivatives, StateDerivatives, derivatives_by_input, input_innovations
from bayes_aero.dynamics.segments import prepare
from bayes_aero.dynamics.system import motion
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.residuals.base import DIRECTIONS_PER_CALL
from bayes_aero.residuals.filter_error import FilterError
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


_states = eqx.filter_jit(lambda responses, theta: responses.states(theta))
_by_input = eqx.filter_jit(derivatives_by_input)


@eqx.filter_jit
def _slopes(responses: OutputError, theta: Any, zeros: Mapping[str, Array], directions: Mapping[str, Array]):
    still = jnp.zeros(len(responses.windows.dynamics.start))

    def residual(added):
        channels = {**responses.flights.channels, **added}
        return eqx.tree_at(lambda r: r.flights.channels, responses, channels).residual(theta, still)

    return jax.vmap(lambda d: jax.jvp(residual, (zeros,), (d,))[1])(dict(directions))


@eqx.filter_jit
def _signals(responses: OutputError, theta: Any, states: Array) -> dict[str, Array]:
    prepared = prepare(responses.flown, theta)

    def at_sample(x, u):
        assert isinstance(prepared.system, EffectSystem)
        signals = prepared.system.flow_signals(x, u) | {"X": motion(prepared.system, x, u)[1]["X"]}
        return {name: s for name, s in signals.items() if not isinstance(s, tuple) and jnp.ndim(s) == 0}

    return jax.vmap(jax.vmap(at_sample))(states, prepared.drives)


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


# --- What a filter does not foresee of something added to a coefficient: to first order, its gains held.
# A term theta phi(x) of a coefficient acts where the filter stands: on the outputs at the state before a sample's
# correction, and on the motion from the state after it to the next sample, along which phi is taken as linear.
# Neither holds noise of the innovation that it changes. The filter is linear in it, so that all terms of a library
# are columns of one recurrence. Source: Jazwinski, *Stochastic Processes and Filtering Theory*, 1970, ch. 8 (the
# linearised filter).

COLUMNS = 64  # at a time


@eqx.filter_jit
def _innovation_slopes(
    responses: FilterError, theta: Any, known: StateDerivatives, own: InputDerivatives, series: Float[Array, "2 d n"]
) -> Float[Array, "m c d"]:
    flown = responses.flown
    before, after = (jnp.moveaxis(x[:, flown.index], 0, -1) for x in series)  # w n d
    return responses.whitened(theta, input_innovations(flown, theta, known, own, responses.by, before, after))


class AddedToFilter(AddedCoefficients):
    """Innovations under inputs that are added to the coefficients, at fixed parameters `theta`, gains held."""

    def __init__(self, responses: FilterError, theta: Float[np.ndarray, " k"]) -> None:
        super().__init__(responses, theta)
        self.path, self.known = responses.path_at(theta)

    @cached_property
    def predicted(self) -> dict[str, np.ndarray]:
        """Signals where each sample's outputs are predicted, by the samples before."""
        return self.along(self.path.before)

    def signals(self) -> dict[str, np.ndarray]:
        """Signals of the flow, X and the marks along the predictions, each (n,)."""
        return self.predicted

    def slopes(self, coefficient: str, made: Made) -> Float[np.ndarray, "d m c"]:
        """Minus the derivatives of the whitened innovations; arguments as of `AddedCoefficients.slopes`."""
        responses = self.responses
        assert isinstance(responses, FilterError)
        direction = {name: jnp.asarray(float(name == channel_of(coefficient))) for name in self.zeros}
        own = _by_input(responses.flown, self.theta, self.path.before, self.known, direction)
        series = np.stack([made(self.predicted), made(self.along(self.path.after))])  # 2 d n
        found = []
        for begin in range(0, series.shape[1], COLUMNS):
            part = series[:, begin : begin + COLUMNS]
            wide = np.zeros((2, COLUMNS, series.shape[2]))
            wide[:, : part.shape[1]] = part
            slope = _innovation_slopes(responses, self.theta, self.known, own, jnp.asarray(wide))
            found.append(-np.moveaxis(np.asarray(slope), -1, 0)[: part.shape[1]])
        return np.concatenate(found)
