"""HDF5 files: NetCDF-4 and MATLAB's v7.3, read in a child process for the reason in `hdf5_child.py`."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.readers.base import (
    MAX_VALUES,
    MOST_VALUES_IN_ALL,
    PACKING,
    Column,
    Heading,
    Opened,
    foreign,
    refuse_huge,
    stated_unit,
    unpacked,
    vector,
)

HDF5 = b"\x89HDF\r\n\x1a\n"
"""What such a file begins with; MATLAB's has 512 bytes of its own before it."""

TIME_LIMIT = 20.0
"""Seconds for the child; a sound record takes about a third of one."""


@dataclass(frozen=True)
class HDF5File:
    """An HDF5 file whose datasets have been listed. `places`: dataset and, of a matrix, column of each heading."""

    data: bytes
    file: str
    headings: Sequence[Heading]
    places: Mapping[Heading, tuple[str, int | None]]
    remarks: Sequence[str] = ()
    kind: str = "variable"

    def read(self, wanted: Mapping[str, Heading]) -> dict[str, Column]:
        """See `Opened.read`."""
        reply, payload = _ask(self.data, [self.places[heading] for heading in wanted.values()], self.file)
        if "problem" in reply:
            place, problem = reply["problem"]
            name = list(wanted)[place]
            raise InputError(f"channel {name} ({wanted[name].names[0]!r}) {problem}")
        columns, start = {}, 0
        for (name, heading), (kind, size, given) in zip(wanted.items(), reply["vectors"], strict=True):
            raw = np.frombuffer(payload, kind, size, start)
            attributes = {key: np.array(x, dtype) for key, (dtype, x) in given.items()}
            columns[name] = Column(unpacked(raw, attributes, name), heading.unit)
            start += raw.nbytes
        return columns


def open_hdf5(data: bytes, kind: str) -> HDF5File:
    """The datasets of an HDF5 file; `kind` names it to the user.

    A dataset in a group goes by its path ("flight.T") and, where no other has it, by its own name. The columns of an
    only matrix go by their numbers.
    """
    if find_spec("h5py") is None:
        raise InputError(f"this {kind} is an HDF5 file, and h5py is not installed; install h5py, or write .csv")
    listed: dict[str, dict[str, Any]] = _ask(data, [], kind)[0]["available"]
    matrices = [path for path, it in listed.items() if it["numbers"] and _columns(it["shape"])]
    own = Counter(path.rsplit("/", 1)[-1] for path in listed)
    headings: list[Heading] = []
    places: dict[Heading, tuple[str, int | None]] = {}
    for path, it in listed.items():
        dotted, short = path.replace("/", "."), path.rsplit("/", 1)[-1]
        names = (short, dotted) if own[short] == 1 else (dotted,)
        count = _columns(it["shape"]) if path in matrices else 0
        for k in range(count) if count else (None,):
            if k is None:
                heading = Heading(tuple(dict.fromkeys(names)), None, stated_unit(it["unit"]))
            else:
                only = len(matrices) == 1
                heading = Heading(
                    (f"{dotted}(:,{k + 1})",), k + 1 if only else None, stated_unit(it["unit"]), formed=True
                )
            headings.append(heading)
            places[heading] = (path, k)
    if listed and all(it["opaque"] for it in listed.values()):
        raise InputError(OBJECT)
    return HDF5File(data, kind, headings, places)


OBJECT = (
    "it holds a MATLAB object (a table, timetable or class), which only MATLAB can read; in MATLAB, save a struct of "
    "vectors (table2struct(T, 'ToScalar', true)), or write .csv with writetable"
)


def _columns(shape: Sequence[int]) -> int:
    """Columns of a matrix; 0 for a vector. MATLAB's files hold matrices transposed."""
    return min(shape) if len(shape) == 2 and min(shape) > 1 else 0


def _ask(data: bytes, wanted: Sequence[tuple[str, int | None]], kind: str) -> tuple[dict, bytes]:
    child = Path(__file__).with_name("hdf5_child.py")
    # -P: the child must not take this folder's numbers.py and the like for libraries.
    command = [
        sys.executable,
        "-P",
        str(child),
        json.dumps([wanted, PACKING]),
        str(MAX_VALUES),
        str(MOST_VALUES_IN_ALL),
    ]
    try:
        done = subprocess.run(command, input=data, capture_output=True, timeout=TIME_LIMIT, check=False)
    except subprocess.TimeoutExpired as reason:
        raise InputError(
            f"the HDF5 library did not finish reading it in {TIME_LIMIT:g} s; the {kind} is damaged: write it again"
        ) from reason
    head, _, payload = done.stdout.partition(b"\n")
    if done.returncode != 0 or not head:
        raise InputError(f"the HDF5 library crashed on it; the {kind} is damaged: write it again")
    reply = json.loads(head)
    if "error" in reply:
        raise InputError(f"it is not a readable {kind} ({reply['error']}); is it damaged or misnamed? Write it again")
    return reply, payload


# --- NetCDF, one variable a channel: classic files by scipy, NetCDF-4 by h5py.


def open_netcdf(data: bytes) -> Opened:
    """A NetCDF file of either kind."""
    if data.startswith(HDF5):
        return open_hdf5(data, "NetCDF file")
    if not data.startswith(b"CDF"):
        raise InputError("it is neither a NetCDF-4 nor a classic NetCDF file; is it misnamed? Write it again")
    from scipy.io import netcdf_file

    with foreign("NetCDF file"):
        file = netcdf_file(io.BytesIO(data), "r", mmap=False)
        headings = [
            Heading((str(name),), None, stated_unit(getattr(v, "units", None))) for name, v in file.variables.items()
        ]
    return ClassicNetCDF(file, headings)


READS = {".nc": open_netcdf}


@dataclass(frozen=True)
class ClassicNetCDF:
    """A classic NetCDF file whose variables have been listed."""

    file: Any
    headings: Sequence[Heading]
    kind: str = "variable"
    remarks: Sequence[str] = ()

    def read(self, wanted: Mapping[str, Heading]) -> dict[str, Column]:
        """See `Opened.read`."""
        columns = {}
        for name, heading in wanted.items():
            variable = self.file.variables[heading.names[0]]
            with foreign("NetCDF file"):
                raw = np.asarray(variable.data)
                refuse_huge(name, heading.names[0], raw.size, len(wanted))
                vector(raw, name)  # its type and shape
                columns[name] = Column(unpacked(raw, vars(variable)["_attributes"], name), heading.unit)
        return columns
