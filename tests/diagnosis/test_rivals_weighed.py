"""Thrust or mass: whichever is hidden is chosen where the flights tell them apart, and none where buffet hides it."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.selection.stacking import stacked, states_of
from bayes_aero.flight.card.card import read_card
from bayes_aero.simulate.injection import hidden_records

SEED = 5
TRUE = 0.1


@pytest.mark.recovery
@pytest.mark.parametrize(("noise", "chosen"), [("white", True), ("buffet", False)])
def test_a_rival_has_the_weight_that_the_flights_give_it(noise, chosen):
    print("seed", SEED)
    records = hidden_records({"thrust_scale": {"thrust_scale": TRUE}}, seed=SEED, noise=noise, seconds=90.0)
    found = diagnose(records, read_card("attas"), seed=SEED, gains_wanted=False).aerodynamics
    assert found.state.active == ("thrust_scale",)
    weighed = stacked(found, "coefficients", {"thrust_scale": ("mass_scale",)}, found.state.active, seed=SEED)
    assert weighed is not None
    assert weighed.blocks == 12
    assert weighed.weight("thrust_scale") + weighed.weight("mass_scale") == pytest.approx(1.0)
    assert (weighed.weight("thrust_scale") >= found.state.settings.stacking_chosen) == chosen
    assert weighed.weight("mass_scale") < weighed.weight("thrust_scale")
    low, high = weighed.models[0].band
    assert low <= weighed.models[0].weight <= high
    for state, model in zip(states_of(weighed, found), weighed.models, strict=True):
        assert state.active == model.effects
        assert np.array_equal(state.theta, model.theta)
