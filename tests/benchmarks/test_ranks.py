"""Ranks: their closed form, and a band that uniform ranks stay in and skewed ones leave."""

import numpy as np
from calibration import DRAWS, band_of, rank


def test_a_truth_has_as_many_draws_below_it_as_its_quantile_says():
    draws = np.arange(1000.0)[:, None] / 1000.0
    draws = np.random.default_rng(0).permutation(draws)
    assert rank(np.array([-1.0]), draws)[0] == 0
    assert rank(np.array([2.0]), draws)[0] == DRAWS
    assert abs(rank(np.array([0.25]), draws)[0] - 0.25 * DRAWS) < 3.0 * np.sqrt(0.25 * 0.75 * DRAWS)


def test_uniform_ranks_stay_in_the_band_as_often_as_it_says():
    """95 % simultaneous: of 200 sets, 190 are expected inside, with a deviation of 3.1."""
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
