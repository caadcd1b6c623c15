"""alpha-dot from vane, gyro and lift: near the truth, and without the noise of the lift that it may explain."""

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.flight.card.card import read_card
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Forming, observe
from bayes_aero.simulate.injection import hidden_flights

INNER = slice(60, -60)  # away from the ends, where the vane alone is taken


@pytest.fixture(scope="module")
def flight():
    card = read_card("attas")
    (flown,) = hidden_flights({}, seed=41, manoeuvres=1, noise="white", seconds=90.0)
    return card, Model.from_card(card), flown


def test_it_is_nearer_the_truth_than_the_vane(flight):
    card, model, flown = flight
    error = {}
    for forming in Forming:
        found = np.asarray(observe([flown.record], card, model, forming).signals["alpha_dot"])
        error[forming] = np.sqrt(np.mean((found - flown.flown["alpha_dot"])[INNER] ** 2))
    assert error[Forming.MATCHED] < 0.3 * error[Forming.PUBLISHED]


def test_it_holds_no_noise_of_the_measured_lift(flight):
    """Noise on az moves the measured CL; what it moves in alpha-dot must not follow it."""
    card, model, flown = flight
    record = flown.record
    noise = 0.5 * np.random.default_rng(1).standard_normal(record.n)
    channels = dict(record.channels) | {"az": record["az"] + noise}
    noisy = type(record).from_arrays(record.name, record.time, channels)
    one, two = (observe([r], card, model) for r in (record, noisy))
    lift = np.asarray(two.measured - one.measured)[INNER, 0]
    rate = np.asarray(two.signals["alpha_dot"] - one.signals["alpha_dot"])[INNER]
    # As measured, alpha-dot would move by noise/V; a tenth of its size is left at most, and next to none is lift's.
    smoothed = np.std(lift) * np.std(noise) / np.std(lift) / float(jnp.mean(one.signals["airspeed"]))
    assert np.std(rate) < 0.1 * smoothed
    assert abs(np.polyfit(lift, rate, 1)[0]) * np.std(lift) < 0.02 * smoothed
