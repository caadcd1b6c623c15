"""One synthetic record on request: any effects at given sizes, any standard manoeuvre, on the aircraft of a card.

Geometry, mass, sensors and recorded channels are the card's; the aerodynamics are those of the demo aircraft
(`demo.TRUTH`) and whatever is asked for. Physical effects act in flight, sensor errors when it is recorded.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

from bayes_aero.dynamics.plant import refuse_unflown
from bayes_aero.dynamics.simulate import fly
from bayes_aero.effect import Effect, Kind, Stage
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card, read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.physics.atmosphere import air
from bayes_aero.simulate.demo import DISTURBANCE, TRUTH
from bayes_aero.simulate.manoeuvres import DT
from bayes_aero.simulate.pilot_model import piloted
from bayes_aero.simulate.request import Grid, Request, grid_of, refuse
from bayes_aero.simulate.sensor_faults import corrected, misrecorded
from bayes_aero.simulate.sensor_model import OTHER_SENSORS, channels_flown, sensed

BUFFET = 2.0  # growth of the disturbance with 1 - X
ALPHA, AIRSPEED = (-0.1, 0.45), (15.0, 300.0)  # rad, m/s: outside, no truth is claimed
GAS, GAMMA = 287.05287, 1.4


@dataclass(frozen=True)
class Synthetic:
    """The record, every parameter that was flown, the noise's deviations (SI), and what the user should know."""

    record: FlightRecord
    parameters: Mapping[str, float]
    disturbance: Mapping[str, float]
    sensor_noise: Mapping[str, float]
    notes: tuple[str, ...]


def synthetic(request: Request, card: Card, known: Mapping[str, Effect], name: str = "simulated") -> Synthetic:
    """Fly and record; `known` are the effects that may be asked for. `InputError` where it cannot be flown."""
    refuse(request, card)
    rng = np.random.default_rng([request.seed, 7])
    base = read_card("attas").effects
    chosen = [known[n] for n in dict.fromkeys((*base, *request.effects))]
    for effect in chosen:
        refuse_unflown(effect)
    flown_model = Model.of([e for e in chosen if e.stage is not Stage.CHANNEL])
    faults = [e for e in chosen if e.stage is Stage.CHANNEL]
    values = {name: x for e in chosen for name, x in e.neutral_values.items()} | TRUTH
    values |= {p: x for given in request.effects.values() for p, x in given.items()}
    values = {key: jnp.asarray(x, float) for key, x in values.items()}
    aircraft = flown_model.actual_aircraft(values, card.aircraft)
    grid = grid_of(request)
    increments, buffet = _disturbance(rng, request, grid)
    pilot, start = piloted(rng, request, grid, flown_model, values, aircraft, increments, buffet, chosen)
    marks = _marks(grid)
    commanded = {"thrust": np.asarray(pilot.thrust)}
    engines = Model.of([e for e in faults if e.kind is Kind.PROPULSION])
    thrust = corrected(engines, values, commanded, marks, card.aircraft)["thrust"] if engines.effects else None
    thrust = commanded["thrust"] if thrust is None else thrust
    states, outputs = fly(
        flown_model, values, aircraft, pilot._replace(thrust=jnp.asarray(thrust)), start, jnp.asarray(grid.dt)
    )
    state = {key: np.asarray(x) for key, x in states._asdict().items()}
    flown = {key: np.asarray(x) for key, x in outputs.items()}
    _inside(state, grid.kept, request)
    true = channels_flown(state, flown, pilot, thrust) | _more(state, flown, grid.dt)
    sensors = Model.of([e for e in faults if e.kind is not Kind.PROPULSION])
    recorded = true | commanded
    if sensors.effects:
        recorded = misrecorded(sensors, values, recorded, marks, card.aircraft)
    deviations = OTHER_SENSORS | dict(read_card("attas").sensors) | dict(card.sensors)
    scale = 0.0 if request.noise == "none" else request.noise_scale
    channels = sensed(
        rng, {key: x[grid.kept] for key, x in recorded.items()}, replace(card, sensors=deviations), scale, False
    )
    missing = [c.name for c in card.channels if c.required and c.name != "time" and c.name not in channels]
    if missing:
        raise InputError(
            f"card {card.name} requires channel {missing[0]}, which the simulator does not make; set required = false"
        )
    record = FlightRecord.from_arrays(name, grid.time[grid.kept], channels, "simulated")
    return Synthetic(
        record,
        {key: float(x) for key, x in values.items()},
        {"buffet": buffet} | {k: x * (k[:5] != "sigma" or _strength(request)) for k, x in DISTURBANCE.items()},
        {key: scale * x for key, x in deviations.items() if key in (*channels, "thrust")},
        _notes(request, known, {key: x[grid.kept] for key, x in true.items()}),
    )


