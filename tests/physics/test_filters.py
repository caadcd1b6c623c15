"""Filters against what they are known to pass exactly, and alpha-dot from vane, gyro and lift."""

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.flight.card import read_card
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Forming, observe
from bayes_aero.physics import filters
from bayes_aero.physics.separation import kirchhoff_factor, lagged, separation_point
from bayes_aero.simulate.injection import hidden_flights


# Smoothing and differentiation against what the filters are known to pass exactly
@pytest.fixture
def rng():
    return np.random.default_rng(int.from_bytes(b"filters", "big") % 2**32)


def polynomial(rng, degree, n):
    t = np.linspace(-1.0, 1.0, n)
    coefficients = rng.normal(size=degree + 1)
    return t, np.polynomial.polynomial.polyval(t, coefficients), np.polynomial.polynomial.polyder(coefficients)


def test_spencer_filter_passes_cubics_inside(rng):
    _, x, _ = polynomial(rng, 3, 60)
    smoothed = np.asarray(filters.smooth(jnp.asarray(x)))
    np.testing.assert_allclose(smoothed[7:-7], x[7:-7], atol=1e-12)


def test_ends_stay_and_next_samples_pass_straight_lines(rng):
    _, x, _ = polynomial(rng, 1, 40)
    smoothed = np.asarray(filters.smooth(jnp.asarray(x)))
    np.testing.assert_allclose(smoothed, x, atol=1e-12)
    noise = rng.normal(size=40)
    np.testing.assert_array_equal(
        np.asarray(filters.smooth(jnp.asarray(noise)))[[0, 1, 2, -3, -2, -1]], noise[[0, 1, 2, -3, -2, -1]]
    )


def test_derivatives_of_quartics_are_exact_and_of_sines_of_high_order(rng):
    t, x, derivative = polynomial(rng, 4, 50)
    found = np.asarray(filters.differentiate(jnp.asarray(x), t[1] - t[0]))
    expected = np.polynomial.polynomial.polyval(t, derivative)
    np.testing.assert_allclose(found[2:-2], expected[2:-2], atol=1e-9)
    np.testing.assert_array_equal(found[:2], found[2])
    np.testing.assert_array_equal(found[-2:], found[-3])
    errors = []
    for n in (60, 120):
        t = np.linspace(0.0, 2 * np.pi, n)
        found = np.asarray(filters.differentiate(jnp.asarray(np.sin(8 * t)), t[1] - t[0]))
        errors.append(np.abs(found - 8 * np.cos(8 * t))[8:-8].max())
    assert np.log2(errors[0] / errors[1]) > 7.0


def test_recurrence_is_the_loop_it_stands_for(rng):
    keep, drive = rng.uniform(-1, 1, (30, 2)), rng.normal(size=(30, 2))
    x, expected = np.zeros(2), []
    for a, b in zip(keep, drive, strict=True):
        x = a * x + b
        expected.append(x)
    np.testing.assert_allclose(filters.recurrence(jnp.asarray(keep), jnp.asarray(drive)), expected, atol=1e-12)


def test_separation_point_is_the_published_tanh(rng):
    alpha, a1, star = rng.uniform(-0.5, 0.8, 50), rng.uniform(5, 40), rng.uniform(0.2, 0.4)
    expected = (1 - np.tanh(a1 * (alpha - star))) / 2
    np.testing.assert_allclose(
        separation_point(jnp.asarray(a1), jnp.asarray(alpha), jnp.asarray(star)), expected, rtol=1e-9, atol=1e-14
    )
    assert float(kirchhoff_factor(jnp.asarray(1.0))) == 1.0
    assert float(kirchhoff_factor(jnp.asarray(0.0))) == pytest.approx(0.25)


def test_lag_follows_the_exponential_and_restarts_at_a_seam(rng):
    tau, dt, n = rng.uniform(0.2, 2.0), 0.04, 200
    start = np.zeros(2 * n, bool)
    start[[0, n]] = True
    step = np.tile(np.concatenate([[1.0], np.zeros(n - 1)]), 2)
    step[n:] = 0.3  # the second manoeuvre begins at rest at another value
    X = np.asarray(lagged(jnp.asarray(step), jnp.full(2 * n, tau), jnp.full(2 * n, dt), jnp.asarray(start)))
    # Input linear from 1 to 0 over the first step, then zero: the closed form of tau X' + X = u.
    first = tau / dt * (1 - np.exp(-dt / tau))
    np.testing.assert_allclose(X[1:n], first * np.exp(-dt / tau * np.arange(n - 1)), rtol=1e-9)
    np.testing.assert_allclose(X[n:], 0.3, rtol=1e-12)


