"""Fits and posteriors of a stall: published estimates, truth, closed forms, engines that agree, modes, highest lift."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from jax.scipy.special import logsumexp
from jax.scipy.stats import norm
from scipy.optimize import minimize_scalar
from scipy.stats import multivariate_normal

import bayes_aero as ba
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.card import read_card
from bayes_aero.inference import sampling
from bayes_aero.inference.mle import fit_mle, stall_of, without_noise_bias
from bayes_aero.inference.results import MleStatus, PosteriorStatus
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Colour, Density, LogDensity, Noise, observe
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.simulate.demo import TRUTH, simulate_stall

# Maximum likelihood against the published ATTAS estimates, simulated truth and closed forms
# ../shared/attas/README.md: estimate and Cramer-Rao deviation, reproduced from the published program.
PUBLISHED = {
    "CD0": (4.34961e-02, 4.3651e-04), "e": (8.39351e-01, 6.8668e-03), "CL0": (1.57696e-01, 3.2766e-03),
    "CLa": (3.29802, 3.7654e-02), "CLaM": (9.06967, 1.9966e-01), "Cm0": (5.08510e-02, 1.7792e-03),
    "Cma": (-1.76297e-01, 1.1134e-02), "Cmq": (-6.14636, 2.7480e-01), "Cmde": (-3.90633e-01, 1.5943e-02),
    "a1": (23.7160, 8.0987e-01), "alpha_star": (3.08701e-01, 1.0806e-03), "tau2": (24.0248, 3.5106e-01),
    "CDX": (7.91715e-02, 3.0226e-03), "CmX": (-1.26103e-01, 5.0156e-03),
}  # fmt: skip
PUBLISHED_FIT = {"CL": (0.990265, 0.030034), "CD": (0.949406, 0.009806), "Cm": (0.448006, 0.011800)}


def test_published_estimates_bounds_cost_and_fit(attas, model):
    r = fit_mle(model, attas)
    assert r.status is MleStatus.CONVERGED
    assert set(r.names) == set(PUBLISHED)
    for name, estimate, crb in zip(r.names, r.estimate, r.crb, strict=True):
        value, deviation = PUBLISHED[name]
        assert abs(estimate - value) < 0.3 * deviation, name
        assert crb == pytest.approx(deviation, rel=0.015), name
    assert r.det_R == pytest.approx(1.2076e-11, rel=1e-3)
    for name, (correlation, rmse) in PUBLISHED_FIT.items():
        assert r.fit[name].r == pytest.approx(correlation, abs=2e-4)
        assert r.fit[name].rmse == pytest.approx(rmse, rel=1e-3)

    @jax.jit
    def cost(theta):
        residual = attas.measured - model.predicted(theta, attas.signals, attas.aircraft)
        return 0.5 * attas.n * jnp.sum(jnp.log(jnp.mean(residual**2, axis=0)))

    least = float(cost(r.estimate))
    assert len(r.starts) > 3
    assert min(c for c, outcome in r.starts if outcome == "converged") == pytest.approx(least, abs=1e-6)
    assert least <= float(cost(jnp.asarray([PUBLISHED[name][0] for name in model.names])))
    for i, crb in enumerate(r.crb):  # higher to either side, by the twentieth of a bound
        for sign in (1, -1):
            assert float(cost(r.estimate + sign * 0.05 * crb * (np.arange(len(r.crb)) == i))) > least


def test_the_first_real_manoeuvre_alone_finds_a_stall(attas, model):
    """One quick Gauss-Newton ran from the published start to alpha* < 0; ours must recover."""
    r = fit_mle(model, attas.only(0))
    assert r.status is MleStatus.CONVERGED
    assert 0.2 < r.estimate[r.names.index("alpha_star")] < 0.4


LINEAR = ("attached_lift", "pitching_moment", "profile_drag")  # in its parameters
WHITE = {"sigma_CL": 0.02, "sigma_CD": 0.005, "sigma_Cm": 0.004}
COLOURED = WHITE | {"rho_CL": 0.95, "rho_CD": 0.95, "rho_Cm": 0.95}


def simulated(observations, model, seed, noise=WHITE, colour=Colour.WHITE):
    """The observations with coefficients of the truth and such noise in place of what was measured."""
    density, values = Density(observations, model, Noise(colour)), TRUTH | noise
    white = jnp.asarray(np.random.default_rng(seed).standard_normal((observations.n, 3)))
    return observations.with_measured(density.replicate(jnp.asarray([values[n] for n in density.names]), white))


@pytest.mark.verify
def test_bounds_cover_the_truth_under_white_noise(thinned, model):
    """100 replicates x 14 parameters: the spread of z = error/bound is that of a standard normal."""
    truth = np.array([TRUTH[n] for n in model.names])
    z = []
    for seed in range(100):
        r = fit_mle(model, simulated(thinned, model, seed), start=truth, extra_starts=0)
        z.append((r.estimate - truth) / r.crb)
    z = np.array(z)
    assert np.all(np.abs(z.mean(axis=0)) < 4.0 / np.sqrt(len(z)))
    # sd of a sample sd of 100 normals is 7 %; four of them either way.
    assert np.all((z.std(axis=0) > 0.72) & (z.std(axis=0) < 1.28))
    assert np.mean(np.abs(z) < 1.96) == pytest.approx(0.95, abs=0.02)


@pytest.fixture(scope="module")
def gentle(thinned, model):
    """A flight without a stall, with coloured noise, and its fit."""
    calm = thinned.subset(np.flatnonzero(np.asarray(thinned.signals["alpha"]) < 0.13)[:150])
    data = simulated(calm, model, 50, COLOURED, Colour.AR1)
    return data, fit_mle(model, data, extra_starts=0)


def test_stalls_that_were_not_flown_and_parameters_at_zero_are_said(gentle, thinned, model):
    _, calm = gentle
    assert calm.status is MleStatus.STALL_NOT_IDENTIFIED
    assert any("never approached alpha_star" in said for said in calm.warnings())
    roles = {"a1": "k", "alpha_star": "alpha_half"}  # names of a user's own law, known by their roles
    own = replace(calm, parameters=tuple(replace(p, name=roles.get(p.name, p.name)) for p in calm.parameters))
    assert any(
        "never approached alpha_half" in said and "k, alpha_half and the terms" in said for said in own.warnings()
    )
    r = fit_mle(model, simulated(thinned, model, 3), extra_starts=0)
    assert r.status is MleStatus.CONVERGED
    assert not any("not identified" in w or "never approached" in w for w in r.warnings())
    # tau2 of a quasi-steady flow ends at zero, where the deviation is no finite share of the estimate.
    at = r.names.index("tau2")
    zero = replace(r, estimate=np.where(np.arange(len(r.names)) == at, 0.0, r.estimate))
    expected = f"tau2 is not identified: its Cramer-Rao standard error is {r.crb[at]:.2g}, its estimate 0."
    assert expected in zero.warnings()


def test_singular_information_and_bounds_are_reported(thinned, model):
    """With Mach constant, CLaM Mach alpha and CLa alpha are one term in attached flow: told, not hidden."""
    twice = Model.of((*LINEAR, "mach_lift", "elevator_moment", "pitch_damping"))
    flat = replace(thinned, signals=thinned.signals | {"mach": jnp.full(thinned.n, 0.25)})
    r = fit_mle(twice, flat, extra_starts=0)
    assert r.status is MleStatus.SINGULAR
    assert np.all(np.isnan(r.crb))
    bounded = (p.changed(bounds=(30.0, 60.0), start=40.0) if p.name == "a1" else p for p in model.parameters)
    r = fit_mle(replace(model, parameters=tuple(bounded)), thinned, extra_starts=0)
    assert r.status is MleStatus.AT_BOUND
    assert r.at_bound == ("a1",)
    assert r.estimate[r.names.index("a1")] == 30.0


# Estimates without the bias from recording noise: simulated truth, records without noise, an identity
def flown(card, seed, sensor_noise):
    return [simulate_stall(i, card=card, seed=seed, sensor_noise=sensor_noise, disturbance=0.0) for i in range(2)]


def test_half_the_bias_of_a_noisy_vane_and_more_is_taken_off_and_without_noise_none(card, model):
    """The mean of estimates with noise added and subtracted, less that without noise, is the bias."""
    exact = flown(card, 11, 0.0)
    still = fit_mle(model, observe(exact, card, model), extra_starts=0)
    truth, bias = still.estimate, without_noise_bias(still, exact, card, model).bias
    assert bias is not None
    assert np.all(np.abs(bias) < 0.05 * still.crb_corrected)
    rng, before, after = np.random.default_rng(1), [], []
    for _ in range(2):
        noise = [np.radians(0.3) * rng.standard_normal(record.n) for record in exact]
        for sign in (1.0, -1.0):
            records = [
                replace(record, channels={**record.channels, "alpha": record["alpha"] + sign * one})
                for record, one in zip(exact, noise, strict=True)
            ]
            mle = fit_mle(model, observe(records, card, model), start=truth, extra_starts=0)
            freed = without_noise_bias(mle, records, card, model)
            before.append((mle.estimate - truth) / mle.crb_corrected)
            after.append((freed.estimate - truth) / mle.crb_corrected)
            assert np.all(np.diag(freed.corrected) >= np.diag(mle.corrected))
    biased, rest = np.abs(np.mean(before, axis=0)), np.abs(np.mean(after, axis=0))
    large = biased > 1.0
    assert {"tau2", "Cmq", "Cmde"} <= {name for name, is_large in zip(mle.names, large, strict=True) if is_large}
    assert np.all(rest[large] < 0.5 * biased[large])
    bounded = replace(mle, status=MleStatus.AT_BOUND)
    assert without_noise_bias(bounded, records, card, model) is bounded


def test_the_posterior_is_of_parameters_without_the_bias(thinned, model):
    """Its density at x is that of the fitted parameters at x + bias, priors apart."""
    bias = 0.01 * np.arange(len(model.names))
    plain, freed = (Density.of(thinned, model, Noise(Colour.AR1), *given) for given in ((), (bias,)))
    x = jnp.asarray([p.start for p in plain.parameters])
    there = x.at[: len(bias)].add(bias)
    log_likelihood = eqx.filter_jit(lambda density, x: density.log_likelihood(x))
    assert float(log_likelihood(freed, x)) == pytest.approx(float(log_likelihood(plain, there)), rel=1e-12)


def test_published_coefficients_give_the_published_estimates(card):
    records, model = flown(card, 11, 1.0)[:1], Model.of(LINEAR)
    assert ba.fit(records, card, model=model, coefficients="published").mle.bias is None
    assert ba.fit(records, card, model=model).mle.bias is not None


# The posterior: closed form, agreement of engines, white noise against bounds, coloured noise
SIGMA = np.array([*WHITE.values()])


@pytest.fixture(scope="module")
def linear(thinned):
    """A model linear in its parameters, priors as narrow as the data are informative, and its closed form."""
    model = Model.of(LINEAR)
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


@pytest.fixture(scope="module")
def at_mode(linear):
    model, data, *_ = linear
    density = Density(data, model, Noise(Colour.WHITE))
    mode = sampling.find_mode(density, sampling.density_start(density, fit_mle(model, data, extra_starts=0)))
    assert mode.status is sampling.ModeStatus.CONVERGED
    return density, mode


@pytest.fixture(scope="module")
def posteriors(at_mode):
    nuts = sampling.sample_nuts(*at_mode, seed=5, length=sampling.NutsLength(4, 300), predictive=False)
    return {"emcee": sampling.sample_ensemble(*at_mode, seed=5, length=sampling.EnsembleLength(2)), "nuts": nuts}


@pytest.mark.parametrize("engine", ["emcee", "nuts"])
def test_engines_give_the_closed_form(engine, linear, posteriors):
    """Deviations of the noise are estimated, too; by so many samples that the t of Cm exceeds the normal by 0.2 %."""
    model, _, mean, covariance = linear
    posterior = posteriors[engine]
    assert posterior.status is PosteriorStatus.CONVERGED
    sd = np.sqrt(np.diag(covariance))
    for i, name in enumerate(model.names):
        m = posterior.marginals[name]
        assert abs(m.mean - mean[i]) < 5.0 * sd[i] / np.sqrt(m.ess_bulk) + 0.02 * sd[i]
        assert m.sd == pytest.approx(sd[i], rel=0.12)
    draws = posterior.draws()[:, : len(mean)]
    np.testing.assert_allclose(np.corrcoef(draws.T), covariance / np.outer(sd, sd), atol=0.12)


def test_maximum_likelihood_is_least_squares_on_a_linear_model(linear):
    model, data, *_ = linear
    r = fit_mle(model, data, extra_starts=0)
    alpha, z = np.asarray(data.signals["alpha"]), np.asarray(data.measured)
    A = np.stack([np.ones_like(alpha), alpha], axis=1)
    for column, names in ((0, ("CL0", "CLa")), (2, ("Cm0", "Cma"))):
        expected, rss, *_ = np.linalg.lstsq(A, z[:, column], rcond=None)
        bound = np.sqrt(np.diag(np.linalg.inv(A.T @ A)) * rss / len(z))
        at = [r.names.index(name) for name in names]
        np.testing.assert_allclose([r.estimate[at], r.crb[at]], [expected, bound], rtol=1e-8)


def test_coloured_posterior_of_a_flight_finds_the_pitching_moment(model, card):
    """With filtered Cm, whose smoothness is no persistence; feedback of disturbances biases every method by 2 %."""
    observations = observe([simulate_stall(0, seed=5), simulate_stall(1, seed=5)], card, model)
    density = Density.of(observations, model, Noise(Colour.AR1))
    mode = sampling.find_mode(density, sampling.density_start(density, fit_mle(model, observations, extra_starts=0)))
    found = dict(zip(density.names, np.asarray(density.constrain(jnp.asarray(mode.u))), strict=True))
    for name in ("Cm0", "Cma", "Cmq", "Cmde", "CmX"):
        assert found[name] == pytest.approx(TRUTH[name], rel=0.05), name


def test_a_flight_without_a_stall_has_a_mode(gentle, model):
    """Estimates of what it does not tell are hundreds of deviations off, where the density's slope is not finite."""
    data, mle = gentle
    density = Density(data, model, Noise(Colour.AR1))
    wild = {"CDX": 445.0, "CmX": 814.0, "a1": 199.8, "tau2": -49.9, "alpha_star": 0.29}
    covariance = np.diag([np.inf if name in wild else x for name, x in zip(mle.names, mle.crb**2, strict=True)])
    estimate = [wild.get(name, value) for name, value in zip(mle.names, mle.estimate, strict=True)]
    start = sampling.density_start(density, replace(mle, estimate=np.array(estimate), covariance=covariance))
    begun = dict(zip(density.parameters, start, strict=True))
    assert set(wild) <= {p.name for p in begun}
    assert all(begun[p] == pytest.approx(p.prior.normal[0]) for p in begun if p.name in wild)
    far = np.array([wild.get(name, value) for name, value in zip(density.names, start, strict=True)])
    mode, lost = (sampling.find_mode(density, x) for x in (start, far))
    assert mode.status is sampling.ModeStatus.CONVERGED
    strayed = lost.status is not sampling.ModeStatus.CONVERGED
    assert strayed or lost.log_density == pytest.approx(mode.log_density, abs=1e-3)
    assert np.isfinite(lost.factor).all()


