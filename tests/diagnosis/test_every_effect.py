"""Every effect of the catalogue, hidden in two simulated stalls, leads the first screening; where nothing is hidden,
none explains as much as is worth a name.

Windows of 40 s about the stall, sensor noise, one length: one compiled program serves all. Whole diagnoses, in coloured
noise, are in test_hidden_effects.py, and how often they are right `make verify` counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from bayes_aero.diagnosis.candidate_set import CandidateModel, candidate_model
from bayes_aero.diagnosis.consistency.sensor_errors import SENSOR_KINDS
from bayes_aero.diagnosis.screening.screening import screen
from bayes_aero.diagnosis.screening.selection_state import SelectionState, linearised
from bayes_aero.diagnosis.selection.forward_selection import explained
from bayes_aero.diagnosis.settings import DEFAULT
from bayes_aero.effect import Kind
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.model.joined_channels import Flights, despiked, join
from bayes_aero.model.observations import observe
from bayes_aero.physics.coefficients import NAMES
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.residuals.flight_path import FlightPathError
from bayes_aero.simulate.demo import TRUTH
from bayes_aero.simulate.injection import FLOWN_AXES, HiddenFlight, hidden_flights

SEED, BEGIN, END = 43, 20.0, 60.0  # s of each flight that are looked at
MOVED = {name: {} for name in ("rudder_moment", "spoiler_lift", "dlc_lift", "flap_lift")}  # surfaces, always deflected
CANARD = np.deg2rad(8.0)
BASE = [e.name for e in CATALOGUE.values() if {p.name for p in e.parameters} & (set(TRUTH) - {"tau1"})]
RANDOM = [e.name for e in CATALOGUE.values() if e.disturbance is not None or e.kind is Kind.NOISE]  # test_innovations
ON_PATH = ["heading_delay"]  # of a channel that bayes-aero path alone compares: test_flight_path
OTHERS = {*BASE, *RANDOM, *ON_PATH}
FLOWN = [e for e in CATALOGUE.values() if e.acts_on(FLOWN_AXES)]  # the others: test_lateral_candidates
CANDIDATES = [e.name for e in FLOWN if e.parameters and e.name not in OTHERS]
STAND_INS = [name for name in CANDIDATES if not CATALOGUE[name].candidate]
EXTRA = [replace(CATALOGUE[name], candidate=True) for name in STAND_INS]  # the same objects always: compiled once
ABSORBED = {  # by parameters of the card, whatever their size
    "density_scale": "every coefficient by the same factor",
    "elevator_scale": "Cmde by the inverse of its factor",
}
ABSENT = ("separated_drag", "separated_moment", "reattachment_hysteresis")
LARGER = {"drag_offset": 4.0, "accel_y_scale": 2.0}  # of the middle size, in its logarithm


def middle(name: str) -> dict[str, float]:
    """Each parameter half way, in its logarithm, from the least size worth a name to the largest."""
    effect, values = CATALOGUE[name], {}
    for p in effect.parameters:
        size = LARGER.get(name, 1.0) * np.sqrt(np.prod(effect.sizes[p.name]))
        values[p.name] = next(x for x in (p.neutral + size, p.neutral - size) if p.bounds[0] < x < p.bounds[1])
    return values


def deflected(record: FlightRecord) -> np.ndarray:
    """A canard that moves and does nothing: pulses of three seconds to either side."""
    t = np.asarray(record.time)
    return CANARD * np.sign(np.sin(2.0 * np.pi * t / 6.0)) * (np.sin(2.0 * np.pi * t / 23.0) > 0.0)


def with_canard(flight: HiddenFlight, card, name: str = "", values: Mapping[str, float] | None = None) -> FlightRecord:
    """The record with that canard; with `name` and `values` it has that effect, and the elevator holds its moment."""
    record = flight.record
    channels = {key: np.array(x) for key, x in record.channels.items()} | {"canard": deflected(record)}
    if values:
        signals = {key: np.asarray(x) for key, x in (dict(flight.true) | channels).items()}
        added = CATALOGUE[name].increments(values, signals, card.aircraft, {})
        CL, CD, Cm = (np.asarray(added.get(key, 0.0)) for key in ("CL_attached", "CD", "Cm"))
        v, alpha, aircraft = flight.values, flight.true["alpha"], card.aircraft
        attached = v["CL0"] + (v["CLa"] + v["CLaM"] * flight.true["mach"]) * alpha
        CD = CD + ((attached + CL) ** 2 - attached**2) / (np.pi * v["e"] * aircraft.aspect_ratio)  # induced
        pressure = 0.5 * flight.true["density"] * flight.true["airspeed"] ** 2
        force = pressure * aircraft.wing_area / aircraft.mass
        channels["ax"] += force * (CL * np.sin(alpha) - CD * np.cos(alpha))
        channels["az"] -= force * (CL * np.cos(alpha) + CD * np.sin(alpha))
        channels["elevator"] -= Cm / flight.values["Cmde"]
    return FlightRecord.from_arrays(record.name, np.asarray(record.time), channels, "simulated").window(BEGIN, END)


def named(state: SelectionState) -> list[str]:
    """Of one screening: effects that explain enough, at a size worth a name; the most explaining first."""
    found = []
    for one in screen(state, state.fit(), seed=0, nulls=False).candidate_scores:
        sizes = CATALOGUE[one.effect].sizes.values()
        large = any(abs(step) >= least for step, (least, _) in zip(one.step, sizes, strict=False))
        if large and explained(state, one) >= DEFAULT.least_share:
            found.append(one.effect)
    return list(dict.fromkeys(found))


@dataclass(frozen=True)
class Case:
    """Flights, all effects in one model, and the card's estimates."""

    flights: Flights
    full: CandidateModel
    theta: np.ndarray

    @classmethod
    def of(cls, records: Sequence[FlightRecord], card, model) -> Case:
        flights, _ = despiked(join(records, card))
        full = candidate_model(model, flights, EXTRA)
        values = full.neutral
        fit = fit_mle(model, observe(records, card, model), seed=0, extra_starts=0)
        values |= {name: x for name, x in zip(fit.names, fit.estimate, strict=True) if name in values}
        return cls(flights, full, np.array([values[name] for name in full.model.names]))

    def without(self, name: str) -> Case:
        """The same where the card lacks one of its effects, which is a candidate then."""
        theta, own = self.theta.copy(), self.full.parameters_of(name)
        theta[self.full.columns(own)] = [self.full.neutral[p] for p in own]
        base = tuple(e for e in self.full.base if e != name)
        candidates = (*self.full.candidates, CATALOGUE[name])
        return replace(self, full=replace(self.full, base=base, candidates=candidates), theta=theta)

    def only(self, name: str = "") -> Case:
        """The same without the terms that stand in for others, but for that one."""
        kept = tuple(e for e in self.full.candidates if e.name == name or e.name not in STAND_INS)
        return replace(self, full=replace(self.full, candidates=kept))

    def screening(self, name: str) -> SelectionState:
        """That of the flight path where the effect shows there, else that of the coefficients."""
        path = self.path() if CATALOGUE[name].kind in SENSOR_KINDS else None
        return path if path and name in {block[0] for block in path.blocks} else self.coefficients()

    def path(self) -> SelectionState:
        sensors = tuple(e for e in self.full.candidates if e.kind in SENSOR_KINDS)
        full = replace(self.full, base=(), candidates=sensors)
        responses = FlightPathError.of(self.flights, full.model)
        return linearised(full, responses, responses.outputs, self.theta)

    def coefficients(self) -> SelectionState:
        responses = EquationError.of(self.flights, self.full.model)
        return linearised(self.full, responses, NAMES, self.theta)


