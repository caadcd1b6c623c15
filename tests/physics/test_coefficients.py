"""Coefficients: rotations, propagated noise, and the way back from a simulated flight."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.physics.coefficients import (
    coefficient_noise,
    coefficients,
    condition_joined,
    stacked_coefficients,
    unsmoothed_joined,
)
from bayes_aero.physics.filters import smooth
from bayes_aero.physics.frames import body_from_lift_drag, lift_drag_from_body
from bayes_aero.physics.kinematics import Rotation, lever_arm


def test_rotation_is_its_own_inverse_and_keeps_length():
    rng = np.random.default_rng(1)
    CX, CZ, alpha = (jnp.asarray(rng.normal(size=20)) for _ in range(3))
    CL, CD = lift_drag_from_body(CX, CZ, alpha)
    np.testing.assert_allclose(CL**2 + CD**2, CX**2 + CZ**2, rtol=1e-12)
    np.testing.assert_allclose(body_from_lift_drag(CL, CD, alpha), (CX, CZ), atol=1e-12)
    # At zero incidence drag acts backward and lift upward.
    CL, CD = lift_drag_from_body(jnp.asarray(-0.1), jnp.asarray(-0.5), jnp.asarray(0.0))
    assert (float(CL), float(CD)) == (0.5, 0.1)


def test_lever_arm_is_omega_dot_cross_r_plus_omega_cross_omega_cross_r():
    rng = np.random.default_rng(2)
    omega, omega_dot, r = rng.normal(size=(3, 3))
    found = lever_arm(Rotation(*map(jnp.asarray, (*omega, *omega_dot))), tuple(map(float, r)))
    np.testing.assert_allclose(found, np.cross(omega_dot, r) + np.cross(omega, np.cross(omega, r)), atol=1e-12)


def _conditioned(channels, dt):
    """One manoeuvre."""
    n = len(channels["alpha"])
    return condition_joined(channels, jnp.full(n, dt), jnp.zeros(n, int), jnp.full(n, n - 1))


def test_coefficients_come_back_from_a_simulated_flight(clean, model):
    """The simulator writes accelerations from the model; reconstruction must give the model back."""
    from bayes_aero.simulate.demo import TRUTH

    truth = jnp.asarray([TRUTH[name] for name in model.names])
    modelled = np.asarray(model.predicted(truth, clean.signals, clean.aircraft))
    error = np.abs(np.asarray(clean.measured) - modelled)
    spread = np.ptp(modelled, axis=0)
    # Smoothing costs the sharpest corners of the pitching moment; lift and drag need no derivative.
    assert np.all(np.quantile(error, 0.99, axis=0) < np.array([2e-3, 2e-3, 0.05]) * spread)


def test_propagated_noise_is_the_scatter_of_perturbed_records(card):
    rng = np.random.default_rng(3)
    n, dt = 20_000, 0.04
    steady = {
        "ax": 1.0, "az": -9.5, "p": 0.02, "q": 0.03, "r": -0.01,
        "alpha": 0.15, "airspeed": 75.0, "density": 0.73, "thrust": 5000.0,
    }  # fmt: skip
    exact = {name: jnp.full(n, value) for name, value in steady.items()}
    noisy = {name: x + card.sensors[name] * rng.standard_normal(n) for name, x in exact.items()}
    scatter = np.std(np.asarray(stacked_coefficients(_conditioned(noisy, dt), card.aircraft)), axis=0)
    stated = coefficient_noise(_conditioned(exact, dt), card.aircraft, card.sensors, dt)[n // 2]
    np.testing.assert_allclose(scatter, stated, rtol=0.03)


def test_thrust_line_and_reference_point_enter_the_moment_with_the_right_sign(card):
    """Thrust above the CG pitches down; a force behind the reference point must be balanced."""
    n = 40
    base = {k: jnp.zeros(n) for k in ("ax", "az", "p", "q", "r", "beta")} | {
        "alpha": jnp.full(n, 0.1), "airspeed": jnp.full(n, 70.0), "density": jnp.full(n, 0.8), "thrust": jnp.zeros(n)
    }  # fmt: skip
    signals = _conditioned(base, 0.04)
    slope = jax.grad(lambda T: coefficients(signals | {"thrust": jnp.full(n, T)}, card.aircraft).Cm[20])(0.0)
    a = card.aircraft
    qbar_S = 0.5 * 0.8 * 70.0**2 * a.wing_area
    # Steady flight without acceleration: aerodynamic moment and force cancel those of thrust.
    expected = (-a.engine[2] + a.reference_point[2]) / (qbar_S * a.chord)
    assert float(slope) == pytest.approx(expected, rel=1e-9)
    assert float(slope) > 0.0


def test_an_elevator_that_passes_the_same_filter_keeps_its_effectiveness(card):
    """Pitch acceleration is a constant times a brisk 3-2-1-1 at 20 Hz; the pitch rate is its exact integral."""
    dt, a = 0.05, card.aircraft
    n = 400
    time = dt * np.arange(n)
    corners = 5.0 + np.cumsum([0.0, 0.1, 1.4, 0.2, 0.8, 0.2, 0.3, 0.2, 0.3, 0.1])
    elevator = np.interp(time, corners, [0.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 0.0]) * 0.04
    pitching = np.concatenate([[0.0], np.cumsum((elevator[1:] + elevator[:-1]) / 2.0) * dt])  # corners are samples
    level = {k: jnp.zeros(n) for k in ("ax", "az", "p", "r", "thrust")} | {
        "alpha": jnp.full(n, 0.05), "airspeed": jnp.full(n, 60.0), "density": jnp.full(n, 1.0),
    }  # fmt: skip
    channels = level | {"q": jnp.asarray(-8.0 * pitching), "elevator": jnp.asarray(elevator)}
    at_cg = replace(a, accelerometer=(0.0, 0.0, 0.0), reference_point=(0.0, 0.0, 0.0))
    ends = jnp.full(n, dt), jnp.zeros(n, int), jnp.full(n, n - 1)

    def effectiveness(elevator, signals, smoothing=lambda x: x):
        return np.polyfit(smoothing(jnp.asarray(elevator)), smoothing(coefficients(signals, at_cg).Cm), 1)[0]

    truth = -8.0 * a.Iy / (0.5 * 60.0**2 * a.wing_area * a.chord)
    alike = effectiveness(elevator, unsmoothed_joined(channels, (0.0, 0.0, 0.0), *ends), smooth)
    assert alike == pytest.approx(truth, rel=5e-3)
    published = effectiveness(elevator, condition_joined(channels, *ends))
    assert published / truth < 0.985  # a smoothed pitch acceleration against an elevator as recorded
