"""Simulated manoeuvres with effects hidden in them; and a record on request, of any effects and standard manoeuvre."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, TypeAlias, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.sparse.linalg import LinearOperator, lsmr

from bayes_aero.arrays import AnyArray
from bayes_aero.dynamics import trim as steady
from bayes_aero.dynamics.pilot import FlightState, Pilot, fly, standard_pilots
from bayes_aero.effect import Effect, Kind, Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card, read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.model.records import plain_marks
from bayes_aero.physics.aircraft import GAMMA, GAS, NAMES, Aircraft, Axis, Envelope, air, excursion
from bayes_aero.processes import compiled_at
from bayes_aero.simulate import demo

T = TypeVar("T")
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


NOTHING_BEYOND = Beyond((), lambda _: {})


@dataclass(frozen=True)
class HiddenOptions:
    """How effects are hidden.

    `noise`: sensor noise alone (`white`); with autoregressive coefficient disturbances (`ar1`; lag-1 correlation `rho`,
    drawn from 0.5 to 0.98 where not given); the same growing with 1 - X (`buffet`); or sensor noise with spikes of ten
    standard deviations on accelerations and pitch rate (`outliers`). `sensor_noise` and `disturbance` scale them.
    `beyond` adds effects of no catalogue. `seconds` (at most 100) sets the manoeuvres' length; below 90 they break off.
    """

    manoeuvres: int = 2
    noise: str = "ar1"
    rho: float | None = None
    card: Card = field(default_factory=lambda: read_card("attas"))
    sensor_noise: float = 1.0
    disturbance: float = 1.0
    beyond: Beyond = NOTHING_BEYOND
    seconds: float | None = None

    def __post_init__(self) -> None:
        if self.noise not in NOISES:
            raise InputError(f"there is no noise {self.noise!r}; use one of {', '.join(NOISES)}")
        if self.seconds is not None and not 1.0 <= self.seconds <= demo.LONGEST:
            raise InputError(f"a manoeuvre of {self.seconds} s was asked for; ask for 1 to {demo.LONGEST:.0f} s")


def hidden_records(effects: Mapping[str, Mapping[str, float]], *, seed: int, **options: Any) -> list[FlightRecord]:
    """Records alone of `hidden_flights`; `options` are those of `HiddenOptions`."""
    return [flight.record for flight in hidden_flights(effects, seed=seed, **options)]


def hidden_flights(effects: Mapping[str, Mapping[str, float]], *, seed: int, **options: Any) -> list[HiddenFlight]:
    """Random stall manoeuvres of an aircraft near the demo's, in which `effects` (by name, true values) are hidden.

    `options` are those of `HiddenOptions`. Manoeuvre k of a seed is flown with the same commands and draws whatever is
    hidden, unless the flight leaves its envelope: then all are drawn anew, at most twice."""
    setting = HiddenOptions(**options)
    truth = _values(effects, np.random.default_rng([seed, 1]), setting.beyond)
    return _first(3, lambda attempt: _flights(effects, truth, [seed, 2, attempt], setting))


def _first(attempts: int, make: Callable[[int], T]) -> T:
    """What the first attempt makes that raises no `InputError`; the error of the last one."""
    for attempt in range(attempts - 1):
        with contextlib.suppress(InputError):
            return make(attempt)
    return make(attempts - 1)


def _flights(
    effects: Mapping[str, Mapping[str, float]], values: Mapping[str, Any], seed: list[int], setting: HiddenOptions
) -> list[HiddenFlight]:
    card = setting.card
    model, misrecording, propulsion = _models(setting.beyond.effects)
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
        speed = float(np.clip(steady.level_speed(model, values, aircraft, alpha, height, MACH), *BEGIN))
        starts.append(FlightState(speed, alpha, alpha, 0.0, height))
    time = demo.flight_time()
    marks = plain_marks(demo.SAMPLES, demo.DT, 0) | {"elapsed": time}  # from the first sample of the record
    thrust = [corrected(propulsion, values, {"thrust": p.thrust}, marks, card.aircraft)["thrust"] for p in pilots]
    flying = [pilot._replace(thrust=x) for pilot, x in zip(pilots, thrust, strict=True)]
    flights = []
    for number, everything in enumerate(fly(model, values, aircraft, flying, starts, demo.DT)):
        kept = slice(demo.MARGIN, demo.MARGIN + lengths[number])
        flown = {key: x[kept] for key, x in everything.items()}
        if left := ENVELOPE.left_by(excursion(flown)):
            hidden = ", ".join(effects) or "nothing"
            raise InputError(f"with {hidden} hidden the flight leaves its envelope: {left}; make effects smaller")
        # From where a flight breaks down after what is kept it holds its last value: filters would spread the rest.
        sound = np.cumsum(~np.all([np.abs(everything[k]) < 1e6 for k in FLOWN if k != "thrust"], axis=0)) == 0
        true = {key: np.where(sound, everything[key], flown[key][-1]) for key in FLOWN}
        true["thrust"] = pilots[number].thrust  # as it is commanded
        rec = misrecorded(misrecording, values, true, marks, card.aircraft)
        rec = {key: x[kept] for key, x in rec.items()}
        channels = sensed(rngs[number], rec, card, setting.sensor_noise, setting.noise == "outliers")
        name = f"hidden_{seed[0]}_{number + 1}"
        record = FlightRecord.from_arrays(name, time[kept], channels, "simulated with hidden effects")
        built = {key: flown[key] for key in ("CL", "CD", "Cm", "X", "alpha_dot")}
        truth = {key: float(x) for key, x in values.items()}
        flights.append(HiddenFlight(record, {key: flown[key] for key in FLOWN}, built, truth))
    return flights


def flyable(
    names: Sequence[str], *, seed: int, largest: float = 10.0, **options: Any
) -> tuple[dict[str, dict[str, float]], list[HiddenFlight]]:
    """Effects of these names at random sizes, and flights with them hidden. Sizes with which a flight leaves its
    envelope are drawn again from a range half as wide in its logarithm."""

    def hidden(attempt: int):
        rng = np.random.default_rng([seed, 3, attempt])
        effects = {name: draw_hidden(rng, name, largest ** (0.5**attempt)) for name in names}
        return effects, hidden_flights(effects, seed=seed, **options)

    return _first(8, hidden)


def draw_hidden(rng: np.random.Generator, name: str, largest: float = 10.0) -> dict[str, float]:
    """True values of a catalogue effect: departure uniform in its logarithm within `sizes`, either sign where allowed,
    at most `largest` times the least worth modelling; none of the terms of the base aircraft, which every one has."""
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
        Model.of([*(e for e in flyable_effects if steady.can_simulate(e)), *beyond]),
        Model.of([e for e in channel if e.kind is not Kind.PROPULSION]),
        Model.of([e for e in channel if e.kind is Kind.PROPULSION]),
    )


def _values(effects: Mapping[str, Mapping[str, float]], rng: np.random.Generator, beyond: Beyond) -> dict[str, Any]:
    """All parameters: neutral, the base aircraft's drawn around the demo's, then what is hidden."""
    values = {p.name: p.neutral for p in _models(beyond.effects)[0].parameters}
    for name, x in demo.TRUTH.items():
        values[name] = x * (1.0 + rng.uniform(-1.0, 1.0) * demo.SPREAD.get(name, demo.USUAL_SPREAD))
    for name, given in effects.items():
        effect = _known(name)
        steady.refuse_unsimulated(effect)
        if not effect.acts_on(FLOWN_AXES):
            raise InputError(f"the simulated aircraft cannot fly effect {name}: its lateral motion is prescribed")
        names = {p.name for p in effect.parameters}
        if not set(given) <= names:
            raise InputError(f"effect {name} has the parameters {', '.join(sorted(names))}, not {', '.join(given)}")
        values |= given
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


# --- One record on request. Geometry, mass, sensors, their errors that the card fixes, and recorded channels are the
# card's; the aerodynamics are those of the demo aircraft (`demo.TRUTH`) and whatever is asked for. Physical effects act
# in flight, sensor errors when it is recorded.

WIDER_ENVELOPE = Envelope({"alpha": (-0.1, 0.45), "airspeed": (15.0, 300.0)})  # rad, m/s: outside, no truth is claimed
LOADED = 17631.0  # kg, of the aircraft that the random pilot's thrust was chosen for


@dataclass(frozen=True)
class Synthetic:
    """The record, every parameter that was flown, the noise's deviations (SI), and what the user should know."""

    record: FlightRecord
    parameters: Mapping[str, float]
    disturbance: Mapping[str, float]
    sensor_noise: Mapping[str, float]
    notes: tuple[str, ...]


