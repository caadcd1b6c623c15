"""Hide an effect, or nothing, in simulated flights and diagnose them; every effect is in test_every_effect.py, and the
full study in benchmarks."""

import numpy as np
import pytest
from out_of_catalogue import unknown

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.result import Verdict
from bayes_aero.effects import CATALOGUE
from bayes_aero.simulate.injection import flyable, hidden_flights, hidden_records

# Clearly visible at every size in their range; the study covers the whole catalogue and the edge of detection.
SENSORS = ("alpha_scale", "airspeed_bias", "pitch_rate_bias", "accel_x_bias")
OTHERS = ("thrust_moment", "stabilizer_trim", "sideslip_drag", "pitch_rate_lift", "mass_scale", "elevator_delay")


def draw(seed: int, names: tuple[str, ...]) -> str:
    return str(np.random.default_rng([seed, 7]).choice(names))


@pytest.mark.recovery
@pytest.mark.parametrize("seed", [4101, pytest.param(4102, marks=pytest.mark.verify)])
@pytest.mark.parametrize("family", [SENSORS, OTHERS])
def test_a_hidden_effect_is_named_with_its_size(seed, family, card):
    name = draw(seed, family)
    effects, flights = flyable([name], seed=seed, noise="ar1", seconds=90.0)
    found = diagnose([flight.record for flight in flights], card, seed=seed, gains_wanted=False)
    assert found.causes, (name, effects)
    first = found.causes[0]
    assert first.name == name or name in first.ambiguous_with
    assert not found.changes
    if first.name == name:
        for parameter, true in effects[name].items():
            size = first.parameters[parameter]
            # Five deviations, and a twentieth of the size: recorded regressors carry noise.
            assert abs(size.mean - true) < 5 * size.sd + 0.05 * abs(true), parameter


@pytest.mark.recovery
@pytest.mark.parametrize("seed", [4301, pytest.param(4302, marks=pytest.mark.verify)])
def test_a_hidden_wave_is_called_unexplained_by_its_period(seed, card):
    flights = hidden_flights({}, seed=seed, noise="ar1", beyond=unknown("periodic"), seconds=90.0)
    found = diagnose([flight.record for flight in flights], card, seed=seed, gains_wanted=False)
    assert found.verdict is Verdict.UNEXPLAINED, [c.name for c in found.causes]
    waves = [u for u in found.unknown if u.channel.startswith("time, period")]
    assert waves, found.unknown
    period = float(max(waves, key=lambda u: u.share).channel.split()[2])
    assert period == pytest.approx(float(flights[0].values["unknown_period"]), rel=0.1)


# In the buffet of the last one a wave of 15 s takes a fifth of what is left of the lift.
SILENT = [(4202, "ar1"), (141128, "buffet")]
MORE = [pytest.param(*x, marks=pytest.mark.verify) for x in ((4201, "white"), (4203, "buffet"), (4204, "outliers"))]


@pytest.mark.recovery
@pytest.mark.parametrize(("seed", "noise"), [*SILENT, *MORE])
def test_nothing_is_found_where_nothing_is_hidden(seed, noise, card):
    found = diagnose(hidden_records({}, seed=seed, noise=noise, seconds=90.0), card, seed=seed, gains_wanted=False)
    assert found.verdict is Verdict.NO_EFFECT, [c.name for c in found.causes]
    assert "spoiler_lift" in found.not_testable or "spoiler_lift" not in CATALOGUE
