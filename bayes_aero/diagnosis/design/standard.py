"""The standard manoeuvres, flown by a model that is identified so far, as records of the same channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.design.information import Information, Noise, information_of
from bayes_aero.diagnosis.screening.selection_state import SelectionState, linearised
from bayes_aero.dynamics.simulated.manoeuvres import ANYWHERE, EXCITED_CHANNELS, fly_standard
from bayes_aero.dynamics.simulated.rigid_manoeuvres import LATERAL_EXCITED_CHANNELS, fly_rigid_standard
from bayes_aero.effect import Effect, Stage
from bayes_aero.errors import InputError
from bayes_aero.flight.axes import Axis
from bayes_aero.flight.envelope import Envelope, excursion
from bayes_aero.model.joined_channels import Flights
from bayes_aero.model.joined_records import Recorded
from bayes_aero.model.model import Model
from bayes_aero.model.observations import marks
from bayes_aero.physics.atmosphere import altitude_of_density
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.residuals.flight_path import flight_path

BEGINNING = 2.0  # s of the record whose means are the flight condition


@dataclass(frozen=True)
class Standard:
    """The standard manoeuvres as a state's model flies them.

    `theta` are the values flown; `seconds` until the response to the last input is recorded, `excursion` the least and
    greatest of the envelope's quantities, SI; `refused` says which manoeuvre could not be flown, and why. `airspeed`
    (m/s) and `altitude` (m) are those of the level flight in which all begin, `amplitude` multiplied every input.
    """

    model: Model
    theta: Mapping[str, float]
    flown: Mapping[str, Flights]
    seconds: Mapping[str, float]
    excursion: Mapping[str, Mapping[str, tuple[float, float]]]
    refused: Mapping[str, str]
    airspeed: float
    altitude: float
    amplitude: float


def standard(
    state: SelectionState,
    effects: Sequence[str],
    *,
    amplitude: float = 1.0,
    faster: float = 1.0,
    envelope: Envelope = ANYWHERE,
) -> Standard:
    """Fly the standard manoeuvres with the effects that are in, and with those of `effects` that are candidates.

    A model of both axes flies them in six degrees of freedom, and those of the lateral axis too.

    `amplitude` multiplies every input, `faster` the airspeed with which the records begin. What the record itself gets
    wrong (sensors, thrust) is flown as at neutral.
    """
    rigid = Axis.LATERAL in state.full.model.axes
    if rigid and Axis.LONGITUDINAL not in state.full.model.axes:
        raise InputError(
            "test points are flown from level flight, for which the card has no lift and drag; "
            'add "longitudinal" to [model] axes'
        )
    small = narrowed(state, effects)
    true = state.full.at_neutral(state.theta, [e.name for e in small.effects if e.stage is Stage.CHANNEL])
    theta = {n: x for n, x in zip(state.full.model.names, true, strict=True) if n in small.names}
    values, flights = dict(small.fixed) | theta, state.responses.flights
    begin = round(BEGINNING * 5 / state.responses.seconds)
    start = _start({name: float(np.mean(np.asarray(x)[:begin])) for name, x in flights.channels.items()})
    start["airspeed"] *= faster
    dt = float(np.median(np.asarray(flights.channels["dt"])))
    aircraft = small.actual_aircraft(values, flights.aircraft)
    found = (fly_rigid_standard if rigid else fly_standard)(
        small, values, aircraft, **start, dt=dt, amplitude=amplitude, envelope=envelope
    )
    moved = EXCITED_CHANNELS | (LATERAL_EXCITED_CHANNELS if rigid else {})
    unseen = {n: moved[n] for n in found.channels if n in moved and moved[n] not in flights.recorded}
    flown = {n: _recorded(flights, channels, dt) for n, channels in found.channels.items() if n not in unseen}
    return Standard(
        small,
        theta,
        flown,
        found.seconds,
        {n: excursion(found.channels[n]) for n in flown},
        dict(found.refused) | {n: f"{channel} was not recorded" for n, channel in unseen.items()},
        start["airspeed"],
        start["altitude"],
        amplitude,
    )


def flights_of(state: SelectionState) -> Flights:
    """The records of a diagnosis by coefficients. Raises `InputError` for any other."""
    flights = state.responses.flights
    if not isinstance(flights, Flights):
        raise InputError("the records were not compared by coefficients, so manoeuvres cannot be judged by them")
    return flights


def _start(mean: Mapping[str, float]) -> dict[str, float]:
    """Airspeed, m/s, and altitude, m: where none was recorded, that of standard air of the record's density."""
    altitude = mean["altitude"] if "altitude" in mean else altitude_of_density(mean["density"])
    return {"airspeed": mean["airspeed"], "altitude": altitude}


