"""Filter error against published results, scipy, and output error."""

from __future__ import annotations

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from bayes_aero.dynamics.filtering.innovations import filter_segments, riccati, steady_innovations
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.linear import linear_dynamics
from bayes_aero.dynamics.output_biases import biased_dynamics
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.segments import segments, simulate
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.inference.likelihood.filter_error import FilterErrorStatus, constrained_step, fit_filter_error
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model

BOOK = Path(__file__).resolve().parents[3] / "shared" / "book"
CASES = {  # card, file, process noise to start from, whether it is held; as published
    "TC02": ("dhc2", "y13aus_da1.asc", (0.02, 0.02), False),
    "TC04": ("hfb320", "hfb320_1_10.asc", (0.02, 0.002, 0.02, 0.02), False),
    "TC08": ("unstable", "unStabAC_sim.asc", (5e-6, 5e-6), True),
}
NAMED = {"CLa": "CLal", "CDa": "CDal", "Cma": "Cmal"}


def flown(case: str):
    name, file, _, _ = CASES[case]
    card = read_card(name)
    record = read_record(BOOK / file, card.channels)
    if card.linear is None:
        flights = join([record], card, FLIGHT)
        dynamics = aircraft_dynamics(Model.from_card(card), flights, card.fly.outputs or ())
    else:
        flights = join([record], card, ())
        dynamics = biased_dynamics(linear_dynamics(card), flights, card.output_biases)
    return segments(flights, dynamics, outputs=card.fly.outputs, fixed=card.fly.initial_state)


@pytest.mark.skipif(not BOOK.is_dir(), reason="needs ../shared/book")
@pytest.mark.parametrize("case", CASES)
def test_published_filter_error(case):
    """Estimates within .3 published deviations, deviations within 5 per cent, det R within 1 per cent."""
    published = json.loads((BOOK / "references.json").read_text())["cases"][case]["methods"]["filter_error_nonlinear"]
    _, _, F, F_held = CASES[case]
    found = fit_filter_error(flown(case), np.array(F), F_held=F_held)
    assert found.status in (FilterErrorStatus.CONVERGED, FilterErrorStatus.GAIN_AT_LIMIT)
    compared = 0
    for name, estimate, sd in zip(found.names, found.estimate, found.sd, strict=True):
        theirs = published["parameters"].get(NAMED.get(name, name))
        if theirs:
            assert abs(estimate - theirs["estimate"]) < 0.3 * theirs["std"], name
            assert sd == pytest.approx(theirs["std"], rel=0.05), name
            compared += 1
    assert compared >= 5
    assert found.det_R == pytest.approx(published["det_R"], rel=0.01)
    np.testing.assert_allclose(found.F, list(published["process_noise_F_diagonal"].values()), rtol=0.01)


@pytest.mark.skipif(not BOOK.is_dir(), reason="needs ../shared/book")
def test_the_optimum_does_not_depend_on_the_start():
    """Far from the published start of the process noise."""
    whole = flown("TC04")
    first, second = (fit_filter_error(whole, np.full(4, F)) for F in (0.2, 1e-3))
    np.testing.assert_allclose(first.estimate, second.estimate, atol=1e-4 * first.sd.min(), rtol=1e-4)
    assert first.det_R == pytest.approx(second.det_R, rel=1e-6)


@pytest.mark.skipif(not BOOK.is_dir(), reason="needs ../shared/book")
def test_without_process_noise_it_is_output_error():
    """Of the HFB-320's flight, by the constant and by the varying gain."""
    whole = flown("TC04").nameless
    theta = jnp.asarray([p.start for p in whole.dynamics.free])
    nothing = jnp.zeros((1, 4))
    residual = np.asarray(simulate(whole, theta, nothing).residual)
    R = jnp.asarray(residual.reshape(-1, 7).var(axis=0))
    steady = steady_innovations(whole, theta, nothing, jnp.full(4, 1e-30), R)
    np.testing.assert_allclose(steady.innovation, residual, rtol=1e-8, atol=1e-8)
    varying = filter_segments(whole, theta, jnp.zeros(4), jnp.zeros(4), R)
    np.testing.assert_allclose(varying.innovation, residual, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("unstable", [False, True])
def test_the_riccati_equation_is_that_of_scipy(unstable):
    """Solution, and derivative by differences."""
    rng = np.random.default_rng(3)
    A = rng.standard_normal((4, 4)) + (2.0 if unstable else -4.0) * np.eye(4)
    C, F = rng.standard_normal((7, 4)), np.array([0.3, 1e-3, 0.1, 0.02])
    G, Q = C.T @ C / 0.04, np.diag(F**2)
    P = scipy.linalg.solve_continuous_are(A.T, np.linalg.cholesky(G), Q, np.eye(4))
    np.testing.assert_allclose(riccati(*(jnp.asarray(x) for x in (A, G, Q))), P, rtol=1e-8, atol=1e-12)
    dA, dG, dQ = (rng.standard_normal((4, 4)) for _ in range(3))
    dG, dQ = dG + dG.T, dQ + dQ.T

    def at(h):
        return riccati(jnp.asarray(A) + h * dA, jnp.asarray(G) + h * dG, jnp.asarray(Q) + h * 1e-3 * dQ)

    slope = jax.jvp(at, (0.0,), (1.0,))[1]
    np.testing.assert_allclose(slope, (at(1e-5) - at(-1e-5)) / 2e-5, rtol=1e-5, atol=1e-7)


def test_a_limited_step_meets_the_conditions_of_karush_kuhn_and_tucker():
    rng = np.random.default_rng(5)
    for _ in range(20):
        J = rng.standard_normal((9, 6))
        A, g = J.T @ J, rng.standard_normal(6)
        slopes, margin = rng.standard_normal((3, 6)), rng.uniform(0.0, 0.2, 3)
        step = constrained_step(A, g, slopes, margin)
        assert np.all(slopes @ step <= margin + 1e-8)
        active = slopes @ step > margin - 1e-8
        force = np.linalg.lstsq(slopes[active].T, g - A @ step, rcond=None)[0]
        assert np.all(force > -1e-8)
        np.testing.assert_allclose(slopes[active].T @ force, g - A @ step, atol=1e-7)
