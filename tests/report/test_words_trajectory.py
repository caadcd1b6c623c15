"""Sentences on simulations, against errors made by hand."""

from dataclasses import replace

import pytest

from bayes_aero.diagnosis.selection.backward_elimination import Confirmation
from bayes_aero.diagnosis.trajectories.results import LagTest
from bayes_aero.report.text.phrases import nats_text
from bayes_aero.report.text.trajectories import cause_sentences, lag_sentences, simulation_gain


def test_the_gain_is_that_of_unseen_flights(simulated):
    """Both halves are 1 deg off with the card's model and 0.1 deg with the extended one."""
    assert "α from 1.0 to 0.10 deg" in simulation_gain(simulated)


def test_without_unseen_flights_or_without_a_gain_nothing_is_said(simulated):
    fitted = tuple(p for p in simulated.paths if p.split == "fitted")
    same = tuple(replace(p, errors=simulated.paths[0].errors) for p in simulated.paths)
    for paths in (fitted, same):
        shown = object.__new__(type(simulated))
        for name in ("outputs", "card", "extended", "held"):
            object.__setattr__(shown, name, getattr(simulated, name))
        object.__setattr__(shown, "paths", paths)
        assert simulation_gain(shown) == ""


def test_a_lag_is_told_with_its_size_and_what_it_stands_in_for(simulated):
    lag = LagTest("separation_lag", 25.4, True, (62.1, 15.5), ("tau2",))
    after = replace(simulated.extended, values={"tau1": 13.31}, units={"tau1": "c/V"})
    lagged = replace(simulated, extended=after, deviation={"tau1": 1.57}, lag=lag)
    (said,) = lag_sentences(lagged)
    assert "supports separation_lag in place of tau2: tau1 13.3 ± 1.6 c/V" in said
    assert "62 ± 16" in said
    assert "the extended model (with separation_lag)" in simulation_gain(lagged)


def test_a_lag_that_is_not_wanted_says_why(simulated):
    asked = replace(simulated, lag=LagTest("separation_lag", 4.2, False, (-1.0, 2.0)))
    assert "do not support it (fit +4.2 nats, hold-out -1.0 ± 2.0 nats)" in lag_sentences(asked)[0]
    weak = replace(simulated, lag=LagTest("separation_lag", 1.2, False))
    assert "do not support it (fit +1.2 nats)" in lag_sentences(weak)[0]
    slight = replace(simulated, lag=LagTest("separation_lag", 5.4, slight=True))
    assert "give a size that is too small to be named (fit +5.4 nats)" in lag_sentences(slight)[0]
    lost = replace(simulated, lag=LagTest("separation_lag", float("-inf"), False))
    assert "its fit did not converge" in lag_sentences(lost)[0]
    assert lag_sentences(simulated) == []


def test_causes_that_flight_does_not_miss_are_told_and_the_weakest_of_the_others(simulated):
    missed = {"thrust_moment": (900.0, 80.0), "thrust_scale": (-4.4, 16.1), "thrust_lift": (91.0, 20.7)}
    asked = replace(simulated, asked=Confirmation(("thrust_moment", "thrust_lift"), missed))
    assert asked.out == ("thrust_scale",)
    without, misses = cause_sentences(asked)
    assert "Removing thrust_scale (by -4 ± 16 nats) does not significantly degrade" in without
    assert "the simulated model omits it" in without
    assert (
        misses == "Removing thrust_moment and thrust_lift degrades the prediction of hold-out trajectories (least for "
        "thrust_lift, by 91 ± 21 nats)."
    )
    (alone,) = cause_sentences(replace(simulated, asked=Confirmation(("thrust_lift",), {"thrust_lift": (91.0, 20.7)})))
    assert alone.endswith("degrades the prediction of hold-out trajectories (by 91 ± 21 nats).")
    assert "the extended model (without thrust_scale) changes the RMS error" in simulation_gain(asked)
    lagged = replace(asked, lag=LagTest("separation_lag", 25.4, True, (62.1, 15.5)))
    both_told = "the extended model (with separation_lag and without thrust_scale) changes the RMS error"
    assert both_told in simulation_gain(lagged)
    both = replace(simulated, asked=Confirmation((), {"a": (1.0, 1.0), "b": (0.0, 2.0)}))
    (said,) = cause_sentences(both)
    assert "a (by +1.0 ± 1.0 nats) and b (by +0.0 ± 2.0 nats)" in said
    assert "The search confirms them" in said
    assert said.endswith("the simulated model omits them.")
    assert cause_sentences(simulated) == []


def test_a_cause_without_which_nothing_flies_needs_no_number(simulated):
    alone = replace(simulated, asked=Confirmation(("a",), {"a": (float("inf"), 0.0)}))
    assert cause_sentences(alone) == ["Removing a degrades the prediction of hold-out trajectories."]


@pytest.mark.parametrize(
    ("gain", "sd", "text"),
    [(-269.3, 34.8, "-269 ± 35 nats"), (0.04, 0.02, "less than 0.1 nats"), (0.31, 0.24, "+0.3 ± 0.2 nats")],
)
def test_a_gain_is_never_nothing_plus_or_minus_nothing(gain, sd, text):
    assert nats_text(gain, sd, "+") == text