def synthetic(request: demo.Request, card: Card, catalogue: Mapping[str, Effect], name: str = "simulated") -> Synthetic:
    """Fly and record; `catalogue`: the effects that may be asked for. `InputError` where it cannot be flown."""
    demo.refuse(request, card)
    rng = np.random.default_rng([request.seed, 7])
    rigid = Axis.LATERAL in card.axes
    base = (*read_card("attas").effects, *(demo.LATERAL_EFFECTS if rigid else ()))
    # errors of sensors that the card fixes: its model takes them out of every record, so a record has them
    errors = [e for e in map(catalogue.get, card.effects) if e and e.stage is Stage.CHANNEL and e.parameters]
    fixed = [e for e in errors if all(p.name in card.fixed for p in e.parameters)]
    installed = [e.name for e in fixed if not e.absent_in(card.fixed)]
    chosen = [catalogue[n] for n in dict.fromkeys((*base, *installed, *request.effects))]
    axes, signals = (tuple(Axis), steady.SIGNALS | {"aileron"}) if rigid else ((Axis.LONGITUDINAL,), steady.SIGNALS)
    for effect in chosen:
        steady.refuse_unsimulated(effect, signals)
    flown_model = Model.of([e for e in chosen if e.stage is not Stage.CHANNEL], axes=axes)
    faults = [e for e in chosen if e.stage is Stage.CHANNEL]
    values = {name: x for e in chosen for name, x in e.neutral_values.items()}
    values |= demo.TRUTH | demo.LATERAL_TRUTH if rigid else demo.TRUTH
    values |= {p.name: card.fixed[p.name] for n in installed for p in catalogue[n].parameters}
    values |= {p: x for given in request.effects.values() for p, x in given.items()}
    values = {key: jnp.asarray(x, float) for key, x in values.items()}
    aircraft, (time, in_record) = flown_model.actual_aircraft(values, card.aircraft), demo.grid_of(request)
    pilot, start = _piloted(rng, request, time, flown_model, values, aircraft, chosen)
    marks = plain_marks(len(time), request.dt, 0) | {"elapsed": time}  # from the first sample of the record
    commanded = {"thrust": np.asarray(pilot.thrust)}
    engines = Model.of([e for e in faults if e.kind is Kind.PROPULSION], axes=axes)
    if engines.effects:
        pilot = pilot._replace(thrust=corrected(engines, values, commanded, marks, card.aircraft)["thrust"])
    (flight,) = fly(flown_model, values, aircraft, [pilot], [start], request.dt)
    if left := WIDER_ENVELOPE.left_by(excursion({key: x[in_record] for key, x in flight.items()})):
        raise InputError(f"{request.manoeuvre} leaves the envelope: {left}; change effects, --airspeed or --duration")
    true = {key: flight[key] for key in (RIGID if rigid else FLOWN)} | _air_data(flight)
    sensors, recorded = Model.of([e for e in faults if e.kind is not Kind.PROPULSION], axes=axes), true | commanded
    recorded = misrecorded(sensors, values, recorded, marks, card.aircraft) if sensors.effects else recorded
    deviations = OTHER_SENSORS | dict(read_card("attas").sensors) | dict(card.sensors)
    scale = 0.0 if request.noise == "none" else request.noise_scale
    kept = {key: x[in_record] for key, x in recorded.items()}
    channels = sensed(rng, kept, replace(card, sensors=deviations), scale, False)
    missing = [c.name for c in card.channels if c.required and c.name != "time" and c.name not in channels]
    if missing:
        raise InputError(f"card {card.name} requires {missing[0]}, which is not simulated; set required = false")
    noise = {k: x * (request.disturbance if "sigma" in k else 1.0) for k, x in demo.DISTURBANCE.items()}
    record = FlightRecord.from_arrays(name, time[in_record], channels, "simulated")
    return Synthetic(
        record,
        {key: float(x) for key, x in values.items()},
        {"buffet": request.buffet} | noise,
        {key: scale * x for key, x in deviations.items() if key in (*channels, "thrust")},
        _notes(request, catalogue, {key: x[in_record] for key, x in true.items()}),
    )


