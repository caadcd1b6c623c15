"""A model flown with given parameters: the truth flies a simulated record, and a wrong derivative does not."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_aero.diagnosis.trajectories.time_histories import fly_given
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.flight.card.card import read_card
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model
from bayes_aero.simulate.demo import TRUTH, simulate_stall

BAND = {"alpha": np.radians(2.0), "theta": np.radians(2.0)}


@pytest.fixture(scope="module")
def flights():
    """One manoeuvre without noise or disturbance."""
    card = read_card("attas")
    return card, join([simulate_stall(0, card=card, sensor_noise=0.0, disturbance=0.0)], card, FLIGHT)


def flown(flights, **changed):
    card, joined = flights
    (path,) = fly_given(joined, Model.from_card(card), {**TRUTH, **changed}, BAND)
    return path


def test_the_truth_flies_what_was_recorded(flights):
    path = flown(flights)
    assert path.inside
    assert path.errors["alpha"].rms < np.radians(0.1)
    assert path.errors["airspeed"].rms < 0.3
    assert path.errors["alpha"].within == path.errors["theta"].within == 1.0
    assert path.errors["q"].tolerance is None


def test_a_wrong_stability_derivative_does_not(flights):
    right, wrong = flown(flights), flown(flights, Cma=0.7 * TRUTH["Cma"])
    assert wrong.errors["alpha"].rms > 10.0 * right.errors["alpha"].rms
    assert wrong.errors["alpha"].within < 0.9


def test_what_was_measured_is_shown_as_it_was(flights):
    joined = flights[1]
    path = flown(flights)
    assert np.array_equal(path.measured["theta"], np.asarray(joined.channels["theta"]))
    worst = np.max(np.abs(path.measured["theta"] - path.simulated["theta"]))
    assert path.errors["theta"].largest == pytest.approx(worst)
