"""Do the sensors agree? An answer in absolute terms, before any aerodynamics, with the known error that explains it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from bayes_aero.criticism.extension import Extension
from bayes_aero.criticism.path_check import path_check
from bayes_aero.criticism.sensors import as_the_card_states, compatibility, with_corrections
from bayes_aero.errors import InputError
from bayes_aero.flight.agreement import Agreement, Consistency, PathCheck
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.flights import Flights, despiked, join
from bayes_aero.physics.flightpath import PATH_NEEDS

CORE = ("ax", "az", "q", "theta", "alpha", "airspeed")  # without these nothing of the flight path can be checked
SHORTEST = 4.0  # s of a record that can be checked


def consistency(
    records: Sequence[FlightRecord], card: Card, *, seed: int = 0, seek: bool = True, known: Extension | None = None
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
        return found if known is None else replace(found, errors=errors_of(known))
    if known is None:
        if not seek:
            return found
        try:
            known = compatibility(list(records), card, seed=seed)
        except InputError as reason:
            return replace(found, unsought=str(reason))
    return explained_by(found, known, flights, card, seed)


def explained_by(found: Consistency, known: Extension, flights: Flights, card: Card, seed: int) -> Consistency:
    """`found` with the errors of sensors that an election along the flight path has named taken out."""
    errors = errors_of(known)
    if not errors:
        return replace(found, errors=errors)
    model = known.state.field.model
    values = model.values(jnp.asarray(known.state.theta))
    for effect in known.state.field.candidates:
        if effect.name not in errors:
            values |= {p.name: jnp.asarray(p.neutral) for p in effect.parameters}
    return replace(found, errors=errors, corrected=checks(with_corrections(flights, model, values), card, seed))


def errors_of(known: Extension) -> dict[str, dict[str, Any]]:
    """Errors of sensors and winds of an election as plain data, sizes in SI."""
    effects = {e.name: e for e in known.state.field.candidates}
    return {
        name: {
            "claim": effects[name].claim,
            "minor": name in known.minor,
            "parameters": {
                p.name: {"mean": known.sizes[p.name].mean, "sd": known.sizes[p.name].sd, "unit": p.unit}
                for p in effects[name].parameters
            },
        }
        for name in (*known.causes, *known.minor)
    }


def checks(flights: Flights, card: Card, seed: int) -> tuple[PathCheck, ...]:
    """`path_check` of each manoeuvre."""
    found, begin = [], 0
    for name, length in zip(flights.names, flights.lengths, strict=True):
        part = slice(begin, begin + length)
        channels = {n: np.asarray(x)[part] for n, x in flights.channels.items() if n in PATH_NEEDS}
        found.append(path_check(name, np.asarray(flights.time)[part], channels, card, seed))
        begin += length
    return tuple(found)


def _impossible(records: Sequence[FlightRecord], card: Card) -> str:
    """Why the flight path cannot be checked at all."""
    flights = join(records, card, ())
    missing = [n for n in CORE if n not in flights.channels]
    if missing:
        return f"the flight path needs {', '.join(missing)}"
    if not np.isfinite(float(card.aircraft.mass)):
        return "the card states no [aircraft], so the places of the sensors are not known"
    short = [r.name for r in records if r.time[-1] - r.time[0] < SHORTEST]
    return f"record {short[0]} is shorter than {SHORTEST:g} s" if short else ""
