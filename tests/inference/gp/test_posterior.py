"""Full Bayes through the stand-in equals NUTS on the exact density, and a wrong stand-in is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arviz_stats.base import array_stats
from jax.scipy.stats import multivariate_normal
from numpyro.infer import MCMC, NUTS

from bayes_aero.inference.compiled_programs import give_back_memory
from bayes_aero.inference.gp import posterior as course
from bayes_aero.inference.gp.optimum import find_map
from bayes_aero.inference.gp.posterior import Budget, sample_posterior
from bayes_aero.inference.gp.priors import Priors
from bayes_aero.inference.gp.reduced import ReducedData
from bayes_aero.inference.gp.sampling.density import log_density
from bayes_aero.inference.gp.sampling.reweight import SampleStatus, pareto_smooth, reweight, thin
from bayes_aero.inference.gp.sampling.sample import Settings, laplace_root

LENGTH = Settings(250, 500, 4)
BUDGET = Budget(exact=400, nuts=LENGTH)


@pytest.fixture(scope="module")
def case():
    """A non-linear function of one input with a linear trend, 60 points: data, optimum, posterior."""
    rng = np.random.default_rng(21)
    x = rng.uniform(-1.7, 1.7, size=(60, 1))
    y = 0.5 + 0.4 * x[:, 0] + 0.5 * np.sin(4 * x[:, 0]) + 0.1 * rng.normal(size=60)
    data = ReducedData.of(x, y)
    best = find_map(data, Priors(), starts=4, polish=1)[0]
    return data, best, sample_posterior(best, data, Priors(), budget=BUDGET, seed=2)


def test_it_is_accepted_with_its_error_measured(case):
    data, _, sampled = case
    weighted = sampled.weighted
    assert sampled.status is SampleStatus.accepted
    assert weighted.k_hat < weighted.k_limit <= 0.7
    assert weighted.ess > 0.8 * weighted.exact.size
    assert np.sum(np.exp(weighted.log_weight)) == pytest.approx(1.0)
    assert np.max(sampled.chains.rhat) < 1.01
    at = weighted.theta[1, 5]
    assert weighted.exact[1, 5] == pytest.approx(log_density(at, data, Priors()).value, abs=1e-9)


def test_re_weighted_draws_are_those_of_nuts_on_the_exact_density(case):
    data, best, sampled = case
    root = laplace_root(best.theta, sampled.emulator, float(data.n), Priors())
    exact = _nuts_on_the_exact_density(best.theta, root, data)
    draws = np.asarray(best.theta + exact.get_samples(group_by_chain=True) @ root.T)
    theirs = draws.reshape(-1, best.theta.size)
    theirs_ess = np.array([array_stats.ess(c) for c in np.moveaxis(draws, -1, 0)])
    weight = np.exp(sampled.weighted.log_weight).ravel()
    ours = sampled.weighted.theta.reshape(-1, best.theta.size)
    mean = weight @ ours
    sd = np.sqrt(weight @ (ours - mean) ** 2)
    error = np.sqrt(theirs.var(axis=0) * (1 / np.minimum(theirs_ess, len(theirs)) + 1 / sampled.weighted.ess))
    assert np.all(np.abs(mean - theirs.mean(axis=0)) < 4.5 * error)
    np.testing.assert_allclose(sd, theirs.std(axis=0), rtol=0.25)
    log_density_there = -np.asarray(exact.get_extra_fields()["potential_energy"])
    assert log_density_there.mean() == pytest.approx(weight @ sampled.weighted.exact.ravel(), abs=0.6)


def _nuts_on_the_exact_density(theta, root, data):
    """NumPyro's own driver on the textbook density, n^3 at every leapfrog step."""
    x, y = jnp.asarray(data.x), jnp.asarray(data.fy[:, -1])
    d = x.shape[1]

    def potential(w):
        at = jnp.asarray(theta) + jnp.asarray(root) @ w
        e = jnp.exp(at)
        distance = jnp.sum(((x[:, None] - x) / e[d + 2 : 2 * d + 2]) ** 2, axis=-1)
        k = e[0] ** 2 + (x * e[1 : d + 1] ** 2) @ x.T + e[d + 1] ** 2 * jnp.exp(-0.5 * distance)
        covariance = k + e[-1] ** 2 * jnp.eye(len(y))
        return -multivariate_normal.logpdf(y, jnp.zeros(len(y)), covariance) - Priors().log_density(at)

    driver = MCMC(
        NUTS(potential_fn=potential, target_accept_prob=0.85, max_tree_depth=7, dense_mass=True),
        num_warmup=LENGTH.warmup, num_samples=LENGTH.draws, num_chains=LENGTH.chains,
        chain_method="vectorized", progress_bar=False,
    )  # fmt: skip
    starts = jax.random.normal(jax.random.PRNGKey(8), (LENGTH.chains, len(theta)))
    driver.run(jax.random.PRNGKey(9), init_params=starts, extra_fields=("potential_energy",))
    return driver


