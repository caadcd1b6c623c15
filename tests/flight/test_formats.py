"""Formats of files: what was written, or what a specification says, comes back; the rest is refused in words."""

import datetime
import hashlib
import io
import os
import struct
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any
from unittest.mock import Mock, patch

import asammdf
import h5py
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from flight_samples import CHANNELS, dataflash, refused, remap, sound, spoilt, ulog, workbook, written
from scipy.io import savemat

from bayes_aero.cli.terminal import SUFFIXES
from bayes_aero.errors import InputError
from bayes_aero.flight import binary
from bayes_aero.flight.channel import Channel
from bayes_aero.flight.reading import READERS, read_raw, read_record
from bayes_aero.flight.record import FlightRecord, write_record
from bayes_aero.flight.text import located

OPENERS = {suffix: READERS[suffix] for suffix in (".xlsx", ".mf4", ".ulg", ".bin")}
open_excel, open_mdf, open_ulog, open_dataflash = OPENERS.values()
LIBRARIES = {".xlsx": "openpyxl", ".mf4": "asammdf", ".ulg": "pyulog", ".bin": "pymavlink"}
FORMATS = (".asc", ".txt", ".dat", ".csv", ".mat", ".parquet", ".nc")
TWO = (Channel("time", "s", "T"), Channel("alpha", "deg", "ALCG"))
NAMED = (".csv", ".mat", ".parquet", ".nc")
T60 = np.arange(60) * 0.04


def test_every_reader_is_listed_and_tested():
    assert set(SUFFIXES.split()) == set(READERS) - {".tsv", ".txt", ".dat"}  # variants of .csv and .asc
    assert set(FORMATS) == set(READERS) - {".tsv", *OPENERS}


@pytest.mark.parametrize("suffix", FORMATS)
def test_round_trip(tmp_path, suffix):
    record = sound()
    back = read_record(written(tmp_path / f"flight{suffix}", record), CHANNELS)
    assert back.name == "flight"
    assert back.names == record.names
    for name in record.names:
        np.testing.assert_allclose(back[name], record[name], rtol=4e-16, atol=1e-18)


def test_provenance_and_case_of_suffix(tmp_path):
    path = written(tmp_path / "flight.csv", sound()).rename(tmp_path / "flight.CSV")
    record = read_record(str(path), CHANNELS)
    assert (record.source, record.sha256) == (str(path), hashlib.sha256(path.read_bytes()).hexdigest())


def test_paths_that_are_no_files(tmp_path, monkeypatch):
    path = written(tmp_path / "flight.csv", sound())
    refused(tmp_path / "fligt.csv", CHANNELS, "no such file", "did you mean flight.csv?")
    refused(tmp_path / "nowhere" / "flight.csv", CHANNELS, "folder", "does not exist", "correct the path")
    (tmp_path / "d.csv").mkdir()
    refused(tmp_path / "d.csv", CHANNELS, "directory", "name a file")
    (tmp_path / "e.csv").touch()
    refused(tmp_path / "e.csv", CHANNELS, "empty", "write it again")
    os.mkfifo(tmp_path / "p.csv")
    refused(tmp_path / "p.csv", CHANNELS, "pipe", "regular file")
    refused(tmp_path / "n\0l.csv", CHANNELS, "no such file")
    for name in ("flight.xls", "flight"):
        (tmp_path / name).write_text("x")
        refused(tmp_path / name, CHANNELS, *FORMATS, "convert")
    with monkeypatch.context() as patch:
        patch.setattr("bayes_aero.flight.reading.MAX_BYTES", 100)
        refused(path, CHANNELS, "more than 100", "cut it")
    monkeypatch.setattr(Path, "read_bytes", Mock(side_effect=PermissionError(13, "Permission denied")))
    refused(path, CHANNELS, "Permission denied", "check its name and permissions")


def mat(value, **options):
    return lambda path: savemat(path, {"T": T60, "ALCG": value}, **options)


def netcdf(values, about, engine):
    return lambda path: xr.Dataset({"T": ("t", T60), "ALCG": ("t", values, about)}).to_netcdf(path, engine=engine)


def misnamed(suffix):
    return lambda path: written(path.with_name(f"other{suffix}"), sound()).rename(path)


