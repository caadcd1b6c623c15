"""Excel, MDF, ULog and DataFlash: what the library wrote, or the format's specification says, comes back exactly."""

import datetime
import io
import struct
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from flight_samples import dataflash, spoilt, ulog

from bayes_aero.errors import InputError
from bayes_aero.flight.channel import Channel
from bayes_aero.flight.readers import binary as excel
from bayes_aero.flight.readers import binary as process
from bayes_aero.flight.readers.base import located
from bayes_aero.flight.readers.binary import open_dataflash, open_excel, open_mdf, open_ulog

openpyxl = pytest.importorskip("openpyxl")
asammdf = pytest.importorskip("asammdf")
pytest.importorskip("pyulog")
pytest.importorskip("pymavlink")

OPENERS = {".xlsx": open_excel, ".mf4": open_mdf, ".ulg": open_ulog, ".bin": open_dataflash}
LIBRARIES = {".xlsx": "openpyxl", ".mf4": "asammdf", ".ulg": "pyulog", ".bin": "pymavlink"}


def values_of(opened, **labels):
    """The columns of some headings, named as a card would name them."""
    channels = [Channel(name, "1", label) for name, label in labels.items()]
    return opened.read(located(channels, opened))


def names_of(opened):
    return [name for heading in opened.headings for name in heading.names]


# --------------------------------------------------------------------------------------------------------- Excel


def workbook(*sheets) -> bytes:
    """(title, rows) of each sheet."""
    book = openpyxl.Workbook()
    book.remove(book.active)
    for title, rows in sheets:
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append(row)
    out = io.BytesIO()
    book.save(out)
    return out.getvalue()


def samples(n=60):
    return [[k * 0.04, 0.1 * k if k != 5 else None, k, None if k == n - 1 else 80 + k / 7] for k in range(n)]


def test_a_sheet_with_preamble_units_and_blank_cells():
    preamble = [["Flight 12"], ["Mass", 12000.0, "kg"], []]
    header = [["time", "alpha", "q", "V", "remark"], ["s", "deg", None, "m/s"]]
    notes = [["Aircraft", "D-ABCD"], ["mass", 1200, "kg"]]
    opened = open_excel(workbook(("Notes", notes), ("Data", preamble + header + samples())))
    assert [heading.unit for heading in opened.headings] == ["s", "deg", None, "m/s", None]
    found = values_of(opened, time="time", alpha="alpha", q="q", airspeed="V")
    rows = samples()
    for k, column in enumerate(found.values()):
        expected = np.array([np.nan if row[k] is None else row[k] for row in rows], float)
        np.testing.assert_allclose(column.values, expected, rtol=1e-15)  # openpyxl writes 16 digits
    assert found["airspeed"].unit == "m/s"
    assert "sheet 'Data'" in opened.remarks[0]
    assert "row 4 is taken for the first of the table" in opened.remarks[1]


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
    began, steps = (
        datetime.datetime(2024, 5, 1, 12, 0, 30),
        [datetime.timedelta(milliseconds=40 * k) for k in range(60)],
    )
    stamps = {
        "date": [began + step for step in steps],
        "clock": [(began + step).time() for step in steps],
        "duration": steps,
    }[part]
    opened = open_excel(workbook(("Data", [["time", "x"]] + [[stamp, k] for k, stamp in enumerate(stamps)])))
    found = values_of(opened, time="time", x="x")
    np.testing.assert_allclose(found["time"].values, 0.04 * np.arange(60), atol=1e-9)


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
    monkeypatch.setattr(excel, "MOST_UNPACKED", 1000)
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


# ----------------------------------------------------------------------------------------------------------- MDF

FAST, SLOW = np.arange(100) * 0.01, np.arange(25) * 0.04


