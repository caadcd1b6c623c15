"""Binary files: logs and HDF5 read in a process of their own (the reason is in `child.py`), MATLAB, Parquet, Excel."""

from __future__ import annotations

import io
import json
import math
import re
import subprocess
import sys
import warnings
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import date, datetime, time, timedelta
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.readers import (
    MAX_VALUES,
    MOST_HEADINGS,
    MOST_VALUES_IN_ALL,
    PACKING,
    FileColumn,
    Heading,
    OpenedFile,
    SampleGroup,
    Series,
    foreign,
    refuse_huge,
    several_rates,
    stated_unit,
    unpacked,
    vector,
)
from bayes_aero.flight.readers.text import CELL, MOST_HEADER_ROWS, is_value, laid_out, text_table, value_share
from bayes_aero.units import same_unit

TIME_LIMIT, PER_MEGABYTE = 20.0, 2.0
"""Seconds for the child, and more of them for each MB of the file; sound files take a tenth of that."""

MOST_BYTES = 16 * MOST_VALUES_IN_ALL  # most bytes that a file may unpack to
MOST_COLUMNS = 50_000


def ask_child(
    data: bytes, parser: str, request: Sequence[Any], kind: str, slow: str, crashed: str, limit: float
) -> tuple[dict, list[np.ndarray]]:
    """What a parser of `child.py` replies to a request on a file, and the arrays behind it. `slow` or `crashed` is
    raised if it takes more than `limit` s, or dies; `kind` is what the file is called to the user."""
    # -P: the child must not take this folder's modules for libraries.
    command = [sys.executable, "-P", str(Path(__file__).parent / "child.py"), parser, json.dumps(request)]
    try:
        done = subprocess.run(
            command, input=data, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=limit, check=False
        )
    except subprocess.TimeoutExpired as reason:
        raise InputError(slow) from reason
    end = done.stdout.find(b"\n")
    if done.returncode != 0 or end <= 0:
        raise InputError(crashed)
    reply = json.loads(done.stdout[:end])
    if "error" in reply:
        raise InputError(f"it is not a readable {kind} ({reply['error']}); is it damaged or misnamed? Write it again")
    if "refused" in reply:
        raise InputError(reply["refused"])
    arrays, start = [], end + 1
    for dtype, size in reply["arrays"]:
        arrays.append(np.frombuffer(done.stdout, dtype, size, start))
        start += arrays[-1].nbytes
    return reply, arrays


def parsed_apart(data: bytes, parser: str, kind: str) -> tuple[list[SampleGroup], list[str]]:
    """All groups of samples in a file, and what is to be remarked of it; see `ask_child`."""
    limit = TIME_LIMIT + PER_MEGABYTE * len(data) / 1e6
    slow = f"the library that reads a {kind} did not finish in {limit:.0f} s; is it damaged? Write it again"
    crashed = f"the library that reads a {kind} crashed on it; is it damaged? Write it again"
    reply, arrays = ask_child(data, parser, [MOST_BYTES, MOST_COLUMNS], kind, slow, crashed, limit)
    left, groups = iter(arrays), []
    for listed in reply["groups"]:
        time = next(left)
        series = tuple(Series(tuple(names), unit, next(left)) for names, unit in listed["columns"])
        groups.append(SampleGroup(listed["name"], time, series))
    return groups, reply["remarks"]


# --- Libraries that only some file formats need, and that not everybody has.


def require(suffix: str, *libraries: str) -> None:
    """Refuse a file whose suffix, as in ".mf4", needs a library that is not there."""
    for library in libraries:
        if find_spec(library) is None:
            raise InputError(
                f"reading {suffix} needs {library}, which is not installed; pip install 'bayes-aero[formats]', or "
                "write the record as .csv"
            )


def log_reader(
    suffix: str, library: str, parser: str, kind: str, column: str, tick: float, problem: Callable[[bytes], str]
) -> Callable[[bytes], OpenedFile]:
    """What opens logs of one format; see `parsed_apart` and `several_rates`. `problem`: why a file is none."""

    def opens(data: bytes) -> OpenedFile:
        require(suffix, library)
        if reason := problem(data):
            raise InputError(reason)
        return several_rates(column, *parsed_apart(data, parser, kind), tick)

    return opens