def narrowed(state: SelectionState, chosen: Sequence[str]) -> Model:
    """The card's effects, those that are in, those chosen, and those without parameters: less to compile."""
    kept = {*state.full.base, *state.active, *chosen}
    effects = tuple(e for e in state.full.model.effects if e.name in kept or not e.parameters)
    names = {p.name for e in effects for p in e.parameters}
    fixed = tuple((k, x) for k, x in state.full.model.fixed if k in names)
    own = tuple(p for p in state.full.model.parameters if p.name in names)
    return replace(state.full.model, effects=effects, parameters=own, fixed=fixed)


def _recorded(like: Recorded, channels: Mapping[str, np.ndarray], dt: float) -> Flights:
    """One manoeuvre with the channels of a record; a channel that the simulator does not make keeps its mean."""
    n = len(channels["alpha"])
    own = {
        name: jnp.asarray(channels[name]) if name in channels else jnp.full(n, jnp.mean(like.channels[name]))
        for name in like.recorded
    }
    time = np.arange(n) * dt
    return Flights(own | marks(n, dt), like.aircraft, np.zeros(n, int), time, (n,), ("standard",))


@dataclass(frozen=True)
class Linearised:
    """A model linearised on a record, all outputs together, and the noise of these."""

    state: SelectionState
    noise: Noise
    chosen: tuple[Effect, ...]

    def information(self, seconds: float | None = None) -> Information:
        """Of the record, or of its first `seconds`."""
        blocks = None if seconds is None else round(seconds / self.state.responses.seconds)
        return information_of(self.state, self.noise, self.chosen, blocks)


def of_records(state: SelectionState, chosen: Sequence[Effect], noise: Noise) -> Linearised:
    """The present records, linearised at the parameters of the state, with the `chosen` effects as candidates."""
    flights_of(state)
    full = replace(state.full, candidates=tuple(chosen))
    known = state if state.outputs == noise.outputs else None
    return _linearised(replace(state, full=full), state.theta, noise, known)


def on_record(
    state: SelectionState,
    model: Model,
    flights: Flights,
    theta: Mapping[str, float],
    chosen: Sequence[Effect],
    noise: Noise,
) -> Linearised:
    """The problem linearised on a record at `theta`, in which the `chosen` effects are candidates."""
    path = tuple(name for name in noise.outputs if name not in model.coefficients)
    responses = replace(EquationError.of(flights, model), path=path)  # the same outputs everywhere: compiled once
    seen = noise.of((*model.coefficients, *flight_path(flights)))  # with wings level: nothing of sideslip and bank
    full = replace(state.full, model=model, candidates=tuple(chosen))
    there = replace(state, full=full, responses=responses)
    return _linearised(there, np.array([theta[name] for name in model.names]), seen)


def _linearised(
    state: SelectionState, theta: Float[np.ndarray, " k"], noise: Noise, known: SelectionState | None = None
) -> Linearised:
    """Model, candidates and record of `state` at `theta`; what is `known` there is not computed again."""
    full, responses = state.full, state.responses
    active = tuple(e for e in state.active if e not in {c.name for c in full.candidates})
    inflation = state.variance_inflation
    there = linearised(full, responses, noise.outputs, theta, active, variance_inflation=inflation, known=known)
    X = np.asarray(responses.block(responses.evaluate(jnp.asarray(theta))[1]["X"]))
    return Linearised(replace(there, noise_growth=1.0 + noise.growth * (1.0 - X[:, None])), noise, full.candidates)
