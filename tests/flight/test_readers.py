"""Sound files come back as written; every bad one is told in one sentence with file, channel, sample and remedy."""

import hashlib
import os
import pickle
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from flight_samples import CHANNELS, sound, told
from scipy.io import netcdf_file, savemat

from bayes_aero.cli.terminal import SUFFIXES
from bayes_aero.errors import InputError
from bayes_aero.flight.channel import Channel
from bayes_aero.flight.readers import READERS
from bayes_aero.flight.reading import read_raw, read_record
from bayes_aero.flight.record import FlightRecord, write_record

FORMATS = (".asc", ".txt", ".dat", ".csv", ".mat", ".parquet", ".nc")
TWO = (Channel("time", "s", "T"), Channel("alpha", "deg", "ALCG"))
NAMED = (".csv", ".mat", ".parquet", ".nc")


def written(folder: Path, record: FlightRecord, suffix: str = ".csv") -> Path:
    path = folder / f"flight{suffix}"
    write_record(record, path, CHANNELS)
    return path


@pytest.mark.parametrize("suffix", FORMATS)
def test_round_trip(tmp_path, suffix):
    record = sound()
    back = read_record(written(tmp_path, record, suffix), CHANNELS)
    assert back.name == "flight"
    assert back.names == record.names
    for name in record.names:
        np.testing.assert_allclose(back[name], record[name], rtol=4e-16, atol=1e-18)


def test_formats_are_listed_and_tested():
    assert set(SUFFIXES.split()) == set(READERS) - {".tsv", ".txt", ".dat"}  # variants of .csv and .asc
    assert set(FORMATS) == set(READERS) - {".tsv", ".xlsx", ".mf4", ".ulg", ".bin"}  # test_layouts.py, test_formats.py


@pytest.mark.parametrize("suffix", [".parquet", ".nc"])
def test_the_file_s_own_unit_is_held_against_the_card(tmp_path, suffix, remap):
    path = written(tmp_path, sound(), suffix)
    told(path, remap("alpha", unit="rad"), "channel alpha", "'deg'", "'rad'", 'unit = "deg"')
    assert read_record(path, remap("q", unit="degree / second")).has("q")


@pytest.mark.parametrize("text", [
    "T,ALCG,QRGY,VTAS,RHO\n{rows}",
    "\ufeffT,ALCG,QRGY,VTAS,RHO\r\n{rows}",
    "# a comment\n\nT; ALCG; QRGY; VTAS; RHO\n{semicolons}",
    "T;ALCG;QRGY;VTAS;RHO\n{decimal_commas}",
    "T\tALCG\tQRGY\tVTAS\tRHO\n{tabs}",
    '"T","ALCG","QRGY","VTAS","RHO"\n{rows}',
    "T,ALCG,QRGY,VTAS,RHO\ns,deg,deg/s,kt,kg/m3\n{rows}",
    "T,ALCG,QRGY,VTAS,RHO\n[s],[°],[deg/s],[kt],[-]\n{rows}".replace("[-]", "[kg/m^3]"),
    "T,ALCG,QRGY,VTAS,RHO\n{rows}\n\n# the end\n",
    "T,ALCG,QRGY,VTAS,RHO\n{trailing}",
    "NOTE,T,ALCG,QRGY,VTAS,RHO\n{with_text}",
    '"T","ALCG","QRGY","VTAS","RHO"\n{quoted_commas}',
    'T,ALCG,QRGY,VTAS,RHO\n"s","deg","deg/s","kt","kg/m3"\n{quoted_commas}',
    '"NOTE, with ""a"" comma",T,ALCG,QRGY,VTAS,RHO\n{quoted_text}',
    '"a, b, c, d, e, f";T;ALCG;QRGY;VTAS;RHO\n{quoted_semicolons}',
    '"T"\t"ALCG"\t"QRGY"\t"VTAS"\t"RHO"\n{quoted_tabs}',
    "T,ALCG,QRGY,VTAS,RHO\n{quoted_trailing}",
])  # fmt: skip
def test_csv_as_people_write_it(tmp_path, text):
    r = sound()
    rows = [
        ",".join(f"{v:.9g}" for v in row)
        for row in np.column_stack(
            [r.time, np.rad2deg(r["alpha"]), np.rad2deg(r["q"]), r["airspeed"] * 3600 / 1852, r["density"]]
        )
    ]
    body = "\n".join(rows)
    quoted = "\n".join('"' + row.replace(",", '","') + '"' for row in rows)
    text = text.format(
        rows=body, semicolons=body.replace(",", "; "), decimal_commas=body.replace(",", ";").replace(".", ","),
        tabs=body.replace(",", "\t"), trailing="\n".join(row + "," for row in rows),
        with_text="\n".join("level," + row for row in rows), quoted_commas=quoted.replace(".", ","),
        quoted_text="\n".join('"level, ""trimmed""; 2",' + row for row in rows),
        quoted_semicolons="\n".join('"x;y";' + row.replace(",", ";").replace(".", ",") for row in rows),
        quoted_tabs=quoted.replace('","', '"\t"'),
        quoted_trailing="\n".join(row + "," for row in quoted.split("\n")),
    )  # fmt: skip
    path = tmp_path / "people.csv"
    path.write_bytes(text.encode("utf-8"))
    back = read_record(path, CHANNELS)
    for name in ("time", "alpha", "q", "airspeed", "density"):
        np.testing.assert_allclose(back[name], r[name], rtol=1e-8, atol=1e-9)
    assert not back.has("static_pressure")


