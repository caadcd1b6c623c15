"""Conversions at the border."""

import math
import re
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayes_aero.errors import InputError
from bayes_aero.units import EXACT, FOLDED, canonical, from_si, quantity_to_si, same_unit, si_unit, spellings, to_si


@pytest.mark.parametrize(
    ("unit", "target", "one"),
    [
        ("deg", "rad", math.pi / 180), ("°", "rad", math.pi / 180), ("deg/s", "rad/s", math.pi / 180),
        ("deg/s2", "rad/s^2", math.pi / 180), ("deg/s**2", "rad/s^2", math.pi / 180),
        ("rpm", "rad/s", 2 * math.pi / 60), ("g", "m/s^2", 9.80665), ("m s-2", "m/s^2", 1.0), ("m/s2", "m/s^2", 1.0),
        ("kt", "m/s", 1852 / 3600), ("km/h", "m/s", 1 / 3.6), ("ft", "m", 0.3048), ("hPa", "Pa", 100.0),
        ("mbar", "Pa", 100.0), ("inHg", "Pa", 3386.389), ("degC", "K", 274.15), ("°C", "K", 274.15), ("%", "1", 0.01),
        ("-", "1", 1.0), ("", "1", 1.0), ("slug/ft3", "kg/m^3", 515.3788), ("lbf", "N", 4.448222), ("ms", "s", 1e-3),
        ("SLUG/FT^3", "kg/m^3", 515.3788), ("slugs per cubic foot", "kg/m^3", 515.3788), ("psf", "Pa", 47.88026),
        ("lb/ft2", "Pa", 47.88026), ("PSI", "Pa", 6894.757), ("in. Hg", "Pa", 3386.389),
        ("slug-ft2", "kg m^2", 1.355818), ("LBS", "N", 4.448222), ("lbs", "kg", 0.4535924), ("slug", "kg", 14.59390),
        ("FT/SEC", "m/s", 0.3048), ("fpm", "m/s", 5.08e-3), ("ft/sec**2", "m/s^2", 0.3048),
        ("KNOTS", "m/s", 0.5144444), ("KN", "m/s", 0.5144444), ("KN", "N", 1000.0), ("Deg_C", "K", 274.15),
        ("deg F", "K", 255.9278), ("DEG/SEC^2", "rad/s^2", 0.01745329), ("°/s/s", "rad/s^2", 0.01745329),
        ("G", "m/s^2", 9.80665), ("m/s/s", "m/s^2", 1.0), ("M/S", "m/s", 1.0), ("HPA", "Pa", 100.0),
        ("mb", "Pa", 100.0), ("mPa", "Pa", 1e-3), ("MPa", "Pa", 1e6), ("pct", "1", 0.01), ("µs", "s", 1e-6),
    ],
)  # fmt: skip
def test_known_factors(unit, target, one):
    """From slugs on they are those of NIST SP 811 (2008), appendix B.8."""
    np.testing.assert_allclose(to_si([1.0], unit, "x", target), [one], rtol=1e-6)
    np.testing.assert_allclose(from_si(to_si([0.3, 7.0], unit, "x", target), unit, "x", target), [0.3, 7.0], rtol=1e-12)


@pytest.mark.parametrize("word", sorted({*FOLDED, *EXACT}))
def test_every_spelling_of_the_table_is_a_unit_that_stays_itself(word):
    for unit in spellings(word):
        assert canonical(unit, si_unit(unit)) == unit
        assert same_unit(word, unit)
        assert np.isfinite(to_si(1.0, unit, "x"))


@pytest.mark.parametrize(
    ("text", "si", "unit"),
    [
        ("lbs", "N", "lbf"), ("lbs", "kg", "lb"), ("lb/ft2", "Pa", "lbf/ft^2"), ("lb/ft3", "kg/m^3", "lb/ft^3"),
        ("KN", "N", "kN"), ("KN", "m/s", "kt"), ("hectopascal", "Pa", "hPa"), ("deg (TED)", "rad", "deg"),
        ("FT MSL", "m", "ft"), ("% N1", "1", "%"), ("", None, None), ("left", None, None),
        ("g", "kg", "g"),  # never the gram, which fits
        ("MS", None, None), ("MPA", None, None), ("mpa", None, None), ("MM", None, None),  # which of two is open
    ],
)  # fmt: skip
def test_the_quantity_decides_between_two_meanings(text, si, unit):
    assert canonical(text, si) == unit


