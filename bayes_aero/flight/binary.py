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
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight import text
from bayes_aero.flight.text import FileColumn, Heading, OpenedFile

TIME_LIMIT, PER_MEGABYTE = 20.0, 2.0
"""Seconds for the child, and more of them for each MB of the file; sound files take a tenth of that."""


def ask_child(data: bytes, parser: str, kind: str, request: Sequence[Any] = ()) -> tuple[dict, list[np.ndarray]]:
    """What a parser of `child.py` replies to a request on a file, and the arrays behind it. Raises InputError: it takes
    too long, or dies; `kind` is what the file is called to the user."""
    # -P: the child must not take this folder's modules for libraries.
    command = [sys.executable, "-P", str(Path(__file__).parent / "child.py"), parser, json.dumps(request)]
    limit, advice = TIME_LIMIT + PER_MEGABYTE * len(data) / 1e6, "is it damaged? Then write it again"
    try:
        done = subprocess.run(
            command, input=data, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=limit, check=True
        )
        with np.load(io.BytesIO(done.stdout)) as archive:
            reply, arrays = json.loads(str(archive["reply"])), [archive[f"arr_{k}"] for k in range(len(archive) - 1)]
    except subprocess.TimeoutExpired as reason:
        raise InputError(f"the library that reads a {kind} did not finish in {limit:.0f} s; {advice}") from reason
    except (subprocess.CalledProcessError, ValueError, EOFError, zipfile.BadZipFile) as reason:
        raise InputError(f"the library that reads a {kind} crashed on it; {advice}") from reason
    if "error" in reply:
        raise InputError(f"it is not a readable {kind} ({reply['error']}); is it damaged or misnamed? Write it again")
    return reply, arrays


def require(suffix: str, *libraries: str) -> None:
    """Refuse a file whose suffix, as in ".mf4", needs a library that is not there: not everybody has all of them."""
    for library in libraries:
        if find_spec(library) is None:
            raise InputError(f"reading {suffix} needs {library}: pip install 'bayes-aero[formats]', or write .csv")


# --- Logs, whose channels come at several rates: groups of columns, each group with its own time stamps.


class LogFormat(NamedTuple):
    """A format of logs: its library, what a file and a column of it are called, the resolution of its stamps (s), and
    what a file of it holds somewhere in its first bytes, so many of them."""

    library: str
    parser: str
    kind: str
    column: str
    tick: float
    mark: re.Pattern[bytes]
    within: int


LOGS = {
    # A column is a field of a message, "ATT.Roll": instances go by their number, "IMU[1].GyrX", and an only one also by
    # "IMU.GyrX". Source: ArduPilot, AP_Logger: FMT, FMTU, UNIT and MULT messages describe all others.
    ".bin": LogFormat("pymavlink", "dataflash", "DataFlash log", "field", 1e-6, re.compile(b"\xa3\x95"), 600),
    # A column is a signal of a channel group: "group/name" and, where no other group has one of its name, its name
    # alone. Source: ASAM MDF 4.1, section 4: one channel group has one master channel.
    ".mf4": LogFormat("asammdf", "mdf", "MDF 4 file", "signal", 1e-9, re.compile(b"(MDF     |UnFinMF )4\\."), 10),
    # A column is a field of a topic, "vehicle_attitude.q[0]"; a second instance of a topic goes by its number:
    # "sensor_accel.1.x". Source: PX4 ULog file format, version 1.
    ".ulg": LogFormat("pyulog", "ulog", "ULog file", "field", 1e-6, re.compile(b"ULog\x01\x12\x35"), 7),
}
TIME = Heading(("time",), None, "s")  # stands for the time stamps of whatever columns are read beside it