def test_the_same_seed_gives_the_same_numbers(case):
    data, best, sampled = case
    again = sample_posterior(best, data, Priors(), budget=BUDGET, seed=2)
    np.testing.assert_array_equal(again.weighted.theta, sampled.weighted.theta)
    assert again.weighted.k_hat == sampled.weighted.k_hat


@pytest.mark.forgets
@pytest.mark.verify
def test_it_samples_as_before_after_compiled_programs_were_given_back():
    """As between two coefficients that one process trains."""
    x = np.linspace(-1.5, 1.5, 30)[:, None]
    data = ReducedData.of(x, np.sin(3.0 * x[:, 0]) + 0.1 * np.random.default_rng(3).normal(size=30))
    best = find_map(data, Priors(), starts=2, polish=1)[0]
    tiny = Budget(design=20, exact=20, rounds=1, extensions=0, nuts=Settings(10, 10, 2))
    before = sample_posterior(best, data, Priors(), budget=tiny, seed=1)
    give_back_memory()
    after = sample_posterior(best, data, Priors(), budget=tiny, seed=1)
    np.testing.assert_array_equal(after.chains.theta, before.chains.theta)


def test_a_stand_in_much_too_narrow_is_refused(case):
    """Draws squeezed to a third around the optimum, with the density they then have."""
    data, best, sampled = case
    theta, _ = thin(sampled.chains, 400)
    narrow = best.theta + (theta - best.theta) / 3.0
    exact = np.array([log_density(t, data, Priors(), gradient=False).value for t in theta.reshape(-1, 5)])
    judged = reweight(narrow, exact.reshape(theta.shape[:2]), data, Priors(), lambda _: None)
    assert judged.k_hat > judged.k_limit
    assert judged.status is SampleStatus.pareto_k
    assert "Refused" in judged.status.value


def test_a_stand_in_that_cannot_learn_is_refused(case, monkeypatch):
    """The emulator replaced by one that is wrong about the noise: every round fails, none is used silently."""
    data, best, _ = case
    honest = course.fit_emulator

    def crooked(points, level):
        bent = [p.stats._replace(logdet=p.stats.logdet + 60.0 * p.u[-1]) for p in points]
        return honest([p._replace(stats=s) for p, s in zip(points, bent, strict=True)], level)

    monkeypatch.setattr(course, "fit_emulator", crooked)
    sampled = sample_posterior(
        best, data, Priors(), budget=Budget(exact=80, rounds=2, extensions=1, nuts=LENGTH), seed=0
    )
    assert sampled.status is not SampleStatus.accepted
    assert "Refused" in sampled.status.value


@pytest.mark.parametrize("seed", range(3))
def test_pareto_smoothing_weighs_one_gaussian_into_another(seed):
    """E and Var of N(0.3, 1) from draws of N(0, 1.2): the sign convention of ArviZ's psislw is in this."""
    x = 1.2 * np.random.default_rng(seed).normal(size=4000)
    log_weight, k_hat = pareto_smooth(-0.5 * (x - 0.3) ** 2 + 0.5 * (x / 1.2) ** 2)
    w = np.exp(log_weight)
    assert k_hat < 0.5
    assert w @ x == pytest.approx(0.3, abs=0.1)
    assert w @ (x - w @ x) ** 2 == pytest.approx(1.0, abs=0.12)
