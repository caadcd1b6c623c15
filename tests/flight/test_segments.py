"""Parts of a file: named by seconds, by number, by the card, or found between gaps."""

from __future__ import annotations

import numpy as np
import pytest
from flight_samples import CHANNELS, sound

import bayes_aero as ba
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import parse_card
from bayes_aero.flight.reading.inspection import inspect_record
from bayes_aero.flight.reading.proposals import proposals
from bayes_aero.flight.reading.read_record import manoeuvres, read_record, read_records, write_record
from bayes_aero.flight.reading.segments import parts_of, segment_of
from bayes_aero.flight.record import FlightRecord

N = 360
AIRCRAFT = {
    "mass": "1 kg", "Ix": "1 kg m^2", "Iy": "1 kg m^2", "Iz": "1 kg m^2", "Ixz": "0 kg m^2", "wing_area": "1 m^2",
    "chord": "1 m", "half_span": "5 m", "tail_arm": "5 m", "aspect_ratio": 7.0,
}  # fmt: skip
TABLE = {
    "channels": {c.name: {"label": c.label, "unit": c.unit} for c in CHANNELS},
    "aircraft": AIRCRAFT,
    "model": {"effects": ["attached_lift"]},
}
CARD = parse_card(TABLE, "own", "own.toml")


@pytest.fixture
def seamed(tmp_path):
    """Three manoeuvres of 120 samples in a file, 30 s missing between them."""
    time = np.arange(N) * 0.04 + 30.0 * (np.arange(N) // 120)
    path = tmp_path / "day.csv"
    write_record(sound(N, time=time), path, CHANNELS)
    return path


def test_a_part_by_its_seconds(seamed):
    whole = sound(N)
    part = read_record(f"{seamed}@34.8:39.56", CHANNELS)
    assert part.name == "day_34.8-39.56"
    assert part.n == 120
    assert part.time[0] == pytest.approx(34.8)
    np.testing.assert_allclose(part["alpha"], whole["alpha"][120:240])
    assert read_record(f"{seamed}@:4.76", CHANNELS).n == 120
    assert read_record(f"{seamed}@69.6:", CHANNELS).n == 120
    np.testing.assert_allclose(read_record(f"{seamed}@#2", CHANNELS)["alpha"], part["alpha"])


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("200:300", "no sample lies in the part from 200 to 300 s: its time goes from 0 to 74.36 s"),
        ("5:3", "FROM before TO"),
        ("#4", "gaps in time divide it into 3"),
        ("0:1", "26 samples; at least 50"),
        ("0:80", "--split"),
    ],
)
def test_parts_that_cannot_be(seamed, spec, said):
    with pytest.raises(InputError, match=r"day\.csv") as told:
        read_record(f"{seamed}@{spec}", CHANNELS)
    assert said in str(told.value)


def test_gaps_divide_a_file_on_request(seamed):
    with pytest.raises(InputError, match="--split"):
        read_records([seamed], CHANNELS)
    found = read_records([seamed], CHANNELS, split=True)
    assert [r.n for r in found] == [120, 120, 120]
    assert [r.name for r in found] == ["day_0-4.76", "day_34.8-39.56", "day_69.6-74.36"]
    assert manoeuvres([f"{seamed}@0:4"], CHANNELS, split=True)[0].name == "day.csv@0:4"


def test_time_that_starts_over(tmp_path):
    path = tmp_path / "twice.csv"
    write_record(sound(240, time=np.arange(240) % 120 * 0.04), path, CHANNELS)
    with pytest.raises(InputError, match="where time starts over"):
        read_record(path, CHANNELS)
    found = read_records([path], CHANNELS, split=True)
    assert [r.name for r in found] == ["twice_part1", "twice_part2"]
    np.testing.assert_allclose(found[1]["alpha"], sound(240)["alpha"][120:])
    with pytest.raises(InputError, match=r"starts over.*FILE@#1"):
        read_record(f"{path}@0:2", CHANNELS)


