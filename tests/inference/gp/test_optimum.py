"""The search finds the optimum it should, from bad starts too, and says how it ended."""

import numpy as np
import pytest

from bayes_aero.inference.gp.kernel import noise_to_signal
from bayes_aero.inference.gp.optimum import MapStatus, assemble, find_map, maximise
from bayes_aero.inference.gp.priors import HyperPrior, Priors
from bayes_aero.inference.gp.reduced import ReducedData
from bayes_aero.inference.gp.sampling.density import log_density


def test_u_and_w_are_theta(problem):
    _, theta = problem(0, d=4)
    np.testing.assert_allclose(assemble(theta[:6], noise_to_signal(theta)), theta, atol=1e-14)


@pytest.mark.parametrize("seed", range(2))
def test_the_full_gradient_vanishes_at_the_optimum(problem, seed):
    data, theta = problem(seed, n=150, d=2)
    best = maximise(noise_to_signal(theta), data, Priors())
    assert best.status is MapStatus.converged
    out = log_density(best.theta, data, Priors())
    assert out.value == pytest.approx(best.value, abs=1e-9)
    assert np.max(np.abs(out.gradient)) < 0.02
    assert best.value > log_density(theta, data, Priors()).value


def test_several_starts_find_the_good_one_of_two_optima():
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


def test_an_input_that_does_nothing_is_reported_at_its_bound_under_a_flat_prior():
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