def sine(n, dt, shift=0.0):
    return jnp.asarray(np.sin(2.0 * (np.arange(n) * dt + shift)))


def inside(n):
    return jnp.zeros(n, int), jnp.full(n, n - 1)


@pytest.mark.parametrize("share", [0.3, -1.7])
def test_advance_is_of_third_order_on_a_sine(share):
    def error(dt):
        n = int(4.0 / dt)
        moved = filters.advance(sine(n, dt), jnp.asarray(share * dt), jnp.full(n, dt), *inside(n))
        return float(jnp.max(jnp.abs(moved - sine(n, dt, share * dt))[4:-4]))

    assert error(0.04) < 1e-4
    assert error(0.04) / error(0.02) == pytest.approx(2.0**3, rel=0.1)


def test_advance_moves_whole_samples():
    x, dt = sine(20, 0.25), jnp.full(20, 0.25)
    later, earlier = (filters.advance(x, jnp.asarray(s), dt, *inside(20)) for s in (0.75, -0.5))
    np.testing.assert_array_equal(later, np.concatenate([x[3:], np.repeat(x[-1], 3)]))
    np.testing.assert_array_equal(earlier, np.concatenate([np.repeat(x[0], 2), x[:-2]]))


def test_joined_manoeuvres_are_filtered_as_each_alone(rng):
    pieces = [rng.normal(size=n) for n in (20, 61, 400, 33)]
    lengths = [len(x) for x in pieces]
    first = np.repeat(np.cumsum([0, *lengths[:-1]]), lengths)
    last = first + np.repeat(lengths, lengths) - 1
    x, ends = jnp.asarray(np.concatenate(pieces)), (jnp.asarray(first), jnp.asarray(last))
    dt = np.repeat([0.04, 0.02, 0.01, 0.04], lengths)
    alone = np.concatenate([filters.smooth(jnp.asarray(piece)) for piece in pieces])
    np.testing.assert_allclose(np.asarray(filters.smooth_joined(x, *ends)), alone, rtol=1e-13, atol=1e-14)
    alone = np.concatenate(
        [
            filters.differentiate(jnp.asarray(piece), d)
            for piece, d in zip(pieces, (0.04, 0.02, 0.01, 0.04), strict=True)
        ]
    )
    found = np.asarray(filters.differentiate_joined(x, jnp.asarray(dt), *ends))
    np.testing.assert_allclose(found, alone, rtol=1e-12, atol=1e-11)


def test_rows_are_differentiated_as_each_alone(rng):
    rows = rng.normal(size=(3, 80))
    first = np.repeat([0, 50], [50, 30])
    last, dt = np.repeat([49, 79], [50, 30]), np.full(80, 0.02)
    alone = [filters.differentiate_joined(row, dt, first, last) for row in rows]
    np.testing.assert_array_equal(filters.differentiate_joined(rows, dt, first, last), alone)


# Alpha-dot from vane, gyro and lift: near the truth, and without the noise of the lift that it may explain
INNER = slice(60, -60)  # away from the ends, where the vane alone is taken


@pytest.fixture(scope="module")
def flight():
    card = read_card("attas")
    (flown,) = hidden_flights({}, seed=41, manoeuvres=1, noise="white", seconds=90.0)
    return card, Model.from_card(card), flown


def test_alpha_dot_is_nearer_the_truth_than_the_vane_and_holds_no_noise_of_lift(flight):
    card, model, flown = flight
    error = {}
    for forming in Forming:
        found = np.asarray(observe([flown.record], card, model, forming).signals["alpha_dot"])
        error[forming] = np.sqrt(np.mean((found - flown.flown["alpha_dot"])[INNER] ** 2))
    assert error[Forming.MATCHED] < 0.3 * error[Forming.PUBLISHED]
    # Noise on az moves the measured CL; what it moves in alpha-dot must not follow it.
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
