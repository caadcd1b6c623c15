"""What reports say of identifications, effects, changes, signs and trajectories, against numbers by hand."""

import io
import re
from dataclasses import replace
from string import Formatter
from types import SimpleNamespace
from typing import Any

import jsonschema
import numpy as np
import pytest
from calling import holds
from linear_cards import SHORT_PERIOD, card_of
from report_samples import flight, with_offsets
from rich.console import Console

from bayes_aero.diagnosis import result
from bayes_aero.dynamics.flight import linear_dynamics
from bayes_aero.effect import Untestable
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card import read_card
from bayes_aero.inference import results
from bayes_aero.jobs.documents import ChangePart, document_schema
from bayes_aero.jobs.store import plain
from bayes_aero.model.observations import Colour
from bayes_aero.parameter import Limits, Parameter, Prior, Sign
from bayes_aero.report import phrases, screen
from bayes_aero.report.pages import trajectories
from bayes_aero.report.pages.diagnosis import change_sentences, changes_table, sentences
from bayes_aero.report.pages.estimates import sign_sentences, verdict
from bayes_aero.report.pages.fly import disagreement_sentences, fly_sentences, outside
from bayes_aero.report.pages.identification import identification_screen
from bayes_aero.report.phrases import WORDS, filled, is_doubtful, nats_text, not_testable_sentences, several
from bayes_aero.report.table import Column, Table


def sentence(run, *words: str) -> str:
    """The one sentence with all of `words`."""
    (text,) = [s for s in verdict(run) if all(w in s for w in words)]
    return text


def silent(run, word: str) -> bool:
    return not any(word in s for s in verdict(run))


def test_where_everything_agrees_it_says_so_and_no_more(make):
    agree, engines = verdict(make(gp=False))
    holds(agree, "intervals agree", "1.00 to 1.00 times")
    assert engines.startswith("emcee and NUTS agree")


def test_true_values_stand_beside_estimates(make):
    run = make(gp=False, corrected=4.0)
    assert silent(run, "simulated")
    true = dict(zip(run.mle.names, run.mle.estimate, strict=True))
    true |= {"Cma": true["Cma"] + 0.03, "tau1": 0.0}  # three Cramer-Rao deviations, .75 corrected; one not fitted
    text = sentence(replace(run, truth=true), "simulated")
    holds(text, "of the 6 true parameters", "5 (ML, Cramér-Rao bound), 6 (ML, corrected bound)")
    holds(text, "Cma, -0.8 corrected standard errors")


WIDER = {"width": 4.0, "corrected": 4.0, "lag1": 0.9}
SLIGHT = {"apart": {"Cmde": -8.0}, "corrected": 4.0, "width": 4.0, "lag1": 0.9}
SAID = [  # how the run is made (None: as `full`), words of the one sentence, what it holds; None: there is no such one
    (None, "not white", ["Cm +0.90", "4 times"]),
    ({}, "not white", None),
    ({"lag1": 0.9, "corrected": 1.05}, "not white", None),  # coloured, but the bound does not care
    ({"corrected": 3.0, "width": 3.0}, "not white", ["longer lags"]),
    (None, "same assumption", ["does not support the bound"]),  # a white posterior is no second witness
    ({}, "same assumption", None),
    (None, "weighs the data differently", ["0.5 times the corrected"]),
    (WIDER, "weighs the data differently", None),
    (None, "mean function is wrong, or the residual", ["Cma (6.7)"]),  # 0.3 / hypot(0.02, 0.04)
    (WIDER, "mean function is wrong, or the residual", None),
    (None, "fitted alone", ["Cramér-Rao bound: Cmde (42.4)", "corrected bound: Cmde (10.6)"]),
    ({"apart": {"Cmde": 3.0}}, "fitted alone", None),
    (SLIGHT, "fitted alone", ["Cramér-Rao bound: Cmde (5.7); by the corrected bound: none"]),
    (None, "No noise model alone explains", ["Cmde is -0.800 from flight1 and -1.400 from flight2", "lacks an effect"]),
    (SLIGHT, "No noise model alone", None),
    (None, "GPR correlation", ["neighbours 40 ms away"]),
    ({}, "GPR correlation", ["does not leak significantly"]),
    (None, "maximum likelihood correlates better", ["CD"]),
    ({}, "correlates better", None),
    ({}, "posterior by NUTS", None),
]


