"""Sections of a card: the aircraft, channels formed from others, linear systems, the envelope."""

import re
import tomllib

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from linear_cards import SHORT_PERIOD, SHORT_PERIOD_TRUTH, card_of, record_of, short_period_flight

from bayes_aero.diagnosis.result import CheckReport, SensorCheck
from bayes_aero.errors import InputError
from bayes_aero.flight.card import (
    channel_units,
    parse_aircraft,
    parse_card,
    parse_envelope,
    refuse_no_body,
    shipped_cards,
)
from bayes_aero.flight.health import Consistency
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.check import check_records
from bayes_aero.model.model import Model
from bayes_aero.model.records import with_sums
from bayes_aero.physics.aircraft import DEFAULT_RANGES
from bayes_aero.report.pages.check import card_sentences

# [aircraft]: what follows from other constants need not be stated
STATED = {
    "mass": "377.281 slug", "Ix": "8197.35 slug-ft2", "Iy": "11710.5 slug-ft2", "Iz": "18736.8 slug-ft2",
    "Ixz": "0 slug-ft2", "wing_area": "377.93 ft2", "chord": "7.406 ft", "tail_arm": "19.94 ft",
}  # fmt: skip
SPAN = {"span": "51.56 ft"}


@pytest.mark.parametrize("span", [SPAN, {"half_span": "25.78 ft"}, {"span": "15.715488 m"}])
def test_the_aspect_ratio_is_span_squared_over_wing_area(span):
    aircraft = parse_aircraft({**STATED, **span})
    assert aircraft.aspect_ratio == pytest.approx(51.56**2 / 377.93)
    assert aircraft.half_span == pytest.approx(25.78 * 0.3048)
    assert parse_aircraft({**STATED, **span, "aspect_ratio": 6.5}).aspect_ratio == 6.5


@pytest.mark.parametrize(("span", "words"), [
    ({**SPAN, "half_span": "20 ft"}, re.escape("has span (51.56 ft) and half_span (20 ft); keep one")),
    ({}, r'has no half_span; .* or span = "... m"'), ({"span": "-1 m"}, r"span is -1\.0 m; it must be positive"),
    # Of any body each principal moment of inertia is at most the sum of the other two (Goldstein 1980, ch. 5).
    ({**SPAN, "Iz": "21000 slug-ft2"}, "no body has these moments of inertia"),
    ({**SPAN, "Ixz": "13000 slug-ft2"}, "no body has these moments of inertia"),
])  # fmt: skip
def test_an_aircraft_that_cannot_be_is_refused(span, words):
    refuse_no_body(parse_aircraft({**STATED, **SPAN, "Iz": "19906 slug-ft2"}))  # a flat plate
    with pytest.raises(InputError, match=words):
        refuse_no_body(parse_aircraft({**STATED, **span}))


# What a card forms from recorded channels: sums with factors, density and Mach number by rule, tables
CARD = """
[channels]
time = { label = "t", unit = "s" }
q = { label = "q", unit = "rad/s" }
airspeed = { label = "V", unit = "m/s" }
mach = { label = "M", unit = "1" }
n1_left = { label = "n1", unit = "%", required = false }
shaft = { label = "shaft", unit = "rpm", required = false }
elevator_left = { label = "del", unit = "deg" }
elevator_right = { label = "der", unit = "deg" }
dynamic_pressure = { label = "qbar", unit = "psf", required = false }
static_pressure = { label = "ps", unit = "hPa", required = false }
static_temperature = { label = "ts", unit = "K", required = false }
density = { label = "rho", unit = "slug/ft^3", required = false }
[sums]
elevator = { elevator_left = 0.5, elevator_right = 0.5 }
roll_tail = { elevator_left = 0.5, elevator_right = -0.5 }
thrust = ["thrust_left", "thrust_right"]
[derived]
density = "dynamic pressure"
[tables.thrust_left]
unit = "lbf"
from = { n1_left = { unit = "%", points = [40, 60, 100] }, mach = { unit = "1", points = [0.2, 0.4] } }
values = [[200, 100], [600, 500], [2000, 1600]]
[tables.thrust_right]
unit = "kN"
values = [0, 6]
[tables.thrust_right.from.shaft]
unit = "rpm"
points = [1000, 4000]
[linear]
states = ["q"]
[linear.rates.q]
Mde = "elevator"
"""
N = 60
LBF = 0.45359237 * 9.80665


