"""FlightRecord and what is made of one: resampling, common rates, repeated samples, parts of a file."""

import pickle
import re
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from flight_samples import CHANNELS, sound

import bayes_aero as ba
from bayes_aero.errors import InputError
from bayes_aero.flight.card import parse_card
from bayes_aero.flight.checks import check_record, resample_record
from bayes_aero.flight.reading import (
    at_common_rate,
    inspect_record,
    manoeuvres,
    proposals,
    rate_notes,
    read_record,
    read_records,
)
from bayes_aero.flight.record import FlightRecord, parts_of, segment_of, write_record


# FlightRecord: immutable, named, in SI; and its resampling
def test_what_a_record_and_a_window_of_it_hold():
    record = sound()
    assert len(record) == record.n == 120
    assert record.dt == pytest.approx(0.04, rel=1e-12)
    assert record.names[0] == "time"
    assert record.has("alpha")
    assert not record.has("beta")
    assert record["time"] is record.time
    assert len(record.sha256) == 64
    record, same, other = sound(), sound(), sound(q=np.zeros(120))
    assert record.sha256 == same.sha256 != other.sha256
    record = sound()
    again = pickle.loads(pickle.dumps(record))
    assert again.sha256 == record.sha256
    np.testing.assert_array_equal(again["alpha"], record["alpha"])
    part = record.window(1.0, 3.0)
    assert part.n == 51
    np.testing.assert_allclose(part.time[[0, -1]], [1.0, 3.0])
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
    with pytest.raises(FrozenInstanceError):
        record.name = "other"  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(InputError, match=r"record sound has no channel alhpa \(did you mean alpha\?\).*time, alpha, q"):
        sound()["alhpa"]
    for channels, words in (
        ({"q": np.zeros(5)}, "channel q has 5 samples where time has 3"),
        ({"q": np.zeros((3, 2))}, "shape"),
        ({"q": np.array(["a", "b", "c"])}, "not numeric"),
    ):
        with pytest.raises(InputError, match=words):
            FlightRecord.from_arrays("r", np.arange(3.0), channels)
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
    path = tmp_path / "uneven.csv"
    write_record(sound(time=time), path, CHANNELS)
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
    (said,) = rate_notes(given)
    assert "b (100 Hz)" in said
    assert "10 Hz" in said


# Samples written twice, clocks that show a late hour, and gaps of one channel: as recorders make them
LATE = 1_700_000_000.0  # s since 1970
TABLE = {"channels": {c.name: {"label": c.label, "unit": c.unit} for c in CHANNELS}}


@pytest.fixture
def doubled(tmp_path):
    """Samples 30 and 77 of 120 stand in the file twice, the second with a missing value."""
    rows = np.sort(np.r_[np.arange(120), 30, 77, 77])
    q = sound()["q"].copy()
    q[77] = np.nan
    columns = {name: (q if name == "q" else sound()[name])[rows] for name in sound().channels}
    path = tmp_path / "doubled.csv"
    write_record(sound(len(rows), time=sound().time[rows], **columns), path, CHANNELS)
    return path


def test_a_sample_written_twice_counts_once(doubled):
    record = read_record(doubled, CHANNELS, resample=0.04)
    np.testing.assert_allclose(record.time, 0.04 * np.arange(120), atol=1e-9)
    np.testing.assert_allclose(record["alpha"], sound()["alpha"], atol=1e-9)
    assert record.remarks[0].startswith("3 samples repeat the one before")
    assert manoeuvres([doubled], CHANNELS, split=True) == [doubled]
    card = parse_card(TABLE | {"linear": {"states": ["q"], "rates": {"q": {"Mq": "q"}}}}, "own", "own.toml")
    looked = inspect_record(doubled, card, resample=0.04)
    assert (looked.samples, looked.problems) == (120, ())
    assert sum("3 samples repeat" in remark for remark in looked.remarks) == 1


