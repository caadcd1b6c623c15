"""The marginal likelihood, its priors and its derivatives against textbooks, closed forms, SciPy and scikit-learn."""

import importlib.util
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize
from scipy.stats import multivariate_normal, norm

from bayes_aero.errors import InputError
from bayes_aero.inference.gp.kernel import FLAT, HyperPrior, Priors, ReducedData, reduced_stats
from bayes_aero.inference.gp.optimum import SD_BOUNDS, best_sizes, slopes
from bayes_aero.inference.gp.posterior import log_density, small_posterior

# The marginal likelihood against its textbook form, closed forms, finite differences and scikit-learn
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


def test_one_and_two_points_in_closed_form_and_what_cannot_be_factorised():
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
    x = np.repeat(np.linspace(-1, 1, 30), 2)[:, None]  # every sample twice
    theta = np.array([0.0, 0.0, 0.0, 3.0, -25.0])  # and no noise to tell them apart
    out = log_density(theta, ReducedData.of(x, np.sin(x[:, 0])), Priors.flat())
    assert not out.ok
    assert np.isnan(out.value)


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


# Hyperparameter priors are densities of the logarithm, and refuse nonsense
PROPER = [
    HyperPrior("half-normal", 0.7), HyperPrior("log-normal", 0.3, 0.8), HyperPrior("inverse-gamma", 3.0, 2.0),
    HyperPrior("frechet", 2.0, 5.0),
]  # fmt: skip


@pytest.mark.parametrize("prior", PROPER, ids=lambda p: p.family)
def test_priors_integrate_to_one_and_draws_follow_them(prior):
    mass, _ = quad(lambda t: float(jnp.exp(prior.log_density(jnp.asarray(t)))), -15, 8, limit=200)
    assert mass == pytest.approx(1.0, abs=1e-6)
    t = np.asarray(prior.sample(jax.random.PRNGKey(4), (4000,)))
    mean, _ = quad(lambda s: s * float(jnp.exp(prior.log_density(jnp.asarray(s)))), -15, 8, limit=200)
    assert t.mean() == pytest.approx(mean, abs=5 * t.std() / np.sqrt(t.size))


def test_a_frechet_prior_charges_for_what_is_shorter_than_its_scale():
    prior = HyperPrior("frechet", 6.0, 10.0)
    t = prior.sample(jax.random.PRNGKey(1), (20000,))
    assert float(jnp.mean(jnp.exp(t) < 6.0)) == pytest.approx(np.exp(-1.0), abs=0.02)  # its scale is that quantile
    at_half, at_scale = prior.log_density(jnp.log(jnp.array([3.0, 6.0])))
    assert float(at_scale - at_half) == pytest.approx(2.0**10 - 1.0 - 10.0 * np.log(2.0))


def test_priors_are_laid_out_as_theta_and_refuse_nonsense():
    priors, d = Priors(), 3
    theta = jnp.linspace(-1, 1, 2 * d + 3)
    parts = [float(p.log_density(t)) for p, t in zip(priors.per_parameter(d), theta, strict=True)]
    assert float(priors.log_density(theta)) == pytest.approx(sum(parts))
    assert priors.sample(jax.random.PRNGKey(0), d, 7).shape == (7, 2 * d + 3)
    with pytest.raises(InputError, match="positive"):
        HyperPrior("half-normal", -1.0)
    with pytest.raises(InputError, match="improper"):
        FLAT.sample(jax.random.PRNGKey(0), (1,))
    assert not Priors(noise=FLAT).proper


# Newton's method for the sizes: its derivatives against automatic ones, its optimum against SciPy's
INVERSE = Priors(linear=HyperPrior("inverse-gamma", 2.0, 0.5))
PRIORS = {"house": Priors(), "quasi-steady": Priors.quasi_steady(), "flat": Priors.flat(), "inverse": INVERSE}


def together(w, u):
    return jnp.concatenate([w, u[:-1], (w[-1] + 0.5 * u[-1])[None]])


