"""The deviation of a gain on unseen data, against closed forms."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter
from test_mixing import part

from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.selection.cross_validation import LeftOut
from bayes_aero.diagnosis.view.holdout import compared
from bayes_aero.inference.variance.coloured_bounds import standard_error_of_sum
from bayes_aero.physics.coefficient_names import NAMES

LENGTHS = (600, 400)


def ar1(rng, a):
    """Stationary, two stretches that know nothing of each other, driven by unit white noise."""
    stretches = [lfilter([1.0], [1.0, -a], rng.standard_normal(n + 500))[500:] for n in LENGTHS]
    return np.concatenate(stretches)


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9])
def test_deviation_of_a_coloured_sum_is_its_closed_form(a):
    """Var of a sum of n values of AR(1) with unit innovations: n (1-a^2) - 2a(1 - a^n), over (1-a)^2 (1-a^2)."""
    exact = sum((n * (1 - a**2) - 2 * a * (1 - a**n)) / ((1 - a) ** 2 * (1 - a**2)) for n in LENGTHS)
    rng = np.random.default_rng(4132)
    found = np.mean([standard_error_of_sum(ar1(rng, a), LENGTHS) ** 2 for _ in range(300)])
    assert found == pytest.approx(exact, rel=0.2)  # low by a few per cent: the mean is taken out, lags are tapered


def test_stretches_that_are_not_neighbours_are_independent():
    """A series that jumps between its stretches: as one the colour counts across the jumps, as twenty it does not."""
    rng = np.random.default_rng(7)
    values = np.repeat(rng.standard_normal(20), 50)
    apart = standard_error_of_sum(values, [50] * 20)
    assert apart < standard_error_of_sum(values, [len(values)])


def test_a_comparison_by_manoeuvre_is_the_difference_of_plain_scores():
    """Two manoeuvres, three coefficients, known residuals: R2 and normal log densities formed by hand."""
    rng = np.random.default_rng(4132)
    m, second = 900, 350
    manoeuvre = np.repeat([0, 1], [m - second, second])
    measured = np.cumsum(rng.standard_normal((m, 3)), axis=0)
    noise_growth = 1.0 + rng.uniform(0.0, 3.0, (m, 1)) * np.ones(3)
    before, after = (
        LeftOut(size * rng.standard_normal((m, 3)), noise_growth, np.ones(m, bool), NAMES) for size in (2.0, 1.0)
    )
    variance_inflation = rng.uniform(1.0, 9.0)
    state = part(
        SelectionState,
        responses=SimpleNamespace(manoeuvre=manoeuvre),
        variance_inflation=variance_inflation,
        outputs=NAMES,
    )
    density = []
    for left in (before, after):
        deviation = np.sqrt(np.mean((left.residual / noise_growth) ** 2, axis=0)) * noise_growth
        density.append(stats.norm.logpdf(left.residual, 0.0, deviation))
    for k in (0, 1):
        found, here = compared(before, after, state, measured, k), manoeuvre == k
        for c, name in enumerate(("CL", "CD", "Cm")):
            r2 = [r2_score(measured[here, c], (measured - left.residual)[here, c]) for left in (before, after)]
            assert found[name].r2 == pytest.approx(r2[1] - r2[0], rel=1e-9)
            assert found[name].elpd == pytest.approx(
                (density[1] - density[0])[here, c].sum() / variance_inflation, rel=1e-9
            )
            assert found[name].r2_sd > 0.0
            assert 0.0 < found[name].elpd_sd < found[name].elpd


def r2_score(z, y):
    return 1.0 - np.sum((z - y) ** 2) / np.sum((z - z.mean()) ** 2)
