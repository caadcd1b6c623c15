"""The log score on hold-out flights is a normal density in closed form, for segments of any length."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from bayes_aero.diagnosis.trajectories.log_score import HoldoutScore
from bayes_aero.diagnosis.trajectories.results import Path
from bayes_aero.report.figures.diagnosis import autocorrelation, spectrum

LENGTHS = (90, 91)  # the halves of a manoeuvre with an odd number of samples


def test_halves_that_differ_by_a_sample():
    rng = np.random.default_rng(1)
    missed, noise_growth = [rng.standard_normal((n, 1)) for n in LENGTHS], [np.full((n, 1), 2.0) for n in LENGTHS]
    paths = [
        Path("run", "extended", "hold_out", True, {}, 0.1 * np.arange(len(x)), {"q": x[:, 0]}, {"q": np.zeros(len(x))})
        for x in missed
    ]
    expected = np.concatenate(missed)[:, 0] / 2.0
    density = norm.logpdf(expected, scale=np.sqrt(np.mean(expected**2)))
    for _ in range(20):  # the type checker looks at one element of a sequence, drawn at random
        found = HoldoutScore.of(paths, ("q",), noise_growth)
    assert found.density() == pytest.approx(density)


def test_figures_of_manoeuvres_of_different_length():
    """White noise of variance 2: no correlation beyond lag 0, and twice the variance over the sampling rate."""
    rng = np.random.default_rng(2)
    parts = [np.sqrt(2.0) * rng.standard_normal(n) for n in (4000, 6000)]
    for _ in range(20):
        lags, correlation = autocorrelation(parts, 5)
        _, power = spectrum(parts, 0.1)
    assert list(lags) == [0, 1, 2, 3, 4, 5]
    assert correlation[0] == 1.0
    assert np.abs(correlation[1:]).max() < 4.0 / np.sqrt(10_000)
    assert power.mean() == pytest.approx(2.0 * 2.0 * 0.1, rel=0.05)