def _ticks(name: str, time: np.ndarray, tick: float) -> np.ndarray:
    """(n,) time stamps of a group, s, as whole numbers of ticks of so many seconds; they must increase."""
    scaled = time * round(1.0 / tick)
    if not np.isfinite(scaled).all() or np.abs(scaled).max(initial=0.0) > 2.0**62:
        raise InputError(f"a time stamp of {name} is no number or far too large; is the file damaged?")
    whole = np.rint(scaled).astype(np.int64)
    back = np.diff(whole) <= 0
    if back.any():
        at = int(np.argmax(back)) + 1
        what = "repeats" if whole[at] == whole[at - 1] else "runs backwards"
        raise InputError(
            f"the time of {name} {what} at its sample {at} (counted from 0; t = {time[at]:.9g} s), {int(back.sum())} "
            f"times in all; take the channels of {name} off the card, or cut the record there"
        )
    return whole


def open_log(suffix: str, data: bytes) -> OpenedFile:
    """A log: time first, then every column, no two with the same first name."""
    log = LOGS[suffix]
    require(suffix, log.library)
    if not log.mark.search(data[: log.within]):
        raise InputError(f"it is not a readable {log.kind}: its first bytes are those of no such file; is it misnamed?")
    reply, arrays = ask_child(data, log.parser, log.kind)
    left, headings, taken = iter(arrays), [TIME], {"time"}
    places: dict[Heading, tuple[int, np.ndarray]] = {}  # by heading its group, and the values
    stamps: list[np.ndarray] = []
    for group, listed in enumerate(reply["groups"]):
        stamps.append(next(left))
        for names, unit in listed["columns"]:
            values, first, count = next(left), names[0], 2
            while first in taken:
                first, count = f"{names[0]} ({count})", count + 1
            if len(stamps[group]):
                taken.add(first)
                heading = Heading(tuple(dict.fromkeys((first, *names[1:]))), None, unit)
                headings.append(heading)
                places[heading] = (group, values)
    if not places:
        raise InputError("it holds no samples with time stamps; is it cut off? Write it again")

    def read(wanted: Mapping[str, Heading]) -> dict[str, FileColumn]:
        # The samples are at all time stamps of the groups that the wanted columns are in.
        chosen = {name: places[heading] for name, heading in wanted.items() if heading != TIME}
        used = sorted({group for group, _ in (chosen or places).values()})
        for name, heading in wanted.items():
            text.refuse_huge(name, heading.names[0], sum(len(stamps[group]) for group in used), len(wanted))
        time, rows = stamps[used[0]].copy(), {used[0]: np.s_[:]}
        if len(used) > 1:
            ticks = {group: _ticks(reply["groups"][group]["name"], stamps[group], log.tick) for group in used}
            union = np.unique(np.concatenate(list(ticks.values())))
            time, rows = union / round(1.0 / log.tick), {k: np.searchsorted(union, times) for k, times in ticks.items()}
        columns = {name: FileColumn(time, "s") for name in wanted if name not in chosen}
        for name, (group, recorded) in chosen.items():
            values = np.full(len(time), np.nan)
            values[rows[group]] = text.vector(recorded, name)
            columns[name] = FileColumn(values, wanted[name].unit)
        return columns

    return OpenedFile(headings, read, log.column, reply["remarks"])


# --- Files of named arrays: HDF5, NetCDF, MATLAB, Parquet.

HDF5 = b"\x89HDF\r\n\x1a\n"  # what such a file begins with; MATLAB's has 512 bytes of its own before it
OBJECT = (
    "it holds a MATLAB object (a table, timetable or class), which only MATLAB can read; in MATLAB, save a struct of "
    "vectors (table2struct(T, 'ToScalar', true)), or write .csv with writetable"
)

PACKING = (
    "_Unsigned", "scale_factor", "add_offset", "_FillValue", "missing_value", "valid_min", "valid_max", "valid_range",
    "flag_values", "flag_masks", "flag_meanings",
)  # fmt: skip
"""Attributes by which NetCDF says what stored numbers mean."""
_NEVER_WRITTEN = {
    "i2": -32767, "i4": -2147483647, "i8": -9223372036854775806, "f4": 2.0**122 * 1.875, "f8": 2.0**122 * 1.875,
}  # fmt: skip
"""What the NetCDF library stores where nothing was written (netcdf.h: NC_FILL_SHORT and so on)."""


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


