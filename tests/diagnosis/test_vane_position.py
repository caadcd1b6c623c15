"""Flow-angle sensors on a boom, hidden in simulated stalls: told from a lag, sized, and moved back by a card."""

import numpy as np
import pytest

from bayes_aero.diagnosis.consistency.sensor_errors import screen_sensor_errors
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.simulate.injection import hidden_records

BOOM, LAG = 13.08, 0.15  # m, s: at 80 m/s x/V is .16 s, so that each is what the other would pretend to be


@pytest.mark.recovery
@pytest.mark.parametrize(("name", "true"), [("vane_position", BOOM), ("alpha_delay", LAG)])
def test_a_boom_is_called_a_boom_and_a_lag_a_lag(card, name, true):
    """By kinematics alone: no aerodynamics enters, and each is the other's nearest rival."""
    records = hidden_records({name: {name: true}}, seed=620, noise="ar1", seconds=90.0)
    found = screen_sensor_errors(records, card)
    assert found.causes == (name,)
    size = found.sizes[name]
    assert abs(size.mean - true) < 3.0 * size.sd
    assert 1.96 * size.sd < 0.15 * true


def test_a_card_that_states_the_boom_has_the_coefficients_of_the_cg(card, model, clean_records):
    """A record of the CG moved to the boom by hand, and back by the card's fixed parameter."""
    clean = clean_records[0]
    wrong = dict(clean.channels)
    wrong["alpha"] = clean["alpha"] - BOOM * clean["q"] / clean["airspeed"]
    wrong["beta"] = clean["beta"] + BOOM * clean["r"] / clean["airspeed"]
    boom = FlightRecord.from_arrays(clean.name, clean.time, wrong)
    stated = Model.of([*card.effects, "vane_position"], {**card.fixed, "vane_position": BOOM})
    at_cg, uncorrected, found = (
        np.asarray(observe([record], card, m).signals["alpha_dot"])
        for record, m in ((clean, model), (boom, model), (boom, stated))
    )
    moved = np.std(uncorrected - at_cg)
    assert moved > 0.1 * np.std(at_cg)
    assert np.std(found - at_cg) < 0.02 * moved
