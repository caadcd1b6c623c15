"""Simulated manoeuvres with effects hidden in them, known to the simulator and not to the card."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from bayes_aero.dynamics.pilot import fly_together
from bayes_aero.dynamics.trim import FlightState, can_simulate, level_speed, refuse_unsimulated
from bayes_aero.effect import Effect, Kind, Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card, read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.model.records import plain_marks
from bayes_aero.physics.aircraft import Axis, Envelope, excursion
from bayes_aero.simulate import demo
from bayes_aero.simulate.synthetic_record import FLOWN, corrected, misrecorded, sensed

FLOWN_AXES = (Axis.LONGITUDINAL,)  # axes on which the simulated aircraft has effects
NOISES = ("white", "ar1", "buffet", "outliers")
BEGIN, MACH = (80.0, 110.0), 0.3  # m/s, range of the first airspeed, and the Mach number taken for it
ENVELOPE = Envelope({"alpha": (0.0, 0.4363), "airspeed": (50.0, 130.0)})  # 0 to 25 deg, m/s


@dataclass(frozen=True)
class HiddenFlight:
    """A record; the channels and coefficients (CL, CD, Cm, X) that were flown; every parameter of the truth."""

    record: FlightRecord
    true: Mapping[str, np.ndarray]
    flown: Mapping[str, np.ndarray]
    values: Mapping[str, float]


@dataclass(frozen=True)
class Beyond:
    """Effects of no catalogue that are flown besides, and a draw of the true values of those that are not neutral."""

    effects: tuple[Effect, ...]
    draw: Callable[[np.random.Generator], Mapping[str, float]]


@dataclass(frozen=True)
class _Setting:
    seed: int
    manoeuvres: int
    noise: str
    rho: float | None
    card: Card
    sensor_noise: float
    disturbance: float
    seconds: float | None
    beyond: tuple[Effect, ...]


def hidden_records(effects: Mapping[str, Mapping[str, float]], *, seed: int, **options: Any) -> list[FlightRecord]:
    """Records alone of `hidden_flights`, which explains the options."""
    return [flight.record for flight in hidden_flights(effects, seed=seed, **options)]


def hidden_flights(
    effects: Mapping[str, Mapping[str, float]],
    *,
    seed: int,
    manoeuvres: int = 2,
    noise: str = "ar1",
    rho: float | None = None,
    card: Card | None = None,
    sensor_noise: float = 1.0,
    disturbance: float = 1.0,
    beyond: Beyond | None = None,
    seconds: float | None = None,
) -> list[HiddenFlight]:
    """Random stall manoeuvres of an aircraft near the demo's, in which `effects` (by name, true values) are hidden.

    `noise`: sensor noise alone (`white`); with autoregressive coefficient disturbances (`ar1`; lag-1 correlation `rho`,
    drawn from 0.5 to 0.98 where not given); the same growing with 1 - X (`buffet`); or sensor noise with spikes of ten
    standard deviations on accelerations and pitch rate (`outliers`). `sensor_noise` and `disturbance` scale them.
    `beyond` adds effects of no catalogue. Manoeuvre k of a seed is flown with the same commands and draws whatever is
    hidden, unless the flight leaves its envelope: then all are drawn anew, and after the third time `InputError` says
    that the aircraft cannot be flown so. `seconds` (at most 100) sets the manoeuvres' length; below 90 they break off.
    """
    if noise not in NOISES:
        raise InputError(f"there is no noise {noise!r}; use one of {', '.join(NOISES)}")
    if seconds is not None and not 1.0 <= seconds <= demo.LONGEST:
        raise InputError(f"a simulated manoeuvre of {seconds} s was asked for; ask for 1 to {demo.LONGEST:.0f} s")
    besides, card = () if beyond is None else beyond.effects, card or read_card("attas")
    truth = _values(effects, np.random.default_rng([seed, 1]), beyond)
    setting = _Setting(seed, manoeuvres, noise, rho, card, sensor_noise, disturbance, seconds, besides)
    failure = InputError("")
    for attempt in range(3):
        try:
            return _flights(effects, truth, [seed, 2, attempt], setting)
        except InputError as error:
            failure = error
    raise failure


def _flights(
    effects: Mapping[str, Mapping[str, float]], values: Mapping[str, Any], seed: list[int], setting: _Setting
) -> list[HiddenFlight]:
    card = setting.card
    model, misrecording, propulsion = _models(setting.beyond)
    aircraft = model.actual_aircraft(values, card.aircraft)
    moved = demo.moved_by(_known(name) for name in effects)
    rngs = [np.random.default_rng([*seed, number]) for number in range(setting.manoeuvres)]
    drawn = [rng.uniform(90.0, demo.LONGEST) for rng in rngs]
    lengths = [round((setting.seconds or length) / demo.DT) + 1 for length in drawn]
    pilots, starts = [], []
    for rng, length in zip(rngs, lengths, strict=True):
        disturbance, buffet = _disturbance(rng, setting.noise, setting.rho)
        pilot = demo.random_pilot(rng, max(90.0, (length - 1) * demo.DT), model.break_angle(values), moved)
        pilots.append(pilot._replace(disturbance=setting.disturbance * disturbance, buffet=buffet))
        alpha, height = float(pilot.alpha[0]), rng.uniform(5050.0, 5350.0)
        speed = float(np.clip(level_speed(model, values, aircraft, alpha, height, MACH), *BEGIN))
        starts.append(FlightState(speed, alpha, alpha, 0.0, height))
    time = demo.flight_time()
    marks = plain_marks(demo.SAMPLES, demo.DT, 0) | {"elapsed": time}  # from the first sample of the record
    commanded = [{"thrust": pilot.thrust} for pilot in pilots]
    thrust = [corrected(propulsion, values, x, marks, card.aircraft)["thrust"] for x in commanded]
    flying = [pilot._replace(thrust=x) for pilot, x in zip(pilots, thrust, strict=True)]
    flights = []
    for number, everything in enumerate(fly_together(model, values, aircraft, flying, starts, demo.DT)):
        kept = slice(demo.MARGIN, demo.MARGIN + lengths[number])
        flown = {key: x[kept] for key, x in everything.items()}
        if left := ENVELOPE.left_by(excursion(flown)):
            raise InputError(
                f"with {', '.join(effects) or 'nothing hidden'} at these sizes the flight leaves its envelope: {left}; "
                "make them smaller"
            )
        # a flight that breaks down after what is kept holds its last value: filters would spread NaN
        true = {key: np.where(np.isfinite(everything[key]), everything[key], flown[key][-1]) for key in FLOWN}
        rec = misrecorded(misrecording, values, true | commanded[number], marks, card.aircraft)
        rec = {key: x[kept] for key, x in rec.items()}
        channels = sensed(rngs[number], rec, card, setting.sensor_noise, setting.noise == "outliers")
        name = f"hidden_{setting.seed}_{number + 1}"
        flights.append(
            HiddenFlight(
                FlightRecord.from_arrays(name, time[kept], channels, "simulated with hidden effects"),
                {key: flown[key] for key in FLOWN},
                {key: flown[key] for key in ("CL", "CD", "Cm", "X", "alpha_dot")},
                {key: float(x) for key, x in values.items()},
            )
        )
    return flights


def flyable(
    names: Sequence[str], *, seed: int, largest: float = 10.0, **options: Any
) -> tuple[dict[str, dict[str, float]], list[HiddenFlight]]:
    """Effects of these names at random sizes, and the flights in which they hide.

    Sizes with which the flight leaves its envelope are drawn again from a range half as wide in its logarithm.
    """
    failure = InputError("")
    for attempt in range(8):
        rng = np.random.default_rng([seed, 3, attempt])
        effects = {name: draw_hidden(rng, name, largest ** (0.5**attempt)) for name in names}
        try:
            return effects, hidden_flights(effects, seed=seed, **options)
        except InputError as error:
            failure = error
    raise failure


def draw_hidden(rng: np.random.Generator, name: str, largest: float = 10.0) -> dict[str, float]:
    """True values of a catalogue effect: departure uniform in its logarithm within `sizes`, either sign where allowed.

    No departure is more than `largest` times the least worth modelling. The terms of the base aircraft are in every
    flight; for them the dictionary is empty.
    """
    effect, values = _known(name), {}
    for parameter in effect.parameters:
        if demo.TRUTH.get(parameter.name, parameter.neutral) != parameter.neutral:
            continue
        least, most = effect.sizes[parameter.name]
        size = least * np.exp(rng.uniform(0.0, np.log(min(most / least, largest))))
        lower, upper = parameter.bounds
        allowed = [x for x in (parameter.neutral + size, parameter.neutral - size) if lower < x < upper]
        values[parameter.name] = float(rng.choice(allowed))
    return values


def _known(name: str) -> Effect:
    if name not in CATALOGUE:
        raise InputError(f"there is no effect {name!r} to hide; the catalogue has {', '.join(CATALOGUE)}")
    return CATALOGUE[name]


@cache
def _models(beyond: tuple[Effect, ...]) -> tuple[Model, Model, Model]:
    """Flown, misrecording and thrust: one model each for whatever is hidden, so that each compiles once."""
    flyable_effects = [e for e in CATALOGUE.values() if e.acts_on(FLOWN_AXES)]
    channel = [e for e in flyable_effects if e.stage is Stage.CHANNEL]
    return (
        Model.of([*(e for e in flyable_effects if can_simulate(e)), *beyond]),
        Model.of([e for e in channel if e.kind is not Kind.PROPULSION]),
        Model.of([e for e in channel if e.kind is Kind.PROPULSION]),
    )


def _values(
    effects: Mapping[str, Mapping[str, float]], rng: np.random.Generator, beyond: Beyond | None
) -> dict[str, Any]:
    """All parameters: neutral, the base aircraft's drawn around the demo's, then what is hidden."""
    values = {p.name: p.neutral for p in _models(() if beyond is None else beyond.effects)[0].parameters}
    for name, x in demo.TRUTH.items():
        values[name] = x * (1.0 + rng.uniform(-1.0, 1.0) * demo.SPREAD.get(name, demo.USUAL_SPREAD))
    for name, given in effects.items():
        effect = _known(name)
        refuse_unsimulated(effect)
        if not effect.acts_on(FLOWN_AXES):
            raise InputError(f"the simulated aircraft cannot fly effect {name}: its lateral motion is prescribed")
        names = {p.name for p in effect.parameters}
        if not set(given) <= names:
            raise InputError(f"effect {name} has the parameters {', '.join(sorted(names))}, not {', '.join(given)}")
        values |= given
    if beyond is not None:
        values |= beyond.draw(rng)
    return {name: np.float64(x) for name, x in values.items()}


def _disturbance(rng: np.random.Generator, noise: str, rho: float | None) -> tuple[np.ndarray, float]:
    """Increments of CL, CD, Cm over the flight, and how they grow with 1 - X; the same draws for every noise."""
    white = rng.standard_normal((demo.SAMPLES, 3))
    drawn = rng.uniform(0.5, 0.98, 3)
    rhos = drawn if rho is None else np.full(3, rho)
    sigma = np.array([demo.DISTURBANCE[f"sigma_{name}"] for name in ("CL", "CD", "Cm")]) * rng.uniform(0.6, 1.4, 3)
    buffet = rng.uniform(1.0, 3.0)
    if noise not in ("ar1", "buffet"):
        return np.zeros((demo.SAMPLES, 3)), 0.0
    return demo.autoregressive(white, rhos, sigma), buffet if noise == "buffet" else 0.0