@pytest.mark.parametrize(("made", "words", "parts"), SAID)
def test_the_verdict_speaks_where_results_disagree_and_else_is_silent(made, words, parts, full, make):
    run = full if made is None else make(**made)
    if parts is None:
        assert silent(run, words)
    else:
        holds(sentence(run, words), *parts)


def test_the_screen_names_what_noise_models_disagree_about(full, make):
    def doubts(run):
        return str(identification_screen(run, run.card, run.records).doubts)

    assert "Cmde" not in sentence(full, "mean function is wrong, or the residual")
    assert "maximum likelihood differ on Cma" in doubts(full)
    assert "maximum likelihood differ" not in doubts(make(**WIDER))


def test_engines_and_posteriors_that_disagree_or_did_not_finish(make):
    run = make(gp=False)
    other = make(shift={"CLa": 1.0}, width=1.3, gp=False).posteriors["nuts"]
    run = replace(run, posteriors=run.posteriors | {"nuts": other})
    assert "(CLa)" in sentence(run, "emcee and NUTS disagree", "Run longer")
    run = make()
    bad = replace(run.posteriors["nuts"], status=results.PosteriorStatus.DIVERGENT)
    run = replace(run, posteriors=run.posteriors | {"nuts": bad})
    assert "divergent transitions" in sentence(run, "posterior by NUTS")


def test_a_gp_whose_hyperparameters_were_not_sampled_is_named(make):
    run = make()
    object.__setattr__(run.gp.fits["CD"], "posterior", None)
    first = run.gp.splits["random"][0]
    first["CD"] = replace(first["CD"], status="refused: Pareto k too large.", k_hat=None)
    assert "refused: Pareto k too large" in sentence(run, "Gaussian process of CD")


def test_a_fit_that_failed_is_left_out_of_the_comparison(make):
    run = make(status=results.MleStatus.NOT_CONVERGED, corrected=4.0, lag1=0.9, gp=False)
    assert "stopped before the optimum" in verdict(run)[0]
    assert silent(run, "not white")
    assert silent(run, "agree;")
    run = make(apart={"Cmde": -60.0})
    run.alone["flight2"] = replace(run.alone["flight2"], status=results.MleStatus.STALL_NOT_IDENTIFIED)
    assert "left out of the comparison" in sentence(run, "flight2 alone")
    assert silent(run, "fitted alone")
    assert not silent(run, "intervals agree")


@pytest.mark.parametrize("engines", [(), ("emcee",), ("nuts", "white")])
def test_runs_that_are_not_finished_have_a_verdict_too(engines, make):
    for manoeuvres in (1, 2):
        assert verdict(make(manoeuvres=manoeuvres, engines=engines, gp=False))
    assert verdict(make(noise=Colour.WHITE, engines=engines, corrected=3.0, lag1=0.5))


CHANGE = result.ParameterChange(
    parameter="Cm0", unit="1", manoeuvre="run2", at=43.0, interval=(42.8, 43.4), lasts=True, before=(0.0591, 0.0011),
    after=(0.0651, 0.0012), size=(0.0060, 0.0005), share=0.62, p_value=0.005, gain=310.0,
)  # fmt: skip


