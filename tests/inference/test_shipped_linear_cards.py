"""The linear cards that are shipped: from their starts to the truth of flights by the matrix exponential."""

from __future__ import annotations

import numpy as np
import pytest
from linear_cards import LATERAL_TRUTH, SHORT_PERIOD_TRUTH, lateral_flight, record_of, short_period_flight

from bayes_aero.dynamics.linear import linear_dynamics
from bayes_aero.dynamics.segments import segments
from bayes_aero.flight.card.card import read_card
from bayes_aero.inference.likelihood.output_error import fit_output_error
from bayes_aero.inference.likelihood.output_error_result import OutputErrorStatus
from bayes_aero.model.joined_channels import join

NOISE = {"alpha": 0.002, "q": 0.003, "az": 0.15, "p": 0.004, "r": 0.003}
SPEED = 90.0  # m/s, of the flight by which az follows alpha
TRUTH = {
    "short_period": SHORT_PERIOD_TRUTH
    | {"azalpha": SPEED * SHORT_PERIOD_TRUTH["Zalpha"], "azde": SPEED * SHORT_PERIOD_TRUTH["Zde"]},
    "lateral": LATERAL_TRUTH | {"Nda": 0.0},
}
FLIGHT = {"short_period": short_period_flight, "lateral": lateral_flight}


@pytest.mark.parametrize("name", TRUTH)
def test_it_recovers_the_truth(name):
    card, truth = read_card(name), TRUTH[name]
    dynamics = linear_dynamics(card)
    channels = {c.name for c in card.channels}
    true = {k: x for k, x in FLIGHT[name](truth).items() if k in channels}
    record = record_of(true, 0.04, NOISE, np.random.default_rng(5))
    found = fit_output_error(segments(join([record], card, dynamics.inputs), dynamics))
    assert found.status is OutputErrorStatus.CONVERGED
    assert set(found.names) == set(truth)
    off = (found.estimate - np.array([truth[n] for n in found.names])) / found.sd
    assert np.all(np.abs(off) < 4.0), dict(zip(found.names, off, strict=True))
