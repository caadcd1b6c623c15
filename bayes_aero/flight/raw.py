"""Everything that a file holds, before any card says what it means."""

from __future__ import annotations

import io
import os
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.channel import Channel
from bayes_aero.flight.columns import Column, foreign
from bayes_aero.flight.hdf5 import list_hdf5
from bayes_aero.flight.readers import READERS, Reader, bytes_of, reader_for
from bayes_aero.flight.text import csv_headings, read_columns, width_of

__all__ = ["RawColumn", "RawFile", "read_raw"]

MOST = 2000
"""Columns beyond this are not looked at."""

PATIENCE = 20.0  # seconds


@dataclass(frozen=True)
class RawColumn:
    """One column: its name (None in files without a header), place counted from 1, (n,) values, unit if the file says.

    Values are None where they are no numbers.
    """

    label: str | None
    number: int
    values: np.ndarray | None
    unit: str | None = None

    @property
    def place(self) -> str:
        """How a person finds it in the file."""
        return f"column {self.number}" if self.label is None else repr(self.label)


@dataclass(frozen=True)
class RawFile:
    """A file's columns in its order; names that occur twice are left out and listed."""

    columns: tuple[RawColumn, ...]
    repeated: tuple[str, ...] = ()

    def find(self, channel: Channel) -> RawColumn | None:
        """The column that a card's channel names."""
        for column in self.columns:
            if column.label is None and column.number == channel.column:
                return column
            if column.label is not None and column.label == channel.heading:
                return column
        return None


def read_raw(path: str | os.PathLike[str]) -> RawFile:
    """Every column of a file, numeric or not; raises `InputError` with the file's name."""
    try:
        reader = reader_for(Path(path))
        data = bytes_of(Path(path))
        if reader is read_columns:
            labels: list[str | None] = [None] * min(width_of(data), MOST)
        else:
            labels = [*_labels(Path(path), data)[:MOST]]
        repeated = tuple(sorted({name for name in labels if name is not None and labels.count(name) > 1}))
        places = [
            Channel(name=str(number), unit="1", label=label, column=number, required=False)
            for number, label in enumerate(labels, 1)
            if label not in repeated and label != ""
        ]
        found = _read(reader, data, places)
    except InputError as reason:
        raise InputError(f"{os.fspath(path)}: {reason}") from reason
    columns = (
        RawColumn(place.label, int(place.name), column.values if column else None, column.unit if column else None)
        for place in places
        for column in [found.get(place.name)]
    )
    return RawFile(tuple(columns), repeated)


def _read(reader: Reader, data: bytes, places: Sequence[Channel]) -> dict[str, Column]:
    """All columns at once; where one is no numbers, each half on its own, so that only it is lost.

    When `PATIENCE` is over, whatever has not been read is taken for no numbers.
    """
    found: dict[str, Column] = {}
    failure = InputError("it holds no column of numbers; is it the right file?")
    left = deque([list(places)])
    began = time.monotonic()
    while left and time.monotonic() - began < PATIENCE:
        some = left.popleft()
        try:
            found |= reader(data, some)
        except InputError as reason:
            failure, half = reason, len(some) // 2
            left.extend([some[:half], some[half:]] if half else [])
    if not found:
        raise failure from None
    return found


def _labels(path: Path, data: bytes) -> list[str]:
    suffix = path.suffix.lower()
    assert suffix in READERS
    if suffix == ".csv":
        return csv_headings(data)
    if suffix == ".parquet":
        import pyarrow as pa
        import pyarrow.parquet as pq

        with foreign("Parquet file"):
            return list(pq.ParquetFile(pa.BufferReader(data)).schema_arrow.names)
    if b"\x89HDF\r\n\x1a\n" in (data[:8], data[512:520]):
        return list_hdf5(data, "NetCDF file" if suffix == ".nc" else "MATLAB v7.3 file")
    if suffix == ".mat":
        from scipy.io import whosmat

        with foreign("MATLAB file"):
            return [name for name, _, _ in whosmat(io.BytesIO(data))]
    from scipy.io import netcdf_file

    with foreign("NetCDF file"):
        return [str(name) for name in netcdf_file(io.BytesIO(data), "r", mmap=False).variables]
