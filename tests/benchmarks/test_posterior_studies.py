"""Posteriors against known truth: ranks, calibration, coverage, and figures of both."""

import jax.numpy as jnp
import numpy as np
import pytest
from calibration import (
    DRAWS,
    Replicate,
    band_of,
    calibration_table,
    covariance,
    process_replicate,
    rank,
    rank_bands,
    stall_replicate,
)
from interval_coverage import LOOKS, METHODS, coverage_against_colour, coverage_study

from bayes_aero.report.style import save
from bayes_aero.simulate.demo import TRUTH


def test_ranks_have_the_closed_form_of_quantiles_and_uniform_ones_stay_in_their_band():
    draws = np.arange(1000.0)[:, None] / 1000.0
    draws = np.random.default_rng(0).permutation(draws)
    assert rank(np.array([-1.0]), draws)[0] == 0
    assert rank(np.array([2.0]), draws)[0] == DRAWS
    assert abs(rank(np.array([0.25]), draws)[0] - 0.25 * DRAWS) < 3.0 * np.sqrt(0.25 * 0.75 * DRAWS)
    # 95 % simultaneous: of 200 sets, 190 are expected inside, with a deviation of 3.1.
    rng = np.random.default_rng(3)
    inside = sum(band_of(list(map(int, rng.integers(0, DRAWS + 1, 100)))).inside for _ in range(200))
    assert 178 <= inside <= 199


def test_ranks_of_a_posterior_too_narrow_or_shifted_leave_the_band():
    rng = np.random.default_rng(4)
    truth, n = rng.standard_normal(300), 300
    data = truth + rng.standard_normal(n)
    mean, sd = data / 2.0, np.sqrt(0.5)  # of the posterior, in closed form

    def ranks(shift, width):
        return [
            int(rank(np.array([t]), (m + shift + width * sd * rng.standard_normal((DRAWS, 1))))[0])
            for t, m in zip(truth, mean, strict=True)
        ]

    assert band_of(ranks(0.0, 1.0)).inside
    assert not band_of(ranks(0.0, 0.6)).inside
    assert not band_of(ranks(0.4, 1.0)).inside


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

    from bayes_aero.inference.gp.kernel import Priors, ReducedData
    from bayes_aero.inference.gp.posterior import log_density

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


COLOURED = {"sigma_CL": 0.02, "sigma_CD": 0.005, "sigma_Cm": 0.004, "rho_CL": 0.95, "rho_CD": 0.95, "rho_Cm": 0.95}


@pytest.mark.verify
def test_coverage_under_coloured_noise(thinned, model):
    """rho = 0.95: the AR(1) posterior covers, Cramer-Rao bounds and the white posterior do not.

    Sixty replicates of each of eight cells of colour and rate: benchmarks/interval_coverage.py.
    """
    found = coverage_study(model, thinned, TRUTH, COLOURED, replicates=20, seed=17, white=4, max_steps=600)
    share = found.table().loc["all"]
    assert 0.91 <= share["AR(1) posterior"] <= 0.98
    assert share["CRB"] < 0.6
    assert share["white posterior"] < 0.6
    assert share["corrected CRB"] > 0.8


def test_ranks_outside_their_band_are_said_to_be(tmp_path):
    rng = np.random.default_rng(0)
    even = list(map(int, rng.integers(0, DRAWS + 1, 200)))
    low = list(map(int, rng.integers(0, DRAWS // 2, 200)))
    figure = rank_bands({"CL0": band_of(even), "tau2": band_of(low)})
    assert [ax.get_title() for ax in figure.axes] == ["CL0", "tau2: outside"]
    assert save(figure, tmp_path / "ranks.png").stat().st_size > 5000


def test_coverage_shows_every_method_at_its_colour(tmp_path):
    points = {method: [(0.9, 0.5), (0.0, 0.95)] for method in METHODS}
    figure = coverage_against_colour({6.25: points, 25.0: points})
    left = figure.axes[0]
    assert [t.get_text() for t in left.get_xticklabels()] == ["0", "0.9"]
    lines = [line for line in left.get_lines() if len(line.get_xdata()) == 2 and line.get_label() in str(LOOKS)]
    assert len(lines) == len(METHODS)
    for line in lines:
        assert line.get_ydata() == pytest.approx([0.95, 0.5])
    assert "6.25 samples a second" in left.get_title()
    assert save(figure, tmp_path / "coverage.png").stat().st_size > 5000
