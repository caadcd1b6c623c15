"""What follows from a diagnosis: the flights that would settle what it left open, and simulated ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayes_aero.diagnosis.design.next_test_points import TestPoints, next_test_points
from bayes_aero.diagnosis.result import Diagnosis
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.trajectories.results import Trajectories
from bayes_aero.diagnosis.trajectories.trajectories import Progress, compare_trajectories
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.simulated.manoeuvres import ANYWHERE
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.envelope import Envelope
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.joined_channels import despiked, join

SETS = 2  # ambiguity sets for which the manoeuvres are judged


def proposed_points(diagnosis: Diagnosis, envelope: Envelope = ANYWHERE) -> dict[str, Any]:
    """The manoeuvres that decide all that the coefficients leave open, in the order of flying; empty if there is
    nothing to decide. Raises `InputError` if the model cannot be flown."""
    sets = _open_sets(diagnosis)
    if not sets:
        return {}
    points = next_test_points(diagnosis.aerodynamics.state, sets, envelope, _usual(diagnosis).theta)
    return _told(points, envelope)


def _open_sets(diagnosis: Diagnosis) -> dict[frozenset[str], dict[str, float]]:
    """What the coefficients leave open: effects, and the sizes of their parameters."""
    state = diagnosis.aerodynamics.state
    sets: dict[frozenset[str], dict[str, float]] = {}
    effects = {e.name for e in state.full.candidates}
    for cause in diagnosis.causes:
        # A form is no effect that can be flown.
        members = frozenset({cause.name, *effects.intersection(cause.ambiguous_with)})
        if len(members) > 1 and cause.stage == "coefficients":
            sets.setdefault(members, {name: abs(size.mean) for name, size in cause.parameters.items()})
    known = {c.name: c.parameters for c in diagnosis.causes if c.stage == "coefficients"}
    for pair in diagnosis.together:
        if set(pair.effects) <= set(known):
            sets = {
                frozenset(pair.effects): {}
            } | sets  # at the least sizes worth modelling: the estimates mean nothing
    sets = dict(list(sets.items())[:SETS])
    for one in diagnosis.absorbed:
        parameters = {p.name: e.name for e in state.full.candidates for p in e.parameters}
        sets.setdefault(one.members, {p: abs(one.sizes[e].mean) for p, e in parameters.items() if e in one.sizes})
    return sets


def _told(points: TestPoints, envelope: Envelope) -> dict[str, Any]:
    """Plain data."""
    return {
        "questions": [
            {"effects": list(q.effects), "enough": q.enough, "present": d}
            for q, d in zip(points.questions, points.present, strict=True)
        ],
        "points": [
            {
                "manoeuvre": p.manoeuvre,
                "amplitude": p.amplitude,
                "airspeed": p.airspeed,
                "altitude": p.altitude,
                "seconds": p.seconds,
                "excursion": {name: list(pair) for name, pair in p.excursion.items()},
                "standard_errors": list(p.expected),
                "nats_per_second": p.rate,
            }
            for p in points.points
        ],
        "refused": dict(points.refused),
        "envelope": {name: [None if np.isinf(x) else x for x in pair] for name, pair in envelope.ranges.items()},
        "stated": list(envelope.stated),
    }


def _usual(diagnosis: Diagnosis) -> SelectionState:
    """The state with parameters of controls at rest at their usual values: as fitted, the control may do nothing."""
    state = diagnosis.aerodynamics.state
    theta = state.theta.copy()
    for one in diagnosis.absorbed:
        theta[state.full.columns([one.parameter])] = one.usual[0]
    return replace(state, theta=theta)


def simulations(
    diagnosis: Diagnosis, card: Card, records: Sequence[FlightRecord], seed: int, progress: Progress | None = None
) -> Trajectories:
    """Simulate the card's and the extended model with the records' inputs, fitted to all and on hold-out flights."""
    bands = {name: tolerance.value for name, tolerance in card.tolerances.items()}
    flights = despiked(join(records, card, FLIGHT))[0]
    return compare_trajectories(flights, diagnosis, bands, biases=card.output_biases, seed=seed, progress=progress)
