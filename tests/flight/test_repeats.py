"""Samples written twice, clocks that show a late hour, and gaps of one channel: as recorders make them."""

from __future__ import annotations

import re

import numpy as np
import pytest
from flight_samples import CHANNELS, sound

from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import parse_card
from bayes_aero.flight.reading.inspection import inspect_record
from bayes_aero.flight.reading.read_record import manoeuvres, read_record, write_record

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


def test_an_inspection_counts_it_once_too(doubled):
    card = parse_card(TABLE | {"linear": {"states": ["q"], "rates": {"q": {"Mq": "q"}}}}, "own", "own.toml")
    looked = inspect_record(doubled, card, resample=0.04)
    assert (looked.samples, looked.problems) == (120, ())
    assert sum("3 samples repeat" in remark for remark in looked.remarks) == 1


def test_samples_of_one_time_that_differ_are_refused(tmp_path):
    time = 0.04 * np.arange(120)
    time[30] = time[29]
    path = tmp_path / "clock.csv"
    write_record(sound(time=time), path, CHANNELS)
    with pytest.raises(InputError, match=r"repeats 1\.16 s at sample 30"):
        read_record(path, CHANNELS)


def test_a_late_clock_is_told_to_the_millisecond(tmp_path):
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
