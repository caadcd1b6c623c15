"""What reports say of an identification and of effects: where results disagree and why, wrong signs, changes."""

import re
import tomllib
from dataclasses import replace
from pathlib import Path
from string import Formatter
from types import SimpleNamespace

import jsonschema
import pytest
from calling import holds
from linear_cards import SHORT_PERIOD

from bayes_aero.diagnosis.result import ParameterChange, Verdict, verdict_of
from bayes_aero.dynamics.flight import linear_dynamics
from bayes_aero.effect import Untestable
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card import parse_card, read_card
from bayes_aero.inference.results import MleStatus, PosteriorStatus
from bayes_aero.jobs.documents import ChangePart, document_schema
from bayes_aero.jobs.store import plain
from bayes_aero.model.observations import Colour
from bayes_aero.parameter import Limits, Parameter, Prior, Sign
from bayes_aero.report import phrases
from bayes_aero.report.pages.diagnosis import change_sentences, changes_table, diagnosis_sentences
from bayes_aero.report.pages.estimates import sign_sentences, verdict
from bayes_aero.report.pages.identification import headline
from bayes_aero.report.phrases import WORDS, filled, is_doubtful, not_testable_sentences, several


def sentence(run, *words: str) -> str:
    """The one sentence with all of `words`."""
    found = [s for s in verdict(run) if all(w in s for w in words)]
    assert len(found) == 1, (words, verdict(run))
    return found[0]


def silent(run, word: str) -> bool:
    return not any(word in s for s in verdict(run))


def test_where_everything_agrees_it_says_so_and_no_more(make):
    run = make(gp=False)
    sentences = verdict(run)
    assert len(sentences) == 2, sentences
    assert "intervals agree" in sentences[0]
    assert "1.00 to 1.00 times" in sentences[0]
    assert sentences[1].startswith("emcee and NUTS agree")


def test_what_was_flown_stands_beside_what_was_found(make):
    run = make(gp=False, corrected=4.0)
    assert silent(run, "simulated")
    flown = dict(zip(run.mle.names, run.mle.estimate, strict=True))
    flown |= {"Cma": flown["Cma"] + 0.03, "tau1": 0.0}  # three Cramer-Rao deviations, .75 corrected; one not fitted
    text = sentence(replace(run, truth=flown), "simulated")
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
    (None, "Fitted alone", ["Cramér-Rao bound: Cmde (42.4)", "corrected bound: Cmde (10.6)"]),
    ({"apart": {"Cmde": 3.0}}, "Fitted alone", None),
    (SLIGHT, "Fitted alone", ["Cramér-Rao bound: Cmde (5.7); by the corrected bound: none"]),
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
        assert all(part in sentence(run, words) for part in parts), sentence(run, words)


def test_the_headline_names_what_noise_models_disagree_about(full, make):
    assert "Cmde" not in sentence(full, "mean function is wrong, or the residual")
    assert "noise models disagree about Cma" in headline(full)
    assert "disagree" not in headline(make(**WIDER))


def test_engines_and_posteriors_that_disagree_or_did_not_finish(make):
    run = make(gp=False)
    other = make(shift={"CLa": 1.0}, width=1.3, gp=False).posteriors["nuts"]
    run = replace(run, posteriors=run.posteriors | {"nuts": other})
    assert "(CLa)" in sentence(run, "emcee and NUTS disagree", "Run longer")
    run = make()
    bad = replace(run.posteriors["nuts"], status=PosteriorStatus.DIVERGENT)
    run = replace(run, posteriors=run.posteriors | {"nuts": bad})
    assert "divergent transitions" in sentence(run, "posterior by NUTS")


def test_a_gp_whose_hyperparameters_were_not_sampled_is_named(make):
    run = make()
    object.__setattr__(run.gp.fits["CD"], "posterior", None)
    first = run.gp.splits["random"][0]
    first["CD"] = replace(first["CD"], status="refused: Pareto k too large.", k_hat=None)
    assert "refused: Pareto k too large" in sentence(run, "Gaussian process of CD")


def test_a_fit_that_failed_is_left_out_of_the_comparison(make):
    run = make(status=MleStatus.NOT_CONVERGED, corrected=4.0, lag1=0.9, gp=False)
    sentences = verdict(run)
    assert "stopped before the optimum" in sentences[0]
    assert silent(run, "not white")
    assert silent(run, "agree;")
    run = make(apart={"Cmde": -60.0})
    run.alone["flight2"] = replace(run.alone["flight2"], status=MleStatus.STALL_NOT_IDENTIFIED)
    assert "left out of the comparison" in sentence(run, "flight2 alone")
    assert silent(run, "Fitted alone")
    assert not silent(run, "intervals agree")


@pytest.mark.parametrize("engines", [(), ("emcee",), ("nuts", "white")])
def test_runs_that_are_not_finished_have_a_verdict_too(engines, make):
    for manoeuvres in (1, 2):
        assert verdict(make(manoeuvres=manoeuvres, engines=engines, gp=False))
    assert verdict(make(noise=Colour.WHITE, engines=engines, corrected=3.0, lag1=0.5))


