"""Residuals of trajectories: output error, innovations of a filter, and what terms added to a coefficient do there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bayes_aero.dynamics import kalman
from bayes_aero.dynamics.aircraft import POINTS
from bayes_aero.dynamics.flight import AircraftDynamics
from bayes_aero.dynamics.segments import SegmentTrajectories, prepare, segments, simulate
from bayes_aero.dynamics.system import motion
from bayes_aero.effect import Effect, Example, Stage, effect
from bayes_aero.model.model import Model
from bayes_aero.model.records import Flights
from bayes_aero.physics.filters import FILTER_STEP
from bayes_aero.processes import Compiled, compiled_at
from bayes_aero.residuals import base

# --- Output error: recorded minus simulated channels, in windows with an initial state each.
# It is less sensitive than equation error, because a trajectory integrates the error of a coefficient.


class OutputError(base.ResidualModel, eqx.Module):
    """Residuals of simulated windows, averaged over blocks of `FILTER_STEP` samples: m of them."""

    flights: Flights
    windows: SegmentTrajectories
    place: Int[np.ndarray, " m"]  # indices of the complete blocks
    model: Model = eqx.field(static=True)
    stage = "trajectories"

    @classmethod
    def of(cls, flights: Flights, dynamics: AircraftDynamics, substeps: int = 1) -> OutputError:
        names = tuple(n for n in dynamics.outputs if n in flights.channels)
        cut = segments(flights, dynamics, outputs=names, window=base.WINDOW, substeps=substeps)
        whole = cut.index.shape[1] // FILTER_STEP * FILTER_STEP
        index, inside, noise_growth = (x[:, :whole] for x in (cut.index, cut.inside, cut.noise_growth))
        cut = replace(cut, index=index, inside=inside, noise_growth=noise_growth)
        place = np.flatnonzero(cut.inside.reshape(-1, FILTER_STEP).all(axis=1))
        return cls(flights=flights, windows=cut, place=place, model=dynamics.model)

    @property
    def flown(self) -> SegmentTrajectories:
        """The windows of the present flights."""
        return eqx.tree_at(lambda f: f.flights, self.windows, self.flights)

    @property
    def nameless(self):
        windows = self.flown.nameless
        return replace(self, flights=windows.flights, windows=windows)

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.windows.outputs

    @property
    def manoeuvre(self) -> Int[np.ndarray, " m"]:
        return self.flights.manoeuvre[self.windows.index[:, ::FILTER_STEP].ravel()[self.place]]

    @property
    def stretch(self) -> Int[np.ndarray, " m"]:
        """The window of each block; in a window the effects of disturbances accumulate from its start."""
        return np.repeat(np.arange(len(self.windows.index)), self.windows.index.shape[1] // FILTER_STEP)[self.place]

    @property
    def seconds(self) -> float:
        return FILTER_STEP * float(np.median(self.windows.dt))

    def _mean(self, x: Float[Array, "w n ..."]) -> Float[Array, "m ..."]:
        parts = x.reshape(-1, FILTER_STEP, *x.shape[2:]).mean(axis=1)
        return parts[self.place]

    def block(self, x: Float[Array, "n ..."] | Float[np.ndarray, "n ..."]) -> Float[Array, "m ..."]:
        return self._mean(jnp.asarray(x)[self.windows.index])

    def evaluate(self, theta: base.Theta) -> tuple[base.Residual, Mapping[str, Array]]:
        """Residuals of the windows from their measured initial states."""
        return _residual(self.nameless, jnp.asarray(theta), jnp.zeros(len(self.windows.dynamics.start))), {}

    def slopes(self, theta: base.Theta, directions: base.Directions) -> tuple[base.Residual, base.Slopes]:
        rest = np.zeros((len(directions), len(self.windows.dynamics.start)))
        residual, slope = _slopes(self.nameless, *map(jnp.asarray, (theta, directions, rest)))
        return np.asarray(residual), -np.asarray(slope)

    def offsets(self, theta: base.Theta, outputs: Sequence[str]) -> base.Offsets:
        """Sensitivities to the initial state of each window."""
        keep = [self.outputs.index(name) for name in outputs]
        states, rest = len(self.windows.dynamics.start), np.zeros((base.DIRECTIONS_PER_CALL, len(theta)))
        directions = np.eye(-(-states // base.DIRECTIONS_PER_CALL) * base.DIRECTIONS_PER_CALL, states)
        parts = np.split(directions, len(directions) // base.DIRECTIONS_PER_CALL)  # by the program of `slopes`
        slopes = [_slopes(self.nameless, *map(jnp.asarray, (theta, rest, part)))[1] for part in parts]
        slope = -np.concatenate(slopes)[:states][:, :, keep]  # s m c
        m = len(self.stretch)
        sensitivities = np.zeros((m, len(keep), len(self.windows.index), states))
        sensitivities[np.arange(m), :, self.stretch] = np.moveaxis(slope, 0, 2)
        return sensitivities.reshape(m, len(keep), -1)

    def added(self, theta: base.Theta) -> AddedCoefficients:
        return AddedCoefficients(self, theta)

    def residual(self, theta: Any, shared: Any) -> base.Residual:
        """Residuals at these parameters with the initial state of every window changed by `shared` (s,)."""
        simulated = simulate(self.flown, theta, jnp.zeros((len(self.windows.index), 1)) + shared)
        return self._mean(simulated.residual)

    def states(self, theta: Any) -> Float[Array, "w n s"]:
        """States of the simulated windows from their measured initial states."""
        departure = jnp.zeros((len(self.windows.index), len(self.windows.dynamics.start)))
        return simulate(self.flown, theta, departure).trajectory.states


_residual = Compiled(lambda responses, theta, shared: responses.residual(theta, shared))


@Compiled
def _slopes(responses: OutputError, theta, directions, initial_directions):
    """Derivatives by parameters and initial states together, so that one program serves both."""
    point = (theta, jnp.zeros(initial_directions.shape[1]))
    one = lambda *d: jax.jvp(responses.residual, point, d)  # noqa: E731
    return jax.vmap(one, out_axes=(None, 0))(directions, initial_directions)


# --- Filter error: innovations of whole manoeuvres, the errors of one-step predictions by a Kalman filter.
# The gains are those of an extended Kalman filter at one set of parameters; they are held while the parameters vary.
# The innovations of a correct model are white, also in turbulence. An effect that the model lacks correlates them with
# its input. Source: Jategaonkar, *Flight Vehicle System Identification*, 2nd ed. 2015, ch. 5.

PART = 5.0  # s; our choice: some twenty neighbouring innovations and more, and a minute has a dozen parts


class FilterError(OutputError):
    """Whitened innovations, m samples."""

    # They are not averaged over blocks as outputs are. The sensitivity to a sensor error contains the noise of that
    # sensor up to the sample before; a block mean would correlate it with the noise of the residual.
    by: kalman.Observer
    stage = "innovations"
    white = True
    averaged = 1

    @property
    def stretch(self) -> Int[np.ndarray, " m"]:
        return np.zeros(len(self.place), int)  # innovations are stationary

    @classmethod
    def after(
        cls,
        cut: SegmentTrajectories,
        theta: base.Theta,
        R: Float[np.ndarray, " c"],
        filtered: kalman.Filtered,
        dynamics: AircraftDynamics,
    ) -> FilterError:
        """Innovations of a filtered record (`cut`) under extended dynamics, at the filter's `theta`, `R` and result."""
        # The dynamics may lack states of the filter, such as gusts without intensity, and have two separation points
        # where the filter has one, with which both move while the effects are neutral.
        by = kalman.observer_of(cut.nameless, jnp.asarray(theta), jnp.asarray(R), filtered)
        dynamics, states = dynamics.for_filter(), cut.dynamics.states
        names = [name if name in states or name not in POINTS else POINTS[0] for name in dynamics.states]
        rows = np.array([states.index(name) for name in names])
        by = kalman.Observer(by.gain[:, :, rows], by.whitening)
        cut, place = replace(cut, dynamics=dynamics), np.flatnonzero(cut.inside)
        return cls(flights=cut.flights, windows=cut, place=place, model=dynamics.model, by=by)

    @property
    def manoeuvre(self) -> Int[np.ndarray, " m"]:
        return self.flights.manoeuvre[self.windows.index.ravel()[self.place]]

    @property
    def seconds(self) -> float:
        return float(np.median(self.windows.dt))

    def _mean(self, x: Float[Array, "w n ..."]) -> Float[Array, "m ..."]:
        return x.reshape(-1, *x.shape[2:])[self.place]

    @property
    def parts(self) -> Int[np.ndarray, " m"]:
        """Parts of about `PART` s of every manoeuvre: innovations of different parts are uncorrelated."""
        lengths, begin, parts = np.bincount(self.manoeuvre), 0, []
        for n in lengths:
            count = max(round(n * self.seconds / PART), 1)
            parts.append(begin + np.arange(n) * count // n)
            begin += count
        return np.concatenate(parts)

    def added(self, theta: base.Theta) -> AddedToFilter:
        return AddedToFilter(self, theta)

    def residual(self, theta: Any, shared: Any) -> base.Residual:  # noqa: ARG002
        e = kalman.run_observer(self.flown, theta, self.by).innovation
        return self.whitened(theta, e[..., None])[..., 0]

    def _whitened(self, e: Float[Array, "w n c d"], scale: Float[Array, "w n c"]) -> Float[Array, "m c d"]:
        return self._mean(jnp.einsum("wnij,wnjd->wnid", self.by.whitening, e / scale[..., None]))

    def slopes(self, theta: base.Theta, directions: base.Directions) -> tuple[base.Residual, base.Slopes]:
        return self.slopes_at(theta)(directions)

    def slopes_at(self, theta: base.Theta) -> Callable[[base.Directions], tuple]:
        """`slopes` as a function of the directions; the path and its derivatives by the state are computed once."""
        path, derivatives = self.path_at(theta)

        def slopes(directions):
            residual, slope = _filter_slopes(
                self.nameless, jnp.asarray(theta), path, derivatives, jnp.asarray(directions)
            )
            return np.asarray(residual), -np.moveaxis(np.asarray(slope), -1, 0)

        return slopes

    def path_at(self, theta: base.Theta) -> tuple[kalman.Observed, kalman.StateDerivatives]:
        """The path of the observer at these parameters, and derivatives by the state along it."""
        return _path(self.nameless, jnp.asarray(theta))

    def whitened(self, theta: Any, e: Float[Array, "w n c d"]) -> Float[Array, "m c d"]:
        """Changes of the innovations as they change the residuals."""
        return self._whitened(e, prepare(self.flown, theta).scale)

    def offsets(self, theta: base.Theta, outputs: Sequence[str]) -> base.Offsets:  # noqa: ARG002
        """None: the filter estimates the initial state."""
        return np.zeros((len(self.place), len(outputs), 0))


@Compiled
def _path(responses: FilterError, theta):
    path = kalman.run_observer(responses.flown, theta, responses.by)
    return path, kalman.state_derivatives(responses.flown, theta, path.before, path.after)


@Compiled
def _filter_slopes(responses: FilterError, theta, path, derivatives, directions):
    lin = kalman.linearise(responses.flown, theta, path.before, path.after, directions, derivatives)
    e = path.innovation[..., None]
    # A scale error changes the noise of the record with its signal; without this term it would fit noise.
    grown = e * lin.scale_drive / lin.scale[..., None]
    whitened = responses._whitened(
        jnp.concatenate([e, kalman.observer_derivatives(lin, responses.by) - grown], axis=-1), lin.scale
    )
    return whitened[..., 0], whitened[..., 1:]


# --- What a flight makes of something added to a coefficient: to first order, for whatever is a function of the flight.
# A term theta phi(x) of a coefficient changes the residuals, to first order in theta, as phi along the flight without
# it does where it is prescribed: added to the coefficient as an input, linear between samples. So one compiled program
# has the sensitivities to all terms.


@cache
def _adding(coefficient: str) -> Effect:
    """The effect that adds an input to a coefficient; always the same object, for models are hashed."""
    channel = channel_of(coefficient)
    example = Example({}, {channel: 0.1}, {coefficient: 0.1}, "it adds what it is given")
    claim, added = f"{coefficient} has an addition that is prescribed.", lambda _v, s, *_: {coefficient: s[channel]}
    return effect(channel, claim, "", added, example=example, source="definition", stage=Stage.TOTAL)


def channel_of(coefficient: str) -> str:
    return f"added_{coefficient}"


_states = compiled_at(0)(lambda responses, theta: responses.states(theta))
_by_input = compiled_at(0)(kalman.derivatives_by_input)


@Compiled
def _added_slopes(responses: OutputError, theta: Any, zeros: Mapping[str, Array], directions: Mapping[str, Array]):
    still = jnp.zeros(len(responses.windows.dynamics.start))

    def residual(added):
        channels = {**responses.flights.channels, **added}
        return eqx.tree_at(lambda r: r.flights.channels, responses, channels).residual(theta, still)

    return jax.vmap(lambda d: jax.jvp(residual, (zeros,), (d,))[1])(dict(directions))


@Compiled
def _signals(responses: OutputError, theta: Any, states: Array) -> dict[str, Array]:
    prepared = prepare(responses.flown, theta)
    system: Any = prepared.system  # of effects

    def at_sample(x, u):
        signals = system.flow_signals(x, u) | {"X": motion(system, x, u)[1]["X"]}
        return {name: s for name, s in signals.items() if not isinstance(s, tuple) and jnp.ndim(s) == 0}

    return jax.vmap(jax.vmap(at_sample))(states, prepared.drives)


class AddedCoefficients:
    """Residuals of flights under inputs that are added to the coefficients, at fixed parameters `theta`."""

    def __init__(self, responses: OutputError, theta: base.Theta) -> None:
        model = responses.model.extended(*map(_adding, responses.model.coefficients))
        nothing = jnp.zeros(responses.flights.n)
        self.zeros = {channel_of(name): nothing for name in model.coefficients}
        flights = replace(responses.flights, channels={**responses.flights.channels, **self.zeros})
        dynamics: Any = responses.windows.dynamics
        flights = flights.nameless  # not `longer`: the size of a term is that of what was flown
        windows = replace(responses.windows, dynamics=replace(dynamics, model=model), flights=flights)
        self.responses = replace(responses, flights=flights, windows=windows, model=model)
        self.theta = jnp.asarray(theta)

    @cached_property
    def signals(self) -> dict[str, np.ndarray]:
        """Signals of the flow, X and the marks along the simulated flight, each (n,); samples of no window repeat."""
        return self.along(_states(self.responses, self.theta))

    def along(self, states: Float[Array, "w n s"]) -> dict[str, np.ndarray]:
        """The same along any path of the windows."""
        windows, flights = self.responses.windows, self.responses.flights
        signals = _signals(self.responses, self.theta, states)
        real = np.asarray(windows.inside)
        place, n = np.asarray(windows.index)[real], flights.n
        latest = np.full(n, -1)
        latest[place] = np.arange(len(place))
        latest = np.maximum.accumulate(latest)
        laid = {name: np.asarray(x)[real][latest] for name, x in signals.items()}
        marks = {name: np.asarray(flights.channels[name]) for name in ("dt", "elapsed", "first", "last")}
        return {name: x for name, x in laid.items() if name not in self.zeros} | marks

    def columns(self, coefficient: str, made: base.Made, outputs: Sequence[str], deviation: Float[np.ndarray, " c"]):
        """See `ResidualModel.added`; a column as large as the residual of the median output, all outputs counted."""
        series, kept = made(self.signals), [self.responses.outputs.index(name) for name in outputs]
        slopes = self.slopes(coefficient, made)[:, :, kept]
        scale = np.sqrt(np.mean((slopes / deviation) ** 2, axis=(1, 2))) * float(np.median(deviation))
        return series, slopes, scale

    def slopes(self, coefficient: str, made: base.Made) -> base.Slopes:
        """Minus the derivatives of the residuals by the factors of series that are added to a coefficient."""
        series = made(self.signals)
        size, slopes = base.DIRECTIONS_PER_CALL, []
        for begin in range(0, len(series), size):
            part = series[begin : begin + size]
            wide = jnp.zeros((size, series.shape[1])).at[: len(part)].set(part)
            rest = jnp.zeros_like(wide)
            directions = {name: wide if name == channel_of(coefficient) else rest for name in self.zeros}
            slopes.append(-np.asarray(_added_slopes(self.responses, self.theta, self.zeros, directions))[: len(part)])
        return np.concatenate(slopes)


# --- What a filter does not foresee of something added to a coefficient: to first order, its gains held.
# A term theta phi(x) of a coefficient acts where the filter stands: on the outputs at the state before a sample's
# correction, and on the motion from the state after it to the next sample, along which phi is taken as linear.
# Neither holds noise of the innovation that it changes. The filter is linear in it, so that all terms of a library
# are columns of one recurrence. Source: Jazwinski, *Stochastic Processes and Filtering Theory*, 1970, ch. 8 (the
# linearised filter).

COLUMNS = 64  # at a time


@Compiled
def _innovation_slopes(
    responses: FilterError,
    theta: Any,
    by_state: kalman.StateDerivatives,
    by_input: tuple[Array, Array],
    series: Float[Array, "2 d n"],
) -> Float[Array, "m c d"]:
    flown = responses.flown
    before, after = (jnp.moveaxis(x[:, flown.index], 0, -1) for x in series)  # w n d
    return responses.whitened(
        theta, kalman.input_innovations(flown, theta, by_state, by_input, responses.by, before, after)
    )


class AddedToFilter(AddedCoefficients):
    """Innovations under inputs that are added to the coefficients, at fixed parameters `theta`, gains held."""

    def __init__(self, responses: FilterError, theta: base.Theta) -> None:
        super().__init__(responses, theta)
        self.path, self.known = responses.path_at(theta)

    @cached_property
    def signals(self) -> dict[str, np.ndarray]:
        """Signals where each sample's outputs are predicted, by the samples before."""
        return self.along(self.path.before)

    def slopes(self, coefficient: str, made: base.Made) -> base.Slopes:
        """Minus the derivatives of the whitened innovations; arguments as of `AddedCoefficients.slopes`."""
        responses: Any = self.responses
        direction = {name: jnp.asarray(float(name == channel_of(coefficient))) for name in self.zeros}
        by_input = _by_input(responses.flown, self.theta, self.path.before, self.known, direction)
        series = np.stack([made(self.signals), made(self.along(self.path.after))])  # 2 d n
        slopes = []
        for begin in range(0, series.shape[1], COLUMNS):
            part = series[:, begin : begin + COLUMNS]
            wide = np.zeros((2, COLUMNS, series.shape[2]))
            wide[:, : part.shape[1]] = part
            slope = _innovation_slopes(responses, self.theta, self.known, by_input, jnp.asarray(wide))
            slopes.append(-np.moveaxis(np.asarray(slope), -1, 0)[: part.shape[1]])
        return np.concatenate(slopes)
