"""What trajectories alone have tested: errors against the noise of sensors, and the verdict that follows."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_aero.diagnosis import result as finding
from bayes_aero.diagnosis.result import OutputMiss, Verdict, as_tested
from bayes_aero.diagnosis.trajectories.noise_check import beyond_noise
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.io import diagnosis_json as diagnosis_results
from tests.simulated_halves import halves

DEG = np.pi / 180.0
NAN = float("nan")


def test_an_error_of_which_more_than_half_is_no_noise_is_beyond_it():
    """Noise of variance 1 and as much again of another origin: root mean square sqrt(2)."""
    assert not OutputMiss(1.0, 1.0, NAN).beyond
    assert not OutputMiss(1.0, 1.414, 9.0).beyond  # the noise of the measured initial state is in what is unseen
    assert OutputMiss(1.0, 1.4143, NAN).beyond
    assert OutputMiss(0.0, 1e-9, NAN).beyond
    assert OutputMiss(1.0, NAN, NAN).beyond
    assert OutputMiss(1.0, np.inf, NAN).beyond


def test_causes_explain_only_where_noise_alone_is_left():
    noise, more = (finding.Tested({"alpha": OutputMiss(1.0, x, x)}) for x in (1.0, 3.0))
    never = finding.Tested({})
    assert [as_tested(Verdict.EXPLAINED, t) for t in (noise, more, never)] == [
        Verdict.EXPLAINED,
        Verdict.PARTLY_EXPLAINED,
        Verdict.PARTLY_EXPLAINED,
    ]
    assert [as_tested(Verdict.NO_EFFECT, t) for t in (noise, more, never)] == [
        Verdict.NO_EFFECT,
        Verdict.UNDECIDED,
        Verdict.NO_EFFECT,
    ]
    assert as_tested(Verdict.UNEXPLAINED, noise) is Verdict.UNEXPLAINED
    assert [
        diagnosis_results.tested_results(t, finding.TRAJECTORIES)["within_noise"] for t in (noise, more, never)
    ] == [True, False, None]


def test_errors_are_judged_by_the_noise_that_the_card_states(card):
    """The extended model is off by a tenth of a degree: noise of 0.1 deg makes that, noise of 0.02 deg does not."""
    n = 400
    t = 0.05 * np.arange(n)
    smooth = {"airspeed": 100.0 + np.sin(t), "alpha": 0.05 + 0.02 * np.sin(0.5 * t)}
    record = FlightRecord.from_arrays("a", t, smooth)
    flown = halves(record)
    for sd, beyond in ((0.1 * DEG, False), (0.02 * DEG, True)):
        stated = replace(card, sensors={"alpha": sd, "airspeed": 0.3})
        found = beyond_noise(flown, [record], stated)["alpha"]
        assert found.noise == pytest.approx(sd)
        assert found.fitted == pytest.approx(0.1 * DEG)
        assert found.beyond is beyond
