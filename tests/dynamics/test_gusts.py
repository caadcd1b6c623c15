"""Gusts and buffet in the equations of motion, against closed forms and stationary covariances."""

from dataclasses import replace

import equinox as eqx
import gusty_flight
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.linalg import expm
from scipy.linalg import solve_continuous_lyapunov

from bayes_aero.dynamics import kalman
from bayes_aero.dynamics.aircraft import Longitudinal
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.pilot import through_gusts
from bayes_aero.dynamics.segments import segments
from bayes_aero.dynamics.system import System
from bayes_aero.flight.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.prediction_error import PredictionErrorStatus, disturbed, fit_prediction_error
from bayes_aero.model.model import Model
from bayes_aero.model.observations import join
from bayes_aero.physics.aircraft import FLIGHT

# Gusts in the equations of motion: what feels them, how they decay, and what is known of them at the beginning
V, ALPHA, THETA, Q = 104.0, 0.11, 0.10, 0.02
W, U, LENGTH = 3.0, -2.0, 200.0
VALUES = {
    "vertical_gust": 1.5, "vertical_gust_length": LENGTH, "longitudinal_gust": 0.8,
    "longitudinal_gust_length": 90.0,
}  # fmt: skip
ROW = {"elevator": jnp.asarray(-0.03), "thrust": jnp.asarray(9000.0), "density": jnp.asarray(0.792)}


@pytest.fixture(scope="module")
def systems():
    """One aircraft in air at rest and in gusts."""
    card = read_card("hfb320")
    model = Model.from_card(card)
    gusty = model.extended("vertical_gust", "longitudinal_gust")
    values = {p.name: jnp.asarray(p.start) for p in model.parameters}
    more = values | {name: jnp.asarray(x) for name, x in VALUES.items()}
    return Longitudinal(model, values, card.aircraft, False), Longitudinal(gusty, more, card.aircraft, False)


def state(airspeed=V, alpha=ALPHA, *gusts):
    return jnp.array([airspeed, alpha, THETA, Q, *gusts])


def test_gusts_act_through_the_flow_alone(systems):
    calm, gusty = systems
    assert gusty.states == (*calm.states, "gust_w", "gust_u")
    rate, outputs = calm.motion(state(), ROW)
    other, same = gusty.motion(state(V, ALPHA, 0.0, 0.0), ROW)
    np.testing.assert_array_equal(other[:4], rate)
    np.testing.assert_array_equal(other[4:], 0.0)
    for name, value in outputs.items():
        assert float(same[name]) == pytest.approx(float(value), rel=1e-14, abs=1e-14), name
    airspeed, alpha = V + U, ALPHA + W / V
    _, flow = calm.motion(state(airspeed, alpha), ROW)
    rate, found = gusty.motion(state(V, ALPHA, W, U), ROW)
    assert float(found["alpha"]) == pytest.approx(alpha, rel=1e-14)
    assert float(found["airspeed"]) == pytest.approx(airspeed, rel=1e-14)
    for name in ("ax", "az", "q_dot", "CL", "CD", "Cm"):
        assert float(found[name]) == pytest.approx(float(flow[name]), rel=1e-12), name
    # Newton's second law in axes of the path, written out: alpha-dot = q + (az cos - ax sin + g cos gamma) / V.
    g, arm = 9.80665, gusty.aircraft.accelerometer
    assert not np.any(np.asarray(arm)[[0, 2]])  # the accelerometers are at the CG
    ax, az = float(found["ax"]), float(found["az"])
    climb = THETA - ALPHA
    along = ax * np.cos(ALPHA) + az * np.sin(ALPHA) - g * np.sin(climb)
    turn = Q + (az * np.cos(ALPHA) - ax * np.sin(ALPHA) + g * np.cos(climb)) / V
    assert float(rate[0]) == pytest.approx(along, rel=1e-6)
    assert float(rate[1]) == pytest.approx(turn, rel=1e-6)


def test_gusts_decay_with_their_length_and_keep_their_intensity(systems):
    _, gusty = systems
    x = state(V, ALPHA, W, 0.0)
    at = gusty.states.index("gust_w")
    rate, _ = gusty.motion(x, ROW)
    assert float(rate[at]) == pytest.approx(-V / LENGTH * W, rel=1e-12)
    density = float(gusty.noise_density(x, ROW)[at])  # the stationary variance is density / (2 V / LENGTH)
    assert density == pytest.approx(2.0 * V / LENGTH * VALUES["vertical_gust"] ** 2, rel=1e-12)


