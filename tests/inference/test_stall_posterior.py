"""The posterior: closed form, agreement of engines, white noise against bounds, coloured noise."""

from dataclasses import replace
from functools import partial

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.inference.posterior.ensemble import EnsembleLength, sample_ensemble
from bayes_aero.inference.posterior.laplace import ModeStatus, density_start, find_mode
from bayes_aero.inference.posterior.nuts import NutsLength, WarmUp, sample_nuts
from bayes_aero.inference.posterior.posterior import PosteriorStatus
from bayes_aero.model.density import Density
from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour, Noise
from bayes_aero.model.observations import observe
from bayes_aero.parameter import Prior
from bayes_aero.simulate.demo import TRUTH, simulate_stall

SIGMA = np.array([0.02, 0.005, 0.004])
COLOURED = {
    "sigma_CL": 0.02, "sigma_CD": 0.005, "sigma_Cm": 0.004, "rho_CL": 0.95, "rho_CD": 0.95, "rho_Cm": 0.95,
}  # fmt: skip


@pytest.fixture(scope="module")
def linear(thinned):
    """A model linear in its parameters, priors as narrow as the data are informative, and its closed form."""
    model = Model.of(["attached_lift", "pitching_moment", "profile_drag"])
    rng = np.random.default_rng(11)
    alpha = np.asarray(thinned.signals["alpha"])
    n, names = len(alpha), model.names
    truth = np.array([TRUTH[name] for name in names])
    one, zero = np.ones(n), np.zeros(n)
    columns = {
        "CL0": (one, zero, zero), "CLa": (alpha, zero, zero), "CD0": (zero, one, zero),
        "Cm0": (zero, zero, one), "Cma": (zero, zero, alpha),
    }  # fmt: skip
    S = np.stack([np.stack(columns[name], axis=-1) for name in names], axis=-1)
    z = S @ truth + SIGMA * rng.standard_normal((n, 3))
    information = np.einsum("nci,c,ncj->ij", S, SIGMA**-2, S)
    prior_sd = 1.0 / np.sqrt(np.diag(information))
    prior_mean = truth + prior_sd * rng.standard_normal(len(truth))
    model = replace(
        model,
        parameters=tuple(
            p.changed(prior=Prior("normal", m, s))
            for p, m, s in zip(model.parameters, prior_mean, prior_sd, strict=True)
        ),
    )
    covariance = np.linalg.inv(information + np.diag(prior_sd**-2))
    mean = covariance @ (np.einsum("nci,c,nc->i", S, SIGMA**-2, z) + prior_mean / prior_sd**2)
    return model, thinned.with_measured(jnp.asarray(z)), mean, covariance


MANY = partial(sample_ensemble, length=EnsembleLength(ensembles=2, walkers=256))

STEP_ALONE = partial(sample_nuts, length=NutsLength(4, WarmUp(100, acceptance=0.8, metric=False)))


@pytest.mark.parametrize(
    "engine",
    [sample_ensemble, sample_nuts, MANY, STEP_ALONE],
    ids=["emcee", "nuts", "many walkers", "nuts, step size alone"],
)
def test_engines_give_the_closed_form(linear, engine):
    """The noise deviations are sampled too; at n = 1126 that widens the normal by less than 0.2 %."""
    model, data, mean, covariance = linear
    density = Density(data, model, Noise(Colour.WHITE))
    mode = find_mode(density, density_start(density, fit_mle(model, data, extra_starts=0)))
    assert mode.status is ModeStatus.CONVERGED
    posterior = engine(density, mode, seed=5, predictive=False)
    assert posterior.status is PosteriorStatus.CONVERGED
    sd = np.sqrt(np.diag(covariance))
    for i, name in enumerate(model.names):
        m = posterior.marginals[name]
        assert abs(m.mean - mean[i]) < 5.0 * sd[i] / np.sqrt(m.ess_bulk) + 0.02 * sd[i]
        assert m.sd == pytest.approx(sd[i], rel=0.12)
    draws = posterior.draws()[:, : len(mean)]
    np.testing.assert_allclose(np.corrcoef(draws.T), covariance / np.outer(sd, sd), atol=0.12)
    if engine is STEP_ALONE:
        assert float(posterior.tree["sample_stats"]["n_steps"].mean()) <= 7.0  # a normal posterior, whitened


