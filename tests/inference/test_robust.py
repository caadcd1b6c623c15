"""Corrected bounds against variances that are known in closed form."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import norm, t

from bayes_aero.inference.variance.robust_bounds import robust_covariance

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


def test_noise_that_grows_with_the_sensitivity():
    """Var = sum x^2 sigma(x)^2 / (sum x^2)^2, here three times what one variance for all samples gives."""
    rng, n = np.random.default_rng(6), 4000
    x = rng.standard_normal(n)
    noise = x * rng.standard_normal(n)
    slope = x @ noise / (x @ x)
    exact = np.sum(x**4) / np.sum(x**2) ** 2
    found, _ = variance(x, (noise - slope * x)[:, None])
    assert found == pytest.approx(exact, rel=0.2)
    assert found > 2.5 * np.mean(noise**2) / np.sum(x**2)


def test_few_blocks_widen_by_students_t():
    """12 blocks for one parameter: over many records the variance is s^2/n times that of t with 11 degrees over 1.96^2,
    and HC3 adds the leverage of each block."""
    rng, n, found = np.random.default_rng(7), 12, []
    for _ in range(2000):
        noise = rng.standard_normal(n)
        found.append(variance(np.ones(n), (noise - noise.mean())[:, None])[0])
    widen = (t.ppf(0.975, n - 1) / norm.ppf(0.975)) ** 2
    assert np.mean(found) == pytest.approx(widen / (n - 1), rel=0.05)  # HC3: sum e^2/(1 - 1/n)^2/n^2 = s^2/(n - 1)


def test_blocks_are_a_fifth_of_a_second_long():
    noise = np.random.default_rng(8).standard_normal((500, 1))
    assert variance(np.ones(500), noise, dt=0.04)[1] == 100
