"""[aircraft]: what follows from other constants need not be stated."""

import re

import pytest

from bayes_aero.errors import InputError
from bayes_aero.flight.card.aircraft_table import parse_aircraft, refuse_no_body

STATED = {
    "mass": "377.281 slug", "Ix": "8197.35 slug-ft2", "Iy": "11710.5 slug-ft2", "Iz": "18736.8 slug-ft2",
    "Ixz": "0 slug-ft2", "wing_area": "377.93 ft2", "chord": "7.406 ft", "tail_arm": "19.94 ft",
}  # fmt: skip


@pytest.mark.parametrize("span", [{"span": "51.56 ft"}, {"half_span": "25.78 ft"}, {"span": "15.715488 m"}])
def test_the_aspect_ratio_is_span_squared_over_wing_area(span):
    aircraft = parse_aircraft({**STATED, **span}, "mine")
    assert aircraft.aspect_ratio == pytest.approx(51.56**2 / 377.93)
    assert aircraft.half_span == pytest.approx(25.78 * 0.3048)


def test_a_stated_aspect_ratio_holds():
    assert parse_aircraft({**STATED, "span": "51.56 ft", "aspect_ratio": 6.5}, "mine").aspect_ratio == 6.5


def test_span_and_half_of_it_are_one_constant():
    both = {**STATED, "span": "51.56 ft", "half_span": "20 ft"}
    with pytest.raises(InputError, match=re.escape("has span (51.56 ft) and half_span (20 ft); keep one")):
        parse_aircraft(both, "mine")
    with pytest.raises(InputError, match=r'has no half_span; .* or span = "... m"'):
        parse_aircraft(STATED, "mine")
    with pytest.raises(InputError, match=r"span is -1\.0 m; it must be positive"):
        parse_aircraft({**STATED, "span": "-1 m"}, "mine")


def test_inertia_that_no_body_has_is_refused():
    """Of any body each principal moment of inertia is at most the sum of the other two (Goldstein 1980, ch. 5)."""
    span = {"span": "51.56 ft"}
    refuse_no_body(parse_aircraft({**STATED, **span}, "mine"), "mine")
    refuse_no_body(parse_aircraft({**STATED, **span, "Iz": "19906 slug-ft2"}, "mine"), "mine")  # a flat plate
    for wrong in ({"Iz": "21000 slug-ft2"}, {"Ixz": "13000 slug-ft2"}):
        with pytest.raises(InputError, match="no body has these moments of inertia"):
            refuse_no_body(parse_aircraft({**STATED, **span, **wrong}, "mine"), "mine")