def statistics_of(seed, d):
    """Statistics of d inputs, an output with a linear and a curved part, at random length scales."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((80, d))
    y = np.sin(2.0 * x[:, 0]) + x @ rng.uniform(0.0, 0.3, d) + rng.normal(0.0, 0.2, 80)
    u = np.append(rng.uniform(-0.5, 2.0, d), rng.uniform(-4.0, 0.0))
    return u, reduced_stats(u, ReducedData.of(x, y / np.sqrt(np.mean(y**2))))


@pytest.mark.parametrize("priors", PRIORS.values(), ids=PRIORS)
@pytest.mark.parametrize("d", [1, 4])
def test_derivatives_are_those_of_the_density(priors, d):
    rng = np.random.default_rng(4132)
    u, stats = statistics_of(rng.integers(2**31), d)
    w = rng.uniform(-1.5, 1.0, d + 2)
    found = slopes(w, u, stats, 80.0, priors)

    def posterior(theta, logdet, gram):
        return small_posterior(theta, logdet, gram, 80.0, priors)

    arguments = (together(w, u), jnp.asarray(stats.logdet), jnp.asarray(stats.gram))
    assert found.value == pytest.approx(float(posterior(*arguments)), rel=1e-11)
    by_theta, by_logdet, by_gram = jax.grad(posterior, argnums=(0, 1, 2))(*arguments)
    np.testing.assert_allclose(found.by_theta, by_theta, rtol=1e-8, atol=1e-8)
    assert found.by_logdet == pytest.approx(float(by_logdet))
    symmetric = np.asarray(by_gram) + np.asarray(by_gram).T
    np.testing.assert_allclose(found.by_gram + found.by_gram.T, symmetric, rtol=1e-7, atol=1e-9)
    in_w = jax.jit(lambda w: posterior(together(w, u), *arguments[1:]))
    np.testing.assert_allclose(found.by_w, jax.grad(in_w)(w), rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(found.by_w_twice, jax.hessian(in_w)(w), rtol=1e-7, atol=1e-6)


@pytest.mark.parametrize("priors", PRIORS.values(), ids=PRIORS)
def test_the_optimum_is_at_least_as_good_as_that_of_scipy(priors):
    rng = np.random.default_rng(4132)
    for _ in range(5):
        d = int(rng.integers(1, 6))
        u, stats = statistics_of(rng.integers(2**31), d)
        start = rng.uniform(-3.0, 2.0, d + 2)
        w, found = best_sizes(start, u, stats, 80.0, priors)
        assert np.all((w >= SD_BOUNDS[0]) & (w <= SD_BOUNDS[1]))

        def negative(w, u=u, stats=stats):
            at = slopes(w, u, stats, 80.0, priors)
            return -at.value, -at.by_w

        theirs = minimize(negative, w, jac=True, method="L-BFGS-B", bounds=[SD_BOUNDS] * w.size)
        assert found.value >= -theirs.fun - 1e-7 * abs(theirs.fun)  # nothing higher close by
        inside = (w > SD_BOUNDS[0] + 1e-6) & (w < SD_BOUNDS[1] - 1e-6)
        assert np.max(np.abs(found.by_w[inside]), initial=0.0) < 1e-4 * max(1.0, 1e-3 * abs(found.value))


@pytest.mark.parametrize("family", ["half-normal", "log-normal", "inverse-gamma", "frechet", "flat"])
def test_slopes_of_a_prior_are_those_of_its_density(family):
    prior = HyperPrior(family, 0.7, 1.3)
    t = np.random.default_rng(3).uniform(-2.0, 2.0, 7)
    value, slope, bend = prior.slopes(t)
    np.testing.assert_allclose(value, prior.log_density(jnp.asarray(t)), rtol=1e-12, atol=1e-12)
    first = jax.vmap(jax.grad(prior.log_density))
    np.testing.assert_allclose(slope, first(jnp.asarray(t)), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        bend, jax.vmap(jax.grad(jax.grad(prior.log_density)))(jnp.asarray(t)), rtol=1e-9, atol=1e-12
    )
