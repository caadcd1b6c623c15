"""Multisines: what orthogonal, flat and periodic mean, computed from the signals alone."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_aero.dynamics.simulated.manoeuvres import SECONDS, multisine_inputs
from bayes_aero.dynamics.simulated.multisines import multisines, peak_factor
from bayes_aero.errors import InputError

DT, PERIOD, BAND = 0.04, 25.0, (0.1, 1.4)
TIME = np.arange(0.0, PERIOD, DT)


@pytest.fixture(scope="module")
def three():
    return multisines(TIME, PERIOD, BAND, 3)


def test_controls_are_orthogonal_and_share_no_frequency(three):
    shared = three @ three.T
    np.testing.assert_allclose(shared - np.diag(np.diag(shared)), 0.0, atol=1e-10 * shared[0, 0])
    spectra = np.abs(np.fft.rfft(three)) > 1e-6 * len(TIME)
    frequencies = np.fft.rfftfreq(len(TIME), DT)
    assert np.all(spectra.sum(axis=0) <= 1)
    excited = frequencies[spectra.any(axis=0)]
    np.testing.assert_allclose(excited, np.arange(3, 36) / PERIOD)  # every multiple of 1/T from 0.1 to 1.4 Hz


def test_orthogonal_inputs_stay_so_through_any_linear_system(three):
    """Of a whole period, circular convolution with any response keeps the frequencies."""
    response = np.exp(-TIME)[None, :] * np.array([[1.0], [-2.0], [0.5]])
    answers = np.fft.irfft(np.fft.rfft(three) * np.fft.rfft(response), len(TIME))
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


def test_a_sine_has_the_peak_factor_one():
    assert peak_factor(np.sin(2.0 * np.pi * np.arange(1000) / 1000.0)) == pytest.approx(1.0, rel=1e-6)


def test_the_standard_manoeuvre_holds_whole_periods():
    time = np.arange(0.0, SECONDS, DT)
    signals = multisine_inputs(time, 3)
    one, two = (signals[:, round(begin / DT) : round((begin + PERIOD) / DT)] for begin in (5.0, 30.0))
    np.testing.assert_allclose(one, two, atol=1e-9)
    assert not np.any(signals[:, time < 5.0 - DT / 2])
    assert not np.any(signals[:, time > 55.0 - DT / 2])


def test_a_narrow_band_is_refused():
    with pytest.raises(InputError, match=r"1 multiples of 1/25 s, and 1 multisines need 2 above zero; widen the band"):
        multisines(TIME, PERIOD, (0.1, 0.12), 1)