@pytest.mark.parametrize(("changed", "parts"), [
    ({}, ("Cm0", "43.0 s of run2", "42.8 to 43.4 s", "0.0591 ± 0.0011", "0.0651 ± 0.0012", "0.00600 ± 0.00050")),
    ({}, ("62%", "trim or flaps", "centre of gravity")), ({"at": 0.0}, ("from run2 on",)),
    ({"at": 0.0, "lasts": False}, ("in run2",)), ({"lasts": False}, ("the value before in later records",)),
    ({"ambiguous_with": ("Cma", "CmX")}, ("Cma and CmX",)),
    ({"parameter": "tau2", "unit": "c/V"}, ("tau2",)),  # has no usual reasons
])  # fmt: skip
def test_a_change_is_reported_with_its_time_values_possible_reasons_and_rivals(changed, parts):
    (text,) = change_sentences([replace(CHANGE, **changed)])
    holds(text, *parts)
    assert ("reasons" in text) == (changed.get("parameter") != "tau2")


def test_a_change_is_reported_beside_the_verdict_and_is_no_cause(diagnosed):
    assert result.verdict_of([], [CHANGE]) is result.Verdict.UNEXPLAINED
    d = replace(diagnosed.view.diagnosis, verdict=result.Verdict.UNEXPLAINED, causes=(), unknown=(), changes=(CHANGE,))
    headline, *rest = sentences(d)
    assert headline.key == "verdict_nothing_explains"
    (said,) = change_sentences([CHANGE])
    assert said in rest
    holds(said, "Cm0", "run2")
    (row,) = changes_table(d).frame().reset_index().to_dict("records")
    columns = ("parameter", "at_low", "at_high", "size", "size_sd")
    assert tuple(row[column] for column in columns) == ("Cm0", 42.8, 43.4, 0.0060, 0.0005)
    schema = document_schema("diagnosis")
    written = plain(ChangePart.of(CHANGE))
    jsonschema.validate([written], schema["properties"]["changes"] | {"$defs": schema["$defs"]})
    assert written["size"] == {"mean": 0.0060, "sd": 0.0005}


LATERAL = {"Lbeta": -4.0, "Lda": -6.0, "Lp": -2.0, "Nbeta": 3.0, "Ndr": -1.7, "Nr": -0.5}


@pytest.mark.parametrize(("estimates", "parts"), [
    ({"Cmde": (1.25, 0.002), "CLa": (5.0, 0.1), "CL0": (-0.2, 0.01)}, ("Cmde = +1.25", "sign = -1")),
    ({"CD0": (-0.099, 0.01)}, ("CD0 = -0.099 is impossible",)),
    ({"CLa": (591.0, 400.0)}, ("CLa = 591 is impossible",)),
    ({"Cmq": (4.0, 0.5)}, ("Cmq = 4 is impossible",)),
    ({"Cmde": (-1.25, 0.002), "CLa": (6.0, 0.1)}, ()),  # right
    ({"Cmde": (0.01, 0.02), "CD0": (-0.001, 0.01), "Cmq": (0.5, 1.0)}, ()),  # not sure
])  # fmt: skip
def test_signs_and_sizes_that_no_aircraft_has_are_reported(estimates, parts):
    sentences = sign_sentences(estimates, [p for effect in CATALOGUE.values() for p in effect.parameters])
    assert len(sentences) == bool(parts)
    holds(" ".join(sentences), *parts)


def test_an_effect_of_the_user_declares_what_its_estimate_cannot_be():
    stick = Parameter(
        "Cm_stick", "1/rad", 0.0, 0.4, "moment per stick", Prior("normal", 0.4, 1.0),
        sign=Sign(1, "stick", "pulling would push the nose down"), limits=Limits(-5.0, 3.0, "no tail is so large"),
    )  # fmt: skip
    (wrong,) = sign_sentences({"Cm_stick": (-0.4, 0.01)}, [stick])
    holds(wrong, "Cm_stick = -0.4 has the wrong sign: pulling would push the nose down.", "sign of stick is reversed")
    (large,) = sign_sentences({"Cm_stick": (9.0, 0.1), "Cmde": (1.0, 0.01)}, [stick])
    assert "Cm_stick = 9 is impossible: no tail is so large" in large
    assert sign_sentences({"Cm_stick": (0.4, 0.01)}, [stick]) == []


