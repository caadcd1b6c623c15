"""What a candidate is worth where folds have gaps between them, as those of a single manoeuvre do."""

import numpy as np
import pytest
from scipy.linalg import lstsq
from test_mixing import part

from bayes_aero.criticism.election import Projected
from bayes_aero.criticism.regression import Products
from bayes_aero.criticism.state import State


@pytest.mark.parametrize("gap", [0, 40])
def test_information_is_what_the_model_cannot_follow_in_the_folds(gap):
    """Against least squares on the folds alone; a candidate that the model follows everywhere has none."""
    rng = np.random.default_rng(gap)
    n, k = 900, 4
    folds = tuple(slice(begin, begin + 300 - gap) for begin in (0, 300, 600))
    S = np.cumsum(rng.standard_normal((n, 3, k + 2)), axis=0) + rng.uniform(3.0, 9.0, k + 2)
    S[:, :, k] = S[:, :, :k] @ rng.standard_normal(k)
    residual = rng.standard_normal((n, 3)) * [1.0, 0.1, 3.0]
    active = np.arange(k)
    fit = Products.of(residual, S, folds).fit(active, np.zeros(k + 2), np.zeros(k + 2))
    state = part(State, S=S, swell=np.ones((n, 3)), folds=folds)
    found = Projected(state, fit, [np.array([k]), np.array([k + 1])]).information

    inside = np.concatenate([np.arange(n)[fold] for fold in folds])
    A = (S[inside] / np.sqrt(fit.variance)[:, None]).reshape(-1, k + 2)
    left = A[:, k + 1] - A[:, :k] @ lstsq(A[:, :k], A[:, k + 1])[0]
    assert found[1, 1] == pytest.approx(left @ left, rel=1e-6)
    assert found[0, 0] < 1e-12 * (A[:, k] @ A[:, k])
