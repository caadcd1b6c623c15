"""The deviation of a gain on unseen data, against closed forms."""

import numpy as np
import pytest
from scipy.signal import lfilter

from bayes_aero.criticism.gain import deviation_of_sum

LENGTHS = (600, 400)


def ar1(rng, a):
    """Stationary, two stretches that know nothing of each other, driven by unit white noise."""
    stretches = [lfilter([1.0], [1.0, -a], rng.standard_normal(n + 500))[500:] for n in LENGTHS]
    return np.concatenate(stretches)


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9])
def test_deviation_of_a_coloured_sum_is_its_closed_form(a):
    """Var of a sum of n values of AR(1) with unit innovations: n (1-a^2) - 2a(1 - a^n), over (1-a)^2 (1-a^2)."""
    exact = sum((n * (1 - a**2) - 2 * a * (1 - a**n)) / ((1 - a) ** 2 * (1 - a**2)) for n in LENGTHS)
    rng = np.random.default_rng()
    found = np.mean([deviation_of_sum(ar1(rng, a), LENGTHS) ** 2 for _ in range(300)])
    assert found == pytest.approx(exact, rel=0.2)  # low by a few per cent: the mean is taken out, lags are tapered


def test_stretches_that_are_not_neighbours_are_independent():
    """A series that jumps between its stretches: as one the colour counts across the jumps, as twenty it does not."""
    rng = np.random.default_rng(7)
    values = np.repeat(rng.standard_normal(20), 50)
    apart = deviation_of_sum(values, [50] * 20)
    assert apart < deviation_of_sum(values, [len(values)])
