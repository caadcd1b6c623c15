"""What a card forms from recorded channels: sums with factors, density and Mach number by rule, tables."""

import copy
import tomllib

import numpy as np
import pytest

from bayes_aero.diagnosis.consistency.check_result import CheckReport, SensorCheck
from bayes_aero.dynamics.linear import channel_units
from bayes_aero.errors import InputError
from bayes_aero.flight.agreement import Consistency
from bayes_aero.flight.card.card import parse_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.check import check_records
from bayes_aero.model.derived_channels import with_sums
from bayes_aero.report.text.check import card_sentences

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
[linear.fixed]
"""
N = 60
LBF = 0.45359237 * 9.80665


def card_of(text=CARD, edit=None):
    table = tomllib.loads(text.replace("[linear.fixed]\n", ""))
    if edit is not None:
        table = copy.deepcopy(table)
        edit(table)
    return parse_card(table, "x", "x.toml")


def record_of(**channels):
    base = {
        "q": 0.0, "airspeed": 80.0, "mach": 0.25, "elevator_left": 0.04, "elevator_right": 0.01,
        "n1_left": 0.5, "shaft": 2500.0 * 2.0 * np.pi / 60.0,
    } | channels  # fmt: skip
    arrays = {name: np.broadcast_to(x, N).astype(float) for name, x in base.items() if x is not None}
    return FlightRecord.from_arrays("run", np.arange(N) * 0.04, arrays)


def test_a_sum_may_have_factors():
    formed = with_sums(record_of(), card_of())
    np.testing.assert_allclose(formed["elevator"], 0.025, rtol=1e-14)
    np.testing.assert_allclose(formed["roll_tail"], 0.015, rtol=1e-14)


def test_thrust_is_read_off_tables_of_one_and_of_two_dimensions():
    """N1 50 % is halfway from 40 to 60, Mach 0.25 a quarter of the way: 400 lbf at Mach 0.2, 300 lbf at 0.4."""
    formed = with_sums(record_of(), card_of())
    np.testing.assert_allclose(formed["thrust_left"], 375.0 * LBF, rtol=1e-12)
    np.testing.assert_allclose(formed["thrust_right"], 3000.0, rtol=1e-12)  # 2500 rpm is halfway
    np.testing.assert_allclose(formed["thrust"], 375.0 * LBF + 3000.0, rtol=1e-12)
    assert channel_units(card_of())["thrust_left"] == "N"


def test_the_ends_of_a_table_belong_to_it():
    formed = with_sums(record_of(n1_left=1.0, mach=0.4), card_of())
    np.testing.assert_allclose(formed["thrust_left"], 1600.0 * LBF, rtol=1e-12)


def test_beyond_a_table_its_range_and_the_sample_are_told():
    n1 = np.full(N, 0.5)
    n1[7:] = 1.045
    with pytest.raises(
        InputError,
        match=r"record run: n1_left is 104.5 % at sample 7 \(counted from 0; t = 0.28 s\), outside the card's table "
        r"of thrust_left, which goes from 40 to 100 %, 53 of 60 samples in all; extend \[tables.thrust_left\]",
    ):
        with_sums(record_of(n1_left=n1), card_of())


def test_what_is_recorded_goes_before_a_table_and_a_rule():
    formed = with_sums(record_of(thrust_left=1000.0, density=0.9, dynamic_pressure=3000.0), card_of())
    np.testing.assert_array_equal(formed["thrust_left"], 1000.0)
    np.testing.assert_array_equal(formed["density"], 0.9)


def test_a_record_without_the_entry_of_a_table_has_no_thrust():
    with pytest.raises(InputError, match="no channel thrust_left"):
        with_sums(record_of(n1_left=None), card_of())


@pytest.mark.parametrize(
    ("name", "rule", "channels", "value"),
    [
        ("density", "dynamic pressure", {"dynamic_pressure": 0.5 * 1.1 * 80.0**2}, 1.1),
        # ISO 2533: at 3000 m 701.21 hPa and 268.659 K make 0.90925 kg/m3, the speed of sound is 328.583 m/s
        ("density", "gas law", {"static_pressure": 70121.0, "static_temperature": 268.659}, 0.90925),
        ("mach", "static temperature", {"static_temperature": 268.659, "mach": None}, 80.0 / 328.583),
    ],
)
def test_density_and_mach_number_by_rule(name, rule, channels, value):
    def edit(table):
        table["derived"] = {name: rule}
        if name == "mach":
            table["channels"]["mach"]["required"] = False

    card = card_of(edit=edit)
    np.testing.assert_allclose(with_sums(record_of(**channels), card)[name], value, rtol=2e-5)
    assert any(rule in sentence and name in sentence for sentence in card_sentences_of(card))


def card_sentences_of(card):
    return card_sentences(CheckReport(card, (), {}, {}, SensorCheck("", {}, {}), Consistency("")))


def put(*path):
    *keys, last, value = path

    def edit(table):
        for key in keys:
            table = table[key]
        table[last] = value

    return edit


LEFT = ("tables", "thrust_left")


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (put(*LEFT, "values", [[1, 2], [3, 4]]), "3 lists of 2 numbers .3 points of n1_left; 2 points of mach"),
        (put(*LEFT, "values", [[1, 2], [3, 4], [5]]), "values must be a list of plain numbers"),
        (put(*LEFT, "values", [[1, 2], [3, 4], [5, "6"]]), "values must be a list of plain numbers"),
        (put(*LEFT, "values", [[1, 2], [3, 4], [5, float("nan")]]), "finite"),
        (put(*LEFT, "unit", "ft"), "'ft' cannot be turned into 'N'"),
        (put(*LEFT, "units", "ft"), "unknown key of .tables.thrust_left. 'units'; did you mean 'unit'"),
        (put(*LEFT, "from", {}), "from must name one to 3 channels"),
        (put(*LEFT, "from", "n1_left", {"unit": "%", "points": [40, 100, 60]}), "points must be .* increase"),
        (put(*LEFT, "from", "n1_left", {"points": [40, 100, 60]}), "must have unit and points"),
        (put(*LEFT, "from", {"n1_lft": {"unit": "%", "points": [1, 2]}}), "does not map it; is 'n1_left' there meant"),
        (put("tables", {"thrust_left": 3}), "must be a table with unit, from and values"),
        (put("tables", {"q": {"unit": "rad/s", "from": {}, "values": []}}), "states q elsewhere, too"),
        (put("derived", "density", "guess"), "write 'gas law' or 'dynamic pressure' or 'standard atmosphere'"),
        (put("derived", "density", "standard atmosphere"), "needs altitude"),
        (put("sums", "density", ["mach"]), r"density is in \[sums\] and in \[derived\]"),
        (put("sums", "elevator", {"elevator_left": "half"}), "'half' is not a number"),
        (put("sums", "elevator", [["elevator_left"]]), "must hold names of channels"),
        (put("sums", "elevator", 3), "list of channel names, or a table with factors"),
    ],
)
def test_a_wrong_entry_is_one_sentence(edit, words):
    with pytest.raises(InputError, match=words) as caught:
        card_of(edit=edit)
    assert "x.toml" in str(caught.value) or "channel" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_check_says_what_the_card_forms():
    said = card_sentences_of(card_of())
    assert "sum from the card: elevator = 0.5 elevator_left + 0.5 elevator_right" in said
    assert "sum from the card: roll_tail = 0.5 elevator_left - 0.5 elevator_right" in said
    assert "table from the card: thrust_left over n1_left (40 to 100 %), mach (0.2 to 0.4)" in said


@pytest.mark.parametrize(("last", "usable"), [(99.0, True), (108.0, False)])
def test_check_finds_a_record_beyond_a_table_not_usable(tmp_path, last, usable):
    heads = ["t", "q", "V", "M", "n1", "shaft", "del", "der"]
    wave = np.sin(np.arange(N) * 0.2)
    table = [np.arange(N) * 0.04, 0.05 * wave, 80.0 + wave, 0.25 + 0.0 * wave, np.linspace(60.0, last, N),
             2500.0 + wave, wave, -wave]  # fmt: skip
    path = tmp_path / "run.csv"
    np.savetxt(path, np.transpose(table), delimiter=",", header=",".join(heads), comments="")
    report = check_records([path], card_of(), sensors=False)
    assert report.usable == usable
    said = " ".join(report.records[0].problems)
    assert usable == ("outside the card's table of thrust_left, which goes from 40 to 100 %" not in said)
