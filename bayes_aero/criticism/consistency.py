"""Do the sensors agree? An answer in absolute terms, before any aerodynamics, with the known error that explains it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from bayes_aero.criticism.accuracy import Size
from bayes_aero.criticism.credibility import implausible
from bayes_aero.criticism.extension import Extension
from bayes_aero.criticism.finding import Diagnosis
from bayes_aero.criticism.path_check import path_check
from bayes_aero.criticism.sensors import SENSOR_KINDS, as_the_card_states, compatibility, with_corrections
from bayes_aero.effect import Effect
from bayes_aero.errors import InputError
from bayes_aero.flight.agreement import Agreement, Consistency, PathCheck
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.flights import Flights, despiked, join
from bayes_aero.model.model import Model
from bayes_aero.physics.flightpath import PATH_NEEDS

CORE = ("ax", "az", "q", "theta", "alpha", "airspeed")  # without these nothing of the flight path can be checked
LEVEL = np.radians(5.0)  # of bank: wings that move less count as level where bank was not recorded
SHORTEST = 4.0  # s of a record that can be checked


@dataclass(frozen=True)
class KnownErrors:
    """Errors of the record that were found: effects of stage CHANNEL, and plain data of each (see `Consistency`)."""

    effects: tuple[Effect, ...]
    errors: Mapping[str, Mapping[str, Any]]


def consistency(
    records: Sequence[FlightRecord], card: Card, *, seed: int = 0, seek: bool = True, known: KnownErrors | None = None
) -> Consistency:
    """Check the flight path of each record in absolute terms.

    Args:
        records: the manoeuvres.
        card: says the sensors' noise, where the accelerometer is, and which errors of sensors are corrected already.
        seed: of the records of noise.
        seek: where sensors disagree, look for the known error that explains it (some seconds).
        known: the search's result, where it has been done.
    """
    if why := _impossible(records, card):
        return Consistency(why)
    flights, _ = despiked(as_the_card_states(join(records, card, CORE), card))
    unchecked = tuple(n for n in ("altitude", "beta", "phi") if n not in flights.channels)
    found = Consistency("", unchecked, checks(flights, card, seed))
    if found.agreement is Agreement.AGREE:
        return found if known is None else replace(found, errors=known.errors)
    if known is None:
        if not seek:
            return found
        try:
            known = errors_of_path(compatibility(list(records), card, seed=seed))
        except InputError as reason:
            return replace(found, unsought=str(reason))
    if not known.effects:
        return replace(found, errors=known.errors)
    model = Model.of(known.effects)
    values = {p: jnp.asarray(x["mean"]) for e in known.errors.values() for p, x in e["parameters"].items()}
    return replace(found, errors=known.errors, corrected=checks(with_corrections(flights, model, values), card, seed))


def errors_of_path(known: Extension) -> KnownErrors:
    """Errors of sensors and winds that a search along the flight path has found, minor ones included.

    One at a parameter bound, or larger than sensors have, explains nothing: another cause is behind it.
    """
    named, neutral = {e.name: e for e in known.state.field.candidates}, known.state.field.neutral
    found = [
        named[name]
        for name in (*known.causes, *known.minor)
        if not implausible(named[name], known.sizes, neutral)
        and not any(known.sizes[p.name].at_bound for p in named[name].parameters)
    ]
    return KnownErrors(tuple(found), {e.name: _plain(e, known.sizes, minor=e.name in known.minor) for e in found})


def errors_of_diagnosis(found: Diagnosis) -> KnownErrors:
    """Errors of the record that a diagnosis has confirmed, by the flight path or by the coefficients."""
    named = {e.name: e for e in found.aerodynamics.state.field.model.effects}
    causes = {c.name: c for c in found.causes if c.sure and named[c.name].kind in SENSOR_KINDS}
    return KnownErrors(
        tuple(named[name] for name in causes),
        {name: _plain(named[name], cause.parameters, minor=False) for name, cause in causes.items()},
    )


def _plain(effect: Effect, sizes: Mapping[str, Size], *, minor: bool) -> dict[str, Any]:
    parameters = {
        p.name: {"mean": sizes[p.name].mean, "sd": sizes[p.name].sd, "unit": p.unit} for p in effect.parameters
    }
    return {"claim": effect.claim, "minor": minor, "parameters": parameters}


def checks(flights: Flights, card: Card, seed: int) -> tuple[PathCheck, ...]:
    """`path_check` of each manoeuvre."""
    found, begin = [], 0
    for name, length in zip(flights.names, flights.lengths, strict=True):
        part = slice(begin, begin + length)
        channels = {n: np.asarray(x)[part] for n, x in flights.channels.items() if n in PATH_NEEDS}
        found.append(path_check(name, np.asarray(flights.time)[part], channels, card, seed))
        begin += length
    return tuple(found)


def _rolls(flights: Flights) -> bool:
    """Whether the roll rate of some manoeuvre changes the bank angle, a drift apart."""
    begin = 0
    for length in flights.lengths:
        p, dt = (np.asarray(flights.channels[name])[begin : begin + length] for name in ("p", "dt"))
        if np.ptp(np.cumsum((p - p.mean()) * dt)) > LEVEL:
            return True
        begin += length
    return False


def _impossible(records: Sequence[FlightRecord], card: Card) -> str:
    """Why the flight path cannot be checked at all."""
    flights = join(records, card, ())
    missing = [n for n in CORE if n not in flights.channels]
    if missing:
        return f"the flight path needs {', '.join(missing)}"
    if not np.isfinite(float(card.aircraft.mass)):
        return "the card states no [aircraft], so the places of the sensors are not known"
    if "phi" not in flights.channels and "p" in flights.channels and _rolls(flights):
        return "the flight path needs phi, for the aircraft rolled; map it, or state what stood still under [constants]"
    short = [r.name for r in records if r.time[-1] - r.time[0] < SHORTEST]
    return f"record {short[0]} is shorter than {SHORTEST:g} s" if short else ""
