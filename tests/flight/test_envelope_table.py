"""[envelope] of a card: units, defaults, and one sentence for what is wrong."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_aero.errors import InputError
from bayes_aero.flight.card.envelope_table import parse_envelope
from bayes_aero.flight.envelope import DEFAULT_RANGES


def test_quantities_have_units_and_the_rest_the_program_s_ranges():
    found = parse_envelope({"alpha": ["-2 deg", "18 deg"], "altitude_loss": "1000 ft", "load_factor": [0.5, 2]}, "x")
    assert found.ranges["alpha"] == pytest.approx(np.deg2rad([-2.0, 18.0]))
    assert found.ranges["altitude_loss"] == (-np.inf, pytest.approx(304.8))
    assert found.ranges["load_factor"] == (0.5, 2.0)
    assert found.ranges["airspeed"] == DEFAULT_RANGES["airspeed"]
    assert found.stated == ("alpha", "altitude_loss", "load_factor")
    assert not found.programmed_inputs


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"alpha": "18 deg"}, "write the least and the greatest value"),
        ({"alpha": ["18 deg", "2 deg"]}, "the first value must be less than the second"),
        ({"alpha": ["2 kt", "18 deg"]}, "alpha"),
        ({"speed": [1, 2]}, "speed"),
        ({"programmed_inputs": "yes"}, "write true or false"),
    ],
)
def test_what_is_wrong_is_one_sentence(table, words):
    with pytest.raises(InputError, match=words) as told:
        parse_envelope(table, "a.toml")
    assert "a.toml" in str(told.value)
