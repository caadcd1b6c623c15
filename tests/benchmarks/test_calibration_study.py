"""Calibration studies: reproducible replicates whose ranks are those of a calibrated posterior, at small size."""

import jax.numpy as jnp
import numpy as np
import pytest
from calibration import DRAWS, Replicate, calibration_table, covariance, process_replicate, stall_replicate


@pytest.mark.verify
def test_both_engines_rank_a_truth_alike(thinned, model):
    """Same truth and data: two ranks among 99 draws differ by a deviation of at most 7; five are allowed."""
    few = thinned.thinned(4)
    ours, theirs = (stall_replicate(model, few, engine, 2) for engine in ("emcee", "NUTS"))
    assert len(ours.ranks) == 20
    for name, own in ours.ranks.items():
        assert 0 <= own <= DRAWS
        assert abs(own - theirs.ranks[name]) < 35, name


def test_a_sample_function_has_the_covariance_that_the_engine_assumes():
    """Against the engine's own kernel matrix through its log likelihood."""
    from scipy.stats import multivariate_normal

    from bayes_aero.inference.gp.priors import Priors
    from bayes_aero.inference.gp.reduced import ReducedData
    from bayes_aero.inference.gp.sampling.density import log_density

    rng = np.random.default_rng(2)
    x, theta = rng.standard_normal((12, 2)), rng.normal(-0.5, 0.3, 7)
    y = rng.standard_normal(12)
    ours = multivariate_normal(np.zeros(12), covariance(theta, x)).logpdf(y)
    prior = float(Priors().log_density(jnp.asarray(theta)))
    assert log_density(theta, ReducedData.of(x, y), Priors()).value - prior == pytest.approx(ours, abs=1e-8)


@pytest.mark.verify
def test_a_process_replicate_ranks_every_hyperparameter():
    x = np.random.default_rng(5).standard_normal((40, 1))
    found = process_replicate(x, ("alpha",), 1)
    assert set(found.ranks) == {"constant", "linear[alpha]", "signal", "length_scale[alpha]", "noise"}
    assert all(0 <= k <= DRAWS for k in found.ranks.values())


def test_the_table_counts_coverage_in_closed_form():
    ranks = np.arange(DRAWS + 1)
    table = calibration_table([Replicate(int(k), {"a": int(k)}, "converged") for k in ranks])
    row = table.loc["a"]
    assert row["mean rank"] == pytest.approx(0.5)
    assert row["in 50 %"] == pytest.approx(0.5)
    assert row["in 90 %"] == pytest.approx(0.9)
    assert bool(row["inside band"])
