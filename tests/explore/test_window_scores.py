"""Errors and likelihood in a window, against closed forms and SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from bayes_aero.errors import InputError
from bayes_aero.explore.asked import Asked, read_asked
from bayes_aero.explore.scores import gain, scores

N = 200
RNG = np.random.default_rng(7)
WINDOW = np.arange(N) >= 50
RECORDED = {"alpha": RNG.standard_normal(N), "q": RNG.standard_normal(N)}
BEFORE = {name: x + 0.3 * RNG.standard_normal(N) for name, x in RECORDED.items()}
NOW = {name: x + 0.2 * RNG.standard_normal(N) for name, x in RECORDED.items()}


def test_errors_are_those_of_the_window():
    alpha, q = scores(RECORDED, BEFORE, NOW, WINDOW, {"alpha": 0.25})
    wrong = (NOW["alpha"] - RECORDED["alpha"])[50:]
    assert alpha.now == pytest.approx(np.linalg.norm(wrong) / np.sqrt(150.0), rel=1e-12)
    assert alpha.within == np.count_nonzero(np.abs(wrong) <= 0.25) / 150
    assert alpha.within_before < alpha.within
    assert (q.within, q.within_before) == (None, None)


def test_the_gain_is_the_difference_of_normal_log_densities():
    sd = {"alpha": 0.3, "q": 0.5}

    def density(simulated):
        return sum(norm.logpdf((RECORDED[n] - simulated[n])[WINDOW], scale=x).sum() for n, x in sd.items())

    assert gain(RECORDED, BEFORE, NOW, WINDOW, sd, 1.0) == pytest.approx(density(NOW) - density(BEFORE), rel=1e-12)
    assert gain(RECORDED, BEFORE, NOW, WINDOW, sd, 25.0) == pytest.approx((density(NOW) - density(BEFORE)) / 25.0)
    assert gain(RECORDED, BEFORE, BEFORE, WINDOW, sd, 1.0) == 0.0


SENT = '{"id": 3, "manoeuvre": 1, "window": [2, 5], "values": {"CLa": 3.5}, "off": ["a"], "added": ["b", "b"], "fan": true, "export": null}'  # noqa: E501


def test_what_the_page_sends_is_read():
    assert read_asked(SENT) == Asked(3, 1, (2.0, 5.0), {"CLa": 3.5}, ("a",), ("b",), True, "")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("3.5", "NaN"),
        ("3.5", '"x"'),
        ("null", '"../../etc"'),
        ("[2, 5]", "[2]"),
        ("null}", "null"),
        ('"id": 3', '"i": 3'),
    ],
)
def test_what_it_never_sends_is_one_sentence(old, new):
    text = SENT.replace(old, new)
    assert text != SENT
    with pytest.raises(InputError, match=r"the page sent what it never sends .*; load it again"):
        read_asked(text)