def test_clocks_that_repeat_or_are_late(tmp_path):
    time = 0.04 * np.arange(120)
    time[30] = time[29]
    path = tmp_path / "clock.csv"
    write_record(sound(time=time), path, CHANNELS)
    with pytest.raises(InputError, match=r"repeats 1\.16 s at sample 30"):
        read_record(path, CHANNELS)
    time = LATE + 0.04 * np.arange(240) + 3.0 * (np.arange(240) > 119)
    path = tmp_path / "late.csv"
    write_record(sound(240, time=time), path, CHANNELS)
    with pytest.raises(InputError, match=re.escape("t = 1700000004.76 s")):
        read_record(path, CHANNELS)
    first, second = manoeuvres([path], CHANNELS, split=True)
    assert [read_record(part, CHANNELS).n for part in (first, second)] == [120, 120]
    assert read_record(second, CHANNELS).name == "late_1700000007.8-1700000012.56"


def test_parts_without_a_gap_of_one_channel_are_named(tmp_path):
    """Time has no gap there: dividing the file at gaps in time would lead in a circle."""
    q = sound(360)["q"].copy()
    q[130:150] = np.nan
    path = tmp_path / "torn.csv"
    write_record(sound(360, q=q), path, CHANNELS)
    with pytest.raises(InputError) as told:
        read_record(path, CHANNELS, resample=0.04)
    parts = re.findall(r"FILE@[0-9.:]+", str(told.value))
    assert parts == ["FILE@:5.16", "FILE@6:"]
    assert [read_record(p.replace("FILE", str(path)), CHANNELS, resample=0.04).n for p in parts] == [130, 210]


# Parts of a file: named by seconds, by number, by the card, or found between gaps
N = 360
AIRCRAFT = {
    "mass": "1 kg", "Ix": "1 kg m^2", "Iy": "1 kg m^2", "Iz": "1 kg m^2", "Ixz": "0 kg m^2", "wing_area": "1 m^2",
    "chord": "1 m", "half_span": "5 m", "tail_arm": "5 m", "aspect_ratio": 7.0,
}  # fmt: skip
PART_TABLE = TABLE | {"aircraft": AIRCRAFT, "model": {"effects": ["attached_lift"]}}
CARD = parse_card(PART_TABLE, "own", "own.toml")