CHANGE = ParameterChange(
    parameter="Cm0", unit="1", manoeuvre="run2", at=43.0, interval=(42.8, 43.4), lasts=True, before=(0.0591, 0.0011),
    after=(0.0651, 0.0012), size=(0.0060, 0.0005), share=0.62, p_value=0.005, gain=310.0,
)  # fmt: skip


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({}, ("Cm0", "43.0 s of run2", "42.8 to 43.4 s", "0.0591 ± 0.0011", "0.0651 ± 0.0012", "0.00600 ± 0.00050")),
        ({}, ("62%", "trim or flaps", "centre of gravity")), ({"at": 0.0}, ("from run2 on",)),
        ({"at": 0.0, "lasts": False}, ("in run2",)), ({"lasts": False}, ("the value before in later records",)),
        ({"ambiguous_with": ("Cma", "CmX")}, ("Cma and CmX",)),
        ({"parameter": "tau2", "unit": "c/V"}, ("tau2",)),  # has no usual reasons
    ],
)  # fmt: skip
def test_a_change_is_told_with_its_time_values_possible_reasons_and_rivals(changed, said):
    (text,) = change_sentences([replace(CHANGE, **changed)])
    assert [part for part in said if part not in text] == [], text
    assert ("reasons" in text) == (changed.get("parameter") != "tau2")


def test_the_verdict_names_the_parameter_and_the_record_and_a_change_is_no_cause(diagnosed):
    assert verdict_of([], [CHANGE]) is Verdict.UNEXPLAINED
    d = replace(diagnosed.view.diagnosis, verdict=Verdict.UNEXPLAINED, causes=(), unknown=(), changes=(CHANGE,))
    headline, *rest = diagnosis_sentences(d)
    assert "Cm0 changes in run2" in headline
    assert change_sentences([CHANGE])[0] in rest
    (row,) = changes_table(d).frame().reset_index().to_dict("records")
    assert (row["parameter"], row["at_low"], row["at_high"]) == ("Cm0", 42.8, 43.4)
    assert (row["size"], row["size_sd"]) == (0.0060, 0.0005)


def test_what_is_written_follows_the_schema():
    schema = document_schema("diagnosis")
    one = schema["properties"]["changes"] | {"$defs": schema["$defs"]}
    written = plain(ChangePart.of(CHANGE))
    jsonschema.validate([written], one)
    assert written["size"] == {"mean": 0.0060, "sd": 0.0005}
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate([written | {"at": -1.0}], one)


PARAMETERS = [p for effect in CATALOGUE.values() for p in effect.parameters]

LATERAL = {"Lbeta": -4.0, "Lda": -6.0, "Lp": -2.0, "Nbeta": 3.0, "Ndr": -1.7, "Nr": -0.5}


@pytest.mark.parametrize(
    ("estimates", "said"),
    [
        ({"Cmde": (1.25, 0.002), "CLa": (5.0, 0.1), "CL0": (-0.2, 0.01)}, ("Cmde = +1.25", "sign = -1")),
        ({"CD0": (-0.099, 0.01)}, ("CD0 = -0.099 is impossible",)),
        ({"CLa": (591.0, 400.0)}, ("CLa = 591 is impossible",)),
        ({"Cmq": (4.0, 0.5)}, ("Cmq = 4 is impossible",)),
        ({"Cmde": (-1.25, 0.002)}, ()),  # right
        ({"Cmde": (0.01, 0.02)}, ()),  # not sure, as the next two
        ({"CD0": (-0.001, 0.01)}, ()),
        ({"Cmq": (0.5, 1.0)}, ()),
        ({"CLa": (6.0, 0.1)}, ()),
    ],
)
def test_signs_and_sizes_that_no_aircraft_has_are_told(estimates, said):
    found = sign_sentences(estimates, PARAMETERS)
    assert len(found) == bool(said)
    assert all(part in found[0] for part in said)


def test_an_effect_of_the_user_declares_what_its_estimate_cannot_be():
    stick = Parameter(
        "Cm_stick", "1/rad", 0.0, 0.4, "moment per stick", Prior("normal", 0.4, 1.0),
        sign=Sign(1, "stick", "pulling would push the nose down"), limits=Limits(-5.0, 3.0, "no tail is so large"),
    )  # fmt: skip
    (wrong,) = sign_sentences({"Cm_stick": (-0.4, 0.01)}, [stick])
    assert wrong.startswith("Cm_stick = -0.4 has the wrong sign: pulling would push the nose down.")
    assert "sign of stick is reversed" in wrong
    (large,) = sign_sentences({"Cm_stick": (9.0, 0.1), "Cmde": (1.0, 0.01)}, [stick])
    assert "Cm_stick = 9 is impossible: no tail is so large" in large
    assert sign_sentences({"Cm_stick": (0.4, 0.01)}, [stick]) == []