def input_card(edit=None):
    table = tomllib.loads(CARD)
    if edit is not None:
        edit(table)
    return parse_card(table, "x", "x.toml")


def input_record(**channels):
    base = {
        "q": 0.0, "airspeed": 80.0, "mach": 0.25, "elevator_left": 0.04, "elevator_right": 0.01,
        "n1_left": 0.5, "shaft": 2500.0 * 2.0 * np.pi / 60.0,
    } | channels  # fmt: skip
    arrays = {name: np.broadcast_to(x, N).astype(float) for name, x in base.items() if x is not None}
    return FlightRecord.from_arrays("run", np.arange(N) * 0.04, arrays)


def test_channels_are_formed_by_sums_and_tables_which_check_reports():
    formed = with_sums(input_record(), input_card())
    np.testing.assert_allclose(formed["elevator"], 0.025, rtol=1e-14)
    np.testing.assert_allclose(formed["roll_tail"], 0.015, rtol=1e-14)
    # N1 50 % is halfway from 40 to 60, Mach 0.25 a quarter of the way: 400 lbf at Mach 0.2, 300 lbf at 0.4.
    np.testing.assert_allclose(formed["thrust_left"], 375.0 * LBF, rtol=1e-12)
    np.testing.assert_allclose(formed["thrust_right"], 3000.0, rtol=1e-12)  # 2500 rpm is halfway
    np.testing.assert_allclose(formed["thrust"], 375.0 * LBF + 3000.0, rtol=1e-12)
    assert channel_units(input_card())["thrust_left"] == "N"
    formed = with_sums(input_record(n1_left=1.0, mach=0.4), input_card())
    np.testing.assert_allclose(formed["thrust_left"], 1600.0 * LBF, rtol=1e-12)
    formed = with_sums(input_record(thrust_left=1000.0, density=0.9, dynamic_pressure=3000.0), input_card())
    np.testing.assert_array_equal(formed["thrust_left"], 1000.0)
    np.testing.assert_array_equal(formed["density"], 0.9)
    sentences = card_sentences_of(input_card())
    assert "sum from the card: roll_tail = 0.5 elevator_left - 0.5 elevator_right" in sentences
    assert "table from the card: thrust_left over n1_left (40 to 100 %), mach (0.2 to 0.4)" in sentences


def test_what_a_table_cannot_give_is_refused():
    n1 = np.full(N, 0.5)
    n1[7:] = 1.045
    with pytest.raises(
        InputError,
        match=r"record run: n1_left is 104.5 % at sample 7 \(counted from 0; t = 0.28 s\), outside the card's table "
        r"of thrust_left, which goes from 40 to 100 %, 53 of 60 samples in all; extend \[tables.thrust_left\]",
    ):
        with_sums(input_record(n1_left=n1), input_card())
    with pytest.raises(InputError, match="no channel thrust_left"):
        with_sums(input_record(n1_left=None), input_card())


@pytest.mark.parametrize(("name", "rule", "channels", "value"), [
    ("density", "dynamic pressure", {"dynamic_pressure": 0.5 * 1.1 * 80.0**2}, 1.1),
    # ISO 2533: at 3000 m 701.21 hPa and 268.659 K make 0.90925 kg/m3, the speed of sound is 328.583 m/s
    ("density", "gas law", {"static_pressure": 70121.0, "static_temperature": 268.659}, 0.90925),
    ("mach", "static temperature", {"static_temperature": 268.659, "mach": None}, 80.0 / 328.583),
])  # fmt: skip
def test_density_and_mach_number_by_rule(name, rule, channels, value):
    def edit(table):
        table["derived"] = {name: rule}
        if name == "mach":
            table["channels"]["mach"]["required"] = False

    card = input_card(edit=edit)
    np.testing.assert_allclose(with_sums(input_record(**channels), card)[name], value, rtol=2e-5)
    assert any(rule in sentence and name in sentence for sentence in card_sentences_of(card))