def test_base_units_where_no_target_is_known_and_the_result_is_a_copy():
    np.testing.assert_allclose(to_si([1.0, 2.0], "mm", "strain"), [1e-3, 2e-3])
    assert si_unit("deg/s") == "rad/s"
    assert si_unit("hPa") == "kg/m/s**2"
    assert si_unit("%") == "1"
    values = np.ones(3)
    assert to_si(values, "m", "x", "m") is not values


@pytest.mark.parametrize(("unit", "target", "words"), [
    *((unit, target, rf"'{unit}'.*'{target.replace('^', '.')}'.*unit") for unit, target in [
        ("Hz", "rad/s"), ("%", "rad"), ("1", "rad"), ("deg", "1"), ("m", "s"), ("kg", "m/s^2"), ("deg", "m")]),
    *((unit, "rad", ".* is not known; write it") for unit in [
        "degg", "m/", "9**9**9**9", "m**99", "2 m", "__import__('os')", "m" * 1000, "\0", "?"]),
])  # fmt: skip
def test_units_that_do_not_belong_together_or_are_unknown(unit, target, words):
    with pytest.raises(InputError, match=f"channel alpha: the unit {words}"):
        to_si([1.0], unit, "alpha", target)


@given(st.text(alphabet="mskgrade1239*/^()-. %°²", max_size=30) | st.text(max_size=30))
@settings(max_examples=200, deadline=2000)
def test_any_text_is_a_unit_or_an_input_error(text):
    with suppress(InputError):
        assert to_si([1.0], text, "x").shape == (1,)
    assert same_unit(text, "deg") in (True, False, None)


@pytest.mark.parametrize(("one", "other", "same"), [
    ("deg", "degrees", True), ("m/s2", "m/s^2", True), ("knots", "kt", True), ("deg", "rad", False),
    ("degC", "K", False), ("rad", "1", False), ("degrees_north", "deg", None), ("lbs", "lbf", True),
    ("lbs", "lb", True), ("lbs", "N", False), ("-", "deg", None), ("-", "%", False),  # a dash says nothing
    ("MS", "ms", None), ("MPA", "ms", None),  # where capitals tell two units apart they must be right
])  # fmt: skip
def test_same_unit(one, other, same):
    assert same_unit(one, other) is same


@pytest.mark.parametrize(
    ("value", "unit", "number"),
    [
        ("17631 kg", "kg", 17631.0), ("-0.02 m", "m", -0.02), ("11442 kg m^2", "kg m^2", 11442.0),
        ("0 deg", "rad", 0.0), ("0.1 deg/s", "rad/s", 0.1 * math.pi / 180), ("64.0m^2", "m^2", 64.0),
        ("1e3 lb", "kg", 453.59237), (7.22, "1", 7.22), ("50 %", "1", 0.5),
        ("230 slug", "kg", 230 * 14.593902937206365),
        ("25000 slug-ft^2", "kg m^2", 25000 * 14.593902937206365 * 0.3048**2), ("700 sq ft", "m^2", 700 * 0.3048**2),
        ("1000 lbs", "kg", 453.59237), ("1000 lbs", "N", 453.59237 * 9.80665),
    ],
)  # fmt: skip
def test_card_constants(value, unit, number):
    assert quantity_to_si(value, unit, "card: mass") == pytest.approx(number, rel=1e-12)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (5, 'without a unit; write e.g. "5 kg"'), ("5", "without a unit"), ("heavy", "finite number with its unit"),
        ("1e999 kg", "finite number"), (float("nan"), "finite number"), ("5 m", "'m' cannot be turned into 'kg'"),
        ("5 kgg", "'kgg' is not known"), (True, "number with its unit"), ([5], "number with its unit"),
    ],
)  # fmt: skip
def test_bad_card_constants(value, words):
    with pytest.raises(InputError, match=words) as caught:
        quantity_to_si(value, "kg", "card a.toml: [aircraft] mass")
    assert str(caught.value).startswith("card a.toml: [aircraft] mass")


@pytest.mark.parametrize(("weight", "kg"), [("12138.7 lbf", 5506.02), ("9806.65 N", 1000.0), ("20 kN", 2039.43)])
def test_a_weight_for_a_mass_is_refused_with_the_mass_to_write(weight, kg):
    """A pound of mass weighs a pound of force: 0.45359237 kg; one newton over 9.80665 m/s^2."""
    with pytest.raises(InputError) as told:
        quantity_to_si(weight, "kg", "mass")
    assert float(re.search(r'"([\d.]+) kg"', str(told.value))[1]) == pytest.approx(kg, rel=1e-5)
    assert quantity_to_si("1000 lb", "kg", "mass") == pytest.approx(453.59237)