def doubted(card, estimates, *fed):
    """Parameters of a linear card that no aircraft has so."""
    sentences = sign_sentences({n: (x, 0.1) for n, x in estimates.items()}, linear_dynamics(card).free, *fed)
    return sorted(text.split(" = ")[0] for text in sentences)


def test_linear_derivatives_have_the_signs_of_their_counterparts():
    """`fly` of a linear card asks as `identify` does; -1 times a channel turns the side round.

    The card has half of right less left aileron; the published fit of its records has these signs.
    """
    card, lateral = read_card("short_period"), read_card("attas_lateral")
    assert doubted(card, {"Mde": 42.3, "Mq": 33.0, "Malpha": 3.0}) == ["Mde", "Mq"]
    assert doubted(card, {"Mde": 42.3, "Mq": 33.0}, ("elevator",)) == ["Mq"]  # a surface that follows the outputs
    assert doubted(card, {"Mde": -4.0, "Mq": -1.2}) == doubted(lateral, LATERAL) == []
    assert doubted(lateral, {n: -x for n, x in LATERAL.items()}) == sorted(LATERAL)
    turned = card_of(SHORT_PERIOD.replace('Mde = "elevator"', "Mde = { elevator = -1.0 }"))
    assert doubted(turned, {"Mde": -4.0}) == ["Mde"]
    assert doubted(turned, {"Mde": 4.0}) == []


REASONS = {
    "canard_drag": Untestable.of(Untestable.NOT_RECORDED, ["canard"]),
    "canard_lift": Untestable.of(Untestable.NOT_RECORDED, ["canard"]),
    "dlc_lift": Untestable.of(Untestable.NOT_RECORDED, ["dlc_left", "dlc_right"]),
    "sideslip_drag": Untestable.of(Untestable.STILL, ["beta"]), "drag_offset": Untestable.of(Untestable.LACKING, ["e"]),
    "separation_lag": "a lag is a state of its own, {tried} later",
}  # fmt: skip


def test_one_sentence_counts_every_effect_once():
    (text,) = not_testable_sentences(REASONS)
    assert [*map(int, re.findall(r"(?:^|: |; )(\d+) ", text))] == [len(REASONS), 3, 1, 1, 1]
    holds(text, "canard, dlc_left and dlc_right", "channel beta", "has no e", "{tried} later")
    assert not_testable_sentences({}) == []


def test_sentences_read_lists_out_follow_their_length_and_write_errors():
    text = "{names} {names:is|are} {size:±{unit}} ({share:.0%})"
    for names, start in ((["a"], "a is"), (("a", "b"), "a and b are")):
        sentence = filled(text, names=names, size=(0.01, 0.001), unit="rad", share=0.5)
        assert sentence == f"{start} 0.573 ± 0.057 deg (50%)"
    assert filled("{n} {n:effect is|effects are}", n=1) == "1 effect is"
    assert several("abcd", 2) == "a and b and 2 more"
    for template in leaves([WORDS[part] for part in ("sentences", "messages", "tables")]):
        assert [*Formatter().parse(template)] or template == ""


def test_a_message_has_a_key_a_severity_a_text_and_what_to_do():
    assert {message["severity"] for message in WORDS["messages"].values()} == {"finding", "doubt", "error"}
    assert not set(WORDS["messages"]) & set(WORDS["sentences"])
    bound = {"b": SimpleNamespace(name="CL0"), "side": "lower", "bound": "0", "unit": "", "free": "-1", "moves": ""}
    message: Any = phrases.sentence("at_bound", **bound)
    assert (message.key, message.severity, message.do) == ("at_bound", "doubt", "Widen the bound, or fix CL0.")
    assert message.startswith("CL0 is at its lower bound, 0")
    assert message.endswith(message.do)
    answers = phrases.sentence("agree"), phrases.sentence("verdict_explained", n=1, names="")
    assert [is_doubtful(text) for text in (message, *answers)] == [True, False, False]