def _no_mdf(data: bytes) -> str:
    if data[:8] not in (b"MDF     ", b"UnFinMF "):
        return "it is not an MDF file (its first bytes differ); is it misnamed?"
    said = data[8:16].decode("latin-1").strip("\0 ")
    return (
        ""
        if said[:2] == "4."
        else f"it is an MDF file of version {said!r}; convert it to version 4, and save it as .mf4"
    )


# A column is a field of a message, "ATT.Roll": instances go by their number, "IMU[1].GyrX", and an only one also by
# "IMU.GyrX". Source: ArduPilot, AP_Logger: FMT, FMTU, UNIT and MULT messages describe all others.
NO_DATAFLASH = "it is not an ArduPilot DataFlash log (no message begins near its start); is it misnamed?"
open_dataflash = log_reader(
    ".bin", "pymavlink", "dataflash", "DataFlash log", "field", 1e-6,
    lambda data: "" if b"\xa3\x95" in data[:600] else NO_DATAFLASH,
)  # fmt: skip
# A column is a signal of a channel group: "group/name" and, where no other group has one of its name, its name alone.
# Source: ASAM MDF 4.1, section 4: one channel group has one master channel.
open_mdf = log_reader(".mf4", "asammdf", "mdf", "MDF file", "signal", 1e-9, _no_mdf)
# A column is a field of a topic, "vehicle_attitude.q[0]"; a second instance of a topic goes by its number:
# "sensor_accel.1.x". Source: PX4 ULog file format, version 1.
NO_ULOG = "it is not a PX4 ULog file (its first bytes differ); is it misnamed?"
open_ulog = log_reader(
    ".ulg", "pyulog", "ulog", "ULog file", "field", 1e-6,
    lambda data: "" if data.startswith(b"ULog\x01\x12\x35") else NO_ULOG,
)  # fmt: skip


# --- Files of named arrays: HDF5, NetCDF, MATLAB, Parquet.


class Variable(NamedTuple):
    """An array before its values are read: names that it goes by, its shape, and why it can be no channel. One of two
    dimensions is a channel a column, or a row where it has fewer rows than columns."""

    key: str
    names: tuple[str, ...]
    shape: tuple[int, ...]
    unit: str | None = None
    problem: str = ""

    @property
    def columns(self) -> int:
        """Channels of a matrix; 0 for a vector."""
        return min(self.shape) if not self.problem and len(self.shape) == 2 and min(self.shape) > 1 else 0


Places = dict[
    str, tuple[str, int | None]
]  # by channel the key of a variable and, of a matrix, the number of the column


def named_arrays(
    variables: Sequence[Variable], load: Callable[[Places], dict[str, np.ndarray]], kind: str = "variable",
    *, numbered: bool = False, of_columns: Sequence[str] = (),
) -> OpenedFile:  # fmt: skip
    """A file of such variables, of which `load` gives numbers. The columns of an only matrix go by their numbers and,
    if there are as many, by the names `of_columns`. `numbered`: a variable's place in the file is its number."""
    only = sum(v.columns > 0 for v in variables) == 1
    places: dict[Heading, tuple[Variable, int | None]] = {}
    for number, v in enumerate(variables, 1):
        if not v.columns:
            places[Heading(v.names, number if numbered else None, v.unit)] = (v, None)
        formed = len(of_columns) != v.columns
        for k in range(v.columns):
            names = tuple(f"{name}(:,{k + 1})" for name in v.names) if formed else (of_columns[k],)
            places[Heading(names, k + 1 if only else None, v.unit, formed)] = (v, k)

    def read(wanted: Mapping[str, Heading]) -> dict[str, FileColumn]:
        for name, heading in wanted.items():
            variable, label = places[heading][0], heading.names[0]
            if variable.problem:
                raise InputError(f"channel {name} ({label!r}) {variable.problem}")
            refuse_huge(name, label, math.prod(variable.shape), len(wanted))
        loaded = load({name: (places[h][0].key, places[h][1]) for name, h in wanted.items()})
        return {name: FileColumn(loaded[name], heading.unit) for name, heading in wanted.items()}

    return OpenedFile(list(places), read, kind)


