"""What reports say of simulations, one-step predictions, gusts and a fit to trajectories, against numbers by hand."""

from dataclasses import replace

import numpy as np
import pytest
from calling import holds
from report_samples import flight, with_offsets
from rich.console import Console

from bayes_aero.diagnosis.result import Confirmation, Disagreement, LagTest, ProcessNoise
from bayes_aero.inference.results import Calibration, OneStep, OutputErrorStatus, Predicted, Share
from bayes_aero.report.page import page_table
from bayes_aero.report.pages.fly import disagreement_sentences, fly_sentences, outside, parameter_table
from bayes_aero.report.pages.trajectories import (
    cause_sentences,
    lag_sentences,
    one_step_table,
    prediction_sentences,
    process_noise_sentences,
    simulation_gain,
)
from bayes_aero.report.phrases import nats_text


def test_the_gain_is_that_of_unseen_flights_and_else_nothing_is_said(simulated):
    """Both halves are 1 deg off with the card's model and 0.1 deg with the extended one."""
    assert "α from 1.0 to 0.10 deg" in simulation_gain(simulated)
    fitted = tuple(p for p in simulated.paths if p.split == "fitted")
    same = tuple(replace(p, errors=simulated.paths[0].errors) for p in simulated.paths)
    assert [simulation_gain(replace(simulated, paths=paths)) for paths in (fitted, same)] == ["", ""]


def test_a_lag_is_told_with_its_size_and_what_it_stands_in_for(simulated):
    lag = LagTest("separation_lag", 25.4, True, (62.1, 15.5), ("tau2",))
    after = replace(simulated.extended, values={"tau1": 13.31}, units={"tau1": "c/V"})
    lagged = replace(simulated, extended=after, deviation={"tau1": 1.57}, lag=lag)
    (said,) = lag_sentences(lagged)
    assert all(part in said for part in ("separation_lag in place of tau2", "tau1 13.3 ± 1.6 c/V", "62 ± 16"))
    assert "(with separation_lag)" in simulation_gain(lagged)
    assert lag_sentences(simulated) == []


@pytest.mark.parametrize(
    ("lag", "parts"),
    [
        ({"gain": 4.2, "unseen": (-1.0, 2.0)}, ("not support", "+4.2 nats", "-1.0 ± 2.0 nats")),
        ({"gain": 1.2}, ("not support", "+1.2 nats")),
        ({"gain": 5.4, "slight": True}, ("too small", "+5.4 nats")),
        ({"gain": float("-inf")}, ("its fit did not converge",)),
    ],
)
def test_a_lag_that_is_not_wanted_says_why(simulated, lag, parts):
    (said,) = lag_sentences(replace(simulated, lag=LagTest("separation_lag", **lag)))
    assert all(part in said for part in parts), said


def test_causes_that_flight_does_not_miss_are_told_and_the_weakest_of_the_others(simulated):
    missed = {"thrust_moment": (900.0, 80.0), "thrust_scale": (-4.4, 16.1), "thrust_lift": (91.0, 20.7)}
    asked = replace(simulated, asked=Confirmation(("thrust_moment", "thrust_lift"), missed))
    assert asked.out == ("thrust_scale",)
    without, misses = cause_sentences(asked)
    assert "thrust_scale (by -4 ± 16 nats)" in without
    holds(misses, "thrust_moment and thrust_lift", "thrust_lift, by 91 ± 21 nats")
    (alone,) = cause_sentences(replace(simulated, asked=Confirmation(("thrust_lift",), {"thrust_lift": (91.0, 20.7)})))
    assert "(by 91 ± 21 nats)" in alone
    assert "(without thrust_scale)" in simulation_gain(asked)
    lagged = replace(asked, lag=LagTest("separation_lag", 25.4, True, (62.1, 15.5)))
    assert "(with separation_lag and without thrust_scale)" in simulation_gain(lagged)
    both = replace(simulated, asked=Confirmation((), {"a": (1.0, 1.0), "b": (0.0, 2.0)}))
    (said,) = cause_sentences(both)
    holds(said, "a (by +1.0 ± 1.0 nats) and b (by +0.0 ± 2.0 nats)", "confirms")
    assert cause_sentences(simulated) == []
    alone = replace(simulated, asked=Confirmation(("a",), {"a": (float("inf"), 0.0)}))
    assert cause_sentences(alone) == ["Removing a degrades the prediction of hold-out trajectories."]


@pytest.mark.parametrize(
    ("gain", "sd", "text"),
    [(-269.3, 34.8, "-269 ± 35 nats"), (0.04, 0.02, "less than 0.1 nats"), (0.31, 0.24, "+0.3 ± 0.2 nats")],
)
def test_a_gain_is_never_nothing_plus_or_minus_nothing(gain, sd, text):
    assert nats_text(gain, sd, "+") == text


DEGREE = np.deg2rad(1.0)


@pytest.mark.parametrize(("one", "two", "share"), [(1.0, 3.0, 0.75), (3.0, 1.0, 0.25)])
def test_time_outside_is_counted_over_all_manoeuvres_and_told_if_it_is_most(one, two, share):
    """100 samples of 400 off by `one` deg and 300 by `two`, with a tolerance of 2 deg."""
    flown = with_offsets(flight().flown, {"one": 100, "two": 300}, {"one": one * DEGREE, "two": two * DEGREE})
    assert outside(flown) == {"alpha": pytest.approx(share)}
    told = [line for line in fly_sentences(flown) if "tolerances" in line]
    assert len(told) == (share > 0.5)
    assert all("α 75% of the time" in said for said in told)
    assert not any("diagnose" in said for said in told), "it takes models of effects alone, and this one is linear"


