"""Gusts in the equations of motion: what feels them, how they decay, and what is known of them at the beginning."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.linalg import expm

from bayes_aero.dynamics.aircraft.longitudinal import Longitudinal
from bayes_aero.dynamics.filtering.kalman import discrete_noise
from bayes_aero.flight.card.card import read_card
from bayes_aero.model.model import Model

V, ALPHA, THETA, Q = 104.0, 0.11, 0.10, 0.02
W, U, LENGTH = 3.0, -2.0, 200.0
VALUES = {
    "vertical_gust": 1.5,
    "vertical_gust_length": LENGTH,
    "longitudinal_gust": 0.8,
    "longitudinal_gust_length": 90.0,
}
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


def test_without_motion_of_the_air_nothing_changes(systems):
    calm, gusty = systems
    assert gusty.states == (*calm.states, "gust_w", "gust_u")
    rate, outputs = calm.motion(state(), ROW)
    other, same = gusty.motion(state(V, ALPHA, 0.0, 0.0), ROW)
    np.testing.assert_array_equal(other[:4], rate)
    np.testing.assert_array_equal(other[4:], 0.0)
    for name, value in outputs.items():
        assert float(same[name]) == pytest.approx(float(value), rel=1e-14, abs=1e-14), name


def test_vane_pitot_tube_and_forces_feel_the_flow(systems):
    calm, gusty = systems
    airspeed, alpha = V + U, ALPHA + W / V
    _, flow = calm.motion(state(airspeed, alpha), ROW)
    _, found = gusty.motion(state(V, ALPHA, W, U), ROW)
    assert float(found["alpha"]) == pytest.approx(alpha, rel=1e-14)
    assert float(found["airspeed"]) == pytest.approx(airspeed, rel=1e-14)
    for name in ("ax", "az", "q_dot", "CL", "CD", "Cm"):
        assert float(found[name]) == pytest.approx(float(flow[name]), rel=1e-12), name


def test_the_path_over_ground_follows_from_the_forces(systems):
    """Newton's second law in axes of the path, written out: alpha-dot = q + (az cos - ax sin + g cos gamma) / V."""
    _, gusty = systems
    rate, found = gusty.motion(state(V, ALPHA, W, U), ROW)
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
    density, dt = float(gusty.noise_density(x, ROW)[at]), 0.01
    kept = float(expm(jnp.array([[-V / LENGTH * dt]]))[0, 0])
    variance = 0.0
    for _ in range(20000):  # the stationary variance of the process, by its recursion
        variance = kept**2 * variance + density * (1.0 - kept**2) / (2.0 * V / LENGTH)
    assert variance == pytest.approx(VALUES["vertical_gust"] ** 2, rel=1e-9)


def test_at_the_beginning_the_flow_is_known_and_the_gust_is_not(systems):
    _, gusty = systems
    x, deviation = state(V, ALPHA, 0.0, 0.0), jnp.array([0.3, 0.004, 0.002, 0.001, 0.0, 0.0])
    P = np.asarray(gusty.start_covariance(x, ROW, deviation))

    def flow(x):
        found = gusty.motion(x, ROW)[1]
        return jnp.stack([found["airspeed"], found["alpha"]])

    C = np.asarray(jax.jacfwd(flow)(x))
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
    found = np.asarray(discrete_noise(jnp.asarray(transition), jnp.asarray(np.diag(W)), dt))
    np.testing.assert_allclose(found[1:, 1:], exact[1:, 1:], rtol=2e-3)
    assert found[0, 0] < 1.3 * exact[0, 0]  # of the fifth power of dt