# by channel the key of a variable and, of a matrix, the number of the column
Places = dict[str, tuple[str, int | None]]
Loader = Callable[[Places], dict[str, np.ndarray]]


def named_arrays(
    variables: Sequence[Variable], load: Loader, kind: str = "variable", *, numbered: bool = False
) -> OpenedFile:
    """A file of such variables, of which `load` gives numbers. The columns of an only matrix go by their numbers, too.
    `numbered`: a variable's place in the file is its number."""
    matrices = [v for v in variables if v.columns]
    places: dict[Heading, tuple[Variable, int | None]] = {}
    for number, v in enumerate(variables, 1):
        if not v.columns:
            places[Heading(v.names, number if numbered else None, v.unit)] = (v, None)
        for k in range(v.columns):
            names = tuple(f"{name}(:,{k + 1})" for name in v.names)
            places[Heading(names, k + 1 if len(matrices) == 1 else None, v.unit, formed=True)] = (v, k)

    def read(wanted: Mapping[str, Heading]) -> dict[str, FileColumn]:
        for name, heading in wanted.items():
            variable, label = places[heading][0], heading.names[0]
            if variable.problem:
                raise InputError(f"channel {name} ({label!r}) {variable.problem}")
            text.refuse_huge(name, label, math.prod(variable.shape), len(wanted))
        loaded = load({name: (places[h][0].key, places[h][1]) for name, h in wanted.items()})
        return {name: FileColumn(loaded[name], heading.unit) for name, heading in wanted.items()}

    remarks = [
        f"the matrix {v.names[0]!r} has {v.shape[0]} rows and {v.shape[1]} columns; each row is taken for a channel"
        for v in matrices
        if v.shape[0] < v.shape[1]
    ]
    return OpenedFile(list(places), read, kind, remarks)


def by_path(paths: Iterable[str], gap: str) -> dict[str, tuple[str, ...]]:
    """The names of each path: its last part where no other path ends in it, and the whole, with dots."""
    often = Counter(path.rsplit(gap, 1)[-1] for path in paths)
    names = {path: (path.rsplit(gap, 1)[-1], path.replace(gap, ".")) for path in paths}
    return {path: tuple(dict.fromkeys(both if often[both[0]] == 1 else both[1:])) for path, both in names.items()}


def stated_unit(units: Any) -> str | None:
    """The unit in an attribute `units`; of "seconds since 2020-01-01" the seconds."""
    units = units.decode("utf-8", "replace") if isinstance(units, bytes) else units
    return str(units).split(" since ")[0][:60] if isinstance(units, str) else None


def open_hdf5(data: bytes, kind: str) -> OpenedFile:
    """The datasets of a NetCDF-4 or MATLAB v7.3 file; `kind` names it to the user."""
    if find_spec("h5py") is None:
        raise InputError(f"this {kind} is an HDF5 file, and h5py is not installed; install h5py, or write .csv")

    def load(places: Places) -> dict[str, np.ndarray]:
        reply, arrays = ask_child(data, "hdf5", kind, [[*places.values()], PACKING])
        about = ({key: np.array(x, of) for key, (of, x) in given.items()} for given in reply["attributes"])
        return {name: unpacked(x, given, name) for name, x, given in zip(places, arrays, about, strict=True)}

    listed: dict[str, dict[str, Any]] = ask_child(data, "hdf5", kind, [[], PACKING])[0]["available"]
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

    with text.foreign("NetCDF file"):
        there = netcdf_file(io.BytesIO(data), "r", mmap=False).variables
        units = {key: stated_unit(getattr(variable, "units", None)) for key, variable in there.items()}
        listed = [Variable(key, (str(key),), (), units[key]) for key in there]  # a matrix is no channel

    def load(places: Places) -> dict[str, np.ndarray]:
        loaded = {}
        for name, (key, _) in places.items():
            with text.foreign("NetCDF file"):
                raw = np.asarray(there[key].data)
                text.vector(raw, name)  # its type and shape
                loaded[name] = unpacked(raw, vars(there[key])["_attributes"], name)
        return loaded

    return named_arrays(listed, load)


