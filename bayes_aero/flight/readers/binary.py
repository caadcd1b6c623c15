"""Binary files: logs and HDF5 read in a process of their own (the reason is in `child.py`), MATLAB, Parquet, Excel."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
import warnings
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date, datetime, time, timedelta
from importlib.util import find_spec
from pathlib import Path
from typing import Any

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
    data: bytes, parser: str, request: Sequence[Any], limit: float, slow: str, crashed: str, kind: str
) -> tuple[dict, memoryview]:
    """What a parser of `child.py` replies on a file, and the bytes of the arrays behind it. `request` is what it is
    given beside the file. If it takes more than `limit` s, or dies, `slow` or `crashed` is raised; `kind` is what the
    file is called to the user."""
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
    return reply, memoryview(done.stdout)[end + 1 :]


def parsed_apart(data: bytes, parser: str, kind: str) -> tuple[list[SampleGroup], list[str]]:
    """All groups of samples in a file, and what is to be remarked of it; see `ask_child`."""
    limit = TIME_LIMIT + PER_MEGABYTE * len(data) / 1e6
    slow = f"the library that reads a {kind} did not finish in {limit:.0f} s; is it damaged? Write it again"
    crashed = f"the library that reads a {kind} crashed on it; is it damaged? Write it again"
    reply, payload = ask_child(data, parser, [MOST_BYTES, MOST_COLUMNS], limit, slow, crashed, kind)
    groups, start = [], 0
    for listed in reply["groups"]:
        arrays = []
        for dtype in ("<f8" if sys.byteorder == "little" else ">f8", *(column[2] for column in listed["columns"])):
            arrays.append(np.frombuffer(payload, np.dtype(dtype), listed["size"], start))
            start += arrays[-1].nbytes
        columns = zip(listed["columns"], arrays[1:], strict=True)
        series = tuple(Series(tuple(names), unit, values) for (names, unit, _), values in columns)
        groups.append(SampleGroup(listed["name"], arrays[0], series))
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


# --- ArduPilot DataFlash logs, read by pymavlink: a column is a field of a message, as in "ATT.Roll".


def open_dataflash(data: bytes) -> OpenedFile:
    """A binary DataFlash log. Instances go by their number, "IMU[1].GyrX", and an only one also by "IMU.GyrX". Source:
    ArduPilot, AP_Logger: FMT, FMTU, UNIT and MULT messages describe all others."""
    require(".bin", "pymavlink")
    if b"\xa3\x95" not in data[:600]:
        raise InputError("it is not an ArduPilot DataFlash log (no message begins near its start); is it misnamed?")
    groups, remarks = parsed_apart(data, "dataflash", "DataFlash log")
    return several_rates("field", groups, remarks, 1e-6)


# --- ASAM MDF version 4, read by asammdf: a column is a signal of a channel group.


def open_mdf(data: bytes) -> OpenedFile:
    """An MDF file. A signal goes by "group/name" and, where no other group has one of its name, by its name alone.
    Source: ASAM MDF 4.1, section 4: one channel group has one master channel."""
    require(".mf4", "asammdf")
    if data[:8] not in (b"MDF     ", b"UnFinMF "):
        raise InputError("it is not an MDF file (its first bytes differ); is it misnamed?")
    if not data[8:16].startswith(b"4."):
        said = data[8:16].decode("latin-1").strip("\0 ")
        raise InputError(f"it is an MDF file of version {said!r}; convert it to version 4, and save it as .mf4")
    groups, remarks = parsed_apart(data, "mdf", "MDF file")
    return several_rates("signal", groups, remarks, 1e-9)


# --- PX4 ULog, read by pyulog: a column is a field of a topic, as in "vehicle_attitude.q[0]".


def open_ulog(data: bytes) -> OpenedFile:
    """A ULog file. A second instance of a topic goes by its number: "sensor_accel.1.x". Source: PX4 ULog file format,
    version 1."""
    require(".ulg", "pyulog")
    if not data.startswith(b"ULog\x01\x12\x35"):
        raise InputError("it is not a PX4 ULog file (its first bytes differ); is it misnamed?")
    groups, remarks = parsed_apart(data, "ulog", "ULog file")
    return several_rates("field", groups, remarks, 1e-6)


# --- HDF5: NetCDF-4 and MATLAB's v7.3.

HDF5 = b"\x89HDF\r\n\x1a\n"  # what such a file begins with; MATLAB's has 512 bytes of its own before it
OBJECT = (
    "it holds a MATLAB object (a table, timetable or class), which only MATLAB can read; in MATLAB, save a struct of "
    "vectors (table2struct(T, 'ToScalar', true)), or write .csv with writetable"
)


def open_hdf5(data: bytes, kind: str) -> OpenedFile:
    """The datasets of an HDF5 file; `kind` names it to the user. A dataset in a group goes by its path ("flight.T")
    and, where no other has it, by its own name. The columns of an only matrix go by their numbers."""
    if find_spec("h5py") is None:
        raise InputError(f"this {kind} is an HDF5 file, and h5py is not installed; install h5py, or write .csv")

    def ask(wanted: Sequence[tuple[str, int | None]]) -> tuple[dict, memoryview]:
        damaged = f"the {kind} is damaged: write it again"
        slow = f"the HDF5 library did not finish reading it in {TIME_LIMIT:g} s; {damaged}"
        request = [wanted, PACKING, MAX_VALUES, MOST_VALUES_IN_ALL]
        crashed = f"the HDF5 library crashed on it; {damaged}"
        return ask_child(data, "hdf5", request, TIME_LIMIT, slow, crashed, kind)

    listed: dict[str, dict[str, Any]] = ask([])[0]["available"]
    matrices = [path for path, it in listed.items() if it["numbers"] and _columns(it["shape"])]
    own = Counter(path.rsplit("/", 1)[-1] for path in listed)
    places: dict[Heading, tuple[str, int | None]] = {}  # dataset and, of a matrix, column
    headings = []
    for path, it in listed.items():
        dotted, short, unit = path.replace("/", "."), path.rsplit("/", 1)[-1], stated_unit(it["unit"])
        if path in matrices:
            only = len(matrices) == 1
            for k in range(_columns(it["shape"])):
                headings.append(Heading((f"{dotted}(:,{k + 1})",), k + 1 if only else None, unit, formed=True))
                places[headings[-1]] = (path, k)
        else:
            names = (short, dotted) if own[short] == 1 else (dotted,)
            headings.append(Heading(tuple(dict.fromkeys(names)), None, unit))
            places[headings[-1]] = (path, None)
    if listed and all(it["opaque"] for it in listed.values()):
        raise InputError(OBJECT)

    def read(wanted: Mapping[str, Heading]) -> dict[str, FileColumn]:
        reply, payload = ask([places[heading] for heading in wanted.values()])
        if "problem" in reply:
            place, problem = reply["problem"]
            name = list(wanted)[place]
            raise InputError(f"channel {name} ({wanted[name].names[0]!r}) {problem}")
        columns, start = {}, 0
        for (name, heading), (dtype, size, given) in zip(wanted.items(), reply["vectors"], strict=True):
            raw = np.frombuffer(payload, dtype, size, start)
            attributes = {key: np.array(x, of) for key, (of, x) in given.items()}
            columns[name] = FileColumn(unpacked(raw, attributes, name), heading.unit)
            start += raw.nbytes
        return columns

    return OpenedFile(headings, read)


def _columns(shape: Sequence[int]) -> int:
    """Columns of a matrix; 0 for a vector. MATLAB's files hold matrices transposed."""
    return min(shape) if len(shape) == 2 and min(shape) > 1 else 0