def leaves(words):
    """All texts of nested tables."""
    parts = words.values() if isinstance(words, dict) else words
    return [text for part in parts for text in ([part] if isinstance(part, str) else leaves(part))]


# Simulations, one-step predictions, gusts and a fit to trajectories
def test_claims_are_short_and_what_ended_badly_is_the_first_doubt():
    long = {key: m.get("claim", "") for key, m in WORDS["messages"].items() if len(m.get("claim", "").split()) > 25}
    assert not long
    slight, bad = (phrases.sentence(key, **values) for key, values in (
        ("caution", {"text": "Few blocks."}), ("ended", {"what": "NUTS", "status": "R-hat 1.4"})))  # fmt: skip
    assert screen.claims(screen.doubts_of(["An answer.", slight, bad])) == ["NUTS: R-hat 1.4.", "Few blocks."]


def test_a_screen_gives_up_rows_then_doubts_for_the_lines_it_has_and_says_what_is_left():
    table = Table([Column([f"p{k}" for k in range(40)], page="name")])
    whole = screen.Screen(["Fit."], ["Done.", table], ["a", "b", "c", "d"], ["x", "bayes-aero y", "z"])
    for lines in (28, 12, 9):
        console = Console(width=100, file=io.StringIO())
        console.print(whole.terminal(console, lines))
        text = console.file.getvalue()
        assert text.count("\n") <= lines
        assert "more on the page" in text
        assert "more doubt" in text
    changed = screen.Screen(["Fit."], ["Done now.", table], ["b"], []).changes(whole)
    assert (changed.record, changed.result, changed.doubts) == ([], ["Done now."], [])


def test_the_gain_is_that_of_unseen_flights_and_else_nothing_is_said(simulated):
    """Both halves are 1 deg off with the card's model and 0.1 deg with the extended one."""
    assert "α 1.0 → 0.10 deg" in trajectories.simulation_gain(simulated)
    fitted = tuple(p for p in simulated.paths if p.split == "fitted")
    same = tuple(replace(p, errors=simulated.paths[0].errors) for p in simulated.paths)
    assert [trajectories.simulation_gain(replace(simulated, paths=paths)) for paths in (fitted, same)] == ["", ""]


def test_a_lag_is_reported_with_its_size_and_what_it_stands_in_for(simulated):
    lag = result.LagTest("separation_lag", 25.4, True, (62.1, 15.5), ("tau2",))
    after = replace(simulated.extended, values={"tau1": 13.31}, units={"tau1": "c/V"})
    lagged = replace(simulated, extended=after, deviation={"tau1": 1.57}, lag=lag)
    (text,) = trajectories.lag_sentences(lagged)
    holds(text, "separation_lag in place of tau2", "tau1 13.3 ± 1.6 c/V", "62 ± 16")
    assert "(with separation_lag)" in trajectories.simulation_gain(lagged)
    assert trajectories.lag_sentences(simulated) == []


@pytest.mark.parametrize(("lag", "parts"), [
    ({"gain": 4.2, "unseen": (-1.0, 2.0)}, ("not support", "+4.2 nats", "-1.0 ± 2.0 nats")),
    ({"gain": 5.4, "slight": True}, ("too small", "+5.4 nats")),
    ({"gain": float("-inf")}, ("its fit did not converge",)),
])  # fmt: skip
def test_a_lag_that_is_not_supported_says_why(simulated, lag, parts):
    (text,) = trajectories.lag_sentences(replace(simulated, lag=result.LagTest("separation_lag", **lag)))
    holds(text, *parts)


