"""Corrected variances, blocks, splits and noise records, against what is known in closed form."""

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from scipy.stats import norm, t
from statsmodels.tsa.arima_process import ArmaProcess

from bayes_aero.errors import InputError
from bayes_aero.inference.covariance import (
    cluster_covariance,
    jackknife_covariance,
    robust_covariance,
    stationary_series,
)
from bayes_aero.inference.validation import BLOCK_SECONDS, make_splits

# Corrected bounds against variances that are known in closed form
BLOCK = 0.2


def variance(x, residual, dt=BLOCK):
    """Of the slope of one output on `x`."""
    R = np.mean(residual**2, axis=0)
    D = np.array([[R[0] / np.sum(x**2)]])
    start = np.arange(len(x)) == 0
    covariance, blocks = robust_covariance(D, x[:, None, None], R, residual, np.zeros(len(x), int), start, dt)
    return covariance[0, 0], blocks


@pytest.mark.parametrize("rho", [0.0, 0.6, 0.9])
def test_the_mean_of_a_first_order_autoregression(rho):
    """The variance of a sample mean of n samples tends to (1 + rho)/(1 - rho)/n."""
    rng, n, found = np.random.default_rng(5), 3000, []
    for _ in range(30):
        noise = np.asarray(lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], rng.standard_normal(n + 200)))[200:]
        found.append(variance(np.ones(n), (noise - noise.mean())[:, None])[0])
    assert np.mean(found) == pytest.approx((1.0 + rho) / (1.0 - rho) / n, rel=0.15)


def test_noise_that_grows_and_few_blocks_widen_the_variance():
    """Var = sum x^2 sigma(x)^2 / (sum x^2)^2, here three times what one variance for all samples gives."""
    rng, n = np.random.default_rng(6), 4000
    x = rng.standard_normal(n)
    noise = x * rng.standard_normal(n)
    slope = x @ noise / (x @ x)
    exact = np.sum(x**4) / np.sum(x**2) ** 2
    found, _ = variance(x, (noise - slope * x)[:, None])
    assert found == pytest.approx(exact, rel=0.2)
    assert found > 2.5 * np.mean(noise**2) / np.sum(x**2)
    noise = np.random.default_rng(8).standard_normal((500, 1))
    assert variance(np.ones(500), noise, dt=0.04)[1] == 100
    # 12 blocks for one parameter: over many records the variance is s^2/n times that of t with 11 degrees over
    # 1.96^2, and HC3 adds the leverage of each block.
    rng, n, found = np.random.default_rng(7), 12, []
    for _ in range(2000):
        noise = rng.standard_normal(n)
        found.append(variance(np.ones(n), (noise - noise.mean())[:, None])[0])
    widen = (t.ppf(0.975, n - 1) / norm.ppf(0.975)) ** 2
    assert np.mean(found) == pytest.approx(widen / (n - 1), rel=0.05)  # HC3: sum e^2/(1 - 1/n)^2/n^2 = s^2/(n - 1)


# Blocks of one sample: the textbook's standard error of a mean
def test_jackknife_and_clusters_have_the_covariance_of_a_mean():
    """S/n with S = sum (x - mean)(x - mean)'/(n - 1)."""
    x = np.random.default_rng(5).standard_normal((12, 3)) @ [[1.0, 0.5, 0.0], [0.0, 2.0, 1.0], [0.0, 0.0, 3.0]]
    n, expected = len(x), np.cov(x.T) / len(x)
    without = np.array([np.delete(x, i, axis=0).mean(axis=0) for i in range(n)])
    np.testing.assert_allclose(jackknife_covariance(without - x.mean(axis=0)), expected, rtol=1e-12)
    np.testing.assert_allclose(cluster_covariance((x - x.mean(axis=0)) / n, np.arange(n)), expected, rtol=1e-12)
    # Two copies of each sample say no more than one.
    x = np.random.default_rng(6).standard_normal((8, 2))
    once = cluster_covariance(x, np.arange(8))
    np.testing.assert_allclose(cluster_covariance(np.repeat(x, 2, axis=0) / 2, np.repeat(np.arange(8), 2)), once)


