"""`fit_gp` from the outside: predictions, coverage, units, refusals, and a tree that ArviZ reads back."""

import arviz_stats
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

from bayes_aero.errors import InputError
from bayes_aero.inference import gp as fit
from bayes_aero.inference.gp import Budget, Prediction, Priors, SampleStatus, fit_gp
from bayes_aero.inference.gp.posterior import Settings


def make(seed, n=100):
    """Two inputs in units far apart, an output with an offset and noise of sd 0.1."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, 2)) * [0.05, 9.0] + [0.15, 84.0]
    z = (X - [0.15, 84.0]) / [0.05, 9.0]
    return X, 1.0 + 0.3 * z[:, 0] + 0.4 * np.sin(1.5 * z[:, 1]) + 0.1 * rng.normal(size=n)


@pytest.fixture(scope="module")
def sampled():
    X, y = make(0)
    budget = Budget(exact=80, nuts=Settings(250, 500, 4))  # the shape and settings of test_posterior: one compilation
    return fit_gp(X[:, 1:], y - 6 * X[:, 0], input_names=("V",), output_name="CL", starts=4, budget=budget, seed=4)


@pytest.fixture(scope="module")
def at_map():
    return fit_gp(*make(0), input_names=("alpha", "V"), starts=4, sample=False)


def test_predictions_cover_what_they_say_with_the_uncertainty_of_hyperparameters(sampled):
    X, y = make(1, n=1500)
    y = y - 6 * X[:, 0]
    p = sampled.predict(X[:, 1:])
    for level, share in p.coverage(y).items():
        assert share == pytest.approx(level, abs=0.1 if level == 0.5 else 0.05)
    assert np.sqrt(np.mean((p.mean - y) ** 2)) < 0.13
    assert np.all(p.sd > p.latent_sd)
    new = np.linspace(60.0, 110.0, 50)[:, None]
    p = sampled.predict(new)
    assert p.component_mean.shape == (24, 50)
    np.testing.assert_allclose(p.mean, p.component_mean.mean(axis=0))
    within = np.mean(p.component_sd**2, axis=0)
    np.testing.assert_allclose(p.sd**2, within + p.component_mean.var(axis=0))
    assert np.all(p.component_mean.std(axis=0) > 0)


def test_map_prediction_is_the_textbook_conditional(at_map):
    X, y = make(0)
    new, _ = make(3, n=5)
    hyper = at_map.map
    mean, sd = at_map.scaling.mean, at_map.scaling.sd

    def kernel(a, b):
        linear = ((a - mean) * hyper["linear"] ** 2) @ (b - mean).T
        distance = (((a[:, None] - b) / hyper["length_scale"]) ** 2).sum(axis=-1)
        return hyper["constant"] ** 2 + linear + hyper["signal"] ** 2 * np.exp(-0.5 * distance)

    k = kernel(X, X) + hyper["noise"] ** 2 * np.eye(len(X))
    cross = kernel(X, new)
    p = at_map.predict(new)
    np.testing.assert_allclose(p.mean, cross.T @ np.linalg.solve(k, y), rtol=1e-8)
    variance = np.diag(kernel(new, new) - cross.T @ np.linalg.solve(k, cross))
    np.testing.assert_allclose(p.latent_sd**2, variance, rtol=1e-5)
    np.testing.assert_allclose(p.sd**2, variance + hyper["noise"] ** 2, rtol=1e-8)
    np.testing.assert_allclose(p.high[2] - p.low[2], 2 * 1.959964 * p.sd, rtol=1e-6)
    assert sd.shape == (2,)


def test_mixture_quantiles_are_those_of_its_draws():
    rng = np.random.default_rng(0)
    means, latent = rng.normal(size=(6, 3)), rng.uniform(0.1, 1.0, size=(6, 3))
    noise = rng.uniform(0.1, 0.5, size=6)
    p = Prediction.of_mixture(means, latent, noise)
    which = rng.integers(6, size=200_000)
    draws = means[which] + np.sqrt(latent + noise[:, None])[which] * rng.normal(size=(200_000, 3))
    np.testing.assert_allclose(p.mean, draws.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(p.sd, draws.std(axis=0), atol=0.02)
    np.testing.assert_allclose(p.low[1], np.quantile(draws, 0.05, axis=0), atol=0.03)
    np.testing.assert_allclose(p.high[2], np.quantile(draws, 0.975, axis=0), atol=0.03)


def test_units_of_inputs_and_output_do_not_matter(at_map):
    X, y = make(0)
    other = fit_gp(X * [57.3, 3.6] + [1.0, 0.0], 100.0 * y, starts=4, sample=False)
    new, _ = make(6, n=20)
    there, here = other.predict(new * [57.3, 3.6] + [1.0, 0.0]), at_map.predict(new)
    np.testing.assert_allclose(there.mean, 100.0 * here.mean, rtol=1e-4)
    np.testing.assert_allclose(other.map["length_scale"], at_map.map["length_scale"] * [57.3, 3.6], rtol=1e-2)
    np.testing.assert_allclose(other.map["linear"], 100 * at_map.map["linear"] / [57.3, 3.6], rtol=1e-2)
    assert other.optima[0].value == pytest.approx(at_map.optima[0].value, abs=1e-3)


def test_the_tree_is_complete_and_arviz_reads_it_back(sampled, tmp_path):
    tree = sampled.posterior
    assert sampled.status is SampleStatus.accepted
    assert {"posterior", "prior", "sample_stats", "proposal", "stand_in"} <= set(tree.children)
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


def test_a_fit_without_sampling_says_so_and_takes_jax_arrays(at_map):
    assert at_map.status is SampleStatus.not_sampled
    assert at_map.posterior is None
    assert np.isnan(at_map.k_hat)
    X, y = make(0)
    fit = fit_gp(jnp.asarray(X), jnp.asarray(y), starts=4, sample=False)
    assert fit.optima[0].value == at_map.optima[0].value
    with pytest.raises(InputError, match="alpha, V"):
        at_map.predict(np.zeros((3, 3)))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda X, y: (X[:6], y[:6]), "6 samples cannot"),
        (lambda X, y: (np.tile(X, (81, 1)), np.tile(y, 81)), "8000"),
        (lambda X, y: (np.where(np.arange(100)[:, None] == 7, np.nan, X), y), "x0 is not finite at sample 7"),
        (lambda X, y: (X * [0.0, 1.0], y), "x0 does not vary"),
        (lambda X, y: (X, 0.0 * y), "zero at every"),
    ],
    ids=["few", "many", "nan", "constant", "zero"],
)
def test_what_cannot_be_fitted_is_refused_in_words(change, says):
    with pytest.raises(InputError, match=says):
        fit_gp(*change(*make(0)), sample=False)


def test_priors_and_records_that_cannot_be_sampled_are_refused(monkeypatch):
    with pytest.raises(InputError, match="improper"):
        fit_gp(*make(0), priors=Priors.flat())
    X, y = make(0)
    monkeypatch.setattr(fit, "MAX_SAMPLES", 80)
    with pytest.raises(InputError, match=r"n = 100 .*bound of 80.*--resample"):
        fit_gp(X, y, sample=False)


@pytest.mark.parametrize("dependent", ["input twice", "sum of inputs", "linear output"])
def test_dependent_inputs_have_a_mode_and_a_status_in_place_of_draws(dependent):
    X, y = make(0, n=60)
    if dependent != "linear output":
        X = np.column_stack([X, X[:, 0] if dependent == "input twice" else X @ [1.0, 0.01]])
    y = 2.0 + X @ np.arange(1.0, X.shape[1] + 1.0) if dependent == "linear output" else y
    fit = fit_gp(X, y, sample=True, starts=3, seed=1)
    assert fit.status is SampleStatus.dependent
    assert fit.posterior is None
    assert np.isfinite(fit.predict(X).mean).all()
