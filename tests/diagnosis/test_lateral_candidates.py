"""Every lateral effect, hidden in two simulated stalls of three axes, leads the first screening of the coefficients."""

from __future__ import annotations

import numpy as np
import pytest
from lateral_flight import LATERAL_TRUTH, can_simulate, flown, three_axis_card, values

from bayes_aero.diagnosis.candidate_set import CandidateModel, candidate_model
from bayes_aero.diagnosis.screening.screening import screen
from bayes_aero.diagnosis.screening.selection_state import SelectionState, linearised
from bayes_aero.diagnosis.selection.forward_selection import explained
from bayes_aero.diagnosis.settings import DEFAULT
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.axes import Axis
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model
from bayes_aero.residuals.equation_error import EquationError

LATERAL = [e for e in CATALOGUE.values() if e.axes == (Axis.LATERAL,) and e.parameters and can_simulate(e)]
BASE = [e.name for e in LATERAL if {p.name for p in e.parameters} & set(LATERAL_TRUTH)]
CANDIDATES = [e.name for e in LATERAL if e.name not in BASE]
ABSORBED = {  # by parameters of the card, whatever their size
    "aileron_scale": "Clda and Cnda by the inverse of its factor",
    "rudder_scale": "CYdr, Cldr and Cndr by the inverse of its factor",
}
SMALLER = {"aileron_incidence": 0.4}  # of the middle size; with more, ailerons reverse and nothing balances
ALIKE = {  # one of the two leads, whichever it is
    "sideslip_vane_height": "roll_rate_side_force",  # sideslip that goes with p/V, where Clp and Cnp are free
    **dict.fromkeys(("side_force_offset", "roll_offset", "yaw_offset"), "sideslip_bias"),  # where two are free
}


def middle(name: str) -> dict[str, float]:
    """Each parameter half way, in its logarithm, from the least size worth a name to the largest."""
    return {p: SMALLER.get(name, 1.0) * float(np.sqrt(np.prod(size))) for p, size in CATALOGUE[name].sizes.items()}


def screening(hidden: dict[str, float], without: str = "") -> tuple[CandidateModel, SelectionState]:
    """The first screening of two flights, by a card whose effects have their true values, but for one that it lacks."""
    card = three_axis_card()
    model = Model.from_card(card)
    flights = join([flown(hidden, seed) for seed in (1, 2)], card)
    full = candidate_model(model, flights)
    begin = full.neutral | {p.name: values({})[p.name] for p in model.free}
    theta = np.array([begin[name] for name in full.model.names])
    if without:
        theta[full.own_columns(without)] = 0.0
        base = tuple(e for e in full.base if e != without)
        full = CandidateModel(full.model, base, (*full.candidates, CATALOGUE[without]), full.not_testable)
    return full, linearised(full, EquationError.of(flights, full.model), full.model.coefficients, theta)


def named(state: SelectionState) -> list[str]:
    """Of one screening: effects that explain enough, at a size worth a name; the most explaining first."""
    found = []
    for one in screen(state, state.fit(), seed=0, nulls=False).candidate_scores:
        sizes = CATALOGUE[one.effect].sizes.values()
        large = any(abs(step) >= least for step, (least, _) in zip(one.step, sizes, strict=False))
        if large and explained(state, one) >= DEFAULT.least_share:
            found.append(one.effect)
    return list(dict.fromkeys(found))


@pytest.mark.parametrize("name", CANDIDATES)
def test_what_is_hidden_leads(name):
    full, state = screening(middle(name))
    assert name in {e.name for e in full.candidates}
    found = named(state)
    if name in ABSORBED:
        assert name not in found, ABSORBED[name]
    else:
        assert found[:1] in ([name], [ALIKE.get(name)])


@pytest.mark.parametrize("name", BASE)
def test_what_the_card_lacks_leads(name):
    """Terms that every flight has."""
    assert named(screening({}, name)[1])[:1] in ([name], [ALIKE.get(name)])


def test_nothing_is_worth_a_name_where_nothing_is_hidden():
    assert named(screening({})[1]) == []