def by_path(paths: Iterable[str], gap: str) -> dict[str, tuple[str, ...]]:
    """The names of each path: its last part where no other path ends in it, and the whole, with dots."""
    often = Counter(path.rsplit(gap, 1)[-1] for path in paths)
    names = {path: (path.rsplit(gap, 1)[-1], path.replace(gap, ".")) for path in paths}
    return {path: tuple(dict.fromkeys(both if often[both[0]] == 1 else both[1:])) for path, both in names.items()}


HDF5 = b"\x89HDF\r\n\x1a\n"  # what such a file begins with; MATLAB's has 512 bytes of its own before it
OBJECT = (
    "it holds a MATLAB object (a table, timetable or class), which only MATLAB can read; in MATLAB, save a struct of "
    "vectors (table2struct(T, 'ToScalar', true)), or write .csv with writetable"
)


def open_hdf5(data: bytes, kind: str) -> OpenedFile:
    """The datasets of a NetCDF-4 or MATLAB v7.3 file; `kind` names it to the user."""
    if find_spec("h5py") is None:
        raise InputError(f"this {kind} is an HDF5 file, and h5py is not installed; install h5py, or write .csv")

    def ask(wanted: Sequence[tuple[str, int | None]]) -> tuple[dict, list[np.ndarray]]:
        slow = f"the HDF5 library did not finish reading it in {TIME_LIMIT:g} s; the {kind} is damaged: write it again"
        crashed = f"the HDF5 library crashed on it; the {kind} is damaged: write it again"
        return ask_child(data, "hdf5", [wanted, PACKING], kind, slow, crashed, TIME_LIMIT)

    def load(places: Places) -> dict[str, np.ndarray]:
        reply, arrays = ask([*places.values()])
        about = ({key: np.array(x, of) for key, (of, x) in given.items()} for given in reply["attributes"])
        return {name: unpacked(x, given, name) for name, x, given in zip(places, arrays, about, strict=True)}

    listed: dict[str, dict[str, Any]] = ask([])[0]["available"]
    if listed and all(it["opaque"] for it in listed.values()):
        raise InputError(OBJECT)
    names = by_path(listed, "/")
    return named_arrays(
        [Variable(p, names[p], tuple(x["shape"]), stated_unit(x["unit"]), x["problem"]) for p, x in listed.items()],
        load,
    )


def open_netcdf(data: bytes) -> OpenedFile:
    """A NetCDF file: a classic one by scipy, NetCDF-4 by h5py."""
    if data.startswith(HDF5):
        return open_hdf5(data, "NetCDF file")
    if not data.startswith(b"CDF"):
        raise InputError("it is neither a NetCDF-4 nor a classic NetCDF file; is it misnamed? Write it again")
    from scipy.io import netcdf_file

    with foreign("NetCDF file"):
        there = netcdf_file(io.BytesIO(data), "r", mmap=False).variables
        units = {key: stated_unit(getattr(variable, "units", None)) for key, variable in there.items()}
        listed = [Variable(key, (str(key),), (), units[key]) for key in there]  # a matrix is no channel

    def load(places: Places) -> dict[str, np.ndarray]:
        loaded = {}
        for name, (key, at) in places.items():
            with foreign("NetCDF file"):
                raw = _part(np.asarray(there[key].data), at)
                vector(raw, name)  # its type and shape
                loaded[name] = unpacked(raw, vars(there[key])["_attributes"], name)
        return loaded

    return named_arrays(listed, load)


def _part(values: np.ndarray, at: int | None) -> np.ndarray:
    """A vector, or the column (row, where there are fewer) of a matrix."""
    if at is None:
        return values
    return values[:, at] if values.shape[0] >= values.shape[1] else values[at]


# MATLAB files: vectors, structs of vectors and matrices. Nothing here loads a pickle.