FLAGS = {"flag_values": np.array([0, 1], "i1"), "flag_meanings": "up down"}
SCALED = {"scale_factor": 0.001, "add_offset": 0.0, "_FillValue": np.int32(-9999), "units": "degrees"}
FAULTY = [  # suffix, what writes the file, words of the refusal
    *((suffix, misnamed(".csv"), ("again",)) for suffix in (".mat", ".parquet", ".nc")),
    *((suffix, misnamed(".parquet"), ("NUL", "Save it as UTF-8 text")) for suffix in (".asc", ".csv")),
    (".parquet", lambda path: pd.DataFrame({"T": T60, "ALCG": "x"}).to_parquet(path),
     ("channel alpha", "numbers should be", "plain numbers")),
    (".parquet", pd.DataFrame({"T": T60}).to_pickle, ("not a readable Parquet",)),
    (".mat", mat({"x": T60}), ("channel alpha", "did you mean 'ALCG.x'")),
    (".mat", mat("words"), ("channel alpha", "char", "numeric vector")),
    (".mat", mat(np.ones((60, 2))), ("channel alpha", "did you mean", "'ALCG(:,1)'")),
    (".mat", mat(np.ones(59)), ("channel alpha", "59 samples", "60", "same length")),
    (".mat", mat(T60, format="4"), ("version 5 to 7.3", "-v7")),
    *((".nc", netcdf(values, about, engine), ("channel alpha", *words)) for engine in ("h5netcdf", "scipy")
      for values, about, words in (
        (np.where(np.arange(60) == 7, np.int32(-9999), np.int32(5000)), SCALED,
         ("not a number", "sample 7 ", "t = 0.28 s", "1 of 60", "repair")),
        (np.ones(60, "i1"), FLAGS, ("flags", "flag_meanings")),
        (np.ones(60, "i1"), {"scale_factor": "0.1"}, ("scale_factor", "plain numbers")),
        (np.ones(60, "i1"), {"_Unsigned": "perhaps"}, ("_Unsigned",)))),
]  # fmt: skip


@pytest.mark.parametrize(("suffix", "write", "words"), FAULTY)
def test_a_file_of_another_format_or_without_numbers_is_refused(tmp_path, suffix, write, words):
    write(tmp_path / f"a{suffix}")
    refused(tmp_path / f"a{suffix}", TWO, *words)


CARDS = [  # format, the channels of a card that does not go with it, words of the refusal
    (".csv", CHANNELS[1:], ("channel time", "[channels]")),
    (".csv", (*CHANNELS, CHANNELS[1]), ("channel alpha", "twice", "keep one")),
    (".csv", remap("alpha", unit="degre"), ("channel alpha", "'degre'", "not known", '"deg"')),
    (".csv", remap("airspeed", unit="hPa"), ("channel airspeed", "'hPa'", "'m/s'", "correct the unit")),
    (".csv", remap("q", unit="Hz"), ("channel q", "'Hz'", '"rad/s"')),
    (".asc", remap("alpha", column=12), ("channel alpha", "column 12", "7 columns", "correct the column")),
    (".asc", remap("alpha", column=None), ("channel alpha", "no column number", "add column = N")),
    (".asc", remap("time", column=99, required=False), ("channel time", "required = true")),
    *((s, remap("alpha", label="ALCGG"), ("channel alpha", "'ALCGG'", "did you mean 'ALCG'", "label on the card"))
      for s in NAMED),
    *((s, remap("alpha", label="wxyz"), ("channel alpha", "the file has", "'QRGY'", "required = false"))
      for s in NAMED),
    *((s, remap("alpha", unit="rad"), ("channel alpha", "'deg'", "'rad'", 'unit = "deg"')) for s in NAMED[2:]),
]  # fmt: skip


@pytest.mark.parametrize(("suffix", "channels", "words"), CARDS)
def test_a_card_that_does_not_go_with_the_file_is_refused(tmp_path, suffix, channels, words):
    refused(written(tmp_path / f"flight{suffix}", sound()), channels, *words)


@pytest.mark.parametrize(("suffix", "name", "entry", "there"), [
    *((suffix, "strain", {"label": "no such"}, False) for suffix in NAMED),
    (".asc", "strain", {"column": 8}, False), (".asc", "strain", {"column": None}, False),
    *((suffix, "q", {"unit": "degree / second"}, True) for suffix in NAMED[2:]),
])  # fmt: skip
def test_what_is_not_required_may_be_missing_and_a_unit_has_several_names(tmp_path, suffix, name, entry, there):
    assert read_record(written(tmp_path / f"flight{suffix}", sound()), remap(name, **entry)).has(name) is there


