"""Signs that no aircraft has are told; those that are right, or not sure, are not."""

import tomllib

import pytest
from linear_cards import SHORT_PERIOD

from bayes_aero.dynamics.linear import linear_dynamics
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card.card import parse_card, read_card
from bayes_aero.parameter import Limits, Parameter, Prior, Sign
from bayes_aero.report.text.restraints import sign_sentences

PARAMETERS = [p for effect in CATALOGUE.values() for p in effect.parameters]

LATERAL = {"Lbeta": -4.0, "Lda": -6.0, "Lp": -2.0, "Nbeta": 3.0, "Ndr": -1.7, "Nr": -0.5}


def test_an_elevator_that_raises_the_nose_is_told():
    (said,) = sign_sentences({"Cmde": (1.25, 0.002), "CLa": (5.0, 0.1), "CL0": (-0.2, 0.01)}, PARAMETERS)
    assert "Cmde = +1.25" in said
    assert "sign = -1" in said


@pytest.mark.parametrize("estimate", [(-1.25, 0.002), (0.01, 0.02)])
def test_right_or_unsure_signs_are_not(estimate):
    assert sign_sentences({"Cmde": estimate}, PARAMETERS) == []


@pytest.mark.parametrize(("name", "estimate"), [("CD0", (-0.099, 0.01)), ("CLa", (591.0, 400.0)), ("Cmq", (4.0, 0.5))])
def test_what_no_aircraft_has_is_impossible(name, estimate):
    (said,) = sign_sentences({name: estimate}, PARAMETERS)
    assert f"{name} = {estimate[0]:.4g} is impossible" in said


@pytest.mark.parametrize(("name", "estimate"), [("CD0", (-0.001, 0.01)), ("CLa", (6.0, 0.1)), ("Cmq", (0.5, 1.0))])
def test_what_may_be_chance_is_not(name, estimate):
    assert sign_sentences({name: estimate}, PARAMETERS) == []


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
