"""From a record to coefficients: filters, alpha-dot, forces put on a rigid body, and the textbook's polar."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.model.records import Forming
from bayes_aero.physics import filters
from bayes_aero.physics.aircraft import Aircraft
from bayes_aero.physics.coefficients import coefficients, condition_joined, unsmoothed_joined
from bayes_aero.physics.filters import kirchhoff_factor, lagged, separation_point
from bayes_aero.residuals.base import smoothed_means
from bayes_aero.simulate.injection import hidden_flights


# Smoothing and differentiation against what the filters are known to pass exactly
@pytest.fixture
def rng():
    return np.random.default_rng(int.from_bytes(b"filters", "big") % 2**32)


smooth, differentiate, advance, smooth_joined, differentiate_joined = map(
    jax.jit,
    (filters.smooth, filters.differentiate, filters.advance, filters.smooth_joined, filters.differentiate_joined),
)


def polynomial(rng, degree, n=60):
    t = np.linspace(-1.0, 1.0, n)
    coefficients = rng.normal(size=degree + 1)
    return t, np.polynomial.polynomial.polyval(t, coefficients), np.polynomial.polynomial.polyder(coefficients)


def test_spencer_filter_passes_cubics_inside_and_straight_lines_near_the_ends(rng):
    _, x, _ = polynomial(rng, 3)
    np.testing.assert_allclose(smooth(x)[7:-7], x[7:-7], atol=1e-12)
    _, x, _ = polynomial(rng, 1)
    np.testing.assert_allclose(smooth(x), x, atol=1e-12)
    noise, ends = rng.normal(size=60), [0, 1, 2, -3, -2, -1]
    np.testing.assert_array_equal(smooth(noise)[jnp.array(ends)], noise[ends])


def test_derivatives_of_quartics_are_exact_and_of_sines_of_high_order(rng):
    t, x, derivative = polynomial(rng, 4)
    slope = np.asarray(differentiate(x, t[1] - t[0]))
    expected = np.polynomial.polynomial.polyval(t, derivative)
    np.testing.assert_allclose(slope[2:-2], expected[2:-2], atol=1e-9)
    np.testing.assert_array_equal(slope[:2], slope[2])
    np.testing.assert_array_equal(slope[-2:], slope[-3])
    errors = []
    for n in (60, 120):
        t = np.linspace(0.0, 2 * np.pi, n)
        slope = np.asarray(differentiate(np.sin(8 * t), t[1] - t[0]))
        errors.append(np.abs(slope - 8 * np.cos(8 * t))[8:-8].max())
    assert np.log2(errors[0] / errors[1]) > 7.0


def test_separation_point_is_the_published_tanh(rng):
    alpha, a1, star = rng.uniform(-0.5, 0.8, 50), rng.uniform(5, 40), rng.uniform(0.2, 0.4)
    expected = (1 - np.tanh(a1 * (alpha - star))) / 2
    X = separation_point(jnp.asarray(a1), jnp.asarray(alpha), jnp.asarray(star))
    np.testing.assert_allclose(X, expected, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(kirchhoff_factor(jnp.array([1.0, 0.0])), [1.0, 0.25])


def test_lag_follows_the_exponential_and_restarts_at_a_seam(rng):
    tau, dt, n = rng.uniform(0.2, 2.0), 0.04, 200
    start = np.zeros(2 * n, bool)
    start[[0, n]] = True
    step = np.tile(np.concatenate([[1.0], np.zeros(n - 1)]), 2)
    step[n:] = 0.3  # the second manoeuvre begins at rest at another value
    X = np.asarray(jax.jit(lagged)(step, np.full(2 * n, tau), np.full(2 * n, dt), start))
    # Input linear from 1 to 0 over the first step, then zero: the closed form of tau X' + X = u.
    first = tau / dt * (1 - np.exp(-dt / tau))
    np.testing.assert_allclose(X[1:n], first * np.exp(-dt / tau * np.arange(n - 1)), rtol=1e-9)
    np.testing.assert_allclose(X[n:], 0.3, rtol=1e-12)


def sine(n, dt, shift=0.0):
    return np.sin(2.0 * (np.arange(n) * dt + shift))


def moved(n, dt, by):
    return np.asarray(advance(sine(n, dt), by, np.full(n, dt), np.zeros(n, int), np.full(n, n - 1)))


@pytest.mark.parametrize("share", [0.3, -1.7])
def test_advance_is_of_third_order_on_a_sine_and_moves_whole_samples(share):
    def error(dt):
        n = int(4.0 / dt)
        return float(np.max(np.abs(moved(n, dt, share * dt) - sine(n, dt, share * dt))[4:-4]))

    assert error(0.04) < 1e-4
    assert error(0.04) / error(0.02) == pytest.approx(2.0**3, rel=0.1)
    x = sine(100, 0.25)
    np.testing.assert_array_equal(moved(100, 0.25, 0.75), np.concatenate([x[3:], np.repeat(x[-1], 3)]))
    np.testing.assert_array_equal(moved(100, 0.25, -0.5), np.concatenate([np.repeat(x[0], 2), x[:-2]]))


def test_joined_manoeuvres_and_rows_are_filtered_as_each_alone(rng):
    pieces, steps = [rng.normal(size=n) for n in (20, 64, 21)], (0.04, 0.02, 0.01)
    lengths = [len(x) for x in pieces]
    first = np.repeat(np.cumsum([0, *lengths[:-1]]), lengths)
    last = first + np.repeat(lengths, lengths) - 1
    x, dt = np.concatenate(pieces), np.repeat(steps, lengths)
    alone = np.concatenate([smooth(piece) for piece in pieces])
    np.testing.assert_allclose(smooth_joined(x, first, last), alone, rtol=1e-13, atol=1e-14)
    means = [smooth(piece)[: len(piece) // 5 * 5].reshape(-1, 5).mean(axis=1) for piece in pieces]
    np.testing.assert_allclose(smoothed_means(tuple(lengths)) @ x, np.concatenate(means), rtol=1e-12, atol=1e-14)
    alone = np.concatenate([differentiate(piece, d) for piece, d in zip(pieces, steps, strict=True)])
    joined = differentiate_joined(x, dt, first, last)
    np.testing.assert_allclose(joined, alone, rtol=1e-12, atol=1e-11)
    rows = differentiate_joined(np.stack([x, -2.0 * x]), dt, first, last)
    np.testing.assert_allclose(rows, np.stack([joined, -2.0 * joined]), rtol=1e-13)


# Alpha-dot from vane, gyro and lift: near the truth, and without the noise of the lift that it may explain
INNER = slice(60, -60)  # away from the ends, where the vane alone is taken


def test_alpha_dot_is_nearer_the_truth_than_the_vane_and_holds_no_noise_of_lift(card, model):
    (flown,) = hidden_flights({}, seed=41, manoeuvres=1, noise="white", seconds=90.0)
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


# What a filter does to a coefficient
def test_an_elevator_that_passes_the_same_filter_keeps_its_effectiveness(card):
    """Pitch acceleration is a constant times a brisk 3-2-1-1 at 20 Hz; the pitch rate is its exact integral."""
    dt, a = 0.05, card.aircraft
    n = 400
    time = dt * np.arange(n)
    corners = 5.0 + np.cumsum([0.0, 0.1, 1.4, 0.2, 0.8, 0.2, 0.3, 0.2, 0.3, 0.1])
    elevator = np.interp(time, corners, [0.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 0.0]) * 0.04
    pitching = np.concatenate([[0.0], np.cumsum((elevator[1:] + elevator[:-1]) / 2.0) * dt])  # corners are samples
    level = dict.fromkeys(("ax", "az", "p", "r", "thrust"), 0.0) | {"alpha": 0.05, "airspeed": 60.0, "density": 1.0}
    channels = {name: jnp.full(n, x) for name, x in level.items()}
    channels |= {"q": jnp.asarray(-8.0 * pitching), "elevator": jnp.asarray(elevator)}
    at_cg = replace(a, accelerometer=(0.0, 0.0, 0.0), reference_point=(0.0, 0.0, 0.0))
    ends = jnp.full(n, dt), jnp.zeros(n, int), jnp.full(n, n - 1)

    def effectiveness(elevator, signals, smoothing=lambda x: x):
        return np.polyfit(smoothing(elevator), smoothing(coefficients(signals, at_cg)["Cm"]), 1)[0]

    truth = -8.0 * a.Iy / (0.5 * 60.0**2 * a.wing_area * a.chord)
    unsmoothed = jax.jit(lambda s: unsmoothed_joined(s, (0.0, 0.0, 0.0), *ends))(channels)
    alike = effectiveness(elevator, unsmoothed, smooth)
    assert alike == pytest.approx(truth, rel=5e-3)
    published = effectiveness(elevator, jax.jit(condition_joined)(channels, *ends))
    assert published / truth < 0.985  # a smoothed pitch acceleration against an elevator as recorded


# Six coefficients from forces and moments put on a rigid body with vector products
AIRCRAFT = Aircraft(
    mass=17_000.0, Ix=1.3e5, Iy=2.5e5, Iz=3.6e5, Ixz=1.1e4, Ixy=4e3, Iyz=-2e3, wing_area=64.0, chord=3.2,
    half_span=10.75, aspect_ratio=7.2, tail_arm=15.0, reference_point=(-0.2, 0.15, -0.12),
    accelerometer=(-1.0, 0.9, 0.1), engine=(-1.3, 0.1, -0.65), engine_inclination=0.05, engine_arm=3.0,
    lateral_length=10.75,
)  # fmt: skip
TRUE = {"CL": 0.7, "CD": 0.06, "Cm": 0.02, "CY": -0.05, "Cl": 0.004, "Cn": -0.003}
THRUST = 9_000.0, 6_000.0  # N, left and right


def sensed(a: Aircraft, true=TRUE) -> dict:
    """What sensors show while the air makes these coefficients: Newton and Euler with NumPy's cross products."""
    V, rho, alpha, omega = 130.0, 0.8, 0.08, np.array([0.3, 0.08, -0.12])
    area = 0.5 * rho * V**2 * a.wing_area
    CX = true["CL"] * np.sin(alpha) - true["CD"] * np.cos(alpha)
    CZ = -true["CL"] * np.cos(alpha) - true["CD"] * np.sin(alpha)
    force = area * np.array([CX, true["CY"], CZ])
    moment = area * np.array([true["Cl"] * a.lateral_length, true["Cm"] * a.chord, true["Cn"] * a.lateral_length])
    moment += np.cross(a.reference_point, force)
    for thrust, side in zip(THRUST, (-1.0, 1.0), strict=True):
        pull = thrust * np.array([np.cos(a.engine_inclination), 0.0, -np.sin(a.engine_inclination)])
        moment += np.cross(np.add(a.engine, [0.0, side * a.engine_arm, 0.0]), pull)
        force = force + pull
    inertia = np.array([[a.Ix, -a.Ixy, -a.Ixz], [-a.Ixy, a.Iy, -a.Iyz], [-a.Ixz, -a.Iyz, a.Iz]])
    turning = np.linalg.solve(inertia, moment - np.cross(omega, inertia @ omega))
    arm = np.array(a.accelerometer)
    felt = force / a.mass + np.cross(turning, arm) + np.cross(omega, np.cross(omega, arm))
    names = ("p", "q", "r", "p_dot", "q_dot", "r_dot", "ax", "ay", "az")
    shown = dict(zip(names, [*omega, *turning, *felt], strict=True))
    shown |= {"alpha": alpha, "airspeed": V, "density": rho, "thrust": sum(THRUST)}
    return shown | {"thrust_left": THRUST[0], "thrust_right": THRUST[1]}


