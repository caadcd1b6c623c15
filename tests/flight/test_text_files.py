"""Text files as loggers write them, and as nobody should: read alike, or refused in words that help."""

import re
from typing import Any

import numpy as np
import pandas as pd
import pytest
from flight_samples import CHANNELS, refused, sound, written

from bayes_aero.errors import InputError
from bayes_aero.flight.channel import Channel
from bayes_aero.flight.reading import read_raw, read_record
from bayes_aero.flight.text import Marks, marks_of, number_of, seconds

LABELS = [channel.heading for channel in CHANNELS]


def table(tmp_path) -> pd.DataFrame:
    return pd.read_csv(written(tmp_path / "plain.csv", sound()))


def same(path, **options) -> None:
    """The file holds the plain record."""
    record, plain = read_record(path, CHANNELS, **options), sound()
    assert record.names == plain.names
    for name in plain.names:
        np.testing.assert_allclose(record[name], plain[name], rtol=1e-6, atol=1e-6 * np.ptp(plain[name]))


def columns(frame: pd.DataFrame, gap: str = ",", decimal: str = ".") -> str:
    rows = [gap.join(f"{x:.9f}".replace(".", decimal) for x in row) for row in frame.to_numpy()]
    return "\n".join(rows) + "\n"


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize(("gap", "decimal"), [(";", ","), (";", "."), ("\t", ","), ("\t", "."), (" | ", ".")])
def test_separators_and_decimal_marks(tmp_path, gap, decimal, ending):
    path = tmp_path / "a.csv"
    text = gap.join(LABELS) + "\n" + columns(table(tmp_path), gap, decimal)
    path.write_text(text.replace("\n", ending), newline="")
    same(path)


HEADER = ",".join(LABELS) + "\n"
UNITS = ",".join(f"[{channel.unit}]" for channel in CHANNELS) + "\n"
LONG = ",".join(f"Long name {k}" for k in range(len(LABELS))) + "\n"


@pytest.mark.parametrize("above", [
    HEADER,
    "sep=,\n" + HEADER,
    "Aircraft,Demo\nDate,2024-05-06\nSampling,25 Hz\n\n" + HEADER,
    "Flight test 7\n25 Hz, cut by hand\n" + HEADER + UNITS,
    HEADER + UNITS,
    LONG + HEADER,
    HEADER + LONG + UNITS,
    "#info,log_version=1.00\n" + LONG + HEADER,
    "# " + HEADER,
    "% " + HEADER,
])  # fmt: skip
def test_what_stands_above_the_samples(tmp_path, above):
    path = tmp_path / "a.csv"
    body = columns(table(tmp_path))
    path.write_text(above + body)
    same(path)
    path.write_text(above + body + "," * (len(LABELS) - 1) + "\n\n")
    same(path)
    path.write_text((above + body).replace(",", " , "))
    same(path)


def test_columns_between_blanks_in_utf16_and_without_a_name(tmp_path):
    path = tmp_path / "a.asc"
    body = columns(table(tmp_path), "   ")
    path.write_text("Date file: flight\n7 variables\n\n  " + "   ".join(LABELS) + "\n" + body)
    same(path)
    path.write_text("   ".join(f"{label} raw" for label in LABELS) + "\n" + body)  # names of two words
    assert [column.label for column in read_raw(path).columns] == [f"{label} raw" for label in LABELS]
    text = HEADER.strip() + ",\n" + columns(table(tmp_path)).replace("\n", ",\n")
    (tmp_path / "a.csv").write_text(text, encoding="utf-16")
    same(tmp_path / "a.csv")
    assert [column.label for column in read_raw(tmp_path / "a.csv").columns] == LABELS


QUOTED_HEADER = ",".join(f'"{label}"' for label in LABELS) + "\n"
QUOTE = lambda row: '"' + row.replace(",", '","') + '"'


