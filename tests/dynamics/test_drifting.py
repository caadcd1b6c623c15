"""Parameters as random walks: against another library's local level, and against parameters that are moved for good."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from linear_cards import card_of
from scipy.stats import chi2

from bayes_aero.diagnosis.trajectories.process_noise import at_bound, holm
from bayes_aero.dynamics.filtering.drifting import drifting
from bayes_aero.dynamics.filtering.innovations import filter_segments
from bayes_aero.dynamics.filtering.kalman import log_likelihood, outputs_at, smooth
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.linear import linear_dynamics
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.segments import prepare, segments
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.drifting import fit_drifting, histories
from bayes_aero.inference.likelihood.prediction_error import PredictionErrorStatus, fit_prediction_error
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model

N, DT, SIGMA, SD, BIAS = 400, 0.05, 0.04, 0.05, 0.3
SCALAR = """
[channels]
time = { label = "t", unit = "s" }
q = { label = "q", unit = "rad/s", required = false }
az = { label = "az", unit = "m/s^2" }
[linear]
states = ["q"]
[linear.rates.q]
damping = "q"
[linear.outputs.az]
bias = "1"
[linear.fixed]
damping = -1.0
"""


@pytest.fixture(scope="module")
def scalar():
    """A constant that drifts, read by one noisy sensor."""
    rng = np.random.default_rng(3)
    walk = np.append(0.0, np.cumsum(SIGMA * np.sqrt(DT) * rng.standard_normal(N - 1)))
    z = BIAS + walk + SD * rng.standard_normal(N)
    z[100:130] = np.nan
    card = card_of(SCALAR)
    record = FlightRecord.from_arrays("walk", DT * np.arange(N), {"az": np.nan_to_num(z)}, "simulated")
    flights = join([record], card, ())
    flights = replace(flights, channels=flights.channels | {"az": jnp.asarray(z)})
    return segments(flights, linear_dynamics(card)), z


def local_level(z, sigma, variance, **start):
    """Statsmodels' local level of these intensities."""
    structural = pytest.importorskip("statsmodels.tsa.statespace.structural")
    other = structural.UnobservedComponents(z, "local level", loglikelihood_burn=0)
    other.ssm.tolerance = 0.0  # no gain that is held from some sample on
    if start:
        other.ssm.initialize_known(np.array([start["level"]]), np.zeros((1, 1)))
    else:
        other.ssm.initialize_diffuse()
    return other.smooth([variance, sigma**2 * DT])


def test_a_drifting_constant_is_the_local_level_of_another_library(scalar):
    """Likelihood, states given all samples and their variances to 1e-8."""
    flown, z = scalar
    moving = replace(flown, dynamics=drifting(flown.dynamics, ["bias"]))
    deviation, F, R = jnp.array([0.05, 0.0]), jnp.array([0.0, SIGMA]), jnp.array([SD**2])
    found = filter_segments(moving, jnp.array([BIAS]), deviation, F, R)
    one = type(found)(*(x[0] for x in found))
    theirs = local_level(z, SIGMA, SD**2, level=BIAS)
    assert float(log_likelihood(one)) == pytest.approx(theirs.llf, rel=1e-8)
    x, P = smooth(one)
    np.testing.assert_allclose(BIAS + x[:, 1], theirs.smoothed_state[0], rtol=1e-8)
    np.testing.assert_allclose(P[1:, 1, 1], theirs.smoothed_state_cov[0, 0, 1:], rtol=1e-8)
    assert float(P[0, 1, 1]) == 0.0


@pytest.fixture(scope="module")
def fitted(scalar):
    flown, z = scalar
    still = fit_prediction_error(flown, np.zeros(1), np.array([4.0 * SD**2]), start_deviation=np.array([0.05]))
    return still, fit_drifting(flown, still, ["bias"]), z


def test_the_intensity_is_where_the_other_library_s_likelihood_is_highest(fitted):
    _, found, z = fitted
    fit = found.fit
    assert fit.status is PredictionErrorStatus.CONVERGED
    assert found.usable
    level, sigma, variance = float(fit.estimate[0]), float(found.intensity[0, 0]), float(fit.R[0])
    best = local_level(z, sigma, variance, level=level).llf
    assert best == pytest.approx(fit.log_likelihood, rel=1e-7)
    for up in (0.98, 1.02):
        assert local_level(z, up * sigma, variance, level=level).llf < best
        assert local_level(z, sigma, up * variance, level=level).llf < best
        assert local_level(z, sigma, variance, level=up * level).llf < best
    assert abs(np.log(sigma / SIGMA)) < 3.0 * found.intensity[0, 1]


def test_the_likelihood_ratio_is_twice_the_gain_of_the_other_library(fitted):
    still, found, z = fitted
    with_drift = local_level(z, float(found.intensity[0, 0]), float(found.fit.R[0]), level=float(found.fit.estimate[0]))
    known = z[np.isfinite(z)]
    level = np.mean(known)
    without = -0.5 * len(known) * (np.log(2.0 * np.pi * np.mean((known - level) ** 2)) + 1.0)
    assert still.estimate[0] == pytest.approx(level, rel=1e-5)
    assert found.ratio == pytest.approx(2.0 * (with_drift.llf - without), rel=1e-4)


