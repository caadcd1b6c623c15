"""FlightRecord, what is made of one (resampling, common rates, parts of a file), and what its checks refuse."""

import re

import numpy as np
import pytest
from calling import holds
from flight_samples import CHANNELS, refused, sound, written
from flights import put

import bayes_aero as ba
from bayes_aero.errors import InputError
from bayes_aero.flight.card import parse_card
from bayes_aero.flight.channel import Channel
from bayes_aero.flight.health.air import proposals
from bayes_aero.flight.reading import (
    MIN_SAMPLES,
    at_common_rate,
    check_record,
    inspect_record,
    manoeuvres,
    rate_notes,
    read_record,
    read_records,
    resample_record,
)
from bayes_aero.flight.record import FlightRecord, parts_of, segment_of


# FlightRecord: immutable, named, in SI; and its resampling
def test_what_a_record_and_a_window_of_it_hold():
    record = sound()
    assert len(record) == record.n == 120
    assert record.dt == pytest.approx(0.04, rel=1e-12)
    assert record["time"] is record.time
    assert (record.has("alpha"), record.has("beta")) == (True, False)
    assert record.sha256 == sound().sha256 != sound(q=np.zeros(120)).sha256
    part = record.window(1.0, 3.0)
    np.testing.assert_allclose(part.time, record.time[25:76])
    np.testing.assert_array_equal(part["q"], record["q"][25:76])
    assert part.sha256 == record.sha256
    assert part.name != record.name
    with pytest.raises(InputError, match="no sample between 9 and 10 s"):
        record.window(9, 10)


