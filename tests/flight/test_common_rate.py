"""Records of several rates brought to one."""

import numpy as np

from bayes_aero.flight.reading.common_rate import at_common_rate, rate_notes
from bayes_aero.flight.record import FlightRecord


def record(name, rate, frequency=0.5, seconds=20.0):
    time = np.arange(round(seconds * rate) + 1) / rate
    return FlightRecord.from_arrays(name, time, {"alpha": np.sin(2.0 * np.pi * frequency * time)})


def test_records_of_the_usual_rate_are_left_as_they_are():
    given = [record("a", 25.0), record("b", 25.0)]
    assert all(new is old for new, old in zip(at_common_rate(given), given, strict=True))
    assert rate_notes(given) == ()
    slow = [record("a", 10.0)]
    assert at_common_rate(slow)[0] is slow[0]


def test_a_fast_record_keeps_what_is_slow_and_loses_what_would_alias():
    (slow,) = at_common_rate([record("a", 100.0)])
    assert abs(slow.dt - 0.04) < 1e-9
    inner = (slow.time > 2.0) & (slow.time < 18.0)
    np.testing.assert_allclose(slow["alpha"][inner], np.sin(np.pi * slow.time[inner]), atol=5e-3)
    (buzz,) = at_common_rate([record("a", 100.0, frequency=24.0)])  # would be seen at 1 Hz
    assert np.std(buzz["alpha"][inner]) < 0.02


def test_two_rates_meet_at_the_slower_one():
    given = [record("a", 10.0), record("b", 100.0)]
    assert [round(1.0 / r.dt) for r in at_common_rate(given)] == [10, 10]
    (said,) = rate_notes(given)
    assert "b (100 Hz)" in said
    assert "10 Hz" in said