def measured(*more) -> bytes:
    """Two groups of different rate that share a name, and more signals, each in a group of its own name."""
    signal = asammdf.Signal
    with asammdf.MDF(version="4.10") as mdf:
        mdf.append(
            [
                signal(np.sin(FAST), FAST, name="alpha", unit="rad"),
                signal(np.arange(100), FAST, name="q", unit="deg/s"),
            ],
            comment="ADC",
            common_timebase=True,
        )
        words = np.array([b"on"] * 25)
        mdf.append(
            [
                signal(80.0 + SLOW, SLOW, name="V", unit="m/s"),
                signal(np.cos(SLOW), SLOW, name="alpha"),
                signal(words, SLOW, name="word", encoding="utf-8"),
            ],
            comment="GPS",
            common_timebase=True,
        )
        for other in more:
            mdf.append([other], comment=f"of {other.name}")
        out = io.BytesIO()
        mdf.save(out, overwrite=True)
    return out.getvalue()


def test_mdf_with_two_rates():
    opened = open_mdf(measured())
    assert names_of(opened) == ["time", "ADC/alpha", "q", "ADC/q", "V", "GPS/V", "GPS/alpha"]
    one = values_of(opened, time="time", alpha="ADC/alpha", q="q")
    np.testing.assert_array_equal(one["time"].values, FAST)
    np.testing.assert_array_equal(one["alpha"].values, np.sin(FAST))
    np.testing.assert_array_equal(one["q"].values, np.arange(100.0))
    assert (one["time"].unit, one["alpha"].unit, one["q"].unit) == ("s", "rad", "deg/s")
    both = values_of(opened, time="time", alpha="ADC/alpha", other="GPS/alpha")
    np.testing.assert_allclose(both["time"].values, FAST, rtol=1e-15)
    np.testing.assert_array_equal(both["alpha"].values, np.sin(FAST))
    slow = np.full(100, np.nan)
    slow[::4] = np.cos(SLOW)
    np.testing.assert_array_equal(both["other"].values, slow)
    assert both["other"].unit is None


def test_mdf_conversions_byte_order_and_invalid_samples():
    counts = np.arange(25)
    gear = {f"val_{k}": k for k in range(2)} | {f"text_{k}": f"position {k}".encode() for k in range(2)}
    opened = open_mdf(
        measured(
            asammdf.Signal(counts.astype("u1"), SLOW, name="linear", conversion={"a": 0.5, "b": -1.0}),
            asammdf.Signal(counts % 2, SLOW, name="gear", conversion=gear | {"default": b"?"}),
            asammdf.Signal(counts.astype(">f4") / 4, SLOW, name="motorola"),
            asammdf.Signal(counts.astype(float), SLOW, name="gaps", invalidation_bits=counts == 7),
        )
    )
    found = values_of(opened, time="time", linear="linear", gear="gear", motorola="motorola", gaps="gaps")
    np.testing.assert_allclose(found["time"].values, SLOW, rtol=1e-15)
    np.testing.assert_array_equal(found["linear"].values, 0.5 * counts - 1.0)
    np.testing.assert_array_equal(found["gear"].values, counts % 2)
    np.testing.assert_array_equal(found["motorola"].values, counts / 4)
    np.testing.assert_array_equal(found["gaps"].values, np.where(counts == 7, np.nan, counts))


def test_formulas_of_an_mdf_file_are_arithmetic_and_no_programs(tmp_path):
    trace = tmp_path / "trace"
    formulas = {"twice": "2*X1+1", "evil": f"__import__('pathlib').Path('{trace}').touch() or X1"}
    signals = (asammdf.Signal(np.arange(25), SLOW, name=n, conversion={"formula": f}) for n, f in formulas.items())
    opened = open_mdf(measured(*signals))
    np.testing.assert_array_equal(values_of(opened, x="twice")["x"].values, 2.0 * np.arange(25) + 1.0)
    assert "evil" not in names_of(opened)
    assert any("'evil' is left out" in remark for remark in opened.remarks)
    assert not trace.exists()


# ---------------------------------------------------------------------------------------------------------- ULog


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
    one = values_of(opened, time="time", q="vehicle_attitude.q[2]", reset="vehicle_attitude.reset")
    np.testing.assert_array_equal(one["time"].values, (1_000_000 + 4000 * np.arange(200)) / 1e6)
    np.testing.assert_array_equal(one["q"].values, 3.0 * np.arange(200))
    np.testing.assert_array_equal(one["reset"].values, np.arange(200) % 2)
    other = values_of(opened, time="time", q="vehicle_attitude.q[0]", x="sensor_accel.1.x")
    there = ~np.isnan(other["x"].values)
    np.testing.assert_array_equal(other["time"].values[there], (1_000_007 + 20_000 * np.arange(40)) / 1e6)
    np.testing.assert_array_equal(other["x"].values[there], 0.1 * np.arange(40))
    assert np.isnan(other["q"].values[there]).all()
    assert not np.isnan(other["q"].values[~there]).any()
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