def flown(effects: Mapping[str, Mapping[str, float]]) -> list[HiddenFlight]:
    return hidden_flights(MOVED | dict(effects), seed=SEED, noise="white", seconds=END)


@pytest.fixture(scope="module")
def silent(card, model):
    """Nothing hidden."""
    return Case.of([with_canard(f, card) for f in flown({})], card, model)


@pytest.fixture(scope="module")
def without_stall_terms(card, model):
    """An aircraft that has none of `ABSENT`, and a card that has them."""
    neutral = {name: {p.name: p.neutral for p in CATALOGUE[name].parameters} for name in ABSENT}
    return Case.of([with_canard(f, card) for f in flown(neutral)], card, model)


@pytest.mark.parametrize("name", CANDIDATES)
def test_what_is_hidden_leads(name, card, model):
    by_hand = name.startswith("canard")  # the simulated aircraft has none
    flights = flown({} if by_hand else {name: middle(name)})
    records = [with_canard(f, card, name, middle(name) if by_hand else {}) for f in flights]
    found = named(Case.of(records, card, model).only(name).screening(name))
    if name in ABSORBED:
        assert name not in found, ABSORBED[name]
    elif name in STAND_INS:
        assert name in found  # what it stands in for explains as much
    else:
        assert found[:1] == [name]


@pytest.mark.parametrize("name", BASE)
def test_what_the_card_lacks_leads(name, silent):
    """Terms that every flight has."""
    assert named(silent.only().without(name).coefficients())[:1] == [name]


def test_nothing_is_worth_a_name_where_nothing_is_hidden(silent):
    case = silent.only()
    assert len(case.full.candidates) == len(CANDIDATES) - len(STAND_INS)
    assert named(case.path()) == named(case.coefficients()) == []


@pytest.mark.parametrize("name", STAND_INS)
def test_a_term_that_stands_in_for_others_is_not_either(name, silent):
    assert named(silent.only(name).coefficients()) == []


@pytest.mark.parametrize("name", ABSENT)
def test_what_neither_card_nor_aircraft_has_is_not_worth_a_name(name, without_stall_terms):
    assert name not in named(without_stall_terms.only().without(name).coefficients())