def test_provenance_and_case_of_suffix(tmp_path):
    path = written(tmp_path, sound()).rename(tmp_path / "flight.CSV")
    record = read_record(str(path), CHANNELS)
    assert record.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert record.source == str(path)


# The file itself


def test_paths_that_are_no_files(tmp_path):
    written(tmp_path, sound())
    told(tmp_path / "fligt.csv", CHANNELS, "no such file", "did you mean flight.csv?")
    told(tmp_path / "nowhere" / "flight.csv", CHANNELS, "folder", "does not exist", "correct the path")
    (tmp_path / "d.csv").mkdir()
    told(tmp_path / "d.csv", CHANNELS, "directory", "name a file")
    (tmp_path / "e.csv").touch()
    told(tmp_path / "e.csv", CHANNELS, "empty", "write it again")
    os.mkfifo(tmp_path / "p.csv")
    told(tmp_path / "p.csv", CHANNELS, "pipe", "regular file")
    told(tmp_path / "n\0l.csv", CHANNELS, "no such file")


def test_unreadable_file(tmp_path, monkeypatch):
    path = written(tmp_path, sound())

    def refuse(_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "read_bytes", refuse)
    told(path, CHANNELS, "Permission denied", "check its name and permissions")


def test_too_large_a_file(tmp_path, monkeypatch):
    monkeypatch.setattr("bayes_aero.flight.reading.MAX_BYTES", 100)
    told(written(tmp_path, sound()), CHANNELS, "more than 100", "cut it")


@pytest.mark.parametrize("name", ["flight.xls", "flight"])
def test_unknown_suffix_lists_the_known(tmp_path, name):
    (tmp_path / name).write_text("x")
    told(tmp_path / name, CHANNELS, *FORMATS, "convert")


@pytest.mark.parametrize("suffix", [".mat", ".parquet", ".nc"])
def test_misnamed_file(tmp_path, suffix):
    path = written(tmp_path, sound()).rename(tmp_path / f"flight{suffix}")
    told(path, CHANNELS, "again")


@pytest.mark.parametrize("suffix", [".asc", ".csv"])
def test_binary_named_as_text(tmp_path, suffix):
    path = written(tmp_path, sound(), ".parquet").rename(tmp_path / f"flight{suffix}")
    told(path, CHANNELS, "NUL", "Save it as UTF-8 text")
    path.write_bytes(b"\n \n# only words\n")
    told(path, CHANNELS, "no data", "write the record again")


# The card


def test_odd_channels_and_impossible_units_of_a_card(tmp_path, channels, remap):
    path = written(tmp_path, sound())
    told(path, channels[1:], "channel time", "[channels]")
    told(path, (*channels, channels[1]), "channel alpha", "twice", "keep one")
    told(path, remap("alpha", unit="degre"), "channel alpha", "'degre'", "not known", '"deg"')
    told(path, remap("airspeed", unit="hPa"), "channel airspeed", "'hPa'", "'m/s'", "correct the unit")
    told(path, remap("q", unit="Hz"), "channel q", "'Hz'", '"rad/s"')


# Columns


@pytest.mark.parametrize("suffix", NAMED)
def test_missing_named_channel(tmp_path, suffix, remap):
    path = written(tmp_path, sound(), suffix)
    told(path, remap("alpha", label="ALCGG"), "channel alpha", "'ALCGG'", "did you mean 'ALCG'", "label on the card")
    told(path, remap("alpha", label="wxyz"), "channel alpha", "the file has", "'QRGY'", "required = false")
    assert not read_record(path, remap("strain", label="no such")).has("strain")


