"""What follows from a diagnosis: the best predictor available, and the flight that would settle what it left open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from bayes_aero.criticism.design import separating
from bayes_aero.criticism.finding import Diagnosis
from bayes_aero.criticism.gain import truncated
from bayes_aero.criticism.predictors import compare_states
from bayes_aero.criticism.trajectory import Progress, Trajectories, fly_both
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.flights import despiked, join
from bayes_aero.model.longitudinal import FLIGHT

SETS = 2  # ambiguity sets for which manoeuvres are flown: each compiles a flight of its own


def predictors(diagnosis: Diagnosis, card: Card) -> dict[str, Any]:
    """Card's model, Gaussian process, extended model and that with its discrepancy, by coefficient, on unseen data."""
    found = compare_states(truncated(diagnosis.aerodynamics.state, diagnosis.kept), card.gp_inputs)
    return {
        name: {c: None if scores is None else asdict(scores) for c, scores in row.items()}
        for name, row in found.table.items()
    }


def separations(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """For each ambiguity set of the coefficients' causes: the standard manoeuvre that would tell its members apart."""
    found, seen = [], set()
    for cause in diagnosis.causes:
        members = frozenset((cause.name, *cause.ambiguous_with))
        if len(members) < 2 or members in seen or cause.stage != "coefficients" or len(found) >= SETS:
            continue
        seen.add(members)
        sizes = {name: abs(size.mean) for name, size in cause.parameters.items()}
        try:
            design = separating(diagnosis.aerodynamics.state, sorted(members), sizes=sizes)
        except InputError as error:
            found.append({"effects": sorted(members), "status": str(error), "manoeuvres": []})
            continue
        ranked = [{"manoeuvre": m.manoeuvre, "deviations": m.weakest} for m in design.manoeuvres]
        found.append({"effects": sorted(members), "status": design.status, "manoeuvres": ranked})
    return found


def simulations(
    diagnosis: Diagnosis, card: Card, records: Sequence[FlightRecord], seed: int, progress: Progress | None = None
) -> Trajectories:
    """The card's model and the extended one flown through the records' inputs, fitted there and on unseen flight."""
    bands = {name: tolerance.value for name, tolerance in card.tolerances.items()}
    return fly_both(despiked(join(records, card, FLIGHT))[0], diagnosis, bands, seed=seed, progress=progress)