def card_sentences_of(card):
    return card_sentences(CheckReport(card, (), {}, {}, SensorCheck("", {}, {}), Consistency("")))


def put(*path):
    *keys, last, value = path

    def edit(table):
        for key in keys:
            table = table[key]
        if value is None:
            del table[last]
        else:
            table[last] = value

    return edit


LEFT = ("tables", "thrust_left")
WRONG_INPUTS = [
    (put(*LEFT, "values", [[1, 2], [3, 4]]), "3 lists of 2 numbers .3 points of n1_left; 2 points of mach"),
    (put(*LEFT, "values", [[1, 2], [3, 4], [5, "6"]]), "values must be a list of plain numbers"),
    (put(*LEFT, "values", [[1, 2], [3, 4], [5, float("nan")]]), "finite"),
    (put(*LEFT, "unit", "ft"), "'ft' cannot be turned into 'N'"),
    (put(*LEFT, "units", "ft"), "unknown key of .tables.thrust_left. 'units'; did you mean 'unit'"),
    (put(*LEFT, "from", {}), "from must name one to 3 channels"),
    (put(*LEFT, "from", "n1_left", {"unit": "%", "points": [40, 100, 60]}), "points must be .* increase"),
    (put(*LEFT, "from", "n1_left", {"points": [40, 100, 60]}), "thrust_left. from n1_left has no unit"),
    (put(*LEFT, "from", {"n1_lft": {"unit": "%", "points": [1, 2]}}), "does not map; is 'n1_left' there meant"),
    (put("tables", {"thrust_left": 3}), "must be a table with unit, from, values"),
    (put("tables", {"q": {"unit": "rad/s", "from": {}, "values": []}}), "states q elsewhere, too"),
    (put("derived", "density", "guess"), "write 'gas law' or 'dynamic pressure' or 'standard atmosphere'"),
    (put("derived", "density", "standard atmosphere"), "needs altitude"),
    (put("sums", "density", ["mach"]), r"density is both in \[sums\] and in \[derived\]"),
    (put("sums", "elevator", {"elevator_left": "half"}), "'half' is not a number"),
    (put("sums", "elevator", [["elevator_left"]]), "must hold names of channels"),
    (put("sums", "elevator", 3), "list of channel names, or a table with factors"),
]  # fmt: skip


@pytest.mark.parametrize(("last", "usable"), [(99.0, True), (108.0, False)])
def test_check_finds_a_record_beyond_a_table_not_usable(tmp_path, last, usable):
    wave = np.sin(np.arange(N) * 0.2)
    columns = {"t": np.arange(N) * 0.04, "q": 0.05 * wave, "V": 80.0 + wave, "M": 0.25, "shaft": 2500.0 + wave}
    columns |= {"n1": np.linspace(60.0, last, N), "del": wave, "der": -wave}
    pd.DataFrame(columns).to_csv(tmp_path / "run.csv", index=False)
    report = check_records([tmp_path / "run.csv"], input_card(), sensors=False)
    assert report.usable == usable
    problems = " ".join(report.records[0].problems)
    assert usable == ("outside the card's table of thrust_left, which goes from 40 to 100 %" not in problems)