def test_dates_of_a_parquet_file_are_times_and_too_many_values_are_refused(tmp_path, monkeypatch):
    frame = pd.DataFrame({"T": pd.date_range("2020-01-01", periods=60, freq="40ms"), "ALCG": T60})
    frame.to_parquet(tmp_path / "a.parquet")
    np.testing.assert_allclose(read_record(tmp_path / "a.parquet", TWO).time, T60, atol=1e-9)
    path = written(tmp_path / "flight.mat", sound(2000))
    monkeypatch.setattr("bayes_aero.flight.text.MAX_VALUES", 100)
    refused(path, CHANNELS, "claims", "-v7")


def test_matlab_v73(tmp_path):
    r = sound()
    path = tmp_path / "v73.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for label, values in (("T", r.time), ("ALCG", np.rad2deg(r["alpha"]))):
            file.create_dataset(label, data=values[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
        file["s"] = "text"
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM")
    np.testing.assert_allclose(read_record(path, TWO)["alpha"], r["alpha"], rtol=1e-15)
    refused(path, [*TWO, Channel("q", "deg/s", "s")], "channel q", "numbers should be")
    refused(path, [*TWO, Channel("q", "deg/s", "QRGY")], "channel q", "the file has", "'ALCG'")


def test_hdf5_that_takes_for_ever_crashes_or_has_no_library(tmp_path, monkeypatch):
    path = written(tmp_path / "flight.nc", sound())
    monkeypatch.setattr(binary, "TIME_LIMIT", 0.001)
    refused(path, CHANNELS, "did not finish", "write it again")
    monkeypatch.undo()
    monkeypatch.setattr("sys.executable", "/bin/false")
    refused(path, CHANNELS, "crashed", "write it again")
    monkeypatch.setattr(binary, "find_spec", lambda _: None)
    refused(path, CHANNELS, "h5py is not installed", "install h5py")


PACKED = [  # stored numbers, their attributes, the numbers they stand for: by hand
    (np.array([0, 1, 40000, 65535], "u2").view("i2"), {"_Unsigned": "true", "scale_factor": 0.5},
     [0.0, 0.5, 20000.0, 32767.5]),
    (np.array([0, 65535, 40000, 9], "u2").view("i2"),
     {"_Unsigned": "true", "scale_factor": 0.0004, "add_offset": -23.5, "_FillValue": np.int16(-1)},
     [-23.5, np.nan, -7.5, -23.4964]),
    (np.array([0, 65535, 40000, 9], "u2").view("i2"),
     {"_Unsigned": "True", "add_offset": 1.5, "missing_value": np.int16(-1)}, [1.5, np.nan, 40001.5, 10.5]),
    (np.array([0, 5, 251, 255], "u1"), {"_Unsigned": "false", "scale_factor": 2.0}, [0, 10, -10, -2]),
    (np.array([1, 2, 3, 4], "i4"), {"missing_value": np.array([2, 4], "i4")}, [1, np.nan, 3, np.nan]),
    # Valid ranges of stored, of unpacked and of unsigned numbers, and a value that was never written
    (np.array([1, 50, 200, 7], "i2"), {"scale_factor": 0.1, "valid_range": np.array([5, 100], "i2")},
     [np.nan, 5.0, np.nan, 0.7]),
    (np.array([1, 50, 200, 7], "i2"), {"scale_factor": 0.1, "valid_range": np.array([0.5, 10.0])},
     [np.nan, 5.0, np.nan, 0.7]),
    (np.array([3, 50000, 60000, 7], "u2").view("i2"),
     {"_Unsigned": "true", "valid_min": np.int16(5), "valid_max": np.array(50000, "u2").view("i2")[()]},
     [np.nan, 50000, np.nan, 7]),
    (np.array([1.0, 9.969209968386869e36, 3.0, 4.0]), {}, [1, np.nan, 3, 4]),
]  # fmt: skip


@pytest.mark.parametrize("classic", [False, True])
def test_packed_netcdf_stands_for_its_numbers(tmp_path, classic):
    """After the CF conventions and the NetCDF User's Guide."""
    path = tmp_path / "packed.nc"
    if classic:  # its bytes have a sign
        plain = [x.view("i1") if x.dtype == "u1" else x for x, *_ in PACKED]
        data = xr.Dataset({f"v{i}": ("t", x, PACKED[i][1]) for i, x in enumerate(plain)})
        data.to_netcdf(path, engine="scipy", encoding={name: {"_FillValue": None} for name in data})
    else:
        with h5py.File(path, "w") as file:
            for i, (x, about, _) in enumerate(PACKED):
                file.create_dataset(f"v{i}", data=x, dtype=x.dtype.newbyteorder(">")).attrs.update(about)
    read: Any = {column.label: column.values for column in read_raw(path).columns}
    for i, (_, about, right) in enumerate(PACKED):
        np.testing.assert_allclose(read[f"v{i}"], right, rtol=1e-14, err_msg=str(about))


def test_netcdf_of_the_classic_format_and_times_since_a_date(tmp_path):
    """At 1 kHz a step of 1 ms could be one of 1 s."""
    r = sound()
    columns = {"T": ("t", 1000.0 * r.time, {"units": "milliseconds since 2020-01-01"}), "ALCG": ("t", r["alpha"])}
    for engine in ("h5netcdf", "scipy"):
        path = tmp_path / f"{engine}.nc"
        xr.Dataset(columns).to_netcdf(path, engine=engine)
        refused(path, [Channel("time", "s", "T"), Channel("alpha", "rad", "ALCG")], "'milliseconds'", 'unit = "ms"')
        read = read_record(path, [Channel("time", "ms", "T"), Channel("alpha", "rad", "ALCG")])
        np.testing.assert_allclose(read.time, r.time, rtol=1e-14)


def test_what_is_written_can_be_read_back(tmp_path):
    record = sound()
    for path, channels, words in (
        (tmp_path / "a.xls", CHANNELS, (".csv", "suffix")),
        (tmp_path / "a.asc", remap("q", column=None), ("channel q", "column = N")),
        (tmp_path / "a.mat", remap("q", label="pitch rate"), ("channel q", "'pitch rate'", "label")),
        (tmp_path / "no" / "a.csv", CHANNELS, ("cannot be written", "permissions")),
        (tmp_path / "a.csv", (*CHANNELS, Channel("beta", "deg", "BE")), ("no channel beta",)),
    ):
        with pytest.raises(InputError) as caught:
            write_record(record, path, channels)
        for word in words:
            assert word in str(caught.value)
    assert list(tmp_path.iterdir()) == []
    lean = FlightRecord.from_arrays("lean", record.time, {k: v for k, v in record.channels.items() if k != "strain"})
    assert not read_record(written(tmp_path / "flight.csv", lean), CHANNELS).has("strain")


# The real files through the shipped card
G = np.pi / 180
FIRST = {  # sample of qst01 in SI, typed off the file's first line; of the pressure the publisher's list says hPa
    "time": 0.0, "ax": 1.145436, "ay": 0.0941775, "az": -9.35899, "p": 0.35808659 * G, "q": 0.30738040 * G,
    "r": -0.01799775 * G, "phi": -1.7633063 * G, "theta": 6.7126475 * G, "psi": 2.2357386 * G, "alpha": 5.16904 * G,
    "beta": -0.793239 * G, "airspeed": 98.74842, "altitude": 5469.941, "radio_altitude": 787.8696,
    "calibrated_airspeed": 77.27116, "elevator": 1.8355276 * G, "stabilizer": -1.3252772 * G, "n1_left": 0.8326477,
    "n1_right": 0.8559144, "dlc_left": -0.84823881 * G, "dlc_right": -0.83640264 * G,
    "aileron_left": -0.87378929 * G, "aileron_right": 0.08288121 * G, "rudder": -0.96240466 * G, "mach": 0.3186875,
    "static_temperature": 249.8909, "static_pressure": 50956.0, "density": 0.7103676, "thrust_left": 10281.97,
    "thrust_right": 11068.86, "fuel_used": 1990.0, "flap": 1.2531498 * G, "spoiler_left": 0.086010018 * G,
    "spoiler_right": 0.19280941 * G,
}  # fmt: skip


@pytest.mark.attas
@pytest.mark.parametrize(("number", "n", "end"), [(1, 3001, 120.0), (2, 2051, 82.0)])
def test_the_card_of_the_attas_maps_its_files(attas_paths, card, number, n, end):
    """By the file's first line, the gas law, and Mach; the unit registry is made once."""
    path = attas_paths[number - 1]
    r = read_record(path, card.channels)
    with patch("pint.UnitRegistry", side_effect=AssertionError("made twice")):
        read_record(path, card.channels)
    assert (r.name, r.n, r.time[-1]) == (f"fAttas_qst0{number}", n, pytest.approx(end))
    assert r.dt == pytest.approx(0.04, rel=1e-9)
    assert set(r.names) == set(FIRST)
    for channel, value in FIRST.items():
        assert number == 2 or r[channel][0] == pytest.approx(value, rel=1e-12, abs=1e-15), channel
    np.testing.assert_allclose(r["static_pressure"], r["density"] * 287.05 * r["static_temperature"], rtol=0.01)
    np.testing.assert_allclose(r["mach"], r["airspeed"] / np.sqrt(1.4 * 287.05 * r["static_temperature"]), atol=0.03)


def values_of(opened, **labels):
    """The columns of some headings, named as a card would name them."""
    channels = [Channel(name, "1", label) for name, label in labels.items()]
    return opened.read(located(channels, opened))


def hold(columns, place: Any = slice(None), **expected):
    """The columns have these numbers there."""
    for name, values in expected.items():
        np.testing.assert_array_equal(columns[name].values[place], values, err_msg=name)


def names_of(opened):
    return [name for heading in opened.headings for name in heading.names]


# Excel
def test_a_sheet_with_preamble_units_and_blank_cells():
    preamble = [["Flight 12"], ["Mass", 12000.0, "kg"], []]
    header = [["time", "alpha", "q", "V", "remark"], ["s", "deg", None, "m/s"]]
    notes = [["Aircraft", "D-ABCD"], ["mass", 1200, "kg"]]
    rows = [[k * 0.04, 0.1 * k if k != 5 else None, k, None if k == 59 else 80 + k / 7] for k in range(60)]
    opened = open_excel(workbook(("Notes", notes), ("Data", preamble + header + rows)))
    assert [heading.unit for heading in opened.headings] == ["s", "deg", None, "m/s", None]
    columns = values_of(opened, time="time", alpha="alpha", q="q", airspeed="V")
    for k, column in enumerate(columns.values()):
        expected = np.array([np.nan if row[k] is None else row[k] for row in rows], float)
        np.testing.assert_allclose(column.values, expected, rtol=1e-15)  # openpyxl writes 16 digits
    assert columns["airspeed"].unit == "m/s"
    assert "sheet 'Data'" in opened.remarks[0]
    assert "line 4 is taken for the first of the table" in opened.remarks[1]


def test_tables_of_a_workbook_are_found_and_three_decimals_are_no_thousands():
    first, second = ([["time", "x"]] + [[0.04 * k, factor * k] for k in range(60)] for factor in (1, 2))
    opened = open_excel(workbook(("One", first), ("Two", second)))
    np.testing.assert_array_equal(values_of(opened, x="x")["x"].values, np.arange(60.0))
    assert "sheet 'One' is read, the first of 2 with a table" in opened.remarks[0]
    notes = [["Flight 12"], ["Mass", 12000, "kg"], ["time", "x", "y"], ["s", "m"]]
    late = [[0.04 * k] if k < 10 else [0.04 * k, k, 1] for k in range(70)]
    opened = open_excel(workbook(("Data", notes + late)))
    assert [(heading.names, heading.unit) for heading in opened.headings] == [
        (("time",), "s"), (("x",), "m"), (("y",), None),
    ]  # fmt: skip
    x = values_of(opened, time="time", x="x")["x"].values
    np.testing.assert_array_equal(x, np.r_[np.full(10, np.nan), np.arange(10.0, 70.0)])
    # Beside a text cell with a decimal comma, 1.234 in a text file would be 1234.
    rows = [["time", "x"]] + [[k / 8 + 1.0, f"{k},5"] for k in range(60)]
    opened = open_excel(workbook(("Data", rows)))
    with pytest.raises(InputError, match="decimal comma"):
        values_of(opened, time="time", x="x")
    np.testing.assert_array_equal(values_of(opened, time="time")["time"].values, np.arange(60) / 8 + 1.0)


@pytest.mark.parametrize("part", ["date", "clock", "duration"])
def test_dates_and_times_of_a_sheet_are_seconds_from_the_first(part):
    began, steps = datetime.datetime(2024, 5, 1, 12, 0, 30), [datetime.timedelta(0, 0.04 * k) for k in range(60)]
    dates = [began + step for step in steps]
    stamps = {"date": dates, "clock": [date.time() for date in dates], "duration": steps}[part]
    opened = open_excel(workbook(("Data", [["time", "x"]] + [[stamp, k] for k, stamp in enumerate(stamps)])))
    time = values_of(opened, time="time", x="x")["time"].values
    np.testing.assert_allclose(time, 0.04 * np.arange(60), atol=1e-9)


def test_workbooks_that_are_old_or_unpack_without_end_are_refused(monkeypatch):
    with pytest.raises(InputError, match=r"save it as \.xlsx"):
        open_excel(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600))
    data = workbook(("Data", [["time", "x"], *([0.04 * k, k] for k in range(60))]))
    bomb = '<!DOCTYPE w [<!ENTITY a "aaaaaaaaaa">' + "".join(
        f'<!ENTITY {b} "{10 * f"&{a};"}">' for a, b in zip("abcdefghi", "bcdefghij", strict=True)
    )
    sheet, name = "xl/worksheets/sheet1.xml", "xl/workbook.xml"
    for part, begin, place in ((sheet, b"<worksheet", b">x<"), (name, b"<workbook", b'"Data"')):
        mined = rewritten(data, part, begin, (bomb + "]>").encode() + begin)
        with pytest.raises(InputError, match="not a readable Excel workbook"):
            open_excel(rewritten(mined, part, place, place[:1] + b"&j;" + place[-1:]))
    far = rewritten(data, sheet, b'<row r="2"', b'<row r="1000000000000"')
    with pytest.raises(InputError, match="rows"):
        open_excel(far)
    monkeypatch.setattr(binary, "MOST_UNPACKED", 1000)
    with pytest.raises(InputError, match="unpacks to"):
        open_excel(data)


def rewritten(data: bytes, name: str, old: bytes, new: bytes) -> bytes:
    """A workbook with a change in one of its parts."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as source, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as copy:
        for entry in source.namelist():
            content = source.read(entry)
            copy.writestr(entry, content.replace(old, new, 1) if entry == name else content)
    return out.getvalue()


# MDF
FAST, SLOW = np.arange(100) * 0.01, np.arange(25) * 0.04


def measured(*more) -> bytes:
    """Two groups of different rate that share a name, and more signals, each in a group of its own name."""
    signal, words = asammdf.Signal, np.array([b"on"] * 25)
    groups = {
        "ADC": [signal(np.sin(FAST), FAST, name="alpha", unit="rad"),
                signal(np.arange(100), FAST, name="q", unit="deg/s")],
        "GPS": [signal(80.0 + SLOW, SLOW, name="V", unit="m/s"), signal(np.cos(SLOW), SLOW, name="alpha"),
                signal(words, SLOW, name="word", encoding="utf-8")],
    }  # fmt: skip
    with asammdf.MDF(version="4.10") as mdf:
        for name, signals in groups.items():
            mdf.append(signals, comment=name, common_timebase=True)
        for other in more:
            mdf.append([other], comment=f"of {other.name}")
        out = io.BytesIO()
        mdf.save(out, overwrite=True)
    return out.getvalue()


def test_mdf_with_two_rates():
    opened = open_mdf(measured())
    assert names_of(opened) == ["time", "ADC/alpha", "q", "ADC/q", "V", "GPS/V", "GPS/alpha"]
    fast = values_of(opened, time="time", alpha="ADC/alpha", q="q")
    hold(fast, time=FAST, alpha=np.sin(FAST), q=np.arange(100.0))
    assert [column.unit for column in fast.values()] == ["s", "rad", "deg/s"]
    both = values_of(opened, time="time", alpha="ADC/alpha", other="GPS/alpha")
    np.testing.assert_allclose(both["time"].values, FAST, rtol=1e-15)
    slow = np.full(100, np.nan)
    slow[::4] = np.cos(SLOW)
    hold(both, alpha=np.sin(FAST), other=slow)
    assert both["other"].unit is None


def test_mdf_conversions_byte_order_invalid_samples_and_formulas_that_are_not_run(tmp_path):
    counts, trace = np.arange(25), tmp_path / "trace"
    gear = {f"val_{k}": k for k in range(2)} | {f"text_{k}": f"position {k}".encode() for k in range(2)}
    signals = {
        "linear": {"samples": counts.astype("u1"), "conversion": {"a": 0.5, "b": -1.0}},
        "gear": {"samples": counts % 2, "conversion": gear | {"default": b"?"}},
        "motorola": {"samples": counts.astype(">f4") / 4},
        "gaps": {"samples": counts.astype(float), "invalidation_bits": counts == 7},
    }
    formula: Any = {"formula": f"__import__('pathlib').Path('{trace}').touch() or X1"}
    evil = asammdf.Signal(counts, SLOW, name="evil", conversion=formula)
    sound = (asammdf.Signal(timestamps=SLOW, name=name, **x) for name, x in signals.items())
    opened = open_mdf(measured(evil, *sound))
    assert "evil" not in names_of(opened)
    assert any("'evil' is left out" in remark for remark in opened.remarks)
    assert not trace.exists()
    columns = values_of(opened, time="time", **{name: name for name in signals})
    np.testing.assert_allclose(columns["time"].values, SLOW, rtol=1e-15)
    gaps = np.where(counts == 7, np.nan, counts)
    hold(columns, linear=0.5 * counts - 1.0, gear=counts % 2, motorola=counts / 4, gaps=gaps)


# ULog
def px4() -> bytes:
    fast, slow = 5_000_000 + 4000 * np.arange(200), 5_000_000 + 20_000 * np.arange(40)
    attitude = [struct.pack("<4f?", k, 2 * k, 3 * k, 4 * k, k % 2) for k in range(200)]
    accel = [struct.pack("<dB3s", 0.1 * k, k, b"abc") for k in range(40)]
    fields = ["float[4] q", "bool reset"], ["double x", "uint8_t count", "char[3] word"]
    return ulog(
        [
            ("vehicle_attitude", 0, fields[0], fast, attitude),
            ("sensor_accel", 0, fields[1], slow, accel),
            ("sensor_accel", 1, fields[1], slow + 7, accel),
        ],
        start=4_000_000,
        dropout_ms=120,
    )


def test_ulog_with_instances_arrays_and_two_rates():
    opened = open_ulog(px4())
    assert names_of(opened) == [
        "time",
        *(f"sensor_accel.{name}" for name in ("x", "count", "1.x", "1.count")),
        *(f"vehicle_attitude.{name}" for name in ("q[0]", "q[1]", "q[2]", "q[3]", "reset")),
    ]
    attitude = values_of(opened, time="time", q="vehicle_attitude.q[2]", reset="vehicle_attitude.reset")
    k = np.arange(200)
    hold(attitude, time=(1_000_000 + 4000 * k) / 1e6, q=3.0 * k, reset=k % 2)
    both = values_of(opened, time="time", q="vehicle_attitude.q[0]", x="sensor_accel.1.x")
    there, k = ~np.isnan(both["x"].values), np.arange(40)
    hold(both, there, time=(1_000_007 + 20_000 * k) / 1e6, x=0.1 * k)
    np.testing.assert_array_equal(np.isnan(both["q"].values), there)
    assert opened.remarks == ["the logger lost samples 1 times, for 0.12 s in all"]


def test_a_clock_that_runs_backwards_is_not_joined_with_another():
    stamps = np.r_[4000 * np.arange(100), 4000 * np.arange(50)]
    rows = [struct.pack("<f", k) for k in range(150)]
    other = ("b", 0, ["float y"], 10 * np.arange(150), rows)
    raw = ulog([("a", 0, ["float x"], 4000 * np.arange(150), rows), other])
    for k in range(100, 150):  # the samples stay in their places
        raw = raw.replace(struct.pack("<HQ", 0, 4000 * k), struct.pack("<HQ", 0, int(stamps[k])))
    opened = open_ulog(raw)
    np.testing.assert_array_equal(values_of(opened, time="time", x="a.x")["time"].values, stamps / 1e6)
    with pytest.raises(InputError, match=r"the time of a runs backwards at its sample 100 .* t = 0 s"):
        values_of(opened, time="time", x="a.x", y="b.y")


# DataFlash
def ardupilot() -> bytes:
    kinds = {
        60: ("ATT", "Qccf", "TimeUS,Roll,Pitch,Aspd"), 61: ("IMU", "QBf", "TimeUS,I,GyrX"),
        62: ("GPS", "QBL", "TimeUS,I,Lat"), 63: ("MODE", "QN", "TimeUS,Name"),
    }  # fmt: skip
    began = 70_000_000
    messages = [(60, (began + 10_000 * k, 100 * k - 5000, -k, 20.0 + k)) for k in range(100)]
    messages += [(61, (began + 2_500 + 10_000 * k, i, k + 0.5 * i)) for k in range(100) for i in range(2)]
    messages += [(62, (began + 200_000 * k, 0, 481234567 + k)) for k in range(5)]
    messages += [(63, (began, b"AUTO"))]
    return dataflash(
        kinds,
        sorted(messages, key=lambda message: message[1][0]),
        units=[("s", "s"), ("d", "deg"), ("n", "m/s"), ("E", "rad/s"), ("D", "deglatitude"), ("#", "instance")],
        multipliers=[("F", 1e-6), ("B", 1e-2), ("-", 0.0), ("C", 1e-3)],
        meanings=[(60, "sddn", "FBB-"), (61, "s#E", "F-C"), (62, "s#D", "F--")],
    )


def test_dataflash_with_units_multipliers_instances_and_several_rates():
    opened = open_dataflash(ardupilot())
    wanted = {"ATT.Roll", "ATT.Pitch", "ATT.Aspd", "IMU[0].GyrX", "IMU[1].GyrX", "GPS[0].Lat", "GPS.Lat"}
    assert wanted | {"time"} == set(names_of(opened))
    attitude, k = values_of(opened, time="time", phi="ATT.Roll", theta="ATT.Pitch", airspeed="ATT.Aspd"), np.arange(100)
    hold(attitude, time=k / 100, phi=(100.0 * k - 5000) / 100, theta=-k / 100, airspeed=20.0 + k)
    assert [attitude[name].unit for name in ("phi", "airspeed")] == ["deg", "m/s"]
    both = values_of(opened, time="time", p="IMU[1].GyrX", latitude="GPS.Lat")
    there = ~np.isnan(both["p"].values)
    hold(both, there, time=(2_500 + 10_000 * k) / 1e6, p=k + 0.5)
    hold(both, ~there, latitude=(481234567 + np.arange(5)) / 1e7)
    assert (both["p"].unit, both["latitude"].unit) == ("mrad/s", "deg")
    assert opened.remarks == []


# All of them
@pytest.mark.parametrize("suffix", OPENERS)
def test_a_missing_library_is_said(suffix, monkeypatch):
    monkeypatch.setattr(binary, "find_spec", lambda _: None)
    with pytest.raises(InputError, match=rf"reading {suffix} needs {LIBRARIES[suffix]}: pip install .*formats.*\.csv"):
        OPENERS[suffix](b"anything")


@pytest.mark.parametrize("suffix", OPENERS)
@pytest.mark.parametrize("content", [b"PK\x03\x04", b"", b"a,b\n1,2\n"], ids=["zip", "empty", "text"])
def test_misnamed_files_are_refused(suffix, content):
    with pytest.raises(InputError, match=r"misnamed|not a readable"):
        OPENERS[suffix](content)


@pytest.mark.parametrize("how", ["cut", "spoilt"])
@pytest.mark.parametrize("suffix", OPENERS)
def test_damaged_files_are_read_in_part_or_refused_soon(suffix, how):
    sheet = ("Data", [["time", "x"], *([0.04 * k, k] for k in range(60))])
    data = {".xlsx": lambda: workbook(sheet), ".mf4": measured, ".ulg": px4, ".bin": ardupilot}[suffix]()
    refusal, columns = "", {}
    try:
        opened = OPENERS[suffix](data[: len(data) // 2] if how == "cut" else spoilt(data, seed=1))
        columns = opened.read({str(k): heading for k, heading in enumerate(opened.headings)})
    except InputError as reason:
        refusal = str(reason)
    assert "\n" not in refusal
    assert len(refusal) < 600
    assert len({len(column.values) for column in columns.values()}) == (0 if refusal else 1)


def test_the_libraries_are_not_loaded_before_they_are_needed():
    program = (
        "import sys; from bayes_aero.flight.reading import READERS; "
        f"print(sorted({set(LIBRARIES)!r} - set(READERS)), {set(LIBRARIES.values())!r} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[] set()"
