"""Channels that stand still or lie on straight lines, and are sound or not."""

import numpy as np
import pytest

from bayes_aero.flight.card import read_card
from bayes_aero.flight.health.channel import frozen, interpolated_period
from bayes_aero.flight.record import FlightRecord


# Channels that are computed, not measured, stand still in trim: that is no fault. A sensor that stands still is
def flight() -> dict[str, np.ndarray]:
    """Three seconds of trim, then slow climbs and descents, at 20 Hz; thrust and density from tables, rounded."""
    t = np.arange(0.0, 12.0, 0.05)
    rng = np.random.default_rng(3)
    late = np.maximum(t - 3.0, 0.0)
    height = 2500.0 + 30.0 * np.sin(0.5 * late)
    return {
        "time": t, "ax": 0.3 + 0.02 * rng.standard_normal(len(t)), "az": -9.8 + 0.05 * rng.standard_normal(len(t)),
        "q": 0.01 * np.sin(late) + 3e-4 * rng.standard_normal(len(t)),
        "theta": 0.05 + 0.01 * (1.0 - np.cos(late)) + 2e-4 * rng.standard_normal(len(t)),
        "airspeed": 75.0 + 0.1 * late + 0.1 * rng.standard_normal(len(t)),
        "thrust": np.round(4667.0 - 20.0 * np.sin(0.5 * late), 2),
        "density": np.round(0.9568 * np.exp(-(height - 2500.0) / 9000.0), 6),
    }  # fmt: skip


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


# Rounding of a smooth channel is no interpolation; straight lines between slow samples are, rounded too
T = 0.05 * np.arange(400)
SWING = 1.0e-6 * np.sin(2.0 * np.pi * T / 8.0)


SLOW = 0.001857 + np.interp(T, 0.2 * np.arange(101), np.random.default_rng(5).normal(0.0, 1e-6, 101))
SERIES = {  # values, their last digit, samples between two that were recorded
    # Air density of a wings-level flight moves in its last digits; computed from height, it is as smooth as that.
    **{
        f"smooth, {x:g}, {k:g}": (k * (0.001857 + SWING), k * x, 0.0)
        for x in (1e-9, 1e-8, 5e-8)
        for k in (1.0, 515.379)
    },
    # Of a steady slope the last digit steps in a regular pattern, which is not that of slow samples.
    **{f"slope {x:g}": (0.001857 + x * np.arange(400), 1e-9, 0.0) for x in (1.1661538e-9, 1.853846e-9, 2.00666667e-9)},
    **{f"lines, {x:g}": (SLOW, x, 4.0) for x in (0.0, 1e-9)},
}


@pytest.mark.parametrize("name", SERIES)
def test_straight_lines_between_slow_samples_are_found_and_no_rounding(name):
    x, step, period = SERIES[name]
    assert interpolated_period(step * np.round(x / step) if step else x) == pytest.approx(period)


@pytest.mark.parametrize("lag", [3.0, 8.0, 20.0])
@pytest.mark.parametrize("step", [0.0, 0.02, 0.2])
def test_answers_to_steps_at_whole_seconds_are_not_interpolated(lag, step):
    """Of an actuator of first order, samples; they bend at every 25th sample alone, where the pilot moves."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        asked = np.repeat(rng.choice([-1.0, 0.0, 1.0], 60), 25)
        x = np.convolve(asked, np.exp(-np.arange(200) / lag) / lag)[: len(asked)]
        assert interpolated_period(step * np.round(x / step) if step else x) == 0.0
