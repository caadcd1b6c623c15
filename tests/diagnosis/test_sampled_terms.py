"""Terms as a regression under coloured noise: against generalised least squares with the whole covariance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag, toeplitz

from bayes_aero.diagnosis.screening.autocorrelation import Autocorrelation
from bayes_aero.diagnosis.terms.columns import columns_of
from bayes_aero.diagnosis.terms.sampled import regression

MEMORY, DEVIATION = np.array([0.7, 0.3, 0.6]), np.array([0.02, 0.003, 0.004])  # lag-1, and of the innovation


@pytest.fixture(scope="module")
def state(diagnosed):
    return diagnosed.view.diagnosis.aerodynamics.base


def generalised(state, column):
    """Estimate and information of one term beside the model, by the covariance of AR(1) noise of every fold and output.

    An autoregression of third order begins behind three samples, of which AR(1) noise remembers the last.
    """
    rows, blocks = [], []
    for fold in state.folds:
        for c, (phi, sigma) in enumerate(zip(MEMORY, DEVIATION, strict=True)):
            n = fold.stop - fold.start - 2
            stationary = sigma**2 / (1.0 - phi**2)
            blocks.append(np.linalg.inv(stationary * toeplitz(phi ** np.arange(n))))
            blocks[-1][0, 0] -= 1.0 / stationary  # given, not observed
            rows.append((slice(fold.start + 2, fold.stop), c))
    W = block_diag(*blocks)
    y, B, x = (
        np.concatenate([(part / growth)[own] for own in rows])
        for part, growth in (
            (state.residual, state.noise_growth),
            (state.S[:, :, state.columns()], state.noise_growth[:, :, None]),
            (column.component.basis[:, :, 0], state.noise_growth),
        )
    )
    prior = np.diag(state.precision[state.columns()] / state.variance_inflation)
    mean = state.mean[state.columns()]
    X = np.concatenate([x[:, None], B], axis=1)
    normal, right = X.T @ W @ X, X.T @ W @ y
    normal[1:, 1:] += prior
    right[1:] += prior @ mean
    scale = 1.0 / np.sqrt(np.diag(normal))
    inverse = np.linalg.inv(normal * np.outer(scale, scale)) * np.outer(scale, scale)
    return float((inverse @ right)[0]), float(1.0 / inverse[0, 0])


def test_inner_products_are_those_of_generalised_least_squares(state):
    columns = [c for c in columns_of(state, "Cm") if c.term.name in ("alpha^2", "qhat elevator", "elevator^2")]
    phi = np.stack([MEMORY, np.zeros(3), np.zeros(3)], axis=1)
    data, kept = regression(state, columns, Autocorrelation(phi, DEVIATION))
    assert kept == [0, 1, 2]
    assert np.diag(data.gram) == pytest.approx(np.ones(3), abs=1e-12)
    for column, right in zip(columns, data.right, strict=True):
        estimate, information = generalised(state, column)
        assert right == pytest.approx(estimate * np.sqrt(information), rel=1e-6)


def test_each_factor_halves_the_prior_and_one_term_is_expected(state):
    columns = columns_of(state, "Cm")
    colour = Autocorrelation(np.zeros((3, 3)), DEVIATION)
    data, kept = regression(state, columns, colour)
    odds = np.exp(data.log_odds)
    costs = np.array([columns[j].term.cost for j in kept])
    assert odds.sum() == pytest.approx(1.0)
    assert odds * 2.0**costs == pytest.approx(np.full(len(odds), odds[0] * 2.0 ** costs[0]))
    assert set(np.round(np.diag(data.gram), 9)) == {1.0}
