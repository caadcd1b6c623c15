"""Criticism from trajectories alone: what is missing from the model, where no accelerometer gives the coefficients.

The card's model is flown through the recorded inputs in windows, each from an initial state of its own; the elections
are those of the coefficients. Less is seen than there: a trajectory integrates what a coefficient shows at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bayes_aero.criticism.candidates import Field, field_of, lag_of
from bayes_aero.criticism.credibility import attributed
from bayes_aero.criticism.diagnosis import causes_of, moves_of, structure_of, together_of, verdict_of
from bayes_aero.criticism.extension import (
    ALPHA,
    DECISIVE,
    Extension,
    Progress,
    Step,
    between_p_value,
    extend,
    nats_gained,
)
from bayes_aero.criticism.finding import Diagnosis, NoiseReport
from bayes_aero.criticism.gain import split_name
from bayes_aero.criticism.linearisable import Linearisable
from bayes_aero.criticism.state import State, linearised, refitted
from bayes_aero.criticism.windows import WINDOW, too_few_windows
from bayes_aero.effect import Effect, Stage
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.output_error import fit_cascade
from bayes_aero.inference.output_error_result import OutputErrorResult, OutputErrorStatus
from bayes_aero.model.dynamics import AircraftDynamics, aircraft_dynamics
from bayes_aero.model.flights import Flights, despiked, join
from bayes_aero.model.flown_channels import FLIGHT
from bayes_aero.model.model import Model
from bayes_aero.model.own_effects import own_effects
from bayes_aero.model.segments import Flown, segments, simulate
from bayes_aero.physics.filters import FILTER_STEP

FIRST = (10.0, 5.0, 2.5)  # s, of first windows, tried until a fit converges: begun far off, long ones may stray


class FlownResponses(Linearisable, eqx.Module):
    """Residuals of simulated windows, averaged over blocks of `FILTER_STEP` samples: m of them."""

    flights: Flights
    windows: Flown
    place: Int[np.ndarray, " m"]  # of every block that is whole, among all
    model: Model = eqx.field(static=True)

    @classmethod
    def of(cls, flights: Flights, dynamics: AircraftDynamics, substeps: int = 1) -> FlownResponses:
        """Every manoeuvre in windows."""
        names = tuple(n for n in dynamics.outputs if n in flights.channels)
        cut = segments(flights, dynamics, outputs=names, window=WINDOW, substeps=substeps)
        whole = cut.index.shape[1] // FILTER_STEP * FILTER_STEP
        index, inside, swell = (x[:, :whole] for x in (cut.index, cut.inside, cut.swell))
        cut = replace(cut, index=index, inside=inside, swell=swell)
        place = np.flatnonzero(cut.inside.reshape(-1, FILTER_STEP).all(axis=1))
        return cls(flights=flights, windows=cut, place=place, model=dynamics.model)

    @property
    def flown(self) -> Flown:
        """The windows of the present flights."""
        return eqx.tree_at(lambda f: f.flights, self.windows, self.flights)

    @property
    def _nameless(self) -> FlownResponses:
        return replace(self, flights=self.flights.nameless, windows=self.windows.nameless)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the channels that are compared."""
        return self.windows.outputs

    @property
    def manoeuvre(self) -> Int[np.ndarray, " m"]:
        """Which manoeuvre each block belongs to."""
        return self.flights.manoeuvre[self.windows.index[:, ::FILTER_STEP].ravel()[self.place]]

    @property
    def stretch(self) -> Int[np.ndarray, " m"]:
        """The window of each block: what disturbs the flight gathers from its beginning on."""
        return np.repeat(np.arange(len(self.windows.index)), self.windows.index.shape[1] // FILTER_STEP)[self.place]

    @property
    def seconds(self) -> float:
        """Length of a block, s."""
        return FILTER_STEP * float(np.median(self.windows.dt))

    def _mean(self, x: Float[Array, "w n ..."]) -> Float[Array, "m ..."]:
        parts = x.reshape(-1, FILTER_STEP, *x.shape[2:]).mean(axis=1)
        return parts[self.place]

    def block(self, x: Float[Array, "n ..."] | Float[np.ndarray, "n ..."]) -> Float[Array, "m ..."]:
        """Means over blocks."""
        return self._mean(jnp.asarray(x)[self.windows.index])

    def evaluate(
        self, theta: Float[Array, " k"] | Float[np.ndarray, " k"]
    ) -> tuple[Float[Array, "m c"], Mapping[str, Array]]:
        """Residuals of the windows, begun at their measured states."""
        return _evaluate(self._nameless, jnp.asarray(theta)), {}

    def slopes(
        self, theta: Float[np.ndarray, " k"], directions: Float[np.ndarray, "d k"]
    ) -> tuple[Float[np.ndarray, "m c"], Float[np.ndarray, "d m c"]]:
        """Residuals and minus their derivatives in these directions."""
        residual, slope = _slopes(self._nameless, jnp.asarray(theta), jnp.asarray(directions))
        return np.asarray(residual), -np.asarray(slope)

    def offsets(self, theta: Float[np.ndarray, " k"], outputs: Sequence[str]) -> Float[np.ndarray, "m c o"]:
        """Sensitivities to the initial state of each window."""
        keep = [self.outputs.index(name) for name in outputs]
        slope = -np.asarray(_state_slopes(self._nameless, jnp.asarray(theta)))[:, :, keep]  # s m c
        window = self.stretch
        s, m, c = slope.shape
        S = np.zeros((m, c, len(self.windows.index) * s))
        for w in range(len(self.windows.index)):
            mine = window == w
            S[mine, :, w * s : (w + 1) * s] = np.moveaxis(slope[:, mine], 0, 2)
        return S


def _residual(responses: FlownResponses, theta: Any, shared: Any) -> Float[Array, "m c"]:
    found = simulate(responses.flown, theta, jnp.zeros((len(responses.windows.index), 1)) + shared)
    return responses._mean(found.residual)


@eqx.filter_jit
def _evaluate(responses: FlownResponses, theta):
    return _residual(responses, theta, jnp.zeros(len(responses.windows.dynamics.states)))


@eqx.filter_jit
def _slopes(responses: FlownResponses, theta, directions):
    rest = jnp.zeros(len(responses.windows.dynamics.states))
    one = lambda d: jax.jvp(lambda t: _residual(responses, t, rest), (theta,), (d,))  # noqa: E731
    return jax.vmap(one, out_axes=(None, 0))(directions)


@eqx.filter_jit
def _state_slopes(responses: FlownResponses, theta):
    rest = jnp.zeros(len(responses.windows.dynamics.states))
    one = lambda d: jax.jvp(lambda x: _residual(responses, theta, x), (rest,), (d,))[1]  # noqa: E731
    return jax.vmap(one)(jnp.eye(len(rest)))


def diagnose_flown(
    records: Sequence[FlightRecord],
    card: Card,
    *,
    model: Model | None = None,
    seed: int = 0,
    most: int = 8,
    extra: Sequence[Effect] = (),
    progress: Progress | None = None,
) -> Diagnosis:
    """Find what the card's model gets wrong from airspeed, alpha, attitude, pitch rate and altitude alone.

    Accelerations are compared too where they were recorded. A lag of the separation point that the card does not have
    would be a state of its own: it is tried where something is missing. Structure without a name is not sought.
    """
    if why := too_few_windows(records):
        raise InputError(why)
    model = model or Model.from_card(card)
    flights, outliers = despiked(join(records, card, FLIGHT))
    base = aircraft_dynamics(model, flights)
    fit = in_windows(flights, base)
    if fit.status is OutputErrorStatus.LEFT_ENVELOPE:
        raise InputError(f"card {card.name}: {fit.status.value}")
    whole = field_of(model, flights, (*own_effects(card.effect_files).values(), *extra))
    field = _without_lags(whole)
    state = _state(field, flights, base.altitude, dict(zip(fit.names, fit.estimate, strict=True)))
    found = extend(state, seed=seed, most=most, progress=progress)
    if found.state.active:
        found = _with_lag(whole, found, seed, most, progress) or found
    field = found.state.field
    named = [("trajectories", found)]
    causes, beyond, unnamed = attributed(causes_of(field, named, {}, progress))
    unknown = structure_of(field, named, unnamed)
    return Diagnosis(
        verdict=verdict_of(causes, unknown),
        causes=causes,
        minor=(*found.minor, *(c.name for c in unnamed)),
        unknown=unknown,
        noise=_noise(found, outliers),
        not_testable=field.not_testable,
        sensors=None,
        aerodynamics=found,
        theta=found.state.theta,
        split=split_name(found.state),
        base_moves=moves_of(found),
        notes=() if fit.status is OutputErrorStatus.CONVERGED else (f"The card's model: {fit.status.value}.",),
        together=together_of(named, causes),
        beyond=beyond,
    )


def in_windows(flights: Flights, dynamics: AircraftDynamics) -> OutputErrorResult:
    """The card's model fitted to windows of `WINDOW` s: the first fit that converges, or the best."""
    start = np.array([p.start for p in dynamics.free])
    finer = dynamics.substeps(start, flights)
    found = []
    for seconds in FIRST:
        first, windows = (segments(flights, dynamics, window=w, substeps=finer) for w in (seconds, WINDOW))
        found.append(fit_cascade([first, windows], [start]))
        if found[-1].status is OutputErrorStatus.CONVERGED:
            return found[-1]
    return min(found, key=lambda fit: (fit.status is OutputErrorStatus.LEFT_ENVELOPE, fit.cost))


def _state(
    field: Field, flights: Flights, altitude: bool, values: Mapping[str, float], active: tuple[str, ...] = ()
) -> State:
    """The problem linearised where these parameters have these values and all others are neutral."""
    theta = np.array([values.get(name, field.neutral[name]) for name in field.model.names])
    dynamics = AircraftDynamics(field.model, altitude)
    responses = FlownResponses.of(flights, dynamics, dynamics.substeps(theta, flights))
    return linearised(field, responses, responses.outputs, theta, active)


def _with_lag(whole: Field, found: Extension, seed: int, most: int, progress: Progress | None) -> Extension | None:
    """What is found with a lag of the separation point in from the beginning, if that is decisively better."""
    try:
        with np.errstate(over="raise", invalid="raise", divide="raise"):
            return _lagged(whole, found, seed, most, progress)
    except (FloatingPointError, np.linalg.LinAlgError):
        return None  # the lag fell to none on the way: the state is its static value, and nothing depends on it


def _lagged(whole: Field, found: Extension, seed: int, most: int, progress: Progress | None) -> Extension | None:
    lag = lag_of(whole)
    if lag is None:
        return None
    if progress:
        progress("lag of the separation point", 0.0)
    base = found.base
    values = dict(zip(base.field.model.names, base.theta, strict=True)) | {p.name: p.start for p in lag.parameters}
    responses = base.responses
    assert isinstance(responses, FlownResponses)
    dynamics = responses.windows.dynamics
    assert isinstance(dynamics, AircraftDynamics)
    state, fit = refitted(_state(whole, responses.flights, dynamics.altitude, values, (lag.name,)))
    among = found.steps[0].poll
    gain = (found.base_fit.deviance - fit.deviance) / (2.0 * found.base.temper)
    if not (gain > DECISIVE and between_p_value(state, fit, lag.name, len(among.standings) + 1) <= ALPHA):
        return None  # a lag that is none leaves nothing to linearise
    other = extend(state, seed=seed, most=most - 1, progress=progress)
    if lag.name not in other.state.active or nats_gained(found, other) <= DECISIVE:
        return None
    p = between_p_value(other.state, other.fit, lag.name, len(among.standings) + 1)
    return replace(other, base=base, base_fit=found.base_fit, steps=(Step(lag.name, p, among, np.nan), *other.steps))


def _without_lags(field: Field) -> Field:
    """Without effects that need a state of their own."""
    lags = [e for e in field.candidates if e.stage is Stage.LAG]
    own = {p.name: p.neutral for e in lags for p in e.parameters}
    model = Model(field.model.effects, field.model.parameters, (*field.model.fixed, *own.items()))
    told = {
        e.name: "a lag is a state of its own, tried only where something is missing; give it on the card" for e in lags
    }
    return replace(
        field,
        model=model,
        candidates=tuple(e for e in field.candidates if e not in lags),
        not_testable={**field.not_testable, **told},
    )


def _noise(found: Extension, outliers: Mapping[str, int]) -> NoiseReport:
    """Of the blocks that are left, by output."""
    left = found.state.left(found.fit)
    lag1 = {
        name: float(np.sum(left[1:, c] * left[:-1, c]) / np.sum(left[:, c] ** 2))
        for c, name in enumerate(found.state.outputs)
    }
    deviation = {name: float(left[:, c].std()) for c, name in enumerate(found.state.outputs)}
    return NoiseReport(lag1, deviation, dict.fromkeys(found.state.outputs, 1.0), dict(outliers))
