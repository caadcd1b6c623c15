"""Signs that no aircraft has are told; those that are right, or not sure, are not."""

import pytest

from bayes_aero.report.text.impossible_estimates import sign_sentences


def test_an_elevator_that_raises_the_nose_is_told():
    (said,) = sign_sentences({"Cmde": (1.25, 0.002), "CLa": (5.0, 0.1), "CL0": (-0.2, 0.01)})
    assert "Cmde = +1.25" in said
    assert "sign = -1" in said


@pytest.mark.parametrize("estimate", [(-1.25, 0.002), (0.01, 0.02)])
def test_right_or_unsure_signs_are_not(estimate):
    assert sign_sentences({"Cmde": estimate}) == []


@pytest.mark.parametrize(("name", "estimate"), [("CD0", (-0.099, 0.01)), ("CLa", (591.0, 400.0)), ("Cmq", (4.0, 0.5))])
def test_what_no_aircraft_has_is_impossible(name, estimate):
    (said,) = sign_sentences({name: estimate})
    assert f"{name} = {estimate[0]:.4g} is impossible" in said


@pytest.mark.parametrize(("name", "estimate"), [("CD0", (-0.001, 0.01)), ("CLa", (6.0, 0.1)), ("Cmq", (0.5, 1.0))])
def test_what_may_be_chance_is_not(name, estimate):
    assert sign_sentences({name: estimate}) == []