NUMERIC = {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
DEPTH = 3  # structs within structs


def open_mat(data: bytes) -> OpenedFile:
    """A MATLAB file: v5 to v7 by scipy, v7.3 by h5py. Structs are read, the other variables are only listed."""
    if data[512:520] == HDF5 or data[:8] == HDF5:
        return open_hdf5(data, "MATLAB v7.3 file")
    if len(data) < 136 or data[126:128] not in (b"IM", b"MI"):
        raise InputError("it is not a MATLAB file of version 5 to 7.3; in MATLAB, save it again with -v7")
    from scipy.io import loadmat, whosmat

    def loaded(names: Iterable[str], **options: bool) -> dict[str, Any]:
        with foreign("MATLAB file"), warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)  # scipy warns where a file holds one name twice
            return loadmat(io.BytesIO(data), variable_names=list(names), **options) if names else {}

    claimed = _bounded(data)
    with foreign("MATLAB file"), warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        contents = {name: (shape, kind) for name, shape, kind in whosmat(io.BytesIO(data))}
    if contents and all(kind in ("opaque", "object", "function") for _, kind in contents.values()):
        raise InputError(OBJECT)
    structs = [name for name, (_, kind) in contents.items() if kind == "struct"]
    if claimed > 8 * MOST_VALUES_IN_ALL and structs:
        raise InputError(
            f"it claims {claimed} bytes, more than a record may have; is it damaged? Otherwise cut the record"
        )
    of_structs, fields = loaded(structs, simplify_cells=True), dict[str, np.ndarray]()
    for name in structs:
        if isinstance(of_structs.get(name), dict):
            del contents[name]
            fields |= _fields(of_structs[name], name)
    contents |= {path: (values.shape, "double") for path, values in fields.items()}
    names = by_path(contents, ".")
    listed = []
    for path, (shape, kind) in contents.items():
        problem = (
            f"is a {kind} where numbers should be; store one numeric vector a channel, or a struct of such vectors"
        )
        listed.append(Variable(path, names[path], shape, problem="" if kind in NUMERIC else problem))
    matrices = [variable for variable in listed if variable.columns]
    cells, of_columns = [path for path, (_, kind) in contents.items() if kind == "cell"], ()
    if len(matrices) == 1 and len(cells) == 1:  # names of the columns, where they are all texts
        texts = np.asarray(loaded(cells, simplify_cells=True)[cells[0]]).reshape(-1)
        of_columns = tuple(map(str, texts)) if all(isinstance(text, str) for text in texts) else ()

    def load(places: Places) -> dict[str, np.ndarray]:
        arrays = fields | loaded(sorted({key for key, _ in places.values() if key not in fields}))
        return {name: vector(_part(np.asarray(arrays[key]), at), name) for name, (key, at) in places.items()}

    opened = named_arrays(listed, load, of_columns=of_columns)
    opened.remarks.extend(
        f"the matrix {v.names[0]!r} has {v.shape[0]} rows and {v.shape[1]} columns; each row is taken for a channel"
        for v in matrices
        if v.shape[0] < v.shape[1]
    )
    return opened


def _fields(struct: Mapping[str, Any], path: str, depth: int = 1) -> dict[str, np.ndarray]:
    """Numeric fields of a struct and of the structs in it, by their dotted path."""
    fields: dict[str, np.ndarray] = {}
    for key, value in struct.items():
        if isinstance(value, Mapping) and depth < DEPTH:
            fields |= _fields(value, f"{path}.{key}", depth + 1)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.size > 1:
            fields[f"{path}.{key}"] = value
    return fields


