"""Noise records begin in the stationary distribution: every covariance is that of the autoregression."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import toeplitz
from statsmodels.tsa.arima_process import ArmaProcess

from bayes_aero.inference.variance.autoregression import stationary_series

ROOTS = {"fast": (0.6, -0.3, 0.1), "slow": (0.99, 0.9, -0.5), "pair": (0.8 + 0.4j, 0.8 - 0.4j, 0.2)}


@pytest.mark.parametrize("name", ROOTS)
def test_the_covariance_of_every_two_samples_is_the_autoregressions(name):
    phi, n = -np.real(np.poly(ROOTS[name]))[1:], 30
    response = stationary_series(phi[:, None], np.eye(n))  # of each unit innovation, side by side
    autocovariance = ArmaProcess(np.concatenate([[1.0], -phi])).acovf(n)
    np.testing.assert_allclose(response @ response.T, toeplitz(autocovariance), rtol=1e-7)


def test_a_record_shorter_than_the_order_is_stationary_too():
    phi = -np.real(np.poly(ROOTS["slow"]))[1:]
    response = stationary_series(phi[:, None], np.eye(2))
    autocovariance = ArmaProcess(np.concatenate([[1.0], -phi])).acovf(2)
    np.testing.assert_allclose(response @ response.T, toeplitz(autocovariance), rtol=1e-7)
