"""Blocks of one sample: the textbook's standard error of a mean."""

import numpy as np

from bayes_aero.inference.variance.block_jackknife import cluster_covariance, jackknife_covariance


def test_both_are_the_covariance_of_a_mean():
    """S/n with S = sum (x - mean)(x - mean)'/(n - 1)."""
    x = np.random.default_rng(5).standard_normal((12, 3)) @ [[1.0, 0.5, 0.0], [0.0, 2.0, 1.0], [0.0, 0.0, 3.0]]
    n, expected = len(x), np.cov(x.T) / len(x)
    without = np.array([np.delete(x, i, axis=0).mean(axis=0) for i in range(n)])
    np.testing.assert_allclose(jackknife_covariance(without - x.mean(axis=0)), expected, rtol=1e-12)
    np.testing.assert_allclose(cluster_covariance((x - x.mean(axis=0)) / n, np.arange(n)), expected, rtol=1e-12)


def test_samples_of_a_block_count_together():
    """Two copies of each sample say no more than one."""
    x = np.random.default_rng(6).standard_normal((8, 2))
    once = cluster_covariance(x, np.arange(8))
    np.testing.assert_allclose(cluster_covariance(np.repeat(x, 2, axis=0) / 2, np.repeat(np.arange(8), 2)), once)
