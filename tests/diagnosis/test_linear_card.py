"""A linear model flown into the stall: diagnosis finds the separation of the flow and what depends on it."""

import numpy as np
import pytest

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.model.model import Model
from bayes_aero.simulate.injection import hidden_flights

LINEAR = (
    "attached_lift", "mach_lift", "elevator_moment", "pitching_moment", "pitch_damping", "profile_drag", "induced_drag",
)  # fmt: skip
STALL = {"flow_separation", "reattachment_hysteresis", "separated_moment", "separated_drag"}


@pytest.mark.verify
def test_a_linear_model_is_extended_to_the_stall_that_was_flown(card):
    seed = int(np.random.default_rng(611).integers(1_000_000))
    flights = hidden_flights({}, seed=seed, noise="ar1", seconds=90.0)
    records, truth = [flight.record for flight in flights], flights[0].values
    found = diagnose(records, card, model=Model.of(LINEAR), seed=seed, gains_wanted=False)
    assert {cause.name for cause in found.causes} == STALL
    assert found.causes[0].name == "flow_separation"
    for cause in found.causes:
        for name, size in cause.parameters.items():
            assert size.mean == pytest.approx(truth[name], rel=0.15), name
    assert not found.unknown
