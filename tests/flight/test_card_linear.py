"""What cards say of linear systems, of constants and of the way rates are made free of units."""

import copy
import tomllib

import jax.numpy as jnp
import numpy as np
import pytest
from linear_cards import SHORT_PERIOD, SHORT_PERIOD_TRUTH, card_of, record_of, short_period_flight

from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import parse_card, shipped_cards
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.derived_channels import with_sums
from bayes_aero.model.model import Model


def change(path, value):
    def edit(table):
        for key in path[:-1]:
            table = table[key]
        if value is None:
            del table[path[-1]]
        else:
            table[path[-1]] = value

    return edit


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (change(["linear", "state"], ["alpha"]), "did you mean 'states'"),
        (change(["linear", "states"], []), "states must be a list"),
        (change(["linear", "states"], ["q", "q"]), "twice"),
        (change(["linear", "states"], ["alpha", "q", "theta"]), r"theta, which \[channels\] does not map"),
        (change(["linear", "rates", "q"], None), r"\[linear.rates.q\] is missing"),
        (change(["linear", "rates", "p"], {"Lp": "q"}), "unknown state"),
        (change(["linear", "rates", "q", "Mde"], "rudder"), r"rudder, which \[channels\] does not map"),
        (change(["linear", "rates", "q", "Mde"], 3.0), "write the channel it multiplies"),
        (change(["linear", "rates", "q", "Mde"], {"elevator": "big"}), "not a number"),
        (change(["linear", "rates", "q"], {}), "must be a table of parameters"),
        (change(["linear", "outputs", "ax"], {"X0": "1"}), r"ax, which \[channels\] does not map"),
        (change(["linear", "outputs", "q"], {"Xq": "q"}), "is a state"),
        (change(["linear", "fixed", "Mp"], 1.0), "Mp is a parameter of no row"),
        (change(["linear", "fixed", "Mq"], "one"), "not a number"),
        (change(["parameters"], {"Mdelta": {"start": 1.0}}), "unknown parameter 'Mdelta'"),
        (change(["model"], {"effects": ["attached_lift"]}), r"both \[model\] and \[linear\]"),
        (change(["channels"], None), r"section \[channels\] is missing"),
        (change(["constants"], {"alpha": "3 deg"}), "required channel"),
        (change(["constants"], {"wobble": "3 deg"}), "not a channel of the program"),
        (change(["constants"], {"density": "0.8"}), "without a unit"),
        (change(["constants"], {"density": "792 kg/m^3"}), "check its unit"),
        (change(["constants"], {"time": "1 s"}), "time cannot be constant"),
    ],
)
def test_a_wrong_linear_card_is_one_sentence(edit, words):
    table = copy.deepcopy(tomllib.loads(SHORT_PERIOD))
    edit(table)
    with pytest.raises(InputError, match=words) as caught:
        parse_card(table, "x", "x.toml")
    assert str(caught.value).startswith("card x.toml")
    assert "\n" not in str(caught.value)


def test_a_linear_card_needs_neither_aircraft_nor_effects():
    card = card_of(SHORT_PERIOD)
    assert card.effects == ()
    assert np.isnan(card.aircraft.mass)  # nothing computed from it could pass for a number
    assert card.linear.inputs == ("elevator",)
    assert card.linear.parameters == ("Z0", "Zalpha", "Zq", "Zde", "M0", "Malpha", "Mq", "Mde", "az0")


def test_a_constant_stands_where_nothing_was_recorded():
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


def test_a_channel_is_a_sum_or_a_constant():
    table = copy.deepcopy(tomllib.loads(SHORT_PERIOD))
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


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"output": ["q"]}, "did you mean 'outputs'"),
        ({"outputs": "q"}, r"\[fly\] outputs must be a list"),
        ({"initial_state": ["q"]}, r"\[fly\] initial_state must be a table"),
        ({"initial_state": {"theta": "0 deg"}}, "initial_state has theta, which .channels. does not map"),
        ({"initial_state": {"q": "3 m"}}, r"\[fly\] initial_state q"),
    ],
)
def test_a_bad_section_of_a_trajectory_fit_is_refused(given, told):
    with pytest.raises(InputError, match=told):
        parse_card(tomllib.loads(SHORT_PERIOD) | {"fly": given}, "x", "x.toml")


def test_an_initial_state_is_in_si():
    """A channel of the card's own in its own unit: 10 ft/s are 3.048 m/s."""
    table = tomllib.loads(SHORT_PERIOD)
    table["channels"]["w"] = {"column": 3, "unit": "ft/s"}
    table["fly"] = {"outputs": ["q", "q"], "initial_state": {"alpha": "2 deg", "w": "10 ft/s"}}
    found = parse_card(table, "x", "x.toml").fly
    assert found.outputs == ("q",)
    assert found.initial_state == pytest.approx({"alpha": np.deg2rad(2.0), "w": 3.048}, rel=1e-12)


def test_a_record_of_a_linear_card_needs_no_alpha():
    record = FlightRecord.from_arrays("x", np.arange(60) * 0.04, {"q": np.zeros(60)})
    assert set(with_sums(record, card_of(SHORT_PERIOD))) == {"q"}
