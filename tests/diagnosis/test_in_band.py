"""The causes in a band of frequencies: the truth of a simulated flight, and a size that the band does not confirm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.in_band.fit import band_of, causes_in_band, with_sensor_errors_held
from bayes_aero.report.design.in_band import in_band_sentences
from bayes_aero.simulate.injection import flyable


@pytest.fixture(scope="module")
def hidden(card):
    effects, flights = flyable(["alpha_dot_moment"], seed=2, noise="ar1", seconds=90.0)
    return effects["alpha_dot_moment"]["Cmadot"], diagnose([f.record for f in flights], card, gains_wanted=False)


@pytest.fixture(scope="module")
def shown(hidden):
    return causes_in_band(hidden[1])


def test_the_band_gives_the_size_that_was_hidden(hidden, shown):
    (size,) = shown.sizes
    mean, sd = size.in_band
    assert size.cause == "alpha_dot_moment"
    assert abs(mean - hidden[0]) < 3.0 * sd
    assert sd < 0.1 * abs(hidden[0])
    assert size.apart < 3.0
    (sentence,) = in_band_sentences(shown)
    assert "agree: alpha_dot_moment" in sentence


def test_the_band_is_that_of_the_motion(hidden, shown):
    """From two periods of the shorter manoeuvre; nearly all power of the pitch rate is inside."""
    flights = hidden[1].aerodynamics.state.responses.flights
    assert shown.band == band_of(flights)
    assert shown.band[0] == pytest.approx(2.0 / 90.04, rel=1e-3)
    q = np.asarray(flights.channels["q"])[: flights.lengths[0]]
    frequency, power = np.fft.rfftfreq(len(q), 0.04), np.abs(np.fft.rfft(q - q.mean())) ** 2
    assert power[frequency <= shown.band[1]].sum() > 0.95 * power.sum()


def test_a_size_that_is_not_in_the_band_is_told(hidden):
    """As a slow model error would leave it."""
    found = hidden[1]
    (cause,) = found.causes
    size = cause.parameters["Cmadot"]
    off = replace(size, mean=size.mean + 6.0 * size.sd)
    (one,) = causes_in_band(replace(found, causes=(replace(cause, parameters={"Cmadot": off}),))).sizes
    assert one.apart > 3.0
    shown = causes_in_band(replace(found, causes=(replace(cause, parameters={"Cmadot": off}),)))
    assert "a drift or a slow model error has a part in it" in in_band_sentences(shown)[0]


def test_an_error_of_a_sensor_that_was_found_before_keeps_its_value(hidden):
    """It is no candidate of the coefficients, and the model in the band has it all the same."""
    state = hidden[1].aerodynamics.state
    theta = state.theta.copy()
    theta[state.full.columns(["accel_z_bias"])] = 0.3
    model, start = with_sensor_errors_held(replace(state, theta=theta))
    assert model.values(start)["accel_z_bias"] == 0.3
    assert "accel_z_bias" not in model.names
    assert set(model.names) == {p for n in (*state.full.base, *state.active) for p in state.full.parameters_of(n)}


def test_without_causes_there_is_nothing_to_fit(hidden):
    assert causes_in_band(replace(hidden[1], causes=())) is None
    assert in_band_sentences(None) == ()
