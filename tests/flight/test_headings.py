"""Headings of files that nobody here has written."""

import pytest

from bayes_aero.flight.aliases import ALIASES, plain_heading, split_heading, symbol_of
from bayes_aero.flight.reading.raw import read_raw
from bayes_aero.jobs.card.column_inference import guessed


@pytest.mark.parametrize(
    ("heading", "channel", "unit"),
    [
        ("Q gyro [deg/s]", "q", "deg/s"),
        ("NZ up [g]", "az", "g"),
        ("Pitch Att [deg]", "theta", "deg"),
        ("measured AoA (deg)", "alpha", "deg"),
        ("TAS (kn)", "airspeed", "kt"),
        ("ADC_TAS_KT", "airspeed", "kt"),
        ("BOOM_AOA_DEG", "alpha", "deg"),
        ("INS_PITCH_DEG", "theta", "deg"),
        ("INS_Q [deg/s]", "q", "deg/s"),
        ("INS_NZ_G", "az", "g"),
        ("UTC_SEC", "time", "s"),
        ("ENG_THRUST_LBF", "thrust", "lbf"),
        ("AirspeedTrue_kt", "airspeed", "kt"),
        ("Normal Accel [g]", "az", "g"),
        ("P_RATE", "p", None),
    ],
)
def test_words_beside_the_name_are_no_part_of_it(heading, channel, unit):
    key, found = split_heading(plain_heading(heading))
    assert (ALIASES.get(key), found) == (channel, unit)


@pytest.mark.parametrize("heading", ["gyro", "up [g]", "sensor", "ADC_RAW"])
def test_a_heading_of_such_words_alone_stays(heading):
    assert plain_heading(heading) == heading


@pytest.mark.parametrize(
    ("heading", "symbol"),
    [
        ("Long. Load Factor nx [g]", "nx"),
        ("Boom No. 2 AoA (deg)", "aoa"),
        ("ADC1_TAS", "tas"),
        ("No2_AoA_deg", "aoa"),
        ("Commanded theta [deg]", None),
        ("alpha limit [deg]", None),
        ("", None),
    ],
)
def test_a_symbol_at_the_end_names_the_channel(heading, symbol):
    assert symbol_of(heading) == symbol
    assert symbol is None or symbol in ALIASES


@pytest.mark.parametrize(
    ("left", "right", "whole"),
    [
        ("AileronL [deg]", "AileronR [deg]", "aileron"),
        ("L_Aileron_deg", "R_Aileron_deg", "aileron"),
        ("SpoilerL", "SpoilerR", "spoiler"),
        ("Elevator LH (deg)", "Elevator RH (deg)", "elevator"),
        ("Left Elevon", "Right Elevon", "elevon"),
        ("ThrottleL", "ThrottleR", "throttle"),
    ],
)
def test_halves_are_told_apart_and_from_the_whole(tmp_path, left, right, whole):
    """The left aileron alone is no aileron: it would be half of it, with the other sign."""
    path = tmp_path / "run.csv"
    path.write_text(f"Time [s],{right},{left}\n" + "\n".join(f"{0.1 * i:.1f},{i},{-i}" for i in range(60)))
    found, _ = guessed(read_raw(path).columns)
    assert {name: guess.column.number for name, guess in found.items()} == {
        "time": 1,
        f"{whole}_right": 2,
        f"{whole}_left": 3,
    }


def test_a_command_does_not_resemble_what_it_asks_for(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("Time [s],elevator_cmd [deg]\n" + "\n".join(f"{0.1 * i:.1f},{i}" for i in range(60)))
    found, unknown = guessed(read_raw(path).columns)
    assert list(found) == ["time"]
    assert [column.label for column in unknown] == ["elevator_cmd [deg]"]
