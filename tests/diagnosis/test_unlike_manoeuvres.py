"""An effect in two unlike manoeuvres: the gain of an addition by itself in closed form, and a whole diagnosis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import six_axes
from stranger_six import Plane, fly

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.result import Verdict
from bayes_aero.diagnosis.screening.regression import Products
from bayes_aero.diagnosis.selection.cross_validation import integrated_deviance
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card.card import read_card
from bayes_aero.report.text.diagnosis import diagnosis_sentences
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


def set_between(seed: int):
    """Three manoeuvres of 8 s of another simulator whose constants differ, as the recorded flap and rudder trim do."""
    rng, usual, planes, records = np.random.default_rng([seed, 53]), Plane(**six_axes.ATTACHED), [], []
    for k in range(3):
        constants = {"CL0": 0.03, "CD0": 0.004, "Cm0": 0.01}
        moved = {name: getattr(usual, name) + rng.normal(0.0, sd) for name, sd in constants.items()}
        planes.append(replace(usual, **moved))
        record = six_axes.record(f"m{k}", fly(planes[-1], "elevator", rng, dt=0.02, seconds=8.0), rng)
        rudder = record.channels["rudder"] + np.radians(rng.uniform(-3.0, 3.0))
        flap = np.full(record.n, np.radians(rng.uniform(0.0, 5.0)))
        channels = {**record.channels, "rudder": rudder, "flap": flap}
        records.append(replace(record, channels=channels))
    return planes, records


@pytest.fixture(scope="module")
def linear_card(tmp_path_factory):
    path = tmp_path_factory.mktemp("card") / "card.toml"
    text = six_axes.card_text(Plane(**six_axes.ATTACHED), six_axes.LONGITUDINAL, ("longitudinal",))
    path.write_text(text, encoding="utf-8")
    return read_card(str(path))


@pytest.mark.recovery
def test_what_is_set_between_manoeuvres_is_an_offset_and_no_cause(linear_card):
    planes, records = set_between(2)
    found = diagnose(records, linear_card, seed=1, gains_wanted=False, process_noise=False)
    assert found.verdict is Verdict.UNEXPLAINED
    assert not found.causes
    assert not found.terms
    assert not found.changes
    assert {(one.coefficient, one.channel) for one in found.unknown} == {(c, "manoeuvre") for c in ("CL", "CD", "Cm")}
    for one in found.unknown:
        if one.coefficient == "CD":  # the drag due to lift is in it
            continue
        for plane, (mean, sd) in zip(planes[1:], one.offsets.values(), strict=True):
            true = getattr(plane, f"{one.coefficient}0") - getattr(planes[0], f"{one.coefficient}0")
            assert abs(mean - true) < 4.0 * sd, one.coefficient
    for name in ("flap_lift", "flap_moment", "rudder_moment"):
        assert name in found.not_testable
    assert found.not_testable["flap_lift"] == "channel flap differs only between manoeuvres, as an offset does"
    said = " ".join(diagnosis_sentences(found))
    assert "The constant of Cm differs between manoeuvres" in said.replace("the constant", "The constant")