# ----------------------------------------------------------------------------------------------------- DataFlash


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
    one = values_of(opened, time="time", phi="ATT.Roll", theta="ATT.Pitch", airspeed="ATT.Aspd")
    np.testing.assert_array_equal(one["time"].values, np.arange(100) / 100)
    np.testing.assert_array_equal(one["phi"].values, (100.0 * np.arange(100) - 5000) / 100)
    np.testing.assert_array_equal(one["theta"].values, -np.arange(100) / 100)
    np.testing.assert_array_equal(one["airspeed"].values, 20.0 + np.arange(100))
    assert [one[name].unit for name in ("phi", "airspeed")] == ["deg", "m/s"]
    both = values_of(opened, time="time", p="IMU[1].GyrX", latitude="GPS.Lat")
    there = ~np.isnan(both["p"].values)
    np.testing.assert_array_equal(both["time"].values[there], (2_500 + 10_000 * np.arange(100)) / 1e6)
    np.testing.assert_array_equal(both["p"].values[there], np.arange(100) + 0.5)
    np.testing.assert_array_equal(both["latitude"].values[~there], (481234567 + np.arange(5)) / 1e7)
    assert (both["p"].unit, both["latitude"].unit) == ("mrad/s", "deg")
    assert opened.remarks == []


# ---------------------------------------------------------------------------------------------------- all of them


@pytest.mark.parametrize("suffix", OPENERS)
def test_a_missing_library_is_said(suffix, monkeypatch):
    monkeypatch.setattr(process, "find_spec", lambda _: None)
    with pytest.raises(InputError) as caught:
        OPENERS[suffix](b"anything")
    assert str(caught.value) == (
        f"reading {suffix} needs {LIBRARIES[suffix]}, which is not installed; pip install 'bayes-aero[formats]', or "
        "write the record as .csv"
    )


@pytest.mark.parametrize("suffix", OPENERS)
@pytest.mark.parametrize("content", [b"PK\x03\x04", b"", b"a,b\n1,2\n", bytes(1000)], ids=["zip", "empty", "text", "0"])
def test_misnamed_files_are_refused(suffix, content):
    with pytest.raises(InputError, match=r"misnamed|not a readable"):
        OPENERS[suffix](content)


@pytest.mark.parametrize("how", ["cut", "spoilt"])
@pytest.mark.parametrize("suffix", OPENERS)
def test_damaged_files_are_read_in_part_or_refused_soon(suffix, how):
    sheet = ("Data", [["time", "x"], *([0.04 * k, k] for k in range(60))])
    sound = {".xlsx": lambda: workbook(sheet), ".mf4": measured, ".ulg": px4, ".bin": ardupilot}[suffix]()
    refusal = ""
    try:
        opened = OPENERS[suffix](sound[: len(sound) // 2] if how == "cut" else spoilt(sound, seed=1))
        columns = opened.read({str(k): heading for k, heading in enumerate(opened.headings)})
    except InputError as refused:
        refusal, columns = str(refused), {}
    assert "\n" not in refusal
    assert len(refusal) < 600
    assert len({len(column.values) for column in columns.values()}) == (0 if refusal else 1)


def test_a_parser_that_never_ends_is_stopped(monkeypatch, tmp_path):
    parser = tmp_path / "endless.py"
    parser.write_text("def groups(data):\n    while True:\n        pass\n")
    monkeypatch.setattr(process, "TIME_LIMIT", 2.0)
    with pytest.raises(InputError, match="did not finish in 2 s"):
        process.parsed_apart(b"", str(parser), "log")


def test_the_libraries_are_not_loaded_before_they_are_needed():
    program = (
        "import sys; from bayes_aero.flight.readers import READERS; "
        f"print(sorted({set(LIBRARIES)!r} - set(READERS)), {set(LIBRARIES.values())!r} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[] set()"