def test_at_the_beginning_the_flow_is_known_and_the_gust_is_not(systems):
    _, gusty = systems
    x, deviation = state(V, ALPHA, 0.0, 0.0), jnp.array([0.3, 0.004, 0.002, 0.001, 0.0, 0.0])

    def flow(x):
        shown = gusty.motion(x, ROW)[1]
        return jnp.stack([shown["airspeed"], shown["alpha"]])

    P, C = jax.jit(lambda x: (gusty.start_covariance(x, ROW, deviation), jax.jacfwd(flow)(x)))(x)
    np.testing.assert_allclose(np.sqrt(np.diag(C @ P @ C.T)), [0.3, 0.004], rtol=1e-9)
    w, u = gusty.states.index("gust_w"), gusty.states.index("gust_u")
    assert P[w, w] == pytest.approx(1.5**2)
    assert P[u, u] == pytest.approx(0.8**2)
    assert P[1, w] == pytest.approx(-(1.5**2) / V, rel=1e-9)  # what the vane reads beside the path is gust


def test_noise_that_a_sample_gathers_is_van_loan_s_integral():
    """A gust of first order that turns the aircraft: pitch rate and attitude gather its noise within a sample."""
    A, W, dt = np.array([[0.0, 1.0, 0.0], [0.0, -1.2, 0.06], [0.0, 0.0, -0.5]]), np.diag([0.0, 0.0, 2.3]), 0.05
    block = np.block([[-A, W], [np.zeros((3, 3)), A.T]]) * dt
    both = np.asarray(expm(jnp.asarray(block)))
    transition = both[3:, 3:].T
    exact = transition @ both[:3, 3:]
    found = np.asarray(kalman.discrete_noise(jnp.asarray(transition), jnp.asarray(np.diag(W)), dt))
    np.testing.assert_allclose(found[1:, 1:], exact[1:, 1:], rtol=2e-3)
    assert found[0, 0] < 1.3 * exact[0, 0]  # of the fifth power of dt


# A system in random gusts against the stationary covariance of the linear system
RATE, GAIN, LAG, SIGMA = 2.0, 3.0, 0.8, 1.5  # 1/s, 1/s, 1/s, m/s
DT, N, COUNT = 0.02, 400, 4000


class Driven(System):
    """x' = -RATE x + GAIN g, with a gust g of standard deviation `sigma` and decay rate LAG."""

    sigma: float = eqx.field(default=SIGMA)

    @property
    def states(self):
        return ("x", "g")

    def motion(self, x, u):  # noqa: ARG002
        return jnp.stack([-RATE * x[0] + GAIN * x[1], -LAG * x[1]]), {"x": x[0], "g": x[1]}

    def noise_density(self, x, u):  # noqa: ARG002
        return jnp.stack([jnp.zeros_like(x[0]), 2.0 * LAG * self.sigma**2 + 0.0 * x[0]])

    def decay(self, x, u):  # noqa: ARG002
        return jnp.array([0.0, LAG])


def flights(sigma):
    white = jnp.asarray(np.random.default_rng(7).standard_normal((COUNT, N, 2)))
    inputs = {"u": jnp.zeros(N)}
    fly = jax.jit(jax.vmap(lambda w: through_gusts(Driven(sigma), jnp.zeros(2), inputs, DT, w, ("x", "g"))))
    found, inside = fly(white)
    assert bool(inside.all())
    return np.asarray(found)


def test_the_spread_is_that_of_the_linear_system_and_a_gust_grows_exactly():
    A = np.array([[-RATE, GAIN], [0.0, -LAG]])
    exact = solve_continuous_lyapunov(A, -np.diag([0.0, 2.0 * LAG * SIGMA**2]))
    assert exact[1, 1] == pytest.approx(SIGMA**2)
    assert exact[0, 0] == pytest.approx(GAIN**2 * SIGMA**2 / (RATE * (RATE + LAG)))
    flown = flights(SIGMA)
    found = np.cov(flown[:, -1].T)
    four = 4.0 * np.sqrt(2.0 / COUNT)  # standard errors of a variance; the step of 0.02 s adds 1 %
    assert np.diag(found) == pytest.approx(np.diag(exact), rel=four + 0.01)
    assert found[0, 1] == pytest.approx(exact[0, 1], rel=four + 0.01)
    # Its variance from calm air is sigma^2 (1 - exp(-2 a t)), whatever the step.
    for k in (1, 20, 100):
        exact = SIGMA**2 * (1.0 - np.exp(-2.0 * LAG * DT * k))
        assert np.var(flown[:, k, 1]) == pytest.approx(exact, rel=4.0 * np.sqrt(2.0 / COUNT))
    assert not flights(0.0).any()