@pytest.mark.parametrize(("header", "write"), [
    ("\ufeff" + HEADER.replace("\n", "\r\n"), str),
    ("# a comment\n\n" + HEADER.replace(",", "; "), lambda row: row.replace(",", "; ")),
    (HEADER + ",".join(channel.unit.replace("deg", "°") for channel in CHANNELS) + "\n", str),
    (HEADER, lambda row: row + ","),
    ("NOTE," + HEADER, lambda row: "level," + row),
    (QUOTED_HEADER, lambda row: QUOTE(row).replace(".", ",")),
    (HEADER + UNITS.replace("[", '"').replace("]", '"'), lambda row: QUOTE(row).replace(".", ",")),
    ('"NOTE, with ""a"" comma",' + HEADER, lambda row: '"level, ""trimmed""; 2",' + row),
    ('"a, b, c, d, e, f";' + HEADER.replace(",", ";"), lambda row: '"x;y";' + row.replace(",", ";").replace(".", ",")),
    (QUOTED_HEADER.replace(",", "\t"), lambda row: QUOTE(row).replace(",", "\t")),
    (HEADER, lambda row: QUOTE(row) + ","),
])  # fmt: skip
def test_csv_as_people_write_it(tmp_path, header, write):
    rows = map(write, columns(table(tmp_path)).splitlines())
    (tmp_path / "people.csv").write_text(header + "\n".join(rows) + "\n\n# the end\n", "utf-8")
    same(tmp_path / "people.csv")


# Quoted cells that hold the separator
QUOTED = (Channel("time", "s", "T"), Channel("alpha", "deg", "alpha, left vane"), Channel("altitude", "m", "H"))


def quoted_file(folder):
    """Commas between 60 rows' cells, and decimal ones within quotes."""
    rows = [f'"{0.04 * i:.2f}","{0.5 + 0.01 * i:.2f}","{5000 + i}"' for i in range(60)]
    path = folder / "quoted.csv"
    path.write_text("\n".join(['T,"alpha, left vane",H', *(row.replace(".", ",") for row in rows)]))
    return path


MISSING = lambda line: re.sub("[ ,][^ ,]*$", "", line)
UNCLOSED = lambda line: "".join(line.rpartition('"')[::2])
THIRD = lambda cell: lambda line: re.sub("^(([^ ,]+[ ,]){2})[^ ,]*", rf"\g<1>{cell}", line)
FAULTS = [  # suffix of the file, line from 0, what is done to it, words of the refusal
    (".asc", 31, MISSING, ("line 32", "sample 31", "6 columns where 7", "complete or delete that line")),
    (".csv", 31, MISSING, ("line 32", "sample 30", "6 columns where 7", "complete or delete that line")),
    (".csv", 1, MISSING, ("line 2", "6 columns", "complete or delete")),
    (".csv", 0, lambda line: MISSING(MISSING(line)), ("header in line 1 names 5 columns", "have 7")),
    (".csv", 20, THIRD(""), ("channel q", "empty", "sample 19", "resampling")),
    *((suffix, 20, THIRD(cell), ("channel q", f"'{cell}'", "line 21", "column 3", "sample", "correct or delete"))
      for suffix in (".asc", ".csv") for cell in ("abc", "1_0", "1.0x+00")),
    ("", 20, lambda _: '"0,76","a, b",5019', ("channel alpha", "line 21", "column 2", "sample 19")),
    ("", 20, lambda _: '"0,76","0,69"', ("line 21", "2 columns where 3")),
    *(("", row, UNCLOSED, (f"line {row + 1} has a quote that is not closed", "close it")) for row in (0, 1, 60)),
]  # fmt: skip


@pytest.mark.parametrize(("suffix", "row", "change", "words"), FAULTS)
def test_a_wrong_line_is_refused_with_its_place(tmp_path, suffix, row, change, words):
    path = written(tmp_path / f"a{suffix}", sound()) if suffix else quoted_file(tmp_path)
    lines = path.read_text().splitlines()
    lines[row] = change(lines[row])
    path.write_text("\n".join(lines))
    refused(path, CHANNELS if suffix else QUOTED, *words)