# Noise records begin in the stationary distribution: every covariance is that of the autoregression
ROOTS = {"fast": (0.6, -0.3, 0.1), "slow": (0.99, 0.9, -0.5), "pair": (0.8 + 0.4j, 0.8 - 0.4j, 0.2)}


@pytest.mark.parametrize(("name", "n"), [*((name, 30) for name in ROOTS), ("slow", 2)])
def test_the_covariance_of_every_two_samples_is_the_autoregressions(name, n):
    """Also of a record that is shorter than the order."""
    phi = -np.real(np.poly(ROOTS[name]))[1:]
    response = stationary_series(phi[:, None], np.eye(n))  # of each unit innovation, side by side
    autocovariance = ArmaProcess(np.concatenate([[1.0], -phi])).acovf(n)
    np.testing.assert_allclose(response @ response.T, toeplitz(autocovariance), rtol=1e-7)


# Every split is a partition, and holds back what its name says
DT = 0.04


@pytest.fixture(params=range(4))
def index(request):
    rng = np.random.default_rng(request.param)
    return np.repeat(np.arange(rng.integers(2, 4)), rng.integers(1500, 3100))


@pytest.mark.parametrize("kind", ["random", "block", "manoeuvre"])
def test_each_split_is_a_partition_in_time_order(kind, index):
    for split in make_splits(kind, index, DT, seed=3):
        both = np.concatenate([split.train_idx, split.test_idx])
        assert np.array_equal(np.sort(both), np.arange(index.size))
        assert np.all(np.diff(split.train_idx) > 0)
        assert np.all(np.diff(split.test_idx) > 0)


def test_splits_have_the_papers_size_ten_groups_or_are_unknown():
    (split,) = make_splits("random", np.zeros(5052, int), DT, seed=0)
    assert split.train_idx.size == 3536
    index = np.repeat(np.arange(25), 4)
    folds = make_splits("manoeuvre", index, 0.04, 0)
    assert len(folds) == 10
    assert np.array_equal(np.sort(np.concatenate([f.test_idx for f in folds])), np.arange(100))
    for fold in folds:
        assert not set(index[fold.test_idx]) & set(index[fold.train_idx])
    with pytest.raises(Exception, match="alternate"):  # InputError, or the type hook before it
        make_splits("alternate", np.zeros(100, int), DT, 0)


@pytest.mark.parametrize("kind", ["random", "block"])
def test_the_seed_decides(kind, index):
    first, again, other = (make_splits(kind, index, DT, seed=s)[0].train_idx for s in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_blocks_are_contiguous_and_each_manoeuvre_is_held_back_once(index):
    (split,) = make_splits("block", index, DT, seed=5)
    length = round(BLOCK_SECONDS / DT)
    test = np.isin(np.arange(index.size), split.test_idx)
    for m in np.unique(index):
        part = test[index == m]
        assert 0.25 < part.mean() < 0.35
        edges = np.flatnonzero(np.diff(part))
        assert np.all(np.diff(edges) >= length)  # no run shorter than a block
    splits = make_splits("manoeuvre", index, DT, seed=0)
    held = [np.unique(index[s.test_idx]).tolist() for s in splits]
    assert held == [[m] for m in np.unique(index)]
    for s in splits:
        assert not np.intersect1d(index[s.train_idx], index[s.test_idx]).size


@pytest.mark.parametrize(("kind", "index", "says"), [
    ("manoeuvre", np.zeros(100, int), "at least two records"),
    ("block", np.zeros(150, int), "too few for two blocks"), ("random", np.zeros(3, int), "at least 10 samples"),
])  # fmt: skip
def test_what_cannot_be_split_is_refused_in_words(kind, index, says):
    with pytest.raises(InputError, match=says):
        make_splits(kind, index, DT, 0)