# --- NetCDF, one variable a channel: classic files by scipy, NetCDF-4 by h5py.


def open_netcdf(data: bytes) -> OpenedFile:
    """A NetCDF file of either kind."""
    if data.startswith(HDF5):
        return open_hdf5(data, "NetCDF file")
    if not data.startswith(b"CDF"):
        raise InputError("it is neither a NetCDF-4 nor a classic NetCDF file; is it misnamed? Write it again")
    from scipy.io import netcdf_file

    with foreign("NetCDF file"):
        file = netcdf_file(io.BytesIO(data), "r", mmap=False)
        units = {str(name): getattr(variable, "units", None) for name, variable in file.variables.items()}
        headings = [Heading((name,), None, stated_unit(unit)) for name, unit in units.items()]

    def read(wanted: Mapping[str, Heading]) -> dict[str, FileColumn]:
        columns = {}
        for name, heading in wanted.items():
            variable = file.variables[heading.names[0]]
            with foreign("NetCDF file"):
                raw = np.asarray(variable.data)
                refuse_huge(name, heading.names[0], raw.size, len(wanted))
                vector(raw, name)  # its type and shape
                columns[name] = FileColumn(unpacked(raw, vars(variable)["_attributes"], name), heading.unit)
        return columns

    return OpenedFile(headings, read)


