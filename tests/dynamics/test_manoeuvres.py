"""Inputs of manoeuvres: pulses, rounded steps and multisines, by definition."""

import numpy as np
import pytest

from bayes_aero.dynamics.pilot import (
    SECONDS,
    multisine_inputs,
    multisines,
    pulses,
    rounded,
    steps,
    three_two_one_one,
)
from bayes_aero.errors import InputError

# Shapes of inputs: what a 3-2-1-1, a later pulse and a rounded step are by definition
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


# Multisines: what orthogonal, flat and periodic mean, computed from the signals alone
DT, PERIOD, BAND = 0.04, 25.0, (0.1, 1.4)
ONE_PERIOD = np.arange(0.0, PERIOD, DT)


def peak_factor(signal):
    """Half the range over that of a sine of the same root mean square; 1 for a sine."""
    return np.ptp(signal) / (2.0 * np.sqrt(2.0 * np.mean(np.square(signal))))


@pytest.fixture(scope="module")
def three():
    return multisines(ONE_PERIOD, PERIOD, BAND, 3)


def test_multisines_are_orthogonal_and_stay_so_through_any_linear_system(three):
    shared = three @ three.T
    np.testing.assert_allclose(shared - np.diag(np.diag(shared)), 0.0, atol=1e-10 * shared[0, 0])
    spectra = np.abs(np.fft.rfft(three)) > 1e-6 * len(ONE_PERIOD)
    frequencies = np.fft.rfftfreq(len(ONE_PERIOD), DT)
    assert np.all(spectra.sum(axis=0) <= 1)
    excited = frequencies[spectra.any(axis=0)]
    np.testing.assert_allclose(excited, np.arange(3, 36) / PERIOD)  # every multiple of 1/T from 0.1 to 1.4 Hz
    # Of a whole period, circular convolution with any response keeps the frequencies.
    response = np.exp(-ONE_PERIOD)[None, :] * np.array([[1.0], [-2.0], [0.5]])
    answers = np.fft.irfft(np.fft.rfft(three) * np.fft.rfft(response), len(ONE_PERIOD))
    shared = answers @ answers.T
    np.testing.assert_allclose(shared - np.diag(np.diag(shared)), 0.0, atol=1e-10 * np.max(shared))


@pytest.mark.parametrize(("controls", "least"), [(1, 1.1), (3, 1.3)])
def test_peaks_are_small_and_the_signal_begins_at_zero(controls, least):
    """In phase 33 cosines have a relative peak factor of about 4; Morelli accepts up to 1.3 for a few of them."""
    signals = multisines(np.arange(0.0, PERIOD, 0.005), PERIOD, BAND, controls)
    np.testing.assert_allclose(signals[:, 0], 0.0, atol=1e-9)
    for signal in signals:
        assert peak_factor(signal) < least
        assert np.max(np.abs(signal)) == pytest.approx(1.0, abs=1e-2)


def test_multisines_of_the_standard_manoeuvre_and_of_a_narrow_band():
    assert peak_factor(np.sin(2.0 * np.pi * np.arange(1000) / 1000.0)) == pytest.approx(1.0, rel=1e-6)
    time = np.arange(0.0, SECONDS, DT)
    signals = multisine_inputs(time, 3)
    one, two = (signals[:, round(begin / DT) : round((begin + PERIOD) / DT)] for begin in (5.0, 30.0))
    np.testing.assert_allclose(one, two, atol=1e-9)
    assert not np.any(signals[:, time < 5.0 - DT / 2])
    assert not np.any(signals[:, time > 55.0 - DT / 2])
    with pytest.raises(InputError, match=r"1 multiples of 1/25 s, and 1 multisines need 2 above zero; widen the band"):
        multisines(ONE_PERIOD, PERIOD, (0.1, 0.12), 1)
