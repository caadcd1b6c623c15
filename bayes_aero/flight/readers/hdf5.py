"""HDF5 files: NetCDF-4 and MATLAB's v7.3, read in a child process for the reason in `isolated/child.py`."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.readers.base import (
    MAX_VALUES,
    MOST_VALUES_IN_ALL,
    PACKING,
    FileColumn,
    Heading,
    OpenedFile,
    foreign,
    refuse_huge,
    stated_unit,
    unpacked,
    vector,
)
from bayes_aero.flight.readers.isolated.process import ask_child

HDF5 = b"\x89HDF\r\n\x1a\n"  # what such a file begins with; MATLAB's has 512 bytes of its own before it
TIME_LIMIT = 20.0  # seconds for the child; a sound record takes about a third of one
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
        return ask_child(data, "hdf5_child.py", request, TIME_LIMIT, slow, crashed, kind)

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


READS = {".nc": open_netcdf}