# --- MATLAB files: vectors, structs of vectors and matrices. Nothing here loads a pickle.

NUMERIC = {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
DEPTH = 3  # structs within structs


def open_mat(data: bytes) -> OpenedFile:
    """A MATLAB file: v5 to v7 by scipy, v7.3 by h5py. Structs are read, the other variables are only listed. The
    columns of an only matrix go by their numbers, those of several by "name(:,k)"."""
    if data[512:520] == HDF5 or data[:8] == HDF5:
        return open_hdf5(data, "MATLAB v7.3 file")
    if len(data) < 136 or data[126:128] not in (b"IM", b"MI"):
        raise InputError("it is not a MATLAB file of version 5 to 7.3; in MATLAB, save it again with -v7")
    from scipy.io import whosmat

    claimed = _bounded(data)
    with foreign("MATLAB file"), warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)  # scipy warns where a file holds one name twice
        contents = {name: (shape, kind) for name, shape, kind in whosmat(io.BytesIO(data))}
    if contents and all(kind in ("opaque", "object", "function") for _, kind in contents.values()):
        raise InputError(OBJECT)
    structs = [name for name, (_, kind) in contents.items() if kind == "struct"]
    if claimed > 8 * MOST_VALUES_IN_ALL and structs:
        raise InputError(
            f"it claims {claimed} bytes, more than a record may have; is it damaged? Otherwise cut the record"
        )
    loaded = _loaded(data, structs, simplify_cells=True)
    fields: dict[str, np.ndarray] = {}
    for name in structs:
        if isinstance(loaded.get(name), dict):
            del contents[name]
            fields |= _fields(loaded[name], name)
    places = [_Place(name, kind, shape, None) for name, (shape, kind) in contents.items()]
    places += [_Place(path, "field", value.shape, value) for path, value in fields.items()]
    return _opened(data, places)


def _loaded(data: bytes, names: Iterable[str], **options: bool) -> dict[str, Any]:
    from scipy.io import loadmat

    with foreign("MATLAB file"), warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        return loadmat(io.BytesIO(data), variable_names=list(names), **options) if names else {}


def _opened(data: bytes, listed: Sequence[_Place]) -> OpenedFile:
    matrices = [place for place in listed if place.is_matrix]
    cells = [place.path for place in listed if place.kind == "cell"]
    names: tuple[str, ...] = ()  # of a matrix's columns, where one cell array of texts lies beside it
    if len(matrices) == 1 and len(cells) == 1:
        texts = np.asarray(_loaded(data, cells, simplify_cells=True)[cells[0]]).reshape(-1)
        names = tuple(map(str, texts)) if all(isinstance(text, str) for text in texts) else ()
    short = Counter(place.path.rsplit(".", 1)[-1] for place in listed)
    places, remarks = dict[Heading, _Place](), []
    for place in listed:
        last, path = place.path.rsplit(".", 1)[-1], place.path
        called = tuple(dict.fromkeys((last, path) if short[last] == 1 else (path,)))
        if not place.is_matrix:
            places[Heading(called)] = place
            continue
        count = min(place.shape)
        formed = len(names) != count
        for k in range(count):
            label = f"{called[0]}(:,{k + 1})" if formed else names[k]
            places[Heading((label,), k + 1 if len(matrices) == 1 else None, formed=formed)] = replace(place, at=k)
        if place.shape[0] < place.shape[1]:
            remarks.append(
                f"the matrix {called[0]!r} has {place.shape[0]} rows and {place.shape[1]} columns; each row is taken "
                "for a channel"
            )

    def read(wanted: Mapping[str, Heading]) -> dict[str, FileColumn]:
        for name, heading in wanted.items():
            place = places[heading]
            if place.kind not in (*NUMERIC, "field"):
                raise InputError(
                    f"channel {name} ({place.path!r}) is a {place.kind} where numbers should be; store one numeric "
                    "vector a channel, or a struct of such vectors"
                )
            refuse_huge(name, place.path, float(np.prod([float(extent) for extent in place.shape])), len(wanted))
        loaded = _loaded(data, sorted({places[h].path for h in wanted.values() if places[h].values is None}))
        return {name: FileColumn(places[heading].taken(name, loaded)) for name, heading in wanted.items()}

    return OpenedFile(list(places), read, remarks=remarks)