def test_linear_derivatives_have_the_signs_of_their_counterparts():
    """`fly` of a linear card asks as `identify` does; -1 times a channel turns the side round.

    The card has half of right less left aileron; the published fit of its records has these signs.
    """
    free = {p.name: p for p in linear_dynamics(read_card("short_period")).free}
    wrong = sign_sentences({"Mde": (42.3, 2.3), "Mq": (33.0, 1.9), "Malpha": (3.0, 0.1)}, free.values())
    assert [said.split(" = ")[0] for said in wrong] == ["Mde", "Mq"]
    assert "sign = -1" in wrong[0]
    fed = sign_sentences({"Mde": (42.3, 2.3), "Mq": (33.0, 1.9)}, free.values(), ("elevator",))
    assert not any("sign" in said for said in fed), "a surface that only follows the outputs says nothing of signs"
    assert sign_sentences({"Mde": (-4.0, 0.1), "Mq": (-1.2, 0.1)}, free.values()) == []
    lateral = {p.name: p for p in linear_dynamics(read_card("attas_lateral")).free}
    right, wrong = ({n: (side * x, 0.1) for n, x in LATERAL.items()} for side in (1.0, -1.0))
    assert sign_sentences(right, lateral.values()) == []
    assert sorted(said.split(" = ")[0] for said in sign_sentences(wrong, lateral.values())) == sorted(LATERAL)
    text = SHORT_PERIOD.replace('Mde = "elevator"', "Mde = { elevator = -1.0 }")
    turned = {p.name: p for p in linear_dynamics(parse_card(tomllib.loads(text), "turned", "turned.toml")).free}
    assert [said.split(" = ")[0] for said in sign_sentences({"Mde": (-4.0, 0.1)}, turned.values())] == ["Mde"]
    assert sign_sentences({"Mde": (4.0, 0.1)}, turned.values()) == []


REASONS = {
    "canard_drag": Untestable.of(Untestable.NOT_RECORDED, ["canard"]),
    "canard_lift": Untestable.of(Untestable.NOT_RECORDED, ["canard"]),
    "dlc_lift": Untestable.of(Untestable.NOT_RECORDED, ["dlc_left", "dlc_right"]),
    "sideslip_drag": Untestable.of(Untestable.STILL, ["beta"]), "drag_offset": Untestable.of(Untestable.LACKING, ["e"]),
    "separation_lag": "a lag is a state of its own, {tried} later",
}  # fmt: skip


def test_one_sentence_counts_every_effect_once():
    (said,) = not_testable_sentences(REASONS)
    first, *counts = map(int, re.findall(r"(?:^|: |; )(\d+) ", said))
    assert first == sum(counts) == len(REASONS)
    assert counts == [3, 1, 1, 1]
    holds(said, "canard, dlc_left and dlc_right", "channel beta", "has no e", "{tried} later")
    assert not_testable_sentences({}) == []


def test_sentences_read_lists_out_follow_their_length_and_write_errors():
    text = "{names} {names:is|are} {size:±{unit}} ({share:.0%})"
    one, two = (filled(text, names=names, size=(0.01, 0.001), unit="rad", share=0.5) for names in (["a"], ("a", "b")))
    assert (one, two) == ("a is 0.573 ± 0.057 deg (50%)", "a and b are 0.573 ± 0.057 deg (50%)")
    assert filled("{n} {n:effect is|effects are}", n=1) == "1 effect is"
    assert several("abcd", 2) == "a and b and 2 more"
    assert all(parse(text) for part in ("sentences", "messages", "tables") for text in leaves(WORDS[part]))


def test_a_message_has_a_key_a_severity_a_text_and_what_to_do():
    messages = WORDS["messages"]
    assert {one["severity"] for one in messages.values()} == {"finding", "doubt", "error"}
    assert not set(messages) & set(WORDS["sentences"])
    source = "".join(path.read_text("utf-8") for path in Path(phrases.__file__).parents[1].rglob("*.py"))
    assert not [
        key for key in messages if f'"{key}"' not in source and key.partition("_")[0] not in ("verdict", "model")
    ]
    bound = {"b": SimpleNamespace(name="CL0"), "side": "lower", "bound": "0", "unit": "", "free": "-1", "moves": ""}
    said = phrases.sentence("at_bound", **bound)
    assert (said.key, said.severity, said.do) == ("at_bound", "doubt", "Widen the bound, or fix CL0.")
    assert said.startswith("CL0 is at its lower bound, 0")
    assert said.endswith(said.do)
    answers = phrases.sentence("agree"), phrases.sentence("verdict_explained", n=1, names="")
    assert [is_doubtful(one) for one in (said, *answers)] == [True, False, False]


def leaves(words):
    """All texts of nested tables."""
    return [text for one in words.values() for text in (leaves(one) if isinstance(one, dict) else [one])]


def parse(text):
    """The fields of a template; ValueError if it is none."""
    return list(Formatter().parse(text)) or [()]
