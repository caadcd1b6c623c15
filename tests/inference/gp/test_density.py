"""The marginal likelihood against its textbook form, closed forms, finite differences and scikit-learn."""

import importlib.util
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from bayes_aero.inference.gp.priors import Priors
from bayes_aero.inference.gp.reduced import ReducedData
from bayes_aero.inference.gp.sampling.density import log_density

BENCHMARK = Path(__file__).parents[3] / "benchmarks" / "scikit_learn_gp.py"


def textbook_covariance(theta, x):
    d, e = x.shape[1], np.exp(theta)
    distance = (((x[:, None] - x) / e[d + 2 : 2 * d + 2]) ** 2).sum(axis=-1)
    k = e[0] ** 2 + (x * e[1 : d + 1] ** 2) @ x.T + e[d + 1] ** 2 * np.exp(-0.5 * distance)
    return k + e[-1] ** 2 * np.eye(len(x))


@pytest.mark.parametrize(("seed", "d"), [(0, 1), (1, 2), (2, 4)])
def test_value_is_the_gaussian_density_of_the_full_covariance(problem, seed, d):
    data, theta = problem(seed, n=40, d=d)
    y = data.fy[:, -1]
    exact = multivariate_normal(np.zeros(data.n), textbook_covariance(theta, data.x)).logpdf(y)
    assert log_density(theta, data, Priors.flat()).value == pytest.approx(exact, rel=1e-10)


def test_one_and_two_points_in_closed_form():
    theta = np.log([0.7, 0.3, 1.1, 0.9, 0.2])
    s0, s1, sf, length, sn = np.exp(theta)
    x, y = np.array([[0.4], [-1.0]]), np.array([0.8, -0.1])
    one = ReducedData.of(x[:1], y[:1])
    variance = s0**2 + (s1 * 0.4) ** 2 + sf**2 + sn**2
    assert log_density(theta, one, Priors.flat()).value == pytest.approx(norm(0, np.sqrt(variance)).logpdf(0.8))
    a, b = variance, s0**2 + s1**2 + sf**2 + sn**2
    c = s0**2 - 0.4 * s1**2 + sf**2 * np.exp(-0.5 * (1.4 / length) ** 2)
    determinant = a * b - c * c
    quadratic = (b * 0.64 + a * 0.01 + 2 * c * 0.08) / determinant
    expected = -0.5 * (quadratic + np.log(determinant)) - np.log(2 * np.pi)
    assert log_density(theta, ReducedData.of(x, y), Priors.flat()).value == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("priors", [Priors.flat(), Priors()], ids=["flat", "default"])
@pytest.mark.parametrize("seed", range(3))
def test_gradient_is_the_finite_difference(problem, seed, priors):
    data, theta = problem(seed + 10)
    gradient = log_density(theta, data, priors).gradient
    step = 1e-5 * np.eye(theta.size)
    numeric = [
        (log_density(theta + s, data, priors).value - log_density(theta - s, data, priors).value) / 2e-5 for s in step
    ]
    np.testing.assert_allclose(gradient, numeric, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_gradient_is_that_of_differentiating_through_the_factorisation(problem, seed):
    data, theta = problem(seed + 20)
    gradient = log_density(theta, data, Priors.flat()).gradient
    x, y = jnp.asarray(data.x), jnp.asarray(data.fy[:, -1])
    plain = jax.grad(lambda t: _through_the_cholesky(t, x, y))(jnp.asarray(theta))
    np.testing.assert_allclose(gradient, plain, rtol=1e-6, atol=1e-8)


def _through_the_cholesky(theta, x, y):
    d, e = x.shape[1], jnp.exp(theta)
    distance = jnp.sum(((x[:, None] - x) / e[d + 2 : 2 * d + 2]) ** 2, axis=-1)
    k = e[0] ** 2 + (x * e[1 : d + 1] ** 2) @ x.T + e[d + 1] ** 2 * jnp.exp(-0.5 * distance)
    lower = jnp.linalg.cholesky(k + e[-1] ** 2 * jnp.eye(x.shape[0]))
    z = jax.scipy.linalg.solve_triangular(lower, y, lower=True)
    return -0.5 * z @ z - jnp.sum(jnp.log(jnp.diagonal(lower)))


def test_value_and_gradient_are_scikit_learns(problem):
    pytest.importorskip("sklearn")
    spec = importlib.util.spec_from_file_location("scikit_learn_gp", BENCHMARK)
    bench = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(bench)
    data, theta = problem(30, n=80, d=4)
    y = data.fy[:, -1]
    ours = log_density(theta, data, Priors.flat())
    model = bench.scikit_learn_model(data.x, y, theta)
    value, gradient = model.log_marginal_likelihood(bench.to_scikit_learn(theta), eval_gradient=True)
    assert ours.value == pytest.approx(value, rel=1e-8)
    per = bench.to_scikit_learn(np.ones(theta.size))  # theirs are derivatives by the logs of variances
    np.testing.assert_allclose(ours.gradient, per * gradient, rtol=1e-6, atol=1e-8)


def test_what_cannot_be_factorised_says_so():
    x = np.repeat(np.linspace(-1, 1, 30), 2)[:, None]  # every sample twice
    theta = np.array([0.0, 0.0, 0.0, 3.0, -25.0])  # and no noise to tell them apart
    out = log_density(theta, ReducedData.of(x, np.sin(x[:, 0])), Priors.flat())
    assert not out.ok
    assert np.isnan(out.value)