def test_values_have_the_variance_of_a_level_whose_begin_is_not_known(fitted):
    """With noise and intensity known it is that of a diffuse beginning: the smoother's alone would be too small."""
    _, found, z = fitted
    theirs = local_level(z, float(found.intensity[0, 0]), float(found.fit.R[0]))
    begin, alone = theirs.smoothed_state[0, :1], np.zeros_like(found.fit.covariance)
    alone[0, 0] = found.fit.covariance[0, 0]
    assert abs(found.fit.estimate[0] - begin[0]) < 0.05 * np.sqrt(alone[0, 0])  # how near the fit comes
    path = histories(replace(found, fit=replace(found.fit, estimate=begin, covariance=alone)))
    np.testing.assert_allclose(path.value[0, :, 0], theirs.smoothed_state[0], rtol=1e-6)
    # The information on the begin is that of the expectation but for the innovations themselves: a part in a thousand.
    np.testing.assert_allclose(path.value_sd[0, :, 0] ** 2, theirs.smoothed_state_cov[0, 0], rtol=3e-3)


def test_a_sensor_that_has_drifted_reads_as_one_with_another_bias():
    """Of effects: the record is corrected, and what is compared differs as much as with the bias moved for good."""
    card = read_card("hfb320")
    added, away = ("pitch_rate_bias", "thrust_scale", "alpha_squared_moment"), np.array([0.003, 0.02, -0.5, -0.05])
    model = Model.from_card(card).extended(*added, "flow_separation", "kirchhoff_lift", "separation_lag")
    names = (*(p.name for e in model.effects if e.name in added for p in e.parameters), "alpha_star")
    rng, n = np.random.default_rng(1), 40
    size = {"airspeed": 104.0, "alpha": 0.11, "theta": 0.11, "q": 0.0, "ax": 1.0, "az": -9.6, "elevator": -0.03}
    channels = {name: x + 0.01 * rng.standard_normal(n) for name, x in size.items()}
    channels |= {"thrust": np.full(n, 9e3), "density": np.full(n, 0.792)}
    record = FlightRecord.from_arrays("short", 0.05 * np.arange(n), channels, "simulated")
    flights = join([record], card, FLIGHT)
    outputs = ("airspeed", "alpha", "theta", "q", "ax", "az")
    plain = segments(flights, aircraft_dynamics(model, flights), outputs=outputs)
    theta = np.array([p.start for p in plain.dynamics.free])
    moved = theta + away @ np.array([[p == name for p in plain.dynamics.names] for name in names])
    drifted = prepare(replace(plain, dynamics=drifting(plain.dynamics, names)), jnp.asarray(theta))
    there, here = prepare(plain, jnp.asarray(moved)), prepare(plain, jnp.asarray(theta))
    x = jnp.array([103.0, 0.10, 0.09, 0.01, 0.8])  # the last is the separation point
    assert there.system.states[-1] == "X"
    k, rows = 20, {}
    for name, prepared, state in (("drifted", drifted, jnp.append(x, away)), ("moved", there, x), ("still", here, x)):
        u = {channel: y[0, k] for channel, y in prepared.drives.items()}
        rate, _ = prepared.system.motion(state, u)
        rows[name] = [*(prepared.true[0, k] - outputs_at(prepared.system, state, u, plain.outputs)), *rate[:5]]
    np.testing.assert_allclose(rows["drifted"], rows["moved"], rtol=1e-9, atol=1e-12)
    assert np.all(
        np.abs(np.array(rows["moved"]) - np.array(rows["still"]))[[3, 9, 10]] > 1e-3
    )  # q, its rate, and that of X


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["CLaa"], "no such parameter; did you mean CLa"),
        (["vertical_gust"], "belongs to a disturbance"),
        (["Cma"], "the card fixes it"),
        ([], "0 parameters are named to drift; name one to 4"),
        (["Cm0", "CLa", "CD0", "Cmq", "Cmde"], "5 parameters"),
    ],
)
def test_what_cannot_drift_is_refused_in_a_sentence(names, said):
    card = read_card("hfb320")
    model = Model.from_card(card).extended("vertical_gust")
    size = {"airspeed": 104.0, "alpha": 0.11, "theta": 0.11, "q": 0.0, "elevator": 0.0, "thrust": 9e3, "density": 0.8}
    channels = {name: np.full(20, x) for name, x in size.items()}
    record = FlightRecord.from_arrays("short", 0.05 * np.arange(20), channels, "simulated")
    dynamics = aircraft_dynamics(model, join([record], card, FLIGHT))
    with pytest.raises(InputError, match=said):
        drifting(dynamics, names, {"Cma"})


def test_p_values_are_those_of_the_boundary_and_of_holm():
    multitest = pytest.importorskip("statsmodels.stats.multitest")
    assert at_bound(2.705543454) == pytest.approx(0.05, abs=1e-9)  # the 90 % point of chi-square
    assert at_bound(0.0) == at_bound(0.0, 3) == 1.0
    assert at_bound(4.0, 2) == pytest.approx(0.5 * chi2.sf(4.0, 1) + 0.25 * chi2.sf(4.0, 2))
    p = np.array([0.02, 0.9, 0.03, 0.02])
    np.testing.assert_allclose(holm(p), multitest.multipletests(p, method="holm")[1])