def _bounded(data: bytes) -> int:
    """Bytes that all elements claim; refuses one that claims to unpack into more than a record can hold."""
    order = "little" if data[126:128] == b"IM" else "big"
    position, count, total = 128, 0, 0
    while position + 8 <= len(data):
        count += 1
        if count > MOST_HEADINGS:
            raise InputError(f"it has more than {MOST_HEADINGS} variables; is it a flight record?")
        kind = int.from_bytes(data[position : position + 4], order)
        size = int.from_bytes(data[position + 4 : position + 8], order)
        if kind == 15:  # miCOMPRESSED
            with foreign("MATLAB file"):
                inner = zlib.decompressobj().decompress(data[position + 8 : position + 8 + min(size, 4096)], 8)
            claimed = int.from_bytes(inner[4:8], order)
        else:
            claimed = size
        if claimed > 8 * MAX_VALUES + 4096:
            raise InputError(
                f"it claims a variable of {claimed} bytes; is it damaged? In MATLAB, save it again with -v7"
            )
        position, total = position + 8 + size, total + claimed
    return total


def open_parquet(data: bytes) -> OpenedFile:
    """A Parquet file by pyarrow; its time stamps come back in seconds from the first one."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    numeric = (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_timestamp)
    with foreign("Parquet file"):
        file = pq.ParquetFile(pa.BufferReader(data))
        groups = (file.metadata.row_group(i).num_rows for i in range(file.metadata.num_row_groups))
        rows, listed = max(file.metadata.num_rows, sum(groups)), []
        for field in file.schema_arrow:
            unit = stated_unit((field.metadata or {}).get(b"units"))
            unit = "s" if pa.types.is_timestamp(field.type) else unit
            problem = f"holds {field.type} where numbers should be; store it as plain numbers, and time as seconds or "
            fits = any(of(field.type) for of in numeric)
            listed.append(Variable(field.name, (field.name,), (rows,), unit, "" if fits else f"{problem}time stamps"))

    def load(places: Places) -> dict[str, np.ndarray]:
        columns = {}
        with foreign("Parquet file"):
            table = file.read(columns=[key for key, _ in places.values()], use_threads=False)
            for name, (key, _) in places.items():
                values = table.column(key)
                if pa.types.is_timestamp(values.type):
                    stamps = values.to_numpy().astype("datetime64[ns]")
                    first = stamps[~np.isnat(stamps)][:1]
                    elapsed = (stamps - first) / np.timedelta64(1, "s") if len(first) else np.full(len(stamps), np.nan)
                    columns[name] = elapsed
                else:
                    numbers = values.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
                    columns[name] = vector(numbers, name)
        return columns

    return named_arrays(listed, load, "column", numbered=True)


# --- Excel workbooks (.xlsx), read by openpyxl: the first sheet that holds a table, laid out as a text table is.

MOST_UNPACKED = 1 << 29  # most bytes of XML in the archive, 0.5 GiB; a file of some kB can claim any number
MOST_ROWS, MOST_CELLS = 1 << 20, 10_000_000
"""Excel's own number of rows; and most cells of a sheet, of which each takes some microseconds."""

A_TABLE = 50  # rows of numbers that make a table; a sheet with fewer is read only where no sheet has so many
_OLD = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
_UNFIT = re.compile(rf'[{CELL}"\r\n\t]+')  # what parts cells and lines in a text table
_THOUSANDS = re.compile(r"-?\d{1,3}\.\d{3}")  # a number whose point could stand between thousands in a text table

Rows = list[tuple[int, list[str]]]
"""Rows that are not blank, each with its number in the sheet, counted from 1, without the blank cells at its end."""


def open_excel(data: bytes) -> OpenedFile:
    """The table of a workbook."""
    rows, remarks = rows_of(data)
    if not rows:
        raise InputError("it holds no data, only blank sheets; write the record again")
    numeric = [value_share(row) > 0.5 for _, row in rows]
    begin = _header_begins(rows, next((k for k, it in enumerate(numeric) if it and all(numeric[k : k + 3])), 0))
    if begin > 0:
        remarks += [f"row {rows[begin][0]} is taken for the first of the table; what stands above it is skipped"]
    width = max(len(row) for _, row in rows[begin:])
    lines = [(number, CELL.join(row + [""] * (width - len(row)))) for number, row in rows[begin:]]
    return text_table(laid_out(lines, CELL), remarks)


