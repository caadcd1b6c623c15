"""The posterior with process noise: its density and gradient, and both samplers against quadrature on a grid."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from linear_cards import FIRST_ORDER, card_of, disturbed_first_order
from scipy import stats

from bayes_aero.dynamics.filtering.density import NoisePoint, innovations_density
from bayes_aero.dynamics.filtering.innovations import filter_segments
from bayes_aero.dynamics.filtering.kalman import log_likelihood
from bayes_aero.dynamics.flight import Dynamics
from bayes_aero.dynamics.linear import linear_dynamics
from bayes_aero.dynamics.segments import segments
from bayes_aero.dynamics.system import System
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.prediction_error import fit_prediction_error
from bayes_aero.inference.posterior.ensemble import EnsembleLength
from bayes_aero.inference.posterior.innovations import (
    SPREAD,
    PosteriorLength,
    innovations_posterior,
    sample_innovations,
)
from bayes_aero.inference.posterior.nuts import NutsLength, WarmUp
from bayes_aero.inference.posterior.posterior import PosteriorStatus
from bayes_aero.model.joined_channels import join
from bayes_aero.parameter import Parameter, Prior

DT, N, ZALPHA, F, SIGMA = 0.05, 160, -0.8, 0.03, 0.01


@pytest.fixture(scope="module")
def scalar():
    """One state, disturbed, measured with noise; the samples of a gap are missing."""
    channels = disturbed_first_order(N, DT, ZALPHA, F, SIGMA)
    z, de = channels["alpha"], channels["elevator"]
    z[60:70] = np.nan
    card = card_of(FIRST_ORDER)
    record = FlightRecord.from_arrays("disturbed", DT * np.arange(N), channels, "simulated")
    flown = segments(join([record], card, ()), linear_dynamics(card), fixed={"alpha": 0.0}, held=True)
    return flown, z, de


@pytest.fixture(scope="module")
def fitted(scalar):
    return fit_prediction_error(scalar[0], np.array([0.02]), np.array([2e-4]))


def scalar_likelihood(z, de, a, f, sigma):
    """A Kalman filter of one state with exact transitions, for arrays of parameters."""
    phi, driven = np.exp(a * DT), (np.exp(2.0 * a * DT) - 1.0) / (2.0 * a) * f**2
    x, P, total = np.zeros_like(a), np.zeros_like(a), np.zeros_like(a)
    for measured, u in zip(z, de, strict=True):
        if np.isfinite(measured):
            S, e = P + sigma**2, measured - x
            total -= 0.5 * (np.log(2.0 * np.pi * S) + e**2 / S)
            x, P = x + P / S * e, P * sigma**2 / S
        x, P = phi * x - (phi - 1.0) / a * u, phi**2 * P + driven
    return total


def test_the_density_is_the_likelihood_of_the_fit_and_the_priors(scalar, fitted):
    """Likelihood to 1e-8 of the fit's; priors by SciPy's distributions."""
    R = np.array([3e-4])
    density = innovations_posterior(scalar[0], R)
    x = density.start(fitted)
    assert density.names == ("Zalpha", "F_alpha", "sigma_alpha")
    np.testing.assert_allclose(x, [*fitted.estimate, *fitted.F, *np.sqrt(fitted.R)], rtol=1e-12)
    assert float(density.log_likelihood(jnp.asarray(x))) == pytest.approx(fitted.log_likelihood, rel=1e-8)
    priors = stats.norm.logpdf(x[0], -1.0, 1.0)
    for value, median in zip(x[1:], (0.3 * R[0] ** 0.5, (0.1 * R[0]) ** 0.5), strict=True):
        priors += stats.lognorm.logpdf(value, SPREAD, scale=median)
    u = density.unconstrain(jnp.asarray(x))
    knee = np.array([0.5 * 0.3 * R[0] ** 0.5, 0.03 * (0.1 * R[0]) ** 0.5])
    slope = knee * (1.0 - np.exp(-x[1:] / knee))  # of knee log(1 + exp(u)) by u
    whole = fitted.log_likelihood + priors + np.log(slope).sum()
    assert float(density(u)) == pytest.approx(whole, rel=1e-8)


@pytest.mark.recovery
def test_both_samplers_find_the_posterior_by_quadrature(scalar, fitted):
    """Means within Monte Carlo error, deviations within a tenth; so the samplers agree with each other."""
    flown, z, de = scalar
    R = np.array([3e-4])
    axes = [
        np.linspace(-2.2, 0.4, 60) + 1e-4,
        *(np.log(y) + np.linspace(-1.6, 1.2, 60) for y in (fitted.F[0], fitted.R[0] ** 0.5)),
    ]
    a, f, s = np.meshgrid(*axes, indexing="ij")
    log = scalar_likelihood(z, de, a, np.exp(f), np.exp(s)) + stats.norm.logpdf(a, -1.0, 1.0)
    log += stats.norm.logpdf(f, np.log(0.3 * R[0] ** 0.5), SPREAD)
    log += stats.norm.logpdf(s, np.log((0.1 * R[0]) ** 0.5), SPREAD)
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    posteriors = sample_innovations(flown, fitted, R, seed=3)
    assert set(posteriors) == {"nuts", "emcee"}
    for posterior in posteriors.values():
        assert posterior.status is PosteriorStatus.CONVERGED
        for name, grid in {"Zalpha": a, "F_alpha": np.exp(f), "sigma_alpha": np.exp(s)}.items():
            found = posterior.marginals[name]
            mean = np.sum(weight * grid)
            sd = np.sqrt(np.sum(weight * (grid - mean) ** 2))
            assert abs(found.mean - mean) < 4.0 * sd / np.sqrt(found.ess_bulk), (posterior.engine, name)
            assert found.sd == pytest.approx(sd, rel=0.1), (posterior.engine, name)


def test_short_chains_say_so(scalar, fitted):
    """One ensemble of a hundred steps misses the effective sample size."""
    length = PosteriorLength(NutsLength(2, WarmUp(200), 1), EnsembleLength(1, 100))
    found = sample_innovations(scalar[0], fitted, np.array([3e-4]), seed=1, length=length)["emcee"]
    assert found.tree.attrs["steps"] == 100
    assert min(m.ess for m in found.marginals.values()) < 400.0
    assert found.status is PosteriorStatus.NOT_CONVERGED


class _Pendulum(System):
    """Turns, and is damped by the square of its rate; a sensor feels both."""

    values: dict[str, Any]

    @property
    def states(self):
        return ("w", "q")

    def motion(self, x, u):
        angle, rate = x
        stiff, damped = self.values["stiff"], self.values["damped"]
        turn = -stiff * jnp.sin(angle) - damped * rate * jnp.abs(rate) + u["elevator"]
        return jnp.stack([rate, turn]), {"w": angle, "q": rate, "az": jnp.cos(angle) * rate**2 + turn}

    def noise_density(self, x, u):  # noqa: ARG002
        return jnp.stack([jnp.zeros(()), (0.1 * x[0]) ** 2 * self.values["damped"]])


@dataclass(frozen=True)
class _PendulumDynamics(Dynamics):
    states = ("w", "q")
    inputs = ("elevator",)
    outputs = ("w", "q", "az")

    @property
    def free(self):
        wide = Prior("normal", 1.0, 3.0)
        return tuple(Parameter(name, "1", 0.0, 1.0, "of a pendulum", wide) for name in ("stiff", "damped"))

    def values(self, theta):
        return {"stiff": theta[0], "damped": theta[1]}

    def system(self, values, aircraft):  # noqa: ARG002
        return _Pendulum(values)

    def drives(self, values, channels, flights):  # noqa: ARG002
        return {"elevator": channels["elevator"]}


@pytest.fixture(scope="module")
def pendulum():
    """Two flights of unlike length with large angles; an output at half the rate."""
    rng, card = np.random.default_rng(2), card_of(FIRST_ORDER.replace("alpha", "w"))
    parts = []
    for n in (40, 30):
        t = 0.1 * np.arange(n)
        channels = {"w": np.sin(2.0 * t), "q": 2.0 * np.cos(2.0 * t), "az": np.sin(t), "elevator": np.sin(t)}
        noisy = {name: y + 0.1 * rng.standard_normal(n) for name, y in channels.items()}
        noisy["az"][::2] = np.nan
        parts.append(FlightRecord.from_arrays(f"flight{n}", t, noisy, "simulated"))
    return segments(join(parts, card, ()), _PendulumDynamics())


@eqx.filter_jit
def both(flown, x):
    point = NoisePoint(x[:2], x[2:4], x[4:])
    lean = innovations_density(flown, point, jnp.array([0.1, 0.2]))
    found = filter_segments(flown, x[:2], jnp.array([0.1, 0.2]), x[2:4], x[4:])
    return lean, jnp.sum(jax.vmap(log_likelihood)(found))


def test_the_lean_likelihood_is_the_filter_s(pendulum):
    rng = np.random.default_rng(1)
    for _ in range(3):
        x = jnp.asarray([4.0, 0.3, 0.05, 0.2, 0.01, 0.01, 0.02] * rng.uniform(0.5, 1.5, 7))
        lean, whole = both(pendulum.nameless, x)
        assert float(lean) == pytest.approx(float(whole), rel=1e-10)


def test_its_gradient_is_that_of_finite_differences(pendulum):
    """Of a motion and outputs that bend, and of noise that depends on state and parameters."""
    flown = pendulum.nameless
    value = eqx.filter_jit(lambda x: innovations_density(flown, NoisePoint(x[:2], x[2:4], x[4:]), jnp.ones(2)))
    x = np.array([4.0, 0.3, 0.05, 0.2, 0.01, 0.01, 0.02])
    gradient = jax.jit(jax.grad(value))(jnp.asarray(x))
    for i in range(len(x)):
        h = 1e-5 * x[i] * (np.arange(len(x)) == i)
        difference = (value(jnp.asarray(x + h)) - value(jnp.asarray(x - h))) / (2.0 * h.sum())
        assert float(gradient[i]) == pytest.approx(float(difference), rel=1e-6, abs=1e-4), i


def test_a_noise_that_vanishes_begins_inside_its_prior(scalar, fitted):
    """A fit without process noise is no point of a lognormal."""
    density = innovations_posterior(scalar[0], np.array([3e-4]))
    x = density.start(replace(fitted, F=np.zeros(1)))
    assert x[1] == pytest.approx(0.3 * 3e-4**0.5 * np.exp(-2.0 * SPREAD))
    assert np.isfinite(float(density(density.unconstrain(jnp.asarray(x)))))