def _piloted(
    rng: np.random.Generator,
    request: demo.Request,
    time: Float[np.ndarray, " n"],
    model: Model,
    values: Mapping[str, Any],
    aircraft: Aircraft,
    chosen: Sequence[Effect],
) -> tuple[Pilot, FlightState | steady.RigidTrim]:
    """What the pilot does and what disturbs him, and the state in which the flight begins."""
    white = rng.standard_normal((len(time), 3))
    rho, sigma = ([demo.DISTURBANCE[f"{x}_{name}"] for name in NAMES] for x in ("rho", "sigma"))
    rho = [x ** (request.dt / demo.DT) for x in rho]  # their correlation time is the demo's
    increments = demo.autoregressive(white, rho, [request.disturbance * x for x in sigma])
    if request.manoeuvre == demo.RANDOM_STALL:
        drawn = demo.random_pilot(rng, max(90.0, request.seconds), model.break_angle(values), demo.moved_by(chosen))
        pilot = demo.resampled(drawn, time)
        pilot = pilot._replace(thrust=pilot.thrust * (float(aircraft.mass) / LOADED))
        alpha = float(pilot.alpha[0])
        airspeed = request.airspeed or steady.level_speed(model, values, aircraft, alpha, request.altitude)
        start = FlightState(airspeed, alpha, alpha, 0.0, request.altitude)
        if Axis.LATERAL in model.axes:
            start = steady.rigid_trim(model, values, aircraft, steady.Condition(airspeed, request.altitude))
    else:
        airspeed = request.airspeed or steady.level_speed(model, values, aircraft, np.deg2rad(6.0), request.altitude)
        level = steady.Condition(airspeed, request.altitude)
        pilots, start = standard_pilots(model, values, aircraft, time, level, request.amplitude)
        pilot = pilots[request.manoeuvre]
    return pilot._replace(disturbance=increments, buffet=request.buffet), start


