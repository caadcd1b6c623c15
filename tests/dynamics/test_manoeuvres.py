"""Shapes of inputs: what a 3-2-1-1, a later pulse and a rounded step are by definition."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_aero.dynamics.simulated.manoeuvres import pulses, rounded, steps, three_two_one_one

DT = 0.04
TIME = np.arange(-125, 1500) * DT


@pytest.mark.parametrize("begin", [5.0, 32.0])
def test_a_3_2_1_1_lasts_as_many_samples_as_its_name_says(begin):
    """Units of 0.8 s, 20 samples each: edges fall on samples, though 3 x 0.8 is not 2.4 in floating point."""
    signal = pulses(TIME, three_two_one_one(begin, 0.8, 2.0))
    changes = np.flatnonzero(np.diff(signal)) + 1
    np.testing.assert_allclose(TIME[changes[0]], begin)
    np.testing.assert_array_equal(np.diff(changes), [60, 40, 20, 20])
    np.testing.assert_array_equal(signal[changes], [2.0, -2.0, 2.0, -2.0, 0.0])


def test_a_later_pulse_replaces_an_earlier_one_while_it_lasts():
    signal = pulses(TIME, [(1.0, 10.0, 1.0), (3.0, 5.0, -2.0), *steps((20.0, 4.0))])
    at = lambda t: signal[np.searchsorted(TIME, t)]
    assert [at(t) for t in (0.5, 2.0, 4.0, 7.0, 15.0, 59.0)] == [0.0, 1.0, -2.0, 1.0, 0.0, 4.0]


@pytest.mark.parametrize("dt", [0.01, 0.04, 0.5])
def test_a_rounded_step_ends_where_the_step_ends_and_is_half_way_at_its_middle(dt):
    time = np.arange(-10.0, 10.0, dt)
    step = np.where(time < -0.25 * dt, 0.0, 1.0)
    smooth = rounded(step, 2.0, dt)
    assert len(smooth) == len(time)
    np.testing.assert_allclose(smooth[np.abs(time) > 1.0 + dt], step[np.abs(time) > 1.0 + dt], atol=1e-12)
    assert np.all(np.diff(smooth) > -1e-12)
    middle = int(np.argmin(np.abs(time)))
    assert 0.5 * (smooth[middle - 1] + smooth[middle]) == pytest.approx(0.5)  # the window is symmetric