def test_rounded_and_uneven_stamps_are_no_gaps():
    t = np.arange(500) / 64.0
    assert parts_of(np.floor(t * 20) / 20) == [(0, 500)]
    assert parts_of(np.round(t, 2)) == [(0, 500)]
    t[250:] += 10.0
    assert parts_of(t) == [(0, 250), (250, 500)]


def test_a_file_whose_name_looks_like_a_part(tmp_path):
    path = tmp_path / "odd.csv@1:2"
    assert not segment_of(path).whole
    path.write_text("x")
    assert segment_of(path).whole


def test_the_card_names_the_parts_of_a_file(seamed):
    table = TABLE | {"segments": {"day.csv": ["0:4.76", "#3"]}}
    card = parse_card(table, "own", "own.toml")
    assert [r.name for r in ba.read(seamed, card)] == ["day_0-4.76", "day_part3"]
    assert [r.name for r in ba.read(f"{seamed}@34.8:39", card)] == ["day_34.8-39"]
    for wrong, said in (({"day.csv": "0:4"}, "a list of parts"), ({"day.csv": ["whole"]}, "write FROM:TO")):
        with pytest.raises(InputError, match=said):
            parse_card(table | {"segments": wrong}, "own", "own.toml")


def test_an_inspection_looks_at_the_part_alone(seamed):
    looked = inspect_record(f"{seamed}@#1", CARD)
    assert (looked.samples, looked.gaps, looked.problems) == (120, 0, ())
    assert inspect_record(seamed, CARD).gaps == 2


def flown(duration: float, airspeed: float, rest: float = 0.0) -> dict[str, np.ndarray]:
    """A doublet of the elevator at 5 and 45 s in calm flight, at 25 Hz."""
    t = np.arange(0.0, duration, 0.04)
    rng = np.random.default_rng(5)
    doublet = sum(
        np.where((t > b) & (t < b + 2), 0.05, np.where((t >= b + 2) & (t < b + 4), -0.05, 0)) for b in (5, 45)
    )
    return {
        "time": t,
        "elevator": doublet + 1e-4 * rng.standard_normal(len(t)),
        "q": 0.8 * doublet + 1e-3 * rng.standard_normal(len(t)),
        "airspeed": np.full(len(t), airspeed) + rest,
    }


def test_manoeuvres_are_proposed():
    data = flown(70.0, 100.0)
    record = FlightRecord.from_arrays("day", data.pop("time"), data)
    found = proposals(record, CARD)
    assert [p.what for p in found] == ["manoeuvre", "manoeuvre"]
    for proposal, begin in zip(found, (5.0, 45.0), strict=True):
        assert begin - 4.0 < proposal.begin < begin
        assert begin + 4.0 < proposal.end < begin + 9.0
        assert record.window(proposal.begin, proposal.end).n > 150


def test_parts_in_flight_are_proposed():
    data = flown(70.0, 100.0)
    data["airspeed"][:1000] = 1.0  # 40 s on the ground
    record = FlightRecord.from_arrays("day", data.pop("time"), data)
    flights = [p for p in proposals(record, CARD) if p.what == "in flight"]
    assert [p.begin for p in flights] == [pytest.approx(40.0, abs=0.2)]
    assert [p.end for p in flights] == [pytest.approx(69.96)]


def test_nothing_is_proposed_of_one_manoeuvre():
    data = flown(11.0, 100.0)
    assert proposals(FlightRecord.from_arrays("day", data.pop("time"), data), CARD) == ()


def test_ranges_of_a_part_are_its_own(seamed):
    looked = inspect_record(f"{seamed}@#2", CARD)
    time = next(channel for channel in looked.channels if channel.name == "time")
    assert (time.lowest, time.highest) == (pytest.approx(34.8), pytest.approx(39.56))
    whole = inspect_record(seamed, CARD)
    assert (whole.gaps, whole.uneven) == (2, 0)


def test_a_card_keeps_its_name_whatever_it_derives():
    table = TABLE | {"channels": TABLE["channels"] | {"altitude": {"label": "HQNH", "unit": "m"}}}
    derived = {"mach": "standard atmosphere"}
    assert parse_card(table | {"derived": derived}, "own", "own.toml").name == "own"