@dataclass(frozen=True)
class _Place:
    """A variable or a field of a struct, which is read already; one column `at` of it where it is a matrix."""

    path: str
    kind: str
    shape: tuple[int, ...]
    values: np.ndarray | None
    at: int | None = None

    @property
    def is_matrix(self) -> bool:
        return self.kind in (*NUMERIC, "field") and len(self.shape) == 2 and min(self.shape) > 1

    def taken(self, name: str, loaded: Mapping[str, Any]) -> np.ndarray:
        whole = np.asarray(loaded[self.path] if self.values is None else self.values)
        if self.at is None:
            return vector(whole, name)
        return vector(whole[:, self.at] if whole.shape[0] >= whole.shape[1] else whole[self.at], name)


def _fields(struct: Mapping[str, Any], path: str, depth: int = 1) -> Iterator[tuple[str, np.ndarray]]:
    """Numeric fields of a struct and of the structs in it, by their dotted path."""
    for key, value in struct.items():
        if isinstance(value, Mapping) and depth < DEPTH:
            yield from _fields(value, f"{path}.{key}", depth + 1)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.size > 1:
            yield f"{path}.{key}", value


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


# --- Parquet, one column a channel, read by pyarrow.


def open_parquet(data: bytes) -> OpenedFile:
    """A Parquet file; its time stamps come back in seconds from the first one."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with foreign("Parquet file"):
        file = pq.ParquetFile(pa.BufferReader(data))
        schema = file.schema_arrow
        groups = (file.metadata.row_group(i).num_rows for i in range(file.metadata.num_row_groups))
        rows = max(file.metadata.num_rows, sum(groups))
        units = [(field.metadata or {}).get(b"units") for field in schema]
        units = [None if unit is None else unit.decode("utf-8", "replace") for unit in units]
        headings = [
            Heading((name,), k, unit) for k, (name, unit) in enumerate(zip(schema.names, units, strict=True), 1)
        ]

    def read(wanted: Mapping[str, Heading]) -> dict[str, FileColumn]:
        for name, heading in wanted.items():
            label, kind = heading.names[0], schema.field(heading.names[0]).type
            allowed = (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_timestamp)
            if not any(fits(kind) for fits in allowed):
                raise InputError(
                    f"channel {name} ({label!r}) holds {kind} where numbers should be; store it as plain numbers, and "
                    "time as seconds or time stamps"
                )
            refuse_huge(name, label, rows, len(wanted))
        with foreign("Parquet file"):
            table = file.read(columns=[h.names[0] for h in wanted.values()], use_threads=False)
            return {name: _column(table.column(h.names[0]), name, h) for name, h in wanted.items()}

    return OpenedFile(headings, read, "column")


def _column(values: Any, name: str, heading: Heading) -> FileColumn:
    import pyarrow as pa

    if pa.types.is_timestamp(values.type):
        stamps = values.to_numpy().astype("datetime64[ns]")
        first = stamps[~np.isnat(stamps)][:1]
        seconds = (stamps - first) / np.timedelta64(1, "s") if len(first) else np.full(len(stamps), np.nan)
        return FileColumn(seconds, "s")
    numbers = values.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
    return FileColumn(vector(numbers, name), heading.unit)


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
    """The first sheet with a table, and which one it is where there are several. Numbers come as Python writes them,
    dates and times of day in ISO 8601, durations in seconds. Raises InputError: no workbook, or one that claims more
    than a record can hold."""
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
