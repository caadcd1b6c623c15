"""An effect in two unlike manoeuvres: the gain of an addition by itself in closed form, and a whole diagnosis."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.screening.regression import Products
from bayes_aero.diagnosis.selection.cross_validation import integrated_deviance
from bayes_aero.effects import CATALOGUE
from bayes_aero.simulate.request import Request
from bayes_aero.simulate.synthetic_record import synthetic


def test_the_gain_is_the_bayes_factor_under_the_other_fold_s_posterior():
    """One addition, no parameter of the card: each fold's evidence with the normal prior that the other fold gives.

    Twice the log of a normal evidence, with the variance of each fold's residuals: squares at the joint estimate, and
    the log of how many times the fold narrows its prior.
    """
    rng, n = np.random.default_rng(2), 4000
    x = rng.standard_normal(2 * n)
    y = 0.2 * x + rng.standard_normal(2 * n)
    folds = (slice(0, n), slice(n, 2 * n))
    products = Products.of(y[:, None], np.stack([x, np.zeros_like(x)], axis=1)[:, None, :], folds)
    prior, nothing = (np.zeros(2), np.array([1e-9, 1.0])), np.array([1])
    expected = 0.0
    for own, other in ((folds[0], folds[1]), (folds[1], folds[0])):
        told = x[other] @ x[other] / np.var(y[other] - 0.2 * x[other])
        mean = x[other] @ y[other] / (x[other] @ x[other])
        S = x[own] @ x[own]
        variance = np.mean((y[own] - 0.2 * x[own]) ** 2)
        estimate = (S / variance * (x[own] @ y[own] / S) + told * mean) / (S / variance + told)
        left = np.sum((y[own] - estimate * x[own]) ** 2) / variance + told * (estimate - mean) ** 2
        before = n * np.log(np.mean(y[own] ** 2))
        after = n * np.log(variance) + (left - n) + np.log((S / variance + told) / told)
        expected += before - after
    found = 0.0
    for fold in (0, 1):
        with_it = integrated_deviance(products, fold, (np.array([0, 1]), nothing), prior, 1.0)
        found += integrated_deviance(products, fold, (nothing, nothing), prior, 1.0) - with_it
    assert found == pytest.approx(expected, rel=0.02)


def test_what_a_stall_and_a_multistep_show_is_named(card):
    """A fit to the multistep alone has no stall, with the effect or without."""
    hidden = {"alpha_dot_lift": {"CLadot": -9.5}}
    asked = {"elevator_3211": {}, "slow_stall": {"amplitude": 1.5, "airspeed": 114.7, "altitude": 5200.0}}
    records = [
        synthetic(Request(hidden, seed=53600 + 50 * k, manoeuvre=name, **more), card, CATALOGUE, name=name).record
        for k, (name, more) in enumerate(asked.items())
    ]
    found = diagnose(records, card, seed=536, gains_wanted=False, process_noise=False)
    (cause,) = found.causes
    size = cause.parameters["CLadot"]
    assert cause.name == "alpha_dot_lift"
    assert not found.unknown
    assert abs(size.mean + 9.5) < 3.0 * size.sd
