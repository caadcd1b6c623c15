"""Gaussian processes: density, priors, optimum, full Bayes of hyperparameters, `fit_gp`; processes that train."""

import subprocess
import sys
from dataclasses import replace

import arviz_stats
import jax
import jax.numpy as jnp
import numpy as np
import psutil
import pytest
import xarray as xr
from arviz_stats.base import array_stats
from numpyro.infer import MCMC, NUTS
from scipy.integrate import quad
from scipy.optimize import minimize
from scipy.stats import multivariate_normal

from bayes_aero import processes
from bayes_aero.errors import InputError
from bayes_aero.inference import gp
from bayes_aero.inference import gp_kernel as kernel

HOUSE = kernel.Priors()


def covariance(theta, x):
    """Of measurements at `x` (n, d), from the scaled logarithms of the hyperparameters; as a textbook writes it."""
    d, e = x.shape[1], jnp.exp(jnp.asarray(theta))
    distance = (((x[:, None] - x) / e[d + 2 : 2 * d + 2]) ** 2).sum(axis=-1)
    k = e[0] ** 2 + (x * e[1 : d + 1] ** 2) @ x.T + e[d + 1] ** 2 * jnp.exp(-0.5 * distance)
    return k + e[-1] ** 2 * jnp.eye(len(x))


def log_posterior(theta, data, priors):
    """log q(theta) + log p(y | theta) at all points; and the exact statistics."""
    point = kernel.exact_point(kernel.noise_to_signal(theta), data, slopes=False)
    return kernel.density_at(theta, point, data.n, priors), point


def problem(seed, n=60, d=3):
    """A small problem drawn from the kernel itself: (data, theta)."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform(-0.7, 0.7, size=2 * d + 3)
    theta[-1] -= 1.5
    x = rng.normal(size=(n, d))
    return kernel.ReducedData.of(x, np.linalg.cholesky(covariance(theta, x)) @ rng.normal(size=n)), theta


# The marginal likelihood against its textbook form, closed forms, finite differences and scikit-learn
@pytest.mark.parametrize(("seed", "d"), [(0, 1), (2, 4)])
def test_value_is_the_gaussian_density_of_the_full_covariance(seed, d):
    data, theta = problem(seed, n=40, d=d)
    exact = multivariate_normal(np.zeros(data.n), covariance(theta, data.x)).logpdf(data.fy[:, -1])
    assert log_posterior(theta, data, HOUSE)[0] - HOUSE.slopes(theta)[0] == pytest.approx(exact, rel=1e-10)


def test_a_covariance_that_cannot_be_factorised_is_a_status(monkeypatch):
    """Every sample twice, and no noise to tell them apart."""
    x = np.repeat(np.linspace(-1, 1, 30), 2)[:, None]
    data = kernel.ReducedData.of(x, np.sin(x[:, 0]))
    value, point = log_posterior(np.array([0.0, 0.0, 0.0, 3.0, -25.0]), data, WIDE)
    assert not point.ok
    assert np.isnan(value)
    monkeypatch.setattr("bayes_aero.inference.gp_kernel.NOISE_BOUNDS", (-60.0, -50.0))
    best = kernel.maximise(np.array([1.0, -55.0]), data, WIDE)
    assert best.status is kernel.MapStatus.not_positive_definite


# Hyperparameter priors are densities of the logarithm
WIDE = kernel.Priors(*5 * [kernel.HyperPrior("log-normal", 1.0, 1e3)])  # flat in effect
PROPER = [kernel.HyperPrior(*of) for of in (("half-normal", 0.7), ("log-normal", 0.3, 0.8), ("frechet", 2.0, 5.0))]


@pytest.mark.parametrize("prior", PROPER, ids=lambda p: p.family)
def test_priors_integrate_to_one_and_draws_follow_them(prior):
    density = jax.jit(lambda t: jnp.exp(prior.slopes(t)[0]))
    mass, _ = quad(lambda t: float(density(t)), -15, 8, limit=200)
    assert mass == pytest.approx(1.0, abs=1e-6)
    t = prior.sample(np.random.default_rng(4), (4000,))
    mean, _ = quad(lambda t: t * float(density(t)), -15, 8, limit=200)
    assert t.mean() == pytest.approx(mean, abs=5 * t.std() / np.sqrt(t.size))
    if prior.family == "frechet":  # its scale, 2, is the quantile 1/e: what is shorter is charged for
        assert np.mean(np.exp(t) < 2.0) == pytest.approx(np.exp(-1.0), abs=0.03)


def test_priors_are_laid_out_as_theta():
    priors, d = HOUSE, 3
    theta = jnp.linspace(-1, 1, 2 * d + 3)
    each = [p for p, count in zip(priors.each, (1, d, 1, d, 1), strict=True) for _ in range(count)]
    parts = [float(p.slopes(t)[0]) for p, t in zip(each, theta, strict=True)]
    assert float(priors.slopes(theta)[0]) == pytest.approx(sum(parts))
    assert priors.sample(np.random.default_rng(0), d, 7).shape == (7, 2 * d + 3)


# Newton's method for the sizes: its derivatives against automatic ones, its optimum against SciPy's
PRIORS = {"house": HOUSE, "quasi-steady": kernel.Priors.quasi_steady(), "wide": WIDE}


def statistics_of(seed, d):
    """Exact statistics of d inputs, an output with a linear and a curved part, at random length scales."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((80, d))
    y = np.sin(2.0 * x[:, 0]) + x @ rng.uniform(0.0, 0.3, d) + rng.normal(0.0, 0.2, 80)
    u = np.append(rng.uniform(-0.5, 2.0, d), rng.uniform(-4.0, 0.0))
    return kernel.exact_point(u, kernel.ReducedData.of(x, y / np.sqrt(np.mean(y**2))), slopes=False)