def test_maximum_likelihood_is_least_squares_on_a_linear_model(linear):
    model, data, _, _ = linear
    r = fit_mle(model, data, extra_starts=0)
    alpha, z = np.asarray(data.signals["alpha"]), np.asarray(data.measured)
    A = np.stack([np.ones_like(alpha), alpha], axis=1)
    for column, names in ((0, ("CL0", "CLa")), (2, ("Cm0", "Cma"))):
        expected, rss, *_ = np.linalg.lstsq(A, z[:, column], rcond=None)
        bound = np.sqrt(np.diag(np.linalg.inv(A.T @ A)) * rss / len(z))
        at = [r.names.index(name) for name in names]
        np.testing.assert_allclose(r.estimate[at], expected, rtol=1e-8)
        np.testing.assert_allclose(r.crb[at], bound, rtol=1e-8)


def simulate(density, values, seed):
    x = jnp.asarray([values[name] for name in density.names])
    white = jnp.asarray(np.random.default_rng(seed).standard_normal((density.observations.n, 3)))
    return density.observations.with_measured(density.replicate(x, white))


def test_white_posterior_is_as_wide_as_the_bounds(clean, model):
    density = Density(clean, model, Noise(Colour.WHITE))
    data = simulate(density, TRUTH | {f"sigma_{k}": s for k, s in zip(("CL", "CD", "Cm"), SIGMA / 2, strict=True)}, 21)
    mle = fit_mle(model, data, extra_starts=0)
    density = Density(data, model, Noise(Colour.WHITE))
    posterior = sample_ensemble(density, find_mode(density, density_start(density, mle)), seed=1, predictive=False)
    assert posterior.status is PosteriorStatus.CONVERGED
    for name, crb in zip(mle.names, mle.crb, strict=True):
        assert posterior.marginals[name].sd == pytest.approx(crb, rel=0.10), name


def test_coloured_posterior_of_a_flight_finds_the_pitching_moment(model, card):
    """A flight with filtered Cm: the AR(1) posterior must not take the filter's smoothness for persistence.

    Tolerances are 5 % of the truth: feedback of disturbances through the pilot biases every method by about 2 %.
    """
    observations = observe([simulate_stall(0, seed=5), simulate_stall(1, seed=5)], card, model)
    density = Density.of(observations, model, Noise(Colour.AR1))
    mode = find_mode(density, density_start(density, fit_mle(model, observations, extra_starts=0)))
    found = dict(zip(density.names, np.asarray(density.constrain(jnp.asarray(mode.u))), strict=True))
    for name in ("Cm0", "Cma", "Cmq", "Cmde", "CmX"):
        assert found[name] == pytest.approx(TRUTH[name], rel=0.05), name


def test_a_flight_without_a_stall_has_a_mode(thinned, model):
    """Estimates of what it does not tell are hundreds of deviations off, where the density's slope is not finite."""
    gentle = thinned.subset(np.flatnonzero(np.asarray(thinned.signals["alpha"]) < 0.15)[:150])
    density = Density(gentle, model, Noise(Colour.AR1))
    data = simulate(density, TRUTH | COLOURED, 50)
    density, mle = Density(data, model, Noise(Colour.AR1)), fit_mle(model, data)
    wild = {"CDX": 445.0, "CmX": 814.0, "a1": 199.8, "tau2": -49.9, "alpha_star": 0.29}
    covariance = np.diag([np.inf if name in wild else x for name, x in zip(mle.names, mle.crb**2, strict=True)])
    estimate = [wild.get(name, value) for name, value in zip(mle.names, mle.estimate, strict=True)]
    start = density_start(density, replace(mle, estimate=np.array(estimate), covariance=covariance))
    begun = dict(zip(density.parameters, start, strict=True))
    assert all(begun[p] == pytest.approx(p.prior.normal[0]) for p in begun if p.name in wild)
    far = np.array([wild.get(name, value) for name, value in zip(density.names, start, strict=True)])
    mode, lost = (find_mode(density, x) for x in (start, far))
    assert mode.status is ModeStatus.CONVERGED
    assert lost.status is not ModeStatus.CONVERGED or lost.log_density == pytest.approx(mode.log_density, abs=1e-3)
    assert np.isfinite(lost.factor).all()


