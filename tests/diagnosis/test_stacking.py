"""Stacking weights: against ArviZ and a grid, split between imitators, and with the true one of two that differ."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import xarray as xr

from bayes_aero.diagnosis.predictors import averaged
from bayes_aero.diagnosis.selection.stacking import resampled_weights, stacking_weights
from bayes_aero.diagnosis.settings import DEFAULT

N, BLOCKS = 800, 12
RHO = 0.8  # of the noise
INFLATION = (1.0 + RHO) / (1.0 - RHO)
FOLDS = slice(0, N // 2), slice(N // 2, N)


def normal(error, sd=1.0):
    return -0.5 * (error / sd) ** 2 - np.log(sd * np.sqrt(2.0 * np.pi))


def mixture(seed):
    """Densities of three predictors of data that the first two make in turn."""
    rng = np.random.default_rng(seed)
    y = rng.standard_normal(N) + np.where(rng.uniform(size=N) < 0.7, 1.5, -1.5)
    return np.stack([normal(y - 1.5), normal(y + 1.5), normal(y, 3.0)], axis=1)


@pytest.mark.parametrize("seed", [0, 1])
def test_weights_are_those_of_arviz(seed):
    print("seed", seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from arviz_stats import compare
        from arviz_stats.utils import ELPDData

        density = mixture(seed)
        elpd = {
            str(k): ELPDData(
                "loo",
                float(d.sum()),
                0.0,
                0.0,
                1,
                N,
                "log",
                False,
                0.7,
                elpd_i=xr.DataArray(d, dims="i"),
                pareto_k=None,
            )
            for k, d in enumerate(density.T)
        }
        known = compare(elpd, method="stacking")["weight"]
    assert stacking_weights(density, 1.0, prior=1.0) == pytest.approx([known[str(k)] for k in range(3)], abs=2e-3)


@pytest.mark.parametrize("inflation", [1.0, 8.0])
def test_weights_of_two_are_the_highest_of_a_grid(inflation):
    density, grid = mixture(3)[:, :2], np.linspace(1e-4, 1.0 - 1e-4, 9999)
    score = np.logaddexp(np.log(grid) + density[:, :1], np.log(1.0 - grid) + density[:, 1:]).sum(axis=0) / inflation
    best = grid[np.argmax(score + np.log(grid * (1.0 - grid)))]  # Dirichlet(2, 2)
    assert stacking_weights(density, inflation)[0] == pytest.approx(best, abs=2e-4)


def coloured(rng):
    noise, innovations = np.zeros(N), np.sqrt(1.0 - RHO**2) * rng.standard_normal(N)
    for t in range(1, N):
        noise[t] = RHO * noise[t - 1] + innovations[t]
    return noise


def two_models(rng, apart, size):
    """Truth of a first regressor, and both models fitted to the other half; `apart` is what the second has alone."""
    x1 = np.sin(np.linspace(0.0, 40.0, N))
    x2 = x1 + apart * np.cos(np.linspace(0.0, 33.0, N))
    y, found = size * x1 + coloured(rng), []
    for x in (x1, x2):
        mean, sd = np.zeros((N, 1)), np.zeros((N, 1))
        for fold, train in (FOLDS, FOLDS[::-1]):
            fitted = x[train] @ y[train] / (x[train] @ x[train])
            mean[fold, 0], sd[fold, 0] = fitted * x[fold], np.std(y[train] - fitted * x[train])
        found.append((mean, sd))
    density = np.stack([normal(y - m[:, 0], s[:, 0]) for m, s in found], axis=1)
    return size * x1, y, found, resampled_weights(density, np.arange(N) * BLOCKS // N, INFLATION, 0)


def test_imitators_share_the_weight_and_their_average_covers_the_truth():
    """What they predict differs by less than the noise: neither is chosen, and the average loses no coverage."""
    print("seeds 0 to 7")
    inside = []
    for seed in range(8):
        truth, y, models, found = two_models(np.random.default_rng(seed), 0.02, 1.5)
        assert 1.0 - DEFAULT.stacking_chosen < found[:, 0].mean() < DEFAULT.stacking_chosen
        mean, sd = averaged(models, y[:, None], FOLDS, INFLATION)
        assert np.max(np.abs(truth - mean[:, 0]) / sd[:, 0]) < 1.96
        inside.append([np.mean(np.abs(y - m[:, 0]) < 1.96 * s[:, 0]) for m, s in (*models, (mean, sd))])
    one, other, average = np.mean(inside, axis=0)
    assert average >= min(one, other) - 1.0 / N
    assert average > 0.9


def test_the_true_one_of_two_that_differ_is_chosen():
    print("seeds 0 to 4")
    for seed in range(5):
        *_, found = two_models(np.random.default_rng(seed), 1.0, 3.0)
        assert found[:, 0].mean() >= DEFAULT.stacking_chosen


def test_the_average_has_the_moments_of_the_mixture():
    """Two predictors at -1 and 1 of data that come from both alike: mean 0 and variance 1 + 1."""
    rng = np.random.default_rng(2)
    y = rng.standard_normal((N, 1)) + rng.choice([-1.0, 1.0], (N, 1))
    one = np.ones((N, 1))
    mean, sd = averaged([(-one, one), (one, one)], y, FOLDS, 1.0)
    assert mean == pytest.approx(np.zeros((N, 1)), abs=0.25)
    assert mean**2 + sd**2 == pytest.approx(np.full((N, 1), 2.0), abs=1e-12)