def test_causes_that_hold_out_prediction_does_not_need_are_named_and_the_weakest_of_the_others(simulated):
    missed = {"thrust_moment": (900.0, 80.0), "thrust_scale": (-4.4, 16.1), "thrust_lift": (91.0, 20.7)}
    tested = replace(simulated, asked=result.Confirmation(("thrust_moment", "thrust_lift"), missed))
    assert tested.out == ("thrust_scale",)
    without, needed = trajectories.cause_sentences(tested)
    assert "thrust_scale (by -4 ± 16 nats)" in without
    holds(needed, "thrust_moment and thrust_lift", "thrust_lift, by 91 ± 21 nats")
    assert "(without thrust_scale)" in trajectories.simulation_gain(tested)
    lagged = replace(tested, lag=result.LagTest("separation_lag", 25.4, True, (62.1, 15.5)))
    assert "(with separation_lag and without thrust_scale)" in trajectories.simulation_gain(lagged)
    both = replace(simulated, asked=result.Confirmation((), {"a": (1.0, 1.0), "b": (0.0, 2.0)}))
    (text,) = trajectories.cause_sentences(both)
    holds(text, "a (by +1.0 ± 1.0 nats) and b (by +0.0 ± 2.0 nats)", "confirms")
    assert trajectories.cause_sentences(simulated) == []
    alone = replace(simulated, asked=result.Confirmation(("a",), {"a": (float("inf"), 0.0)}))
    assert trajectories.cause_sentences(alone) == ["Removing a degrades the prediction of hold-out trajectories."]


@pytest.mark.parametrize(
    ("gain", "sd", "text"),
    [(-269.3, 34.8, "-269 ± 35 nats"), (0.04, 0.02, "less than 0.1 nats"), (0.31, 0.24, "+0.3 ± 0.2 nats")],
)
def test_a_gain_is_never_nothing_plus_or_minus_nothing(gain, sd, text):
    assert nats_text(gain, sd, "+") == text


@pytest.mark.parametrize(("offsets", "share"), [((1.0, 3.0), 0.75), ((3.0, 1.0), 0.25)])
def test_time_outside_is_counted_over_all_manoeuvres_and_reported_if_it_is_most(offsets, share):
    """100 samples of 400 off by the first offset, deg, and 300 by the second, with a tolerance of 2 deg."""
    first, second = np.deg2rad(offsets)
    flown = with_offsets(flight().flown, {"one": 100, "two": 300}, {"one": first, "two": second})
    assert outside(flown) == {"alpha": pytest.approx(share)}
    text = " ".join(line for line in fly_sentences(flown) if "tolerances" in line)
    assert ("α 75% of the time" in text) == bool(text) == (share > 0.5)
    assert "diagnose" not in text, "it takes models of effects alone, and this one is linear"


def test_a_fit_that_may_come_nearer_or_stands_under_feedback_is_reported():
    flown = with_offsets(flight().flown, {"one": 100}, {"one": np.deg2rad(3.0)})
    early = replace(flown, fit=replace(flown.fit, status=results.OutputErrorStatus.NOT_CONVERGED))
    assert ["lacks an effect" in " ".join(fly_sentences(fit)) for fit in (flown, early)] == [True, False]
    flown = replace(flight().flown, following=("elevator",))
    doubt = "converged, but feedback and aircraft cannot be parted (elevator)"
    assert doubt in fly_sentences(flown)[0]
    # A single manoeuvre of some seconds is too short for diagnose.
    (text,) = disagreement_sentences([result.Disagreement("CLa", "1/rad", (4.3, 0.1), (3.4, 0.1), 6.4)], "too short")
    assert "diagnose" not in text
    assert "check looks for" in text


GUSTS = {"vertical_gust": (1.5, 0.1), "vertical_gust_length": (200.0, 30.0),
         "longitudinal_gust": (0.1, 0.2), "longitudinal_gust_length": (300.0, 200.0)}  # fmt: skip


def gust_sentences(**more):
    gusts = GUSTS | {"buffet": (0.05, 0.01), "buffet_length": (3.0, 0.5)} | more
    noise = result.ProcessNoise("converged", True, 20.0, {}, {}, {}, {}, gusts)
    return " ".join(trajectories.process_noise_sentences(noise, flight().flown))