def unpacked(raw: np.ndarray, attributes: Mapping[str, Any], name: str) -> np.ndarray:
    """The numbers that (n,) stored ones stand for by the variable's `attributes`, of which those of `PACKING` count.
    NaN where they are missing or outside the valid range; flags and packing that is no numbers are refused. Source: CF
    conventions 1.11, sections 2.5.1 and 8.1; NetCDF User's Guide, appendix A."""

    def native(values: Any) -> np.ndarray:  # in the byte order of this machine
        array = np.asarray(values).reshape(-1)
        return array.astype(array.dtype.newbyteorder("="))

    given = {key: native(attributes[key]) for key in PACKING if key in attributes}
    if any(key.startswith("flag_") for key in given):
        raise InputError(f"channel {name} has flag_meanings: it holds flags, no quantity; name another variable")
    unsigned = "".join(given.pop("_Unsigned", np.array([""]))[:1].astype(str)).strip().casefold()
    packing = {"scale_factor", "add_offset"} & set(given)
    wrong = [key for key, x in given.items() if x.dtype.kind not in "fiu" or not x.size]
    wrong += [key for key in packing if given[key].size != 1] + ["_Unsigned"] * (unsigned not in ("", "true", "false"))
    if wrong:
        raise InputError(f"channel {name} has a {wrong[0]} that says nothing; write it again with plain numbers there")
    raw = native(raw)
    stored = raw.dtype
    if unsigned and stored.kind in "iu":
        meant = np.dtype(f"{'u' if unsigned == 'true' else 'i'}{stored.itemsize}")
        raw, given = raw.view(meant), {key: x.view(meant) if x.dtype == stored else x for key, x in given.items()}
    with np.errstate(all="ignore"):  # a damaged file may state any number
        values = raw.astype(np.float64)
        never = _NEVER_WRITTEN.get(raw.dtype.str[1:], ()) if stored.kind == "f" or packing else ()
        if packing:
            values = values * given.get("scale_factor", np.ones(1))[0] + given.get("add_offset", np.zeros(1))[0]
        missing = np.isin(raw, given.get("_FillValue", never)) | np.isin(raw, given.get("missing_value", ()))
        for key in {"valid_min", "valid_max", "valid_range"} & set(given):
            # A limit of a wider type than the packed numbers is one of the unpacked ones.
            x = values if given[key].dtype.kind == "f" and stored.kind in "iu" else raw
            missing |= (key != "valid_max") & (x < given[key][0]) | (key != "valid_min") & (x > given[key][-1])
    values[missing] = np.nan
    return values


# --- MATLAB files: vectors, structs of vectors and matrices. Nothing here loads a pickle.