# What cards say of linear systems, of constants, of rates free of units, of the envelope
WRONG_LINEAR = [
    (put("linear", "state", ["alpha"]), "did you mean 'states'"),
    (put("linear", "states", []), "states must be a list"),
    (put("linear", "states", ["q", "q"]), "twice"),
    (put("linear", "states", ["alpha", "q", "theta"]), r"theta, which \[channels\] does not map"),
    (put("linear", "rates", "q", None), r"\[linear.rates.q\] is missing"),
    (put("linear", "rates", "p", {"Lp": "q"}), "unknown state"),
    (put("linear", "rates", "q", "Mde", "rudder"), r"rudder, which \[channels\] does not map"),
    (put("linear", "rates", "q", "Mde", 3.0), "write the channel it multiplies"),
    (put("linear", "rates", "q", "Mde", {"elevator": "big"}), "not a number"),
    (put("linear", "rates", "q", {}), "must be a table of parameters"),
    (put("linear", "outputs", "ax", {"X0": "1"}), r"ax, which \[channels\] does not map"),
    (put("linear", "outputs", "q", {"Xq": "q"}), "is a state"),
    (put("linear", "fixed", "Mp", 1.0), "Mp is a parameter of no row"),
    (put("linear", "fixed", "Mq", "one"), "not a number"),
    (put("parameters", {"Mdelta": {"start": 1.0}}), "unknown parameter 'Mdelta'"),
    (put("model", {"effects": ["attached_lift"]}), r"both \[model\] and \[linear\]"),
    (put("channels", None), r"section \[channels\] is missing"),
    (put("constants", {"alpha": "3 deg"}), "required channel"),
    (put("constants", {"wobble": "3 deg"}), "not a channel of the program"),
    (put("constants", {"density": "0.8"}), "without a unit"),
    (put("constants", {"density": "792 kg/m^3"}), "check its unit"),
    (put("constants", {"time": "1 s"}), "time cannot be constant"),
    (put("fly", {"output": ["q"]}), "did you mean 'outputs'"),
    (put("fly", {"outputs": "q"}), r"\[fly\] outputs must be a list"),
    (put("fly", {"initial_state": ["q"]}), r"\[fly\] initial_state must be a table"),
    (put("fly", {"initial_state": {"theta": "0 deg"}}), "initial_state has theta, which .channels. does not map"),
    (put("fly", {"initial_state": {"q": "3 m"}}), r"\[fly\] initial_state q"),
    (put("envelope", {"alpha": "18 deg"}), "write the least and the greatest value"),
    (put("envelope", {"alpha": ["18 deg", "2 deg"]}), "the first value must be less than the second"),
    (put("envelope", {"alpha": ["2 kt", "18 deg"]}), "alpha"),
    (put("envelope", {"speed": [1, 2]}), "speed"),
    (put("envelope", {"programmed_inputs": "yes"}), "write true or false"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "edit", "words"), [
    *((CARD, *row) for row in WRONG_INPUTS), *((SHORT_PERIOD, *row) for row in WRONG_LINEAR),
])  # fmt: skip
def test_a_wrong_entry_is_one_sentence(text, edit, words):
    table = tomllib.loads(text)
    edit(table)
    with pytest.raises(InputError, match=words) as caught:
        parse_card(table, "x", "x.toml")
    assert "x.toml" in str(caught.value) or "channel" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_linear_card_needs_neither_aircraft_nor_effects_nor_alpha():
    card = card_of(SHORT_PERIOD)
    assert card.linear is not None
    assert card.effects == ()
    assert np.isnan(card.aircraft.mass)  # nothing computed from it could pass for a number
    assert card.linear.inputs == ("elevator",)
    assert card.linear.parameters == ("Z0", "Zalpha", "Zq", "Zde", "M0", "Malpha", "Mq", "Mde", "az0")
    assert set(with_sums(record_of({"q": np.zeros(60)}), card)) == {"q"}


