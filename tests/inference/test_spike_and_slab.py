"""Sampled sets of columns against the sum over all sets, independent columns, and many collinear ones."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from bayes_aero.inference.posterior.posterior import PosteriorStatus
from bayes_aero.inference.posterior.spike_and_slab import MOST, Columns, sample_sets

N = 120
GRID = np.linspace(-0.6, 0.6, 61), np.linspace(-2.0, 9.0, 111)  # log sigma, log tau


def problem(X, y, odds):
    X = X / np.linalg.norm(X, axis=0)
    return Columns(X.T @ X, X.T @ y, y @ y, float(len(y)), np.log(odds), np.sqrt(len(y)))


def collinear(rng):
    """Two near copies, a sum of two others, and a free one; the truth is the first and the last."""
    a, b, c, d = rng.standard_normal((4, N))
    X = np.stack([a, a + 0.05 * b, b, b + c, c, d], axis=1)
    X /= np.linalg.norm(X, axis=0)
    return X, 6.0 * X[:, 0] + 3.0 * X[:, 5] + rng.standard_normal(N)


def enumerated(X, y, odds):
    """Inclusion probabilities by the multivariate normal density of y itself, set by set, tau and sigma on a grid."""
    sets = [s for k in range(MOST + 1) for s in combinations(range(X.shape[1]), k)]
    log_sigma, log_tau = np.meshgrid(*GRID, indexing="ij")
    sigma2, tau2 = np.exp(2.0 * log_sigma), np.exp(2.0 * log_tau)
    prior = -0.5 * log_sigma**2 + log_tau - np.log1p(tau2 / N)
    weights = []
    for chosen in sets:
        own = X[:, chosen]
        values, vectors = np.linalg.eigh(own @ own.T)  # y ~ N(0, sigma^2 (I + tau^2 X X'))
        spread = 1.0 + tau2[..., None] * np.maximum(values, 0.0)
        squares = np.sum((vectors.T @ y) ** 2 / spread, axis=-1) / sigma2
        log = -0.5 * (squares + np.sum(np.log(spread), axis=-1)) - N * log_sigma + prior
        weights.append(log + np.sum(np.log(odds[list(chosen)])))
    total = np.array([np.logaddexp.reduce(w, axis=None) for w in weights])
    share = np.exp(total - np.logaddexp.reduce(total))
    return np.array([sum(p for s, p in zip(sets, share, strict=True) if j in s) for j in range(X.shape[1])])


@pytest.mark.parametrize("seed", [0, 1])
def test_inclusion_probabilities_are_those_of_the_sum_over_all_sets(seed):
    print("seed", seed)
    X, y = collinear(np.random.default_rng(seed))
    odds = np.array([0.1, 0.1, 0.2, 0.2, 0.1, 0.05])
    found = sample_sets(problem(X, y, odds), seed=seed)
    assert found.status is PosteriorStatus.CONVERGED
    exact = enumerated(X, y, odds)
    assert 0.2 < exact[0] < 0.8  # the copies share the probability
    error = 4.0 * np.sqrt(exact * (1.0 - exact) / found.ess)
    assert np.all(np.abs(found.probabilities(6) - exact) < np.maximum(error, 1e-3))


def test_independent_columns_have_the_closed_form_of_one():
    """Given sigma and tau the odds of each are multiplied by (1 + tau^2)^-1/2 exp(r^2 tau^2 / (1 + tau^2) / 2)."""
    rng = np.random.default_rng(3)
    X = np.linalg.qr(rng.standard_normal((N, MOST)))[0]
    y = X @ np.array([0.0, 2.0, 3.0, 4.0]) + rng.standard_normal(N)
    data = problem(X, y, np.full(MOST, 0.3))
    found = sample_sets(data, seed=3)
    tau2, right = found.slab[..., None] ** 2, data.right / found.noise[..., None]
    odds = 0.3 / np.sqrt(1.0 + tau2) * np.exp(0.5 * right**2 * tau2 / (1.0 + tau2))
    closed = np.mean(odds / (1.0 + odds), axis=(0, 1))
    assert np.all(np.abs(found.probabilities(MOST) - closed) < 4.0 * np.sqrt(0.25 / found.ess))
    assert closed[-1] > 0.5 > closed[0]


def test_two_of_two_hundred_collinear_columns_are_found():
    rng = np.random.default_rng(5)
    X = rng.standard_normal((400, 8)) @ rng.standard_normal((8, 200)) + 0.15 * rng.standard_normal((400, 200))
    X /= np.linalg.norm(X, axis=0)
    y = 15.0 * X[:, 3] - 12.0 * X[:, 50] + rng.standard_normal(400)
    found = sample_sets(problem(X, y, np.full(200, 1.0 / 200.0)), seed=5)
    assert found.status is PosteriorStatus.CONVERGED
    assert set(np.argsort(-found.probabilities(200))[:2]) == {3, 50}
    assert found.probability(3) > 0.95
    assert found.probability(50) > 0.95


def test_noise_alone_has_no_column():
    rng = np.random.default_rng(7)
    X, y = rng.standard_normal((400, 100)), rng.standard_normal(400)
    found = sample_sets(problem(X, y, np.full(100, 0.01)), seed=7)
    assert found.probabilities(100).max() < 0.5