def rows_of(data: bytes) -> tuple[Rows, list[str]]:
    """The first sheet with a table, and which one it is. Numbers come as Python writes them, dates and times of day in
    ISO 8601, durations in seconds. Raises InputError: no workbook, or more than a record can hold."""
    require(".xlsx", "openpyxl", "defusedxml")  # openpyxl takes defusedxml, against XML bombs, only where it is there
    if data.startswith(_OLD):
        raise InputError("it is a workbook of Excel 97 to 2003, or one with a password; save it as .xlsx without one")
    with foreign("Excel workbook"):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            claimed = sum(entry.file_size for entry in archive.infolist())
        if claimed > MOST_UNPACKED:
            raise InputError(f"it unpacks to {claimed} bytes, more than {MOST_UNPACKED}; save the table as .csv")
        sheets = _sheets(data)
    lengths = [sum(len(row) > 1 and value_share(row) > 0.5 for _, row in rows) for _, rows in sheets]
    tables = [k for k, length in enumerate(lengths) if length >= A_TABLE] or [
        k for k, length in enumerate(lengths) if length and length == max(lengths)
    ]
    if not tables:
        return (sheets[0][1] if sheets else []), []
    name, rows = sheets[tables[0]]
    if len(tables) == 1:
        return rows, [f"the table is that of sheet {name[:40]!r}"] if len(sheets) > 1 else []
    return rows, [
        f"sheet {name[:40]!r} is read, the first of {len(tables)} with a table; for another one, save it as a workbook "
        "of its own"
    ]


def _sheets(data: bytes) -> list[tuple[str, Rows]]:
    """Name and rows of each sheet that is not blank."""
    from openpyxl import load_workbook

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of styles and extensions that it leaves out
        book = load_workbook(io.BytesIO(data), read_only=True, data_only=True, keep_links=False)
        try:
            sheets = [(str(sheet.title), _rows(sheet)) for sheet in book.worksheets]
        finally:
            book.close()
    return [(title, rows) for title, rows in sheets if rows]


def _rows(sheet: Any) -> Rows:
    rows, cells, title = [], 0, repr(sheet.title[:40])
    sheet.reset_dimensions()  # programs write wrong ones
    for number, values in enumerate(sheet.iter_rows(values_only=True), 1):
        cells += len(values)
        if number > MOST_ROWS or cells > MOST_CELLS:
            raise InputError(f"sheet {title} has more than {MOST_ROWS} rows or {MOST_CELLS} cells; cut it")
        row = [_text(value) for value in values]
        while row and not row[-1]:
            row.pop()
        if len(row) > MOST_HEADINGS:
            raise InputError(f"sheet {title} has more than {MOST_HEADINGS} columns; is it a flight record?")
        if row:
            rows.append((number, row))
    return rows


def _text(value: Any) -> str:
    """What a cell holds, as a text table would have it."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, datetime | date | time):
        return value.isoformat()
    if isinstance(value, timedelta):
        return repr(value.total_seconds())
    if isinstance(value, float):
        return repr(value) + "0" * (_THOUSANDS.fullmatch(repr(value)) is not None)
    return _UNFIT.sub(" ", str(value)).strip()


def _header_begins(rows: Rows, first: int) -> int:
    """Index of the first row of names or units above the first sample; higher up stand notes, of a few cells."""
    width, begin, named = len(rows[first][1]), first, False
    for k in range(first - 1, max(first - 1 - MOST_HEADER_ROWS, -1), -1):
        number, row = rows[k]
        filled = sum(map(bool, row))
        units = all(same_unit(said, said) for cell in row if (said := cell.strip("[]() ")))
        parted = k < first - 1 and rows[k + 1][0] - number > 1  # a blank row
        few = 2 * filled <= width and (named or filled < 2)
        if parted or (not units and (few or (named and any(map(is_value, row))))):
            break
        begin, named = k, named or not units
    return begin


READS = {
    ".bin": open_dataflash,
    ".mf4": open_mdf,
    ".ulg": open_ulog,
    ".nc": open_netcdf,
    ".mat": open_mat,
    ".parquet": open_parquet,
    ".xlsx": open_excel,
}