def test_thinning_stays_within_manoeuvres(clean):
    fewer = clean.thinned(5)
    kept = [5 * k for k in range(-(-clean.only(0).n // 5))]
    np.testing.assert_array_equal(fewer.time[fewer.manoeuvre == 0], clean.time[kept])
    assert fewer.dt == pytest.approx(5 * clean.dt)
    assert int(np.asarray(fewer.start).sum()) == len(clean.names)


@pytest.mark.parametrize("colour", list(Colour))
def test_density_is_that_of_the_multivariate_normal(thinned, model, colour):
    """Sum of the conditional densities against scipy's joint density of each manoeuvre and coefficient."""
    from scipy.stats import multivariate_normal

    short = thinned.subset(np.concatenate([np.arange(40), np.flatnonzero(thinned.manoeuvre == 1)[:30]]))
    density = Density(short, model, Noise(colour))
    rng = np.random.default_rng(8)
    values = TRUTH | COLOURED | {f"rho_{k}": rng.uniform(0.2, 0.9) for k in ("CL", "CD", "Cm")}
    values |= {f"buffet_{k}": rng.uniform(0.5, 3.0) for k in ("CL", "CD", "Cm")}
    x = jnp.asarray([values[name] for name in density.names])
    residual = np.asarray(short.measured - density.predict(x))
    X = np.asarray(model.flow(density.values(x), short.signals, short.aircraft)["X"])
    expected = 0.0
    for m in (0, 1):
        at = short.manoeuvre == m
        lag = np.abs(np.subtract.outer(np.arange(at.sum()), np.arange(at.sum())))
        for i, k in enumerate(("CL", "CD", "Cm")):
            noise_growth = 1 + values[f"buffet_{k}"] * (1 - X[at]) if colour is Colour.BUFFET_AR1 else np.ones(at.sum())
            rho = 0.0 if colour is Colour.WHITE else values[f"rho_{k}"]
            covariance = values[f"sigma_{k}"] ** 2 * rho**lag * np.outer(noise_growth, noise_growth)
            expected += multivariate_normal(cov=covariance).logpdf(residual[at, i])
    assert float(density.log_likelihood(x)) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("colour", list(Colour))
def test_simulated_noise_standardises_to_what_made_it(thinned, model, colour):
    density = Density(thinned, model, Noise(colour))
    values = TRUTH | COLOURED | {f"buffet_{k}": 1.5 for k in ("CL", "CD", "Cm")}
    x = jnp.asarray([values[name] for name in density.names])
    white = np.random.default_rng(3).standard_normal((thinned.n, 3))
    data = thinned.with_measured(density.replicate(x, jnp.asarray(white)))
    np.testing.assert_allclose(Density(data, model, Noise(colour)).standardised(x), white, atol=1e-9)


def test_unbounded_scale_is_a_bijection_with_the_stated_slope(thinned, model):
    import jax

    density = Density(thinned, model, Noise(Colour.BUFFET_AR1))
    rng = np.random.default_rng(4)
    x = jnp.asarray(density.sample_prior(rng, 1)[0])
    u = density.unconstrain(x)
    np.testing.assert_allclose(density.constrain(u), x, rtol=1e-9)
    slope = jnp.log(jnp.abs(jnp.diag(jax.jacfwd(density.constrain)(u))))
    expected = density.log_likelihood(x) + density.log_prior(x) + jnp.sum(slope)
    assert float(density(u)) == pytest.approx(float(expected), rel=1e-10)


def test_a_chain_too_short_is_not_called_converged(clean, model):
    density = Density(clean, model, Noise(Colour.WHITE))
    data = simulate(density, TRUTH | {f"sigma_{k}": 0.01 for k in ("CL", "CD", "Cm")}, 2)
    density = Density(data, model, Noise(Colour.WHITE))
    mode = find_mode(density, density_start(density, fit_mle(model, data, extra_starts=0)))
    wrong = replace(mode, u=mode.u + 30.0 * np.abs(np.diag(mode.factor)), factor=0.05 * mode.factor)
    posterior = sample_ensemble(density, wrong, seed=1, length=EnsembleLength(2, 100), predictive=False)
    assert posterior.status is PosteriorStatus.NOT_CONVERGED


def test_saved_tree_loads_with_its_groups(linear, tmp_path):
    model, data, _, _ = linear
    density = Density(data, model, Noise(Colour.WHITE))
    mode = find_mode(density, density_start(density, fit_mle(model, data, extra_starts=0)))
    posterior = sample_ensemble(density, mode, seed=2, length=EnsembleLength(2))
    posterior.save(tmp_path / "posterior.nc")
    with xr.open_datatree(tmp_path / "posterior.nc", engine="h5netcdf") as tree:
        groups = {"posterior", "prior", "log_likelihood", "posterior_predictive", "prior_predictive", "observed_data"}
        assert groups <= set(tree.children)
        np.testing.assert_array_equal(tree["posterior"]["CLa"], posterior.tree["posterior"]["CLa"])
        assert tree["log_likelihood"]["CL"].shape[-1] == data.n
    assert not list(tmp_path.glob("*.part"))
