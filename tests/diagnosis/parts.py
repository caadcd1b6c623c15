"""Parts of a diagnosis that are made up, for tests of what is judged and not of what is fitted."""

from dataclasses import fields, replace

import numpy as np

from bayes_aero.diagnosis import selection_state
from bayes_aero.diagnosis.result import Cause, Gain, Size
from bayes_aero.diagnosis.selection_state import CandidateModel, SelectionState, linearised
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.observations import join
from bayes_aero.physics.aircraft import NAMES
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.simulate.demo import TRUTH, simulate_stall


def part(kind, **given):
    """An instance of a dataclass with these fields alone: what is judged here needs no aircraft."""
    made = object.__new__(kind)
    for name, value in given.items():
        assert name in {f.name for f in fields(kind)}
        object.__setattr__(made, name, value)
    return made


def cause(name="thrust_scale", mean=-0.08, sd=0.01, **given) -> Cause:
    parameters = {p.name: Size(mean, sd, p.unit) for p in CATALOGUE[name].parameters}
    gain = Gain(1.0, 1.0, "manoeuvre", {}, {})
    rest = {"probability": 0.9, "p_value": 0.01, "ambiguous_with": ()} | given
    return Cause(name, "propulsion", CATALOGUE[name].claim, "coefficients", parameters=parameters, gain=gain, **rest)


def with_candidates(card, model, names, seeds=(0,)) -> SelectionState:
    """The card's model with these candidates, at the truth of simulated stalls without them."""
    base = tuple(e for e in model.effects if e.name != "separation_lag")  # fixed at neutral by the card
    everything = (*base, *(CATALOGUE[name] for name in names))
    changed = {p.name: p for p in model.parameters}
    parameters = tuple(changed.get(p.name, p) for e in everything for p in e.parameters)
    whole = replace(model, effects=everything, parameters=parameters, fixed=())
    full = CandidateModel(whole, tuple(e.name for e in base), everything[len(base) :], {})
    theta = np.array([TRUTH.get(p.name, p.neutral) for p in parameters])
    records = [simulate_stall(seed, card=card) for seed in seeds]
    return linearised(full, EquationError.of(join(records, card), whole), NAMES, theta)


def few_candidates(patch, names) -> None:
    """The catalogue has these effects alone, so that less is compiled; all are searched in `make verify`."""
    patch.setattr(selection_state, "CATALOGUE", {name: CATALOGUE[name] for name in names})


def without_accelerometers(record: FlightRecord) -> FlightRecord:
    kept = {name: x for name, x in record.channels.items() if name not in ("ax", "ay", "az")}
    return FlightRecord.from_arrays(record.name, record.time, kept)