def _air_data(flight: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    density, sound = (np.asarray(x) for x in air(flight["altitude"]))
    temperature = sound**2 / (GAMMA * GAS)
    pressure = density * GAS * temperature
    sea_density, sea_sound = (float(x) for x in air(np.zeros(())))
    impact = pressure * ((1.0 + 0.2 * flight["mach"] ** 2) ** 3.5 - 1.0)
    sea_pressure = sea_density * sea_sound**2 / GAMMA
    calibrated = sea_sound * np.sqrt(5.0 * ((impact / sea_pressure + 1.0) ** (2.0 / 7.0) - 1.0))
    air_data = {"static_temperature": temperature, "static_pressure": pressure}
    return air_data | {"calibrated_airspeed": calibrated, "radio_altitude": flight["altitude"]}


def _notes(request: demo.Request, catalogue: Mapping[str, Effect], true: Mapping[str, np.ndarray]) -> tuple[str, ...]:
    """Effects whose signals do not move, so that the record cannot show them, and sizes that no aircraft has."""
    notes = []
    for name in request.effects:
        channels = [] if catalogue[name].stage is Stage.CHANNEL else catalogue[name].channels
        still = [c for c in channels if c in true and np.ptp(true[c]) <= 1e-12]
        if still:
            notes.append(f"effect {name} acts through {', '.join(still)}: at rest in this manoeuvre, so it cannot show")
        for p in catalogue[name].parameters:
            most = catalogue[name].sizes.get(p.name, (0.0, float("inf")))[1]
            if abs(request.effects[name].get(p.name, p.neutral) - p.neutral) > most:
                notes.append(f"{p.name} is beyond {most:g}, the largest plausible departure from {p.neutral:g}")
    return tuple(notes)


# --- From what was flown to what a faulty installation would have recorded: effects of stage CHANNEL run backwards.

Values: TypeAlias = Mapping[str, Any]
Channels: TypeAlias = Mapping[str, np.ndarray]
STEPS = 8
TOLERANCE = 1e-11  # of a channel's largest value


class _Correction(eqx.Module):
    """`Model.corrected` as a function of one matrix, a channel a row, each over its own scale."""

    model: Model = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    values: dict[str, Any]
    marks: dict[str, Any]
    aircraft: Aircraft
    scale: Float[AnyArray, " k"]

    @classmethod
    def of(
        cls, model: Model, values: Values, channels: Channels, marks: Values, aircraft: Aircraft
    ) -> tuple[_Correction, Float[np.ndarray, "k n"]]:
        """The correction, and the channels as its matrix."""
        x = np.stack(list(channels.values()))
        scale = np.maximum(np.max(np.abs(x), axis=1), 1e-3)
        numbers = {name: np.asarray(value, float) for name, value in values.items()}  # a Python number would be static
        return cls(model, tuple(channels), numbers, dict(marks), aircraft, scale), x / scale[:, None]

    @eqx.filter_jit
    def __call__(self, x: Float[AnyArray, "k n"]) -> Float[Array, "k n"]:
        channels = dict(zip(self.names, x * self.scale[:, None], strict=True))
        true = self.model.corrected(self.values, channels | self.marks, self.aircraft)
        return jnp.stack([true[name] for name in self.names]) / self.scale[:, None]

    def derivative(self, x: Float[AnyArray, "k n"]) -> LinearOperator:
        on = lambda product: lambda v: np.asarray(product(self, x, v.reshape(x.shape))).ravel()  # noqa: E731
        return LinearOperator((x.size,) * 2, matvec=on(_forward), rmatvec=on(_backward), dtype=np.float64)  # pyright: ignore[reportCallIssue]


_forward = compiled_at(0)(lambda correction, x, change: jax.jvp(correction, (x,), (change,))[1])
_backward = compiled_at(0)(lambda correction, x, weight: jax.vjp(correction, x)[1](weight)[0])


def corrected(
    model: Model, values: Values, channels: Channels, marks: Values, aircraft: Aircraft
) -> dict[str, np.ndarray]:
    correction, x = _Correction.of(model, values, channels, marks, aircraft)
    return dict(zip(channels, np.asarray(correction(x)) * correction.scale[:, None], strict=True))


def misrecorded(
    model: Model, values: Values, true: Channels, marks: Values, aircraft: Aircraft
) -> dict[str, np.ndarray]:
    """Channels that `Model.corrected` turns into `true`. Gauss-Newton steps from the true channels, each solved for the
    least change (LSMR: Fong and Saunders, SIAM J. Sci. Comput. 33 (2011) 2950). A plain fixed-point iteration would
    blow up what a delay leaves near half the sampling rate, where it cannot be undone."""
    correction, goal = _Correction.of(model, values, true, marks, aircraft)
    x, left, options = goal, 0.0, {"atol": 1e-13, "btol": 1e-13, "conlim": 0.0, "maxiter": 300}
    for _ in range(STEPS):
        error = goal - np.asarray(correction(x))
        # What LSMR could not solve another step cannot either: it is what a delay has lost. Curvature leaves more.
        if np.max(np.abs(error)) < TOLERANCE or np.linalg.norm(error) < 2.0 * left:
            break
        error = np.where(np.abs(error) < 1e-14, 0.0, error)  # rounding, in channels that no effect touches
        step, _, _, left, *_ = lsmr(correction.derivative(x), error.ravel(), **options)
        x = x + step.reshape(x.shape)
    change = (x - goal) * correction.scale[:, None]
    return {name: series + dx for (name, series), dx in zip(true.items(), change, strict=True)}


# --- What a recorder stores of a simulated flight: channels by the card's names, with the noise of their sensors.

OTHER_SENSORS = {
    "ay": 0.02, "phi": 3e-4, "theta": 3e-4, "psi": 3e-4, "beta": 9e-4, "altitude": 0.5, "elevator": 3e-4,
    "stabilizer": 2e-4, "mach": 6e-4,
}  # fmt: skip
"""White noise of channels of which a card says nothing, SI: platform, vane, potentiometers; our choice."""

FLOWN = (  # channels of a flight that a recorder may store, in the order in which their noise is drawn
    "ax", "ay", "az", "p", "r", "elevator", "q", "phi", "theta", "psi", "alpha", "beta", "airspeed", "altitude",
    "stabilizer", "rudder", "flap", "spoiler_left", "spoiler_right", "dlc_left", "dlc_right", "mach", "density",
    "thrust",
)  # fmt: skip
RIGID = (*FLOWN, "aileron", "aileron_left", "aileron_right")  # those of a flight in six degrees of freedom

OUTLIER_SHARE, OUTLIER_SIZE, SPIKED = 0.005, 10.0, ("ax", "ay", "az", "q")


def sensed(
    rng: np.random.Generator, channels: Mapping[str, np.ndarray], card: Card, scale: float, spikes: bool
) -> dict[str, np.ndarray]:
    """With sensor noise, thrust by engine, outliers; the channels that the card maps."""
    engines = {f"thrust_{side}": channels["thrust"] / 2.0 for side in ("left", "right")}
    engine = card.sensors.get("thrust", 0.0) / math.sqrt(2.0)  # each
    deviations: dict[str, float] = {**OTHER_SENSORS, **card.sensors, **dict.fromkeys(engines, engine)}
    mapped = {channel.name for channel in card.channels}
    sensed = {}
    for name, values in (dict(channels) | engines).items():
        n, sd = len(values), scale * deviations.get(name, 0.0)
        noisy = values + sd * rng.standard_normal(n)
        hit, sign = rng.uniform(size=n) < OUTLIER_SHARE, rng.choice([-1.0, 1.0], n)
        if spikes and name in SPIKED:
            noisy = noisy + OUTLIER_SIZE * sd * hit * sign
        if name in mapped:
            sensed[name] = noisy
    return sensed