def test_a_fit_that_may_come_nearer_or_stands_under_feedback_is_told():
    """It may still come nearer."""
    flown = with_offsets(flight().flown, {"one": 100}, {"one": 3.0 * DEGREE})
    assert any("lacks an effect" in line for line in fly_sentences(flown))
    early = replace(flown, fit=replace(flown.fit, status=OutputErrorStatus.NOT_CONVERGED))
    assert not any("lacks an effect" in line for line in fly_sentences(early))
    flown = replace(flight().flown, following=("elevator",))
    said = "converged, but feedback and aircraft cannot be parted (elevator)"
    assert said in fly_sentences(flown)[0]
    assert said in parameter_table(flown).terminal_title
    # A single manoeuvre of some seconds is too short for diagnose.
    (said,) = disagreement_sentences([Disagreement("CLa", "1/rad", (4.3, 0.1), (3.4, 0.1), 6.4)], "too short")
    assert "diagnose" not in said
    assert "check looks for" in said


GUSTS = {"vertical_gust": (1.5, 0.1), "vertical_gust_length": (200.0, 30.0),
         "longitudinal_gust": (0.1, 0.2), "longitudinal_gust_length": (300.0, 200.0)}  # fmt: skip


def gust_sentences(**more):
    met = GUSTS | {"buffet": (0.05, 0.01), "buffet_length": (3.0, 0.5)} | more
    return process_noise_sentences(ProcessNoise("converged", True, 20.0, {}, {}, {}, {}, met), flight().flown)


def test_gusts_and_buffet_are_told_in_their_own_units():
    said = " ".join(gust_sentences())
    holds(said, "vertical 1.50 ± 0.10 m/s (scale length 200 ± 30 m)", "No longitudinal gusts")
    (buffet,) = (sentence for sentence in gust_sentences() if sentence.startswith("Buffet"))
    holds(buffet, "0.050 ± 0.010", "3.00 ± 0.50 chords")


@pytest.mark.parametrize(("intensity", "none"), [((0.02, 0.01), True), ((0.021, 0.01), False)])
def test_an_intensity_within_two_standard_errors_is_none(intensity, none):
    assert any("No buffet" in said for said in gust_sentences(buffet=intensity)) is none


NUMBERS = ((0.5, 0.48, 0.04, 0.6), (0.9, 0.91, 0.02, 0.5), (0.95, 0.93, 0.02, 0.3), (0.99, 0.985, 0.004, 0.2))
SHARES = tuple(Share(*numbers) for numbers in NUMBERS)
LINE = np.array([[-1.0, -1.1, -1.4, -0.7], [0.0, 0.1, -0.2, 0.2], [1.0, 2.0, 0.7, 1.4]])


def predictions(**calibration: Calibration) -> OneStep:
    """Of alpha (0.2 deg) and q, each with these shares."""
    one = Predicted(500, np.deg2rad(0.2), (1.02, 0.03), SHARES, Calibration.CALIBRATED, LINE)
    outputs = {n: replace(one, calibration=calibration.get(n, one.calibration)) for n in ("alpha", "q")}
    together = calibration.get("together", one.calibration)
    return OneStep(outputs, replace(one, count=1000, rms=None, calibration=together))


def of(found: OneStep | None) -> ProcessNoise:
    return ProcessNoise("converged", True, 1.0, {}, {}, {}, {}, one_step=found)


def test_shares_are_told_with_their_errors():
    first, _ = prediction_sentences(predictions())
    assert "α 93 % (± 2) and q 93 % (± 2)" in first
    few = predictions()
    sharp = replace(SHARES[2], share=0.9512, sd=0.0031)
    found = replace(few, outputs={"q": replace(few.outputs["q"], shares=(*SHARES[:2], sharp, SHARES[3]))})
    assert "q 95.1 % (± 0.3)" in prediction_sentences(found)[0]


@pytest.mark.parametrize(
    ("calibration", "status", "parts"),
    [
        ({}, "calibrated", ("They are calibrated",)),
        ({"q": Calibration.UNDECIDED}, "undecided", ("not decided",)),
        (dict.fromkeys(("q", "together"), Calibration.TOO_NARROW), "not_calibrated", ("q and all", "too narrow")),
        ({"alpha": Calibration.NOT_NORMAL}, "not_calibrated", ("α", "normally distributed")),
        ({"q": Calibration.COLOURED}, "not_calibrated", ("q", "autocorrelated")),
        ({"alpha": Calibration.UNDECIDED, "q": Calibration.TOO_WIDE}, "not_calibrated", ("q", "too wide")),
    ],
)
def test_there_is_one_status(calibration, status, parts):
    found = predictions(**calibration)
    assert found.status == status
    said = prediction_sentences(found)[1]
    assert [part for part in parts if part not in said] == []
    assert ("not calibrated" in said) == (status == "not_calibrated")


def test_the_table_has_units_and_per_cent():
    table = one_step_table(predictions(q=Calibration.TOO_WIDE), {"alpha": "rad", "q": "rad/s"})
    head, *_ = rows = page_table(table).rows
    assert head == ("α [deg]", "0.20", "1.020(30)", "48(4)", "91(2)", "93(2)", "98.5(4)", "calibrated")
    assert [row[0] for row in rows] == ["α [deg]", "q [deg/s]", "all together"]
    assert rows[1][-1] == "too wide"
    assert rows[2][1] == "–"
    console = Console(width=80)
    with console.capture() as captured:
        console.print(table.terminal())
    assert "…" not in captured.get()