def test_a_record_is_immutable_and_refuses_odd_arrays():
    values = np.arange(60.0)
    record = FlightRecord.from_arrays("r", np.arange(60.0), {"alpha": values})
    values[0] = 7.0
    assert record["alpha"][0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        record["alpha"][0] = 1.0
    with pytest.raises(TypeError):
        record.channels["beta"] = values  # pyright: ignore[reportIndexIssue]
    with pytest.raises(InputError, match=r"record sound has no channel alhpa \(did you mean alpha\?\).*time, alpha, q"):
        sound()["alhpa"]
    for q, words in (
        (np.zeros(5), "channel q has 5 samples where time has 3"), (np.zeros((3, 2)), "shape"),
        (np.array(["a", "b", "c"]), "not numeric"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            FlightRecord.from_arrays("r", np.arange(3.0), {"q": q})
    with pytest.raises(InputError, match="two are needed"):
        _ = FlightRecord.from_arrays("r", np.zeros(1), {}).dt


def uneven(n: int = 400) -> FlightRecord:
    rng = np.random.default_rng(0)
    t = np.cumsum(0.04 * (1 + 0.2 * rng.uniform(-1, 1, n)))
    channels = {"alpha": 0.1 + 0.05 * np.sin(2 * t), "psi": np.mod(0.5 * t, 2 * np.pi), "gear": (t > 5) * 1.0}
    return FlightRecord.from_arrays("uneven", t, channels)


@pytest.mark.parametrize("dt", [0.02, 0.04, 0.1, 0.13])
def test_resampling(dt):
    record = uneven()
    even = resample_record(record, dt)
    np.testing.assert_allclose(np.diff(even.time), dt, rtol=1e-9)
    assert record.time[-1] - dt < even.time[-1] <= record.time[-1] + 1e-9
    inner = slice(3, -3)
    np.testing.assert_allclose(even["alpha"][inner], 0.1 + 0.05 * np.sin(2 * even.time[inner]), atol=2e-4)
    np.testing.assert_allclose(even["psi"][inner], 0.5 * even.time[inner], atol=2e-3)  # through the jump at 360 degrees
    assert set(even["gear"]) <= {0.0, 1.0}
    assert f"resampled to {dt:g} s" in even.source
    assert even.sha256 == record.sha256


def test_resampling_neither_folds_noise_nor_moves_an_even_record():
    t = np.arange(4000) * 0.01
    fast = FlightRecord.from_arrays("f", t, {"alpha": 0.1 * np.sin(t) + 0.05 * np.sin(2 * np.pi * 23.0 * t)})
    slow = resample_record(fast, 0.04)  # 23 Hz would come back as 2 Hz
    np.testing.assert_allclose(slow["alpha"][20:-20], 0.1 * np.sin(slow.time[20:-20]), atol=1e-3)
    record = sound()
    again = resample_record(record, 0.04)
    np.testing.assert_allclose(again["alpha"], record["alpha"], atol=1e-12)
    assert again.n == record.n


def test_what_resampling_refuses_and_when_it_is_done(tmp_path):
    record = sound(time=np.arange(120) * 0.04 + (np.arange(120) > 70) * 0.5)
    with pytest.raises(InputError, match=r"gap of 0.54 s after t = 2.8 s.*5 median steps.*cut the record"):
        resample_record(record, 0.04)
    for dt in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="positive number"):
            resample_record(sound(), dt)
    with pytest.raises(InputError, match="longer interval"):
        resample_record(sound(), 1e-9)
    time = np.arange(120) * 0.04
    time[50] += 0.01
    path = written(tmp_path / "uneven.csv", sound(time=time))
    with pytest.raises(InputError, match=r"uneven.csv: .*unevenly.*sample 49 .*--resample 0.04"):
        read_record(path, CHANNELS)
    record = read_record(path, CHANNELS, resample=0.04)
    check_record(record)
    with pytest.raises(InputError, match=r"uneven.csv: .*10 samples.*50"):
        read_record(path, CHANNELS, resample=0.5)


# Records of several rates brought to one
def record(name, rate, frequency=0.5, seconds=20.0):
    time = np.arange(round(seconds * rate) + 1) / rate
    return FlightRecord.from_arrays(name, time, {"alpha": np.sin(2.0 * np.pi * frequency * time)})


def test_records_meet_at_the_usual_rate_or_at_the_slowest():
    given = [record("a", 25.0), record("b", 25.0)]
    assert all(new is old for new, old in zip(at_common_rate(given), given, strict=True))
    assert rate_notes(given) == ()
    slow = [record("a", 10.0)]
    assert at_common_rate(slow)[0] is slow[0]
    (slow,) = at_common_rate([record("a", 100.0)])
    assert abs(slow.dt - 0.04) < 1e-9
    inner = (slow.time > 2.0) & (slow.time < 18.0)
    np.testing.assert_allclose(slow["alpha"][inner], np.sin(np.pi * slow.time[inner]), atol=5e-3)
    (buzz,) = at_common_rate([record("a", 100.0, frequency=24.0)])  # would be seen at 1 Hz
    assert np.std(buzz["alpha"][inner]) < 0.02
    given = [record("a", 10.0), record("b", 100.0)]
    assert [round(1.0 / r.dt) for r in at_common_rate(given)] == [10, 10]
    (note,) = rate_notes(given)
    holds(note, "b (100 Hz)", "10 Hz")


# Samples written twice, clocks that show a late hour, and gaps of one channel: as recorders make them

TABLE = {
    "channels": {c.name: {"label": c.label, "unit": c.unit} for c in CHANNELS},
    "linear": {"states": ["q"], "rates": {"q": {"Mq": "q"}}},
}
CARD = parse_card(TABLE, "own", "own.toml")


def test_a_sample_written_twice_counts_once(tmp_path):
    """Samples 30 and 77 of 120 stand in the file twice, the second with a missing value."""
    rows = np.sort(np.r_[np.arange(120), 30, 77, 77])
    columns = {name: x[rows] for name, x in {**sound().channels, "q": put(sound()["q"], 77, np.nan)}.items()}
    path = written(tmp_path / "doubled.csv", sound(len(rows), **columns | {"time": sound().time[rows]}))
    record = read_record(path, CHANNELS, resample=0.04)
    np.testing.assert_allclose(record.time, 0.04 * np.arange(120), atol=1e-9)
    np.testing.assert_allclose(record["alpha"], sound()["alpha"], atol=1e-9)
    assert record.remarks[0].startswith("3 samples repeat the one before")
    assert manoeuvres([path], CHANNELS, split=True) == [path]
    looked = inspect_record(path, CARD, resample=0.04)
    assert (looked.samples, looked.problems) == (120, ())
    assert sum("3 samples repeat" in remark for remark in looked.remarks) == 1


def test_clocks_that_repeat_or_are_late(tmp_path):
    time = 0.04 * np.arange(120)
    time[30] = time[29]
    path = written(tmp_path / "clock.csv", sound(time=time))
    with pytest.raises(InputError, match=r"repeats 1\.16 s at sample 30"):
        read_record(path, CHANNELS)
    time = 1.7e9 + 0.04 * np.arange(240) + 3.0 * (np.arange(240) > 119)
    path = written(tmp_path / "late.csv", sound(240, time=time))
    with pytest.raises(InputError, match=re.escape("t = 1700000004.76 s")):
        read_record(path, CHANNELS)
    first, second = manoeuvres([path], CHANNELS, split=True)
    assert [read_record(part, CHANNELS).n for part in (first, second)] == [120, 120]
    assert read_record(second, CHANNELS).name == "late_1700000007.8-1700000012.56"


def test_parts_without_a_gap_of_one_channel_are_named(tmp_path):
    """Time has no gap there: dividing the file at gaps in time would lead in a circle."""
    path = written(tmp_path / "torn.csv", sound(360, q=put(sound(360)["q"], slice(130, 150), np.nan)))
    with pytest.raises(InputError) as refusal:
        read_record(path, CHANNELS, resample=0.04)
    parts = re.findall(r"FILE@[0-9.:]+", str(refusal.value))
    assert parts == ["FILE@:5.16", "FILE@6:"]
    assert [read_record(p.replace("FILE", str(path)), CHANNELS, resample=0.04).n for p in parts] == [130, 210]


# Parts of a file: named by seconds, by number, by the card, or found between gaps
N = 360


@pytest.fixture
def seamed(tmp_path):
    """Three manoeuvres of 120 samples in a file, 30 s missing between them."""
    return written(tmp_path / "day.csv", sound(N, time=np.arange(N) * 0.04 + 30.0 * (np.arange(N) // 120)))


def test_parts_of_a_file_by_seconds_number_and_gaps(seamed):
    part = read_record(f"{seamed}@34.8:39.56", CHANNELS)
    assert (part.name, part.n, part.time[0]) == ("day_34.8-39.56", 120, pytest.approx(34.8))
    np.testing.assert_allclose(part["alpha"], sound(N)["alpha"][120:240])
    assert read_record(f"{seamed}@:4.76", CHANNELS).n == read_record(f"{seamed}@69.6:", CHANNELS).n == 120
    np.testing.assert_allclose(read_record(f"{seamed}@#2", CHANNELS)["alpha"], part["alpha"])
    with pytest.raises(InputError, match="--split"):
        read_records([seamed], CHANNELS)
    samples = {r.name: r.n for r in read_records([seamed], CHANNELS, split=True)}
    assert samples == dict.fromkeys(("day_0-4.76", "day_34.8-39.56", "day_69.6-74.36"), 120)
    assert manoeuvres([f"{seamed}@0:4"], CHANNELS, split=True)[0].name == "day.csv@0:4"
    looked = inspect_record(f"{seamed}@#2", CARD)
    assert (looked.samples, looked.gaps, looked.problems) == (120, 0, ())
    whole = inspect_record(seamed, CARD)
    assert (whole.gaps, whole.uneven) == (2, 0)


@pytest.mark.parametrize(("spec", "words"), [
    ("200:300", "no sample lies in the part 200:300 (s): its time goes from 0 to 74.36 s"),
    ("5:3", "FROM before TO"),
    ("#4", "gaps in time divide it into 3"),
    ("0:1", "26 samples; at least 50"),
    ("0:80", "--split"),
])  # fmt: skip
def test_parts_that_cannot_be(seamed, spec, words):
    refused(seamed.with_name(f"day.csv@{spec}"), CHANNELS, words)


def test_time_that_starts_over(tmp_path):
    path = written(tmp_path / "twice.csv", sound(240, time=np.arange(240) % 120 * 0.04))
    with pytest.raises(InputError, match="where time starts over"):
        read_record(path, CHANNELS)
    parts = read_records([path], CHANNELS, split=True)
    assert [r.name for r in parts] == ["twice_part1", "twice_part2"]
    np.testing.assert_allclose(parts[1]["alpha"], sound(240)["alpha"][120:])
    with pytest.raises(InputError, match=r"starts over.*FILE@#1"):
        read_record(f"{path}@0:2", CHANNELS)


def test_stamps_and_names_that_look_like_parts(tmp_path):
    t = np.arange(500) / 64.0
    assert parts_of(np.floor(t * 20) / 20) == [(0, 500)]
    assert parts_of(np.round(t, 2)) == [(0, 500)]
    t[250:] += 10.0
    assert parts_of(t) == [(0, 250), (250, 500)]
    path = tmp_path / "odd.csv@1:2"
    assert not segment_of(path).whole
    path.write_text("x")
    assert segment_of(path).whole


def test_the_card_names_the_parts_of_a_file(seamed):
    table = TABLE | {"segments": {"day.csv": ["0:4.76", "#3"]}}
    card = parse_card(table, "own", "own.toml")
    assert [r.name for r in ba.read(seamed, card)] == ["day_0-4.76", "day_part3"]
    assert [r.name for r in ba.read(f"{seamed}@34.8:39", card)] == ["day_34.8-39"]
    for wrong, words in (({"day.csv": "0:4"}, "a list of parts"), ({"day.csv": ["whole"]}, "write FROM:TO")):
        with pytest.raises(InputError, match=words):
            parse_card(table | {"segments": wrong}, "own", "own.toml")


def doublets(duration: float) -> FlightRecord:
    """Of the elevator at 5 and 45 s in calm flight, at 25 Hz."""
    t = np.arange(0.0, duration, 0.04)
    rng = np.random.default_rng(5)
    elevator = 0.05 * sum((abs(t - b - 1.0) < 1.0) - 1.0 * (abs(t - b - 3.0) < 1.0) for b in (5.0, 45.0))
    noise = rng.standard_normal((2, len(t)))
    channels = {"elevator": elevator + 1e-4 * noise[0], "q": 0.8 * elevator + 1e-3 * noise[1]}
    return FlightRecord.from_arrays("day", t, channels | {"airspeed": np.full(len(t), 100.0)})


def test_manoeuvres_and_parts_in_flight_are_proposed():
    record = doublets(70.0)
    proposed = proposals(record, CARD)
    assert [p.what for p in proposed] == ["manoeuvre", "manoeuvre"]
    for proposal, begin in zip(proposed, (5.0, 45.0), strict=True):
        assert begin - 4.0 < proposal.begin < begin
        assert begin + 4.0 < proposal.end < begin + 9.0
        assert record.window(proposal.begin, proposal.end).n > 150
    taxied = np.where(record.time < 39.99, 1.0, 100.0)  # 40 s on the ground
    landed = FlightRecord.from_arrays("day", record.time, {**record.channels, "airspeed": taxied})
    (flight,) = [p for p in proposals(landed, CARD) if p.what == "in flight"]
    assert (flight.begin, flight.end) == (pytest.approx(40.0, abs=0.2), pytest.approx(69.96))
    assert proposals(doublets(11.0), CARD) == ()


T = np.arange(120) * 0.04


def test_sound_odd_and_uneven_records_pass():
    check_record(sound())
    check_record(sound(MIN_SAMPLES))
    check_record(sound(alpha=1.5 * np.sin(T)))  # post-stall
    check_record(sound(phi=np.linspace(0, 12, 120)))  # two rolls, unwrapped
    check_record(sound(alpha=0.01 + 0.001 * np.sin(T)))  # a fast, calm record is not "converted twice"
    check_record(sound(ax=0.0 * T, ay=0.0 * T, az=0.05 * np.sin(T)))  # a parabola
    check_record(sound(strain=1e9 * T))  # the user's own channel: no bounds are known
    check_record(sound(time=T + 5e4))
    check_record(sound(time=np.round(T + 1e-5 * np.sin(np.arange(120)), 5)))  # as in the second ATTAS file
    check_record(sound(time=put(T, 40, T[40] + 0.01)), even=False)
    with pytest.raises(InputError, match="repeats"):
        check_record(sound(time=put(T, 40, T[39])), even=False)
    large = sound(alpha=2.6 + 1.7 * np.sin(3.0 * T))  # a unit that the card has is not advised, however it is spelled
    for unit in ("deg", "DEG", "degrees", "°"):
        with pytest.raises(InputError, match=r"^(?!.*(looks like|set unit)).*channel alpha"):
            check_record(large, channels=[Channel("alpha", unit)])


CASES = {  # channels put in place of sound ones, words of the refusal, units of the card
    "short": ({"time": T[:49], **{k: v[:49] for k, v in sound().channels.items()}},
     ("49 samples", "50", "use a longer record")),
    "nan": ({"q": put(sound()["q"], [11, 50], np.nan)},
     ("channel q", "NaN", "sample 11 ", "t = 0.44 s", "2 of 120", "repair")),
    "inf": ({"strain": put(T, 3, -np.inf)}, ("channel strain", "infinite", "sample 3 ", "repair")),
    "nan time": ({"time": put(T, 5, np.nan)}, ("channel time", "NaN", "sample 5 ", "repair")),
    "repeated time": ({"time": put(T, 30, T[29])}, ("channel time", "repeats", "sample 30 ", "drop the repeated")),
    "backwards": ({"time": np.r_[T[:60], T[:60]]},
     ("channel time", "backwards", "sample 60 ", "where time starts over")),
    "gap": ({"time": T + (np.arange(120) > 70) * 0.2}, ("channel time", "gap", "sample 70 ", "0.24 s", "--split")),
    "jitter": ({"time": put(T, 40, T[40] + 0.002)}, ("channel time", "unevenly", "sample 39 ", "--resample 0.04")),
    "milliseconds": ({"time": T * 1e3}, ("channel time", "40 s", "sample 0 ", 'unit = "ms"')),
    "days": ({"time": T / 86400}, ("channel time", "sample 0 ", 'unit = "d"')),
    "alpha in degrees": ({"alpha": np.rad2deg(sound()["alpha"])},
     ("channel alpha", "sample 0 ", "t = 0 s", "looks like deg", 'unit = "deg"')),
    "theta in degrees": ({"theta": 5 + T}, ("channel theta", "sample 0 ", 'unit = "deg"')),
    "q in degrees per second": ({"q": 6 * np.sin(T)}, ("channel q", "sample 25 ", 'unit = "deg/s"')),
    "fast": ({"airspeed": np.full(120, 450.0)}, ("channel airspeed", "450 m/s", "sample 0 ", '"kt"')),
    "dense": ({"density": put(T * 0 + 1.2, 9, 2.5)}, ("channel density", "2.5 kg/m^3", "sample 9 ", "unit")),
    "n1 in per cent": ({"n1_left": 80 + T}, ("channel n1_left", "sample 0 ", 'unit = "%"')),
    "pressure in hPa": ({"static_pressure": 510 + T}, ("channel static_pressure", "sample 0 ", '"hPa"')),
    "pressure beyond any unit": ({"static_pressure": 5.1e6 + T}, ("channel static_pressure", "no other unit")),
    "celsius": ({"static_temperature": T - 20}, ("channel static_temperature", '"degC"')),
    "no airspeed": ({"airspeed": put(put(T + 50, 17, 0.0), 90, -1.0)},
     ("channel airspeed", "is 0 m/s", "sample 17 ", "2 samples", "cut the record")),
    "no density": ({"density": put(T + 0.7, 8, 0.0).clip(0, 1)}, ("channel density", "sample 8 ", "repair")),
    "constant alpha": ({"alpha": np.full(120, 0.09)},
     ("channel alpha", "stays at 0.09 rad", "sample 0 ", "sample 119 ", "check the sensor")),
    **{f"fill value {x:g}": ({"alpha": put(sound()["alpha"], [11, 50], np.deg2rad(x))}, (f"({x:.6g} deg in the file)",
       "sample 11 ", "2 of 120", "fill value"), ("alpha", "deg")) for x in (-9999.0, 9999.0, 99999.0)},
    "Pa in a file, hPa on the card": ({"static_pressure": 5.1e6 + T},
     ('looks like Pa: set unit = "Pa"',), ("static_pressure", "hPa")),
    "microseconds in a file, ms on the card": ({"time": T * 1e3}, ('set unit = "us"',), ("time", "ms")),
    "g": ({"ax": 0.1 + 0 * T, "ay": 0 * T, "az": -1.0 - 0.1 * np.sin(T)}, ("ax, ay, az", "sample ", 'unit = "g"')),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_a_fault_of_a_record_is_told_with_its_place_and_what_to_do(case):
    changed, words, *units = CASES[case]
    with pytest.raises(InputError) as refusal:
        check_record(sound(**changed), channels=[Channel(name, unit) for name, unit in units])
    holds(str(refusal.value), *words)
    assert "\n" not in str(refusal.value)
