"""Channels that are computed, not measured, stand still in trim: that is no fault. A sensor that stands still is."""

import numpy as np
import pytest

from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.health.channel.frozen import frozen
from bayes_aero.flight.record import FlightRecord


def flight() -> dict[str, np.ndarray]:
    """Three seconds of trim, then slow climbs and descents, at 20 Hz; thrust and density from tables, rounded."""
    t = np.arange(0.0, 12.0, 0.05)
    rng = np.random.default_rng(3)
    late = np.maximum(t - 3.0, 0.0)
    height = 2500.0 + 30.0 * np.sin(0.5 * late)
    return {
        "time": t,
        "ax": 0.3 + 0.02 * rng.standard_normal(len(t)),
        "az": -9.8 + 0.05 * rng.standard_normal(len(t)),
        "q": 0.01 * np.sin(late) + 3e-4 * rng.standard_normal(len(t)),
        "theta": 0.05 + 0.01 * (1.0 - np.cos(late)) + 2e-4 * rng.standard_normal(len(t)),
        "airspeed": 75.0 + 0.1 * late + 0.1 * rng.standard_normal(len(t)),
        "thrust": np.round(4667.0 - 20.0 * np.sin(0.5 * late), 2),
        "density": np.round(0.9568 * np.exp(-(height - 2500.0) / 9000.0), 6),
    }


def faults(data) -> list[str]:
    data = dict(data)
    record = FlightRecord.from_arrays("run", data.pop("time"), data)
    return [finding.channel for finding in frozen(record, read_card("attas"))]


def test_computed_channels_stand_still_in_trim():
    assert faults(flight()) == []


@pytest.mark.parametrize("channel", ["ax", "az", "airspeed"])
def test_a_sensor_that_stands_still_is_found(channel):
    data = flight()
    data[channel][100:160] = data[channel][100]
    assert faults(data) == [channel]