# Buffet in the equations of motion, and its intensity and length found in a simulated stall
FINER, SHAKEN_DT, SHAKEN_N = 5, 0.05, 1000
STALLING = gusty_flight.TRUTH | {"a1": 30.0, "alpha_star": 0.15, "buffet": 0.15, "buffet_length": 6.0}
FOUND = ("CLa", "Cm0", "a1", "alpha_star", "buffet", "buffet_length")
NOISE = gusty_flight.NOISE


def model_of(card, *more):
    """Of which four parameters are free, and what disturbs it."""
    model = Model.from_card(card).extended("flow_separation", "kirchhoff_lift")
    held = {p.name: STALLING[p.name] for p in model.parameters if p.name not in FOUND}
    return model.extended(*more, fixed=held)


def shaken(card):
    """A flight that passes to and fro over the stall, shaken by buffet; its noise comes five times a sample."""
    rng, h, n = np.random.default_rng(4), SHAKEN_DT / FINER, SHAKEN_N * FINER
    model = model_of(card, "buffet")
    values = {p.name: jnp.asarray(STALLING[p.name]) for p in model.parameters}
    system = Longitudinal(model, values, card.aircraft, False)
    assert system.states[-1] == "buffet"
    angle = 0.12 + 0.05 * np.sin(2.0 * np.pi * h * np.arange(n) / 12.0)
    moment = STALLING["Cm0"] + STALLING["CmV"] + STALLING["Cma"] * angle - 0.018  # of the thrust
    inputs = {"elevator": -moment / STALLING["Cmde"], "thrust": np.full(n, 9e3), "density": np.full(n, 0.792)}
    drives, start = {name: jnp.asarray(y) for name, y in inputs.items()}, jnp.array([104.0, 0.12, 0.12, 0.0, 0.0])
    white = jnp.asarray(rng.standard_normal((n, 5)))
    rows, inside = eqx.filter_jit(through_gusts)(system, start, drives, h, white, (*NOISE, "X"))
    assert bool(inside.all())
    rows = np.asarray(rows)[::FINER]
    assert np.mean(rows[:, -1] > 0.9) > 0.2
    assert np.mean(rows[:, -1] < 0.5) > 0.1
    sensed = rows[:, :-1] + np.array(list(NOISE.values())) * rng.standard_normal((SHAKEN_N, len(NOISE)))
    channels = dict(zip(NOISE, sensed.T, strict=True)) | {name: y[::FINER] for name, y in inputs.items()}
    record = FlightRecord.from_arrays("shaken", SHAKEN_DT * np.arange(SHAKEN_N), channels, "simulated")
    return join([record], card, FLIGHT)


@pytest.mark.verify
def test_buffet_is_found_in_intensity_and_length_and_counted_once():
    card = read_card("hfb320")
    flights, fits = shaken(card), []
    for more in (("buffet",), ()):
        model = model_of(card, *more)
        flown = segments(flights, aircraft_dynamics(model, flights), outputs=tuple(NOISE))
        sd = np.array([NOISE.get(name, 0.0) for name in flown.dynamics.states])
        start = np.array([STALLING[p.name] if p.name in FOUND[:4] else p.start for p in flown.dynamics.free])
        fits.append(fit_prediction_error(flown, 0.1 * sd, np.square(list(NOISE.values())), start=start))
        # Noise that grows as the flow separates stands for buffet: both would count it twice.
        growing = replace(flown, noise_growth=3.0 * flown.noise_growth)
        assert bool(np.all(disturbed(growing).noise_growth == 1.0)) is bool(more)
    fit, without = fits
    assert fit.status is PredictionErrorStatus.CONVERGED
    for name in FOUND:
        estimate, sd = (x[fit.names.index(name)] for x in (fit.estimate, fit.sd))
        assert abs(estimate - STALLING[name]) < 3.0 * sd, name
        assert name != "buffet" or sd < 0.2 * STALLING[name]
    assert fit.log_likelihood - without.log_likelihood > 50.0
    alike, coloured = (np.abs(kalman.neighbour_correlation(one.found)) for one in fits)
    assert np.max(alike) < 4.0 / np.sqrt(SHAKEN_N)
    assert coloured[tuple(NOISE).index("az")] > 4.0 / np.sqrt(SHAKEN_N)