@pytest.mark.parametrize("priors", PRIORS.values(), ids=PRIORS)
def test_derivatives_of_the_density_are_those_of_differences(priors):
    """By the sizes at known statistics; by length scales and noise at the best sizes."""
    rng = np.random.default_rng(4132)
    point, w = statistics_of(rng.integers(2**31), 3), rng.uniform(-1.5, 1.0, 5)
    data, theta = problem(0, n=100, d=2)
    profile, u = kernel.ProfilePosterior(data, priors), kernel.noise_to_signal(theta)

    def slope(value, x):
        return [(value(x + h) - value(x - h)) / 2e-5 for h in 1e-5 * np.eye(x.size)]

    at = kernel.slopes(w, point, 80, priors)
    assert at.value == pytest.approx(kernel.density_at(kernel.assemble(w, point.u), point, 80, priors), rel=1e-11)
    by_w = slope(lambda w: kernel.slopes(w, point, 80, priors).value, w)
    np.testing.assert_allclose(at.by_w, by_w, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(profile(u)[1], slope(lambda u: profile(u)[0], u), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("priors", PRIORS.values(), ids=PRIORS)
def test_the_optimum_is_at_least_as_good_as_that_of_scipy(priors):
    rng = np.random.default_rng(4132)
    for _ in range(5):
        d = int(rng.integers(1, 6))
        point = statistics_of(rng.integers(2**31), d)
        start = rng.uniform(-3.0, 2.0, d + 2)
        w, found = kernel.best_sizes(start, point, 80, priors)
        assert np.all((w >= kernel.SD_BOUNDS[0]) & (w <= kernel.SD_BOUNDS[1]))

        def negative(w, point=point):
            at = kernel.slopes(w, point, 80, priors)
            return -at.value, -at.by_w

        theirs = minimize(negative, w, jac=True, method="L-BFGS-B", bounds=[kernel.SD_BOUNDS] * w.size)
        assert found.value >= -theirs.fun - 1e-7 * abs(theirs.fun)  # nothing higher close by
        inside = (w > kernel.SD_BOUNDS[0] + 1e-6) & (w < kernel.SD_BOUNDS[1] - 1e-6)
        assert np.max(np.abs(found.by_w[inside]), initial=0.0) < 1e-4 * max(1.0, 1e-3 * abs(found.value))


# Full Bayes by weighed draws equals NUTS on the exact density, and a wrong proposal is refused
FOUR = gp.Budget(starts=4)


@pytest.fixture(scope="module")
def case():
    """A non-linear function of one input with a linear trend, 40 points: data, optimum, posterior."""
    rng = np.random.default_rng(21)
    x = rng.uniform(-1.7, 1.7, size=(40, 1))
    y = 0.5 + 0.4 * x[:, 0] + 0.5 * np.sin(4 * x[:, 0]) + 0.1 * rng.normal(size=40)
    data = kernel.ReducedData.of(x, y)
    best = kernel.find_map(data, HOUSE, starts=4, polish=1)[0]
    return data, best, gp.sample_posterior(best, data, HOUSE, budget=gp.Budget(draws=600, seed=2))


def test_it_is_accepted_with_its_error_measured_and_the_same_again(case):
    data, best, sampled = case
    assert sampled.status is gp.SampleStatus.accepted
    assert sampled.k_hat < gp.K_LIMIT <= 0.7
    assert sampled.ess > 0.5 * sampled.exact.size
    assert np.sum(np.exp(sampled.log_weight)) == pytest.approx(1.0)
    for theta, exact in zip(sampled.theta[:5], sampled.exact[:5], strict=True):
        assert exact == pytest.approx(log_posterior(theta, data, HOUSE)[0], abs=1e-9)
    once, again = (
        gp.sample_posterior(best, data, HOUSE, budget=gp.Budget(draws=40, rounds=1, seed=2)) for _ in range(2)
    )
    np.testing.assert_array_equal(again.theta, once.theta)
    assert again.k_hat == once.k_hat


def test_re_weighted_draws_are_those_of_nuts_on_the_exact_density(case):
    data, best, sampled = case
    weight = np.exp(sampled.log_weight)
    mean = weight @ sampled.theta
    sd = np.sqrt(weight @ (sampled.theta - mean) ** 2)
    exact = _nuts_on_the_exact_density(best.theta, np.diag(sd), data)
    draws = np.asarray(best.theta + exact.get_samples(group_by_chain=True) * sd)
    theirs = draws.reshape(-1, best.theta.size)
    theirs_ess = np.array([array_stats.ess(c) for c in np.moveaxis(draws, -1, 0)])
    error = np.sqrt(theirs.var(axis=0) * (1 / np.minimum(theirs_ess, len(theirs)) + 1 / sampled.ess))
    assert np.all(np.abs(mean - theirs.mean(axis=0)) < 4.5 * error)
    np.testing.assert_allclose(sd, theirs.std(axis=0), rtol=0.25)
    log_density_there = -np.asarray(exact.get_extra_fields()["potential_energy"])
    assert log_density_there.mean() == pytest.approx(weight @ sampled.exact, abs=0.6)


def _nuts_on_the_exact_density(theta, root, data):
    """NumPyro's own driver on the textbook density, n^3 at every leapfrog step."""
    x, y = jnp.asarray(data.x), jnp.asarray(data.fy[:, -1])

    def potential(w):
        at = jnp.asarray(theta) + jnp.asarray(root) @ w
        exact = jax.scipy.stats.multivariate_normal.logpdf(y, jnp.zeros(len(y)), covariance(at, x))
        return -exact - HOUSE.slopes(at)[0]

    driver = MCMC(
        NUTS(potential_fn=potential, target_accept_prob=0.85, max_tree_depth=5, dense_mass=True),
        num_warmup=200, num_samples=400, num_chains=4, chain_method="vectorized", progress_bar=False,
    )  # fmt: skip
    starts = jax.random.normal(jax.random.PRNGKey(8), (4, len(theta)))
    driver.run(jax.random.PRNGKey(9), init_params=starts, extra_fields=("potential_energy",))
    return driver


def test_a_proposal_that_sits_beside_the_posterior_is_refused_or_moved_there(case):
    """A log unit from the optimum, one round: refused; more rounds find the way."""
    data, best, sampled = case
    beside = best._replace(theta=best.theta + np.array([0.0, 0.0, 0.0, 1.2, 0.6]))
    once = gp.sample_posterior(beside, data, HOUSE, budget=gp.Budget(draws=96, rounds=1, seed=1))
    assert once.status is gp.SampleStatus.uneven_weights
    assert "Refused" in once.status.value
    often = gp.sample_posterior(beside, data, HOUSE, budget=gp.Budget(draws=96, rounds=20, seed=1))
    assert often.status is gp.SampleStatus.accepted
    ours, theirs = (np.exp(s.log_weight) @ s.theta for s in (often, sampled))
    np.testing.assert_allclose(ours, theirs, atol=0.3)


def test_pareto_smoothing_weighs_one_gaussian_into_another():
    """E and Var of N(0.3, 1) from draws of N(0, 1.2): the sign convention of ArviZ's psislw is in this."""
    x = 1.2 * np.random.default_rng(0).normal(size=4000)
    log_weight, k_hat = gp.pareto_smooth(-0.5 * (x - 0.3) ** 2 + 0.5 * (x / 1.2) ** 2)
    w = np.exp(log_weight)
    assert k_hat < 0.5
    assert w @ x == pytest.approx(0.3, abs=0.1)
    assert w @ (x - w @ x) ** 2 == pytest.approx(1.0, abs=0.12)


# The search finds the optimum it should, from bad starts too, and says how it ended
def test_the_full_gradient_vanishes_at_the_optimum():
    data, theta = problem(0, n=100, d=2)
    best = kernel.maximise(kernel.noise_to_signal(theta), data, HOUSE)
    assert best.status is kernel.MapStatus.converged
    assert log_posterior(best.theta, data, HOUSE)[0] == pytest.approx(best.value, abs=1e-9)
    assert best.value > log_posterior(theta, data, HOUSE)[0]
    step = 1e-5 * np.eye(theta.size)
    ends = [[log_posterior(best.theta + sign * s, data, HOUSE)[0] for sign in (1.0, -1.0)] for s in step]
    assert np.max(np.abs(np.subtract(*np.transpose(ends)))) / 2e-5 < 0.02


def test_searches_from_several_starts_end_at_the_better_optimum_or_at_a_bound():
    """Two explanations of one record: a slow trend with much noise, or a fast wave with little."""
    rng = np.random.default_rng(2)
    x = np.sort(rng.uniform(-1.7, 1.7, 60))[:, None]
    y = 0.6 * np.sin(14.0 * x[:, 0]) + 0.8 * x[:, 0] + 0.1 * rng.normal(size=60)
    data = kernel.ReducedData.of(x, y)
    slow = kernel.maximise(np.array([2.0, 2.0]), data, HOUSE)
    found = kernel.find_map(data, HOUSE, starts=12, seed=1)
    assert found[0].value > slow.value + 10  # a single start from the slow side is poor
    assert np.exp(found[0].u[0]) < 0.5 < np.exp(slow.u[0])
    assert [o.value for o in found] == sorted((o.value for o in found), reverse=True)
    rng = np.random.default_rng(5)
    x = rng.normal(size=(80, 2))
    data = kernel.ReducedData.of(x, np.sin(2 * x[:, 0]) + 0.1 * rng.normal(size=80))
    beyond = kernel.Priors(linear=kernel.HyperPrior("log-normal", 1e-8))  # below the least size that is searched
    best = kernel.find_map(data, beyond, starts=4, seed=0)[0]
    assert best.status is kernel.MapStatus.at_bound
    assert kernel.find_map(data, HOUSE, starts=4, seed=0)[0].status is kernel.MapStatus.converged


# `fit_gp` from the outside: predictions, coverage, units, refusals, and a tree that ArviZ reads back
def make(seed, n=100):
    """Two inputs in units far apart, an output with an offset and noise of sd 0.1."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, 2)) * [0.05, 9.0] + [0.15, 84.0]
    z = (X - [0.15, 84.0]) / [0.05, 9.0]
    return X, 1.0 + 0.3 * z[:, 0] + 0.4 * np.sin(1.5 * z[:, 1]) + 0.1 * rng.normal(size=n)


@pytest.fixture(scope="module")
def sampled():
    X, y = make(0)
    return gp.fit_gp(X[:, 1:], y - 6 * X[:, 0], names=("V", "CL"), budget=gp.Budget(draws=96, starts=4, seed=4))


@pytest.fixture(scope="module")
def at_map():
    return gp.fit_gp(*make(0), names=("alpha", "V", "y"), budget=FOUR, sample=False)


def test_predictions_cover_what_they_say_with_the_uncertainty_of_hyperparameters(sampled):
    X, y = make(1, n=1500)
    y = y - 6 * X[:, 0]
    p = sampled.predict(X[:, 1:])
    coverage = p.coverage(y)
    assert list(coverage) == [0.5, 0.9, 0.95]
    for level, share in coverage.items():
        assert share == pytest.approx(level, abs=0.1 if level == 0.5 else 0.05)
    assert np.sqrt(np.mean((p.mean - y) ** 2)) < 0.13
    new, at = np.linspace(60.0, 110.0, 50)[:, None], np.linspace(0, len(sampled.draws) - 1, 24).round().astype(int)
    each = [replace(sampled, draws=draw[None]).predict(new).mean for draw in sampled.draws[at]]
    np.testing.assert_allclose(sampled.predict(new).mean, np.mean(each, axis=0))
    assert np.std(each, axis=0).min() > 0.0


def test_map_prediction_is_the_textbook_conditional(at_map):
    X, y = make(0)
    new, _ = make(3, n=5)
    hyper = at_map.map
    names = ("constant", "linear", "signal", "length_scale", "noise")
    theta = np.log(np.concatenate([np.atleast_1d(hyper[name]) for name in names]))
    k = np.asarray(covariance(theta, np.concatenate([X, new]) - at_map.scaling.mean))
    cross = k[:100, 100:]
    p = at_map.predict(new)
    np.testing.assert_allclose(p.mean, cross.T @ np.linalg.solve(k[:100, :100], y), rtol=1e-8)
    variance = np.diag(k[100:, 100:] - cross.T @ np.linalg.solve(k[:100, :100], cross))
    np.testing.assert_allclose(p.sd**2, variance, rtol=1e-8)
    np.testing.assert_allclose(p.high[2] - p.low[2], 2 * 1.959964 * p.sd, rtol=1e-6)


def test_mixture_quantiles_are_those_of_its_draws():
    rng = np.random.default_rng(0)
    means, latent = rng.normal(size=(6, 3)), rng.uniform(0.1, 1.0, size=(6, 3))
    noise = rng.uniform(0.1, 0.5, size=6)
    p = gp.Prediction.of_mixture(means, latent, noise)
    which = rng.integers(6, size=200_000)
    draws = means[which] + np.sqrt(latent + noise[:, None])[which] * rng.normal(size=(200_000, 3))
    np.testing.assert_allclose(p.mean, draws.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(p.sd, draws.std(axis=0), atol=0.02)
    np.testing.assert_allclose(p.low[1], np.quantile(draws, 0.05, axis=0), atol=0.03)
    np.testing.assert_allclose(p.high[2], np.quantile(draws, 0.975, axis=0), atol=0.03)


def test_units_of_inputs_and_output_do_not_matter_and_without_sampling_it_says_so(at_map):
    assert at_map.status is gp.SampleStatus.not_sampled
    assert at_map.posterior is None
    assert np.isnan(at_map.k_hat)
    X, y = make(0)
    other = gp.fit_gp(jnp.asarray(X * [57.3, 3.6] + [1.0, 0.0]), jnp.asarray(100.0 * y), budget=FOUR, sample=False)
    new, _ = make(6, n=20)
    there, here = other.predict(new * [57.3, 3.6] + [1.0, 0.0]), at_map.predict(new)
    np.testing.assert_allclose(there.mean, 100.0 * here.mean, rtol=1e-4)
    np.testing.assert_allclose(other.map["length_scale"], at_map.map["length_scale"] * [57.3, 3.6], rtol=1e-2)
    np.testing.assert_allclose(other.map["linear"], 100 * at_map.map["linear"] / [57.3, 3.6], rtol=1e-2)
    assert other.optima[0].value == pytest.approx(at_map.optima[0].value, abs=1e-3)


def test_the_tree_is_complete_and_arviz_reads_it_back(sampled, tmp_path):
    tree = sampled.posterior
    assert sampled.status is gp.SampleStatus.accepted
    assert {"posterior", "prior", "sample_stats", "proposal"} <= set(tree.children)
    assert list(tree["posterior"]["length_scale"].coords["input"].values) == ["V"]
    assert tree.attrs["k_hat"] == sampled.k_hat < tree.attrs["k_limit"]
    weights = np.exp(tree["proposal"]["log_weight"])
    assert float(weights.sum()) == pytest.approx(1.0)
    tree.to_netcdf(tmp_path / "gpr.nc", engine="h5netcdf")
    back = xr.open_datatree(tmp_path / "gpr.nc", engine="h5netcdf")
    np.testing.assert_array_equal(back["posterior"]["noise"], tree["posterior"]["noise"])
    table = arviz_stats.summary(back, var_names=["noise", "length_scale"])
    assert {"noise", "length_scale[V]"} == set(table.index)
    back.close()


@pytest.mark.parametrize(("change", "says"), [
    (lambda X, y: (X[:6], y[:6]), "6 samples cannot"),
    (lambda X, y: (np.tile(X, (81, 1)), np.tile(y, 81)), r"n = 8100 .*bound of 8000.*--resample"),
    (lambda X, y: (X * [0.0, 1.0], y), "x0 does not vary"),
], ids=["few", "many", "constant"])  # fmt: skip
def test_what_cannot_be_fitted_is_refused_in_words(change, says):
    with pytest.raises(InputError, match=says):
        gp.fit_gp(*change(*make(0)), sample=False)


def test_dependent_inputs_are_sampled_as_their_priors_divide_them():
    """What the record cannot tell apart, the priors do: draws of the exact posterior, as of independent inputs."""
    X, y = make(0, n=60)
    X, y = np.column_stack([X[:, 1], X[:, 1]]), y - 6 * X[:, 0]
    fit = gp.fit_gp(X, y, budget=gp.Budget(draws=96, starts=3, seed=1))
    assert fit.status is gp.SampleStatus.accepted
    assert np.isfinite(fit.predict(X).mean).all()


def test_an_output_without_noise_has_a_mode_and_a_status_in_place_of_draws():
    X, _ = make(0, n=60)
    fit = gp.fit_gp(X, 2.0 + X @ [1.0, 2.0], budget=gp.Budget(draws=48, rounds=2, starts=3, seed=1))
    assert fit.status is gp.SampleStatus.uneven_weights
    assert fit.posterior is None
    assert np.isfinite(fit.predict(X).mean).all()


# Processes that train for a parent that was killed do not outlive it
PARENT = """
import os, time
from joblib import Parallel, delayed, parallel_config
from bayes_aero.processes import exit_with

def work(parent):
    exit_with(parent)
    print(os.getpid(), flush=True)
    time.sleep(600.0)

with parallel_config(backend="loky"):
    Parallel(n_jobs=2)(delayed(work)(os.getpid()) for _ in range(2))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="a process has no new parent there")
def test_processes_end_with_a_parent_that_is_killed():
    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        children = [psutil.Process(int(parent.stdout.readline())) for _ in range(2)]
        assert all(child.ppid() == parent.pid for child in children)
        parent.kill()
    _, alive = psutil.wait_procs(children, timeout=20.0)
    assert [child for child in alive if child.status() != psutil.STATUS_ZOMBIE] == []


# Compiled programs take memory mappings, of which Linux allows a process so many
LINUX_ONLY = pytest.mark.skipif(sys.platform != "linux", reason="another system has no such limit")


def mappings():
    return len(processes.MAPPINGS.read_text().splitlines())


@pytest.mark.forgets
@LINUX_ONLY
def test_programs_take_mappings_and_give_them_back():
    processes.give_back_memory()
    before = mappings()
    for k in range(12):
        jax.jit(lambda x, k=k: jax.lax.scan(lambda c, y: (c + k * jnp.sin(y), c), 0.0, x)[0])(jnp.ones(3 + k))
    taken = mappings() - before
    assert taken >= 12
    processes.give_back_memory()
    assert mappings() - before < 0.5 * taken


@pytest.mark.forgets
@LINUX_ONLY
def test_a_process_is_full_near_the_limit_of_the_system(tmp_path, monkeypatch):
    limit = tmp_path / "max_map_count"
    monkeypatch.setattr(processes, "LIMIT", limit)
    assert not processes.full_of_programs()  # no such limit
    for allowed, full in ((2 * mappings(), False), (mappings(), True)):
        limit.write_text(f"{allowed}\n")
        assert processes.full_of_programs() is full
