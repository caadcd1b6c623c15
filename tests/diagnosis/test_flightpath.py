"""Flight-path kinematics against flown flights, and spikes."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.model.joined_channels import despiked, join
from bayes_aero.physics.filters import LONG_REACH, differentiate_joined, smooth_joined
from bayes_aero.physics.flightpath import LATERAL, PATH, integral, path_rates, side_force
from bayes_aero.physics.kinematics import Rotation, lever_arm
from bayes_aero.simulate.injection import hidden_records


@pytest.fixture(scope="module")
def quiet(card):
    """Two flights with bank and sideslip, without any noise."""
    return join(hidden_records({}, seed=12, noise="white", sensor_noise=0.0, disturbance=0.0), card)


def test_recorded_path_is_the_integral_of_its_rates(quiet, card):
    signals = quiet.with_slopes(quiet.channels)
    rates = path_rates(signals, card.aircraft)
    start, first = quiet.channels["start"], quiet.channels["first"]
    # Smoothing and the trapezoidal rule err where the flight bends within half a second.
    tolerance = {"airspeed": 0.05, "alpha": 1e-3, "theta": 5e-4, "altitude": 0.5, "beta": 1e-3, "phi": 1e-3}
    for name in (*PATH, *LATERAL):
        found = signals[name][first] + integral(rates[name], signals["dt"], start, first)
        off = np.abs(np.asarray(found - signals[name]))
        assert off.max() < tolerance[name], name
        assert np.ptp(np.asarray(signals[name])) > 20 * tolerance[name], name


def test_the_vane_tells_the_lateral_force_that_the_accelerometer_felt(quiet, card):
    """The flights were made with the body's equations: v-dot + r u - p w less gravity, and the sensor off the CG."""
    ends = (quiet.channels[name] for name in ("dt", "first", "last"))
    signals = quiet.with_slopes(quiet.channels)
    signals["beta_dot"] = differentiate_joined(quiet.channels["beta"], *ends)
    rates = Rotation(*(signals[name] for name in ("p", "q", "r", "p_dot", "q_dot", "r_dot")))
    felt = {
        name: signals[name] - arm
        for name, arm in zip(("ax", "ay", "az"), lever_arm(rates, card.aircraft.accelerometer), strict=True)
    }
    found = side_force(signals, felt["ax"], felt["az"])
    assert np.ptp(np.asarray(felt["ay"])) > 1.0
    off = np.abs(np.asarray(found - felt["ay"]))
    assert np.quantile(off, 0.99) < 0.01 * np.ptp(np.asarray(felt["ay"]))


def test_alpha_dot_has_the_gyro_s_noise_and_not_its_offset(quiet):
    """The vane's noise, differentiated, is what a one-sided hysteresis makes a bias of."""
    dt, first, last = (quiet.channels[name] for name in ("dt", "first", "last"))
    truth = np.asarray(differentiate_joined(quiet.channels["alpha"], dt, first, last))
    inner = np.asarray(jnp.minimum(jnp.arange(quiet.n) - first, last - jnp.arange(quiet.n))) > LONG_REACH
    rng = np.random.default_rng(9)
    noise = {"alpha": 1e-3, "q": 1e-3, "az": 0.05, "airspeed": 0.2}
    noisy = {name: quiet.channels[name] + sd * rng.standard_normal(quiet.n) for name, sd in noise.items()}
    channels = quiet.channels | noisy
    found = np.asarray(quiet.with_slopes(channels)["alpha_dot"])
    vane = np.asarray(differentiate_joined(smooth_joined(channels["alpha"], first, last), dt, first, last))
    smoothed, true = (np.asarray(smooth_joined(jnp.asarray(x), first, last)) for x in (found, truth))
    assert np.std((smoothed - true)[inner]) < 0.4 * np.std((vane - truth)[inner])
    exact = np.asarray(quiet.with_slopes(quiet.channels)["alpha_dot"])
    assert np.std((exact - truth)[inner]) < 0.01 * np.std(truth[inner])
    off = channels | {"q": channels["q"] + 0.01, "az": channels["az"] + 0.4}
    moved = np.asarray(quiet.with_slopes(off)["alpha_dot"]) - found
    assert np.abs(moved[inner]).max() < 1e-4  # of 0.016 rad/s that the two offsets make together


def test_a_drag_free_fall_keeps_its_energy(card):
    """No force but gravity: V dV + g dh = 0 whatever the attitude."""
    rng = np.random.default_rng(5)
    n = 50
    s = {name: jnp.asarray(rng.uniform(-0.3, 0.3, n)) for name in ("p", "q", "r", "phi", "theta", "alpha", "beta")}
    s |= {name: jnp.zeros(n) for name in ("ax", "ay", "az", "p_dot", "q_dot", "r_dot")}
    s["airspeed"] = jnp.asarray(rng.uniform(50, 120, n))
    at_cg = replace(card.aircraft, accelerometer=(0.0, 0.0, 0.0))
    rates = path_rates(s, at_cg)
    np.testing.assert_allclose(s["airspeed"] * rates["airspeed"] + 9.80665 * rates["altitude"], 0.0, atol=1e-9)


def test_spikes_are_replaced_and_nothing_else(quiet):
    rng = np.random.default_rng(8)
    x = np.array(quiet.channels["az"]) + 0.05 * rng.standard_normal(quiet.n)
    at = rng.choice(np.arange(20, quiet.n - 20, 40), 15, replace=False)
    spiked = x.copy()
    spiked[at] += 2.0 * rng.choice([-1.0, 1.0], len(at))
    found, count = despiked(eqx.tree_at(lambda f: f.channels["az"], quiet, jnp.asarray(spiked)))
    assert count["az"] == len(at)
    off = np.abs(np.asarray(found.channels["az"]) - x)
    assert off[at].max() < 0.5
    assert np.delete(off, at).max() == 0.0


def test_a_step_is_not_a_spike(quiet):
    x = np.where(np.asarray(quiet.channels["elapsed"]) > 30.0, 5.0, 0.0)
    x = x + 0.01 * np.random.default_rng(3).standard_normal(quiet.n)
    found, count = despiked(eqx.tree_at(lambda f: f.channels["q"], quiet, jnp.asarray(x)))
    assert "q" not in count
    np.testing.assert_array_equal(np.asarray(found.channels["q"]), x)


def test_the_sharp_peak_of_a_doublet_is_not_a_spike_and_a_spike_on_its_flank_is(quiet):
    """A pitch rate that stands still, then runs to and fro at a constant slope, as after a 3-2-1-1 at 20 Hz."""
    rng = np.random.default_rng(4)
    time = np.asarray(quiet.channels["elapsed"])
    x = np.interp(time, [30.0, 30.6, 31.4, 32.2, 32.6], [0.0, 0.35, -0.35, 0.25, 0.0])
    x = x + 0.001 * rng.standard_normal(quiet.n)
    found, count = despiked(eqx.tree_at(lambda f: f.channels["q"], quiet, jnp.asarray(x)))
    assert "q" not in count
    np.testing.assert_array_equal(np.asarray(found.channels["q"]), x)
    at = int(np.searchsorted(time, 31.0))
    spiked = x.copy()
    spiked[at] += 0.2
    found, count = despiked(eqx.tree_at(lambda f: f.channels["q"], quiet, jnp.asarray(spiked)))
    assert count["q"] == 1
    assert abs(np.asarray(found.channels["q"])[at] - x[at]) < 0.05