def test_thinning_stays_within_manoeuvres(clean):
    fewer = clean.thinned(5)
    kept = [5 * k for k in range(-(-clean.only(0).n // 5))]
    np.testing.assert_array_equal(fewer.time[fewer.manoeuvre == 0], clean.time[kept])
    assert fewer.dt == pytest.approx(5 * clean.dt)
    assert int(np.asarray(fewer.start).sum()) == len(clean.names)


@pytest.mark.parametrize("colour", list(Colour))
def test_density_is_that_of_the_multivariate_normal_and_standardises_its_noise(thinned, model, colour):
    """Sum of the conditional densities against scipy's joint density of each manoeuvre and coefficient."""
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
    white = jnp.asarray(rng.standard_normal((short.n, 3)))

    @eqx.filter_jit
    def known(density, x):
        data = short.with_measured(density.replicate(x, white))
        return density.log_likelihood(x), Density(data, model, Noise(colour)).standardised(x)

    log_likelihood, standardised = known(density, x)
    assert float(log_likelihood) == pytest.approx(expected, rel=1e-10)
    np.testing.assert_allclose(standardised, white, atol=1e-9)


def test_unbounded_scale_is_a_bijection_with_the_stated_slope(thinned, model):
    density = Density(thinned, model, Noise(Colour.BUFFET_AR1))
    x = jnp.asarray(density.sample_prior(np.random.default_rng(4), 1)[0])

    @eqx.filter_jit
    def there_and_back(density, x):
        u = density.unconstrain(x)
        slope = jnp.log(jnp.abs(jnp.diag(jax.jacfwd(density.constrain)(u))))
        return density.constrain(u), density(u), density.log_likelihood(x) + density.log_prior(x) + jnp.sum(slope)

    back, value, expected = there_and_back(density, x)
    np.testing.assert_allclose(back, x, rtol=1e-9)
    assert float(value) == pytest.approx(float(expected), rel=1e-10)


def test_a_chain_too_short_is_not_called_converged(at_mode):
    density, mode = at_mode
    wrong = replace(mode, u=mode.u + 30.0 * np.abs(np.diag(mode.factor)), factor=0.05 * mode.factor)
    brief = sampling.EnsembleLength(2, 100)
    posterior = sampling.sample_ensemble(density, wrong, seed=1, length=brief, predictive=False)
    assert posterior.status is PosteriorStatus.NOT_CONVERGED


def test_saved_tree_loads_with_its_groups(posteriors, thinned, tmp_path):
    posterior = posteriors["emcee"]
    posterior.save(tmp_path / "posterior.nc")
    with xr.open_datatree(tmp_path / "posterior.nc", engine="h5netcdf") as tree:
        groups = {"posterior", "prior", "log_likelihood", "posterior_predictive", "prior_predictive", "observed_data"}
        assert groups <= set(tree.children)
        np.testing.assert_array_equal(tree["posterior"]["CLa"], posterior.tree["posterior"]["CLa"])
        assert tree["log_likelihood"]["CL"].shape[-1] == thinned.n
    assert not list(tmp_path.glob("*.part"))


# Highest steady lift and the angle of it: closed forms, an independent search, and what lies beyond the record
FLOWN = {
    "alpha": np.deg2rad(np.linspace(2.0, 22.0, 500)),
    "alpha_dot": np.deg2rad(5.0) * np.sin(np.linspace(0.0, 20.0, 500)),
    "airspeed": np.linspace(110.0, 60.0, 500),
    "q": np.full(500, 0.1),
}


def _parabola():
    """CL = 2 b alpha - c alpha^2: its maximum is b^2/c, at b/c."""
    parameters = tuple(Parameter(n, "1", 0.0, 1.0, "of a test", Prior("normal", 0.0, 1.0)) for n in ("b", "c"))
    return Effect(
        "parabola", Kind.AERODYNAMICS, Stage.TOTAL, "test", parameters, ("alpha",),
        lambda v, s, *_: {"CL": 2.0 * v["b"] * s["alpha"] - v["c"] * s["alpha"] ** 2},
        Example({}, {}, {}, ""), "",
    )  # fmt: skip


def test_a_parabola_has_its_known_maximum_and_one_beyond_the_record_is_flagged(card):
    rng = np.random.default_rng(0)
    c = rng.uniform(20.0, 30.0, 300)
    b = c * rng.uniform(0.2, 0.3, 300)
    found = stall_of(Model.of([_parabola()]), np.stack([b, c], axis=1), FLOWN, card.aircraft)
    low, median, high = np.quantile(b**2 / c, [0.025, 0.5, 0.975])
    assert (found.CL_max.low, found.CL_max.median, found.CL_max.high) == pytest.approx((low, median, high), rel=1e-9)
    low, median, high = np.quantile(b / c, [0.025, 0.5, 0.975])
    assert (found.alpha_max.low, found.alpha_max.median, found.alpha_max.high) == pytest.approx((low, median, high))
    assert found.at_edge == 0.0
    assert found.seen
    draws = np.array([[0.5 * c, c] for c in (20.0, 25.0)])  # at 0.5 rad, 29 deg, where nobody flew
    found = stall_of(Model.of([_parabola()]), draws, FLOWN, card.aircraft)
    assert found.at_edge == 1.0
    assert not found.seen
    assert found.alpha_max.high == pytest.approx(np.deg2rad(22.0))


def test_kirchhoffs_stall_by_another_search(card, model):
    """CL written out by hand and searched by Brent's method: no code shared with the package."""
    value = {"CL0": 0.2, "CLa": 3.0, "CLaM": 4.0, "a1": 25.0, "alpha_star": 0.3}
    theta = np.array([value.get(p.name, p.start) for p in model.free])
    signals = {**FLOWN, "mach": np.full(500, 0.3), "elevator": np.zeros(500)}
    found = stall_of(model, theta[None], signals, card.aircraft)

    def lift(alpha):
        X = 0.5 * (1.0 - np.tanh(25.0 * (alpha - 0.3)))
        return 0.2 + (3.0 * ((1.0 + np.sqrt(X)) / 2.0) ** 2 + 4.0 * 0.3) * alpha

    best = minimize_scalar(lambda a: -lift(a), bounds=(0.1, 0.34), method="bounded", options={"xatol": 1e-10})
    steady = lift(found.alpha)
    assert found.CL[1] == pytest.approx(steady, abs=1e-12)
    assert found.CL_max.median == pytest.approx(-best.fun, abs=2e-6)
    assert found.alpha_max.median == pytest.approx(best.x, abs=2e-4)
    falling, still, rising = found.X[:, 1]
    assert np.all(falling <= still)  # late reattachment: less attached flow at the same angle
    assert np.array_equal(rising, still)  # one-sided as published
    assert np.any(falling < still - 0.01)


# The search for the mode that holds most: closed-form mixtures, and stalls of which the truth is known
PRIOR = Prior("normal", 0.0, 2.0)


class Mixture(LogDensity):
    """A posterior that is two normals: `left` of the probability at -1.5, the rest at 2, which is twice as wide."""

    left: float

    @property
    def parameters(self):
        return (Parameter("a", "1", 0.0, 0.1, "-", PRIOR),)

    @property
    def noise_label(self):
        return "white"

    def log_likelihood(self, x):
        parts = jnp.stack([norm.logpdf(x[0], -1.5, 0.2), norm.logpdf(x[0], 2.0, 0.4)])
        return logsumexp(parts + jnp.log(jnp.array([self.left, 1.0 - self.left]))) - PRIOR.log_density(x[0])


@pytest.mark.parametrize(("left", "at"), [(0.7, -1.5), (0.2, 2.0), (1.0 - 1e-9, -1.5)])
def test_the_mode_with_most_of_the_probability_is_taken_and_the_rest_is_told(left, at):
    mode = sampling.search_modes(Mixture(left), np.array([2.0 if left == 0.7 else -1.4]), 10, draws=30)
    assert mode.u[0] == pytest.approx(at, abs=0.01)
    assert mode.other_share == pytest.approx(min(left, 1.0 - left), abs=0.01)
    said = sampling.other_modes(mode, "emcee")
    assert [f"{mode.other_share:.0%}" in one for one in said] == [True] * (left < 0.9)  # one is not several


@pytest.mark.verify
def test_no_better_mode_lies_at_the_truth():
    """Of stalls drawn from the prior, whose maximum likelihood under white noise may lie elsewhere altogether."""
    card = read_card("attas")
    model = Model.from_card(card)
    signals = observe([simulate_stall(0, card=card)], card, model).thinned(16)
    rng = np.random.default_rng(4132)
    for seed in rng.integers(10**6, size=4):
        draw = np.random.default_rng(seed)
        maker = Density(signals, model, Noise(Colour.AR1))
        x = maker.sample_prior(draw, 1)[0]
        data = signals.with_measured(maker.replicate(jnp.asarray(x), jnp.asarray(draw.standard_normal((signals.n, 3)))))
        density = Density(data, model, Noise(Colour.AR1))
        found = sampling.search_modes(density, sampling.density_start(density, fit_mle(model, data)), data.n)
        there = sampling.find_mode(density, x)
        assert found.log_mass > there.log_mass - 2.0, f"seed {seed}"