def test_coefficients_come_back_from_a_rigid_body_six_or_three():
    signals = {name: jnp.asarray([x]) for name, x in sensed(AIRCRAFT).items()}

    def coefficients_without(channel=None):
        apart = coefficients({name: x for name, x in signals.items() if name != channel}, AIRCRAFT)
        return {name: float(x[0]) for name, x in apart.items()}

    assert coefficients_without() == pytest.approx(TRUE, abs=1e-13)
    assert coefficients_without("ay") == pytest.approx({n: TRUE[n] for n in ("CL", "CD", "Cm")}, abs=1e-13)
    area = 0.5 * 0.8 * 130.0**2 * 64.0
    yaw = (THRUST[0] - THRUST[1]) * AIRCRAFT.engine_arm * np.cos(AIRCRAFT.engine_inclination) / (area * 10.75)
    assert coefficients_without("thrust_left")["Cn"] - TRUE["Cn"] == pytest.approx(yaw, rel=1e-9)


# The drag of the stalled wing against the textbook's polar, written out by hand
EFFECTS = (
    "attached_lift", "flow_separation", "kirchhoff_lift",
    "profile_drag", "induced_drag", "separated_drag", "separated_induced_drag",
)  # fmt: skip
VALUES = {"CL0": 0.3, "CLa": 5.2, "a1": 22.0, "alpha_star": 0.27, "CD0": 0.03, "e": 0.78, "CDX": 0.06}


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_drag_is_that_of_the_attached_lift_or_of_the_lift_that_is_left(card, share):
    alpha = np.linspace(-0.05, 0.4, 60)
    model = Model.of(EFFECTS)
    signals = {name: jnp.zeros(60) for name in model.channels} | {"alpha": jnp.asarray(alpha)}
    signals |= {"airspeed": jnp.full(60, 60.0), "dt": jnp.full(60, 0.05)}
    signals |= {"alpha_dot": jnp.zeros(60), "start": jnp.arange(60) == 0}
    values = {name: jnp.asarray(x) for name, x in (VALUES | {"induced_share": share}).items()}
    known = model.flow(values, signals, card.aircraft)
    X = 0.5 * (1.0 - np.tanh(22.0 * (alpha - 0.27)))
    attached = 0.3 + 5.2 * alpha
    CL = 0.3 + 5.2 * ((1.0 + np.sqrt(X)) / 2.0) ** 2 * alpha
    square = (CL if share else attached) ** 2
    CD = 0.03 + square / (np.pi * 0.78 * card.aircraft.aspect_ratio) + 0.06 * (1.0 - X)
    np.testing.assert_allclose(known["CL"], CL, rtol=1e-6)
    np.testing.assert_allclose(known["CD"], CD, rtol=1e-6)
    assert np.ptp(CL - attached) > 0.5  # the two polars differ here