@pytest.mark.parametrize(("text", "words"), [
    ("T,ALCG,ALCG\n0,1,2\n", ("channel alpha", "2 columns", "rename")),
    ("T,ALCG\n0,1\n0.04,\n", ("2 samples; at least 50",)),
    ("T,ALCG\n", ("no samples", "again")),
    ("\n \n# only words\n", ("no data", "write the record again")),
])  # fmt: skip
def test_what_is_no_table_is_refused(tmp_path, text, words):
    (tmp_path / "a.csv").write_text(text)
    refused(tmp_path / "a.csv", CHANNELS[:2], *words)


def test_thousands_fortran_exponents_and_overflows(tmp_path):
    frame = table(tmp_path)
    path = tmp_path / "a.asc"
    rows = ["  ".join(f"{x:.9E}".replace("E", "D") for x in row) for row in frame.to_numpy()]
    path.write_text("\n".join(rows))
    same(path)
    rows[30] = "  ".join(["*" * 12 if k == 2 else cell for k, cell in enumerate(rows[30].split())])
    path.write_text("\n".join(rows))
    refused(path, CHANNELS, CHANNELS[2].name, "sample 30", "resampling")
    same(path, resample=0.04)
    path = tmp_path / "a.csv"
    big = [f"{1000.0 * k + 4562:,.0f}" for k in range(len(frame))]
    text = frame.assign(H=big).to_csv(index=False, sep=";")
    path.write_text(text)
    channels = [*CHANNELS, Channel("altitude", "ft", "H")]
    record = read_record(path, channels)
    np.testing.assert_allclose(record["altitude"], 0.3048 * (1000.0 * np.arange(len(frame)) + 4562))
    assert any("thousands" in remark for remark in record.remarks)


@pytest.mark.parametrize(("cells", "marks"), [
    (["1,5", "0,040"], Marks(",")), (["4,562", "0.9"], Marks(".", ",")), (["4.562,3", "0,9"], Marks(",", ".")),
    (["1,234,567"], Marks(".", ",")), (["4,562.5"], Marks(".", ",")), (["1.5", "7"], Marks(".")),
    (["1,5E-03"], Marks(",")), (["-0,123"], Marks(",")),
])  # fmt: skip
def test_marks(cells, marks):
    assert marks_of(cells) == marks


def test_numbers_and_marks_that_are_not_decided():
    assert number_of("1.5D+02", Marks()) == 150.0
    assert number_of("1.234,5", Marks(",", ".")) == 1234.5
    assert number_of("12'345.5", Marks()) == 12345.5
    assert np.isnan(number_of("#N/A", Marks()))
    for cell in ("1_000", "12:30", "abc", "1 2"):
        with pytest.raises(ValueError, match=r"."):
            number_of(cell, Marks())
    with pytest.raises(InputError, match=r"4,562.*decimal comma or stand before thousands"):
        marks_of(["4,562", "5"])
    with pytest.raises(InputError, match=r"decimal comma and .* decimal point"):
        marks_of(["1,5", "0.25"])


@pytest.mark.parametrize(("cells", "expected"), [
    (["10:23:45.000", "10:23:45.040"], [0.0, 0.04]),
    (["23:59:59.5", "00:00:00.5"], [0.0, 1.0]),
    (["59:59.9", "00:00.1"], [0.0, 0.2]),
    (["127:23:59:59.0", "128:00:00:01.5"], [0.0, 2.5]),
    (["2024-05-06T10:23:45.5Z", "2024-05-06T10:23:46Z"], [0.0, 0.5]),
    (["2024-05-06 23:59:59", "2024-05-07 00:00:01"], [0.0, 2.0]),
    (["05/06/2024 10:23:45.25", "05/06/2024 10:23:46.00"], [0.0, 0.75]),
    (["10:23:45 AM", "10:23:47 AM"], [0.0, 2.0]),
])  # fmt: skip
def test_clock_times(cells, expected):
    np.testing.assert_allclose(seconds(cells), expected, atol=1e-9)


