"""Newton's method for the sizes: its derivatives against automatic ones, its optimum against SciPy's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from bayes_aero.inference.gp.priors import HyperPrior, Priors
from bayes_aero.inference.gp.profile import SD_BOUNDS, best_sizes, slopes
from bayes_aero.inference.gp.reduced import ReducedData, reduced_stats
from bayes_aero.inference.gp.sampling.density import small_posterior

INVERSE = Priors(linear=HyperPrior("inverse-gamma", 2.0, 0.5))
PRIORS = {"house": Priors(), "quasi-steady": Priors.quasi_steady(), "flat": Priors.flat(), "inverse": INVERSE}


def together(w, u):
    return jnp.concatenate([w, u[:-1], (w[-1] + 0.5 * u[-1])[None]])


def problem(seed, d):
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
    u, stats = problem(rng.integers(2**31), d)
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
        u, stats = problem(rng.integers(2**31), d)
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