def test_a_channel_is_a_constant_where_nothing_was_recorded_and_no_sum():
    text = SHORT_PERIOD.replace("[linear]", '[constants]\ndensity = "0.0494 lb/ft^3"\naz = "-1 g"\n\n[linear]')
    text = text.replace("[linear]", '[sums]\nthrust = ["density", "az"]\n\n[linear]')
    card = card_of(text)
    true = short_period_flight(SHORT_PERIOD_TRUTH)
    with_az = with_sums(record_of(true), card)
    np.testing.assert_array_equal(with_az["az"], true["az"])  # mapped, not required, and in the file
    np.testing.assert_allclose(with_az["density"], 0.0494 * 0.45359237 / 0.3048**3, rtol=1e-12)
    del true["az"]
    without = with_sums(record_of(true), card)
    np.testing.assert_allclose(without["az"], -9.80665, rtol=1e-12)
    np.testing.assert_allclose(without["thrust"], -9.80665 + 0.0494 * 0.45359237 / 0.3048**3)  # sums come after
    table = tomllib.loads(SHORT_PERIOD)
    table |= {"sums": {"thrust": ["q"]}, "constants": {"thrust": "5 kN"}}
    with pytest.raises(InputError, match=r"both in \[sums\] and in \[constants\]"):
        parse_card(table, "x", "x.toml")


def test_rates_are_reduced_as_the_card_says(card):
    """-8 x 0.1 rad/s: with c/V of the moment by default, with half a chord over 90 m/s as asked."""
    table = tomllib.loads(shipped_cards()["attas"].read_text())
    assert card.aircraft.reference_speed is None
    assert card.aircraft.rate_length is None
    table["aircraft"] |= {"reference_speed": "324 km/h", "rate_length": "1.5795 m"}
    other = parse_card(table, "x", "x.toml")
    s = {"alpha": jnp.zeros(2), "q": jnp.full(2, 0.1), "airspeed": jnp.array([60.0, 120.0])}
    model, values = Model.of(["pitch_damping"]), {"Cmq": -8.0}
    usual = model.flow(values, s, card.aircraft)["Cm"]
    np.testing.assert_allclose(usual, [-0.8 * 3.159 / 60.0, -0.8 * 3.159 / 120.0], rtol=1e-14)
    np.testing.assert_allclose(model.flow(values, s, other.aircraft)["Cm"], -0.8 * 3.159 / 2.0 / 90.0, rtol=1e-14)
    speed = Model.of(["speed_lift"]).flow({"CLV": 0.3}, s, other.aircraft)["CL"]
    np.testing.assert_allclose(speed, [0.2, 0.4], rtol=1e-14)
    table["aircraft"]["rate_length"] = "0 m"
    with pytest.raises(InputError, match=r"rate_length is 0.0 m; it must be positive"):
        parse_card(table, "x", "x.toml")


def test_an_initial_state_is_in_si():
    """A channel of the card's own in its own unit: 10 ft/s are 3.048 m/s."""
    table = tomllib.loads(SHORT_PERIOD)
    table["channels"]["w"] = {"column": 3, "unit": "ft/s"}
    table["fly"] = {"outputs": ["q", "q"], "initial_state": {"alpha": "2 deg", "w": "10 ft/s"}}
    fly = parse_card(table, "x", "x.toml").fly
    assert fly.outputs == ("q",)
    assert fly.initial_state == pytest.approx({"alpha": np.deg2rad(2.0), "w": 3.048}, rel=1e-12)


# [envelope] of a card: units, defaults, and one sentence for what is wrong
def test_quantities_have_units_and_the_rest_the_program_s_ranges():
    envelope = parse_envelope({"alpha": ["-2 deg", "18 deg"], "altitude_loss": "1000 ft", "load_factor": [0.5, 2]})
    assert envelope.ranges["alpha"] == pytest.approx(np.deg2rad([-2.0, 18.0]))
    assert envelope.ranges["altitude_loss"] == (-np.inf, pytest.approx(304.8))
    assert envelope.ranges["load_factor"] == (0.5, 2.0)
    assert envelope.ranges["airspeed"] == DEFAULT_RANGES["airspeed"]
    assert envelope.stated == ("alpha", "altitude_loss", "load_factor")