NUMERIC = {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
DEPTH = 3  # structs within structs


def open_mat(data: bytes) -> OpenedFile:
    """A MATLAB file: v5 to v7 by scipy, v7.3 by h5py. Structs are read, the other variables are only listed."""
    if data[512:520] == HDF5 or data[:8] == HDF5:
        return open_hdf5(data, "MATLAB v7.3 file")
    if len(data) < 136 or data[126:128] not in (b"IM", b"MI"):
        raise InputError("it is not a MATLAB file of version 5 to 7.3; in MATLAB, save it again with -v7")
    from scipy.io import loadmat, whosmat

    def parsed(parser: Callable[..., Any], **options: Any) -> Any:
        with text.foreign("MATLAB file"), warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)  # scipy warns where a file holds one name twice
            return parser(io.BytesIO(data), **options)

    claimed = _bounded(data)
    contents = {name: (shape, kind) for name, shape, kind in parsed(whosmat)}
    if contents and all(kind in ("opaque", "object", "function") for _, kind in contents.values()):
        raise InputError(OBJECT)
    structs = [name for name, (_, kind) in contents.items() if kind == "struct"]
    if claimed > 8 * text.MOST_VALUES_IN_ALL and structs:
        raise InputError(f"it claims {claimed} bytes, more than a record may have; cut the record")
    of_structs = parsed(loadmat, variable_names=structs, simplify_cells=True) if structs else {}
    fields: dict[str, np.ndarray] = {}
    for name in structs:
        if isinstance(of_structs.get(name), dict):
            del contents[name]
            fields |= _fields(of_structs[name], name)
    contents |= {path: (values.shape, "double") for path, values in fields.items()}
    names, listed = by_path(contents, "."), []
    for path, (shape, kind) in contents.items():
        problem = f"is a {kind} where numbers should be; store a numeric vector a channel, or a struct of these"
        listed.append(Variable(path, names[path], shape, problem="" if kind in NUMERIC else problem))

    def load(places: Places) -> dict[str, np.ndarray]:
        keys = sorted({key for key, _ in places.values()} - fields.keys())
        arrays, columns = fields | (parsed(loadmat, variable_names=keys) if keys else {}), {}
        for name, (key, at) in places.items():
            values = np.asarray(arrays[key])
            if at is not None:
                values = values[:, at] if values.shape[0] >= values.shape[1] else values[at]
            columns[name] = text.vector(values, name)
        return columns

    return named_arrays(listed, load)


def _fields(struct: Mapping[str, Any], path: str, depth: int = 1) -> dict[str, np.ndarray]:
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
        if count > text.MOST_HEADINGS:
            raise InputError(f"it has more than {text.MOST_HEADINGS} variables; is it a flight record?")
        kind, size = (int.from_bytes(data[at : at + 4], order) for at in (position, position + 4))
        claimed = size
        if kind == 15:  # miCOMPRESSED
            with text.foreign("MATLAB file"):
                inner = zlib.decompressobj().decompress(data[position + 8 : position + 8 + min(size, 4096)], 8)
            claimed = int.from_bytes(inner[4:8], order)
        if claimed > 8 * text.MAX_VALUES + 4096:
            raise InputError(f"it claims a variable of {claimed} bytes; in MATLAB, save it again with -v7")
        position, total = position + 8 + size, total + claimed
    return total


def open_parquet(data: bytes) -> OpenedFile:
    """A Parquet file by pyarrow; its time stamps come back in seconds from the first one."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    numeric = (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_timestamp)
    with text.foreign("Parquet file"):
        file = pq.ParquetFile(pa.BufferReader(data))
        groups = (file.metadata.row_group(i).num_rows for i in range(file.metadata.num_row_groups))
        rows, listed = max(file.metadata.num_rows, sum(groups)), []
        for field in file.schema_arrow:
            unit = "s" if pa.types.is_timestamp(field.type) else stated_unit((field.metadata or {}).get(b"units"))
            problem = f"holds {field.type} where numbers should be; store it as plain numbers, and time as seconds or "
            fits = any(of(field.type) for of in numeric)
            listed.append(Variable(field.name, (field.name,), (rows,), unit, "" if fits else f"{problem}time stamps"))

    def load(places: Places) -> dict[str, np.ndarray]:
        columns = {}
        with text.foreign("Parquet file"):
            table = file.read(columns=[key for key, _ in places.values()], use_threads=False)
            for name, (key, _) in places.items():
                values = table.column(key)
                if pa.types.is_timestamp(values.type):
                    stamps = values.to_numpy().astype("datetime64[ns]")
                    first = stamps[~np.isnat(stamps)][:1]
                    columns[name] = (stamps - (first if len(first) else stamps)) / np.timedelta64(1, "s")
                else:
                    numbers = values.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
                    columns[name] = text.vector(numbers, name)
        return columns

    return named_arrays(listed, load, "column", numbered=True)


# --- Excel workbooks (.xlsx), read by openpyxl: the first sheet that holds a table, laid out as a text table is.

MOST_UNPACKED = 1 << 29  # most bytes of XML in the archive, 0.5 GiB; a file of some kB can claim any number
MOST_ROWS, MOST_CELLS = 1 << 20, 10_000_000
"""Excel's own number of rows; and most cells of a sheet, of which each takes some microseconds."""
A_TABLE = 50  # rows of numbers that make a table; a sheet with fewer is read only where no sheet has so many
_UNFIT = re.compile(rf'[{text.CELL}"\r\n\t]+')  # what parts cells and lines in a text table
_THOUSANDS = re.compile(r"-?\d{1,3}\.\d{3}")  # a number whose point could stand between thousands in a text table