def test_numbered_channels_that_are_missing_and_headings_that_stand_twice(tmp_path, remap):
    path = written(tmp_path, sound(), ".asc")
    told(path, remap("alpha", column=12), "channel alpha", "column 12", "7 columns", "correct the column")
    told(path, remap("alpha", column=None), "channel alpha", "no column number", "add column = N")
    assert not read_record(path, remap("strain", column=8)).has("strain")
    assert not read_record(path, remap("strain", column=None)).has("strain")
    told(path, remap("time", column=99, required=False), "channel time", "required = true")
    path = tmp_path / "a.csv"
    path.write_text("T,ALCG,ALCG\n0,1,2\n")
    told(path, TWO, "channel alpha", "2 columns", "rename")


@pytest.mark.parametrize("suffix", [".asc", ".csv"])
def test_ragged_row(tmp_path, suffix):
    path = written(tmp_path, sound(), suffix)
    lines = path.read_text().splitlines()
    lines[31] = lines[31].rpartition("," if suffix == ".csv" else " ")[0]
    path.write_text("\n".join(lines))
    sample = 30 if suffix == ".csv" else 31
    told(path, CHANNELS, "line 32", f"sample {sample}", "6 columns where 7", "complete or delete that line")


@pytest.mark.parametrize(("cell", "what"), [("abc", "'abc'"), ("1_0", "'1_0'"), ("1.0x+00", "'1.0x+00'")])
@pytest.mark.parametrize("suffix", [".asc", ".csv"])
def test_text_where_a_number_should_be(tmp_path, suffix, cell, what):
    path = written(tmp_path, sound(), suffix)
    separator = "," if suffix == ".csv" else " "
    lines = path.read_text().splitlines()
    cells = lines[20].split(separator)
    cells[2] = cell
    lines[20] = separator.join(cells)
    path.write_text("\n".join(lines))
    told(path, CHANNELS, "channel q", what, "line 21", "column 3", "sample", "correct or delete")