@pytest.fixture
def seamed(tmp_path):
    """Three manoeuvres of 120 samples in a file, 30 s missing between them."""
    time = np.arange(N) * 0.04 + 30.0 * (np.arange(N) // 120)
    path = tmp_path / "day.csv"
    write_record(sound(N, time=time), path, CHANNELS)
    return path


def test_parts_of_a_file_by_seconds_number_and_gaps(seamed):
    whole = sound(N)
    part = read_record(f"{seamed}@34.8:39.56", CHANNELS)
    assert part.name == "day_34.8-39.56"
    assert part.n == 120
    assert part.time[0] == pytest.approx(34.8)
    np.testing.assert_allclose(part["alpha"], whole["alpha"][120:240])
    assert read_record(f"{seamed}@:4.76", CHANNELS).n == 120
    assert read_record(f"{seamed}@69.6:", CHANNELS).n == 120
    np.testing.assert_allclose(read_record(f"{seamed}@#2", CHANNELS)["alpha"], part["alpha"])
    with pytest.raises(InputError, match="--split"):
        read_records([seamed], CHANNELS)
    found = read_records([seamed], CHANNELS, split=True)
    assert [r.n for r in found] == [120, 120, 120]
    assert [r.name for r in found] == ["day_0-4.76", "day_34.8-39.56", "day_69.6-74.36"]
    assert manoeuvres([f"{seamed}@0:4"], CHANNELS, split=True)[0].name == "day.csv@0:4"
    looked = inspect_record(f"{seamed}@#1", CARD)
    assert (looked.samples, looked.gaps, looked.problems) == (120, 0, ())
    assert inspect_record(seamed, CARD).gaps == 2
    looked = inspect_record(f"{seamed}@#2", CARD)
    time = next(channel for channel in looked.channels if channel.name == "time")
    assert (time.lowest, time.highest) == (pytest.approx(34.8), pytest.approx(39.56))
    whole = inspect_record(seamed, CARD)
    assert (whole.gaps, whole.uneven) == (2, 0)


@pytest.mark.parametrize(("spec", "said"), [
    ("200:300", "no sample lies in the part from 200 to 300 s: its time goes from 0 to 74.36 s"),
    ("5:3", "FROM before TO"),
    ("#4", "gaps in time divide it into 3"),
    ("0:1", "26 samples; at least 50"),
    ("0:80", "--split"),
])  # fmt: skip
def test_parts_that_cannot_be(seamed, spec, said):
    with pytest.raises(InputError, match=r"day\.csv") as told:
        read_record(f"{seamed}@{spec}", CHANNELS)
    assert said in str(told.value)


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


def test_the_card_names_the_parts_of_a_file_and_keeps_its_own_name(seamed):
    table = PART_TABLE | {"segments": {"day.csv": ["0:4.76", "#3"]}}
    card = parse_card(table, "own", "own.toml")
    assert [r.name for r in ba.read(seamed, card)] == ["day_0-4.76", "day_part3"]
    assert [r.name for r in ba.read(f"{seamed}@34.8:39", card)] == ["day_34.8-39"]
    for wrong, said in (({"day.csv": "0:4"}, "a list of parts"), ({"day.csv": ["whole"]}, "write FROM:TO")):
        with pytest.raises(InputError, match=said):
            parse_card(table | {"segments": wrong}, "own", "own.toml")
    table = PART_TABLE | {"channels": PART_TABLE["channels"] | {"altitude": {"label": "HQNH", "unit": "m"}}}
    derived = {"mach": "standard atmosphere"}
    assert parse_card(table | {"derived": derived}, "own", "own.toml").name == "own"


def flown(duration: float, airspeed: float, rest: float = 0.0) -> dict[str, np.ndarray]:
    """A doublet of the elevator at 5 and 45 s in calm flight, at 25 Hz."""
    t = np.arange(0.0, duration, 0.04)
    rng = np.random.default_rng(5)
    doublet = sum(
        np.where((t > b) & (t < b + 2), 0.05, np.where((t >= b + 2) & (t < b + 4), -0.05, 0)) for b in (5, 45)
    )
    return {
        "time": t, "elevator": doublet + 1e-4 * rng.standard_normal(len(t)),
        "q": 0.8 * doublet + 1e-3 * rng.standard_normal(len(t)), "airspeed": np.full(len(t), airspeed) + rest,
    }  # fmt: skip


def test_manoeuvres_and_parts_in_flight_are_proposed():
    data = flown(70.0, 100.0)
    record = FlightRecord.from_arrays("day", data.pop("time"), data)
    found = proposals(record, CARD)
    assert [p.what for p in found] == ["manoeuvre", "manoeuvre"]
    for proposal, begin in zip(found, (5.0, 45.0), strict=True):
        assert begin - 4.0 < proposal.begin < begin
        assert begin + 4.0 < proposal.end < begin + 9.0
        assert record.window(proposal.begin, proposal.end).n > 150
    data = flown(70.0, 100.0)
    data["airspeed"][:1000] = 1.0  # 40 s on the ground
    record = FlightRecord.from_arrays("day", data.pop("time"), data)
    flights = [p for p in proposals(record, CARD) if p.what == "in flight"]
    assert [p.begin for p in flights] == [pytest.approx(40.0, abs=0.2)]
    assert [p.end for p in flights] == [pytest.approx(69.96)]
    data = flown(11.0, 100.0)
    assert proposals(FlightRecord.from_arrays("day", data.pop("time"), data), CARD) == ()
