"""How far sizes may be off: noise that was added is read off the record, and its bias is seen and taken off."""

import jax.numpy as jnp
import numpy as np
import pytest
from test_confirmation import with_added

from bayes_aero.diagnosis.screening.accuracy import filtered_channels, noise_effect, recording_noise, sizes
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.joined_channels import despiked, join
from bayes_aero.physics.filters import smooth
from bayes_aero.simulate.demo import simulate_stall
from bayes_aero.simulate.injection import flyable


@pytest.fixture(scope="module")
def noisy(clean_records):
    """Clean simulated records with white noise of known deviations, and the deviations."""
    rng = np.random.default_rng(20)
    noise = {"alpha": rng.uniform(3e-4, 3e-3), "q": rng.uniform(2e-4, 2e-3), "airspeed": rng.uniform(0.05, 0.5)}
    noise["elevator"] = rng.uniform(2e-4, 1e-3)
    records = []
    for record in clean_records:
        channels = {name: np.array(x) for name, x in record.channels.items()}
        for name, sd in noise.items():
            channels[name] += sd * rng.standard_normal(record.n)
        records.append(FlightRecord.from_arrays(record.name, np.asarray(record.time), channels))
    return records, noise


def test_recording_noise_is_read_off_the_record_and_motion_is_not_noise(card, noisy):
    records, noise = noisy
    found = recording_noise(join(records, card))
    for name, sd in noise.items():
        assert found[name] == pytest.approx(sd, rel=0.06), name
    assert found["theta"] < 1e-5  # moves by tenths of a radian, recorded without noise


def test_noise_that_was_filtered_before_recording_is_said_to_be_unreadable(card, noisy):
    records, _ = noisy
    assert filtered_channels(join(records, card)) == ()
    smoothed = []
    for record in records:
        channels = {name: np.array(x) for name, x in record.channels.items()}
        channels["alpha"] = np.asarray(smooth(jnp.asarray(channels["alpha"])))
        smoothed.append(FlightRecord.from_arrays(record.name, np.asarray(record.time), channels))
    assert filtered_channels(join(smoothed, card)) == ("alpha",)


def test_spikes_are_repaired_and_steps_of_a_quantised_channel_are_not(card):
    record = simulate_stall(0, card=card)
    channels = {name: np.array(x) for name, x in record.channels.items()}
    channels["theta"] = np.round(channels["theta"] / 5e-4) * 5e-4
    at = np.random.default_rng(4).choice(np.arange(50, record.n - 50), 6, replace=False)
    channels["q"][at] += 0.2
    flights = join([FlightRecord.from_arrays("spiked", np.asarray(record.time), channels)], card)
    repaired, count = despiked(flights)
    assert count["q"] == 6
    assert "theta" not in count  # four of its steps were taken for spikes once
    assert np.max(np.abs(np.asarray(repaired.channels["q"])[at] - np.asarray(record["q"])[at])) < 0.05


@pytest.mark.verify
def test_size_freed_of_what_noise_adds_is_nearer_to_the_truth(card, model):
    """Ten times the usual noise of the sensors biases least squares by a tenth of Cma2, for alpha squared is noisy."""
    name, plain, freed, seen = "alpha_squared_moment", [], [], 0
    for seed in np.random.default_rng(77).integers(100_000, size=3):
        effects, flights = flyable([name], seed=int(seed), noise="white", seconds=90.0, sensor_noise=10.0)
        state = with_added(card, model, [flight.record for flight in flights], [name])
        fit, truth = state.fit(), effects[name]["Cma2"]
        column = int(state.full.columns(["Cma2"])[0])
        plain.append(abs(state.theta[column] - truth))
        freed.append(abs(sizes(state, fit)["Cma2"].mean - truth))
        bias, spread = noise_effect(state, fit)
        at = list(fit.columns).index(column)
        if abs(bias[at]) > spread[at]:  # else chance may decide the sign
            assert np.sign(bias[at]) == np.sign(state.theta[column] - truth)
            seen += 1
    assert seen > 0
    assert np.sum(freed) < 0.7 * np.sum(plain)