Rows = list[tuple[int, list[str]]]
"""Rows that are not blank, each with its number in the sheet, counted from 1, without the blank cells at its end."""


def open_excel(data: bytes) -> OpenedFile:
    """The table of a workbook, of the first sheet with one. Raises InputError: no workbook, or more than a record can
    hold."""
    require(".xlsx", "openpyxl", "defusedxml")  # openpyxl takes defusedxml, against XML bombs, only where it is there
    if data.startswith(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"):
        raise InputError("it is a workbook of Excel 97 to 2003, or one with a password; save it as .xlsx without one")
    from openpyxl import load_workbook

    with text.foreign("Excel workbook"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of styles and extensions that it leaves out
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            claimed = sum(entry.file_size for entry in archive.infolist())
        if claimed > MOST_UNPACKED:
            raise InputError(f"it unpacks to {claimed} bytes, more than {MOST_UNPACKED}; save the table as .csv")
        book = load_workbook(io.BytesIO(data), read_only=True, data_only=True, keep_links=False)
        try:
            sheets = [(str(sheet.title)[:40], rows) for sheet in book.worksheets if (rows := _rows(sheet))]
        finally:
            book.close()
    if not sheets:
        raise InputError("it holds no data, only blank sheets; write the record again")
    lengths = [sum(len(row) > 1 and text.value_share(row) > 0.5 for _, row in rows) for _, rows in sheets]
    most = min(max(lengths), A_TABLE)
    tables = [k for k, length in enumerate(lengths) if length >= most] if most else [0]
    (name, rows), remarks = sheets[tables[0]], []
    if len(tables) > 1:
        others = f"the first of {len(tables)} with a table; save another one as its own workbook"
        remarks = [f"sheet {name!r} is read, {others}"]
    elif len(sheets) > 1:
        remarks = [f"the table is that of sheet {name!r}"]
    numeric = [text.value_share(row) > 0.5 for _, row in rows]
    first = next((k for k, it in enumerate(numeric) if it and all(numeric[k : k + 3])), 0)
    width = max(len(row) for _, row in rows[max(first - text.MOST_HEADER_ROWS, 0) :])
    # Above the samples stand names and units, and notes of a few cells, which fill no line of the table.
    lines, half = [], len(rows[first][1]) / 2
    for k, (number, row) in enumerate(rows):
        whole = k >= first or sum(map(bool, row)) > half
        lines.append((number, text.CELL.join(row + [""] * (width - len(row)) if whole else row)))
    return text.laid_out(lines, text.CELL, remarks)


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
        if len(row) > text.MOST_HEADINGS:
            raise InputError(f"sheet {title} has more than {text.MOST_HEADINGS} columns; is it a flight record?")
        if row:
            rows.append((number, row))
    return rows


def _text(value: Any) -> str:
    if isinstance(value, datetime | date | time):
        return value.isoformat()
    if isinstance(value, timedelta | bool):
        return repr(value.total_seconds() if isinstance(value, timedelta) else int(value))
    if isinstance(value, float):
        return repr(value) + "0" * (_THOUSANDS.fullmatch(repr(value)) is not None)
    return "" if value is None else _UNFIT.sub(" ", str(value)).strip()


READS = {suffix: partial(open_log, suffix) for suffix in LOGS} | {
    ".nc": open_netcdf, ".mat": open_mat, ".parquet": open_parquet, ".xlsx": open_excel,
}  # fmt: skip
