"""Do the sensors agree? An answer in absolute terms, before any aerodynamics, with the known error that explains it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayes_aero.diagnosis.consistency.flight_path_check import gusts_met, path_check
from bayes_aero.diagnosis.consistency.flight_path_noise import CALM
from bayes_aero.diagnosis.consistency.sensor_errors import (
    SENSOR_KINDS,
    as_the_card_states,
    no_flight_path,
    screen_sensor_errors,
    with_corrections,
)
from bayes_aero.diagnosis.result import Diagnosis
from bayes_aero.diagnosis.screening.accuracy import Size
from bayes_aero.diagnosis.selection.collinear import correlated
from bayes_aero.diagnosis.selection.forward_selection import Extension
from bayes_aero.diagnosis.selection.plausibility import without_hold
from bayes_aero.diagnosis.selection.undecided_errors import open_errors
from bayes_aero.effect import Effect
from bayes_aero.errors import InputError
from bayes_aero.flight.agreement import Agreement, Consistency, OpenError, PathCheck
from bayes_aero.flight.axes import Axis
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.joined_records import Joined, joined, repaired
from bayes_aero.model.model import Model
from bayes_aero.physics.flightpath import PATH_CORE, PATH_NEEDS


@dataclass(frozen=True)
class KnownErrors:
    """Errors of the record that were found: effects on it or on where its sensors are, and plain data of each (see
    `Consistency`); and those that the flight path cannot decide on."""

    effects: tuple[Effect, ...]
    errors: Mapping[str, Mapping[str, Any]]
    open: tuple[OpenError, ...] = ()


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
    found = as_recorded(records, card, seed)
    if not found.recorded:
        return found
    if known is None:
        if found.agreement is Agreement.AGREE or not seek:
            return found
        try:
            known = errors_of_path(screen_sensor_errors(list(records), card, seed=seed))
        except InputError as reason:
            return replace(found, unsought=str(reason))
    return with_known_errors(found, records, card, known, seed)


def as_recorded(records: Sequence[FlightRecord], card: Card, seed: int = 0) -> Consistency:
    """The check of the records as they are; nothing is looked for."""
    if why := no_flight_path(records, card):
        return Consistency(why)
    flights = _flights(records, card)
    unchecked = tuple(n for n in ("altitude", "beta", "phi") if n not in flights.channels)
    return Consistency("", unchecked, checks(flights, card, seed))


def with_known_errors(
    found: Consistency, records: Sequence[FlightRecord], card: Card, known: KnownErrors, seed: int = 0
) -> Consistency:
    """`as_recorded` with the errors that are known; where the sensors disagree, checked again without these."""
    found = replace(found, errors=known.errors, open=known.open)
    if found.agreement is Agreement.AGREE or not known.effects:
        return found
    model = Model.of(known.effects, axes=tuple(Axis))
    values = {p: x["mean"] for e in known.errors.values() for p, x in e["parameters"].items()}
    return replace(found, corrected=checks(with_corrections(_flights(records, card), model, values), card, seed))


def _flights(records: Sequence[FlightRecord], card: Card) -> Joined:
    """The manoeuvres' channels of the flight path, spikes repaired."""
    return repaired(as_the_card_states(joined(records, card, PATH_CORE), card))[0]


def errors_of_path(known: Extension) -> KnownErrors:
    """Errors of sensors and winds that a search along the flight path has found, minor ones included.

    One at a parameter bound, or larger than sensors have, explains nothing: another cause is behind it. What was
    estimated together with such a one is no error by itself, either.
    """
    named = {e.name: e for one in (known, *known.larger) for e in one.state.full.candidates}
    joint, out = correlated(known, known.state.active), without_hold(known)
    alone = [(one, name, with_) for one in (known, *known.larger) for name, with_ in without_hold(one).items() if with_]
    unheld = {name for _, name, _ in alone}
    found = [named[name] for name in (*known.causes, *known.minor) if name not in out]
    plain = {e.name: _plain(e, known.sizes, joint.get(e.name, {}), minor=e.name in known.minor) for e in found}
    pairs = (_unheld(named[name], one.sizes, partners) for one, name, partners in alone)
    return KnownErrors(tuple(found), plain, (*pairs, *(e for e in open_errors(known) if e.name not in unheld)))


def _unheld(effect: Effect, sizes: Mapping[str, Size], partners: Mapping[str, float]) -> OpenError:
    p = effect.parameters[0]
    size = sizes[p.name]
    return OpenError(effect.name, p.unit, size.mean, size.sd, size.sd, False, tuple(partners), 1.0, dict(partners))


def errors_of_diagnosis(found: Diagnosis) -> KnownErrors:
    """Errors of the record that a diagnosis has confirmed, by the flight path or by the coefficients.

    What it names, it does not call undecided, too.
    """
    named = {e.name: e for e in found.aerodynamics.state.full.model.effects}
    causes = {c.name: c for c in found.causes if c.sure and named[c.name].kind in SENSOR_KINDS}
    told = {c.name for c in (*found.causes, *found.beyond)}
    return KnownErrors(
        tuple(named[name] for name in causes),
        {name: _plain(named[name], cause.parameters, cause.joint, minor=False) for name, cause in causes.items()},
        () if found.sensors is None else tuple(e for e in open_errors(found.sensors) if e.name not in told),
    )


def _plain(effect: Effect, sizes: Mapping[str, Size], joint: Mapping[str, float], *, minor: bool) -> dict[str, Any]:
    parameters = {
        p.name: {"mean": sizes[p.name].mean, "sd": sizes[p.name].sd, "unit": p.unit} for p in effect.parameters
    }
    return {"claim": effect.claim, "minor": minor, "parameters": parameters, "joint": dict(joint)}


def checks(flights: Joined, card: Card, seed: int) -> tuple[PathCheck, ...]:
    """`path_check` of each manoeuvre, with the sensors where `flights` say that they are."""
    card = replace(card, aircraft=flights.aircraft)
    return tuple(path_check(name, time, channels, card, seed) for name, time, channels in _manoeuvres(flights))


def in_gusts(records: Sequence[FlightRecord], card: Card, seed: int = 0) -> dict[str, float]:
    """Records in no calm air, and their gusts by the flight path alone (standard deviation, m/s).

    In these a fit without process noise takes gusts for aerodynamics. Where the flight path cannot be checked none are
    known.
    """
    if no_flight_path(records, card):
        return {}
    flights = _flights(records, card)
    found = {name: gusts_met(time, channels, card, seed) for name, time, channels in _manoeuvres(flights)}
    return {name: gusts for name, gusts in found.items() if gusts > CALM}


def _manoeuvres(flights: Joined) -> Iterator[tuple[str, np.ndarray, dict[str, np.ndarray]]]:
    """Name, time, and channels of the flight path of each."""
    begin = 0
    for name, length in zip(flights.names, flights.lengths, strict=True):
        part = slice(begin, begin + length)
        channels = {n: np.asarray(x)[part] for n, x in flights.channels.items() if n in PATH_NEEDS}
        yield name, np.asarray(flights.time)[part], channels
        begin += length
