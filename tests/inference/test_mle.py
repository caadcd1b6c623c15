"""Maximum likelihood against published estimates, simulated truth and closed forms, with and without noise bias."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import bayes_aero as ba
from bayes_aero.inference.covariance import corrected_covariance
from bayes_aero.inference.mle import descend, fit_mle, without_noise_bias
from bayes_aero.inference.results import MleStatus
from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour, Density, Noise
from bayes_aero.model.observations import observe
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


@pytest.fixture(scope="module")
def published_fit(attas, model):
    return fit_mle(model, attas)


def test_published_estimates_bounds_cost_and_fit(published_fit, attas, model):
    r = published_fit
    assert r.status is MleStatus.CONVERGED
    assert set(r.names) == set(PUBLISHED)
    for name, estimate, crb in zip(r.names, r.estimate, r.crb, strict=True):
        value, deviation = PUBLISHED[name]
        assert abs(estimate - value) < 0.3 * deviation, name
        assert crb == pytest.approx(deviation, rel=0.015), name
    assert published_fit.det_R == pytest.approx(1.2076e-11, rel=1e-3)
    for name, (r, rmse) in PUBLISHED_FIT.items():
        assert published_fit.fit[name].r == pytest.approx(r, abs=2e-4)
        assert published_fit.fit[name].rmse == pytest.approx(rmse, rel=1e-3)
    theta = jnp.asarray([PUBLISHED[name][0] for name in model.names])
    residual = attas.measured - model.predicted(theta, attas.signals, attas.aircraft)
    assert published_fit.det_R <= float(jnp.prod(jnp.mean(residual**2, axis=0)))
    costs = [cost for cost, _ in published_fit.starts]
    assert min(c for c, outcome in published_fit.starts if outcome == "converged") == pytest.approx(
        0.5 * attas.n * np.log(published_fit.det_R), abs=1e-6
    )
    assert len(costs) > 3
    # Finite differences of the cost vanish at the optimum, to the scale of one bound.
    theta, cost = published_fit.estimate, 0.5 * attas.n * np.log(published_fit.det_R)
    for i, crb in enumerate(published_fit.crb):
        for sign in (1, -1):
            moved = theta.copy()
            moved[i] += sign * 0.05 * crb
            residual = attas.measured - model.predicted(jnp.asarray(moved), attas.signals, attas.aircraft)
            assert 0.5 * attas.n * float(jnp.sum(jnp.log(jnp.mean(residual**2, axis=0)))) > cost
    again = descend(model, attas, theta)
    np.testing.assert_allclose(again.theta, theta, atol=1e-3 * published_fit.crb.min())


@pytest.mark.parametrize("manoeuvre", [0, 1])
def test_each_real_manoeuvre_alone_finds_a_stall(attas, model, manoeuvre):
    """One quick Gauss-Newton ran from the published start to alpha* < 0 on the first; ours must recover."""
    r = fit_mle(model, attas.only(manoeuvre))
    assert r.status is MleStatus.CONVERGED
    alpha_star = r.estimate[r.names.index("alpha_star")]
    assert 0.2 < alpha_star < 0.4


def simulated(observations, model, noise, seed):
    density = Density(observations, model, Noise(Colour.AR1))
    x = jnp.asarray([TRUTH[n] for n in model.names] + [noise[p.name] for p in density.noise.parameters])
    white = jnp.asarray(np.random.default_rng(seed).standard_normal((observations.n, 3)))
    return observations.with_measured(density.replicate(x, white))


NOISE = {"sigma_CL": 0.02, "sigma_CD": 0.005, "sigma_Cm": 0.004, "rho_CL": 0.0, "rho_CD": 0.0, "rho_Cm": 0.0}


@pytest.mark.verify
def test_bounds_cover_the_truth_under_white_noise(thinned, model):
    """100 replicates x 14 parameters: the spread of z = error/bound is that of a standard normal."""
    truth = np.array([TRUTH[n] for n in model.names])
    z = []
    for seed in range(100):
        r = fit_mle(model, simulated(thinned, model, NOISE, seed), start=truth, extra_starts=0)
        z.append((r.estimate - truth) / r.crb)
    z = np.array(z)
    assert np.all(np.abs(z.mean(axis=0)) < 4.0 / np.sqrt(len(z)))
    # sd of a sample sd of 100 normals is 7 %; four of them either way.
    assert np.all((z.std(axis=0) > 0.72) & (z.std(axis=0) < 1.28))
    assert np.mean(np.abs(z) < 1.96) == pytest.approx(0.95, abs=0.02)


def test_corrected_bound_matches_the_true_scatter_of_a_mean_under_coloured_noise():
    """One constant parameter: the estimate is the sample mean, whose variance under AR(1) is known in closed form."""
    rng = np.random.default_rng(5)
    n, rho = 4000, rng.uniform(0.7, 0.95)
    ratios = []
    for _ in range(40):
        e = rng.standard_normal(n) * np.sqrt(1 - rho**2)
        r = np.empty(n)
        r[0] = rng.standard_normal()
        for k in range(1, n):
            r[k] = rho * r[k - 1] + e[k]
        r = (r - r.mean())[:, None]
        R = np.mean(r**2, axis=0)
        S = np.ones((n, 1, 1))
        D = np.array([[R[0] / n]])
        start = np.arange(n) == 0
        ratios.append(corrected_covariance(D, S, R, r, np.zeros(n, int), start)[0, 0])
    exact = (1 + rho) / (1 - rho) / n
    assert np.mean(ratios) == pytest.approx(exact, rel=0.2)


def test_corrected_bound_is_the_bound_itself_under_white_noise(thinned, model):
    """The correlogram is noisy on one record; over ten the median ratio is one, less a few per cent of bias."""
    start = np.array([TRUTH[n] for n in model.names])
    fits = [fit_mle(model, simulated(thinned, model, NOISE, s), start=start, extra_starts=0) for s in range(10)]
    assert np.mean([np.median(r.crb_corrected / r.crb) for r in fits]) == pytest.approx(1.0, abs=0.12)


def test_stalls_that_were_not_flown_and_parameters_at_zero_are_said(clean, model):
    calm = clean.subset(np.flatnonzero(np.asarray(clean.signals["alpha"]) < 0.13))
    data = simulated(calm, model, NOISE, 3)
    r = fit_mle(model, data)
    told = r.status is not MleStatus.CONVERGED or any(
        "not identified" in w or "never approached" in w for w in r.warnings()
    )
    assert told
    r = fit_mle(model, simulated(clean, model, NOISE, 3))
    assert r.status is MleStatus.CONVERGED
    assert not any("not identified" in w or "never approached" in w for w in r.warnings())
    # tau2 of a quasi-steady flow ends at zero, where the deviation is no finite share of the estimate.
    r = fit_mle(model, simulated(clean, model, NOISE, 3), extra_starts=0)
    at = r.names.index("tau2")
    zero = replace(r, estimate=np.where(np.arange(len(r.names)) == at, 0.0, r.estimate))
    expected = f"tau2 is not identified: its Cramer-Rao standard error is {r.crb[at]:.2g}, its estimate 0."
    assert expected in zero.warnings()


def test_singular_information_and_bounds_are_reported(clean, model):
    """With Mach constant, CLaM Mach alpha and CLa alpha are one term in attached flow: told, not hidden."""
    twice = Model.of(
        ["attached_lift", "mach_lift", "elevator_moment", "pitching_moment", "pitch_damping", "profile_drag"]
    )
    flat = clean.with_measured(clean.measured)
    flat.signals["mach"] = jnp.full(clean.n, 0.25)
    r = fit_mle(twice, flat, extra_starts=0)
    assert r.status is MleStatus.SINGULAR
    assert np.all(np.isnan(r.crb))
    tight = replace(
        model,
        parameters=tuple(p.changed(bounds=(30.0, 60.0), start=40.0) if p.name == "a1" else p for p in model.parameters),
    )
    r = fit_mle(tight, clean, extra_starts=0)
    assert r.status is MleStatus.AT_BOUND
    assert r.at_bound == ("a1",)
    assert r.estimate[r.names.index("a1")] == 30.0


# Estimates without the bias from recording noise: simulated truth, records without noise, an identity
VANE = np.radians(0.3)


def flown(card, seed, sensor_noise):
    return [simulate_stall(i, card=card, seed=seed, sensor_noise=sensor_noise, disturbance=0.0) for i in range(2)]


def test_half_the_bias_of_a_noisy_vane_and_more_is_taken_off(card, model):
    """The mean of estimates with noise added and subtracted, less that without noise, is the bias."""
    exact = flown(card, 11, 0.0)
    truth = fit_mle(model, observe(exact, card, model), extra_starts=0).estimate
    rng, before, after = np.random.default_rng(1), [], []
    for _ in range(3):
        noise = [VANE * rng.standard_normal(record.n) for record in exact]
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


def test_without_noise_or_at_a_bound_nothing_moves(card, model):
    records = flown(card, 11, 0.0)
    mle = fit_mle(model, observe(records, card, model), extra_starts=0)
    freed = without_noise_bias(mle, records, card, model)
    assert freed.bias is not None
    assert np.all(np.abs(freed.bias) < 0.05 * mle.crb_corrected)
    records = flown(card, 11, 1.0)
    mle = fit_mle(model, observe(records, card, model), extra_starts=0)
    bounded = replace(mle, status=MleStatus.AT_BOUND)
    assert without_noise_bias(bounded, records, card, model) is bounded


@pytest.mark.parametrize("colour", list(Colour))
def test_the_posterior_is_of_parameters_without_the_bias(clean, model, colour):
    """Its density at x is that of the fitted parameters at x + bias, priors apart."""
    noise, bias = Noise(colour), 0.01 * np.arange(len(model.names))
    plain, freed = Density.of(clean, model, noise), Density.of(clean, model, noise, bias)
    x = jnp.asarray([p.start for p in plain.parameters])
    there = x.at[: len(bias)].add(bias)
    assert float(freed.log_likelihood(x)) == pytest.approx(float(plain.log_likelihood(there)), rel=1e-12)
    np.testing.assert_allclose(freed.predict(x), plain.predict(there))


def test_published_coefficients_give_the_published_estimates(card):
    records = flown(card, 11, 1.0)
    assert ba.fit(records, card, coefficients="published").mle.bias is None
    assert ba.fit(records, card).mle.bias is not None