def test_time_as_a_date(tmp_path):
    frame = table(tmp_path)
    stamps: Any = pd.Timestamp("2024-05-06 23:59:58") + pd.to_timedelta(frame[LABELS[0]].to_numpy(), unit="s")
    frame[LABELS[0]] = stamps.strftime("%d.%m.%Y %H:%M:%S.%f")
    frame.to_csv(tmp_path / "a.csv", index=False)
    record = read_record(tmp_path / "a.csv", CHANNELS)
    np.testing.assert_allclose(record.time, sound().time, atol=1e-6)
    assert "is t = 0" in record.remarks[0]


def test_several_rates_are_interpolated_on_request(tmp_path):
    """A slow channel between its own samples is as a cubic spline has it, to its error for a sine."""
    frame = table(tmp_path)
    t = frame[LABELS[0]].to_numpy()
    frame["H"] = 5000.0 + 100.0 * np.sin(0.5 * t)
    channels = [*CHANNELS, Channel("altitude", "m", "H")]
    frame.loc[np.arange(len(frame)) % 5 != 0, "H"] = np.nan
    frame.to_csv(tmp_path / "a.csv", index=False)
    refused(
        tmp_path / "a.csv", channels, "altitude", "96 of 120 samples", "file is of several rates", "--resample 0.04"
    )
    frame.ffill().to_csv(tmp_path / "b.csv", index=False)
    for name, remark in (("a", "missing samples of altitude (5 Hz in a file of 25 Hz)"), ("b", "held samples of alt")):
        record = read_record(tmp_path / f"{name}.csv", channels, resample=0.04)
        right = 5000.0 + 100.0 * np.sin(0.5 * record.time)
        np.testing.assert_allclose(record["altitude"][:-5], right[:-5], atol=0.02)
        assert remark in record.remarks[0]
        assert name == "b" or record.time[-1] == pytest.approx(t[(len(t) - 1) // 5 * 5])


def test_a_unit_in_the_heading_counts(tmp_path):
    frame = table(tmp_path)
    frame["IAS (kt)"] = 200.0
    frame.to_csv(tmp_path / "a.csv", index=False)
    wrong = Channel("calibrated_airspeed", "m/s", "IAS (kt)")
    refused(tmp_path / "a.csv", [*CHANNELS, wrong], "in 'kt' according to the file", "correct the card")
    record = read_record(tmp_path / "a.csv", [*CHANNELS, Channel("calibrated_airspeed", "kt", "IAS (kt)")])
    assert record["calibrated_airspeed"][0] == pytest.approx(200.0 * 1852.0 / 3600.0, rel=1e-9)


def test_quoted_cells_with_commas_are_read(tmp_path):
    path = quoted_file(tmp_path)
    record = read_record(path, QUOTED)
    np.testing.assert_allclose(record.time, 0.04 * np.arange(60), atol=1e-12)
    np.testing.assert_allclose(record["alpha"], np.deg2rad(0.5 + 0.01 * np.arange(60)), rtol=1e-12)
    assert record["altitude"][-1] == 5059.0
    # "5,000" is five thousand where points stand before decimals, and is not decided where nothing else shows it.
    rows = path.read_text().splitlines()
    points = [re.sub(r'"(\d),', r'"\1.', row).replace('"50', '"5,0') for row in rows[1:]]
    path.write_text("\n".join([rows[0], *points]))
    assert read_record(path, QUOTED)["altitude"][0] == 5000.0
    path.write_text("\n".join(["T,H", *(f'{i},"5,{i:03d}"' for i in range(60))]))
    refused(path, (QUOTED[0], QUOTED[2]), "'5,059'", "decimal comma", "thousands")
    path.write_text("\n".join(["T,H", *(f'{i},"0,{i:03d}"' for i in range(60))]))  # no thousands begin with 0
    assert read_record(path, (QUOTED[0], QUOTED[2]))["altitude"][59] == 0.059
