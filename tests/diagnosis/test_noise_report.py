"""What is said of noise, on flights whose noise is known."""

import pytest

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.simulate.injection import hidden_records


@pytest.mark.parametrize(("noise", "coloured"), [("white", False), ("ar1", True)])
def test_noise_is_called_coloured_only_if_it_is(card, noise, coloured):
    records = hidden_records({}, seed=31, noise=noise, seconds=90.0)
    found = diagnose(records, card, seed=0, gains_wanted=False)
    assert ("colored" in found.noise.labels) is coloured, found.noise.lag1
