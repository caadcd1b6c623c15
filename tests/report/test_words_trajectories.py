"""What reports say of simulations, one-step predictions, gusts and a fit to trajectories, against numbers by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from report_samples import flight, with_offsets
from rich.console import Console

from bayes_aero.diagnosis.selection.backward_elimination import Confirmation
from bayes_aero.diagnosis.trajectories.results import Disagreement, LagTest, ProcessNoise
from bayes_aero.inference.likelihood.output_error_result import OutputErrorStatus
from bayes_aero.inference.scores import Calibration, OneStep, Predicted, Share
from bayes_aero.report.figures.pit import one_step_quantiles
from bayes_aero.report.html.page_table import page_table
from bayes_aero.report.style import NotDrawn
from bayes_aero.report.tables.filtered import one_step_table
from bayes_aero.report.tables.fly import parameter_table
from bayes_aero.report.text.fly import disagreement_sentences, fly_sentences, outside
from bayes_aero.report.text.phrases import nats_text
from bayes_aero.report.text.process_noise import prediction_sentences, process_noise_sentences
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


DEGREE = np.deg2rad(1.0)


def test_time_outside_is_counted_over_all_manoeuvres():
    """3 deg off for 300 samples of 400, with a tolerance of 2 deg."""
    flown = with_offsets(flight().flown, {"one": 100, "two": 300}, {"one": 1.0 * DEGREE, "two": 3.0 * DEGREE})
    assert outside(flown) == {"alpha": pytest.approx(0.75)}
    (said,) = [line for line in fly_sentences(flown) if "tolerances" in line]
    assert "α 75% of the time" in said
    assert "diagnose" not in said, "it takes models of effects alone, and this one is linear"


def test_nothing_is_said_where_it_stays_inside_most_of_the_time():
    """The same errors, the other way round: a quarter outside."""
    flown = with_offsets(flight().flown, {"one": 100, "two": 300}, {"one": 3.0 * DEGREE, "two": 1.0 * DEGREE})
    assert outside(flown) == {"alpha": pytest.approx(0.25)}
    assert not any("tolerances" in line for line in fly_sentences(flown))


def test_nothing_is_said_of_the_model_where_the_fit_has_not_converged():
    """It may still come nearer."""
    flown = with_offsets(flight().flown, {"one": 100}, {"one": 3.0 * DEGREE})
    assert any("lacks an effect" in line for line in fly_sentences(flown))
    early = replace(flown, fit=replace(flown.fit, status=OutputErrorStatus.NOT_CONVERGED))
    assert not any("lacks an effect" in line for line in fly_sentences(early))


def test_a_fit_under_feedback_alone_is_not_only_called_converged():
    flown = replace(flight().flown, following=("elevator",))
    said = "converged, but feedback and aircraft cannot be parted (elevator)"
    assert said in fly_sentences(flown)[0]
    assert said in parameter_table(flown).terminal_title


def test_nobody_is_sent_to_a_command_that_cannot_use_the_record():
    """A single manoeuvre of some seconds is too short for diagnose."""
    (said,) = disagreement_sentences([Disagreement("CLa", "1/rad", (4.3, 0.1), (3.4, 0.1), 6.4)], "too short")
    assert "diagnose" not in said
    assert "check looks for" in said


GUSTS = {"vertical_gust": (1.5, 0.1), "vertical_gust_length": (200.0, 30.0),
         "longitudinal_gust": (0.1, 0.2), "longitudinal_gust_length": (300.0, 200.0)}  # fmt: skip


def gust_sentences(**more):
    met = GUSTS | {"buffet": (0.05, 0.01), "buffet_length": (3.0, 0.5)} | more
    return process_noise_sentences(ProcessNoise("converged", True, 20.0, {}, {}, {}, {}, met), flight().flown)


def test_gusts_and_buffet_are_told_in_their_own_units():
    told = gust_sentences()
    assert "Estimated gusts, standard deviation: vertical 1.50 ± 0.10 m/s (scale length 200 ± 30 m)." in told
    assert "No longitudinal gusts are distinguishable from noise of the states." in told
    assert (
        "Buffet: the lift coefficient of fully separated flow fluctuates by 0.050 ± 0.010 (standard deviation; "
        "correlated over 3.00 ± 0.50 chords)."
    ) in told


@pytest.mark.parametrize(("intensity", "none"), [((0.02, 0.01), True), ((0.021, 0.01), False)])
def test_an_intensity_within_two_standard_errors_is_none(intensity, none):
    assert ("No buffet is distinguishable from noise of the states." in gust_sentences(buffet=intensity)) is none


SHARES = (
    Share(0.5, 0.48, 0.04, 0.6),
    Share(0.9, 0.91, 0.02, 0.5),
    Share(0.95, 0.93, 0.02, 0.3),
    Share(0.99, 0.985, 0.004, 0.2),
)
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
    assert first == (
        "One-step predictions: share of the samples inside their 95 % intervals: α 93 % (± 2) and q 93 % (± 2)."
    )
    few = predictions()
    sharp = replace(SHARES[2], share=0.9512, sd=0.0031)
    found = replace(few, outputs={"q": replace(few.outputs["q"], shares=(*SHARES[:2], sharp, SHARES[3]))})
    assert prediction_sentences(found)[0] == (
        "One-step predictions: share of the samples inside their 95 % intervals: q 95.1 % (± 0.3)."
    )


@pytest.mark.parametrize(
    ("calibration", "status", "said"),
    [
        ({}, "calibrated", "They are calibrated: no share departs"),
        ({"q": Calibration.UNDECIDED}, "undecided", "Whether they are calibrated is not decided"),
        (
            {"q": Calibration.TOO_NARROW, "together": Calibration.TOO_NARROW},
            "not_calibrated",
            "They are not calibrated: intervals of q and all outputs together are too narrow.",
        ),
        (
            {"alpha": Calibration.NOT_NORMAL, "q": Calibration.COLOURED},
            "not_calibrated",
            "They are not calibrated: innovations of α are not normally distributed; innovations of q are "
            "autocorrelated.",
        ),
        (
            {"alpha": Calibration.UNDECIDED, "q": Calibration.TOO_WIDE},
            "not_calibrated",
            "They are not calibrated: intervals of q are too wide.",
        ),
    ],
)
def test_there_is_one_status(calibration, status, said):
    found = predictions(**calibration)
    assert found.status == status
    assert prediction_sentences(found)[1].startswith(said)


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


def test_every_output_has_a_panel_with_its_status():
    figure = one_step_quantiles(of(predictions(alpha=Calibration.TOO_NARROW)))
    assert [ax.get_title() for ax in figure.axes] == ["α: too narrow", "q: calibrated", "all together: calibrated"]
    for ax in figure.axes:
        line = next(line for line in ax.lines if line.get_label() == "innovations")
        np.testing.assert_array_equal(line.get_xydata(), LINE[:, :2])
    alone = predictions()
    single = one_step_quantiles(of(replace(alone, outputs={"q": alone.outputs["q"]})))
    assert [ax.get_title() for ax in single.axes] == ["q: calibrated"]


def test_without_a_fit_nothing_is_drawn():
    with pytest.raises(NotDrawn, match="did not converge"):
        one_step_quantiles(of(None))