def test_empty_cell_and_headers_at_odds_with_the_format(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("T,ALCG\n0,1\n0.04,\n")
    told(path, TWO, "2 samples; at least 50")
    path.write_text("T,ALCG\n")
    told(path, TWO, "no samples", "again")
    path = written(tmp_path, sound(), ".csv").rename(tmp_path / "b.asc")
    path.write_text(path.read_text().replace(",", " "))
    np.testing.assert_allclose(
        read_record(path, CHANNELS)["q"], sound()["q"], rtol=1e-12
    )  # a header is read there, too
    path = written(tmp_path, sound(), ".csv")
    lines = path.read_text().splitlines()
    cells = lines[20].split(",")
    lines[20] = ",".join([*cells[:2], "", *cells[3:]])
    path.write_text("\n".join(lines))
    told(path, CHANNELS, "channel q", "empty", "sample 19", "resampling")


# Binary formats


def test_object_columns_are_refused(tmp_path):
    frame = pd.DataFrame({"T": np.arange(60) * 0.04, "ALCG": ["x"] * 60})
    frame.to_parquet(tmp_path / "a.parquet")
    told(tmp_path / "a.parquet", TWO, "channel alpha", "numbers should be", "plain numbers")
    frame["T"] = pd.date_range("2020-01-01", periods=60, freq="40ms")
    frame.to_parquet(tmp_path / "b.parquet")
    frame["ALCG"] = np.arange(60.0)
    frame.to_parquet(tmp_path / "b.parquet")
    np.testing.assert_allclose(read_record(tmp_path / "b.parquet", TWO).time, np.arange(60) * 0.04, atol=1e-9)
    (tmp_path / "c.parquet").write_bytes(pickle.dumps(frame))
    told(tmp_path / "c.parquet", TWO, "not a readable Parquet")


def test_mat_files_that_hold_no_vectors_or_too_much(tmp_path, monkeypatch):
    t = np.arange(60) * 0.04
    for value, words in (
        ({"x": t}, ("did you mean 'ALCG.x'",)),
        ("words", ("char", "numeric vector")),
        (np.ones((60, 2)), ("did you mean", "'ALCG(:,1)'")),
        (np.ones(59), ("59 samples", "60", "same length")),
    ):
        savemat(tmp_path / "a.mat", {"T": t, "ALCG": value})
        told(tmp_path / "a.mat", TWO, "channel alpha", *words)
    savemat(tmp_path / "v4.mat", {"T": t}, format="4")
    told(tmp_path / "v4.mat", TWO, "version 5 to 7.3", "-v7")
    path = written(tmp_path, sound(2000), ".mat")
    monkeypatch.setattr("bayes_aero.flight.readers.binary.MAX_VALUES", 100)
    told(path, CHANNELS, "claims", "-v7")


def test_matlab_v73_and_absurd_claims_of_hdf5(tmp_path):
    r = sound()
    path = tmp_path / "v73.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for label, values in (("T", r.time), ("ALCG", np.rad2deg(r["alpha"]))):
            file.create_dataset(label, data=values[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
        file["s"] = "text"
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM")
    np.testing.assert_allclose(read_record(path, TWO)["alpha"], r["alpha"], rtol=1e-15)
    told(path, [*TWO, Channel("q", "deg/s", "s")], "channel q", "numbers should be")
    told(path, [*TWO, Channel("q", "deg/s", "QRGY")], "channel q", "the file has", "'ALCG'")
    path = tmp_path / "huge.nc"
    with h5py.File(path, "w") as file:
        file.create_dataset("T", shape=(10**12,), chunks=(1000,), dtype="f8")
    assert path.stat().st_size < 100_000
    told(path, [Channel("time", "s", "T")], "channel time", "1000000000000 samples", "damaged")


def test_hdf5_that_takes_for_ever_crashes_or_has_no_library(tmp_path, monkeypatch):
    path = written(tmp_path, sound(), ".nc")
    monkeypatch.setattr("bayes_aero.flight.readers.binary.TIME_LIMIT", 0.001)
    told(path, CHANNELS, "did not finish", "write it again")
    monkeypatch.undo()
    monkeypatch.setattr("sys.executable", "/bin/false")
    told(path, CHANNELS, "crashed", "write it again")
    monkeypatch.setattr("bayes_aero.flight.readers.binary.find_spec", lambda _: None)
    told(path, CHANNELS, "h5py is not installed", "install h5py")


def test_netcdf_conventions_and_what_are_no_measured_numbers(tmp_path):
    r = sound()
    packed = np.round(np.rad2deg(r["alpha"]) / 0.001).astype("i4")
    packed[7] = -9999
    about = {"scale_factor": 0.001, "add_offset": 0.0, "_FillValue": np.int32(-9999), "units": "degrees"}
    data = xr.Dataset({"T": ("t", r.time), "ALCG": ("t", packed, about)})
    for engine in ("h5netcdf", "scipy"):
        path = tmp_path / f"{engine}.nc"
        data.to_netcdf(path, engine=engine)
        told(path, TWO, "channel alpha", "not a number", "sample 7 ", "t = 0.28 s", "1 of 120", "repair")
        data.where(data.ALCG != -9999, 5730).assign(T=data.T).to_netcdf(tmp_path / "whole.nc", engine=engine)
    card = [Channel("time", "s", "T"), Channel("flap", "deg", "FLAP")]
    flags = {"flag_values": np.array([0, 1], "i1"), "flag_meanings": "up down"}
    for about, words in (
        (flags, ("channel flap", "flags", "flag_meanings")),
        ({"scale_factor": "0.1"}, ("channel flap", "scale_factor", "plain numbers")),
        ({"_Unsigned": "perhaps"}, ("channel flap", "_Unsigned")),
    ):
        for engine in ("h5netcdf", "scipy"):
            path = tmp_path / f"{engine}.nc"
            columns = {"T": ("t", r.time, {"units": "seconds since 2020-01-01"}), "FLAP": ("t", np.ones(r.n, "i1"))}
            data = xr.Dataset(columns)
            data["FLAP"].attrs = about
            data.to_netcdf(path, engine=engine)
            told(path, card, *words)


PACKED = {
    "unsigned": (np.array([0, 1, 40000, 65535], "u2").view("i2"), {"_Unsigned": "true", "scale_factor": 0.5}),
    "unsigned with a fill value": (
        np.array([0, 65535, 40000, 9], "u2").view("i2"),
        {"_Unsigned": "true", "scale_factor": 0.0004, "add_offset": -23.5, "_FillValue": np.int16(-1)},
    ),
    "unsigned with missing values": (
        np.array([0, 65535, 40000, 9], "u2").view("i2"),
        {"_Unsigned": "True", "add_offset": 1.5, "missing_value": np.int16(-1)},
    ),
    "signed": (np.array([0, 5, 251, 255], "u1"), {"_Unsigned": "false", "scale_factor": 2.0}),
    "several missing values": (np.array([1, 2, 3, 4], "i4"), {"missing_value": np.array([2, 4], "i4")}),
    "valid range of the stored numbers": (
        np.array([1, 50, 200, 7], "i2"), {"scale_factor": 0.1, "valid_range": np.array([5, 100], "i2")},
    ),
    "valid range of the unpacked numbers": (
        np.array([1, 50, 200, 7], "i2"), {"scale_factor": 0.1, "valid_range": np.array([0.5, 10.0])},
    ),
    "unsigned valid limits": (
        np.array([3, 50000, 60000, 7], "u2").view("i2"),
        {"_Unsigned": "true", "valid_min": np.int16(5), "valid_max": np.array(50000, "u2").view("i2")[()]},
    ),
    "never written": (np.array([1.0, 9.969209968386869e36, 3.0, 4.0]), {}),
}  # fmt: skip
UNPACKED = [
    [0.0, 0.5, 20000.0, 32767.5], [-23.5, np.nan, -7.5, -23.4964], [1.5, np.nan, 40001.5, 10.5], [0, 10, -10, -2],
    [1, np.nan, 3, np.nan], [np.nan, 5.0, np.nan, 0.7], [np.nan, 5.0, np.nan, 0.7], [np.nan, 50000, np.nan, 7],
    [1, np.nan, 3, 4],
]  # fmt: skip


@pytest.mark.parametrize("suffix", [".nc", "classic.nc"])
def test_packed_netcdf_stands_for_its_numbers(tmp_path, suffix):
    """By hand, after the CF conventions and the NetCDF User's Guide."""
    path = tmp_path / f"packed{suffix}"
    names = [f"v{i}" for i in range(len(PACKED))]
    if suffix == ".nc":
        with h5py.File(path, "w") as file:
            for name, (stored, about) in zip(names, PACKED.values(), strict=True):
                file.create_dataset(name, data=stored, dtype=stored.dtype.newbyteorder(">")).attrs.update(about)
    else:
        with netcdf_file(path, "w") as file:
            file.createDimension("t", 4)
            for name, (stored, about) in zip(names, PACKED.values(), strict=True):
                plain = "i1" if stored.dtype == "u1" else stored.dtype
                variable = file.createVariable(name, plain, ("t",))
                variable[:] = stored.view(plain)
                for key, value in about.items():
                    setattr(variable, key, np.float64(value) if isinstance(value, float) else value)
    read = {column.label: column.values for column in read_raw(path).columns}
    for case, name, right in zip(PACKED, names, UNPACKED, strict=True):
        np.testing.assert_allclose(read[name], right, rtol=1e-14, err_msg=case)


def test_netcdf_of_the_classic_format_and_times_since_a_date(tmp_path):
    """At 1 kHz a step of 1 ms could be one of 1 s."""
    r = sound()
    columns = {"T": ("t", 1000.0 * r.time, {"units": "milliseconds since 2020-01-01"}), "ALCG": ("t", r["alpha"])}
    for engine in ("h5netcdf", "scipy"):
        path = tmp_path / f"{engine}.nc"
        xr.Dataset(columns).to_netcdf(path, engine=engine)
        told(path, [Channel("time", "s", "T"), Channel("alpha", "rad", "ALCG")], "'milliseconds'", 'unit = "ms"')
        read = read_record(path, [Channel("time", "ms", "T"), Channel("alpha", "rad", "ALCG")])
        np.testing.assert_allclose(read.time, r.time, rtol=1e-14)
    path = tmp_path / "classic.nc"
    about = {"units": "rad"}
    xr.Dataset({"T": ("t", r.time), "ALCG": ("t", r["alpha"], about)}).to_netcdf(path, engine="scipy")
    card = [Channel("time", "s", "T"), Channel("alpha", "rad", "ALCG")]
    np.testing.assert_array_equal(read_record(path, card)["alpha"], r["alpha"])
    told(path, [card[0], Channel("alpha", "deg", "ALCG")], "channel alpha", "'rad'", 'unit = "rad"')


# Writing


def test_what_is_written_can_be_read_back(tmp_path, remap):
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
    assert not read_record(written(tmp_path, lean), CHANNELS).has("strain")