def _strength(request: Request) -> float:
    return request.noise_scale if request.noise in ("ar1", "buffet") else 0.0


def _disturbance(rng: np.random.Generator, request: Request, grid: Grid) -> tuple[Float[np.ndarray, "n 3"], float]:
    """Coloured increments of CL, CD, Cm as in the demo, their correlation time kept at any sampling interval."""
    white = rng.standard_normal((grid.n, 3))
    columns = []
    for x, name in zip(white.T, ("CL", "CD", "Cm"), strict=True):
        rho = DISTURBANCE[f"rho_{name}"] ** (grid.dt / DT)
        drive = np.concatenate([x[:1], np.sqrt(1.0 - rho**2) * x[1:]])
        columns.append(
            _strength(request) * DISTURBANCE[f"sigma_{name}"] * np.asarray(lfilter([1.0], [1.0, -rho], drive))
        )
    return np.stack(columns, axis=1), BUFFET if request.noise == "buffet" else 0.0


def _marks(grid: Grid) -> dict[str, Any]:
    """What CHANNEL effects read, beyond the ends too: time counts from the first sample of the record."""
    index = jnp.arange(grid.n)
    ends = {"first": jnp.zeros(grid.n, int), "last": jnp.full(grid.n, grid.n - 1)}
    return {"dt": jnp.full(grid.n, grid.dt), "start": index == 0, "elapsed": jnp.asarray(grid.time)} | ends


def _more(state: Mapping[str, np.ndarray], flown: Mapping[str, np.ndarray], dt: float) -> dict[str, np.ndarray]:
    """Heading at any sampling interval, and air data that follow from height and airspeed in a standard atmosphere."""
    turn = flown["psi_dot"]
    density, sound = (np.asarray(x) for x in air(jnp.asarray(state["h"])))
    temperature = sound**2 / (GAMMA * GAS)
    pressure = density * GAS * temperature
    sea_density, sea_sound = (float(x) for x in air(jnp.asarray(0.0)))
    impact = pressure * ((1.0 + 0.2 * (state["V"] / sound) ** 2) ** 3.5 - 1.0)
    sea_pressure = sea_density * sea_sound**2 / GAMMA
    calibrated = sea_sound * np.sqrt(5.0 * ((impact / sea_pressure + 1.0) ** (2.0 / 7.0) - 1.0))
    return {
        "psi": np.concatenate([[0.0], np.cumsum(0.5 * dt * (turn[1:] + turn[:-1]))]),
        "static_temperature": temperature,
        "static_pressure": pressure,
        "calibrated_airspeed": calibrated,
        "radio_altitude": state["h"],
    }


def _inside(state: Mapping[str, np.ndarray], kept: slice, request: Request) -> None:
    for name, series, (lower, upper) in (("alpha", state["alpha"], ALPHA), ("airspeed", state["V"], AIRSPEED)):
        x = series[kept]
        if not (np.all(np.isfinite(x)) and x.min() >= lower and x.max() <= upper):
            raise InputError(
                f"{request.manoeuvre} with {', '.join(request.effects) or 'no effect'} leaves the envelope: {name} "
                f"{x.min():.3g} to {x.max():.3g} (allowed {lower:g} to {upper:g}); make the effects smaller, or change "
                "the manoeuvre, --airspeed or --duration"
            )


def _notes(request: Request, known: Mapping[str, Effect], true: Mapping[str, np.ndarray]) -> tuple[str, ...]:
    """Effects whose signals do not move, so that the record cannot show them, and sizes that no aircraft has."""
    notes = []
    for name in request.effects:
        channels = [] if known[name].stage is Stage.CHANNEL else known[name].channels
        still = [c for c in channels if c in true and np.ptp(true[c]) <= 1e-12]
        if still:
            notes.append(f"effect {name} acts through {', '.join(still)}: at rest in this manoeuvre, so it cannot show")
        for p in known[name].parameters:
            most = known[name].sizes.get(p.name, (0.0, float("inf")))[1]
            if abs(request.effects[name].get(p.name, p.neutral) - p.neutral) > most:
                notes.append(f"{p.name} is beyond {most:g}, the largest plausible departure from {p.neutral:g}")
    return tuple(notes)
