"""Do the sensors agree? The flight path alone, before any aerodynamics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.candidate_set import CandidateModel, candidate_model
from bayes_aero.diagnosis.screening.regression import Fit
from bayes_aero.diagnosis.screening.selection_state import SelectionState, linearised
from bayes_aero.diagnosis.selection.block_jackknife import consistent_across_blocks, widened
from bayes_aero.diagnosis.selection.forward_selection import Extension, forward_selection, nats_gained
from bayes_aero.diagnosis.selection.plausibility import without_hold
from bayes_aero.diagnosis.selection.undecided_errors import with_several_instead
from bayes_aero.effect import Kind, Stage
from bayes_aero.errors import InputError
from bayes_aero.flight.axes import Axis
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.chosen import lengths_of
from bayes_aero.model.joined_records import Joined, joined, repaired
from bayes_aero.model.model import Model
from bayes_aero.model.own_effects import own_effects
from bayes_aero.parameter import Prior
from bayes_aero.physics.flightpath import PATH_CORE
from bayes_aero.residuals.flight_path import FlightPathError, rolled_unseen

SENSOR_KINDS = (Kind.MEASUREMENT, Kind.ENVIRONMENT)
SHORTEST = 4.0  # s of a record that can be checked


def check_sensors(
    full: CandidateModel,
    responses: FlightPathError,
    theta: Float[np.ndarray, " k"],
    *,
    seed: int,
    known: Sequence[str] = (),
    priors: Mapping[str, Prior] | None = None,
) -> Extension:
    """Sensor errors and winds that the flight path asks for beside the `known` ones, of whose parameters `priors` tell.

    Nothing else is in but where integrals begin. Where one is larger than sensors have, all is selected again without
    it and what holds only beside it. If that explains the record as well, it had stood in for others. If not, it stays,
    for the others cannot be judged without it, and corrects nothing (see `without_hold`).
    """

    def selected(barred: Sequence[str]) -> Extension:
        candidates = tuple(e for e in full.candidates if e.kind in SENSOR_KINDS and e.name not in (*known, *barred))
        own = replace(full, base=tuple(known), candidates=candidates, priors=priors or {})
        state = linearised(own, responses, responses.outputs, theta)
        found = forward_selection(state, seed=seed, checked=_checked)
        return widened(found, found.state, found.fit)

    first = found = selected(())
    out: tuple[str, ...] = ()
    while found.implausible:
        out = (*out, *without_hold(found))
        found = replace(selected(out), too_large=found)
    return found if found is first or nats_gained(first, found) > -full.settings.decisive else first


def _checked(state: SelectionState, fit: Fit) -> tuple[SelectionState, Fit]:
    """What stretches bear out, or several errors in place of one of these, if stretches bear them out, too."""
    return consistent_across_blocks(*with_several_instead(*consistent_across_blocks(state, fit)))


def screen_sensor_errors(records: list[FlightRecord], card: Card, *, seed: int = 0) -> Extension:
    """Sensor errors and winds that the flight path asks for, as the first stage of a diagnosis finds them.

    Raises `InputError` where there is no flight path (see `no_flight_path`) or a single manoeuvre is too short.
    """
    if why := no_flight_path(records, card):
        raise InputError(why)
    flights, _ = repaired(as_the_card_states(joined(records, card, PATH_CORE), card))
    plain = Model((), (), axes=tuple(Axis), lengths=lengths_of(flights.aircraft))
    whole = candidate_model(plain, flights, tuple(own_effects(card.effect_files).values()))
    sensors = tuple(e for e in whole.candidates if e.kind in SENSOR_KINDS)
    model = Model(sensors, tuple(p for e in sensors for p in e.parameters), axes=tuple(Axis))
    full = CandidateModel(model, (), sensors, {})
    return check_sensors(full, FlightPathError.of(flights, model), full.neutral_vector, seed=seed)


def no_flight_path(records: Sequence[FlightRecord], card: Card) -> str:
    """Why the flight path cannot be checked at all; empty where it can."""
    flights = joined(records, card, ())
    missing = [n for n in PATH_CORE if n not in flights.channels]
    if missing:
        return f"the flight path needs {', '.join(missing)}"
    if not np.isfinite(float(card.aircraft.mass)):
        return "the card states no [aircraft], so the positions of the sensors are unknown"
    if rolled_unseen(flights):
        return (
            "the flight path needs phi, because the aircraft rolled; map it, or state what did not move under "
            "[constants]"
        )
    short = [r.name for r in records if r.time[-1] - r.time[0] < SHORTEST]
    return f"record {short[0]} is shorter than {SHORTEST:g} s" if short else ""


def as_the_card_states(flights: Joined, card: Card) -> Joined:
    """Flights without the errors of the record that the card states."""
    if card.linear is not None:
        return flights
    model = Model.from_card(card)
    stated = [e for e in model.effects if e.stage is Stage.CHANNEL]
    if not stated:
        return flights
    fixed = dict(model.fixed)
    values = {p.name: fixed.get(p.name, p.start) for e in stated for p in e.parameters}
    return with_corrections(flights, Model.of(stated, axes=tuple(Axis)), values)


def with_corrections(flights: Joined, model: Model, values: Mapping[str, Any]) -> Joined:
    """Flights as a model of errors of the record, and of where its sensors are, makes them true."""
    true = model.corrected(values, flights.channels, flights.aircraft)
    aircraft = model.actual_aircraft(values, flights.aircraft)
    return replace(flights, channels={name: np.asarray(true[name]) for name in flights.channels}, aircraft=aircraft)