def test_gusts_and_buffet_are_reported_in_their_own_units():
    text = gust_sentences()
    holds(text, "vertical 1.50 ± 0.10 m/s (scale length 200 ± 30 m)", "No longitudinal gusts")
    holds(text[text.index("Buffet") :], "0.050 ± 0.010", "3.00 ± 0.50 chords")


@pytest.mark.parametrize(("intensity", "none"), [((0.02, 0.01), True), ((0.021, 0.01), False)])
def test_an_intensity_within_two_standard_errors_is_none(intensity, none):
    assert ("No buffet" in gust_sentences(buffet=intensity)) is none


NUMBERS = ((0.5, 0.48, 0.04, 0.6), (0.9, 0.91, 0.02, 0.5), (0.95, 0.93, 0.02, 0.3), (0.99, 0.985, 0.004, 0.2))
SHARES = tuple(results.Share(*numbers) for numbers in NUMBERS)
LINE = np.array([[-1.0, -1.1, -1.4, -0.7], [0.0, 0.1, -0.2, 0.2], [1.0, 2.0, 0.7, 1.4]])


def predictions(**calibration: results.Calibration) -> results.OneStep:
    """Of alpha (0.2 deg) and q, each with these shares."""
    alike = results.Predicted(500, np.deg2rad(0.2), (1.02, 0.03), SHARES, results.Calibration.CALIBRATED, LINE)
    alpha, q, together = (
        replace(alike, calibration=calibration.get(n, alike.calibration)) for n in ("alpha", "q", "together")
    )
    return results.OneStep({"alpha": alpha, "q": q}, replace(together, count=1000, rms=None))


def test_shares_are_reported_with_their_errors():
    few = predictions()
    assert "α 93 % (± 2) and q 93 % (± 2)" in trajectories.prediction_sentences(few)[0]
    sharp = replace(SHARES[2], share=0.9512, sd=0.0031)
    many = replace(few, outputs={"q": replace(few.outputs["q"], shares=(*SHARES[:2], sharp, SHARES[3]))})
    assert "q 95.1 % (± 0.3)" in trajectories.prediction_sentences(many)[0]


@pytest.mark.parametrize(("calibration", "status", "parts"), [
    ({}, "calibrated", ("They are calibrated",)),
    ({"q": results.Calibration.UNDECIDED}, "undecided", ("not decided",)),
    (dict.fromkeys(("q", "together"), results.Calibration.TOO_NARROW), "not_calibrated", ("q and all", "too narrow")),
    ({"alpha": results.Calibration.NOT_NORMAL}, "not_calibrated", ("α", "normally distributed")),
    ({"q": results.Calibration.COLOURED}, "not_calibrated", ("q", "autocorrelated")),
    ({"alpha": results.Calibration.UNDECIDED, "q": results.Calibration.TOO_WIDE}, "not_calibrated", ("q", "too wide")),
])  # fmt: skip
def test_there_is_one_status(calibration, status, parts):
    predicted = predictions(**calibration)
    assert predicted.status == status
    text = trajectories.prediction_sentences(predicted)[1]
    holds(text, *parts)
    assert ("not calibrated" in text) == (status == "not_calibrated")


def test_the_table_has_units_and_per_cent():
    table = trajectories.one_step_table(predictions(q=results.Calibration.TOO_WIDE), {"alpha": "rad", "q": "rad/s"})
    head, *_ = rows = table.text().rows
    inside = "1.020 ± 0.030", "48.0 ± 4.0", "91.0 ± 2.0", "93.0 ± 2.0", "98.50 ± 0.40"
    assert head == ("α [deg]", "0.20", *inside, "calibrated")
    assert [(row[0], row[-1]) for row in rows[1:]] == [("q [deg/s]", "too wide"), ("all together", "calibrated")]
    assert rows[2][1] == "–"
