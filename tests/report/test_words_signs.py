"""Signs that no aircraft has are told; those that are right, or not sure, are not."""

import pytest

from bayes_aero.effects import CATALOGUE
from bayes_aero.parameter import Limits, Parameter, Prior, Sign
from bayes_aero.report.text.restraints import sign_sentences

PARAMETERS = [p for effect in CATALOGUE.values() for p in effect.parameters]


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
