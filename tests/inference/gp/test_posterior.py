"""Full Bayes of a Gaussian process: the optimum, the stand-in, and NUTS on the exact density."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arviz_stats.base import array_stats
from jax.scipy.stats import multivariate_normal
from numpyro.infer import MCMC, NUTS

from bayes_aero.inference.gp import posterior
from bayes_aero.inference.gp.kernel import (
    ExactPoint,
    HyperPrior,
    Priors,
    ReducedData,
    fit_emulator,
    noise_to_signal,
    outputs,
    stats_and_gradient,
)
from bayes_aero.inference.gp.optimum import MapStatus, assemble, find_map, maximise
from bayes_aero.inference.gp.posterior import (
    K_LIMIT,
    Budget,
    SampleStatus,
    Settings,
    laplace_root,
    log_density,
    pareto_smooth,
    reweight,
    sample_posterior,
    thin,
)
from bayes_aero.processes import give_back_memory

# Full Bayes through the stand-in equals NUTS on the exact density, and a wrong stand-in is refused
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


def test_it_is_accepted_with_its_error_measured_and_the_same_again(case):
    data, _, sampled = case
    weighted = sampled.weighted
    assert sampled.status is SampleStatus.accepted
    assert weighted.k_hat < K_LIMIT <= 0.7
    assert weighted.ess > 0.8 * weighted.exact.size
    assert np.sum(np.exp(weighted.log_weight)) == pytest.approx(1.0)
    assert np.max(sampled.chains.rhat) < 1.01
    at = weighted.theta[1, 5]
    assert weighted.exact[1, 5] == pytest.approx(log_density(at, data, Priors()).value, abs=1e-9)
    data, best, sampled = case
    again = sample_posterior(best, data, Priors(), budget=BUDGET, seed=2)
    np.testing.assert_array_equal(again.weighted.theta, sampled.weighted.theta)
    assert again.weighted.k_hat == sampled.weighted.k_hat


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


def test_a_stand_in_that_is_too_narrow_or_cannot_learn_is_refused(case, monkeypatch):
    """Draws squeezed to a third around the optimum, with the density they then have."""
    data, best, sampled = case
    theta, _ = thin(sampled.chains, 400)
    narrow = best.theta + (theta - best.theta) / 3.0
    exact = np.array([log_density(t, data, Priors(), gradient=False).value for t in theta.reshape(-1, 5)])
    judged = reweight(narrow, exact.reshape(theta.shape[:2]), data, Priors(), lambda _: None)
    assert judged.k_hat > K_LIMIT
    assert judged.status is SampleStatus.pareto_k
    assert "Refused" in judged.status.value
    # The emulator replaced by one that is wrong about the noise: every round fails, none is used silently.
    data, best, _ = case
    honest = posterior.fit_emulator

    def crooked(points, level):
        bent = [p.stats._replace(logdet=p.stats.logdet + 60.0 * p.u[-1]) for p in points]
        return honest([p._replace(stats=s) for p, s in zip(points, bent, strict=True)], level)

    monkeypatch.setattr(posterior, "fit_emulator", crooked)
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


# The search finds the optimum it should, from bad starts too, and says how it ended
def test_theta_and_derivatives_of_the_outputs_are_what_they_stand_for(problem):
    _, theta = problem(0, d=4)
    np.testing.assert_allclose(assemble(theta[:6], noise_to_signal(theta)), theta, atol=1e-14)
    data, theta = problem(8, n=50, d=2)
    u = noise_to_signal(theta)

    def at(v):
        return outputs(ExactPoint(v, *stats_and_gradient(v, data)))

    numeric = [(at(u + s)[0] - at(u - s)[0]) / 2e-5 for s in 1e-5 * np.eye(u.size)]
    np.testing.assert_allclose(at(u)[1], numeric, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("seed", range(2))
def test_the_full_gradient_vanishes_at_the_optimum(problem, seed):
    data, theta = problem(seed, n=150, d=2)
    best = maximise(noise_to_signal(theta), data, Priors())
    assert best.status is MapStatus.converged
    out = log_density(best.theta, data, Priors())
    assert out.value == pytest.approx(best.value, abs=1e-9)
    assert np.max(np.abs(out.gradient)) < 0.02
    assert best.value > log_density(theta, data, Priors()).value


def test_searches_from_several_starts_end_at_the_better_optimum_or_at_a_bound():
    """Two explanations of one record: a slow trend with much noise, or a fast wave with little."""
    rng = np.random.default_rng(2)
    x = np.sort(rng.uniform(-1.7, 1.7, 60))[:, None]
    y = 0.6 * np.sin(14.0 * x[:, 0]) + 0.8 * x[:, 0] + 0.1 * rng.normal(size=60)
    data = ReducedData.of(x, y)
    slow = maximise(np.array([2.0, 2.0]), data, Priors())
    found = find_map(data, Priors(), starts=12, seed=1)
    assert found[0].value > slow.value + 10  # a single start from the slow side is poor
    assert np.exp(found[0].u[0]) < 0.5 < np.exp(slow.u[0])
    assert [o.value for o in found] == sorted((o.value for o in found), reverse=True)
    rng = np.random.default_rng(5)
    x = rng.normal(size=(80, 2))
    data = ReducedData.of(x, np.sin(2 * x[:, 0]) + 0.1 * rng.normal(size=80))
    best = find_map(data, Priors.flat(), starts=4, seed=0)[0]
    assert best.status is MapStatus.at_bound
    assert find_map(data, Priors(), starts=4, seed=0)[0].status is MapStatus.converged


def test_a_covariance_that_cannot_be_factorised_is_a_status(monkeypatch):
    x = np.repeat(np.linspace(-1, 1, 30), 2)[:, None]
    data = ReducedData.of(x, np.sin(x[:, 0]))
    monkeypatch.setattr("bayes_aero.inference.gp.optimum.NOISE_BOUNDS", (-60.0, -50.0))
    best = maximise(np.array([1.0, -55.0]), data, Priors(noise=HyperPrior("flat")))
    assert best.status is MapStatus.not_positive_definite


@pytest.mark.recovery
def test_hyperparameters_drawn_from_the_prior_are_recovered(problem):
    """log l and log sn of many kernels come back without bias, with a spread that the size of the data allows."""
    errors = []
    for seed in range(12):
        data, theta = problem(100 + seed, n=250, d=2)
        errors.append(find_map(data, Priors(), starts=4, polish=1, seed=seed)[0].theta - theta)
    errors = np.array(errors)
    lengths, noise = errors[:, 4:6], errors[:, -1]
    assert abs(np.mean(noise)) < 0.05
    assert np.std(noise) < 0.12
    assert abs(np.mean(lengths)) < 0.3
    assert np.median(np.abs(lengths)) < 0.4


# The stand-in reproduces its data, its derivatives and a held-back point, and stays put outside
@pytest.fixture
def trained(problem):
    data, theta = problem(7, n=80, d=2)
    centre = noise_to_signal(theta)
    rng = np.random.default_rng(0)
    points = []
    for _ in range(60):
        u = centre + 0.15 * rng.normal(size=centre.size)
        points.append(ExactPoint(u, *stats_and_gradient(u, data)))
    return points, fit_emulator(points[:40], np.zeros(40))


def test_what_the_emulator_was_trained_with_is_predicted_again(trained):
    points, emulator = trained
    for p in points[40:]:
        logdet, gram, _ = emulator(jnp.asarray(p.u))
        assert float(logdet) == pytest.approx(p.stats.logdet, abs=0.02)
        np.testing.assert_allclose(gram, p.stats.gram, rtol=1e-2, atol=1e-2 * np.max(p.stats.gram))
    far = jnp.asarray(points[0].u + 5.0)
    farther = emulator.centre + 3.0 * (far - emulator.centre)
    (a, _, near_penalty), (b, _, far_penalty) = emulator(far), emulator(farther)
    assert float(a) == pytest.approx(float(b), abs=1.0)
    assert float(far_penalty) < float(near_penalty) < -10
    assert np.all(np.isfinite(jax.grad(lambda u: emulator(u)[2])(far)))
    assert float(emulator(emulator.centre)[2]) == 0.0
    points, _ = trained
    few = fit_emulator(points[:8], np.zeros(8))  # 32 rows: quadratic in three variables has 10 terms, cubic 20
    corner = np.asarray(few.coefficients)[:4, :4]
    assert np.count_nonzero(few.coefficients) <= 10 * few.coefficients.shape[-1]
    assert np.all(np.isfinite(corner))
    points, emulator = trained
    junk = [p._replace(u=p.u + 3.0) for p in points[40:50]]
    again = fit_emulator([*points[:40], *junk], np.append(np.zeros(40), np.full(10, -1e4)))
    at = jnp.asarray(points[55].u)
    assert float(again(at)[0]) == pytest.approx(float(emulator(at)[0]), abs=0.05)
    assert float(again(jnp.asarray(junk[0].u))[2]) < -10
    points, _ = trained
    mixed = [*points[:20], *(p._replace(gradient=None) for p in points[20:50])]
    emulator = fit_emulator(mixed, np.zeros(50))
    for p in points[50:]:
        assert float(emulator(jnp.asarray(p.u))[0]) == pytest.approx(p.stats.logdet, abs=0.05)
