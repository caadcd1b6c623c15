"""Parameters, process noise and measurement noise of a simulated disturbed flight, jointly, against the truth."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.dynamics.linear import linear_dynamics
from bayes_aero.dynamics.segments import segments
from bayes_aero.dynamics.system import advance
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood import prediction_error
from bayes_aero.inference.likelihood.prediction_error import PredictionErrorStatus, fit_prediction_error
from bayes_aero.model.joined_channels import join

TRUTH = {"Zw": -1.4249, "Zde": -6.2632, "Mw": -0.05, "Mq": -3.7067, "Mde": -12.78}  # as the unstable card, made stable
F, R = np.array([0.8, 0.06]), np.array([0.15, 0.01, 0.4]) ** 2  # w, q; w, q, az
DT, N = 0.05, 1200


@pytest.fixture(scope="module")
def flown():
    """One manoeuvre of a minute in disturbed air; az at every second sample, a gap in q."""
    card = read_card("unstable")
    dynamics = linear_dynamics(card)
    values = dynamics.fixed | TRUTH
    rng, t = np.random.default_rng(11), DT * np.arange(N)
    de = 0.06 * np.sign(np.sin(2.0 * np.pi * t / 7.0)) + 0.03 * np.sign(np.sin(2.0 * np.pi * t / 2.3))
    system = dynamics.system({name: jnp.asarray(x) for name, x in values.items()}, card.aircraft)
    ahead, x, rows = eqx.filter_jit(advance), np.zeros(2), []
    for k in range(N):
        az = values["Zw"] * x[0] + values["Zq"] * x[1] + values["Zde"] * de[k]
        rows.append([*x, az])
        now, then = ({"elevator": jnp.asarray(de[min(k + i, N - 1)]), "1": jnp.asarray(1.0)} for i in (0, 1))
        x = np.asarray(ahead(system, jnp.asarray(x), now, then, DT, 1)) + np.sqrt(DT) * F * rng.standard_normal(2)
    z = np.array(rows) + np.sqrt(R) * rng.standard_normal((N, 3))
    channels = {"w": z[:, 0], "q": z[:, 1], "az": z[:, 2], "elevator": de}
    record = FlightRecord.from_arrays("disturbed", t, channels, "simulated")
    return segments(join([record], card, ()), dynamics, fixed=card.fly.initial_state)


def test_the_truth_is_recovered(flown):
    """Every parameter within 3.5 standard errors; process and measurement noise within 3.5 of their own."""
    found = fit_prediction_error(flown, np.full(2, 0.2), 4.0 * R[[0, 1, 2]], priors=False)
    assert found.status is PredictionErrorStatus.CONVERGED
    order = [found.outputs.index(name) for name in ("w", "q", "az")]
    sd = np.sqrt(np.diag(found.covariance))
    for name, estimate, error in zip(found.names, found.estimate, found.sd, strict=True):
        assert abs(estimate - TRUTH[name]) < 3.5 * error, name
        assert error < 0.2 * abs(TRUTH[name]) or name == "Mw"
    k = len(found.names)
    assert np.all(np.abs(np.log(found.F / F)) < 3.5 * sd[k : k + 2])
    assert np.all(np.abs(np.log(found.R[order] / R)) < 3.5 * sd[k + 2 :][order])
    used = np.asarray(found.found.used)[0]
    e = np.asarray(found.found.innovation / np.sqrt(found.found.variance))[0]
    for c in range(3):
        white = e[used[:, c], c]
        assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 4.0 / np.sqrt(len(white))


def test_the_gradient_is_that_of_finite_differences(flown):
    point = np.array([*(0.9 * TRUTH[n] for n in flown.dynamics.names), *np.log(F), *np.log(R)])
    problem = prediction_error._Problem.of(flown.nameless, None, {}, F > 0.0, True)
    gradient = problem.look(point).gradient
    for i, g in enumerate(gradient):
        h = 1e-5 * max(1.0, abs(point[i])) * (np.arange(len(point)) == i)
        difference = (problem.cost(point + h) - problem.cost(point - h)) / (2.0 * h.sum())
        assert g == pytest.approx(difference, rel=1e-4, abs=1e-3), i


def test_without_process_noise_the_fit_says_so(flown):
    """F of 0 is held; the likelihood of a disturbed flight is far lower without it."""
    still = fit_prediction_error(flown, np.zeros(2), 20.0 * R, priors=False)
    free = fit_prediction_error(flown, F, R, priors=False)
    np.testing.assert_array_equal(still.F, 0.0)
    assert free.log_likelihood - still.log_likelihood > 100.0
