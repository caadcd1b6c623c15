"""Rounding of a smooth channel is no interpolation; straight lines between slow samples are, rounded too."""

import numpy as np
import pytest

from bayes_aero.flight.health.channel.held import interpolated_period

T = 0.05 * np.arange(400)
SWING = 1.0e-6 * np.sin(2.0 * np.pi * T / 8.0)


@pytest.mark.parametrize("step", [1e-9, 1e-8, 5e-8])
@pytest.mark.parametrize("scale", [1.0, 515.379])
def test_a_smooth_channel_that_is_rounded_is_not_interpolated(step, scale):
    """Air density of a wings-level flight moves in its last digits; computed from height, it is as smooth as that."""
    x = scale * step * np.round((0.001857 + SWING) / step)
    assert interpolated_period(x) == 0.0


@pytest.mark.parametrize("slope", [1.1661538e-9, 1.853846e-9, 2.00666667e-9])
def test_a_steady_slope_that_is_rounded_is_not_interpolated(slope):
    """The last digit steps in a regular pattern, which is not that of slow samples."""
    assert interpolated_period(1e-9 * np.round((0.001857 + slope * np.arange(400)) / 1e-9)) == 0.0


@pytest.mark.parametrize("step", [0.0, 1e-9])
def test_straight_lines_between_slow_samples_are_found(step):
    slow = np.random.default_rng(5).normal(0.0, 1e-6, 101)
    x = 0.001857 + np.interp(T, 0.2 * np.arange(101), slow)
    x = step * np.round(x / step) if step else x
    assert interpolated_period(x) == pytest.approx(4.0)


@pytest.mark.parametrize("lag", [3.0, 8.0, 20.0])
@pytest.mark.parametrize("step", [0.0, 0.02, 0.2])
def test_answers_to_steps_at_whole_seconds_are_not_interpolated(lag, step):
    """Of an actuator of first order, samples; they bend at every 25th sample alone, where the pilot moves."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        asked = np.repeat(rng.choice([-1.0, 0.0, 1.0], 60), 25)
        x = np.convolve(asked, np.exp(-np.arange(200) / lag) / lag)[: len(asked)]
        assert interpolated_period(step * np.round(x / step) if step else x) == 0.0
